"""Object scooping as a robosuite environment: table, rack, rod, and a Panda that holds the spatula (paper, Figure 3).

    robosuite.make("ObjectScooping", robots="Panda", com=0.3, scoop_point=0.25)
    gymnasium.make("capture/ObjectScooping-v0", robots="Panda")

Importing this module registers both. The model of the plant, `capture_cli/tasks/scooping.xml`, is part of the scene
as it stands, and stepped with its options, so that a spatula that moves alike lifts the rod alike.
"""

from __future__ import annotations

# patches robosuite, and says so where it is missing: before anything of it is imported
from capture_cli.worlds import _robosuite  # noqa: F401

# isort: split
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
from robosuite.environments.manipulation.manipulation_env import ManipulationEnv
from robosuite.models.arenas import TableArena
from robosuite.models.base import MujocoXML
from robosuite.models.tasks import ManipulationTask
from robosuite.utils.observables import Observable, sensor

from capture_cli.errors import OptionError, did_you_mean
from capture_cli.tasks._scooping import HALF_LENGTH, lift_height
from capture_cli.tasks.scooping import Scooping
from capture_cli.worlds._grip import grip, take_hold, take_options
from capture_cli.worlds._gymnasium import GymnasiumEnvironment

SCENE = Path(__file__).with_name("scooping_scene.xml")
TABLE_SIZE = (0.8, 0.8, 0.05)  # m
TABLE_TOP = 0.8  # m
RACK_HEIGHT = 0.12  # m, of the rod's underside above the table
# The plant's x axis points to the right of a robot that faces the table, its y axis away from it.
RACK_TURN = "0.70710678118654757 0 0 -0.70710678118654757"
DRIVERS = ("arm", "servos")


class ObjectScooping(ManipulationEnv):
    """One robot lifts a rod whose centre of mass it does not see; success is that the rod is lifted in balance.

    com, scoop_point: in half-lengths of the rod, as the task's parameter and action; None draws one at every reset.
    The robot holds the spatula under the scoop point at reset, and its action moves it from there.
    driven_by: "arm", or "servos": the spatula is let go of and follows `spatula_target` (2,), m, as in the plant.
    Other arguments are robosuite's. Raises OptionError.
    """

    def __init__(
        self,
        robots,
        com: float | None = None,
        scoop_point: float | None = None,
        driven_by: str = "arm",
        has_offscreen_renderer: bool = False,
        use_camera_obs: bool = False,
        **options,
    ):
        if driven_by not in DRIVERS:
            raise OptionError(f"driven_by = {driven_by!r}", cure=did_you_mean(driven_by, DRIVERS))
        self.plant = Scooping()
        self.driven_by = driven_by
        self.place(com, scoop_point)
        options = {"initialization_noise": None, **options}
        super().__init__(
            robots=robots,
            has_offscreen_renderer=has_offscreen_renderer,
            use_camera_obs=use_camera_obs,
            **options,
        )

    def place(self, com: float | None, scoop_point: float | None) -> None:
        """What the next reset makes of the rod and the spatula; None draws it."""
        self._given = (com, scoop_point)

    @property
    def outputs(self) -> np.ndarray:
        """What the plant's sensors report now, (output,)."""
        return self.sim.data.qpos[self._qpos].copy()

    @property
    def label(self) -> float:
        """-1 tilted left, 0 lifted in balance, 1 tilted right: the task's observation of the rod as it is now."""
        return float(self.plant.observe(self.outputs)[0])

    def reward(self, action=None) -> float:
        """1 where the rod is lifted in balance, 0 otherwise."""
        return float(self._check_success())

    def _check_success(self) -> bool:
        return self.label == 0

    # --- the scene ---

    def _load_model(self):
        super()._load_model()
        robot = self.robots[0].robot_model
        robot.set_base_xpos(robot.base_xpos_offset["table"](TABLE_SIZE[0]))
        arena = TableArena(table_full_size=TABLE_SIZE, table_offset=(0, 0, TABLE_TOP))
        arena.set_origin([0, 0, 0])
        plant = MujocoXML(str(self.plant.model_path))
        arena.worldbody.append(_rack(plant, MujocoXML(str(SCENE))))
        arena.actuator.extend(plant.actuator)
        arena.sensor.extend(plant.sensor)
        self.model = ManipulationTask(mujoco_arena=arena, mujoco_robots=[robot])
        hand = self.robots[0].gripper[self._arm].correct_naming("eef")
        self.model.equality.append(grip(hand, "spatula"))
        take_options(self.model.root, plant.root)

    def _setup_references(self):
        super()._setup_references()
        model = self.sim.model._model
        self._qpos = [model.joint(c.name).qposadr[0] for c in self.plant.outputs]
        servos = [self.plant.model.actuator(c.index).name for c in self.plant.inputs]
        self._servos = [model.actuator(name).id for name in servos]

    def _setup_observables(self):
        observables = super()._setup_observables()

        @sensor(modality="object")
        def rod_and_spatula(cache):
            return self.outputs

        observables["rod_and_spatula"] = Observable(
            name="rod_and_spatula", sensor=rod_and_spatula, sampling_rate=self.control_freq
        )
        return observables

    @property
    def _arm(self) -> str:
        return self.robots[0].arms[0]

    # --- an episode ---

    def _reset_internal(self):
        super()._reset_internal()
        com, scoop_point = (self.rng.uniform(-1, 1) if v is None else v for v in self._given)
        model, data = self.sim.model._model, self.sim.data._data
        model.body("rod").ipos[0] = HALF_LENGTH * com
        mujoco.mj_setConst(model, mujoco.MjData(model))
        data.qpos[self._qpos] = self.plant.episodes(np.array([[scoop_point]])).starts.qpos[0]
        self.spatula_target = self.outputs[3:]
        mujoco.mj_forward(model, data)
        if self.driven_by == "arm":
            take_hold(self.robots[0], self._arm, model, data, "handle", self._servos)

    def _pre_action(self, action, policy_step=False):
        super()._pre_action(action, policy_step)
        self.sim.data.ctrl[self._servos] = self.spatula_target

    def arm_action(self, target: np.ndarray) -> np.ndarray:
        """The action that sends the hand to where the spatula is at `target`, (x, z) in the plant's axes, m.

        For a controller whose first three inputs move the hand by at most `output_max`, as the Panda's own one does.
        """
        x, z = target - self.outputs[3:]
        controller = self.robots[0].part_controllers[self._arm]
        action = np.zeros(self.action_dim)
        action[:3] = np.clip(np.array([0.0, -x, z]) / controller.output_max[:3], -1, 1)
        return action


