"""Episodes that were not run yet, as the log that they would leave if an estimate were right."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from capture_cli.common.evenly_spread import evenly_spread
from capture_cli.estimate.difference_step import difference_step
from capture_cli.estimate.initial_states.from_outputs import InitialStateEstimate, states_of
from capture_cli.estimate.initial_states.nominal_motion import motion_at
from capture_cli.estimate.initial_states.of_windows import as_acted, in_whole_episodes, log_initial_states
from capture_cli.estimate.log_windows import cut_log, window_of
from capture_cli.estimate.noise.noise_floor import NoiseFloor
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.split import Split
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.windows import Windows
from capture_cli.model.tasks.base import ActionTask, Task
from capture_cli.simulate.engine import Rollouts
from capture_cli.stages.excitation.drive import Drive
from capture_cli.store.estimate import Estimate


@dataclass(frozen=True)
class Known:
    """What an estimate says of the next episode.

    point (parameter,), covariance (p, p), in the parameters' own units. noise: of the outputs, as the estimate has it.
    interval: s, between the steps of its log; apart (output,): s, between the samples of an output that has none in
    some of them, 0 of the others. window: s, that the fit was told instead of the task's. acted: whether the fit
    began episodes where their actions say. variance: of its residual over that of the noise; correlated: s,
    by how much its autocorrelation time is longer than an interval.
    """

    point: np.ndarray
    covariance: np.ndarray
    noise: NoiseFloor
    interval: float
    apart: np.ndarray
    window: float | None
    acted: bool
    variance: float
    correlated: float

    @classmethod
    def of(cls, task: Task, estimate: Estimate, window: float | None) -> Self:
        """window: s, that the estimate was told instead of the task's."""
        record, arrays = estimate.record, estimate.arrays
        names = [c.name for c in task.outputs]
        noise_sd = np.array([record.noise_floor[name] for name in names])
        time, number = (np.asarray(arrays[f"step/{name}"]) for name in ("time", "window"))
        sampled = ~np.isnan(np.asarray(arrays["step/measured"]))
        interval = _usual_interval(time, number)
        apart = [0.0 if own.all() else _usual_interval(time[own], number[own]) for own in sampled.T]
        lack, rounds = record.lack_of_fit, record.in_context
        return cls(
            point=np.asarray(arrays["parameter/estimate"]),
            covariance=np.asarray(arrays["parameter/covariance"]),
            noise=NoiseFloor(noise_sd, ("declared",) * len(names)),
            interval=interval,
            apart=np.array(apart),
            window=window,
            acted=isinstance(task, ActionTask) and rounds is not None and not rounds["fallback"],
            variance=lack["normalized"] ** 2,
            correlated=(lack["autocorrelation_time"] - 1) * interval,
        )

    def inflation(self, interval: float) -> float:
        """k, as of a `Linearization`, of a residual with samples `interval` s apart."""
        return max(1.0, self.variance * (1 + self.correlated / interval))


def _usual_interval(time: np.ndarray, window: np.ndarray) -> float:
    """s, between samples at `time` (step,) of one `window` (step,); 0 where no two are."""
    apart = np.diff(time)[np.diff(window) == 0]
    return float(np.median(apart)) if apart.size else 0.0


def planned(
    task: Task, driven: Drive, known: Known, threads: int | None
) -> tuple[PreparedLog | None, np.ndarray]:
    """What `driven` would leave, made ready as `identify` does, with windows that begin where the machine then is.

    How well that is known is what would be read off outputs with their noise. And which episodes are in it, (episode,):
    those that do not diverge; None where all do.
    """
    whole, rollouts = _motion(task, driven, known, threads)
    sound = np.flatnonzero(~rollouts.diverged)
    if not sound.size:
        return None, sound
    if len(sound) < len(whole):
        driven = driven.rows(sound)
        whole, rollouts = _motion(task, driven, known, threads)
    outputs = whole.sample(rollouts.sensors[..., [c.index for c in task.outputs]], np.arange(len(whole)))
    log = _measured(task, driven, outputs[whole.mask], known)
    windows = cut_log(log, task, window_of(log, task, known.window))
    read = log_initial_states(log, task, windows, known.noise, threads)
    true = states_of(rollouts, *in_whole_episodes(windows, whole))
    initial = replace(read.states, qpos=true.qpos, qvel=true.qvel, act=true.act)
    none_held_out = Split(np.zeros(len(windows), dtype=bool), "nothing held out")
    there = InitialStateEstimate(initial, read.sd)
    prepared = PreparedLog(task, log, windows, there, known.noise, none_held_out)
    judged = 16  # windows, evenly spread, in which it is seen how long finite differences have to be
    some = evenly_spread(len(windows), judged)
    step, _ = difference_step(prepared.part(some), threads, known.point)
    prepared = replace(prepared, difference_step=step)
    return as_acted(prepared) if known.acted else prepared, sound


def _motion(task: Task, driven: Drive, known: Known, threads: int | None) -> tuple[Windows, Rollouts]:
    """Whole episodes, in which nothing was measured, and how the machine moves through them at the estimate."""
    whole = cut_log(_log(task, driven, np.zeros((len(driven.time), len(task.outputs)))), task, None)
    controls = task.controls(whole.controls)
    return whole, motion_at(task, known.point, driven.initial, controls, threads=threads)


def _measured(task: Task, driven: Drive, outputs: np.ndarray, known: Known) -> MeasuredLog:
    """The log of outputs (step, output), with noise: how well initial states are read off depends on it."""
    noise = np.random.default_rng(0).standard_normal(outputs.shape)
    log = _log(task, driven, outputs + known.noise.sd * noise)
    every = np.maximum(np.rint(known.apart / (driven.time[1] - driven.time[0])), 1).astype(int)
    number = np.concatenate([np.arange(e.stop - e.start) for e in log.episodes])
    seen = number[:, None] % every == 0
    sparse = frozenset(
        c.name for c, all_seen in zip(task.outputs, seen.all(axis=0), strict=True) if not all_seen
    )
    return replace(log, outputs=np.where(seen, log.outputs, np.nan), sparse=sparse)


def _log(task: Task, driven: Drive, outputs: np.ndarray) -> MeasuredLog:
    return driven.log(task, outputs, name="planned", source="capture propose")
