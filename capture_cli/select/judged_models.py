"""The declared model and each with one effect more: refitted, and what each leaves of every part of the log."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from capture_cli.estimate.fit import SETTINGS as FIT_SETTINGS
from capture_cli.estimate.fit import Fit
from capture_cli.estimate.model_fits import Effort, ModelFits
from capture_cli.estimate.noise.lack_of_fit import LackOfFit, lack_of_fit
from capture_cli.estimate.part_fit import PartFit
from capture_cli.estimate.solve.intervals import Intervals, intervals
from capture_cli.select.log_parts import FIT, SELECT, TEST, LogParts
from capture_cli.select.minima import minima
from capture_cli.select.model_comparison import ModelComparison, initial_states_found
from capture_cli.select.time_limit import Made, TimeLimit

# what is tried, its number, of how many, what was found so far
OnStep = Callable[[str, int, int, Sequence[str]], None]


@dataclass(frozen=True)
class JudgedModel:
    """A model with what judges it.

    fit: to the fit part. again: to all that is not test; the same where it is not refitted. minima: others of the same,
    nearly as good. judged: the fit on what it did not see; None where nothing judges. whole: `again` on every window.
    """

    name: str
    fit: Fit
    again: Fit
    minima: list[Fit]
    judged: PartFit | None
    whole: PartFit

    @property
    def is_refitted(self) -> bool:
        return self.again is not self.fit

    @cached_property
    def lacking(self) -> LackOfFit:
        """What it leaves of what it was fitted to: of the fit part, or of all that is not test, whichever is more."""
        return max((lack_of_fit(f.at) for f in (self.fit, self.again)), key=lambda lack: lack.normalized)

    @cached_property
    def intervals(self) -> Intervals:
        """Intervals of the refit's parameters, which reach to the other minima that are nearly as good."""
        return intervals(self.again.at, [m.at for m in self.minima])


@dataclass(frozen=True)
class Closing:
    """What it takes, s, to make a row of the declared model: to refit it, and to work out the initial states of all
    windows.

    What follows a search takes as much for the model that was found, and some more simulations of the log.
    """

    refit: float = 0.0
    whole: float = 0.0

    @property
    def after_refit(self) -> float:
        """s; for errors in open loop every window is simulated a few times, which are about as many again."""
        return 2 * self.whole

    @property
    def after_search(self) -> float:
        """s, with a refit, and a descent beside it, which shows whether the error has other minima. What was fitted to
        first order is linearized once more in its refit than the declared model, which was not.
        """
        return 3 * self.refit + self.after_refit


