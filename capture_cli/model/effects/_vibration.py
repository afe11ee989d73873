"""A mass on a spring that is shaken: what a loose mass and a base that gives share."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from copy import copy
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline

from capture_cli.common.frozen import frozen
from capture_cli.model.effects._followed_log import since_stretches_began
from capture_cli.model.effects._joint_force import ForceOfKernel
from capture_cli.model.effects.base import Effect, SeenLog, spread
from capture_cli.model.parameters import Parameter
from capture_cli.model.world import World


@frozen
class SETTINGS:
    # Hz
    slowest: float = 0.3
    fastest: float = 20.0
    # Swings within a window, at least: with how it begins free, less of one imitates any force that changes slowly.
    swings: float = 0.5
    # How much farther it commonly swings, before a window begins, than what pushes it would push it once
    resonates: float = 4.0
    # Of a window: what begins later in a stretch of the log begins as the log before it says.
    first: float = 0.5
    hides: float = 2.0  # times what the noise of the log makes of it: how far off that may be
    # Than the log: straight between its samples a swing of 20 Hz in 100 Hz would be 12 % too small.
    finer: int = 4
    kept: int = 64  # frequencies and damping ratios, the last ones tried, of which it is known how the log shakes them


class Vibration:
    """apart d'' + 2 zeta w d' + w^2 d = -shaken, w = 2 pi frequency, by trapezoidal steps, which damp nothing.

    displaced, moving: d and d' at the start.
    """

    def __init__(self, *, frequency, damping_ratio, timestep, displaced=0.0, moving=0.0):
        self.timestep = timestep
        self.turning = 2 * np.pi * frequency  # w, rad/s
        self.slowing = 2 * damping_ratio * self.turning
        self.displaced, self.rate = displaced + 0.0 * frequency, moving + 0.0 * frequency  # d, d'
        self.change = None  # d''

    def advance(self, shaken, apart=1.0):
        """The mean of d'' over a step."""
        h = self.timestep
        if self.change is None:
            self.change = -(shaken + self.turning**2 * self.displaced + self.slowing * self.rate) / apart
        pulled = self.turning**2 * (self.displaced + h * self.rate + h * h / 4 * self.change)
        pulled = pulled + self.slowing * (self.rate + h / 2 * self.change)
        resists = apart + self.slowing * h / 2 + (self.turning * h) ** 2 / 4
        now = -(shaken + pulled) / resists
        mean = (self.change + now) / 2
        self.displaced = self.displaced + h * self.rate + h * h / 2 * mean
        self.rate, self.change = self.rate + h * mean, now
        return mean


class VibrationEffect(Effect):
    """An effect of something that swings. Its parameters are how much does, the frequency and the damping ratio.

    With x what shakes it, `share` of it, d'' + 2 zeta w d' + w^2 d = -share x''. With states that are free in every
    window it may stand in for any force that changes slowly. Where it is `shaken`, a window begins as x made it swing
    since the stretch of the log began.
    """

    shapes = ("frequency", "damping_ratio")
    vague_at_end = ("frequency",)
    states = ("displaced", "moving")
    states_mean = (
        "`displaced`, `moving`: how far (m or rad) and how fast (m/s or rad/s; its `rate`) what swings is from where "
        "it rests. At 1 what an acceleration of the base (5 m/s^2 times `mobility`), or of the joint by its greatest "
        "common force, comes to at resonance: 4 times it over w^2, and over w, with w = 2 pi `frequency`"
    )
    shaken: Shaken | None = None
    seen_log: SeenLog | None = None

    @property
    def swinging(self) -> tuple[Parameter, Parameter]:
        """The frequency and the damping ratio."""
        slowest = float(
            np.clip(SETTINGS.swings / (self.window or np.inf), SETTINGS.slowest, SETTINGS.fastest / 4)
        )
        return (
            Parameter("frequency", "Hz", slowest, SETTINGS.fastest, max(2 * slowest, 2.0)),
            Parameter("damping_ratio", "1", 0.002, 0.7, 0.05),
        )

    def shape_grid(self, count=5):
        # resonances are narrow, and how narrow shows once the frequency is right
        grid = np.repeat(self.space.nominal[None], 2 * count, axis=0)
        grid[:, 1] = spread(self.parameters[1], 2 * count)
        return grid

    def doubt(self, values, duration):
        if values[1] * duration >= 1:
            return None
        return f"it swings once in {1 / values[1]:.3g} s, and no episode lasts longer than {duration:.3g} s"

    def look_in(self, log):
        super().look_in(log)
        self.seen_log = log

    def as_told(self):
        shaken = None if self.seen_log is None else self.shaken_in(self.seen_log)
        if shaken is None:
            return None
        own = copy(self)
        own.shaken = shaken
        return own

    @abstractmethod
    def shaken_in(self, log: SeenLog) -> Shaken | None:
        """How x was in the log; None where that does not measure it."""

    @abstractmethod
    def shaking(self, world: World) -> tuple[np.ndarray, np.ndarray]:
        """x and x' where simulations are now, (simulation,) each."""

    def share(self, values: np.ndarray) -> np.ndarray | float:
        """Of x, by which it is shaken, (simulation,); values (simulation, parameter)."""
        return 1.0

    def begins(
        self,
        values: np.ndarray,
        states: np.ndarray | None,
        push: np.ndarray | float,
        *,
        timestep: float,
        first: np.ndarray | None,
    ) -> dict[str, np.ndarray]:
        """How it begins, (simulation,) each, at `states`; push: its usual accelerations, m/s^2 or rad/s^2.

        first: as of `force`. What the log tells is off by no more than what its noise makes of it, but in the first
        window of a stretch; `after` and `following` are x + d and x' + d' with a share of 1.
        """
        states = np.zeros((len(values), len(self.states))) if states is None else states
        turning, share = 2 * np.pi * values[:, 1], self.share(values)
        far = SETTINGS.resonates * push / turning**2
        if self.shaken is None or first is None:
            return {"displaced": far * states[:, 0], "moving": far * turning * states[:, 1]}
        unknown = self.shaken.elapsed[first] < SETTINGS.first * self.window
        far = np.where(unknown, far, share * self.shaken.error(values[:, 1], values[:, 2], first))
        after, following = self.shaken.after(values[:, 1], values[:, 2], first, timestep)
        begins = {"displaced": far * states[:, 0], "moving": far * turning * states[:, 1]}
        return begins | {"after": after, "following": following, "share": share + 0.0 * after}


