"""Table air hockey as a robosuite environment: table, puck, and a Panda that holds the mallet (paper, Figure 3).

    robosuite.make("TableAirHockey", robots="Panda", parameters={"left_friction": 0.03})
    gymnasium.make("capture/TableAirHockey-v0", robots="Panda")

Importing this module registers both. The model of the plant, `capture_cli/tasks/air_hockey.xml`, is part of the scene
as it stands, and stepped with its options, so that a mallet that moves alike strikes the puck alike.
"""

from __future__ import annotations

# patches robosuite, and says so where it is missing: before anything of it is imported
from capture_cli.worlds import _robosuite  # noqa: F401

# isort: split
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping

import gymnasium
import mujoco
import numpy as np
from robosuite.controllers import load_composite_controller_config
from robosuite.environments.manipulation.manipulation_env import ManipulationEnv
from robosuite.models.arenas import TableArena
from robosuite.models.base import MujocoXML
from robosuite.models.tasks import ManipulationTask
from robosuite.utils.observables import Observable, sensor

from capture_cli.errors import OptionError, did_you_mean
from capture_cli.sim.engine import ModelFields
from capture_cli.tasks.air_hockey import MODEL, AirHockey
from capture_cli.worlds._grip import grip, take_hold, take_options
from capture_cli.worlds._gymnasium import GymnasiumEnvironment

TABLE_SIZE = (1.0, 0.8, 0.05)  # m
TABLE_TOP = 0.8  # m
RINK = (0.12, 0.0, 0.05)  # m, of the plant's origin from the middle of the table's top
REACH = 0.15  # m, that one action can send the hand away at most: the stroke is ahead of the arm by less
DRIVERS = ("arm", "servos")


class TableAirHockey(ManipulationEnv):
    """One robot strikes a puck on a table whose friction and restitution it does not see.

    parameters: of the task, by name; mallet: (x, y), m, of its start. None of them, or those not named, are drawn at
    every reset. The robot holds the mallet at reset, and its action moves it from there. driven_by: "arm", or
    "servos": the mallet is let go of and moves at `mallet_velocity` (2,), m/s, as in the plant. Other arguments are
    robosuite's. Raises OptionError.
    """

    def __init__(
        self,
        robots,
        parameters: Mapping[str, float] | None = None,
        mallet: np.ndarray | None = None,
        driven_by: str = "arm",
        has_offscreen_renderer: bool = False,
        use_camera_obs: bool = False,
        **options,
    ):
        if driven_by not in DRIVERS:
            raise OptionError(f"driven_by = {driven_by!r}", cure=did_you_mean(driven_by, DRIVERS))
        self.plant = AirHockey()
        self.driven_by = driven_by
        self.place(parameters, mallet)
        if isinstance(robots, str):
            options = {"controller_configs": _controller(robots), **options}
        super().__init__(
            robots=robots,
            has_offscreen_renderer=has_offscreen_renderer,
            use_camera_obs=use_camera_obs,
            **{"initialization_noise": None, **options},
        )

    def place(self, parameters: Mapping[str, float] | None, mallet: np.ndarray | None) -> None:
        """What the next reset makes of the table and the mallet; what is not given is drawn. Raises OptionError."""
        self.plant.space.to_vector(parameters or {})
        self._given = (dict(parameters or {}), mallet)

    @property
    def outputs(self) -> np.ndarray:
        """What the plant's sensors report now, (output,)."""
        return self.sim.data.qpos[self._measured].copy()

    def reward(self, action=None) -> float:
        """That of the task for a puck that stays where it is: 1 at the target, falling with its distance."""
        return float(self.plant.reward(None, self._trajectory())[0])

    def _check_success(self) -> bool:
        return bool(self.plant.success(None, self._trajectory())[0])

    def _trajectory(self) -> np.ndarray:
        return self.plant.observe(self.outputs)[None, None]

    # --- the scene ---

    def initialize_time(self, control_freq):
        super().initialize_time(control_freq)
        self.model_timestep = self.plant.timestep

    def _load_model(self):
        super()._load_model()
        robot = self.robots[0].robot_model
        robot.set_base_xpos(robot.base_xpos_offset["table"](TABLE_SIZE[0]))
        arena = TableArena(table_full_size=TABLE_SIZE, table_offset=(0, 0, TABLE_TOP))
        arena.set_origin([0, 0, 0])
        plant = MujocoXML(str(MODEL))
        arena.worldbody.append(_rink(plant))
        arena.actuator.extend(plant.actuator)
        arena.sensor.extend(plant.sensor)
        self.model = ManipulationTask(mujoco_arena=arena, mujoco_robots=[robot])
        hand = self.robots[0].gripper[self._arm].correct_naming("eef")
        self.model.equality.append(grip(hand, "mallet"))
        take_options(self.model.root, plant.root)

    def _setup_references(self):
        super()._setup_references()
        model, plant = self.sim.model._model, self.plant.model
        self._measured = [model.joint(c.name).qposadr[0] for c in self.plant.outputs]
        joints = [model.joint(plant.joint(k).name) for k in range(plant.njnt)]
        self._qpos = [j.qposadr[0] for j in joints]
        self._geoms = {k: model.geom(plant.geom(k).name).id for k in range(plant.ngeom)}
        self._servos = [model.actuator(plant.actuator(c.index).name).id for c in self.plant.inputs]

    def _setup_observables(self):
        observables = super()._setup_observables()

        @sensor(modality="object")
        def puck_and_mallet(cache):
            return self.outputs

        observables["puck_and_mallet"] = Observable(
            name="puck_and_mallet", sensor=puck_and_mallet, sampling_rate=self.control_freq
        )
        return observables

    @property
    def _arm(self) -> str:
        return self.robots[0].arms[0]

    # --- an episode ---

    def _reset_internal(self):
        super()._reset_internal()
        named, mallet = self._given
        space, actions = self.plant.space, self.plant.actions
        drawn = space.from_unit(self.rng.random(len(space)))
        action = actions.from_unit(self.rng.random(len(actions)))
        if mallet is not None:
            action[:2] = mallet
        model, data = self.sim.model._model, self.sim.data._data
        self._write(model, space.to_vector(named, default=drawn))
        data.qpos[self._qpos] = self.plant.episodes(action[None]).starts.qpos[0]
        self.mallet_velocity = np.zeros(2)
        mujoco.mj_forward(model, data)
        if self.driven_by == "arm":
            take_hold(self.robots[0], self._arm, model, data, "knob", self._servos)

    def _write(self, model: mujoco.MjModel, parameters: np.ndarray) -> None:
        fields = ModelFields(self.plant.model, 1)
        self.plant.write(fields, parameters[None])
        for name, values in fields.values.items():
            for own, geom in self._geoms.items():
                getattr(model, name)[geom] = values[0, own]

    def _pre_action(self, action, policy_step=False):
        super()._pre_action(action, policy_step)
        self.sim.data.ctrl[self._servos] = self.mallet_velocity

    def arm_action(self, target: np.ndarray) -> np.ndarray:
        """The action that sends the hand to where the mallet is at `target`, (x, y), m.

        For a controller whose first three inputs move the hand by at most `output_max`, as the Panda's own one does.
        """
        controller = self.robots[0].part_controllers[self._arm]
        action = np.zeros(self.action_dim)
        action[:2] = np.clip((target - self.outputs[2:]) / controller.output_max[:2], -1, 1)
        return action


