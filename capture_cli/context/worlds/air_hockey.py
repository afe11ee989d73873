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
import numpy as np
from robosuite.models.base import MujocoXML

from capture_cli.context.worlds._pushed import PushedScene
from capture_cli.context.worlds._scene import SETTINGS as SCENE
from capture_cli.model.tasks.air_hockey import AirHockey


@frozen
class SETTINGS:
    rink: tuple[float, ...] = (0.12, 0.0, 0.05)  # m, of the plant's origin from the middle of the table's top


class TableAirHockey(PushedScene):
    """One robot strikes a puck on a table whose friction and restitution it does not see.

    parameters: of the task, by name; mallet: (x, y), m, of its start. None of them, or those not named, are drawn at
    every reset. The robot holds the mallet at reset, and its action moves it from there. driven_by: "arm", or
    "servos": the mallet is let go of and moves at `tool_velocity` (2,), m/s, as in the plant. Other arguments are
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
        super().__init__(AirHockey(), robots, parameters, mallet, driven_by, **options)

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


MACHINE = TableAirHockey
gymnasium_environment = TableAirHockey.behind_gymnasium
gymnasium.register("capture/TableAirHockey-v0", entry_point=gymnasium_environment)
