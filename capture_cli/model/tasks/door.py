"""A door is to be left ajar by one push: its hinge rubs, and its panel bounces off the finger.

The open parameters are the hinge's dry friction and damping, and how much finger and panel damp a hit: the second
number of the contact's `solref="-stiffness -damping"`, 1/s, as of table air hockey's mallet. An action is one push,
straight through the door. The door is robosuite's, and so is its inertia.
"""

from pathlib import Path

import mujoco
import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.model.parameters import Parameter, ParameterSpace
from capture_cli.model.states import InitialStates
from capture_cli.model.tasks.base import ActionTask, Channel, Episodes, Feature, LogColumns

MODEL = Path(__file__).with_suffix(".xml")


@frozen
class SETTINGS:
    hinge_friction: tuple[float, float] = (0.2, 0.8)  # N m; robosuite's own door has 1, and 1 N m s/rad
    hinge_damping: tuple[float, float] = (0.1, 0.6)  # N m s/rad
    finger_damping: tuple[float, float] = (-40.0, -3.0)
    step: float = 0.02  # of the range: a hit is a little rough, by where between two steps it falls
    ajar: float = 0.5  # rad, where the door is to come to rest
    within: float = 0.03  # rad, that count as there
    gap: float = 0.04  # m, of finger and panel before the push
    pause: float = 0.05  # s, before the push: a log then shows from where, and that nothing moved
    follow_through: float = 0.08  # m, of the finger past the place where it meets the panel


class Door(ActionTask):
    """The plant: a panel on a hinge, and a finger on two velocity servos, which nothing but the panel resists."""

    name = "door"
    trainable = True

    def __init__(self):
        self.model = mujoco.MjModel.from_xml_path(str(MODEL))
        self.model_path = MODEL
        self.space = ParameterSpace(
            [
                _parameter("hinge_friction", "N m", SETTINGS.hinge_friction),
                _parameter("hinge_damping", "N m s/rad", SETTINGS.hinge_damping),
                _parameter("finger_damping", "1/s", SETTINGS.finger_damping),
            ]
        )
        self.inputs = tuple(
            Channel.of_actuator(self.model, name, "m/s") for name in ("finger_vx", "finger_vy")
        )
        self.outputs = tuple(
            Channel.of_sensor(self.model, name, unit)
            for name, unit in (("door_angle", "rad"), ("finger_x", "m"), ("finger_y", "m"))
        )
        self.log = LogColumns()
        self.actions = ParameterSpace(
            [
                _parameter("finger_y", "m", (-0.05, 0.15)),  # from the panel's middle; the hinge is at -0.255
                _parameter("speed", "m/s", (0.25, 0.6)),
            ]
        )
        self.features = (Feature("door_angle", "rad", 0.2),)
        self.point_times = 0.2 * np.arange(1, 11)
        self._hinge = self.model.joint("door_angle").dofadr[0]
        self._finger = [self.model.joint(name).qposadr[0] for name in ("finger_x", "finger_y")]
        self._start_x = -self.model.geom("panel").size[0] - self.model.geom("finger").size[0] - SETTINGS.gap

    def write(self, fields, parameters):
        friction, damping, hit = parameters.T
        fields["dof_frictionloss"][:, self._hinge] = friction
        fields["dof_damping"][:, self._hinge] = damping
        fields["geom_solref"][:, self.model.geom("finger").id, 1] = hit

    def episodes(self, actions):
        """The finger stands before the door, moves at `speed` towards and past it, and stops."""
        count = len(actions)
        qpos = np.repeat(self.model.qpos0[None], count, axis=0)
        qpos[:, self._finger[0]] = self._start_x
        qpos[:, self._finger[1]] = actions[:, 0]
        initial = InitialStates(qpos, np.zeros((count, self.model.nv)), np.zeros((count, 0)), np.zeros(count))
        duration = (SETTINGS.gap + SETTINGS.follow_through) / actions[:, 1]
        inputs = np.zeros((count, self.grid_steps, 2))
        inputs[:, :, 0] = self.share_of_steps(SETTINGS.pause, duration) * actions[:, 1:]
        return Episodes(initial, inputs)

    def observe(self, outputs):
        """The door's angle, rad."""
        return outputs[..., :1]

    def reward(self, actions, trajectories):
        """1 where the door ends ajar, falling with the angle that it misses."""
        return np.exp(-_miss(trajectories) / SETTINGS.within)

    def success(self, actions, trajectories):
        """Whether the door ends `within` of ajar."""
        return _miss(trajectories) <= SETTINGS.within


def _parameter(name: str, unit: str, bounds: tuple[float, float]) -> Parameter:
    return Parameter(name, unit, *bounds, nominal=sum(bounds) / 2, step=SETTINGS.step)


def _miss(trajectories: np.ndarray) -> np.ndarray:
    """How far each episode ends from ajar, rad, (episode,)."""
    return np.abs(trajectories[:, -1, 0] - SETTINGS.ajar)
