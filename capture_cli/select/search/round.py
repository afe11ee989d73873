"""One round of the search: sets of candidates fitted by simulation, judged on other windows, and one of them chosen."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from capture_cli.common.frozen import frozen
from capture_cli.common.similarity import similarity
from capture_cli.estimate.fit import Fit
from capture_cli.model.effects.placed import Placed
from capture_cli.select.candidates import Candidate
from capture_cli.select.fit_checks import out_of_range
from capture_cli.select.model_comparison import FittedSet, ModelComparison
from capture_cli.select.reason import Reason, Rejection
from capture_cli.select.score import Score


@frozen
class SETTINGS:
    # other candidates that an accepted effect is compared with once everything else is in the model
    rivals: int = 4
    # cosine of responses beyond which a candidate that was not fitted may still be a rival
    similar: float = 0.97


# What may be accepted, and candidates that did as well
Choice = tuple[FittedSet, list[Candidate]]


class Round:
    """What may be added to the model `current`, of the `candidates`.

    rival: of effects that are not among them; a fit that stays far behind it is stopped early. on_step is told what is
    being tried, the number of it, and of how many.

    ranked: candidates that their scores speak for, best first. supported: sets of them that hold on what judges.
    """

    def __init__(
        self,
        models: ModelComparison,
        current: Fit,
        candidates: Sequence[Candidate],
        *,
        rival: Fit | None = None,
        on_step: Callable[[str, int, int], None],
    ):
        self.models = models
        self.current = current
        self.candidates = {c.name: c for c in candidates}
        self.useful_error = models.useful_error(current)
        self.on_step = on_step
        self.ranked: list[Candidate] = []
        self.supported: list[FittedSet] = []
        self._best = rival

    def choose(self) -> Choice | None:
        """Of the supported sets the best, and of those it cannot be told from that with the fewest parameters. With it,
        where it is one effect, its rivals: the others of one, and what was not fitted and does nearly the same as one
        of these.
        """
        if not self.supported:
            self._reject_unfitted([])
            return None
        best = self.models.best_of(self.supported)
        as_good = [s for s in self.supported if s is best or self.models.as_good(best, s)]
        chosen = min(as_good, key=lambda s: (len(s.fit.point), s.fit.penalised_squares))
        names, rivals = [e.name for e in chosen.added], []
        for other in sorted(self.supported, key=lambda s: s.fit.penalised_squares):
            if len(other.added) == 1 and other.added[0].name not in names:
                self._reject(other.added, Rejection(Reason.LESS_DOES_IT, {"best": " and ".join(names)}))
                rivals.append(replace(self.candidates[other.added[0].name]))
        unfitted = self._reject_unfitted(names)
        if len(names) > 1:
            return chosen, []
        rivals = rivals[: SETTINGS.rivals]
        return chosen, [*rivals, *_alike(unfitted, [self.candidates[names[0]], *rivals])]

    def _judged(self, added: Sequence[Placed], fit: Fit) -> tuple[Rejection | None, FittedSet | None]:
        """What simulations of other windows say against the effects `added` in `fit`; where that is nothing, these with
        `fit`, or where the escape from its minimum leads.
        """
        candidates = [self.candidates[e.name] for e in added]
        support, _ = self.models.support(self.current, fit, candidates, len(self.candidates))
        if reason := support.reason_against_entry():
            return reason, None
        fit = self.models.escaped(fit, self._best, self.useful_error)
        return None, FittedSet(tuple(added), fit, self.models.judge(fit), support)

    def _out_of_range(self, added: Sequence[Placed], fit: Fit) -> Rejection | None:
        """What the values in `fit` say against one of the effects `added`."""
        return next((why for e in added if (why := out_of_range(self.models, self.current, fit, e))), None)

    def _reject(self, added: Sequence[Placed], reason: Rejection) -> None:
        """Say why an effect is out; of several at once none is out for that."""
        if len(added) == 1:
            self.candidates[added[0].name].rejection = reason

    def _reject_unfitted(self, names: Sequence[str]) -> list[Candidate]:
        """Say why candidates are out that nothing else is said of, but those called `names`; they are returned."""
        found = [c for c in self.ranked if c.rejection is None and c.name not in names]
        reject_at_first_sight(found, self.ranked)
        return found


def by_score(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Those that their scores speak for, best first."""
    return sorted((c for c in candidates if c.rejection is None), key=lambda c: -c.score.gain)


def do_the_same(one: Score, other: Score) -> bool:
    """Whether two effects do so nearly the same that either may be there in the place of the other."""
    return abs(similarity(one.response, other.response)) > SETTINGS.similar


def reject_at_first_sight(candidates: Sequence[Candidate], ranked: Sequence[Candidate]) -> None:
    """Say of candidates that were not worth a fit by how much the best of the `ranked` is ahead of them."""
    for candidate in candidates:
        gain, most = candidate.score.gain, ranked[0].score.gain
        candidate.rejection = Rejection(Reason.BEHIND_AT_FIRST_SIGHT, {"score": gain, "most": most})


def _alike(unfitted: Sequence[Candidate], held: Sequence[Candidate]) -> list[Candidate]:
    """Of candidates that were not fitted, those that do nearly the same as one of those that `held`."""
    alike = [c for c in unfitted if any(do_the_same(c.score, other.score) for other in held)]
    return [replace(c) for c in alike[: SETTINGS.rivals]]
