"""Fits of a task with effects to parts of a prepared log. What `diagnose` compares."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import takewhile

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.checkpoint import Checkpoint, checkpointed_fit, checkpointed_part
from capture_cli.estimate.escape import escaped
from capture_cli.estimate.fit import SETTINGS as FIT
from capture_cli.estimate.fit import Fit, least
from capture_cli.estimate.initial_states.refined import fit_initial_states
from capture_cli.estimate.part_fit import PartFit
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve.base import Best, Trial, run
from capture_cli.estimate.solve.intervals import unit_covariance
from capture_cli.estimate.solve.least_squares import SETTINGS as LEAST_SQUARES
from capture_cli.estimate.solve.least_squares import EarlyStop, LeastSquares
from capture_cli.estimate.solve.linearization import (
    Data,
    Known,
    Linearization,
    best_trials,
    columns,
    trial_objectives,
)
from capture_cli.estimate.solve.undetermined import is_confounded
from capture_cli.model.effects.placed import Placed
from capture_cli.model.parameters import ParameterSpace
from capture_cli.simulate.engine import Engine, Rollouts
from capture_cli.simulate.simulator import InitialConditions, Simulator


@frozen
class SETTINGS:
    fit_rounds: int = 60
    beside_null: float = 2.0  # steps of differences, which do not reach across it from there


@dataclass(frozen=True)
class Effort:
    """How hard a fit is tried. rounds, tolerance, starts and seed are those of LeastSquares.

    rival: a fit of the same part; this one is stopped early where it stays far behind, less early where it has fewer
    parameters: of two that do as well it would be the better. to_reach: the error that is asked of it; it is stopped,
    less early, where it stays far above. needed: the error above which the model is of no use; it is stopped where it
    does not promise to get there. material: the error that effects have to promise by their score test where they come
    in. at_minimum: whether it begins where a smaller model has its minimum. escapes: whether poor minima that contacts
    or hidden states make are escaped from.
    """

    rounds: int = SETTINGS.fit_rounds
    tolerance: float = FIT.tolerance
    starts: int = 1
    seed: int = 0
    rival: Fit | None = None
    to_reach: float = np.inf
    needed: float = np.inf
    material: float = np.inf
    at_minimum: bool = False
    escapes: bool = True


USUAL = Effort()


class ModelFits:
    """Fits models of `prepared.task` plus effects, on one engine. checkpoint: of an earlier run of the same steps.

    from_balance: whether the declared model begins where the force balance puts it, which has one minimum.
    """

    def __init__(
        self,
        prepared: PreparedLog,
        threads: int | None,
        checkpoint: Checkpoint | None = None,
        *,
        from_balance: bool = False,
    ):
        self.prepared = prepared
        self.from_balance = from_balance
        self.checkpoint = checkpoint
        self.engine = Engine(prepared.task.model, threads)
        self._elsewhere = 0

    @property
    def rollouts(self) -> int:
        """How many windows were simulated on the engine, and what else was added."""
        return self.engine.rollouts + self._elsewhere

    @rollouts.setter
    def rollouts(self, count: int) -> None:
        self._elsewhere = count - self.engine.rollouts

    @checkpointed_fit
    def fit(
        self,
        part: PreparedLog,
        effects: Sequence[Placed],
        start: np.ndarray,
        *,
        near: Fit | None = None,
        corrections: np.ndarray | None = None,
        effort: Effort = USUAL,
    ) -> Fit | None:
        """Fit from `start` (parameter,); None where every trial diverged.

        near: another fit of the same part. This one begins with its initial states of windows and, of another model
        and where they are better than those of `start`, its values, as far as they concern the declared parameters and
        the effects that both have; and with its sensitivities, of the effects that both begin with, until it measures
        its own. Where `near` lacks some of the effects it ends there if their score test promises too little; and if
        this one ends above it, it is begun again at it. corrections (window, state): of the initial states, where they
        begin, if not where `near` has them.
        """
        new, theirs = effects, () if near is None else near.effects
        added, lost = _not_in(theirs, effects), _not_in(effects, theirs)
        is_smaller = near is not None and added and not lost
        is_other = near is not None and (added or lost)
        if is_smaller and (slight := self._slight_at_null(near, part, effects, start, effort)):
            return slight
        if corrections is None and near is not None:
            corrections = near.corrections
        if corrections is not None:
            transferred = self._transferred(corrections, theirs, effects)
            points = [start, self.as_near(near, effects, start)] if is_other else [start]
            start, corrections = self._nearer(
                part, effects, points, [transferred, np.zeros_like(transferred)]
            )
            new = added
        corrections = self._with_states_found(part, effects, start, corrections, new)
        fit = self._descended(part, effects, start, corrections, effort, near)
        if is_smaller and (fit is None or fit.error > near.error):
            fit = least([fit, self._descended_from(near, part, effects, start, effort)])
        tried = searched(added)
        if effort.escapes and (tried or (part.difference_step and not effects and not self.from_balance)):
            fit = self._escaped(part, fit, effects, effort)
        return fit

    @checkpointed_fit
    def escaped(
        self, part: PreparedLog, effects: Sequence[Placed], start: np.ndarray, *, near: Fit, effort: Effort
    ) -> Fit | None:
        """`near`, a fit with the `effects` that ended at `start` (parameter,), or where the escape from its minimum
        leads.
        """
        return self._escaped(part, near, effects, effort)

    def _escaped(
        self, part: PreparedLog, fit: Fit | None, effects: Sequence[Placed], effort: Effort
    ) -> Fit | None:
        descend = partial(self._descended, part, effects, effort=replace(effort, starts=1))
        return escaped(self, part, fit, effort.rival, descend)

    def as_near(self, near: Fit, effects: Sequence[Placed], start: np.ndarray) -> np.ndarray:
        """`start` (parameter,) of a model with `effects`, with what it has in common with `near` as it is there."""
        point, declared, known = start.copy(), self.parameter_count(()), {e.name for e in near.effects}
        point[:declared] = near.point[:declared]
        for placed, own in self._parameters(effects):
            if placed.name in known:
                point[own] = near.point[near.columns(placed.name)]
        return point

    def _descended_from(
        self, near: Fit, part: PreparedLog, effects: Sequence[Placed], start: np.ndarray, effort: Effort
    ) -> Fit | None:
        """The fit of a model with `effects` that begins at `near`, which lacks some of them."""
        begin = self._with_null(near, effects, start)
        return self._descended(part, effects, *begin, replace(effort, at_minimum=True), near)

    def _slight_at_null(
        self, near: Fit, part: PreparedLog, effects: Sequence[Placed], start: np.ndarray, effort: Effort
    ) -> Fit | None:
        """The model with `effects` at `near`, which lacks some of them, where their score test does not promise what is
        `material`: of the gain of the linearization with them, what that of `near` does not have. None where it does,
        or says nothing: what begins at a threshold has no slope, and where outputs jump it is not kept, while fits with
        more lead out of poor minima. It is on the side of `start`, for there may be a kink at null: friction that falls
        below zero in neither direction acts in one.
        """
        added = _not_in(near.effects, effects)
        if not np.isfinite(effort.material) or any(e.effect.has_threshold for e in added):
            return None
        simulator = self.simulator(effects)
        data = part.data(simulator)
        if data.rough:
            return None
        point, corrections = self._with_null(near, effects, start)
        known = self._known(near, effects, data)
        new = [own for placed, own in self._parameters(effects) if placed in added]
        null = data.space.to_unit(point)
        beside = null.copy()
        for own in new:
            beside[own] += SETTINGS.beside_null * data.space.steps[own] * np.sign(start[own] - point[own])
        trial = columns(data, beside, corrections, known=known, near=True)
        outputs, diverged, *_ = part.answer(simulator, trial)
        at = Linearization.from_columns(data, beside, corrections, outputs, diverged)
        if known is not None:
            at = known.completed(at)
        at = replace(at, x=null, residual=near.at.residual)
        shows = at.by_parameter.any(axis=(0, 1))
        if not all(shows[own].any() for own in new):
            return None
        gain = at.whole_gain(at.inflation) - near.at.whole_gain(at.inflation)
        promised = float(np.sqrt(max(near.error**2 - gain / data.count, 0.0)))
        if promised <= effort.material:
            return None
        found = self.at(part, effects, Best(point, corrections, near.error), at, measured=False)
        return replace(found, finished=False, promised=promised)

    def _with_null(
        self, near: Fit, effects: Sequence[Placed], start: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Parameters (parameter,) and corrections (window, state) of `near` with those of the `effects` that it lacks:
        as large as where there is none, with their shapes as in `start` (parameter,).
        """
        point, known = self.as_near(near, effects, start), {e.name for e in near.effects}
        for placed, own in self._parameters(effects):
            if placed.name not in known:
                effect = placed.effect
                is_shape = [p.name in effect.shapes for p in effect.parameters]
                point[own] = np.where(is_shape, point[own], effect.space.nominal)
        return point, self._transferred(near.corrections, near.effects, effects)

    def _parameters(self, effects: Sequence[Placed]) -> Iterator[tuple[Placed, slice]]:
        """Each effect, and which of the model's parameters are its own."""
        return _own_part(effects, "parameters", self.parameter_count(()))

    def _nearer(
        self,
        part: PreparedLog,
        effects: Sequence[Placed],
        points: Sequence[np.ndarray],
        begins: Sequence[np.ndarray],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Of `points`, each (parameter,), the best, and there of each window the best of `begins`, each (window,
        state).

        Initial states that stood in for what a model lacked are far from those of a model that has it.
        """
        simulator = self.simulator(effects)
        data = part.data(simulator)
        trials = np.tile(np.stack(begins), (len(points), 1, 1))
        each = np.repeat(np.stack(points), len(begins), axis=0)
        outputs, diverged = part.evaluate(simulator, Trial(each, trials))
        values = trial_objectives(data, trials, outputs, diverged, 1.0)
        values = values.reshape(len(points), len(begins), -1)
        best = int(np.argmin(values.min(axis=1).sum(axis=1)))
        return points[best], best_trials(np.stack(begins), values[best])[0]

    def _with_states_found(
        self,
        part: PreparedLog,
        effects: Sequence[Placed],
        point: np.ndarray,
        corrections: np.ndarray | None,
        new: Sequence[Placed],
    ) -> np.ndarray | None:
        """`corrections` (window, state) with those states of the `new` effects that may be anywhere where they are best
        at `point` (parameter,), of the values tried in every window.

        From a phase on the wrong side of the circle a descent would sooner take the force away than turn it.
        """
        if not any(effect.states_anywhere and effect.states for _, effect in new):
            return corrections
        simulator = self.simulator(effects)
        data = part.data(simulator)
        found = np.zeros(data.initial_sd.shape) if corrections is None else corrections
        anywhere = {e.name for e in new if e.effect.states_anywhere and e.effect.states}
        for placed, own in self._states(effects):
            if placed.name in anywhere:
                effect = placed.effect
                trials = np.repeat(found[None], len(effect.states_tried), axis=0)
                trials[:, :, own] = effect.states_tried[:, None] * (data.initial_sd[:, own] > 0)
                points = np.repeat(point[None], len(trials), axis=0)
                outputs, diverged = part.evaluate(simulator, Trial(points, trials))
                found, _ = best_trials(trials, trial_objectives(data, trials, outputs, diverged, 1.0))
        return found

    def _descended(
        self,
        part: PreparedLog,
        effects: Sequence[Placed],
        start: np.ndarray,
        corrections: np.ndarray | None,
        effort: Effort,
        near: Fit | None = None,
    ) -> Fit | None:
        """Where least squares from `start` (parameter,) and `corrections` (window, state) ends; as `fit`."""
        rival, to_reach, tolerance = effort.rival, effort.to_reach, effort.tolerance
        simulator = self.simulator(effects)
        data = part.data(simulator)
        measured = tolerance < FIT.tolerance
        simpler = rival is not None and len(simulator.space) < len(rival.space)
        to_beat = to_reach if rival is None else min(to_reach, rival.error)
        later = simpler or np.isfinite(to_reach)
        patience = LEAST_SQUARES.long_patience if later else LEAST_SQUARES.patience
        known = None if near is None else self._known(near, effects, data)
        solver = LeastSquares(
            data,
            start=start,
            corrections=corrections,
            known=known and replace(known, at_minimum=effort.at_minimum),
            starts=effort.starts,
            rounds=effort.rounds,
            tolerance=tolerance,
            seed=effort.seed,
            early_stop=EarlyStop(to_beat, patience, effort.needed),
            measured=measured,
        )
        best = run(solver, partial(part.answer, simulator))
        if not np.isfinite(best.error):
            return None
        fit = self.at(part, effects, best, solver.at, measured=measured)
        return replace(
            fit, finished=not (solver.stopped_early or fit.error > LEAST_SQUARES.hopeless * to_beat)
        )

    def _known(self, near: Fit, effects: Sequence[Placed], data: Data) -> Known | None:
        """What `near` says of the sensitivities of a model with `effects`."""
        same = _in_common(near.effects, effects)
        known = near.at.known_in(data, self.parameter_count(same), self._state_count(same))
        return known and replace(known, updates=known.updates + 1)

    def parameter_count(self, effects: Sequence[Placed]) -> int:
        """How many parameters the task has with `effects`."""
        return len(self.prepared.task.space) + sum(len(e.parameters) for _, e in effects)

    def _state_count(self, effects: Sequence[Placed]) -> int:
        """How many states a window begins with, those of the task's effects and of `effects` included."""
        known = [placed for placed, _ in self.prepared.task.effects]
        return self.prepared.initial.sd.shape[1] + sum(len(e.states) for _, e in (*known, *effects))

    def at(
        self,
        part: PreparedLog,
        effects: Sequence[Placed],
        best: Best,
        known: Linearization | None = None,
        *,
        measured: bool = True,
    ) -> Fit:
        """The fit at what an identifier found on `part`, with the linearization there: a new one where none is `known`,
        or it was updated and has to be `measured`.
        """
        simulator = self.simulator(effects)
        if known is not None and not (measured and known.updates):
            return Fit(tuple(effects), simulator.space, best.parameters, known)
        data = part.data(simulator)
        x = simulator.space.to_unit(best.parameters)
        outputs, diverged = part.evaluate(simulator, columns(data, x, best.corrections))
        at = Linearization.from_columns(data, x, best.corrections, outputs, diverged)
        return Fit(tuple(effects), simulator.space, best.parameters, at)

    def sharpened(self, part: PreparedLog, fit: Fit) -> Fit:
        """`fit` to the part; where parameters are confounded, with sensitivities by central differences.

        The error of one-sided differences, small as it is, would tell them apart: where only ratios are known it would
        say how large they are.
        """
        if not is_confounded(unit_covariance(fit.at)[0]):
            return fit
        at = fit.at
        return replace(fit, at=at.with_central(*part.evaluate(self.simulator(fit.effects), at.central())))

    def errors(self, part: PreparedLog, points: np.ndarray) -> np.ndarray:
        """RMSE over the noise floor of the task itself at points (candidate, parameter); inf where one diverged."""
        simulator = self.simulator([])
        data = part.data(simulator)
        trial = Trial(points, np.zeros((len(points), *data.initial_sd.shape)))
        outputs, diverged = part.evaluate(simulator, trial)
        square = np.square(data.residual(outputs)).sum(axis=(1, 2)) / data.count
        return np.where(diverged.any(axis=1) | ~np.isfinite(square), np.inf, np.sqrt(square))

    def nearest(self, part: PreparedLog, points: np.ndarray) -> np.ndarray:
        """Of points (candidate, parameter) of the task the one with the smallest error."""
        return points[np.argmin(self.errors(part, points))]

    def objectives(self, part: PreparedLog, fit: Fit, on: PartFit, points: np.ndarray) -> np.ndarray:
        """The objective (point,) of the fit's model at points (point, parameter); inf where one diverged.

        on: the part at the fit, whose initial states are left as they are.
        """
        corrections = np.repeat(on.corrections[None], len(points), axis=0)
        outputs, diverged = part.evaluate(self.simulator(fit.effects), Trial(points, corrections))
        return trial_objectives(on.data, corrections, outputs, diverged, fit.at.inflation).sum(axis=1)

    @checkpointed_part
    def on(
        self,
        part: PreparedLog,
        fit: Fit,
        tolerance: float = FIT.tolerance,
        corrections: np.ndarray | None = None,
        *,
        thorough: bool = False,
    ) -> PartFit:
        """What the fit leaves of a part of the log, with initial states refined by the rule they were fitted by.

        corrections (window, state): where they begin; as the log has them where None.
        """
        begin = corrections
        if begin is None:
            begin = np.zeros((len(part.windows), fit.corrections.shape[1]))
            begin = self._with_states_found(part, fit.effects, fit.point, begin, fit.effects)
        return PartFit.of(self.initial_states_at(part, fit, tolerance, begin, thorough=thorough))

    def initial_states_at(
        self,
        part: PreparedLog,
        fit: Fit,
        tolerance: float,
        corrections: np.ndarray,
        also: np.ndarray | None = None,
        *,
        thorough: bool = False,
    ) -> Linearization:
        """The part's windows linearized in their initial states alone, where those are best at the fit's parameters;
        searched from `corrections` and, where given, `also` (window, state) on.
        """
        simulator = self.simulator(fit.effects)
        data = replace(part.data(simulator), space=ParameterSpace([]))

        def evaluate(keep: np.ndarray, trial: Trial):
            points = np.repeat(fit.point[None], len(trial), axis=0)
            return part.evaluate_windows(simulator, keep, replace(trial, parameters=points))

        return fit_initial_states(
            data, evaluate, corrections, tolerance=tolerance, also=also, thorough=thorough
        )

    def probe(
        self,
        part: PreparedLog,
        fit: Fit,
        effect: Placed,
        probes: np.ndarray,
        states: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Outputs as residuals (probe, window, row), and which probes diverged (probe,).

        The fit's model with `effect` added at the values `probes` (probe, parameter) of its parameters. states (probe,
        state): of its own, the same in all windows; 0 where None.
        """
        simulator = self.simulator((*fit.effects, effect))
        data = part.data(simulator)
        points = np.concatenate([np.repeat(fit.point[None], len(probes), axis=0), probes], axis=1)
        corrections = np.zeros((len(probes), *data.initial_sd.shape))
        known = fit.corrections.shape[1]
        corrections[:, :, :known] = fit.corrections  # the new effect's own states come last
        if states is not None:
            corrections[:, :, known : known + states.shape[1]] = states[:, None]
        outputs, diverged = part.evaluate(simulator, Trial(points, corrections))
        return data.residual(outputs), diverged.any(axis=1)

    def motion(self, part: PreparedLog, fit: Fit, corrections: np.ndarray | None = None) -> Rollouts:
        """What happens inside every window of the part, initial states moved by `corrections` (those of the fit where
        None).
        """
        simulator = self.simulator(fit.effects)
        initial = part.initial
        corrections = fit.corrections if corrections is None else corrections
        return simulator.motion(part.windows, initial.states, fit.point, corrections, initial.reported)

    def initial_conditions(self, part: PreparedLog, fit: Fit, corrections: np.ndarray) -> InitialConditions:
        """Where the simulation of every window of the part begins, its initial states moved by `corrections` (window,
        state).
        """
        return part.initial_conditions(self.simulator(fit.effects), fit.point, corrections)

    def simulator(self, effects: Sequence[Placed]) -> Simulator:
        """Simulates the task with `effects` on the shared engine."""
        own = self.prepared
        return Simulator(own.task, effects, engine=self.engine, difference_step=own.difference_step)

    def _transferred(
        self, corrections: np.ndarray, theirs: Sequence[Placed], effects: Sequence[Placed]
    ) -> np.ndarray:
        """Corrections (window, state) of a model with `effects`, from those of one with the effects `theirs`: of the
        machine's own states, and of the effects that both have; 0 for the others.
        """
        transferred = np.zeros((len(corrections), self._state_count(effects)))
        own = self._state_count(())
        transferred[:, :own] = corrections[:, :own]
        known = {placed.name: there for placed, there in self._states(theirs)}
        for placed, here in self._states(effects):
            if placed.name in known:
                transferred[:, here] = corrections[:, known[placed.name]]
        return transferred

    def _states(self, effects: Sequence[Placed]) -> Iterator[tuple[Placed, slice]]:
        """Each effect, and which of a window's states are its own."""
        return _own_part(effects, "states", self._state_count(()))


def searched(effects: Sequence[Placed]) -> list[Placed]:
    """Those whose hidden states are searched for where a descent gets stuck."""
    return [e for e in effects if len(e.effect.states_tried)]


def _own_part(effects: Sequence[Placed], what: str, first: int) -> Iterator[tuple[Placed, slice]]:
    """Each effect, and which part of a vector is its own that has `what` of all of them in a row from `first` on."""
    for placed in effects:
        own = slice(first, first + len(getattr(placed.effect, what)))
        first = own.stop
        yield placed, own


def _not_in(known: Sequence[Placed], effects: Sequence[Placed]) -> list[Placed]:
    """Those of the effects whose names none of the `known` has."""
    names = {e.name for e in known}
    return [e for e in effects if e.name not in names]


def _in_common(theirs: Sequence[Placed], effects: Sequence[Placed]) -> list[Placed]:
    """The effects, by their names, that both begin with."""
    pairs = zip(theirs, effects, strict=False)
    return [one for one, _ in takewhile(lambda pair: pair[0].name == pair[1].name, pairs)]
