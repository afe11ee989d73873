"""How noisy series move at chosen samples: value, slope and curvature of a polynomial fitted around each.

A local cubic is fitted; its half-width is the widest at which its residual still looks like the noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

HALF_WIDTHS = (4, 6, 9, 13, 19, 28, 40)  # samples on either side
FEWEST = 6  # samples that a polynomial is fitted to
ACCEPTABLE_RESIDUAL = 1.3  # variance of the local fit's residual over that of the noise
UNKNOWN_SLOPE_SD = 10.0  # per s, where there are too few samples to differentiate


@dataclass(frozen=True)
class Neighbours:
    """The samples around chosen ones, HALF_WIDTHS[-1] on either side.

    index (place, sample): which they are; time (place, sample): s, from the chosen one; known (place, sample): False
    beyond the episode.
    """

    index: np.ndarray
    time: np.ndarray
    known: np.ndarray

    @classmethod
    def of(cls, time: np.ndarray, at: np.ndarray, first: np.ndarray, stop: np.ndarray) -> Neighbours:
        """Those of the samples `at` (place,), each in an episode [first, stop) (place,). time (step,)."""
        reach = HALF_WIDTHS[-1]
        index = at[:, None] + np.arange(-reach, reach + 1)
        inside = np.clip(index, first[:, None], stop[:, None] - 1)
        return cls(inside, time[inside] - time[at][:, None], inside == index)

    def rows(self, keep) -> Neighbours:
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

    def rows(self, keep) -> LocalMotion:
        """That at the places at `keep`."""
        return LocalMotion(**{name: values[keep] for name, values in vars(self).items()})

    def take(self, other: LocalMotion, places: np.ndarray, which: np.ndarray) -> None:
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
    centre, shape = HALF_WIDTHS[-1], series[:, 0].shape
    best = LocalMotion(
        value=series[:, centre].astype(float),
        slope=np.zeros(shape),
        curvature=np.zeros(shape),
        value_sd=np.tile(np.asarray(noise_sd, dtype=float), (shape[0], 1)),
        slope_sd=np.full(shape, UNKNOWN_SLOPE_SD),
    )
    fitted, begun, ended = (
        np.zeros(shape[0], dtype=bool),
        np.zeros(shape, dtype=bool),
        np.zeros(shape, dtype=bool),
    )
    for half in HALF_WIDTHS:
        width = slice(centre - half, centre + half + 1)
        count = near.known[:, width].sum(axis=1)
        places = np.flatnonzero((count >= FEWEST) & ~ended.all(axis=1))
        if not len(places):
            continue
        samples = (near.time[places, width], series[places, width], near.known[places, width])
        cubic, variance = _polynomials(*samples, 3, noise_sd)
        # the residual's variance is itself uncertain: allow three of its standard deviations
        limit = ACCEPTABLE_RESIDUAL + 3 * np.sqrt(2 / (count[places, None] - 4))
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
    return best


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
