"""Data against an effect that lies in its fit: values at the end of a range, or next to nothing explained."""

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.fit import Fit
from capture_cli.estimate.noise.lack_of_fit import lack_of_fit
from capture_cli.estimate.solve.intervals import intervals
from capture_cli.model.effects.placed import Placed
from capture_cli.select.model_comparison import ModelComparison
from capture_cli.select.reason import Reason, Rejection


@frozen
class SETTINGS:
    # Of the squared error above the noise floor: an effect that takes less away corrects a model that is
    # wrong otherwise
    material: float = 0.1
    # Of a range. A result file says "at its bound" from AT_BOUND on; but a descent gives up where its trust
    # region is this small, and an effect that ends so near to where its range does is drawn there.
    near_bound: float = 1e-3


def out_of_range(models: ModelComparison, current: Fit, fit: Fit, placed: Placed) -> Rejection | None:
    """What the values in `fit` say against an effect, over `current` without it, or None.

    Where something is left: that it is at a bound, or drives a declared parameter to one. Where nothing is, that is
    where they are, but for what is vague at a bound. A declared parameter may fall to zero: then it had been standing
    in for the effect. Nor does it count where the log hardly determines it: then it may be anywhere.
    """
    effect, values = placed.effect, fit.point[fit.columns(placed.name)]
    ends = at_end(placed, values)
    vague = next((ends[name] for name in effect.vague_at_end if name in ends), None)
    if vague or models.is_explained(fit):
        return vague
    doubt = effect.doubt(values, models.fits.prepared.log.longest)
    if doubt:
        return Rejection(Reason.NOT_BELIEVED, {"text": doubt})
    if ends:
        return next(iter(ends.values()))
    x, was = fit.space.to_unit(fit.point), current.at.x
    determined = intervals(fit.at).identifiable
    for i in range(len(current.point)):
        at_bound = min(x[i], 1 - x[i]) < SETTINGS.near_bound <= min(was[i], 1 - was[i])
        bound = fit.space.low[i] if x[i] < 0.5 else fit.space.high[i]
        if determined[i] and bound != 0 and at_bound:
            facts = {"parameter": fit.space.names[i], "value": float(fit.point[i])}
            return Rejection(Reason.DRIVES_TO_BOUND, facts)
    return None


def at_end(placed: Placed, values: np.ndarray) -> dict[str, Rejection]:
    """Parameters of an effect at `values` (parameter,) that are at the end of their range, other than at null, and what
    that says against it.
    """
    return {
        name: Rejection(Reason.AT_END, {"parameter": f"{placed.name}.{name}", "value": value})
        for (name, _), value in ends(placed, values).items()
    }


def ends(placed: Placed, values: np.ndarray) -> dict[tuple[str, bool], float]:
    """Likewise the parameters and whether it is the upper end, and the values there."""
    effect, space = placed.effect, placed.effect.space
    x, null = space.to_unit(values), space.to_unit(space.nominal)
    near = np.minimum(x, 1 - x) < SETTINGS.near_bound
    return {
        (name, bool(x[i] > 0.5)): float(values[i])
        for i, name in enumerate(space.names)
        if near[i] and abs(x[i] - null[i]) > SETTINGS.near_bound and name not in effect.shares
    }


def needed_error(current: Fit, material: float) -> float:
    """The error above which a fit is `slight` beside `current`, which has to lose this share of its excess."""
    return float(np.sqrt(1.0 + (1.0 - material) * current.excess))


def as_good_error(current: Fit) -> float:
    """The error above which another model neither explains the log nor comes near `current`."""
    return max(needed_error(current, -SETTINGS.material), lack_of_fit(current.at).threshold)


def no_gain(current: Fit, fit: Fit | None, rival: Fit | None) -> Rejection | None:
    """Why `fit` explains no more than `current`, or None; rival: behind which it may have been stopped early."""
    if fit is not None and fit.promised is not None:
        return Rejection(Reason.PROMISES_TOO_LITTLE, {"promised": fit.promised, "left": current.error})
    if fit is not None and fit.penalised_squares < current.penalised_squares:
        return None
    if fit is not None and not fit.finished and rival is not None:
        return Rejection(Reason.FAR_BEHIND, {"rival": rival.effects[-1].name})
    return Rejection(Reason.NO_GAIN)


def slight(current: Fit, fit: Fit, material: float) -> Rejection | None:
    """Why `fit`, which has to take this share, is no explanation of what `current` leaves above the noise, or None."""
    taken = current.excess - fit.excess
    if taken >= material * current.excess:
        return None
    share = taken / max(current.excess, abs(taken))
    return Rejection(Reason.SLIGHT, {"share": share})


def leaves_something(current: Fit, fit: Fit, useful_error: float) -> Rejection | None:
    """What speaks against a `fit` that takes little of what the declared model left and is not below `useful_error`."""
    if fit.error <= useful_error:
        return None
    return Rejection(Reason.LITTLE_WAS_LEFT, {"before": current.error, "after": fit.error})
