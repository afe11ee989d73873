"""Table air hockey as a robosuite environment: table, puck, and a Panda that holds the mallet (paper, Figure 3).

    robosuite.make("TableAirHockey", robots="Panda", parameters={"left_friction": 0.03})
    gymnasium.make("capture/TableAirHockey-v0", robots="Panda")

Importing this module registers both. The model of the plant, `capture_cli/model/tasks/air_hockey.xml`, is part of
the scene as it stands, and stepped with its options, so that a mallet with the same motion strikes the puck
in the same way.
"""

# patches robosuite, and says so where it is missing: before anything of it is imported
from capture_cli.context.worlds import _robosuite  # noqa: F401

# isort: split
from collections.abc import Mapping

import gymnasium
import numpy as np

from capture_cli.context.worlds._pushed import PushedScene
from capture_cli.model.tasks.air_hockey import AirHockey


class TableAirHockey(PushedScene):
    """One robot strikes a puck on a table whose friction and restitution it does not see.

    parameters: of the task, by name; mallet: (x, y), m, of its start. None of them, or those not named, are drawn at
    every reset. The robot holds the mallet at reset, and its action moves it from there. driven_by: "arm", or
    "servos": the mallet is let go of and moves at `tool_velocity` (2,), m/s, as in the plant. Other arguments are
    robosuite's. Raises OptionError.
    """

    tool, handle, observed = "mallet", "knob", "puck_and_mallet"
    body, origin, held_at = "rink", (0.12, 0.0, 0.05), (0.0, 0.0, 0.035)

    def __init__(
        self,
        robots,
        parameters: Mapping[str, float] | None = None,
        mallet: np.ndarray | None = None,
        driven_by: str = "arm",
        **options,
    ):
        super().__init__(AirHockey(), robots, parameters, mallet, driven_by, **options)


MACHINE = TableAirHockey
gymnasium.register("capture/TableAirHockey-v0", entry_point=TableAirHockey.behind_gymnasium)