def record(
    parameters: np.ndarray, actions: np.ndarray, rate: int = 100
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """What a Panda's log of these lifts would hold, without noise: (time, inputs, outputs) of each, as `lift` gives.

    parameters (parameter,), actions (episode, action), in the task's units. rate: Hz, of the arm's commands and of
    the log. Raises OptionError where the scene's steps do not make up that rate.
    """
    steps_per_sample = 1 / (rate * Scooping().timestep)
    if not (steps_per_sample >= 1 and np.isclose(steps_per_sample, round(steps_per_sample))):
        raise OptionError(
            f"rate = {rate:g} Hz, and the scene is stepped every {Scooping().timestep:g} s",
            cure="give 500 Hz divided by a whole number",
        )
    environment = ObjectScooping(robots="Panda", control_freq=rate, hard_reset=False)
    recordings = []
    for action in actions:
        environment.place(float(parameters[0]), float(action[0]))
        environment.reset()
        recordings.append(lift(environment))
    return recordings


def lift(environment: ObjectScooping) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lift the rod once, from a fresh reset: time (step,) s, inputs (step, 2) and outputs (step, output).

    The arm is sent, at every control step, where the plant's servos would be sent: that is what the log's inputs say.
    """
    plant = environment.plant
    interval = environment.control_timestep
    steps = round(plant.point_times[-1] / interval) + 1
    time = interval * np.arange(steps)
    inputs = np.stack([np.full(steps, environment.outputs[3]), lift_height(time)], axis=1)
    outputs = np.empty((steps, len(plant.outputs)))
    outputs[0] = environment.outputs
    for step in range(1, steps):
        environment.step(environment.arm_action(inputs[step - 1]))
        outputs[step] = environment.outputs
    return time, inputs, outputs


def gymnasium_environment(render_mode: str | None = None, **options) -> GymnasiumEnvironment:
    """The environment behind gymnasium's interface; options are those of `ObjectScooping`."""
    options = {"robots": "Panda", "has_offscreen_renderer": render_mode is not None, **options}
    return GymnasiumEnvironment(ObjectScooping(**options), render_mode)


gymnasium.register("capture/ObjectScooping-v0", entry_point=gymnasium_environment)


# --- parts of the scene ---


def _rack(plant: MujocoXML, scene: MujocoXML) -> ElementTree.Element:
    """Everything of the plant in one body that stands on the table."""
    rack = ElementTree.Element("body", name="rack", pos=f"0 0 {TABLE_TOP + RACK_HEIGHT}", quat=RACK_TURN)
    for body in plant.worldbody.findall("body"):
        beyond = scene.worldbody.find(f"body[@name='{body.get('name')}']")
        body.extend(beyond if beyond is not None else [])
        rack.append(body)
    return rack
