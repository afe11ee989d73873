"""Object scooping, observed as a distance: not monotonic in the parameter (paper, Appendix)."""

import numpy as np

from capture_cli.model.tasks._scooping import SETTINGS as SCOOPING
from capture_cli.model.tasks._scooping import ScoopingPlant
from capture_cli.model.tasks.base import Feature


class ScoopingDistance(ScoopingPlant):
    """Observed as the distance of the scoop point from the centre of mass, whichever side it is on."""

    name = "scooping-distance"

    def __init__(self):
        super().__init__(("rod_x", "rod_z", "rod_tilt", "spatula_x", "spatula_z", "rod_com"))
        self.features = (Feature("distance", "1", 1.0),)
        touch_time = 0.06  # s, when the tines touch the rod and before anything tips
        self.point_times = np.array([touch_time])

    def observe(self, outputs):
        """Distance in half-lengths, as the tines touch the rod."""
        return np.abs(outputs[..., 5:6] - outputs[..., 3:4]) / SCOOPING.half_length

    def reward(self, actions, trajectories):
        """1 where the rod would be lifted in balance, and less the farther the scoop point is from it."""
        return np.where(self.success(actions, trajectories), 1.0, -trajectories[:, -1, 0])

    def success(self, actions, trajectories):
        """Whether the centre of mass is between the tines, so that the rod would be lifted in balance."""
        in_balance = 0.05  # half-lengths: as far as the tines are from the scoop point
        return trajectories[:, -1, 0] <= in_balance
