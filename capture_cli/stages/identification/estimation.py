"""How `identify` finds its point: by physics alone, or in rounds over the log's episodes and then by physics."""

from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from capture_cli.common.evenly_spread import evenly_spread
from capture_cli.common.frozen import frozen
from capture_cli.common.progress import Progress
from capture_cli.context.identifiers.base import finite
from capture_cli.estimate.difference_step import difference_step, hits_something
from capture_cli.estimate.escape import SETTINGS as ESCAPE
from capture_cli.estimate.escape import better_minimum
from capture_cli.estimate.fit import SETTINGS as FIT
from capture_cli.estimate.fit import Fit
from capture_cli.estimate.initial_states.of_windows import as_acted
from capture_cli.estimate.limits import profiled
from capture_cli.estimate.log_requirements import all_diverged
from capture_cli.estimate.model_fits import ModelFits
from capture_cli.estimate.noise.lack_of_fit import SETTINGS as LACK_OF_FIT
from capture_cli.estimate.noise.lack_of_fit import lack_of_fit
from capture_cli.estimate.part_fit import PartFit
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve._profile import Profile
from capture_cli.estimate.solve._sampled_posterior import SampledPosterior, is_rough, sampled_posterior
from capture_cli.estimate.solve.base import Best, Identifier, run
from capture_cli.estimate.solve.intervals import Intervals, intervals, unit_covariance
from capture_cli.estimate.solve.least_squares import LeastSquares
from capture_cli.estimate.solve.linearization import Linearization
from capture_cli.model.parameters import ParameterSpace
from capture_cli.options.identify import IdentifyOptions
from capture_cli.simulate.simulator import Simulator
from capture_cli.stages.identification.chosen_identifier import ChosenIdentifier
from capture_cli.stages.identification.in_context import InContext, LoggedRounds, logged_rounds, walk_log
from capture_cli.stages.recorded.recorded_estimate import EarlierEstimate


@frozen
class SETTINGS:
    # Simulated hits make the error a little rough: near the noise a descent can look for ever for what is not there.
    idle_rounds: int = 4
    # Away from the noise nothing is exact: the model is wrong. A descent is stopped early there where as many
    # rounds as these gained a small share of the squared error, or so little that as much again would not
    # bring it to the noise.
    idle_as_acted: int = 2
    idle_free: int = 3
    least_gain: float = 0.05
    clearly: float = 2.0  # noise floors: beyond what chance allows of any log worth the name
    far: float = 3.0  # noise floors: a log this far from explained may be explained from somewhere else
    # of the range, about the answer to labels, which leave as much open
    around: float = 0.1
    around_points: int = 81
    rounds: int = 100  # of simulations, at most, unless told otherwise
    # of the objective over k, by which an estimate that is off by its standard deviation is above the bottom
    one_sd: float = 1.0
    again: int = 20  # rounds, at most, of a descent from a better point near where one ended
    # Places along the range of a parameter that shows nowhere about the estimate, and, of the objective over k,
    # what shows
    along: int = 17
    shows: float = 0.1
    better: int = 3  # times, at most, that a profile is gone on from
    judged_by: int = 3  # entries of the log, at most, that the estimates of all rounds are compared on


@dataclass
class Found:
    """What was found, with `fits` made ready as it was found.

    history: the best so far (in rounds: each estimate), in order. known: the linearization at the best, where the
    search left it. fallback, elsewhere: as in `InContext.document`. sampled: what was simulated about the best, where
    the error is rough there. cut_short: after how many rounds the search was stopped, where it had not come to rest.
    profile: of the parameters that it does not determine, or where sensitivities do not tell how well.
    """

    fits: ModelFits
    best: Best
    history: list[Best]
    known: Linearization | None = None
    in_context: InContext | None = None
    fallback: bool = False
    elsewhere: bool = False
    sampled: SampledPosterior | None = None
    cut_short: int | None = None
    profile: Profile | None = None

    @cached_property
    def part(self) -> PreparedLog:
        """The fitted part of the log."""
        return self.fits.prepared.part(~self.fits.prepared.split.is_test)

    @cached_property
    def at(self) -> Fit:
        """The linearization at the best, on the fitted part of the log."""
        return self.fits.at(self.part, [], self.best, self.known)

    @property
    def lacking(self) -> bool:
        """Whether something is left that the noise does not explain."""
        return self.best.error > SETTINGS.clearly or lack_of_fit(self.at.at).lacking

    @property
    def contradicted(self) -> bool | None:
        """Whether it differs from what rounds in context proposed, beyond chance; None: not known."""
        if self.in_context is None:
            return None
        return self.in_context.contradicted_by(self.best.parameters, self.intervals.sd)

    @property
    def intervals(self) -> Intervals:
        """Intervals of the parameters, at the best."""
        found = intervals(self.at.at, sampled=self.sampled)
        seen = self.profile
        return found if seen is None else found.limited(self.at.space, seen.looked, seen.excluded)