class ForceShakenBefore(ForceOfKernel):
    """The force of something that swings: where the log says how it was shaken it begins so far from where x is now."""

    def own(self, world):
        own = super().own(world)
        if "after" in own:
            share, after, following = (own.pop(name) for name in ("share", "after", "following"))
            x, speed = self.effect.shaking(world)
            own["displaced"] = own["displaced"] + share * (after - x)
            own["moving"] = own["moving"] + share * (following - speed)
        return own


class Shaken:
    """What swings after a path x of the log at its difference: x + d at every step of the log, and x' + d'.

    time, path (step,): of the log, s, and m or rad; nan where it was not measured. stretches: of its steps; noise: of
    the path, standard deviation. begun, begun_sd (stretch,): x' where a stretch was first measured, and how well that
    is known; between two noisy samples it is not. elapsed (step,): s, since the stretch began.
    """

    def __init__(
        self,
        time: np.ndarray,
        path: np.ndarray,
        stretches: Sequence[slice],
        noise: float,
        begun: np.ndarray,
        begun_sd: np.ndarray,
    ):
        self._time, self._path, self._stretches, self._noise = time, path, stretches, noise
        self._begun, self._begun_sd = begun, np.zeros(len(time))
        for steps, sd in zip(stretches, begun_sd, strict=True):
            self._begun_sd[steps] = sd
        self._interval = float(np.median(np.diff(time)))
        self.elapsed = since_stretches_began(time, stretches)
        self._swings = lru_cache(maxsize=SETTINGS.kept)(self._swinging)

    def error(self, frequency: np.ndarray, damping_ratio: np.ndarray, first: np.ndarray) -> np.ndarray:
        """m or rad: how far off x + d may be at the steps `first` of the log for the noise of the path, (simulation,)
        each.

        A path with white noise of density S shakes x + d by a variance of S w / (4 zeta): S is the noise's variance
        times the interval between samples. What x' is off where the stretch begins swings freely from there on.
        """
        turning = 2 * np.pi * frequency
        gathered = turning * self._interval / (4 * damping_ratio)
        left = np.exp(-damping_ratio * turning * self.elapsed[first])
        begun = self._begun_sd[first] * left / turning
        return SETTINGS.hides * np.hypot(self._noise * np.sqrt(gathered + 1.0), begun)

    def after(
        self, frequency: np.ndarray, damping_ratio: np.ndarray, first: np.ndarray, timestep: float
    ) -> np.ndarray:
        """x + d and x' + d' at the steps `first` of the log, (2, simulation); the others (simulation,), too."""
        found = np.zeros((2, len(first)))
        pairs, which = np.unique(np.stack([frequency, damping_ratio]), axis=1, return_inverse=True)
        for number, (own, ratio) in enumerate(pairs.T):
            rows = which.ravel() == number
            found[:, rows] = self._swings(float(own), float(ratio), timestep)[:, first[rows]]
        return found

    def _swinging(self, frequency: float, damping_ratio: float, timestep: float) -> np.ndarray:
        """(2, step), where d is of the frequency that steps of the trapezoidal rule give it."""
        found = np.zeros((2, len(self._path)))
        turning = 2 / timestep * np.arctan(np.pi * frequency * timestep)
        for steps, begun in zip(self._stretches, self._begun, strict=True):
            time, path = self._time[steps], self._path[steps]
            measured = np.isfinite(path)
            if measured.sum() < 2:
                continue
            begins, ends = time[measured][[0, -1]]
            even = np.linspace(begins, time[-1], SETTINGS.finer * len(time))
            x = CubicSpline(time[measured], path[measured])(np.minimum(even, ends))
            swings = swings_after(even, x, turning, damping_ratio, float(begun))
            found[:, steps] = [np.interp(time, even, own) for own in swings]
        return found


def swings_after(
    time: np.ndarray, path: np.ndarray, turning: float, damping_ratio: float, begun: float
) -> tuple[np.ndarray, np.ndarray]:
    """x + d and x' + d', (step,) each, of d'' + 2 zeta w d' + w^2 d = -x'', d = d' = 0 at first, along x = `path`.

    turning: w, rad/s. begun: x' at first, per s. Exact where x moves steadily between steps, which are even: x' then
    jumps at each, and d' by as much the other way, and the rest is free vibration.
    """
    from scipy.signal import lfilter  # loads for 0.4 s, and few commands come here

    step = float(time[1] - time[0])
    speed = np.diff(path) / step
    speed = np.append(speed, speed[-1])
    jumps = -np.diff(speed, prepend=begun)
    slowing = damping_ratio * turning
    swung = np.sqrt(turning**2 - slowing**2)
    left, angle = np.exp(-slowing * step), swung * step
    poles = [1.0, -2 * left * np.cos(angle), left**2]
    displaced = lfilter([0.0, left * np.sin(angle) / swung], poles, jumps)
    moving = lfilter([1.0, -left * (np.cos(angle) + slowing / swung * np.sin(angle))], poles, jumps)
    return path + displaced, speed + moving
