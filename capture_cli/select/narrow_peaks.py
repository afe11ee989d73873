"""At which values of a shape with narrow peaks is an effect worth simulating? All are judged, the best are chosen."""

from collections.abc import Iterable
from functools import cached_property

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.fit import Fit
from capture_cli.estimate.model_fits import ModelFits
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.model.effects._periodic_force import PeriodicForce
from capture_cli.model.effects.base import Effect
from capture_cli.model.effects.placed import Placed
from capture_cli.select.pulses import NAME, PulseResponse, Pulses
from capture_cli.simulate.engine import Rollouts


@frozen
class SETTINGS:
    peaks: int = 3  # values that are simulated
    # values that are judged: in a log of over 400 s the peaks of fast forces can fall between them
    most: int = 16384
    pulse: float = 0.1  # of the joint's characteristic force
    samples: int = 4  # of a force in each pulse
    at_once: int = 1 << 24  # numbers in memory


class NarrowPeaks:
    """For effects that repeat along time or position, on one part of the log, at one fit to it."""

    def __init__(self, fits: ModelFits, part: PreparedLog, fit: Fit):
        self.fits, self.part, self.fit = fits, part, fit
        self._responses: dict[str, tuple[Pulses, PulseResponse]] = {}

    def respond_to(self, effects: Iterable[Effect]) -> None:
        """Simulate now what `points` of those of the effects that have narrow peaks will ask for."""
        for effect in effects:
            if effect.narrow_shape:
                self._response(effect)
                self._path(effect)

    def points(self, effect: PeriodicForce) -> tuple[np.ndarray, int]:
        """Points (point, parameter) with null amplitudes at the best values of the shape, and how many were judged."""
        pulses, response = self._response(effect)
        path = self._path(effect)
        recording = effect.recording(self.part.windows.first)
        span = max(float(np.ptp(path[recording == n])) for n in np.unique(recording))
        points = effect.sweep(span, SETTINGS.most)
        rest = effect.shape_grid()
        if (
            effect.along == "time"
        ):  # of what is too fast for the pulses a few values are simulated, as they are
            column = effect.space.names.index(effect.shapes[0])
            rest = rest[rest[:, column] > pulses.fastest]
            points = points[points[:, column] <= pulses.fastest]
        else:
            rest = rest[:0]
        if not len(points):
            return rest, len(rest)
        gains = self._gains(effect, points, path, pulses, response)
        doubted = np.array([self.doubts(effect, p) for p in points])
        best = _peaks(np.where(doubted & ~doubted.all(), -np.inf, gains), SETTINGS.peaks)
        return np.concatenate([points[best], rest]), len(points) + len(rest)

    def doubts(self, effect: Effect, values: np.ndarray) -> bool:
        """Whether the log's episodes are too short to believe an effect of these values (parameter,)."""
        return effect.doubt(values, self._longest) is not None

    def _gains(self, effect, points, path, pulses: Pulses, response: PulseResponse) -> np.ndarray:
        every = max(1, pulses.spacing // SETTINGS.samples)
        steps = np.arange(0, path.shape[1], every)
        to_pulses = np.linalg.pinv(pulses.shares(steps))  # (pulse, step)
        carrier = effect.carrier(self._motion.actuator_force[:, steps])
        some = max(1, SETTINGS.at_once // (2 * path[:, steps].size))
        recording = effect.recording(self.part.windows.first)
        gains = [
            response.gains(
                (carrier * effect.waves(points[first : first + some], path[:, steps])) @ to_pulses.T,
                recording,
            )
            for first in range(0, len(points), some)
        ]
        return np.nan_to_num(np.concatenate(gains))  # no number where a simulation went astray

    def _response(self, effect: PeriodicForce) -> tuple[Pulses, PulseResponse]:
        if effect.joint_name not in self._responses:
            model = self.fits.prepared.task.model
            steps = int(self.part.windows.grid_steps.max())
            pulses = Pulses.over(model, effect.joint_name, steps, effect.shortest_period)
            size = SETTINGS.pulse * pulses.characteristic_force
            placed = Placed(NAME, pulses)
            residual, diverged = self.fits.probe(self.part, self.fit, placed, size * np.eye(pulses.count))
            change = (self.fit.at.residual - residual) * ~diverged[:, None, None] / size
            response = PulseResponse.of(self.fit.at, np.moveaxis(change, 0, -1))
            self._responses[effect.joint_name] = (pulses, response)
        return self._responses[effect.joint_name]

    def _path(self, effect: PeriodicForce) -> np.ndarray:
        """What the effect repeats along, in every window on the model's grid, (window, grid)."""
        if effect.along == "time":
            windows = self.part.windows
            since = windows.time - effect.began(windows.first)
            return since[:, None] + windows.timestep * np.arange(windows.grid_steps.max())
        return self._motion.qpos[..., effect.model.jnt_qposadr[effect.joint]]

    @cached_property
    def _motion(self) -> Rollouts:
        return self.fits.motion(self.part, self.fit)

    @cached_property
    def _longest(self) -> float:
        return self.fits.prepared.log.longest


def _peaks(gains: np.ndarray, most: int) -> np.ndarray:
    """The largest local maxima of gains (point,), best first; -inf is none."""
    higher = np.concatenate([[-np.inf], gains, [-np.inf]])
    maxima = np.flatnonzero((gains >= higher[:-2]) & (gains > higher[2:]))
    return maxima[np.argsort(-gains[maxima], kind="stable")][:most]
