"""What scenes have in common whose tool strikes or pushes: it moves in the plane, at the velocities of an action."""

# patches robosuite, and says so where it is missing: before anything of it is imported
from capture_cli.context.worlds import _robosuite  # noqa: F401

# isort: split
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from robosuite.controllers import load_composite_controller_config
from robosuite.models.base import MujocoXML

from capture_cli.context.worlds._scene import SETTINGS as SCENE
from capture_cli.context.worlds._scene import Played, Scene, check_rate
from capture_cli.model.fields import ModelFields
from capture_cli.model.tasks.base import ActionTask


class PushedScene(Scene):
    """A scene of `plant`, whose inputs are the tool's velocities along x and y, m/s, and last outputs its x and y, m.

    parameters: of the task, by name; begin: the first components of an action, which say where the tool begins. None
    of them, or those not named, are drawn at every reset. driven_by, and other arguments: of Scene; servos move the
    tool at `tool_velocity` (2,), m/s. Raises OptionError.

    body: the name of what the plant stands in; origin: m, of the plant's from the middle of the table's top; held_at:
    m, from the tool's middle, where the robot holds it.
    """

    table_size = (1.0, 0.8, 0.05)  # m
    body: str
    origin: tuple[float, float, float]
    held_at: tuple[float, float, float]

    def __init__(
        self,
        plant: ActionTask,
        robots,
        parameters: Mapping[str, float] | None,
        begin: Sequence[float] | None,
        driven_by: str,
        **options,
    ):
        self.plant = plant
        self.place(parameters, begin)
        if isinstance(robots, str):
            options = {"controller_configs": _controller(robots), **options}
        super().__init__(robots, driven_by, **options)

    def place(self, parameters: Mapping[str, float] | None, begin: Sequence[float] | None) -> None:
        """What the next reset makes of the plant and its tool; what is not given is drawn. Raises OptionError."""
        self.plant.space.to_vector(parameters or {})
        self._given = (dict(parameters or {}), () if begin is None else begin)

    @property
    def servo_commands(self) -> np.ndarray:
        """The tool's velocity, (2,), m/s."""
        return self.tool_velocity

    @property
    def tool_position(self) -> np.ndarray:
        """Where the tool is, (x, y), m."""
        return self.outputs[-2:]

    # --- the scene ---

    def standing(self, plant: MujocoXML) -> ElementTree.Element:
        """The plant in its body, and where its tool is held."""
        middle = (x + y for x, y in zip(self.origin, (0, 0, SCENE.table_top), strict=True))
        body = ElementTree.Element("body", name=self.body, pos=" ".join(map(str, middle)))
        body.extend(part for part in plant.worldbody if part.tag in ("geom", "body"))
        tool = body.find(f"body[@name='{self.tool}']")
        held_at = " ".join(f"{x:g}" for x in self.held_at)
        ElementTree.SubElement(tool, "site", name=self.handle, pos=held_at, size="0.004", rgba="0 0 0 0")
        return body

    def initialize_time(self, control_freq):
        super().initialize_time(control_freq)
        self.model_timestep = self.plant.timestep

    def _setup_references(self):
        super()._setup_references()
        model, plant = self.sim.model._model, self.plant.model
        joints = [model.joint(plant.joint(k).name) for k in range(plant.njnt)]
        self._qpos = [j.qposadr[0] for j in joints]
        self._places = {  # in the scene, of what the plant has
            "geom": [model.geom(plant.geom(k).name).id for k in range(plant.ngeom)],
            "dof": [j.dofadr[0] for j in joints],
        }

    # --- an episode ---

    def _reset_internal(self):
        super()._reset_internal()
        named, begin = self._given
        space, actions = self.plant.space, self.plant.actions
        drawn = space.from_unit(self.rng.random(len(space)))
        action = actions.from_unit(self.rng.random(len(actions)))
        action[: len(begin)] = begin
        model, data = self.sim.model._model, self.sim.data._data
        self._write(model, space.to_vector(named, default=drawn))
        data.qpos[self._qpos] = self.plant.episodes(action[None]).initial.qpos[0]
        self.tool_velocity = np.zeros(2)
        mujoco.mj_forward(model, data)
        self._hold()

    def _write(self, model: mujoco.MjModel, parameters: np.ndarray) -> None:
        fields = ModelFields(self.plant.model, 1)
        self.plant.write(fields, parameters[None])
        for name, values in fields.values.items():
            getattr(model, name)[self._places[name.partition("_")[0]]] = values[0]

    def play(self, parameters, action):
        """The log's inputs are the velocities that the plant's servos would be given. The arm, whose controller takes
        positions, is sent at every control step where the tool would be by its end if it obeyed them.
        """
        check_rate(self.plant.timestep, self.control_freq)
        self.place(self.plant.space.to_dict(parameters), action)
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
        sent = np.cumsum([self.tool_position, *interval * inputs], axis=0)[1:]
        outputs = np.empty((steps + 1, len(plant.outputs)))
        for step, target in enumerate(sent):
            outputs[step] = self.outputs
            self.step(self.arm_action(target))
        return self.played(interval * np.arange(steps + 1), inputs, outputs, sent)

    def arm_action(self, target: np.ndarray) -> np.ndarray:
        """The action that sends the hand to where the tool is at `target`, (x, y), m."""
        return self.hand_sent(np.array([*(target - self.tool_position), 0.0]))


def _controller(robot: str) -> dict:
    """The robot's own controller; only how far one action may send the hand is more."""
    config = load_composite_controller_config(robot=robot)
    reach = 0.15  # m, that one action can send the hand away at most: the stroke is ahead of the arm by less
    for part in config["body_parts"].values():
        if part.get("type") == "OSC_POSE":
            part["output_max"] = [reach] * 3 + part["output_max"][3:]
            part["output_min"] = [-reach] * 3 + part["output_min"][3:]
    return config
