"""What robosuite scenes have in common: a table, a task's plant that stands on it, a robot that holds the plant's tool.

The model of the plant is part of the scene as it stands, and stepped with its options.
"""

from capture_cli.common.frozen import frozen

# patches robosuite, and says so where it is missing: before anything of it is imported
from capture_cli.context.worlds import _robosuite  # noqa: F401

# isort: split
import xml.etree.ElementTree as ElementTree
from abc import abstractmethod
from dataclasses import dataclass

import mujoco
import numpy as np
from robosuite.environments.manipulation.manipulation_env import ManipulationEnv
from robosuite.models.arenas import TableArena
from robosuite.models.base import MujocoXML
from robosuite.models.tasks import ManipulationTask
from robosuite.utils.observables import Observable, sensor

from capture_cli.context.worlds._grip import grip, take_hold, take_options
from capture_cli.context.worlds._gymnasium import GymnasiumEnvironment
from capture_cli.errors import OptionError, did_you_mean
from capture_cli.model.tasks.base import ActionTask


@frozen
class SETTINGS:
    table_top: float = 0.8  # m


DRIVERS = ("arm", "servos")
# MuJoCo begins anew after them
DIVERGED = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)


@dataclass(frozen=True)
class Played:
    """What a robot's log of an action would hold, without noise: time (step,) s, inputs (step, input), outputs (step,
    output). behind: how far the tool was at most from where it was sent, over how far that was from where it began.
    diverged: the simulation did.
    """

    time: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    behind: float
    diverged: bool


class Scene(ManipulationEnv):
    """A robot whose action moves the `tool` that it holds by its `handle` from reset on.

    driven_by: "arm", or "servos": the tool is let go of, and its servos do as `servo_commands` says. Other arguments
    are robosuite's. A scene sets `plant`, and what its first reset needs, before this. Raises OptionError.
    """

    plant: ActionTask
    tool: str  # a body of the plant
    handle: str  # a site of it
    table_size: tuple[float, float, float]  # m
    observed: str  # what observations call the plant's outputs

    def __init__(self, robots, driven_by: str, **options):
        if driven_by not in DRIVERS:
            raise OptionError(f"driven_by = {driven_by!r}", cure=did_you_mean(driven_by, DRIVERS))
        self.driven_by = driven_by
        defaults = {"has_offscreen_renderer": False, "use_camera_obs": False, "initialization_noise": None}
        super().__init__(robots=robots, **{**defaults, **options})

    @classmethod
    def behind_gymnasium(cls, render_mode: str | None = None, **options) -> GymnasiumEnvironment:
        """The environment behind gymnasium's interface; options are the scene's own."""
        options = {"robots": "Panda", "has_offscreen_renderer": render_mode is not None, **options}
        return GymnasiumEnvironment(cls(**options), render_mode)

    @property
    def outputs(self) -> np.ndarray:
        """What the plant's sensors report now, (output,)."""
        return self.sim.data.qpos[self._measured].copy()

    def reward(self, action=None) -> float:
        """That of the task for a plant that stays as it is."""
        return float(self.plant.reward(None, self._trajectory())[0])

    def _check_success(self) -> bool:
        return bool(self.plant.success(None, self._trajectory())[0])

    def _trajectory(self) -> np.ndarray:
        return self.plant.observe(self.outputs)[None, None]

    @property
    @abstractmethod
    def servo_commands(self) -> np.ndarray:
        """What the tool's servos are given, (input,)."""

    @abstractmethod
    def play(self, parameters: np.ndarray, action: np.ndarray) -> Played:
        """Begin anew and let the arm do what `action` (action,) asks for, under the task's parameters (parameter,)."""

    @abstractmethod
    def standing(self, plant: MujocoXML) -> ElementTree.Element:
        """Everything of the plant in one body that stands on the table."""

    def _load_model(self):
        super()._load_model()
        robot = self.robots[0].robot_model
        robot.set_base_xpos(robot.base_xpos_offset["table"](self.table_size[0]))
        arena = TableArena(table_full_size=self.table_size, table_offset=(0, 0, SETTINGS.table_top))
        arena.set_origin([0, 0, 0])
        plant = MujocoXML(str(self.plant.model_path))
        arena.worldbody.append(self.standing(plant))
        arena.actuator.extend(plant.actuator)
        arena.sensor.extend(plant.sensor)
        self.model = ManipulationTask(mujoco_arena=arena, mujoco_robots=[robot])
        hand = self.robots[0].gripper[self._arm].correct_naming("eef")
        self.model.equality.append(grip(hand, self.tool))
        take_options(self.model.root, plant.root)

    def _setup_references(self):
        super()._setup_references()
        model, plant = self.sim.model._model, self.plant.model
        self._measured = [model.joint(c.name).qposadr[0] for c in self.plant.outputs]
        self._servos = [model.actuator(plant.actuator(c.index).name).id for c in self.plant.inputs]

    def _setup_observables(self):
        @sensor(modality="object")
        def outputs(cache):
            return self.outputs

        measured = Observable(name=self.observed, sensor=outputs, sampling_rate=self.control_freq)
        return {**super()._setup_observables(), self.observed: measured}

    def played(self, time: np.ndarray, inputs: np.ndarray, outputs: np.ndarray, sent: np.ndarray) -> Played:
        """What was played; sent (step, 2): where the tool, which the last outputs are of, was to be."""
        tool = outputs[:, -sent.shape[1] :]
        behind = np.abs(tool - sent).max() / np.abs(sent - tool[0]).max()
        warnings = self.sim.data._data.warning
        diverged = any(warnings[kind].number for kind in DIVERGED) or not np.isfinite(outputs).all()
        return Played(time, inputs, outputs, float(behind), diverged)

    @property
    def _arm(self) -> str:
        return self.robots[0].arms[0]

    def hand_sent(self, way: np.ndarray) -> np.ndarray:
        """The action that sends the hand by `way`, (x, y, z) in the scene's axes, m, as far as one action may.

        For a controller whose first three inputs move the hand by at most `output_max`, as the Panda's own one does.
        """
        controller = self.robots[0].part_controllers[self._arm]
        action = np.zeros(self.action_dim)
        action[:3] = np.clip(way / controller.output_max[:3], -1, 1)
        return action

    def _hold(self) -> None:
        """Let the robot take the tool, where it is the arm that moves it."""
        if self.driven_by == "arm":
            model, data = self.sim.model._model, self.sim.data._data
            take_hold(self.robots[0], self._arm, model, data, self.handle, self._servos)

    def _pre_action(self, action, policy_step=False):
        super()._pre_action(action, policy_step)
        self.sim.data.ctrl[self._servos] = self.servo_commands


def check_rate(timestep: float, rate: float) -> None:
    """Raise OptionError where steps of `timestep` s do not make up `rate` Hz."""
    steps_per_sample = 1 / (rate * timestep)
    if not (steps_per_sample >= 1 and np.isclose(steps_per_sample, round(steps_per_sample))):
        raise OptionError(
            f"rate = {rate:g} Hz, and the scene is stepped every {timestep:g} s",
            cure=f"give {1 / timestep:g} Hz divided by a whole number",
        )
