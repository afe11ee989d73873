"""A log that is ready for a task: its windows, where they start, how well that is known, noise floor and split."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.initial_states.from_outputs import InitialStateEstimate
from capture_cli.estimate.noise.noise_floor import NoiseFloor
from capture_cli.estimate.solve.base import Data, Trial
from capture_cli.estimate.solve.linearization import SETTINGS as LINEARIZATION
from capture_cli.estimate.split import Split
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.reported_motion import SETTINGS as REPORTED_MOTION
from capture_cli.log.windows import Windows
from capture_cli.model.quaternion_signs import aligned, quaternion_columns
from capture_cli.model.states import corrections_between, shift
from capture_cli.model.tasks.base import Task
from capture_cli.simulate.simulator import InitialConditions, Simulator
from capture_cli.simulate.uncoupled import Grouped

if TYPE_CHECKING:  # the balance loads SciPy, and who only checks a log works out none
    from capture_cli.estimate.balance.input_timing import InputTiming
    from capture_cli.estimate.balance.screening import Screening


@frozen
class SETTINGS:
    agree: float = 0.2  # of a change of the outputs, that one to first order may be off by


@dataclass(frozen=True)
class Balanced:
    """Where the force balance of some `windows` (window,) has the declared parameters, (parameter,), from `start`
    (parameter,) on; None where it leaves one of them open.
    """

    windows: np.ndarray
    start: np.ndarray
    point: np.ndarray | None

    def is_of(self, windows: np.ndarray, start: np.ndarray) -> bool:
        return np.array_equal(windows, self.windows) and np.array_equal(start, self.start)


@dataclass(frozen=True)
class PreparedLog:
    """Everything `identify` and `diagnose` know before the first fit.

    difference_step: the least share of a parameter's range that finite differences take, as of `difference_step`.
    rollouts: how many windows were simulated to make it ready. input_timings: how inputs act between rows, as far as
    the log tells, and `balanced`: where the balance that was asked for that has the parameters. screening: of all
    effects in the force balance of what selects them, where that was asked. left (window,): mean squared error of the
    declared model, where windows are dealt out by that.
    """

    task: Task
    log: MeasuredLog
    windows: Windows
    initial: InitialStateEstimate
    noise: NoiseFloor
    split: Split
    difference_step: float = 0.0
    rollouts: int = 0
    input_timings: Sequence[InputTiming] = ()
    balanced: Balanced | None = None
    screening: Screening | None = None
    left: np.ndarray | None = None

    @property
    def recording(self) -> np.ndarray:
        """Which recording each window comes from, (window,)."""
        return np.asarray(self.log.recording)[self.windows.episode]

    @property
    def log_steps(self) -> np.ndarray:
        """Which step of the log each step of a window is, (window, step); past a window's end any that there is."""
        steps = self.windows.first[:, None] + np.arange(self.windows.mask.shape[1])
        return np.minimum(steps, len(self.log.time) - 1)

    def samples(self, output: int) -> list[np.ndarray]:
        """The samples of an output as they were measured, (sample,) of each episode."""
        values, sampled = self.log.values[:, output], self.log.sampled[:, output]
        return [values[e][sampled[e]] for e in self.log.episodes]

    def part(self, keep: np.ndarray) -> PreparedLog:
        """The windows at `keep` alone (indices or a mask)."""
        keep = np.arange(len(self.windows))[keep]
        return PreparedLog(
            self.task,
            self.log,
            self.windows.rows(keep),
            self.initial.rows(keep),
            self.noise,
            Split(self.split.is_test[keep], self.split.how),
            self.difference_step,
        )

    def corrections_from(self, earlier: PreparedLog, corrections: np.ndarray) -> np.ndarray:
        """Corrections (window, state) of initial states that begin each window where `corrections` began it in
        `earlier`: the same log, of which other initial states were read. What effects hide stays.
        """
        model, own = self.task.model, self.initial.sd.shape[1]
        there = shift(model, earlier.initial.states, corrections[:, :own])
        moved = corrections_between(model, self.initial.states, there)
        return np.hstack([np.where(self.initial.sd > 0, moved, 0.0), corrections[:, own:]])

    def data(self, simulator: Simulator) -> Data:
        """What identifiers are given. Hidden states of effects are free where windows begin, by their prior."""
        return Data(
            simulator.space,
            self.windows.measured,
            self.windows.sampled,
            self.noise.sd,
            self._initial_sd(simulator),
            hidden_tried=simulator.hidden_tried(),
            initial_step=LINEARIZATION.rough_initial_step
            if simulator.difference_step
            else LINEARIZATION.initial_step,
            attitudes=attitudes(self.task),
        )

    def _initial_sd(self, simulator: Simulator) -> np.ndarray:
        """How well states are known at the start of each window, those of effects last, (window, state)."""
        own, reported = self.initial.sd, self.initial.reported
        if reported is not None and (beside := simulator.most_picked_up).any():
            own = np.hypot(own, reported.off_by(beside, own.shape[1]))
        if reported is not None and simulator.begins_early:
            before_the_log = (self.windows.known < REPORTED_MOTION.most_late)[:, None]
            own = np.hypot(own, before_the_log * reported.unseen(own.shape[1]))
        return np.concatenate([own, simulator.hidden_sd(self.windows)], axis=1)

    def evaluate(self, simulator: Simulator, trial: Trial) -> tuple[np.ndarray, np.ndarray]:
        """Simulated outputs (candidate, window, step, output) and diverged (candidate, window) of a trial.

        Initial states that are known for certain stay where they are. Windows that need not be simulated count as
        diverged.
        """
        return self._in_groups(simulator, trial, self._evaluated)

    def _in_groups(
        self, simulator: Simulator, trial: Trial, ask: Callable[[Simulator, Trial], tuple]
    ) -> tuple:
        """What `ask` gives of a trial, whose candidates are simulated together where they move other trees."""
        grouped = Grouped.of(simulator.trees, trial.parameters, trial.corrections)
        if grouped is None:
            return ask(simulator, trial)
        few = replace(trial, parameters=grouped.parameters, corrections=grouped.corrections)
        return grouped.apart(simulator.trees, *ask(simulator, few))

    def _evaluated(self, simulator: Simulator, trial: Trial) -> tuple[np.ndarray, np.ndarray]:
        if trial.windows is not None:
            which, moved = trial.windows, trial.corrections[:, trial.windows]
            outputs = np.zeros((len(trial), *self.windows.measured.shape))
            diverged = np.ones(outputs.shape[:2], dtype=bool)
            outputs[:, which], diverged[:, which] = self.evaluate_windows(
                simulator, which, Trial(trial.parameters, moved)
            )
            return outputs, diverged
        initial, corrections = self.initial, self._moved(simulator, trial.corrections)
        simulated = simulator.simulate(
            self.windows, initial.states, trial.parameters, corrections, initial.reported
        )
        outputs = aligned(simulated.outputs, self.windows.measured, attitudes(self.task))
        return outputs, simulated.diverged

    def answer(self, simulator: Simulator, trial: Trial) -> tuple:
        """What `evaluate` gives; of a trial for which first order will do, also whether all of it was simulated."""
        return self._in_groups(simulator, trial, self._near if trial.near else self._evaluated)

    @np.errstate(over="ignore", invalid="ignore")  # what runs away to first order is simulated
    def _near(self, simulator: Simulator, trial: Trial) -> tuple[np.ndarray, np.ndarray, bool]:
        """To first order, of candidates that differ little from the first, and whether all was simulated after all.

        In each window one step along all candidates together is simulated. Where it does not lead where they say, and
        where it takes no longer, all of them are.
        """
        parameters, corrections = trial.parameters, self._moved(simulator, trial.corrections)
        if not simulator.near_is_cheaper(parameters, corrections):
            return *self.evaluate(simulator, trial), True
        initial = self.initial
        near = simulator.simulate_near(
            self.windows, initial.states, parameters, corrections, initial.reported
        )
        outputs = aligned(near.outputs, self.windows.measured, attitudes(self.task))
        wrong = np.flatnonzero(~self._agrees(simulator, trial, outputs) | near.diverged.any(axis=0))
        diverged = near.diverged
        if wrong.size:
            exact = Trial(parameters, trial.corrections[:, wrong])
            outputs[:, wrong], diverged[:, wrong] = self.evaluate_windows(simulator, wrong, exact)
        return outputs, diverged, wrong.size == len(self.windows)

    def _agrees(self, simulator: Simulator, trial: Trial, outputs: np.ndarray) -> np.ndarray:
        """In which windows a step along all candidates of the trial at once leads where `outputs` (candidate, window,
        step, output) say, (window,). Each candidate has the same share in it, none more than its own step.
        """
        changes = (outputs - outputs[0]) / self.noise.sd * self.windows.sampled
        size = np.median(np.sqrt(np.square(changes).sum(axis=(2, 3))), axis=1)
        usual = np.median(size[size > 0]) if (size > 0).any() else 1.0
        share = usual / np.maximum(size, usual)
        foreseen = np.tensordot(share, changes, axes=1)
        if not np.isfinite(share).all():
            return np.zeros(len(self.windows), dtype=bool)
        together = (
            first + np.tensordot(share, values - first, axes=1)
            for values, first in (
                (trial.parameters, trial.parameters[0]),
                (trial.corrections, trial.corrections[0]),
            )
        )
        there, diverged = self.evaluate(simulator, Trial(*(values[None] for values in together)))
        found = (there[0] - outputs[0]) / self.noise.sd * self.windows.sampled
        off = np.square(found - foreseen).sum(axis=(1, 2))
        return (off <= SETTINGS.agree**2 * np.square(found).sum(axis=(1, 2))) & ~diverged[0]

    def evaluate_windows(
        self, simulator: Simulator, which: np.ndarray, trial: Trial
    ) -> tuple[np.ndarray, np.ndarray]:
        """As of `answer`, of the windows at `which` alone: the corrections are theirs. Padded to the steps of all."""
        outputs, diverged, *_ = self.part(which).answer(simulator, trial)
        padding = self.windows.measured.shape[1] - outputs.shape[2]
        return np.pad(outputs, ((0, 0), (0, 0), (0, padding), (0, 0))), diverged

    def initial_conditions(
        self, simulator: Simulator, point: np.ndarray, corrections: np.ndarray
    ) -> InitialConditions:
        """Where the simulation of every window begins at `point` (parameter,); corrections (window, state)."""
        initial, corrections = self.initial, self._moved(simulator, corrections)
        return simulator.initial_conditions(
            self.windows, initial.states, point, corrections, initial.reported
        )

    def _moved(self, simulator: Simulator, corrections: np.ndarray) -> np.ndarray:
        """Corrections (..., window, state) without those of initial states that are known for certain."""
        return corrections * (self._initial_sd(simulator)[:, : corrections.shape[-1]] > 0)


def attitudes(task: Task) -> list[np.ndarray]:
    """Which outputs make up each attitude, (4,) each."""
    return quaternion_columns(task.model, [c.sensor for c in task.outputs])