class JudgedModels:
    """Makes them, as far as the `limit` leaves time. on_step: as of `explain`."""

    def __init__(
        self,
        fits: ModelFits,
        parts: LogParts,
        limit: TimeLimit,
        seed: int,
        on_step: OnStep,
    ):
        self.fits, self.parts, self.limit = fits, parts, limit
        self.seed, self.on_step = seed, on_step
        self.closing = Closing()

    def in_time(self, make: Callable[[], Made], what: str) -> Made | None:
        """What `make` makes where that leaves the time that errors in open loop take; None otherwise."""
        return self.limit.made(make, what, keeping=self.closing.whole)

    def first(self, compared: ModelComparison, declared: Fit) -> JudgedModel:
        """The declared model. How long it takes tells what is to be kept free for the last one."""
        judged, times = compared.judge(declared), [self.limit.now()]
        again = self._again(declared, judged)
        times.append(self.limit.now())
        whole = self._whole(declared, again, judged)
        times.append(self.limit.now())
        self.closing = Closing(*np.diff(times))
        return JudgedModel("declared", declared, again or declared, [], judged, whole)

    def each(self, compared: ModelComparison, first: JudgedModel, last: Fit) -> list[JudgedModel]:
        """The declared model and each with one more accepted effect; of these the last is refitted."""
        names = [e.name for e in last.effects]
        after = self._last(compared, first, last)
        between = []
        for count in range(1, len(names)):
            self.on_step("refit", count - 1, len(names) - 1, names)
            name = f"+ {names[count - 1]}"
            row = self.in_time(partial(self._between, compared, last, count, name), f"the row of {name}")
            between += [] if row is None else [row]
        if not names:
            return [after]
        declared = compared.nested(last, 0)
        before = first if declared is first.fit else self.first(compared, declared)
        return [before, *between, after]

    def _last(self, compared: ModelComparison, first: JudgedModel, fit: Fit) -> JudgedModel:
        """The model that was found, with other minima of its error, where they may explain the log as well."""
        self.on_step("refit", 0, 1, [e.name for e in fit.effects])
        judged, part, others = compared.judge(fit), self.parts.windows(FIT, SELECT), []
        known = fit is first.fit
        begun = (first.again if first.is_refitted else None) if known else self._again(fit, judged)
        again = begun
        if begun is not None and not lack_of_fit(begun.at).lacking:
            found = self.limit.made(
                lambda: minima(self.fits, part, begun, self.seed),
                "other values that may explain the log as well",
                keeping=self.closing.after_refit,
            )
            again, *others = found or [begun]
        whole = first.whole if known and again is begun else self._whole(fit, again, judged)
        if again is not None:
            again = self.fits.sharpened(part, again)
        name = f"+ {fit.effects[-1].name}" if fit.effects else "declared"
        return JudgedModel(name, fit, again or fit, others, judged, whole)

    def _between(self, compared: ModelComparison, last: Fit, count: int, name: str) -> JudgedModel:
        """The model with the first `count` effects of the `last`, by the fit that it was compared by."""
        fit = compared.nested(last, count)
        judged = compared.judge(fit)
        return JudgedModel(name, fit, fit, [], judged, self._whole(fit, None, judged))

    def _again(self, fit: Fit, judged: PartFit | None) -> Fit | None:
        """The refit; None where it diverges, or there is no time for it."""
        return self.limit.made(
            lambda: self.refitted(fit, judged),
            f"a refit of the {'last' if fit.effects else 'declared'} model to all that is not held out",
            keeping=self.closing.after_refit,
        )

    def refitted(self, fit: Fit, judged: PartFit | None) -> Fit | None:
        """`fit` on all that is not test, from where it ended."""
        known = initial_states_found(self.parts.folds, fit.corrections, judged and judged.corrections)
        return self.fits.fit(
            self.parts.windows(FIT, SELECT),
            fit.effects,
            fit.point,
            near=fit,
            corrections=known[self.parts.number != TEST],
            effort=Effort(tolerance=FIT_SETTINGS.exact),
        )

    def _whole(self, fit: Fit, again: Fit | None, judged: PartFit | None) -> PartFit:
        """The refit, or the fit where there is none, on every window; what was held out has no say in the others.

        judged: the fit on what judges.
        """
        number, folds = self.parts.number, self.parts.folds
        if again is not None:
            where = [number != TEST]
            parts = [self.fits.on(self.fits.prepared.part(where[0]), again, corrections=again.corrections)]
        else:
            where, parts = [folds.fit], [PartFit.of(fit.at)]
            if len(folds.folds) == 1:
                where, parts = [*where, folds.seen & ~folds.fit], [*parts, judged]
            if (rest := (number != TEST) & ~folds.seen).any():
                where, parts = [*where, rest], [*parts, self.fits.on(self.fits.prepared.part(rest), fit)]
        if (number == TEST).any():
            thorough = not lack_of_fit((again or fit).at).lacking
            where.append(number == TEST)
            parts.append(self.fits.on(self.fits.prepared.part(where[-1]), again or fit, thorough=thorough))
        order = np.argsort(np.concatenate([np.flatnonzero(w) for w in where]))
        return PartFit.concatenate(parts).rows(order)
