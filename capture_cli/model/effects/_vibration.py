"""A mass on a spring that is shaken: what a loose mass and a base that gives share."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.interpolate import CubicSpline

from capture_cli.common.frozen import frozen
from capture_cli.common.recursive_filter import recursively_filtered
from capture_cli.model.effects._followed_log import at_steps, since_stretches_began, steps_later
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
    # How far off the swing may be that the log tells: times what its noise makes of that, and of how far it commonly
    # swings. Sensors report late, filter or bend the path.
    hides: float = 2.0
    vague: float = 0.1
    eased: float = 1.0  # `vague` where a descent begins: the valley of a resonance is narrow
    # Than the log: straight between its samples a swing of 20 Hz in 100 Hz would be 12 % too small.
    finer: int = 4
    kept: int = 16  # frequencies and damping ratios, the last ones tried, of which it is known how the log shakes them


class Vibration:
    """d'' + p = -shaken, p = 2 zeta w d' + w^2 d, w = 2 pi frequency, by trapezoidal steps of h, which damp nothing.

    d'' = -(shaken + p) / R with R = 1 + zeta w h + (w h)^2 / 4 and p of the beginning of the step; d' is half a step
    earlier, as MuJoCo's qvel is. displaced, moving: d and d' at the start.
    """

    def __init__(self, *, frequency, damping_ratio, timestep, displaced=0.0, moving=0.0):
        self.timestep = timestep
        turning = 2 * np.pi * frequency  # w, rad/s
        self.slowing, self.pulling = 2 * damping_ratio * turning, turning**2
        self.resists = 1 + self.slowing * timestep / 2 + self.pulling * timestep**2 / 4  # R
        self.displaced, self.rate = displaced + 0.0 * frequency, moving + 0.0 * frequency  # d, d'

    def pulled(self):
        """p."""
        return self.slowing * self.rate + self.pulling * self.displaced

    def move(self, shaken):
        """Take a step."""
        self.rate = self.rate - self.timestep * (shaken + self.pulled()) / self.resists
        self.displaced = self.displaced + self.timestep * self.rate


class VibrationEffect(Effect):
    """An effect of something that swings. Its parameters are how much does, the frequency and the damping ratio.

    With x what shakes it, `share` of it, d'' + 2 zeta w d' + w^2 d = -share x''. With states that are free in every
    window it would stand in for any force that changes slowly: where the log measured x, a window begins as that made
    it swing since the stretch of the log began, d and d' being 0 there.
    """

    shapes = ("frequency", "damping_ratio")
    vague_at_end = ("frequency",)
    states = ("displaced", "moving")
    states_mean = (
        "`displaced`, `moving`: how far (m or rad) and how fast what swings is from where the log made it swing; at 1 "
        "as far as that may be off, or without a log 4 a / w^2 and 4 a / w, w = 2 pi `frequency`, a an acceleration of "
        "the base (5 m/s^2 times `mobility`) or of the joint by its greatest common force"
    )
    seen_log: SeenLog | None = None
    vague: float = SETTINGS.vague

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
        vars(self).pop("shaken", None)

    def eased(self):
        if self.shaken is None:
            return None
        own = copy(self)
        own.vague = SETTINGS.eased
        return own

    @cached_property
    def shaken(self) -> Shaken | None:
        """How x was in the log that it is looked for in; None where that does not measure it."""
        return None if self.seen_log is None else self.shaken_in(self.seen_log)

    @abstractmethod
    def shaken_in(self, log: SeenLog) -> Shaken | None:
        """How x was in the log; None where that does not measure it."""

    @abstractmethod
    def shaking(self, world: World) -> tuple[np.ndarray, np.ndarray]:
        """x and x' where simulations are now, (simulation,) each."""

    def weights(self, world: World) -> np.ndarray:
        """Of the parts that x is the mean of, in `shaken_in`, (simulation, part)."""
        return np.ones((len(world.rows), 1))

    def share(self, values: np.ndarray) -> np.ndarray | float:
        """Of x, by which it is shaken, (simulation,); values (simulation, parameter)."""
        return 1.0

    def shown_at(self, first: np.ndarray | None, late: np.ndarray | float | None) -> np.ndarray | None:
        """The steps, fractional, at which the log shows x as it is where simulations begin, (simulation,); None where
        there is no log. first: as of `force`; late (simulation,): s.
        """
        if self.shaken is None or first is None:
            return None
        return steps_later(self.shaken.time, self.shaken.stretches, first, 0.0 if late is None else late)

    def begins(
        self,
        values: np.ndarray,
        states: np.ndarray | None,
        push: np.ndarray | float,
        *,
        timestep: float,
        shown: np.ndarray | None,
    ) -> dict[str, np.ndarray]:
        """How it begins, (simulation,) each, at `states`; push: its usual accelerations, m/s^2 or rad/s^2.

        shown (simulation,): as of `shown_at`. `after` and `following` (simulation, part) are x + d and x' + d' with a
        share of 1, as the log tells them.
        """
        states = np.zeros((len(values), len(self.states))) if states is None else states
        turning, told = 2 * np.pi * values[:, 1], {}
        far = SETTINGS.resonates * push / turning**2
        if self.shaken is not None and shown is not None:
            (after, following), off, swings = self.shaken.after(values[:, 1], values[:, 2], shown, timestep)
            share = self.share(values) + 0.0 * off
            far = share * np.hypot(off, self.vague * swings)
            told = {"after": after, "following": following, "share": share}
        return {"displaced": far * states[:, 0], "moving": far * turning * states[:, 1]} | told