@dataclass(frozen=True)
class Descents:
    """How a fit descends: from so many starts, in so many rounds at most. what: its name in the progress.

    idle_rounds: of a log that is not explained, the descent also ends when so many rounds gained next to nothing; of
    one that is explained, when what rounds gain is lost in its noise.
    """

    seed: int
    what: str = "fit"
    method: type[Identifier] = LeastSquares
    starts: int = 1
    rounds: int = SETTINGS.rounds
    idle_rounds: int | None = None


def by_physics(
    fits: ModelFits,
    start: np.ndarray,
    progress: Progress,
    descents: Descents,
    corrections: np.ndarray | None = None,
    known: Linearization | None = None,
) -> Found:
    """What is found from `start` (parameter,) and corrections of initial states, `corrections` (window, state).

    known: the linearization there, in which fewer initial states may move, if there is one. Raises FitError where every
    simulation diverged.
    """
    part = fits.prepared.part(~fits.prepared.split.is_test)
    simulator = fits.simulator([])
    data = part.data(simulator)
    what, rounds = descents.what, descents.rounds
    history: list[Best] = []
    idle = False

    def on_round(best: Best) -> None:
        nonlocal idle
        history.append(best)
        error = f"error {best.error:.3g} x noise floor" if np.isfinite(best.error) else "no fit yet"
        progress.step(f"{what}, round {min(len(history) + 1, rounds)} of at most {rounds}, {error}")
        idle = descents.idle_rounds is not None and _idle(history, data.count, descents.idle_rounds)
        if idle:
            solver.rounds_left = 0

    told = {}
    if known is not None and issubclass(descents.method, LeastSquares):
        told["known"] = known.known_in(data, len(simulator.space), data.initial_sd.shape[1])
    solver = descents.method(
        data,
        start=start,
        seed=descents.seed,
        rounds=rounds,
        starts=descents.starts,
        corrections=corrections,
        **told,
    )
    progress.doing(f"{what}, round 1 of at most {rounds}")
    best = run(solver, partial(part.evaluate, simulator), on_round)
    if not np.isfinite(best.error):
        raise all_diverged(fits.prepared.task)
    ran_out = not (solver.at_rest or idle)
    return Found(fits, best, history, solver.at, cut_short=rounds if ran_out else None)


def by_rounds(
    prepared: PreparedLog,
    chosen: ChosenIdentifier,
    options: IdentifyOptions,
    earlier: EarlierEstimate | None,
    start: np.ndarray,
    progress: Progress,
) -> Found:
    """Rounds over the fitted part of the log, then least squares from the best estimate of them.

    Where there are actions, the fit first takes the initial states that they give. If it does not explain the log,
    initial states are fitted as well. If that is far from explaining it, or the identifier was trained on nothing like
    the log, several places are tried, as without an identifier: the proposal may have been wrong.
    start (parameter,). Rounds are made with episodes that are not in the earlier estimate.
    """
    fits = ModelFits(as_acted(prepared), options.threads)
    fitted = ~prepared.split.is_test
    part = fits.prepared.part(fitted)
    progress.doing("rounds in context")
    new = fitted if earlier is None else fitted & earlier.new(prepared.windows)
    logged = logged_rounds(fits.prepared.part(new), chosen.checkpoint, chosen.path)
    logged = replace(logged, before=None if earlier is None else earlier.rounds)
    in_context = walk_log(chosen, logged, start, options, fits.engine, progress)
    estimates = in_context.walk.estimates[0]
    points = np.concatenate([start[None], estimates])
    if not logged.noise_sd.all():
        points = np.concatenate([points, _around(part.task.space, estimates[-1])])
    errors = _errors(fits, part, logged, points)
    none = np.zeros_like(part.initial.sd)
    history = [Best(p, none, float(e)) for p, e in zip(estimates, errors[1:], strict=False)]
    nearest = points[np.argmin(errors)]
    descents = Descents(options.seed, idle_rounds=SETTINGS.idle_as_acted)
    found = by_physics(fits, nearest, progress, descents)
    history += found.history
    fallback = found.lacking
    freed = replace(descents, what="fit with free initial states", idle_rounds=SETTINGS.idle_free)
    if fallback:
        found = _freed(ModelFits(prepared, options.threads), found, progress, freed)
        history += found.history
    elsewhere = fallback and (not in_context.in_family or found.best.error > SETTINGS.far) and found.lacking
    if elsewhere:
        freed = replace(freed, starts=options.starts, idle_rounds=None)
        found = _freed(found.fits, found, progress, freed)
        history += found.history
    found.history, found.in_context = history, in_context
    found.fallback, found.elsewhere = fallback, elsewhere
    return found


