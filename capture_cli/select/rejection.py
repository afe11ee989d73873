"""Data against an effect that lies in its fit: values at the end of a range, or next to nothing explained."""

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.fit import Fit
from capture_cli.estimate.noise.lack_of_fit import lack_of_fit
from capture_cli.estimate.solve.intervals import intervals
from capture_cli.model.effects.placed import Placed
from capture_cli.select.model_comparison import ModelComparison


@frozen
class SETTINGS:
    # Of the squared error above the noise floor: an effect that takes less away corrects a model that is
    # wrong otherwise
    material: float = 0.1
    # Of a range. A result file says "at its bound" from AT_BOUND on; but a descent gives up where its trust
    # region is this small, and an effect that ends so near to where its range does is drawn there.
    near_bound: float = 1e-3


def out_of_range(models: ModelComparison, current: Fit, fit: Fit, placed: Placed) -> str | None:
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
    if doubt or ends:
        return doubt or next(iter(ends.values()))
    x, was = fit.space.to_unit(fit.point), current.at.x
    determined = intervals(fit.at).identifiable
    for i in range(len(current.point)):
        at_bound = min(x[i], 1 - x[i]) < SETTINGS.near_bound <= min(was[i], 1 - was[i])
        bound = fit.space.low[i] if x[i] < 0.5 else fit.space.high[i]
        if determined[i] and bound != 0 and at_bound:
            return f"it drives {fit.space.names[i]} to its bound ({fit.point[i]:.3g})"
    return None


def at_end(placed: Placed, values: np.ndarray) -> dict[str, str]:
    """Parameters of an effect at `values` (parameter,) that are at the end of their range, other than at null, and how
    to say so.
    """
    return {
        name: f"it would have to be at the end of its range ({placed.name}.{name} = {value:.3g})"
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


def no_gain(current: Fit, fit: Fit | None, rival: Fit | None) -> str | None:
    """Why `fit` explains no more than `current`, or None; rival: behind which it may have been stopped early."""
    if fit is not None and fit.promised is not None:
        return f"its score test promises {fit.promised:.4g} noise floors where {current.error:.4g} are left: too little"
    if fit is not None and fit.penalised_squares < current.penalised_squares:
        return None
    if fit is not None and not fit.finished and rival is not None:
        return f"fitted jointly it stays far behind {rival.effects[-1].name}"
    return "fitted jointly it explains nothing more"


def slight(current: Fit, fit: Fit, material: float) -> str | None:
    """Why `fit`, which has to take this share, is no explanation of what `current` leaves above the noise, or None."""
    taken = current.excess - fit.excess
    if taken >= material * current.excess:
        return None
    share = taken / max(current.excess, abs(taken))
    return f"it takes {share:.1%} of what is above the noise floor: that is no explanation of it"


def leaves_something(current: Fit, fit: Fit, useful_error: float) -> str | None:
    """What speaks against a `fit` that takes little of what the declared model left and is not below `useful_error`."""
    if fit.error <= useful_error:
        return None
    return (
        f"the model without it leaves little, {current.error:.3g} times the noise floor, and with it {fit.error:.3g} "
        "are left all the same: a correction of a model that is wrong otherwise"
    )
