"""A log made ready for a task: checked, cut into windows, with starts, noise floor and split."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from capture_cli.diagnosis.noise_floor import NoiseFloor, noise_floor
from capture_cli.diagnosis.split import HeldOut, Split, split_windows
from capture_cli.identifiers.base import Evidence, Trial
from capture_cli.linearization import ROUGH_START_STEP, START_STEP
from capture_cli.protocol.difference_step import difference_step
from capture_cli.protocol.log_checks import check_changes, check_fits, check_fitted, check_long_enough
from capture_cli.protocol.log_starts import log_starts
from capture_cli.protocol.log_windows import cut_log
from capture_cli.sim.quaternion_signs import aligned, continuous, quaternion_columns
from capture_cli.sim.reported_motion import MOST_LATE
from capture_cli.sim.starts import StartEstimate
from capture_cli.sim.windows import Windows
from capture_cli.simulator import Begun, Simulator
from capture_cli.stores.measured_log import MeasuredLog
from capture_cli.tasks.base import Task

REPEATED_SAMPLES = (16, 100)  # half a window within these: over how long repeats are compared


@dataclass(frozen=True)
class PreparedLog:
    """Everything `identify` and `diagnose` know before the first fit.

    difference_step: the least share of a parameter's range that finite differences take, as of `difference_step`.
    rollouts: how many windows were simulated to make it ready.
    """

    task: Task
    log: MeasuredLog
    windows: Windows
    starts: StartEstimate
    noise: NoiseFloor
    split: Split
    difference_step: float = 0.0
    rollouts: int = 0

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

    def evidence(self, simulator: Simulator) -> Evidence:
        """What identifiers are given. Hidden states of effects are free at the starts, by their unit prior."""
        return Evidence(
            simulator.space,
            self.windows.measured,
            self.windows.sampled,
            self.noise.sd,
            self._start_sd(simulator),
            hidden_tried=simulator.hidden_tried(),
            start_step=ROUGH_START_STEP if simulator.difference_step else START_STEP,
            attitudes=attitudes(self.task),
        )

    def _start_sd(self, simulator: Simulator) -> np.ndarray:
        """How well states are known at the start of each window, those of effects last, (window, state)."""
        own, reported = self.starts.sd, self.starts.reported
        if simulator.begins_early and reported is not None:
            before_the_log = (self.windows.known < MOST_LATE)[:, None]
            own = np.hypot(own, before_the_log * reported.unseen(own.shape[1]))
        return np.concatenate([own, simulator.hidden_sd(self.windows)], axis=1)

    def evaluate(self, simulator: Simulator, trial: Trial) -> tuple[np.ndarray, np.ndarray]:
        """Simulated outputs (candidate, window, step, output) and diverged (candidate, window) of a trial.

        Starts that are known for certain stay where they are.
        """
        starts, offsets = self.starts, self._moved(simulator, trial.offsets)
        simulated = simulator.simulate(
            self.windows, starts.starts, trial.parameters, offsets, starts.reported
        )
        outputs = aligned(simulated.outputs, self.windows.measured, attitudes(self.task))
        return outputs, simulated.diverged

    def begun(self, simulator: Simulator, point: np.ndarray, offsets: np.ndarray) -> Begun:
        """Where the simulation of every window begins at `point` (parameter,); offsets (window, state)."""
        starts, offsets = self.starts, self._moved(simulator, offsets)
        return simulator.begun(self.windows, starts.starts, point, offsets, starts.reported)

    def _moved(self, simulator: Simulator, offsets: np.ndarray) -> np.ndarray:
        """Offsets (..., window, state) without those of starts that are known for certain."""
        return offsets * (self._start_sd(simulator)[:, : offsets.shape[-1]] > 0)


def prepare(
    log: MeasuredLog,
    task: Task,
    *,
    window: float | None,
    test: str | None,
    seed: int,
    held_out: HeldOut | None = None,
    threads: int | None = None,
) -> PreparedLog:
    """Check that the log fits the task, and make it ready. Raises LogError or OptionError.

    held_out: what an estimate of the same log kept back, which is kept back again; `test` and `seed` say what where
    None.
    """
    check_fits(log, task)
    turned = continuous(log.outputs, log.episodes, attitudes(task), log.sampled)
    log = replace(log, outputs=turned)
    duration = window if window is not None else task.log.window
    check_long_enough(log, duration)
    windows = cut_log(log, task, duration)
    noise = noise_floor(
        log.values,
        log.episodes,
        [c.noise_sd for c in task.outputs],
        time=log.time,
        driven_by=driven_by(log),
        block=int(np.clip(np.median(windows.samples) / 2, *REPEATED_SAMPLES)),
        attitudes=attitudes(task),
        sampled=log.sampled,
    )
    check_changes(log, task, noise.sd)
    starts = log_starts(log, task, windows, noise, threads)
    split = (
        held_out.split(windows.first, windows.samples)
        if held_out is not None
        else split_windows(
            episode=windows.episode,
            recording=log.recording,
            recording_names=log.recording_names,
            test=test,
            seed=seed,
        )
    )
    prepared = PreparedLog(task, log, windows, starts, noise, split)
    check_fitted(prepared)
    step, rollouts = difference_step(prepared, threads)
    return replace(prepared, difference_step=step, rollouts=rollouts)


def driven_by(log: MeasuredLog) -> Sequence[np.ndarray]:
    """What drove each episode: its inputs (step, input), or its action."""
    return [log.inputs[e] for e in log.episodes] if log.actions is None else log.actions


def with_noise(prepared: PreparedLog, noise: NoiseFloor, threads: int | None) -> PreparedLog:
    """The log with another noise floor, which its starts are known by, too."""
    starts = log_starts(prepared.log, prepared.task, prepared.windows, noise, threads)
    return replace(prepared, noise=noise, starts=starts)


def attitudes(task: Task) -> list[np.ndarray]:
    """Which outputs make up each attitude, (4,) each."""
    return quaternion_columns(task.model, [c.sensor for c in task.outputs])