def record(
    parameters: np.ndarray, actions: np.ndarray, rate: float = 100.0
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """What a Panda's log of these strokes would hold, without noise: (time, inputs, outputs) of each, as by `strike`.

    parameters (parameter,), actions (episode, action), in the task's units. rate: Hz, of the arm's commands and of
    the log. Raises OptionError where the scene's steps do not make up that rate.
    """
    plant = AirHockey()
    steps_per_sample = 1 / (rate * plant.timestep)
    if not (steps_per_sample >= 1 and np.isclose(steps_per_sample, round(steps_per_sample))):
        raise OptionError(
            f"rate = {rate:g} Hz, and the scene is stepped every {plant.timestep:g} s",
            cure=f"give {1 / plant.timestep:g} Hz divided by a whole number",
        )
    environment = TableAirHockey(robots="Panda", control_freq=rate, horizon=int(3 * rate), hard_reset=False)
    recordings = []
    for action in actions:
        environment.place(plant.space.to_dict(parameters), action[:2])
        environment.reset()
        recordings.append(strike(environment, action))
    return recordings


def strike(environment: TableAirHockey, action: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Strike once, from a fresh reset: time (step,) s, inputs (step, 2) and outputs (step, output).

    The log's inputs are the velocities that the plant's servos would be given. The arm, whose controller takes
    positions, is sent at every control step where the mallet would be by its end if it obeyed them.
    """
    plant, interval = environment.plant, environment.control_timestep
    tape = plant.episodes(action[None]).inputs[0]
    each = round(interval / plant.timestep)
    steps = (len(tape) - 1) // each
    inputs = np.append(tape[: steps * each].reshape(steps, each, 2).mean(axis=1), tape[-1:], axis=0)
    outputs = np.empty((steps + 1, len(plant.outputs)))
    target = environment.outputs[2:]
    for step, velocity in enumerate(inputs):
        outputs[step] = environment.outputs
        target = target + interval * velocity
        environment.step(environment.arm_action(target))
    return interval * np.arange(steps + 1), inputs, outputs


def gymnasium_environment(render_mode: str | None = None, **options) -> GymnasiumEnvironment:
    """The environment behind gymnasium's interface; options are those of `TableAirHockey`."""
    options = {"robots": "Panda", "has_offscreen_renderer": render_mode is not None, **options}
    return GymnasiumEnvironment(TableAirHockey(**options), render_mode)


gymnasium.register("capture/TableAirHockey-v0", entry_point=gymnasium_environment)


# --- parts of the scene ---


def _rink(plant: MujocoXML) -> ElementTree.Element:
    """Everything of the plant in one body that stands on the table, and a knob to hold the mallet by."""
    rink = ElementTree.Element(
        "body", name="rink", pos=" ".join(str(x + y) for x, y in zip(RINK, (0, 0, TABLE_TOP), strict=True))
    )
    for part in plant.worldbody:
        if part.tag in ("geom", "body"):
            rink.append(part)
    mallet = rink.find("body[@name='mallet']")
    ElementTree.SubElement(mallet, "site", name="knob", pos="0 0 0.035", size="0.004", rgba="0 0 0 0")
    return rink


def _controller(robot: str) -> dict:
    """The robot's own controller; only how far one action may send the hand is more."""
    config = load_composite_controller_config(robot=robot)
    for part in config["body_parts"].values():
        if "output_max" in part:
            part["output_max"] = [REACH] * 3 + part["output_max"][3:]
            part["output_min"] = [-REACH] * 3 + part["output_min"][3:]
    return config