class ForceShakenBefore(ForceOfKernel):
    """The force of something that swings: where the log says how it was shaken it begins so far from where x is now."""

    def own(self, world):
        own = super().own(world)
        if "after" in own:
            share, after, following = (own.pop(name) for name in ("share", "after", "following"))
            weights, (x, speed) = self.effect.weights(world), self.effect.shaking(world)
            own["displaced"] = own["displaced"] + share * ((weights * after).sum(axis=1) - x)
            own["moving"] = own["moving"] + share * ((weights * following).sum(axis=1) - speed)
        return own


@dataclass(frozen=True, eq=False)
class Shaken:
    """What swings after a path x of the log at its difference: x + d at every step of the log, and x' + d'.

    time (step,), path (step, part): of the log, s, and m or rad; nan where it was not measured. x is the mean of the
    parts, whose `weights` (part,) simulations know better. stretches: of the log's steps; noise: of x, standard
    deviation. begun (stretch, part): speeds where a stretch was first measured; begun_sd (stretch,): how well that of x
    is known; between two noisy samples it is not.
    """

    time: np.ndarray
    path: np.ndarray
    weights: np.ndarray
    stretches: Sequence[slice]
    noise: float
    begun: np.ndarray
    begun_sd: np.ndarray

    @cached_property
    def _swings(self) -> Callable:
        return lru_cache(maxsize=SETTINGS.kept)(self._swinging)

    def after(
        self, frequency: np.ndarray, damping_ratio: np.ndarray, shown: np.ndarray, timestep: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """x + d and x' + d' at the steps `shown`, fractional, of the log, (2, simulation, part), how far off x + d may
        be for the noise, and how large d commonly is, (simulation,) each; the others (simulation,), too.
        """
        found = np.zeros((2, len(shown), self.path.shape[1]))
        off, common = np.zeros((2, len(shown)))
        pairs, which = np.unique(np.stack([frequency, damping_ratio]), axis=1, return_inverse=True)
        for number, (own, ratio) in enumerate(pairs.T):
            rows = which.ravel() == number
            swings, off_there, displaced = self._swings(float(own), float(ratio), timestep)
            found[:, rows] = np.stack([at_steps(each, shown[rows]) for each in swings])
            off[rows], common[rows] = at_steps(off_there, shown[rows]), displaced
        return found, off, common

    def _off(self, frequency: float, damping_ratio: float) -> np.ndarray:
        """m or rad: how far off x + d may be for the noise, (step,).

        A path with white noise of density S shakes x + d by a variance of S w / (4 zeta): S is the noise's variance
        times the interval between samples. What x' is off where the stretch begins swings freely from there on.
        """
        turning, interval = 2 * np.pi * frequency, float(np.median(np.diff(self.time)))
        gathered = self.noise * np.sqrt(turning * interval / (4 * damping_ratio) + 1.0)
        begun = np.exp(-damping_ratio * turning * since_stretches_began(self.time, self.stretches)) / turning
        for steps, sd in zip(self.stretches, self.begun_sd, strict=True):
            begun[steps] *= sd
        return SETTINGS.hides * np.hypot(gathered, begun)

    def _swinging(
        self, frequency: float, damping_ratio: float, timestep: float
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """As of `after`, (2, step, part), (step,) and a number, where d is of the frequency that steps of the
        trapezoidal rule give it, and speeds, as MuJoCo's, are those of half a step before.
        """
        found, displaced = np.zeros((2, *self.path.shape)), np.zeros(len(self.path))
        turning = 2 / timestep * np.arctan(np.pi * frequency * timestep)
        for steps, even, x, begun in self._finer:
            place, speed = swings_after(even, x, turning, damping_ratio, begun)
            time = self.time[steps]
            found[0, steps] = _on_even(even, place, time)
            found[1, steps] = _on_even(even, speed, time - timestep / 2)
            displaced[steps] = _on_even(even, (place - x) @ self.weights, time)
        return found, self._off(frequency, damping_ratio), float(np.sqrt(np.mean(displaced**2)))

    @cached_property
    def _finer(self) -> list[tuple[slice, np.ndarray, np.ndarray, np.ndarray]]:
        """Of stretches in which anything was measured: their steps, times at even distances, from the first sample on,
        x there (time, part), held after the last, and `begun` (part,).
        """
        found = []
        for steps, begun in zip(self.stretches, self.begun, strict=True):
            time, path = self.time[steps], self.path[steps]
            measured = np.isfinite(path).all(axis=1)
            if measured.sum() < 2:
                continue
            begins, ends = time[measured][[0, -1]]
            even = np.linspace(begins, time[-1], SETTINGS.finer * len(time))
            x = CubicSpline(time[measured], path[measured])(np.minimum(even, ends))
            found.append((steps, even, x, begun))
        return found


def _on_even(even: np.ndarray, values: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Values (even, ...) at even times, s, straight between them at `time` (step,); the first before them."""
    return at_steps(values, np.clip((time - even[0]) / (even[1] - even[0]), 0, len(even) - 1))


def swings_after(
    time: np.ndarray, path: np.ndarray, turning: float, damping_ratio: float, begun: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """x + d and x' + d', (step, part) each, of d'' + 2 zeta w d' + w^2 d = -x'', d = d' = 0 at first, along x = `path`.

    turning: w, rad/s. begun (part,): x' at first, per s. Exact where x moves steadily between steps, which are even:
    x' then jumps at each, and d' by as much the other way, and the rest is free vibration.
    """
    step = float(time[1] - time[0])
    speed = np.diff(path, axis=0) / step
    speed = np.concatenate([speed, speed[-1:]])
    jumps = -np.diff(speed, axis=0, prepend=begun[None])
    slowing = damping_ratio * turning
    swung = np.sqrt(turning**2 - slowing**2)
    left, angle = np.exp(-slowing * step), swung * step
    poles = -2 * left * np.cos(angle), left**2
    later = -left * (np.cos(angle) + slowing / swung * np.sin(angle))
    displaced = recursively_filtered((0.0, left * np.sin(angle) / swung), poles, jumps)
    return path + displaced, speed + recursively_filtered((1.0, later), poles, jumps)
