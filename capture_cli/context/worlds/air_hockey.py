"""Table air hockey as a robosuite environment: table, puck, and a Panda that holds the mallet (paper, Figure 3).

    robosuite.make("TableAirHockey", robots="Panda", parameters={"left_friction": 0.03})
    gymnasium.make("capture/TableAirHockey-v0", robots="Panda")

Importing this module registers both. The model of the plant, `capture_cli/model/tasks/air_hockey.xml`, is part of
the scene as it stands, and stepped with its options, so that a mallet with the same motion strikes the puck
in the same way.
"""

from __future__ import annotations

from capture_cli.common.frozen import frozen

# patches robosuite, and says so where it is missing: before anything of it is imported
from capture_cli.context.worlds import _robosuite  # noqa: F401

# isort: split
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping

import gymnasium
import mujoco
import numpy as np
from robosuite.controllers import load_composite_controller_config
from robosuite.models.base import MujocoXML

from capture_cli.context.worlds._scene import SETTINGS as SCENE
from capture_cli.context.worlds._scene import Played, Scene, check_rate
from capture_cli.model.fields import ModelFields
from capture_cli.model.tasks.air_hockey import AirHockey


@frozen
class SETTINGS:
    rink: tuple[float, ...] = (0.12, 0.0, 0.05)  # m, of the plant's origin from the middle of the table's top
    # m, that one action can send the hand away at most: the stroke is ahead of the arm by less
    reach: float = 0.15


class TableAirHockey(Scene):
    """One robot strikes a puck on a table whose friction and restitution it does not see.

    parameters: of the task, by name; mallet: (x, y), m, of its start. None of them, or those not named, are drawn at
    every reset. The robot holds the mallet at reset, and its action moves it from there. driven_by: "arm", or
    "servos": the mallet is let go of and moves at `mallet_velocity` (2,), m/s, as in the plant. Other arguments are
    robosuite's. Raises OptionError.
    """

    tool, handle, observed = "mallet", "knob", "puck_and_mallet"
    table_size = (1.0, 0.8, 0.05)  # m

    def __init__(
        self,
        robots,
        parameters: Mapping[str, float] | None = None,
        mallet: np.ndarray | None = None,
        driven_by: str = "arm",
        **options,
    ):
        self.plant = AirHockey()
        self.place(parameters, mallet)
        if isinstance(robots, str):
            options = {"controller_configs": _controller(robots), **options}
        super().__init__(robots, driven_by, **options)

    def place(self, parameters: Mapping[str, float] | None, mallet: np.ndarray | None) -> None:
        """What the next reset makes of the table and the mallet; what is not given is drawn. Raises OptionError."""
        self.plant.space.to_vector(parameters or {})
        self._given = (dict(parameters or {}), mallet)

    @property
    def servo_commands(self) -> np.ndarray:
        """The mallet's velocity, (2,), m/s."""
        return self.mallet_velocity

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

    def standing(self, plant: MujocoXML) -> ElementTree.Element:
        """The rink, and a knob to hold the mallet by."""
        middle = (x + y for x, y in zip(SETTINGS.rink, (0, 0, SCENE.table_top), strict=True))
        rink = ElementTree.Element("body", name="rink", pos=" ".join(map(str, middle)))
        rink.extend(part for part in plant.worldbody if part.tag in ("geom", "body"))
        mallet = rink.find("body[@name='mallet']")
        ElementTree.SubElement(
            mallet, "site", name=self.handle, pos="0 0 0.035", size="0.004", rgba="0 0 0 0"
        )
        return rink

    def _setup_references(self):
        super()._setup_references()
        model, plant = self.sim.model._model, self.plant.model
        joints = [model.joint(plant.joint(k).name) for k in range(plant.njnt)]
        self._qpos = [j.qposadr[0] for j in joints]
        self._geoms = {k: model.geom(plant.geom(k).name).id for k in range(plant.ngeom)}

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
        data.qpos[self._qpos] = self.plant.episodes(action[None]).initial.qpos[0]
        self.mallet_velocity = np.zeros(2)
        mujoco.mj_forward(model, data)
        self._hold()

    def _write(self, model: mujoco.MjModel, parameters: np.ndarray) -> None:
        fields = ModelFields(self.plant.model, 1)
        self.plant.write(fields, parameters[None])
        for name, values in fields.values.items():
            for own, geom in self._geoms.items():
                getattr(model, name)[geom] = values[0, own]

    def play(self, parameters, action):
        """The log's inputs are the velocities that the plant's servos would be given. The arm, whose controller takes
        positions, is sent at every control step where the mallet would be by its end if it obeyed them.
        """
        check_rate(self.plant.timestep, self.control_freq)
        self.place(self.plant.space.to_dict(parameters), action[:2])
        self.reset()
        return self.strike(action)

    def strike(self, action: np.ndarray) -> Played:
        """The same of a scene that was reset to where the action begins."""
        plant, interval = self.plant, self.control_timestep
        sequence = plant.episodes(action[None]).inputs[0]
        each = round(interval / plant.timestep)
        steps = (len(sequence) - 1) // each
        inputs = np.append(
            sequence[: steps * each].reshape(steps, each, 2).mean(axis=1), sequence[-1:], axis=0
        )
        sent = np.cumsum([self.outputs[2:], *interval * inputs], axis=0)[1:]
        outputs = np.empty((steps + 1, len(plant.outputs)))
        for step, target in enumerate(sent):
            outputs[step] = self.outputs
            self.step(self.arm_action(target))
        return self.played(interval * np.arange(steps + 1), inputs, outputs, sent)

    def arm_action(self, target: np.ndarray) -> np.ndarray:
        """The action that sends the hand to where the mallet is at `target`, (x, y), m.

        For a controller whose first three inputs move the hand by at most `output_max`, as the Panda's own one does.
        """
        controller = self.robots[0].part_controllers[self._arm]
        action = np.zeros(self.action_dim)
        action[:2] = np.clip((target - self.outputs[2:]) / controller.output_max[:2], -1, 1)
        return action


MACHINE = TableAirHockey
gymnasium_environment = TableAirHockey.behind_gymnasium
gymnasium.register("capture/TableAirHockey-v0", entry_point=gymnasium_environment)


def _controller(robot: str) -> dict:
    """The robot's own controller; only how far one action may send the hand is more."""
    config = load_composite_controller_config(robot=robot)
    for part in config["body_parts"].values():
        if part.get("type") == "OSC_POSE":
            part["output_max"] = [SETTINGS.reach] * 3 + part["output_max"][3:]
            part["output_min"] = [-SETTINGS.reach] * 3 + part["output_min"][3:]
    return config
