"""What explains a log: the declared model and each with one more effect, what judges them, and the verdict."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from capture_cli.estimate.held_out import HeldOut
from capture_cli.estimate.noise.lack_of_fit import LackOfFit
from capture_cli.estimate.noise.time_stamp_jitter import TimeStampJitter, time_stamp_jitter
from capture_cli.estimate.part_fit import PartFit
from capture_cli.estimate.solve.intervals import Intervals
from capture_cli.estimate.time_step import ShorterStep
from capture_cli.select.candidates import Candidate
from capture_cli.select.expression import ExpressionTerm, formula
from capture_cli.select.judged_models import JudgedModel
from capture_cli.select.log_parts import TEST, LogParts
from capture_cli.select.search.answer import Accepted
from capture_cli.simulate.engine import Rollouts
from capture_cli.simulate.simulator import InitialConditions


@dataclass(frozen=True)
class Expression:
    """A sparse expression for the force that is still missing; no terms where none holds.

    coefficients, sd (term,). values: of every parameter of the model with it, by name. judged, held_out: that model on
    what it did not see, and on the test part.
    """

    terms: Sequence[ExpressionTerm] = ()
    coefficients: Sequence[float] = ()
    sd: Sequence[float] = ()
    values: Mapping[str, float] = field(default_factory=dict)
    judged: PartFit | None = None
    held_out: PartFit | None = None

    @property
    def text(self) -> str:
        return formula(self.terms, self.coefficients) if self.terms else "no expression explains what is left"


@dataclass(frozen=True)
class Explanation:
    """What the protocol found in a log.

    models: the declared one, then each with one more of the `accepted` effects. sure: how well the last is known.
    motion: of that, in every window. begun: where that begins. held_out: whether that model holds on the test part.
    shorter_step: what the model's time step is in that model's values; None where nothing.
    next_experiment: what would separate the first tie. rollouts: windows simulated in all. out_of_time: whether the
    search ended because its time was over; left_out: what else was not done for want of time, in words.
    """

    parts: LogParts
    accepted: list[Accepted]
    candidates: list[Candidate]
    models: list[JudgedModel]
    sure: Intervals
    motion: Rollouts
    initial_conditions: InitialConditions
    held_out: HeldOut
    shorter_step: ShorterStep | None
    next_experiment: dict[str, Any] | None
    expression: Expression | None = None
    rollouts: int = 0
    out_of_time: bool = False
    left_out: tuple[str, ...] = ()

    @property
    def before(self) -> JudgedModel:
        return self.models[0]

    @property
    def after(self) -> JudgedModel:
        return self.models[-1]

    @property
    def leaves_something(self) -> bool:
        """Whether the last model does not explain what it was fitted to."""
        return not self.after.lacking.is_near

    @property
    def stamps(self) -> TimeStampJitter | None:
        """What the last model leaves says of the log's time stamps."""
        number, last = self.parts.number, self.after
        fitted = number != TEST if last.is_refitted else self.parts.folds.fit
        return time_stamp_jitter(self.parts.prepared, last.whole, last.again.at, fitted)

    @cached_property
    def verdict(self) -> str:
        before = self.before.whole.rows(self.parts.number == TEST)
        return verdict(self.before.lacking, self.after.lacking, before, self.held_out, self.accepted)


def verdict(
    before: LackOfFit,
    after: LackOfFit,
    held_out_before: PartFit,
    held_out: HeldOut,
    accepted: Sequence[Accepted],
) -> str:
    """A model that does not hold on what was held out explains nothing, however well it fits the rest."""
    if held_out.lacking:
        return "unexplained"
    # where the whole log moved the parameters, the error that was held out is of those before
    tested = held_out_before.data.count > 0 and held_out.whole is None
    if tested and accepted and held_out.lack.normalized >= held_out_before.normalized:
        return "unexplained"
    if not (before.lacking or accepted):
        return "explained"
    if not accepted or not after.is_near:
        return "unexplained"
    return "tied" if any(a.tied_with for a in accepted) else "effect-found"
