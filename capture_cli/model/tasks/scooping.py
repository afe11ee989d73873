"""Object scooping: find the point of a rod at which it can be lifted in balance (paper, Section IV-A)."""

import numpy as np

from capture_cli.model.tasks._scooping import SETTINGS as SCOOPING
from capture_cli.model.tasks._scooping import ScoopingPlant
from capture_cli.model.tasks.base import Feature

LIFTED = SCOOPING.lift / 2  # m; a balanced rod rises by all of it, less the way of the tines until they touch


class Scooping(ScoopingPlant):
    """Observed as in the paper: a label of the rod at the end of the lift."""

    name = "scooping"

    def __init__(self):
        super().__init__(("rod_x", "rod_z", "rod_tilt", "spatula_x", "spatula_z"))
        self.features = (Feature("label", "1", 1.0),)
        self.point_times = np.array([SCOOPING.lift_time])

    def observe(self, outputs):
        """-1 where the rod is tilted left (its left end is the lower one), 1 tilted right, 0 lifted in balance.

        A rod that was not lifted is not in balance, however level: it is labelled by the side it leans to.
        """
        height, tilt = outputs[..., 1], outputs[..., 2]
        side = np.where(tilt < 0, -1.0, 1.0)
        # rad. A rod whose centre of mass is 0.047 half-lengths off leans by 0.013; the label changes at 0.0494,
        # just inside the tine's centre (0.05), where the load of one tine alone is enough to lean it.
        tilted = 0.05
        balanced = (np.abs(tilt) <= tilted) & (height >= LIFTED)
        return np.where(balanced, 0.0, side)[..., None]

    def reward(self, actions, trajectories):
        """1 where the rod was lifted in balance, 0 otherwise: a label says no more about how near it was."""
        return self.success(actions, trajectories).astype(float)

    def success(self, actions, trajectories):
        """Whether the rod was lifted in balance."""
        return trajectories[:, -1, 0] == 0
