"""A door as a robosuite environment: table, door, and a Panda that holds the finger.

    robosuite.make("PushedDoor", robots="Panda", parameters={"hinge_friction": 0.3})
    gymnasium.make("capture/PushedDoor-v0", robots="Panda")

Importing this module registers both. The model of the plant, `capture_cli/model/tasks/door.xml`, is part of the scene
as it stands, and stepped with its options, so that a finger with the same motion pushes the door in the same way.
"""

# patches robosuite, and says so where it is missing: before anything of it is imported
from capture_cli.context.worlds import _robosuite  # noqa: F401

# isort: split
from collections.abc import Mapping

import gymnasium

from capture_cli.context.worlds._pushed import PushedScene
from capture_cli.model.tasks.door import Door


class PushedDoor(PushedScene):
    """One robot pushes a door ajar whose hinge it does not see.

    parameters: of the task, by name; finger_y: m, where it begins. None of them, or those not named, are drawn at every
    reset. The robot holds the finger's rod at reset, and its action moves it from there. driven_by: "arm", or "servos":
    the finger is let go of and moves at `tool_velocity` (2,), m/s, as in the plant. Other arguments are robosuite's.
    Raises OptionError.
    """

    tool, handle, observed = "finger", "grip_of_rod", "door_and_finger"
    body, origin, held_at = "sill", (0.12, 0.0, 0.0), (-0.2, 0.0, 0.0)

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


MACHINE = PushedDoor
gymnasium.register("capture/PushedDoor-v0", entry_point=PushedDoor.behind_gymnasium)
