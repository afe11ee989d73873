"""A force that repeats: along time, or along a joint's position, by itself or as a share of a motor's."""

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.model.effects._joint_force import JointForce
from capture_cli.model.effects._kernel import inputs
from capture_cli.model.parameters import Parameter


@frozen
class SETTINGS:
    fastest: float = 20.0  # Hz
    peaks: float = 2.0  # shapes per width of a peak: over a span T the peaks of a spectrum are 1 / T wide
    # Of the range, in finite differences: a longer step turns the phase by radians, at the far end of a log or
    # of a travel
    shape_step: float = 1e-6
    # to a turn: teeth of a worm wheel; finer ones cost every log as many more shapes that may fit by chance
    finest: int = 150


def wave(qpos, *, sine, cosine, period):
    """sine sin(2 pi q / period) + cosine cos(2 pi q / period)."""
    phase = 2 * np.pi * qpos / period
    return sine * np.sin(phase) + cosine * np.cos(phase)


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
        return max(1 / SETTINGS.fastest, 10 * float(self.model.opt.timestep))

    def sweep(self, span: float, most: int) -> np.ndarray:
        """Points (point, parameter) with null amplitudes, the shape so dense that no peak falls between two.

        span: from the first to the last value of what it repeats along. No more than `most` points.
        """
        space, column = self.space, self.space.names.index(self.shapes[0])
        low, high = sorted(self.frequency(np.array([space.low[column], space.high[column]])))
        count = int(np.clip(np.ceil(SETTINGS.peaks * span * (high - low)) + 1, 2, most))
        points = np.repeat(space.nominal[None], count, axis=0)
        points[:, column] = np.clip(
            self.frequency(np.linspace(low, high, count)), space.low[column], space.high[column]
        )
        return points

    def recording(self, first: np.ndarray) -> np.ndarray:
        """Numbers (window,) of windows that begin at the steps `first` of the log: alike where the phase goes on from
        one to the other.
        """
        return np.zeros(len(first), dtype=int)

    def apart(self, first: np.ndarray) -> np.ndarray:
        """Which windows that begin at the steps `first` have amplitudes of their own, (recording, window);
        of no recording where one phase holds in the whole log.
        """
        return np.zeros((0, len(first)), dtype=bool)

    def began(self, first: np.ndarray) -> np.ndarray | float:
        """s, by the clock of simulations, (window,): when a path along time begins for these windows."""
        return 0.0

    def carrier(self, actuator_force: np.ndarray) -> np.ndarray:
        """What the kernel is multiplied by, (...), where actuators give actuator_force (..., actuator): 1."""
        return np.ones(actuator_force.shape[:-1])

    def waves(self, points: np.ndarray, path: np.ndarray) -> np.ndarray:
        """The kernel per unit of each amplitude along `path` (...), for `points` (point, parameter) of a sweep: (point,
        2, ...), sine and cosine.
        """
        frequency = self.frequency(points[:, self.space.names.index(self.shapes[0])])
        turned = _turned(frequency[0], np.ptp(frequency) / max(len(points) - 1, 1), len(points), path)
        return np.stack([turned.imag, turned.real], axis=1)


def _turned(first: float, apart: float, count: int, path: np.ndarray) -> np.ndarray:
    """e^(2 pi i f path), (count, ...), for `count` frequencies f from `first` on, each so far `apart` from the next.

    Each half is the other one turned: thousands of sines of one path, at the price of a few.
    """
    turned = np.empty((count, *path.shape), dtype=complex)
    turned[0] = np.exp(2j * np.pi * first * path)
    step, done = np.exp(2j * np.pi * apart * path), 1
    while done < count:
        more = min(done, count - done)
        np.multiply(turned[:more], step, out=turned[done : done + more])
        step, done = step * step, done + more
    return turned


class AlongPosition(PeriodicForce):
    """One that repeats with the joint's position, every `period` (m or rad)."""

    shapes = ("period",)
    kernel = staticmethod(wave)

    @staticmethod
    def frequency(shape):
        return 1 / shape

    @property
    def period(self) -> Parameter:
        """Of a turn at most, or of the travel of a slide."""
        full = 2 * np.pi if self.is_hinge else 2 * self.travel
        return Parameter(
            "period", self.unit("m", "rad"), full / SETTINGS.finest, full, full / 6, SETTINGS.shape_step
        )
