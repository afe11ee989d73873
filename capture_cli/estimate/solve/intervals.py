"""Standard deviations and 95 % intervals that allow for autocorrelated residuals.

With J the sensitivities and M the projection that removes the initial states (their prior kept), the estimate's error
is A^-1 J'M (e + B b), A = J'MJ, e the residual process and b the initial states' error. Its covariance is the sandwich
A^-1 [J'M (G + B B') M J] A^-1 with G the residual's autocovariance, pooled over windows and tapered (Newey & West
1987), rather than the outer product of scores: far less noisy when windows are few.

Where contacts make the error rough a descent ends on a bump, short of where the sensitivities say that the bottom is.
How far short is a part of the estimate's error, and its square is added to the covariance.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.noise.autocorrelation import (
    autocovariance,
    correlation_length,
    in_order,
    mean_time,
    own_samples,
)
from capture_cli.estimate.solve._sampled_posterior import SampledPosterior
from capture_cli.estimate.solve.linearization import Linearization
from capture_cli.model.parameters import SETTINGS as PARAMETERS
from capture_cli.model.parameters import ParameterSpace


@frozen
class SETTINGS:
    # Posterior sd beyond this share of the range: the 95 % interval spans two thirds of what was known before.
    undetermined_sd: float = 1 / 6
    far: float = 2.0  # of the residual's variance over that of the noise, times its correlation time
    lost_sd: float = 1.0  # of the range, where the log says nothing at all
    # Farther from a bound than so many of its sd the log decides a parameter: of bounds that are very wide,
    # at_bound of the range may be more than the parameter itself.
    clear_of_bound_sd: float = 3.0
    rounding: float = 1e-9  # of the range: what values at a bound are off it by


@dataclass(frozen=True)
class Intervals:
    """In the parameters' own units.

    covariance (p, p); sd (p,); low, high (p,): 95 %, cut to the bounds; identifiable (p,). degrees: effective degrees
    of freedom of the residual. limits (p, 2): what the log says of a parameter all the same that is not identifiable,
    at least and at most; nan where it does not, None where nobody looked.
    """

    covariance: np.ndarray
    sd: np.ndarray
    low: np.ndarray
    high: np.ndarray
    identifiable: np.ndarray
    degrees: float
    limits: np.ndarray | None = None

    def limited(self, space: ParameterSpace, looked: Sequence[int], excluded: np.ndarray) -> Self:
        """With what the log excludes, from below and from above, of the parameters numbered `looked`.

        excluded (p, 2): in the unit cube; nan where it does not exclude the end of the range. Intervals reach as far,
        and a parameter of which it does not exclude both ends is not identifiable, whatever its sd was.
        """
        own = np.isin(np.arange(len(space)), looked)
        limits = np.where(own[:, None], space.low[:, None] + excluded * space.span[:, None], np.nan)
        one_sided = own & self.identifiable & np.isnan(limits).any(axis=1)
        identifiable = self.identifiable & ~one_sided
        low = np.where(identifiable, np.fmin(self.low, limits[:, 0]), np.fmax(space.low, limits[:, 0]))
        high = np.where(identifiable, np.fmax(self.high, limits[:, 1]), np.fmin(space.high, limits[:, 1]))
        limits[identifiable] = np.nan
        covariance = np.where(one_sided[:, None] | one_sided, 0.0, self.covariance)
        covariance[one_sided, one_sided] = np.square(SETTINGS.lost_sd * space.span[one_sided])
        return replace(
            self,
            covariance=covariance,
            sd=np.where(one_sided, SETTINGS.lost_sd * space.span, self.sd),
            low=low,
            high=high,
            identifiable=identifiable,
            limits=limits,
        )

    def quantile(self, among: int = 1) -> float:
        """95 % intervals reach to so many standard deviations; of the worst of `among` as many (Bonferroni)."""
        return _quantile(self.degrees, among)

    def rows(self, space: ParameterSpace, point: np.ndarray, which: Iterable[int]) -> list[dict[str, Any]]:
        """The parameters numbered `which` at `point` (parameter,), as result files have them."""
        x = space.to_unit(point)
        return [
            {
                "value": float(point[i]),
                "unit": space.parameters[i].unit,
                "low": float(space.low[i]),
                "high": float(space.high[i]),
                "sd": float(self.sd[i]),
                "ci95": [float(self.low[i]), float(self.high[i])],
                "at_bound": self._is_at_bound(x[i], self.sd[i] / space.span[i]),
                "identifiable": bool(self.identifiable[i]),
                "limits": self._limits(i),
            }
            for i in which
        ]

    def _limits(self, i: int) -> dict[str, float | None] | None:
        if self.limits is None or np.isnan(self.limits[i]).all():
            return None
        least, most = (None if np.isnan(limit) else float(limit) for limit in self.limits[i])
        return {"at_least": least, "at_most": most}

    @staticmethod
    def _is_at_bound(x: float, sd: float) -> bool:
        """Whether a parameter is at the end of its range, at `x` in the unit cube, with its sd there."""
        distance = min(x, 1 - x)
        return bool(
            distance < PARAMETERS.at_bound and distance <= SETTINGS.clear_of_bound_sd * sd + SETTINGS.rounding
        )


def intervals(
    at: Linearization, minima: Sequence[Linearization] = (), sampled: SampledPosterior | None = None
) -> Intervals:
    """Intervals of the parameters at the linearization `at`, which must be at the estimate.

    minima: other places where descents ended on the same data, of an error that is rough: the intervals reach to those
    that are nearly as good. sampled: what was simulated about an estimate, to be believed instead of the linearization;
    the intervals are about its mean, and reach to the estimate.
    """
    assert at.data.count > 0
    space = at.data.space
    covariance, degrees = unit_covariance(at)
    covariance = (
        covariance + _left_to_go(at) + _scatter_of_minima(at, minima)
        if sampled is None
        else sampled.covariance
    )
    sd_unit = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    value = space.from_unit(at.x)
    middle = value if sampled is None else space.from_unit(sampled.mean)
    half = _quantile(degrees) * sd_unit * space.span
    return Intervals(
        covariance=covariance * np.outer(space.span, space.span),
        sd=sd_unit * space.span,
        low=np.maximum(np.minimum(middle - half, value), space.low),
        high=np.minimum(np.maximum(middle + half, value), space.high),
        identifiable=sd_unit <= SETTINGS.undetermined_sd,
        degrees=degrees,
    )


def _quantile(degrees: float, among: int = 1) -> float:
    from scipy.special import stdtrit

    return float(stdtrit(degrees, 1 - 0.025 / among))


def unit_covariance(at: Linearization) -> tuple[np.ndarray, float]:
    """Covariance (p, p) in the unit cube, and the effective degrees of freedom of the residual."""
    k = at.inflation
    gain = at.initial_gain(k)
    b, j = at.by_initial, at.by_parameter
    through = gain @ (b.swapaxes(1, 2) @ j)
    projected = j - b @ through  # M J, (window, row, p)
    hessian, _ = at.normal(k)
    fitted_initial, count = at.fitted_initial, at.data.count
    meat, correlation = _noise_along(at, projected)
    degrees = max(count / correlation - j.shape[-1] - fitted_initial / correlation, 1.0)
    # sensitivities are finite differences, wrong by about their step: columns more alike than that are the same
    floor = max(at.data.space.steps, default=0.0) ** 2
    return _sandwich(hessian, meat, np.einsum("wrp,wrp->p", j, j), floor), degrees


def noise_along(at: Linearization, changes: np.ndarray) -> np.ndarray:
    """Covariance (change, change) of the products of noise with `changes` (window, row, change) of the residual."""
    return _noise_along(at, changes)[0]


def _noise_along(at: Linearization, changes: np.ndarray) -> tuple[np.ndarray, float]:
    """Likewise, changes' (G + B B') changes, and the residual's autocorrelation time, in samples."""
    count = at.data.count
    product, correlation = _filtered_product(at, changes)
    product *= count / max(count - len(at.x) - at.fitted_initial, 1.0)
    initial = at.by_initial.swapaxes(1, 2) @ changes
    return product + np.einsum("wsp,wsq->pq", initial, initial), correlation


