"""How far a parameter may go before the log speaks against it: the profile of the error along its range.

Of a wheel that never slips a log says how well it grips at least, and sensitivities at the estimate say nothing. So the
parameter is held at places along its range, and the others and the initial states are refitted at each, by
sensitivities that every simulation mends. How far the error rises there, over what noise makes of that, says what the
log excludes: a profile likelihood (Venzon and Moolgavkar 1988). Where it begins to rise sensitivities are others: they
are measured at the outermost place that is not excluded, and those beyond are tried again from there, until nothing
moves outward.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.solve.base import Evaluate
from capture_cli.estimate.solve.intervals import noise_along
from capture_cli.estimate.solve.linearization import Linearization, Trial, columns, held_step


@frozen
class SETTINGS:
    # windows (Kish's effective number) that next to all is from which is known of a parameter
    few: float = 2.0
    # Times as far as sensitivities say that the limit is: one that hangs is not excluded there, either
    farther: float = 1.5
    places: int = 5  # at once, between the outermost that noise allows and the next
    again: int = 2  # of those beyond, the nearest, tried again with them
    levels: int = 5  # times, at most
    # of the range, between the outermost that noise allows and one that is excluded: close enough
    close: float = 0.01
    rounds: int = 4  # of simulations, at most, in which the others are refitted
    # of the objective over k, or of what the error is beyond the limit: not worth a simulation
    little: float = 0.1
    hopeless: float = 100.0  # times what noise allows: not worth one until the place is tried from nearer


@dataclass(frozen=True)
class Profile:
    """looked: the numbers of the parameters that it is of. excluded (parameter, 2): how far from below and from above
    the log excludes these, in the unit cube; nan where it does not exclude the end of the range. better: where the
    error is lower than at the estimate by what is worth to go on from, (parameters, corrections); the search ended
    there.
    """

    looked: Sequence[int]
    excluded: np.ndarray
    better: tuple[np.ndarray, np.ndarray] | None = None


def one_sided(at: Linearization, sd: np.ndarray, evaluate: Evaluate, *, limit: np.ndarray) -> list[int]:
    """The parameters that are known on one side alone: with a little more grip a wheel no longer slips, and any grip
    from there on is as good, whatever sensitivities say.

    sd (parameter,): in the unit cube; nan for those not to look at. limit: as of `profile`. Looked at are those of
    which next to all is known from one window; the others show too often for that, and cost nothing.
    """
    profiles, information = _Profiles(at, evaluate, limit), at.information
    windows = np.square(information.sum(axis=0)) / np.maximum(np.square(information).sum(axis=0), 1e-300)
    reach = SETTINGS.farther * np.sqrt(limit) * sd
    looked = np.flatnonzero((windows < SETTINGS.few) & np.isfinite(reach))
    ends = [(int(i), float(at.x[i] + way * reach[i])) for i in looked for way in (-1, 1)]
    places = [profiles.place(i, to, at) for i, to in ends if 0 <= to <= 1]
    profiles.refit(places)
    return sorted({place.held for place in places if place.at and place.allowed})


def profile(
    at: Linearization, which: Sequence[int], evaluate: Evaluate, *, limit: np.ndarray, worth: float
) -> Profile:
    """The profile of the parameters numbered `which` about the linearization `at`, which is at the estimate.

    evaluate: simulates trials. limit (parameter,): of the error's rise over its variance: the square of a quantile.
    worth: of the objective over k, by which a place has to be better to go on from there.
    """
    profiles = _Profiles(at, evaluate, limit)
    found = np.full((len(at.x), 2), np.nan)
    sides = [_Side(i, end, at) for i in which for end in (0, 1) if at.x[i] != end]
    for _ in range(1 + SETTINGS.levels):
        places = [[profiles.place(side.held, to, side.inside) for to in side.places()] for side in sides]
        profiles.refit([place for own in places for place in own])
        best = min((p.at for own in places for p in own if p.at), key=profiles.rise, default=at)
        if profiles.rise(best) < -worth * profiles.k:
            return Profile(which, found, (at.data.space.from_unit(best.x), best.corrections))
        for side, own in zip(sides, places, strict=True):
            side.tell(own)
            found[side.held, side.end] = side.limit
        sides = [side for side in sides if not side.is_done]
        for side in sides:
            side.inside = profiles.measured(side.inside)
    return Profile(which, found)


@dataclass
class _Place:
    """Parameter `held` at `to`, in the unit cube, and what the others, refitted, leave there.

    origin: the linearization that it begins with. asked: points (x, corrections) to simulate next. at: the best of
    those that were; None where all diverged, of which nothing is known. allowed: whether noise may be what the error is
    more than at the estimate, or nothing is known; excluded: whether not, and what more of a refit promises would not
    do.
    """

    held: int
    to: float
    origin: Linearization
    asked: list[tuple[np.ndarray, np.ndarray]]
    at: Linearization | None = None
    allowed: bool = True
    excluded: bool = False


@dataclass
class _Side:
    """From the estimate to one end of a parameter's range: the linearization at the outermost place that noise allows,
    and the places beyond, the nearest first; None before the end is tried.
    """

    held: int
    end: int
    inside: Linearization
    beyond: list[_Place] | None = None

    @property
    def limit(self) -> float:
        """The first place beyond that is excluded; nan where none is."""
        return next((place.to for place in self.beyond if place.excluded), np.nan)

    @property
    def is_done(self) -> bool:
        return not self.beyond or abs(self.limit - self.inside.x[self.held]) <= SETTINGS.close

    def places(self) -> list[float]:
        """Where to look next, from inside out: at first at the end, which may be as good."""
        if self.beyond is None:
            return [float(self.end)]
        between = np.linspace(self.inside.x[self.held], self.beyond[0].to, SETTINGS.places + 2)[1:-1]
        return [*between.tolist(), *(place.to for place in self.beyond[: SETTINGS.again])]

    def tell(self, places: Sequence[_Place]) -> None:
        """What was found at `places`, from inside out."""
        row = [*places, *(self.beyond or ())[SETTINGS.again :]]
        last = max((number for number, place in enumerate(row) if place.allowed), default=-1)
        if last >= 0 and row[last].at is not None:
            self.inside = row[last].at
        self.beyond = row[last + 1 :]


class _Profiles:
    """The error about the estimate `at`, with a parameter held and the others refitted."""

    def __init__(self, at: Linearization, evaluate: Evaluate, limit: np.ndarray):
        self.at, self.evaluate, self.limit = at, evaluate, limit
        self.k = at.inflation

    def rise(self, there: Linearization) -> float:
        """Of the objective, from the estimate to there."""
        return float((there.objectives(self.k) - self.at.objectives(self.k)).sum())

    def place(self, held: int, to: float, origin: Linearization) -> _Place:
        """To begin with the others as they are, and where the sensitivities say that they are best."""
        alone = origin.x.copy()
        alone[held] = to
        dx = self._step(origin, held, to - origin.x[held])
        ridge = np.clip(origin.x + dx, 0, 1)
        return _Place(
            held, to, origin, [(alone, origin.corrections), (ridge, origin.corrections_after(dx, self.k))]
        )

    def measured(self, there: Linearization) -> Linearization:
        """`there`, with its sensitivities measured where they were updated."""
        if not there.updates:
            return there
        trial = columns(self.at.data, there.x, there.corrections)
        return Linearization.from_columns(self.at.data, there.x, there.corrections, *self.evaluate(trial))

    def refit(self, places: Sequence[_Place]) -> None:
        """Refit the others at each place, for as long as it may turn out not to be excluded."""
        for _ in range(SETTINGS.rounds):
            active = [place for place in places if place.asked]
            before = [place.at for place in active]
            self.simulate(active)
            for place, was in zip(active, before, strict=True):
                if place.at is not was:
                    self._judge(place)

    def simulate(self, places: Sequence[_Place]) -> None:
        """What the places asked for; each keeps the best."""
        if not places:
            return
        x, corrections = (np.stack(part) for part in zip(*(a for p in places for a in p.asked), strict=True))
        outputs, diverged = self.evaluate(Trial(self.at.data.space.from_unit(x), corrections))
        residuals = self.at.data.residual(outputs)
        lost = diverged.any(axis=1) | ~np.isfinite(residuals).all(axis=(1, 2))
        told = iter(zip(residuals, lost, strict=True))
        for place in places:
            origin = place.at or place.origin
            for x, corrections in place.asked:
                residual, is_lost = next(told)
                if is_lost:
                    continue
                there = origin.moved(x, corrections, residual)
                if place.at is None or self.rise(there) < self.rise(place.at):
                    place.at = there
            place.asked = []

    def _judge(self, place: _Place) -> None:
        """Whether a place is excluded, and what to simulate next where that is not certain."""
        at, rise, allowed = place.at, self.rise(place.at), self._allowed(place)
        dx = self._step(at, place.held)
        corrections = at.corrections_after(dx, self.k)
        promised = at.predicted_gain(dx, corrections, self.k)
        place.allowed, place.excluded = rise <= allowed, rise - promised > allowed
        hopeless = rise - promised > SETTINGS.hopeless * allowed
        if not (place.allowed or hopeless) and promised > SETTINGS.little * max(self.k, rise - allowed):
            place.asked = [(np.clip(at.x + dx, 0, 1), corrections)]

    def _step(self, at: Linearization, held: int, by: float = 0.0) -> np.ndarray:
        """The step (parameter,) that moves the one that is held `by` so much, and the others to where they are best."""
        hessian, gradient = at.normal(self.k)
        rest = np.arange(len(at.x)) != held
        x, downhill = at.x[rest], (gradient - by * hessian[held])[rest]
        step = np.full(len(at.x), by)
        step[rest] = held_step(hessian[np.ix_(rest, rest)], downhill, self.k, -x, 1 - x)
        return step

    def _allowed(self, place: _Place) -> float:
        """By how much noise lets the objective rise from the estimate to a place.

        The limit times the variance of noise along the change, 1 where noise is white and as large as its floor.
        """
        b, gain, there = self.at.by_initial, self.at.initial_gain(self.k), place.at
        change = (there.residual - self.at.residual)[..., None] + b @ (there.z - self.at.z)[..., None]
        initial = gain @ (b.swapaxes(1, 2) @ change)  # that make up for it, as far as they do
        change -= b @ initial
        square = np.square(change).sum() + self.k * np.square(initial).sum()
        variance = noise_along(self.at, change)[0, 0] / square if square > 0 else self.k
        return self.limit[place.held] * variance
