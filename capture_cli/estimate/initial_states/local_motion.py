"""How noisy series move at chosen samples: value, slope and curvature of a polynomial fitted around each.

A local cubic is fitted; its half-width is the widest at which its residual still looks like the noise.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from capture_cli.common.frozen import frozen


@frozen
class SETTINGS:
    half_widths: tuple[int, ...] = (4, 6, 9, 13, 19, 28, 40)  # samples on either side
    fewest: int = 6  # samples that a polynomial is fitted to
    acceptable_residual: float = 1.3  # variance of the local fit's residual over that of the noise
    unknown_slope_sd: float = 10.0  # per s, where there are too few samples to differentiate
    # intervals between samples that the nearest is away: nobody saw what the series did meanwhile
    far: float = 2.0


@dataclass(frozen=True)
class Neighbours:
    """The samples around chosen places, `half_widths`[-1] on either side of the nearest.

    index (place, sample): which they are; time (place, sample): s, from the place; known (place, sample): False beyond
    the episode.
    """

    index: np.ndarray
    time: np.ndarray
    known: np.ndarray

    @classmethod
    def of(
        cls,
        time: np.ndarray,
        at: np.ndarray,
        first: np.ndarray,
        stop: np.ndarray,
        own: np.ndarray | None = None,
    ) -> Self:
        """Those of the steps `at` (place,), each in an episode [first, stop) (place,). time (step,).

        own: the steps that have a sample, of which every episode has some; all of them where None.
        """
        own = np.arange(len(time)) if own is None else own
        begin, end = (np.searchsorted(own, steps) for steps in (first, stop))
        after = np.clip(np.searchsorted(own, at), begin, end - 1)
        before = np.maximum(after - 1, begin)
        is_nearer = time[at] - time[own[before]] < np.abs(time[own[after]] - time[at])
        reach = SETTINGS.half_widths[-1]
        number = np.where(is_nearer, before, after)[:, None] + np.arange(-reach, reach + 1)
        inside = np.clip(number, begin[:, None], end[:, None] - 1)
        index = own[inside]
        return cls(index, time[index] - time[at][:, None], inside == number)

    def rows(self, keep) -> Self:
        """Those of the places at `keep`."""
        return Neighbours(self.index[keep], self.time[keep], self.known[keep])


@dataclass(frozen=True)
class LocalMotion:
    """(place, column) each: value, slope and curvature, per s and s^2, and the sd of the first two."""

    value: np.ndarray
    slope: np.ndarray
    curvature: np.ndarray
    value_sd: np.ndarray
    slope_sd: np.ndarray

    def rows(self, keep) -> Self:
        """That at the places at `keep`."""
        return LocalMotion(**{name: values[keep] for name, values in vars(self).items()})

    def mixed(self, weights: np.ndarray) -> Self:
        """That of sums `weights` (sum, column) of the columns, whose noise is independent."""
        sums = (values @ weights.T for values in (self.value, self.slope, self.curvature))
        sds = (np.sqrt(np.square(sd) @ np.square(weights).T) for sd in (self.value_sd, self.slope_sd))
        return LocalMotion(*sums, *sds)

    def take(self, other: Self, places: np.ndarray, which: np.ndarray) -> None:
        """Replace the columns `which` (other's place, column) of `places` (other's place,) by those of `other`."""
        place, column = np.nonzero(which)
        for name, values in vars(self).items():
            values[places[place], column] = getattr(other, name)[place, column]


def local_motion(near: Neighbours, series: np.ndarray, noise_sd: np.ndarray) -> LocalMotion:
    """The motion of `series` (place, sample, column), given at the samples `near`. noise_sd (column,).

    A cubic over the widest half-width up to which its residual's variance stays near the noise's is taken, column by
    column; in the narrowest ones, of few samples, it may be off by chance. Where the curve stands out of the noise in
    all of them, a quintic over the narrowest is, and its sd is what it changes: the residual of a polynomial tells
    little of how wrong its derivative is.
    """
    unseen = _unseen(near)
    # what is far is taken to be as at the nearest sample
    near = replace(near, time=near.time - unseen[:, None])
    centre, shape = SETTINGS.half_widths[-1], series[:, 0].shape
    noise = np.tile(np.asarray(noise_sd, dtype=float), (shape[0], 1))
    best = LocalMotion(
        value=series[:, centre].astype(float),
        slope=np.zeros(shape),
        curvature=np.zeros(shape),
        value_sd=np.hypot(noise, SETTINGS.unknown_slope_sd * near.time[:, centre, None]),
        slope_sd=np.full(shape, SETTINGS.unknown_slope_sd),
    )
    fitted, begun, ended = (
        np.zeros(shape[0], dtype=bool),
        np.zeros(shape, dtype=bool),
        np.zeros(shape, dtype=bool),
    )
    for half in SETTINGS.half_widths:
        width = slice(centre - half, centre + half + 1)
        count = near.known[:, width].sum(axis=1)
        places = np.flatnonzero((count >= SETTINGS.fewest) & ~ended.all(axis=1))
        if not len(places):
            continue
        samples = (near.time[places, width], series[places, width], near.known[places, width])
        cubic, variance = _polynomials(*samples, 3, noise_sd)
        # the residual's variance is itself uncertain: allow three of its standard deviations
        limit = SETTINGS.acceptable_residual + 3 * np.sqrt(2 / (count[places, None] - 4))
        like_noise = variance <= limit * np.square(noise_sd)
        ended[places] |= begun[places] & ~like_noise
        best.take(cubic, places, like_noise & ~ended[places])
        for degree in (4, 5):
            new = ~fitted[places] & (np.minimum(5, count[places] - 2) == degree)
            if new.any():
                quintic, _ = _polynomials(*(s[new] for s in samples), degree, noise_sd)
                quintic.value_sd[:] = np.hypot(quintic.value_sd, quintic.value - cubic.value[new])
                quintic.slope_sd[:] = np.hypot(quintic.slope_sd, quintic.slope - cubic.slope[new])
                best.take(quintic, places[new], ~like_noise[new])
        fitted[places] = True
        begun[places] |= like_noise
    _doubt(best, near, series, unseen)
    return best


def _unseen(near: Neighbours) -> np.ndarray:
    """s, (place,), how long before or after a place its nearest sample is, where that is `far`; 0 elsewhere."""
    away = near.time[:, SETTINGS.half_widths[-1]]
    places = np.flatnonzero(away)
    interval = np.ma.masked_array(np.diff(near.time[places], axis=1), ~_follow(near)[places])
    far = np.zeros(len(away))
    far[places] = np.where(
        np.abs(away[places]) > SETTINGS.far * np.ma.median(interval, axis=1).filled(0.0), away[places], 0.0
    )
    return far


def _follow(near: Neighbours) -> np.ndarray:
    """Which samples and those after them are both known, (place, sample - 1)."""
    return near.known[:, 1:] & near.known[:, :-1]


def _doubt(motion: LocalMotion, near: Neighbours, series: np.ndarray, unseen: np.ndarray) -> None:
    """Allow, `unseen` (place,) s from every sample, for any motion at the speed that the samples around show."""
    places = np.flatnonzero(unseen)
    if not places.size:
        return
    interval = np.ma.masked_array(np.diff(near.time[places], axis=1), ~_follow(near)[places])
    speed = np.diff(series[places], axis=1) / interval[..., None]
    speed = np.ma.sqrt((speed**2).mean(axis=1)).filled(SETTINGS.unknown_slope_sd)
    motion.value_sd[places] = np.hypot(motion.value_sd[places], speed * np.abs(unseen[places, None]))
    motion.slope_sd[places] = np.hypot(motion.slope_sd[places], speed)


def _polynomials(
    time: np.ndarray, series: np.ndarray, known: np.ndarray, degree: int, noise_sd: np.ndarray
) -> tuple[LocalMotion, np.ndarray]:
    """Least-squares polynomials through what is `known` of the series at time 0; their residuals' variance
    (place, column).
    """
    span = np.where(known, time, -np.inf).max(axis=1) - np.where(known, time, np.inf).min(axis=1)
    basis = (time / span[:, None])[..., None] ** np.arange(degree + 1) * known[..., None]
    inverse = np.linalg.inv(np.swapaxes(basis, 1, 2) @ basis)
    coefficients = inverse @ (np.swapaxes(basis, 1, 2) @ series)
    residual = (series - basis @ coefficients) * known[..., None]
    freedom = known.sum(axis=1) - degree - 1
    variance = np.square(residual).sum(axis=1) / freedom[:, None]
    scatter = np.sqrt(np.maximum(variance, np.square(noise_sd)))
    span = span[:, None]
    found = LocalMotion(
        value=coefficients[:, 0],
        slope=coefficients[:, 1] / span,
        curvature=2 * coefficients[:, 2] / span**2,
        value_sd=scatter * np.sqrt(inverse[:, 0, 0, None]),
        slope_sd=scatter * np.sqrt(inverse[:, 1, 1, None]) / span,
    )
    return found, variance
