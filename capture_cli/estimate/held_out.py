"""Whether a model holds on what was held out, where its parameters are no better known than the fit leaves them.

A log may show something for the first time in the part that was held out: a rod that tips, by a centre of mass that
the fitted strokes leave open. Errors there beyond the noise are then no lack of the model. Linearised they have the
covariance I + J S J^T, S that of the parameters (the posterior predictive distribution; Gelman et al., Bayesian Data
Analysis, 3rd ed., section 6.3); as contacts are not linear, the whole log is fitted instead.

Intervals say what the noise leaves open, and take the simulator for exact. A rate that no fitted motion reaches is told
by how it rounds the steps of a command, to a thousandth, and the time step puts that off by a hundredth; a faster
motion that was held out shows it. So parameters may also be where what was fitted is next to nothing worse.
"""

from dataclasses import dataclass

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.extrapolation import Beyond, beyond_fitted
from capture_cli.estimate.fit import SETTINGS as FIT
from capture_cli.estimate.fit import Fit
from capture_cli.estimate.model_fits import Effort, ModelFits
from capture_cli.estimate.noise.lack_of_fit import LackOfFit, lack_held_out, lack_of_fit
from capture_cli.estimate.part_fit import PartFit


@frozen
class SETTINGS:
    drawn: int = 32  # points where a fit to the whole log may begin
    by_chance: float = 1e-3  # the probability that parameters are farther off than this
    next_to_nothing: float = 0.01  # noise floors that what was fitted may be worse


@dataclass(frozen=True)
class HeldOut:
    """lack: what a fit leaves of what it was not fitted to. whole: the same model fitted to the whole log, where it
    leaves nothing of either part and its parameters are where the first fit may have missed them, or would hardly have
    been worse; else None. beyond: where no model of these parameters holds on both, how what was held out differs; None
    where that is not seen.
    """

    lack: LackOfFit
    whole: Fit | None = None
    beyond: Beyond | None = None

    @property
    def lacking(self) -> bool:
        """Whether the model does not hold there."""
        return self.lack.lacking and self.whole is None


def held_out(fits: ModelFits, fit: Fit, covariance: np.ndarray, on: PartFit, is_test: np.ndarray) -> HeldOut:
    """Whether the model of `fit` holds on the windows `is_test` (window,), which that was not fitted to.

    covariance (parameter, parameter): of the fit's error. on: the whole log at the fit's parameters.
    """
    test = on.rows(is_test)
    lack = lack_held_out(test.data, test.residual)
    if not lack.lacking or lack_of_fit(fit.at).lacking:
        return HeldOut(lack)
    whole = _whole(fits, fit, covariance, on, is_test) if len(fit.space) else None
    if whole is not None:
        return HeldOut(lack, whole)
    windows = fits.prepared.windows
    return HeldOut(lack, None, beyond_fitted(windows.measured, windows.sampled, on.residual, is_test))


def _whole(fits: ModelFits, fit: Fit, covariance: np.ndarray, on: PartFit, is_test: np.ndarray) -> Fit | None:
    """The model fitted to the whole log, where it holds on all of it and is no other than `fit` may be."""
    in_unit = covariance / np.outer(fit.space.span, fit.space.span)
    whole = fits.fit(
        fits.prepared,
        fit.effects,
        _begin(fits, fit, in_unit, on),
        near=fit,
        corrections=on.corrections,
        effort=Effort(tolerance=FIT.exact),
    )
    if whole is None or not _leaves_nothing(whole, is_test):
        return None
    if not _by_chance(fit, whole, in_unit) and _loss(whole, on, ~is_test) > SETTINGS.next_to_nothing:
        return None
    return whole


def _begin(fits: ModelFits, fit: Fit, covariance: np.ndarray, on: PartFit) -> np.ndarray:
    """The best point (parameter,) for the whole log of what the fit, of covariance (p, p) in the unit cube, leaves
    open: contacts may hide the way to it.
    """
    space, generator = fit.space, np.random.default_rng(0)
    drawn = generator.multivariate_normal(space.to_unit(fit.point), covariance, SETTINGS.drawn, method="eigh")
    points = np.concatenate([fit.point[None], space.from_unit(np.clip(drawn, 0, 1))])
    return points[np.argmin(fits.objectives(fits.prepared, fit, on, points))]


def _leaves_nothing(whole: Fit, is_test: np.ndarray) -> bool:
    """Whether the fit to the whole log leaves nothing but noise in it, and in the windows `is_test` (window,) alone."""
    test = PartFit.of(whole.at).rows(is_test)
    return not lack_of_fit(whole.at).lacking and not lack_held_out(test.data, test.residual).lacking


def _loss(whole: Fit, on: PartFit, fitted: np.ndarray) -> float:
    """How much larger, in noise floors, the error of the windows `fitted` (window,) is at the fit to the whole log."""
    return PartFit.of(whole.at).rows(fitted).normalized - on.rows(fitted).normalized


def _by_chance(fit: Fit, whole: Fit, covariance: np.ndarray) -> bool:
    """Whether the parameters of the two fits are no farther apart than chance may have put the first of them."""
    from scipy.special import chdtri

    off = (whole.point - fit.point) / fit.space.span
    distance = float(off @ np.linalg.pinv(covariance, rcond=1e-12, hermitian=True) @ off)
    return distance <= chdtri(len(off), SETTINGS.by_chance)
