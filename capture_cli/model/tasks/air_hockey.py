"""Table air hockey: a mallet strikes a puck on a table whose halves differ in friction (paper, Section IV-A, Table I).

The open parameters are the sliding friction of the left and the right half of the table, and how much mallet, left
and right wall damp a contact: the second number of a contact's `solref="-stiffness -damping"`, 1/s, negative as in
the paper's table. The nearer to 0, the livelier: the coefficient of restitution depends on it alone, not on the speed
(`capture_cli.model.targets.Restitution` has the formula). An action is one stroke of the mallet.
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
    friction: tuple[float, float] = (0.03, 0.07)  # Table I
    mallet_damping: tuple[float, float] = (-15.0, -3.0)
    wall_damping: tuple[float, float] = (-40.0, -3.0)
    target_radius: float = 0.04
    # of the range: what follows a hit is rough over 1 % or so, by where between two steps it falls
    step: float = 0.03
    pause: float = 0.05  # s, before the stroke: a log then shows from where, and that nothing moved
    follow_through: float = 0.08  # m, of the mallet past the place where it meets the puck


# Where the puck is to be when the episode ends, m, and how near counts. On a slippery table even the softest straight
# shot overruns it, and friction then has to be had off the walls: no one stroke serves all tables.
TARGET = np.array([0.1, 0.0])


class AirHockey(ActionTask):
    """The plant: table, puck, and a mallet on two velocity servos, which nothing but the puck resists.

    far_wall: also open the damping of the far wall, as a sixth parameter.
    """

    name = "air-hockey"
    trainable = True
    mirrored = True  # left and right

    def __init__(self, *, far_wall: bool = False):
        self.model = mujoco.MjModel.from_xml_path(str(MODEL))
        self.model_path = MODEL
        self._friction = {f"{side}_friction": f"{side}_table" for side in ("left", "right")}
        self._damping = {
            "mallet_damping": "mallet",
            "left_damping": "left_wall",
            "right_damping": "right_wall",
        }
        if far_wall:
            self._damping["far_damping"] = "far_wall"
        self.space = ParameterSpace(
            [_parameter(name, "1", SETTINGS.friction) for name in self._friction]
            + [
                _parameter(
                    name, "1/s", SETTINGS.mallet_damping if geom == "mallet" else SETTINGS.wall_damping
                )
                for name, geom in self._damping.items()
            ]
        )
        self.inputs = tuple(
            Channel.of_actuator(self.model, name, "m/s") for name in ("mallet_vx", "mallet_vy")
        )
        self.outputs = tuple(
            Channel.of_sensor(self.model, name, "m") for name in ("puck_x", "puck_y", "mallet_x", "mallet_y")
        )
        # whole episodes hit the walls too often: their error has valleys everywhere
        self.log = LogColumns(window=1.0)
        self.actions = ParameterSpace(
            [
                _parameter("mallet_x", "m", (-0.28, -0.22)),
                _parameter("mallet_y", "m", (-0.1, 0.1)),
                _parameter("aim", "rad", (-0.01 * np.pi, 0.01 * np.pi)),  # from the line to the puck's centre
                _parameter("speed", "m/s", (0.3, 0.5)),
            ]
        )
        self.features = (Feature("puck_x", "m", 0.1), Feature("puck_y", "m", 0.05))
        self.point_times = 0.2 * np.arange(1, 11)
        self._start = self.model.key("start").qpos.copy()
        joint = {
            name: self.model.joint(name).qposadr[0] for name in ("puck_x", "puck_y", "mallet_x", "mallet_y")
        }
        self._mallet = [joint["mallet_x"], joint["mallet_y"]]
        self.puck_start = self._start[[joint["puck_x"], joint["puck_y"]]]
        geom = self.model.geom
        self._touch = float(geom("puck_rim").size[0] + geom("mallet").size[0])

    def write(self, fields, parameters):
        for column, name in enumerate(self.space.names):
            if name in self._friction:
                fields["geom_friction"][:, self.model.geom(self._friction[name]).id, 0] = parameters[
                    :, column
                ]
            else:
                fields["geom_solref"][:, self.model.geom(self._damping[name]).id, 1] = parameters[:, column]

    def episodes(self, actions):
        """The mallet stands at its start, moves at `speed` along its aim, through the puck's place, and stops."""
        count = len(actions)
        qpos = np.repeat(self._start[None], count, axis=0)
        qpos[:, self._mallet] = actions[:, :2]
        initial = InitialStates(qpos, np.zeros((count, self.model.nv)), np.zeros((count, 0)), np.zeros(count))
        to_puck = self.puck_start - actions[:, :2]
        angle = np.arctan2(to_puck[:, 1], to_puck[:, 0]) + actions[:, 2]
        velocity = actions[:, 3:] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        stroke = np.linalg.norm(to_puck, axis=1) - self._touch + SETTINGS.follow_through
        moving = self.share_of_steps(SETTINGS.pause, stroke / actions[:, 3])
        return Episodes(initial, moving[:, :, None] * velocity[:, None])

    def observe(self, outputs):
        """The puck's x and y, m."""
        return outputs[..., :2]

    def mirror_parameters(self, parameters):
        names = list(self.space.names)
        return np.asarray(parameters)[:, [names.index(_other_side(name)) for name in names]]

    def mirror_actions(self, actions):
        return np.asarray(actions) * np.array([1.0, -1.0, -1.0, 1.0])

    def reward(self, actions, trajectories):
        """1 where the puck ends at the target, falling with its distance."""
        return np.exp(-_miss(trajectories) / SETTINGS.target_radius)

    def success(self, actions, trajectories):
        """Whether the puck ends within `target_radius` of the target."""
        return _miss(trajectories) <= SETTINGS.target_radius


def _parameter(name: str, unit: str, bounds: tuple[float, float]) -> Parameter:
    return Parameter(name, unit, *bounds, nominal=sum(bounds) / 2, step=SETTINGS.step)


def _other_side(name: str) -> str:
    side, _, what = name.partition("_")
    return f"{({'left': 'right', 'right': 'left'}).get(side, side)}_{what}"


def _miss(trajectories: np.ndarray) -> np.ndarray:
    """Distance from the target at the end of each episode, m, (episode,)."""
    return np.linalg.norm(trajectories[:, -1] - TARGET, axis=-1)
