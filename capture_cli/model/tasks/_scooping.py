"""The plant of object scooping: a rod lifted by two tines, in a vertical plane (paper, Section IV-A).

Lengths along the rod are in half-lengths (`half_length`): its centre of mass `com`, the one open parameter, and
`scoop_point`, the one component of an action, are both -1 at the left end and 1 at the right one.
"""

from pathlib import Path

import mujoco
import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.log.input_sequences import EVENLY
from capture_cli.model.parameters import Parameter, ParameterSpace
from capture_cli.model.states import InitialStates
from capture_cli.model.tasks.base import ActionTask, Channel, Episodes, LogColumns

MODEL = Path(__file__).with_name("scooping.xml")


@frozen
class SETTINGS:
    half_length: float = 0.08  # m
    lift: float = 0.032  # m, that the tines rise; 0.001 m of it until they touch
    lift_time: float = 0.4  # s
    # of the range: tilting begins between two steps, which makes outputs a little rough
    com_step: float = 0.01


OUTPUT_UNITS = {"rod_tilt": "rad"}  # m otherwise


class ScoopingPlant(ActionTask):
    """Rod, tray and spatula. A subclass says what is observed and when."""

    trainable = True
    entropy = 0.1

    def __init__(self, output_sensors: tuple[str, ...]):
        self.model = mujoco.MjModel.from_xml_path(str(MODEL))
        self.model_path = MODEL
        self.space = ParameterSpace([Parameter("com", "1", -1.0, 1.0, nominal=0.0, step=SETTINGS.com_step)])
        self.actions = ParameterSpace([Parameter("scoop_point", "1", -1.0, 1.0, nominal=0.0)])
        self.inputs = tuple(
            Channel(f"{name}_target", "m", f"{name}_target", self.model.actuator(name).id, hold=EVENLY)
            for name in ("spatula_x", "spatula_z")
        )
        self.outputs = tuple(
            Channel.of_sensor(self.model, name, OUTPUT_UNITS.get(name, "m")) for name in output_sensors
        )
        self.log = LogColumns()
        self._rod = self.model.body("rod").id
        self._spatula_x = self.model.joint("spatula_x").qposadr[0]

    def write(self, fields, parameters):
        fields["body_ipos"][:, self._rod, 0] = SETTINGS.half_length * parameters[:, 0]

    def episodes(self, actions):
        """The spatula stands under the scoop point and rises along a minimum-jerk path."""
        count = len(actions)
        scoop = SETTINGS.half_length * np.asarray(actions, dtype=float)[:, 0]
        qpos = np.repeat(self.model.qpos0[None], count, axis=0)
        qpos[:, self._spatula_x] = scoop
        initial = InitialStates(qpos, np.zeros((count, self.model.nv)), np.zeros((count, 0)), np.zeros(count))
        inputs = np.empty((count, self.grid_steps, 2))
        inputs[:, :, 0] = scoop[:, None]
        inputs[:, :, 1] = lift_height(self.timestep * np.arange(self.grid_steps))
        return Episodes(initial, inputs)


def lift_height(time: np.ndarray) -> np.ndarray:
    """How far the spatula is to have risen at `time` s, m: minimum jerk (Flash and Hogan, 1985)."""
    u = np.clip(time / SETTINGS.lift_time, 0.0, 1.0)
    return SETTINGS.lift * u**3 * (10 - 15 * u + 6 * u**2)
