"""The effects that a search found so far, and the candidates that it may take more from."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, field

from capture_cli.common.frozen import frozen
from capture_cli.estimate.fit import Fit
from capture_cli.estimate.part_fit import PartFit
from capture_cli.model.effects.placed import Placed
from capture_cli.select.candidates import Candidate
from capture_cli.select.criterion import Support
from capture_cli.select.model_comparison import SETTINGS as COMPARISON
from capture_cli.select.model_comparison import FittedSet, ModelComparison
from capture_cli.select.score import Score


@frozen
class SETTINGS:
    most_effects: int = 6
    # how many that the balance puts first have their score test through the simulator, where it finds nothing, or are
    # compared with what is in the answer
    likeliest: int = 8


@dataclass
class Accepted:
    """An effect in the model, candidates that did as well when it entered, and how it stands in the last model.

    score: when it entered, and so are those of the rivals: later, with it in the model, they answer to what it leaves.
    share: of the squared error above the noise floor of the declared model, or of the model before it where it took
    most of that, what it took when it entered.
    """

    placed: Placed
    score: Score | None
    rivals: list[Candidate]
    support: Support | None
    share: float
    tied: list[Candidate] = field(default_factory=list)

    @property
    def tied_with(self) -> list[str]:
        return [c.name for c in self.tied]

    @property
    def name(self) -> str:
        return self.placed.name


class Answer:
    """What a search found so far, among the candidates of `models`.

    on_step: as of `Attribution`. accepted: in the order of the model's effects.
    """

    def __init__(
        self,
        models: ModelComparison,
        on_step: Callable[[str, int, int, Sequence[Placed]], None],
    ):
        self.models, self.on_step = models, on_step
        self.accepted: list[Accepted] = []

    def step(self, what: str, number: int, total: int) -> None:
        """Tell what is being tried."""
        self.on_step(what, number, total, [a.placed for a in self.accepted])

    @property
    def candidates(self) -> Sequence[Candidate]:
        """All that may be found."""
        return self.models.candidates

    @property
    def outside(self) -> list[Candidate]:
        """Candidates that may be added."""
        return self.beside({a.name for a in self.accepted})

    def beside(self, inside: Set[str]) -> list[Candidate]:
        """Candidates that may be in a model with the effects `inside`: not these; and a model has one step."""
        has_step = any(c.placed.is_shorter_step for c in self.candidates if c.name in inside)
        others = [c for c in self.candidates if c.name not in inside]
        return [c for c in others if not (has_step and c.placed.is_shorter_step)]

    @property
    def count(self) -> int:
        """How many effects are accepted: of the catalogue a law at several places counts once."""
        return len({a.placed.law for a in self.accepted})

    def support(
        self, without: Fit, fit: Fit, some: Sequence[Accepted | Candidate]
    ) -> tuple[Support, PartFit | None]:
        """The support for `some` effects in `fit` over the model `without` them, each the best of all candidates, and
        how `fit` does on what judges.
        """
        return self.models.support(without, fit, [self.candidate(a.name) for a in some], len(self.candidates))

    def candidate(self, name: str) -> Candidate:
        """The one that is called so."""
        return next(c for c in self.candidates if c.name == name)

    def accept(self, chosen: FittedSet, rivals: list[Candidate], current: Fit) -> Fit:
        """Accept the effects of the set `chosen`, whose model it returns. current: the model without them."""
        taken = current.excess - chosen.fit.excess
        of = current.excess if taken > COMPARISON.most * current.excess else self.models.excess
        share = taken / of / len(chosen.added)
        for placed in chosen.added:
            candidate = self.candidate(placed.name)
            candidate.rejection = None
            self.accepted.append(Accepted(placed, candidate.score, rivals, chosen.support, share))
        return chosen.fit