def _left_to_go(at: Linearization) -> np.ndarray:
    """Square (p, p), in the unit cube, of the step that a descent could not take; next to 0 where it took it.

    Not where the error is smooth and far from noise: there a descent ends early on purpose.
    """
    if not at.data.rough and at.inflation > SETTINGS.far:
        return np.zeros((len(at.x),) * 2)
    step = at.whole_step
    return np.outer(step, step)


def _scatter_of_minima(at: Linearization, minima: Sequence[Linearization]) -> np.ndarray:
    """Second moment (p, p), in the unit cube, of minima about the best one, each with its likelihood for a weight."""
    k = at.inflation
    least = at.objectives(k).sum()
    x = np.array([m.x for m in (at, *minima)]) - at.x
    behind = np.array([m.objectives(k).sum() for m in (at, *minima)]) - least
    weights = np.exp(-np.maximum(behind, 0.0) / (2 * k))
    return np.einsum("m,mp,mq->pq", weights / weights.sum(), x, x)


def _filtered_product(at: Linearization, projected: np.ndarray) -> tuple[np.ndarray, float]:
    """sum_w (MJ)' G (MJ), (p, p), and the residual's autocorrelation time, in samples."""
    data = at.data
    shape = data.measured.shape
    covariance = autocovariance(at.residual.reshape(shape), data.mask)
    # noise about three axes shows in four numbers, sensitivities along the three
    for columns in data.attitudes:
        covariance[:, columns] = covariance[:, columns].sum(axis=1, keepdims=True) / 3
    shaped = in_order(projected.reshape(*shape, -1), own_samples(data.mask))
    size = 1 << (2 * shape[1] - 1).bit_length()
    meat = np.zeros((shaped.shape[-1],) * 2)
    times = []
    for output in range(shape[2]):
        lags, time = correlation_length(covariance[:, output])
        taper = np.maximum(1 - np.arange(shape[1]) / (lags + 1), 0)
        kernel = np.zeros(size)
        kernel[: shape[1]] = covariance[:, output] * taper
        kernel[-shape[1] + 1 :] += kernel[1 : shape[1]][::-1]
        spectrum = np.maximum(np.fft.rfft(kernel).real, 0)
        transformed = np.fft.rfft(shaped[:, :, output], size, axis=1)
        filtered = np.fft.irfft(transformed * spectrum[:, None], size, axis=1)[:, : shape[1]]
        meat += np.einsum("wtp,wtq->pq", shaped[:, :, output], filtered)
        times.append(time)
    return meat, mean_time(np.array(times), covariance, data.mask)


def _sandwich(hessian: np.ndarray, meat: np.ndarray, sensitivity: np.ndarray, floor: float) -> np.ndarray:
    """A^-1 meat A^-1 over the directions in which A = hessian (p, p) has information; `lost_sd` in the others.

    sensitivity (p,): what the diagonal of A would be without the initial states, the scale of its error, of which an
    eigenvalue must exceed the share `floor`.
    """
    scale = np.sqrt(np.where(sensitivity > 0, sensitivity, 1.0))
    values, vectors = np.linalg.eigh(hessian / np.outer(scale, scale))
    known = values > floor
    directions = vectors / scale[:, None]
    inverse = (directions[:, known] / values[known]) @ directions[:, known].T
    lost = directions[:, ~known] / np.linalg.norm(directions[:, ~known], axis=0)
    covariance = inverse @ meat @ inverse + SETTINGS.lost_sd**2 * lost @ lost.T
    return (covariance + covariance.T) / 2
