"""A door as a robosuite environment: table, door, and a Panda that holds the finger.

    robosuite.make("PushedDoor", robots="Panda", parameters={"hinge_friction": 0.3})
    gymnasium.make("capture/PushedDoor-v0", robots="Panda")

Importing this module registers both. The model of the plant, `capture_cli/model/tasks/door.xml`, is part of the scene
as it stands, and stepped with its options, so that a finger with the same motion pushes the door in the same way.
"""

from __future__ import annotations

from capture_cli.common.frozen import frozen

# patches robosuite, and says so where it is missing: before anything of it is imported
from capture_cli.context.worlds import _robosuite  # noqa: F401

# isort: split
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping

import gymnasium
from robosuite.models.base import MujocoXML

from capture_cli.context.worlds._pushed import PushedScene
from capture_cli.context.worlds._scene import SETTINGS as SCENE
from capture_cli.model.tasks.door import Door


@frozen
class SETTINGS:
    sill: tuple[float, ...] = (0.12, 0.0, 0.0)  # m, of the plant's origin from the middle of the table's top


class PushedDoor(PushedScene):
    """One robot pushes a door ajar whose hinge it does not see.

    parameters: of the task, by name; finger_y: m, where it begins. None of them, or those not named, are drawn at every
    reset. The robot holds the finger's rod at reset, and its action moves it from there. driven_by: "arm", or "servos":
    the finger is let go of and moves at `tool_velocity` (2,), m/s, as in the plant. Other arguments are robosuite's.
    Raises OptionError.
    """

    tool, handle, observed = "finger", "grip_of_rod", "door_and_finger"
    table_size = (1.0, 0.8, 0.05)  # m

    def __init__(
        self,
        robots,
        parameters: Mapping[str, float] | None = None,
        finger_y: float | None = None,
        driven_by: str = "arm",
        **options,
    ):
        begin = None if finger_y is None else (finger_y,)
        super().__init__(Door(), robots, parameters, begin, driven_by, **options)

    def standing(self, plant: MujocoXML) -> ElementTree.Element:
        """The door in its posts, and where the finger's rod is held."""
        middle = (x + y for x, y in zip(SETTINGS.sill, (0, 0, SCENE.table_top), strict=True))
        sill = ElementTree.Element("body", name="sill", pos=" ".join(map(str, middle)))
        sill.extend(part for part in plant.worldbody if part.tag in ("geom", "body"))
        finger = sill.find("body[@name='finger']")
        ElementTree.SubElement(finger, "site", name=self.handle, pos="-0.2 0 0", size="0.004", rgba="0 0 0 0")
        return sill


MACHINE = PushedDoor
gymnasium_environment = PushedDoor.behind_gymnasium
gymnasium.register("capture/PushedDoor-v0", entry_point=gymnasium_environment)
