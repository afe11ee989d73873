"""A log that is ready for a task: its windows, where they start, how well that is known, noise floor and split."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture_cli.estimate.balance.input_timing import InputTiming
from capture_cli.estimate.balance.screening import Screening
from capture_cli.estimate.initial_states.from_outputs import StartEstimate
from capture_cli.estimate.noise.noise_floor import NoiseFloor
from capture_cli.estimate.solve.base import Data, Trial
from capture_cli.estimate.solve.linearization import SETTINGS as LINEARIZATION
from capture_cli.estimate.split import Split
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.reported_motion import SETTINGS as REPORTED_MOTION
from capture_cli.log.windows import Windows
from capture_cli.model.quaternion_signs import aligned, quaternion_columns
from capture_cli.model.states import offsets_between, shift
from capture_cli.model.tasks.base import Task
from capture_cli.simulate.simulator import Begun, Simulator


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
    effects in the force balance of what selects them, where that was asked.
    """

    task: Task
    log: MeasuredLog
    windows: Windows
    starts: StartEstimate
    noise: NoiseFloor
    split: Split
    difference_step: float = 0.0
    rollouts: int = 0
    input_timings: Sequence[InputTiming] = ()
    balanced: Balanced | None = None
    screening: Screening | None = None

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
            self.starts.rows(keep),
            self.noise,
            Split(self.split.is_test[keep], self.split.how),
            self.difference_step,
        )

    def offsets_from(self, earlier: PreparedLog, offsets: np.ndarray) -> np.ndarray:
        """Offsets (window, state) of starts that begin each window where `offsets` began it in `earlier`: the same log,
        of which other starts were read. What effects hide stays.
        """
        model, own = self.task.model, self.starts.sd.shape[1]
        there = shift(model, earlier.starts.starts, offsets[:, :own])
        moved = offsets_between(model, self.starts.starts, there)
        return np.hstack([np.where(self.starts.sd > 0, moved, 0.0), offsets[:, own:]])

    def data(self, simulator: Simulator) -> Data:
        """What identifiers are given. Hidden states of effects are free at the starts, by their unit prior."""
        return Data(
            simulator.space,
            self.windows.measured,
            self.windows.sampled,
            self.noise.sd,
            self._start_sd(simulator),
            hidden_tried=simulator.hidden_tried(),
            start_step=LINEARIZATION.rough_start_step
            if simulator.difference_step
            else LINEARIZATION.start_step,
            attitudes=attitudes(self.task),
        )

    def _start_sd(self, simulator: Simulator) -> np.ndarray:
        """How well states are known at the start of each window, those of effects last, (window, state)."""
        own, reported = self.starts.sd, self.starts.reported
        if simulator.begins_early and reported is not None:
            before_the_log = (self.windows.known < REPORTED_MOTION.most_late)[:, None]
            own = np.hypot(own, before_the_log * reported.unseen(own.shape[1]))
        return np.concatenate([own, simulator.hidden_sd(self.windows)], axis=1)

    def evaluate(self, simulator: Simulator, trial: Trial) -> tuple[np.ndarray, np.ndarray]:
        """Simulated outputs (candidate, window, step, output) and diverged (candidate, window) of a trial.

        Starts that are known for certain stay where they are. Windows that need not be simulated count as diverged.
        """
        if trial.windows is not None:
            which, moved = trial.windows, trial.offsets[:, trial.windows]
            outputs = np.zeros((len(trial), *self.windows.measured.shape))
            diverged = np.ones(outputs.shape[:2], dtype=bool)
            outputs[:, which], diverged[:, which] = self.evaluate_windows(
                simulator, which, Trial(trial.parameters, moved)
            )
            return outputs, diverged
        starts, offsets = self.starts, self._moved(simulator, trial.offsets)
        simulated = simulator.simulate(
            self.windows, starts.starts, trial.parameters, offsets, starts.reported
        )
        outputs = aligned(simulated.outputs, self.windows.measured, attitudes(self.task))
        return outputs, simulated.diverged

    def evaluate_windows(
        self, simulator: Simulator, which: np.ndarray, trial: Trial
    ) -> tuple[np.ndarray, np.ndarray]:
        """As of `evaluate`, of the windows at `which` alone: the offsets are theirs. Padded to the steps of all."""
        outputs, diverged = self.part(which).evaluate(simulator, trial)
        padding = self.windows.measured.shape[1] - outputs.shape[2]
        return np.pad(outputs, ((0, 0), (0, 0), (0, padding), (0, 0))), diverged

    def begun(self, simulator: Simulator, point: np.ndarray, offsets: np.ndarray) -> Begun:
        """Where the simulation of every window begins at `point` (parameter,); offsets (window, state)."""
        starts, offsets = self.starts, self._moved(simulator, offsets)
        return simulator.begun(self.windows, starts.starts, point, offsets, starts.reported)

    def _moved(self, simulator: Simulator, offsets: np.ndarray) -> np.ndarray:
        """Offsets (..., window, state) without those of starts that are known for certain."""
        return offsets * (self._start_sd(simulator)[:, : offsets.shape[-1]] > 0)


def attitudes(task: Task) -> list[np.ndarray]:
    """Which outputs make up each attitude, (4,) each."""
    return quaternion_columns(task.model, [c.sensor for c in task.outputs])