@dataclass(frozen=True)
class Refinement:
    """What `identify` does after the first fit. Each step returns what was found, or a better fit that began there."""

    progress: Progress
    seed: int
    threads: int | None = None

    def with_longer_differences(self, found: Found) -> Found:
        """`found`, fitted on with finite differences as long as contacts need them there.

        Their length was chosen at the nominal values, where a machine may hit what it does not hit at the estimate, and
        the other way about.
        """
        self.progress.doing("looking for the differences that contacts need")
        fits, part, best = found.fits, found.part, found.best
        step, rollouts = difference_step(part, self.threads, best.parameters, best.corrections)
        fits.rollouts += rollouts
        if step <= part.difference_step:
            return found
        longer = ModelFits(replace(fits.prepared, difference_step=step), self.threads)
        longer.rollouts = fits.rollouts
        what = "fit with longer differences"
        return _after(found, self._again(longer, (best.parameters, best.corrections), what))

    def escaped(self, found: Found) -> Found:
        """`found`; where bodies touch or joints stop, escaped from local minima as long as that is possible.

        Also where the log is explained: a descent may end where no step of parameters and initial states together leads
        down, standard deviations from the bottom, and its intervals would not know. Far from explained no bottom is
        the right one: an escape costs as much as a fit, and is taken only where it leads far down.
        """
        self.progress.doing("looking for a better minimum than where the fit ended")
        fits, part = found.fits, found.part
        if not hits_something(part, fits.simulator([]), found.best.parameters, found.best.corrections):
            return found
        for number in range(ESCAPE.escapes):
            what = f"escape {number + 1} of at most {ESCAPE.escapes}"
            self.progress.doing(f"{what}, looking for it")
            place = better_minimum(fits, part, found.at, whole_step=True, worth=_worth_of_an_escape(found))
            if place is None:
                break
            again = self._again(fits, place, what)
            if again.best.error >= found.best.error:
                break
            found = _after(found, again)
        return found

    def from_where_all_show(self, found: Found) -> Found:
        """`found`; where the error is insensitive to a parameter, from where it is sensitive, if that is better by more
        than chance: the grip of a wheel that never slips with the nominal one tells nothing, and less of it may explain
        what is left.
        """
        self.progress.doing("looking where all parameters show")
        for column in np.flatnonzero(found.at.at.insensitive):
            point = _where_it_shows(found, column)
            if point is not None:
                what = f"fit from where {found.at.space.names[column]} shows"
                again = self._again(found.fits, (point, found.at.at.corrections), what)
                gained = (found.best.error**2 - again.best.error**2) * found.at.at.data.count
                if gained > FIT.as_good * found.at.at.inflation:
                    return _after(found, again)
        return found

    def looked_about(self, found: Found) -> Found:
        """`found`; where it explains the log and its error is rough, from the likeliest point about it, with how sure
        that is: a descent may end on a bump there, and sensitivities tell of the bump.
        """
        if not len(found.best.parameters) or found.lacking:
            return found
        fits, at = found.fits, found.at.at
        covariance, _ = unit_covariance(at)
        evaluate = partial(found.part.evaluate, fits.simulator([]))
        if is_rough(at, covariance, evaluate):
            sampled = sampled_posterior(at, covariance, evaluate, self.seed)
            if sampled.gain > FIT.tolerance:
                what = "fit from the likeliest point about"
                found = _after(found, self._again(fits, (sampled.point, at.corrections), what))
            found = replace(found, sampled=sampled)
        return found

    def with_profile(self, found: Found) -> Found:
        """`found`, with what the log excludes of the parameters that it does not determine; from where the error along
        them is lower by more than chance, if it is.
        """
        self.progress.doing("looking for what the log excludes of each parameter")
        if found.cut_short is not None:
            return _sharpened(found)
        for worth in (*[FIT.as_good] * SETTINGS.better, np.inf):
            found = _sharpened(found)
            seen = profiled(found.fits, found.part, found.at, found.intervals, worth=worth)
            if seen is None or seen.better is None:
                break
            again = self._again(found.fits, seen.better, "fit from a better point along a parameter")
            found = replace(_after(found, again), sampled=None)  # that was about the point before
        return replace(found, profile=seen)

    def _again(self, fits: ModelFits, place: tuple[np.ndarray, np.ndarray], what: str) -> Found:
        """A short descent from `place`: parameters (parameter,), and corrections of initial states (window, state)."""
        return by_physics(
            fits, place[0], self.progress, Descents(self.seed, what, rounds=SETTINGS.again), place[1]
        )


