"""Object scooping as a robosuite environment: table, rack, rod, and a Panda that holds the spatula (paper, Figure 3).

    robosuite.make("ObjectScooping", robots="Panda", com=0.3, scoop_point=0.25)
    gymnasium.make("capture/ObjectScooping-v0", robots="Panda")

Importing this module registers both. The model of the plant, `capture_cli/model/tasks/scooping.xml`, is part of the
scene as it stands, and stepped with its options, so that a spatula with the same motion lifts the rod in the same way.
"""

# patches robosuite, and says so where it is missing: before anything of it is imported
from capture_cli.context.worlds import _robosuite  # noqa: F401

# isort: split
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
from robosuite.models.base import MujocoXML

from capture_cli.context.worlds._scene import SETTINGS as SCENE_SETTINGS
from capture_cli.context.worlds._scene import Played, Scene, check_rate
from capture_cli.model.tasks._scooping import SETTINGS as SCOOPING
from capture_cli.model.tasks._scooping import lift_height
from capture_cli.model.tasks.scooping import Scooping

SCENE = Path(__file__).with_name("scooping_scene.xml")


# The plant's x axis points to the right of a robot that faces the table, its y axis away from it.
RACK_TURN = "0.70710678118654757 0 0 -0.70710678118654757"


class ObjectScooping(Scene):
    """One robot lifts a rod whose centre of mass it does not see; success is that the rod is lifted in balance.

    com, scoop_point: in half-lengths of the rod, as the task's parameter and action; None draws one at every reset.
    The robot holds the spatula under the scoop point at reset, and its action moves it from there.
    driven_by: "arm", or "servos": the spatula is let go of and follows `spatula_target` (2,), m, as in the plant.
    Other arguments are robosuite's. Raises OptionError.
    """

    tool, handle, observed = "spatula", "handle", "rod_and_spatula"
    table_size = (0.8, 0.8, 0.05)  # m

    def __init__(
        self,
        robots,
        com: float | None = None,
        scoop_point: float | None = None,
        driven_by: str = "arm",
        **options,
    ):
        self.plant = Scooping()
        self.place(com, scoop_point)
        super().__init__(robots, driven_by, **options)

    def place(self, com: float | None, scoop_point: float | None) -> None:
        """What the next reset makes of the rod and the spatula; None draws it."""
        self._given = (com, scoop_point)

    @property
    def servo_commands(self) -> np.ndarray:
        """Where the spatula is sent, (2,), m."""
        return self.spatula_target

    @property
    def label(self) -> float:
        """-1 tilted left, 0 lifted in balance, 1 tilted right: the task's observation of the rod as it is now."""
        return float(self.plant.observe(self.outputs)[0])

    def standing(self, plant: MujocoXML) -> ElementTree.Element:
        """The rack with rod and spatula, and what the scene has of them beyond the plant."""
        rack_height = 0.12  # m, of the rod's underside above the table
        rack = ElementTree.Element(
            "body", name="rack", pos=f"0 0 {SCENE_SETTINGS.table_top + rack_height}", quat=RACK_TURN
        )
        scene = MujocoXML(str(SCENE))
        for body in plant.worldbody.findall("body"):
            beyond = scene.worldbody.find(f"body[@name='{body.get('name')}']")
            body.extend(beyond if beyond is not None else [])
            rack.append(body)
        return rack

    # --- an episode ---

    def _reset_internal(self):
        super()._reset_internal()
        com, scoop_point = (self.rng.uniform(-1, 1) if v is None else v for v in self._given)
        model, data = self.sim.model._model, self.sim.data._data
        model.body("rod").ipos[0] = SCOOPING.half_length * com
        mujoco.mj_setConst(model, mujoco.MjData(model))
        data.qpos[self._measured] = self.plant.episodes(np.array([[scoop_point]])).initial.qpos[0]
        self.spatula_target = self.outputs[3:]
        mujoco.mj_forward(model, data)
        self._hold()

    def play(self, parameters, action):
        """The arm is sent, at every control step, where the plant's servos would be sent: the log's inputs."""
        check_rate(self.plant.timestep, self.control_freq)
        self.place(float(parameters[0]), float(action[0]))
        self.reset()
        return self.lift()

    def lift(self) -> Played:
        """The same of a scene that was reset."""
        plant, interval = self.plant, self.control_timestep
        steps = round(plant.point_times[-1] / interval) + 1
        time = interval * np.arange(steps)
        inputs = np.stack([np.full(steps, self.outputs[3]), lift_height(time)], axis=1)
        outputs = np.empty((steps, len(plant.outputs)))
        outputs[0] = self.outputs
        for step in range(1, steps):
            self.step(self.arm_action(inputs[step - 1]))
            outputs[step] = self.outputs
        return self.played(time, inputs, outputs, inputs)

    def arm_action(self, target: np.ndarray) -> np.ndarray:
        """The action that sends the hand to where the spatula is at `target`, (x, z) in the plant's axes, m."""
        x, z = target - self.outputs[3:]
        return self.hand_sent(np.array([0.0, -x, z]))


MACHINE = ObjectScooping
gymnasium.register("capture/ObjectScooping-v0", entry_point=ObjectScooping.behind_gymnasium)
