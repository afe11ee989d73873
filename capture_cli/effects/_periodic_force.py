"""A force that repeats: along time, or along a joint's position."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._joint_force import JointForce
from capture_cli.effects._kernel import inputs

FASTEST = 20.0  # Hz
PEAKS = 2.0  # shapes per width of a peak: over a span T the peaks of a spectrum are 1 / T wide
# Of the range, in finite differences: a longer step turns the phase by radians, at the far end of a log or of a travel
SHAPE_STEP = 1e-6


class PeriodicForce(JointForce):
    """A joint force with the amplitudes `sine` and `cosine` and one shape, which its kernel makes of the
    one input that it repeats along.
    """

    narrow_shape = True

    @property
    def along(self) -> str:
        """What it repeats along: a field of MjData, "time" or "qpos"."""
        return inputs(self.kernel)[0]

    @staticmethod
    def frequency(shape: np.ndarray) -> np.ndarray:
        """Cycles per s, m or rad of values of the shape; its own inverse."""
        return shape

    @property
    def shortest_period(self) -> float:
        """s: of the fastest force worth looking for."""
        return max(1 / FASTEST, 10 * float(self.model.opt.timestep))

    def sweep(self, span: float, most: int) -> np.ndarray:
        """Points (point, parameter) with null amplitudes, the shape so dense that no peak falls between two.

        span: from the first to the last value of what it repeats along. No more than `most` points.
        """
        space, column = self.space, self.space.names.index(self.shapes[0])
        low, high = sorted(self.frequency(np.array([space.low[column], space.high[column]])))
        count = int(np.clip(np.ceil(PEAKS * span * (high - low)) + 1, 2, most))
        points = np.repeat(space.nominal[None], count, axis=0)
        points[:, column] = np.clip(
            self.frequency(np.linspace(low, high, count)), space.low[column], space.high[column]
        )
        return points

    def forces(self, points: np.ndarray, path: np.ndarray) -> np.ndarray:
        """The force per unit of each amplitude along `path` (...), for points (point, parameter): (point, ..., 2)."""
        shape = points[:, self.space.names.index(self.shapes[0])].reshape(-1, *(1,) * path.ndim)
        units = ({"sine": 1.0, "cosine": 0.0}, {"sine": 0.0, "cosine": 1.0})
        return np.stack([self.kernel(path, **unit, **{self.shapes[0]: shape}) for unit in units], axis=-1)