def _worth_of_an_escape(found: Found) -> float:
    """How far down an escape must lead to be taken, in squares of standard deviations."""
    if found.best.error <= SETTINGS.clearly:
        return SETTINGS.one_sd
    at = found.at.at
    return max(SETTINGS.one_sd, SETTINGS.least_gain * at.objectives(at.inflation).sum() / at.inflation)


def _where_it_shows(found: Found, column: int) -> np.ndarray | None:
    """The best point (parameter,) along one parameter's range of those at which it shows; None where it never does.

    Closer where it begins to show: a wheel that slips more is far off, and one that slips less is like one that never
    does.
    """
    fits, at = found.fits, found.at.at
    now, k = at.objectives(at.inflation).sum(), at.inflation

    def along(places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        x = np.repeat(at.x[None], len(places), axis=0)
        x[:, column] = places
        points = found.at.space.from_unit(x)
        objectives = fits.objectives(found.part, found.at, PartFit.of(at), points)
        return points, objectives, np.abs(objectives - now) > SETTINGS.shows * k

    places = np.linspace(0, 1, SETTINGS.along)
    *_, shows = along(places)
    begins = np.flatnonzero(shows[1:] != shows[:-1])
    if not begins.size:
        return None
    closer = np.concatenate([np.linspace(places[i], places[i + 1], SETTINGS.along) for i in begins])
    points, objectives, shows = along(closer)
    return points[np.argmin(np.where(shows, objectives, np.inf))]


def _sharpened(found: Found) -> Found:
    """`found`, with sensitivities that tell what is known of parameters that are confounded."""
    return replace(found, known=found.fits.sharpened(found.part, found.at).at)


def _after(found: Found, again: Found) -> Found:
    """`found`, with the best of `again`, which went on from it."""
    return replace(
        found, fits=again.fits, best=again.best, known=again.known, history=[*found.history, *again.history]
    )


def _freed(fits: ModelFits, found: Found, progress: Progress, descents: Descents) -> Found:
    """What is found from there with initial states as free as the log leaves them."""
    fits.rollouts = found.fits.rollouts
    return by_physics(fits, found.best.parameters, progress, descents, found.best.corrections, found.known)


def _around(space: ParameterSpace, point: np.ndarray) -> np.ndarray:
    """Points (candidate, parameter) along each axis about `point` (parameter,)."""
    x = space.to_unit(point)
    moves = np.linspace(-SETTINGS.around, SETTINGS.around, SETTINGS.around_points)[:, None, None] * np.eye(
        len(space)
    )
    return space.from_unit(np.clip(x + moves.reshape(-1, len(space)), 0, 1))


def _idle(history: list[Best], count: int, unexplained_rounds: int) -> bool:
    """Whether a descent is over: the last rounds lowered the error over `count` numbers by nothing that counts."""
    errors = np.square([best.error for best in history])
    now = errors[-1]
    explained = now <= LACK_OF_FIT.practical**2
    rounds = SETTINGS.idle_rounds if explained else unexplained_rounds
    if len(errors) <= rounds:
        return False
    gain = errors[-1 - rounds] - now
    if explained:
        return bool(count * gain < FIT.tolerance * max(1.0, now))
    return bool(gain < (now - 1 if now < SETTINGS.far**2 else SETTINGS.least_gain * now))


def _errors(fits: ModelFits, part: PreparedLog, logged: LoggedRounds, points: np.ndarray) -> np.ndarray:
    """RMSE over the noise floor at points (candidate, parameter) where nothing else is fitted; inf where one diverged.

    Of a few trajectories, which begin where the action says; where what is observed has no noise, of the outputs.
    """
    if not logged.noise_sd.all():
        return fits.errors(part, points)
    some = evenly_spread(len(logged), SETTINGS.judged_by)
    actions = np.tile(logged.actions[some], (len(points), 1))
    simulator = Simulator(logged.task, engine=fits.engine)
    trajectories, diverged = simulator.trajectories(np.repeat(points, len(some), axis=0), actions)
    measured = np.tile(logged.measured[some], (len(points), 1, 1))
    square = np.square((measured - finite(trajectories, diverged)) / logged.noise_sd).mean(axis=(1, 2))
    square = np.where(diverged, np.inf, square).reshape(len(points), len(some))
    return np.sqrt(square.mean(axis=1))
