"""Fits of a task with effects to parts of a prepared log. What `diagnose` compares."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product, takewhile

import numpy as np

from capture_cli.diagnosis.acceptance import TINY, block_squares, correlation_steps
from capture_cli.diagnosis.lack_of_fit import lack_of_fit
from capture_cli.effects.placed import Placed
from capture_cli.identifiers._window_starts import fit_starts
from capture_cli.identifiers.base import Best, Evidence, Trial, run
from capture_cli.identifiers.intervals import unit_covariance
from capture_cli.identifiers.least_squares import HOPELESS, LONG_PATIENCE, PATIENCE, LeastSquares
from capture_cli.linearization import Linearization, best_trials, columns, trial_objectives
from capture_cli.parameters import ParameterSpace
from capture_cli.protocol.prepared_log import PreparedLog
from capture_cli.sim.engine import Engine
from capture_cli.simulator import Begun, Motion, Simulator

FIT_ROUNDS = 60
TOLERANCE = 0.1  # of the objective over k: a third of a standard error is enough to compare models by
EXACT = 3e-3  # for what is reported
WAYS_OUT = 5  # that are taken, of minima that contacts make
BEGUN_ANEW, BEGUN_AWAY = 3, 3.0  # descents to see whether there are other minima, and how far off, in sd
# Of the objective over k: 95 % of what chance makes of one number. A way out that gains less leads nowhere, and where
# contacts make the error rough there always is one.
AS_GOOD = 3.84
RETURNED = 0.5  # sd: a descent that ends as near as this to where another ended has come back to it


@dataclass(frozen=True)
class PartFit:
    """One part of the log at a fit's parameters, its starts refined.

    residual (window, row): in units of the noise. fitted_hidden (window,): as of a Linearization.
    """

    evidence: Evidence
    offsets: np.ndarray
    residual: np.ndarray
    fitted_hidden: np.ndarray

    @classmethod
    def of(cls, at: Linearization) -> PartFit:
        """The part that `at` is a linearization on."""
        return cls(at.evidence, at.offsets, at.residual, at.fitted_hidden)

    @classmethod
    def concatenate(cls, parts: Sequence[PartFit]) -> PartFit:
        """Several parts as one, padded to one shape."""
        first = parts[0].evidence
        steps = max(p.evidence.measured.shape[1] for p in parts)
        outputs = first.measured.shape[2]

        def padded(values: np.ndarray) -> np.ndarray:
            return np.pad(values, [(0, 0), (0, steps - values.shape[1])] + [(0, 0)] * (values.ndim - 2))

        evidence = Evidence(
            first.space,
            np.concatenate([padded(p.evidence.measured) for p in parts]),
            np.concatenate([padded(p.evidence.mask) for p in parts]),
            first.noise_sd,
            np.concatenate([p.evidence.start_sd for p in parts]),
            attitudes=first.attitudes,
        )
        residual = [padded(p.residual.reshape(p.evidence.measured.shape)) for p in parts]
        residual = np.concatenate(residual).reshape(len(evidence.measured), steps * outputs)
        offsets, hidden = (
            np.concatenate([getattr(p, n) for p in parts]) for n in ("offsets", "fitted_hidden")
        )
        return cls(evidence, offsets, residual, hidden)

    def rows(self, keep: np.ndarray) -> PartFit:
        """The windows at `keep`."""
        return PartFit(
            self.evidence.rows(keep), self.offsets[keep], self.residual[keep], self.fitted_hidden[keep]
        )

    @property
    def penalised_squares(self) -> np.ndarray:
        """Sum of squared residuals of each window, (window,), and what hidden states took of it by chance alone."""
        return np.square(self.residual).sum(axis=1) * self._penalty

    @property
    def _penalty(self) -> np.ndarray:
        """Factor on the squares of each window, (window,), for the free numbers that its hidden states are."""
        count = self.evidence.mask.sum(axis=(1, 2))
        return 1 + self.fitted_hidden / np.maximum(count, 1)

    @property
    def correlation_steps(self) -> float:
        """How many steps are worth one that is independent."""
        return correlation_steps(self.residual.reshape(self.evidence.measured.shape), self.evidence.mask)

    def blocks(self, length: int) -> np.ndarray:
        """Penalised squares summed over blocks of about `length` steps, (block,)."""
        by_step = np.square(self.residual.reshape(self.evidence.measured.shape)).sum(axis=2)
        by_step *= self._penalty[:, None]
        return block_squares(by_step, self.evidence.mask.any(axis=2), length)

    @property
    def rmse(self) -> np.ndarray:
        """Per output, in its unit, (output,); nan of one that has no sample here."""
        return np.sqrt(self._mean(np.square(self.in_units)))

    @property
    def mae(self) -> np.ndarray:
        """Mean absolute error per output, in its unit, (output,); nan of one that has no sample here."""
        return self._mean(np.abs(self.in_units))

    @property
    def normalized(self) -> float:
        """RMSE over the noise floor, over all outputs."""
        return float(np.sqrt(np.square(self.residual).sum() / max(self.evidence.count, 1)))

    @property
    def in_units(self) -> np.ndarray:
        """Residual (window, step, output) in the outputs' units."""
        return self.residual.reshape(self.evidence.measured.shape) * self.evidence.noise_sd

    def _mean(self, values: np.ndarray) -> np.ndarray:
        samples = self.evidence.mask.sum(axis=(0, 1))
        return np.where(samples > 0, values.sum(axis=(0, 1)) / np.maximum(samples, 1), np.nan)


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model: its effects, space and point (parameter,), and its linearization on the part it was fitted to.

    finished: False where it was given up, behind a rival.
    """

    effects: tuple[Placed, ...]
    space: ParameterSpace
    point: np.ndarray
    at: Linearization
    finished: bool = True

    def columns(self, name: str) -> slice:
        """Which of its parameters are those of the effect that is called `name`."""
        stop = len(self.space)
        for placed in reversed(self.effects):
            start = stop - len(placed.effect.parameters)
            if placed.name == name:
                return slice(start, stop)
            stop = start
        raise KeyError(name)

    def known_from(self, first: np.ndarray) -> Fit:
        """The fit, whose effects know no more than windows that begin at the steps `first` (window,) of the log say."""
        effects = [placed._replace(effect=placed.effect.fitted_to(first)) for placed in self.effects]
        return replace(self, effects=tuple(effects))

    def is_far_behind(self, rival: Fit | None) -> bool:
        """Whether there is no hope of doing as well as `rival`."""
        return rival is not None and self.error > HOPELESS * rival.error

    @property
    def offsets(self) -> np.ndarray:
        return self.at.offsets

    @cached_property
    def penalised_squares(self) -> float:
        """Sum of squared residuals, and what the hidden states of its effects took of it by chance alone.

        So that a model is not the better one for having a free number more in every window.
        """
        share = self.at.fitted_hidden.sum() / self.at.evidence.count
        return float(np.square(self.at.residual).sum() * (1 + share))

    @property
    def error(self) -> float:
        """RMSE over the noise floor, over all outputs."""
        return float(np.sqrt(np.square(self.at.residual).sum() / self.at.evidence.count))

    @cached_property
    def excess(self) -> float:
        """Squared error above the noise floor, per sample, of the outputs that are above it: one whose floor is too
        high makes up for nothing in another.
        """
        evidence = self.at.evidence
        squares = np.square(self.at.residual.reshape(evidence.measured.shape)).sum(axis=(0, 1))
        above = np.maximum(squares - evidence.mask.sum(axis=(0, 1)), 0.0)
        return float(above.sum() / evidence.count)


class ModelFits:
    """Fits models of `prepared.task` plus effects, on one engine."""

    def __init__(self, prepared: PreparedLog, threads: int | None):
        self.prepared = prepared
        self.engine = Engine(prepared.task.model, threads)
        self._elsewhere = 0

    @property
    def rollouts(self) -> int:
        """How many windows were simulated on the engine, and what else was added."""
        return self.engine.rollouts + self._elsewhere

    @rollouts.setter
    def rollouts(self, count: int) -> None:
        self._elsewhere = count - self.engine.rollouts

    def fit(
        self,
        part: PreparedLog,
        effects: Sequence[Placed],
        start: np.ndarray,
        *,
        offsets: np.ndarray | None = None,
        offsets_with: Sequence[Placed] = (),
        starts: int = 1,
        rounds: int = FIT_ROUNDS,
        tolerance: float = TOLERANCE,
        seed: int = 0,
        rival: Fit | None = None,
    ) -> Fit | None:
        """Fit from `start` (parameter,); None where every trial diverged. Other options are those of LeastSquares.

        offsets (window, state): of the starts, where they begin, from a model `offsets_with` effects; hidden states are
        those of the effects that it begins with as this one does.
        rival: a fit of the same part; this one is given up where it stays far behind, later where it has fewer
        parameters: of two that do as well it would be the better.
        """
        new = effects
        if offsets is not None:
            offsets = self._carried(offsets, offsets_with, effects)
            new = effects[_in_common(offsets_with, effects) :]
        offsets = self._with_states_found(part, effects, start, offsets, new)
        descend = partial(
            self._descended, part, effects, rounds=rounds, tolerance=tolerance, seed=seed, rival=rival
        )
        fit = descend(start, offsets, starts=starts)
        carried = {e.name for e in offsets_with}
        tried = any(len(e.effect.states_tried) and e.name not in carried for e in effects)
        if tried or (part.difference_step and not effects):
            fit = self._unstuck(part, fit, rival, descend)
        return fit

    def _with_states_found(
        self,
        part: PreparedLog,
        effects: Sequence[Placed],
        point: np.ndarray,
        offsets: np.ndarray | None,
        new: Sequence[Placed],
    ) -> np.ndarray | None:
        """`offsets` (window, state) with those states of the `new` effects, the last, that may be anywhere where they
        are best at `point` (parameter,), of the values tried in every window.

        From a phase on the wrong side of the circle a descent would sooner take the force away than turn it.
        """
        if not any(effect.states_anywhere and effect.states for _, effect in new):
            return offsets
        simulator = self.simulator(effects)
        evidence = part.evidence(simulator)
        found = np.zeros(evidence.start_sd.shape) if offsets is None else offsets
        state = found.shape[1] - sum(len(effect.states) for _, effect in new)
        for _, effect in new:
            own = slice(state, state + len(effect.states))
            state = own.stop
            if effect.states_anywhere and effect.states:
                trials = np.repeat(found[None], len(effect.states_tried), axis=0)
                trials[:, :, own] = effect.states_tried[:, None] * (evidence.start_sd[:, own] > 0)
                points = np.repeat(point[None], len(trials), axis=0)
                outputs, diverged = part.evaluate(simulator, Trial(points, trials))
                found, _ = best_trials(trials, trial_objectives(evidence, trials, outputs, diverged, 1.0))
        return found

    def _unstuck(
        self, part: PreparedLog, fit: Fit | None, rival: Fit | None, descend: Callable[..., Fit | None]
    ) -> Fit | None:
        """`fit`, where it may be stuck, from where there is a way out, as often as contacts may need it."""
        for _ in range(WAYS_OUT if part.difference_step else 1):
            if fit is None or not fit.finished or not _may_be_stuck(fit, rival):
                break
            way = self.way_out(part, fit, whole_step=bool(part.difference_step))
            further = None if way is None else descend(*way)
            if further is None or further.penalised_squares >= fit.penalised_squares:
                break
            fit = further
        return fit

    def _descended(
        self,
        part: PreparedLog,
        effects: Sequence[Placed],
        start: np.ndarray,
        offsets: np.ndarray | None,
        *,
        rounds: int,
        tolerance: float,
        seed: int,
        rival: Fit | None,
        starts: int = 1,
    ) -> Fit | None:
        """Where least squares from `start` (parameter,) and `offsets` (window, state) ends; as of `fit`."""
        simulator = self.simulator(effects)
        evidence = part.evidence(simulator)
        simpler = rival is not None and len(simulator.space) < len(rival.space)
        solver = LeastSquares(
            evidence,
            start=start,
            offsets=offsets,
            starts=starts,
            rounds=rounds,
            tolerance=tolerance,
            seed=seed,
            to_beat=np.inf if rival is None else rival.error,
            patience=LONG_PATIENCE if simpler else PATIENCE,
        )
        best = run(solver, lambda trial: part.evaluate(simulator, trial))
        if not np.isfinite(best.error):
            return None
        fit = self.at(part, effects, best, solver.at)
        return replace(fit, finished=not (solver.gave_up or fit.is_far_behind(rival)))

    def way_out(
        self, part: PreparedLog, fit: Fit, *, whole_step: bool, worth: float = AS_GOOD
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """A better point (parameter,), and offsets (window, state), that no step of all of them together leads to; None
        where there is none.

        Where stops are hit the start of a window has many minima, and a step of all parameters is refused for the few
        windows that it would leave in a worse one. So windows are fitted alone: where the parameters are, from where
        they begin and from where they were measured; and, where asked for, a whole step on.
        worth: of the objective over k, what a way out has to gain.
        """
        k, before = fit.at.scatter, fit.at.objectives(fit.at.scatter)
        found = self.starts_at(part, fit, TOLERANCE, fit.offsets, np.zeros_like(fit.offsets))
        offsets = np.stack([fit.offsets, found.offsets])
        best, values = best_trials(offsets, np.stack([before, found.objectives(k)]))
        ways = [(values.sum(), fit.point, best)]
        if whole_step and len(fit.point):
            point = fit.space.from_unit(fit.at.x + fit.at.whole_step)
            there = self.starts_at(part, replace(fit, point=point), TOLERANCE, best)
            ways.append((there.objectives(k).sum(), point, there.offsets))
        value, point, offsets = min(ways, key=lambda way: way[0])
        return (point, offsets) if before.sum() - value > worth * k else None

    def minima(self, part: PreparedLog, fit: Fit, seed: int) -> list[Fit]:
        """`fit` and where descents end that begin within its reach, best first.

        Where contacts make the error rough it has many minima, and one descent finds one of them. Where the first of
        them comes back to `fit`, the error is taken to be smooth, and no more are begun. After them, not as the best,
        come those that differ by a shape that this part of the log does not show.
        """
        if not len(fit.space):
            return [fit]
        best, *others = self._begun_anew(part, fit, seed)
        return [best, *others, *self._with_shapes_at_ends(part, best)]

    def _with_shapes_at_ends(self, part: PreparedLog, fit: Fit) -> list[Fit]:
        """`fit` with a shape of an effect at an end of its range, where it does as well: a limit that nothing reaches.

        A descent stops where the limit is about to matter, and differences that are taken there say that it does.
        """
        shapes = [
            fit.columns(e.name).start + i
            for e in fit.effects
            for i, name in enumerate(e.effect.space.names)
            if name in e.effect.shapes
        ]
        ends = np.repeat(fit.point[None], 2 * len(shapes), axis=0)
        for row, (shape, end) in zip(ends, product(shapes, (fit.space.low, fit.space.high)), strict=True):
            row[shape] = end[shape]
        if not len(ends):
            return []
        k = fit.at.scatter
        above = self.objectives(part, fit, PartFit.of(fit.at), ends) - fit.at.objectives(k).sum()
        as_good = above < AS_GOOD * k
        return [self.at(part, fit.effects, Best(p, fit.offsets, 0.0)) for p in ends[as_good]]

    def _begun_anew(self, part: PreparedLog, fit: Fit, seed: int) -> list[Fit]:
        """`fit` and where descents end that begin about it, best first."""
        covariance, _ = unit_covariance(fit.at)
        values, vectors = np.linalg.eigh(covariance)
        spread = vectors * np.sqrt(np.maximum(values, 0.0))
        sd = np.sqrt(np.maximum(np.diag(covariance), TINY))
        generator = np.random.default_rng(seed)
        found = [fit]
        for _ in range(BEGUN_ANEW):
            begin = fit.at.x + BEGUN_AWAY * spread @ generator.standard_normal(len(sd))
            point = fit.space.from_unit(np.clip(begin, 0, 1))
            other = self.fit(
                part, fit.effects, point, offsets=fit.offsets, offsets_with=fit.effects, rival=fit
            )
            if other is None:
                continue
            found.append(other)
            if len(found) == 2 and np.abs((other.at.x - fit.at.x) / sd).max() < RETURNED:
                break
        return sorted(found, key=lambda f: f.at.objectives(1.0).sum())

    def at(
        self,
        part: PreparedLog,
        effects: Sequence[Placed],
        best: Best,
        known: Linearization | None = None,
    ) -> Fit:
        """What an identifier found on `part`, with the linearization there: `known`, if measured, or a new one."""
        simulator = self.simulator(effects)
        if known is not None and not known.carried:
            return Fit(tuple(effects), simulator.space, best.parameters, known)
        evidence = part.evidence(simulator)
        x = simulator.space.to_unit(best.parameters)
        outputs, diverged = part.evaluate(simulator, columns(evidence, x, best.offsets))
        at = Linearization.from_columns(evidence, x, best.offsets, outputs, diverged)
        return Fit(tuple(effects), simulator.space, best.parameters, at)

    def errors(self, part: PreparedLog, points: np.ndarray) -> np.ndarray:
        """RMSE over the noise floor of the task itself at points (candidate, parameter); inf where one diverged."""
        simulator = self.simulator([])
        evidence = part.evidence(simulator)
        trial = Trial(points, np.zeros((len(points), *evidence.start_sd.shape)))
        outputs, diverged = part.evaluate(simulator, trial)
        square = np.square(evidence.residual(outputs)).sum(axis=(1, 2)) / evidence.count
        return np.where(diverged.any(axis=1) | ~np.isfinite(square), np.inf, np.sqrt(square))

    def objectives(self, part: PreparedLog, fit: Fit, on: PartFit, points: np.ndarray) -> np.ndarray:
        """Of the fit's model at points (point, parameter), (point,); inf where one diverged.

        on: the part at the fit, whose starts are left as they are.
        """
        offsets = np.repeat(on.offsets[None], len(points), axis=0)
        outputs, diverged = part.evaluate(self.simulator(fit.effects), Trial(points, offsets))
        return trial_objectives(on.evidence, offsets, outputs, diverged, fit.at.scatter).sum(axis=1)

    def on(
        self,
        part: PreparedLog,
        fit: Fit,
        tolerance: float = TOLERANCE,
        offsets: np.ndarray | None = None,
        *,
        thorough: bool = False,
    ) -> PartFit:
        """A part of the log at the fit's parameters, with starts refined by the rule they were fitted by.

        offsets (window, state): where they begin; as the log has them where None.
        """
        begin = offsets
        if begin is None:
            begin = np.zeros((len(part.windows), fit.offsets.shape[1]))
            begin = self._with_states_found(part, fit.effects, fit.point, begin, fit.effects)
        return PartFit.of(self.starts_at(part, fit, tolerance, begin, thorough=thorough))

    def starts_at(
        self,
        part: PreparedLog,
        fit: Fit,
        tolerance: float,
        offsets: np.ndarray,
        also: np.ndarray | None = None,
        *,
        thorough: bool = False,
    ) -> Linearization:
        """The starts of the part's windows at the fit's parameters, from `offsets` or `also` (window, state) on."""
        simulator = self.simulator(fit.effects)
        evidence = replace(part.evidence(simulator), space=ParameterSpace([]))

        def evaluate(keep: np.ndarray, trial: Trial):
            points = np.repeat(fit.point[None], len(trial), axis=0)
            outputs, diverged = part.part(keep).evaluate(simulator, Trial(points, trial.offsets))
            padding = evidence.measured.shape[1] - outputs.shape[2]
            return np.pad(outputs, ((0, 0), (0, 0), (0, padding), (0, 0))), diverged

        return fit_starts(evidence, evaluate, offsets, tolerance=tolerance, also=also, thorough=thorough)

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
        state): of its own, alike in all windows; 0 where None.
        """
        simulator = self.simulator((*fit.effects, effect))
        evidence = part.evidence(simulator)
        points = np.concatenate([np.repeat(fit.point[None], len(probes), axis=0), probes], axis=1)
        offsets = np.zeros((len(probes), *evidence.start_sd.shape))
        carried = fit.offsets.shape[1]
        offsets[:, :, :carried] = fit.offsets  # the new effect's own states come last
        if states is not None:
            offsets[:, :, carried : carried + states.shape[1]] = states[:, None]
        outputs, diverged = part.evaluate(simulator, Trial(points, offsets))
        return evidence.residual(outputs), diverged.any(axis=1)

    def motion(self, part: PreparedLog, fit: Fit, offsets: np.ndarray | None = None) -> Motion:
        """What happens inside every window of the part, its starts at `offsets` (those of the fit where None)."""
        simulator = self.simulator(fit.effects)
        starts = part.starts
        offsets = fit.offsets if offsets is None else offsets
        return simulator.motion(part.windows, starts.starts, fit.point, offsets, starts.reported)

    def begun(self, part: PreparedLog, fit: Fit, offsets: np.ndarray) -> Begun:
        """Where the simulation of every window of the part begins, its starts at `offsets` (window, state)."""
        return part.begun(self.simulator(fit.effects), fit.point, offsets)

    def simulator(self, effects: Sequence[Placed]) -> Simulator:
        """Simulates the task with `effects` on the shared engine."""
        own = self.prepared
        return Simulator(own.task, effects, engine=self.engine, difference_step=own.difference_step)

    def _carried(
        self, offsets: np.ndarray, theirs: Sequence[Placed], effects: Sequence[Placed]
    ) -> np.ndarray:
        """Offsets of a model with the effects `theirs` for one with `effects`.

        Those of the machine's own states, and of the first effects that are the same.
        """
        same = theirs[: _in_common(theirs, effects)]
        kept = self.prepared.starts.sd.shape[1] + sum(len(e.states) for _, e in same)
        states = self.prepared.starts.sd.shape[1] + sum(len(e.states) for _, e in effects)
        carried = np.zeros((len(offsets), states))
        carried[:, :kept] = offsets[:, :kept]
        return carried


def _in_common(theirs: Sequence[Placed], effects: Sequence[Placed]) -> int:
    """With how many effects, by their names, both begin."""
    same = (one.name == other.name for one, other in zip(theirs, effects, strict=False))
    return sum(takewhile(bool, same))


def _may_be_stuck(fit: Fit, rival: Fit | None) -> bool:
    """Whether windows may be where no step of all parameters leads out of.

    It does not matter where a rival that does as well leaves nothing.
    """
    if rival is not None and rival.error <= fit.error and not lack_of_fit(rival.at).lacking:
        return False
    return lack_of_fit(fit.at).lacking or len(fit.at.evidence.standing_out(fit.at.residual)) > 0


def least(fits: Sequence[Fit | None]) -> Fit | None:
    """The fit with the least penalised squares, the first of those that have as little; None of none."""
    return min((f for f in fits if f is not None), key=lambda f: f.penalised_squares, default=None)
