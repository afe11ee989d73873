"""What the log says of parameters that it does not determine: at least so much, or at most."""

from functools import partial

import numpy as np

from capture_cli.estimate.fit import SETTINGS as FIT
from capture_cli.estimate.fit import Fit
from capture_cli.estimate.model_fits import ModelFits
from capture_cli.estimate.noise.lack_of_fit import lack_of_fit
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve._profile import Profile, one_sided, profile
from capture_cli.estimate.solve.intervals import Intervals


def profiled(
    fits: ModelFits, part: PreparedLog, fit: Fit, found: Intervals, *, worth: float = FIT.as_good
) -> Profile | None:
    """The profile of what the intervals `found` of the `fit` to the part say is not identifiable, or is not as well
    known as they say; None where there is neither, and where the model lacks something: noise is not what is left then.

    worth: of the objective over k, by which a place along it has to be better than the fit to end there.
    """
    if lack_of_fit(fit.at).lacking:
        return None
    evaluate = partial(part.evaluate, fits.simulator(fit.effects))
    # that one shows in a single window may be chance, which had all windows to choose from
    among = np.where(found.identifiable, len(part.windows), 1)
    limit = np.square([found.quantile(number) for number in among])
    sd = np.where(found.identifiable, found.sd / fit.space.span, np.nan)
    known_on_one_side = one_sided(fit.at, sd, evaluate, limit=limit)
    which = sorted([*np.flatnonzero(~found.identifiable).tolist(), *known_on_one_side])
    return profile(fit.at, which, evaluate, limit=limit, worth=worth) if which else None


def with_limits(fits: ModelFits, part: PreparedLog, fit: Fit, found: Intervals) -> Intervals:
    """`found`, the intervals of the `fit` to the part, with the limits of what is not identifiable."""
    seen = profiled(fits, part, fit, found, worth=np.inf)
    return found if seen is None else found.limited(fit.space, seen.looked, seen.excluded)
