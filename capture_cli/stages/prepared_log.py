"""A log made ready for a task: checked, cut into windows, with starts, noise floor and split. Shared by stages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.diagnosis.noise_floor import NoiseFloor, noise_floor
from capture_cli.diagnosis.split import HeldOut, Split, split_windows
from capture_cli.errors import FitError, LogError, OptionError
from capture_cli.identifiers.base import Evidence, Trial
from capture_cli.linearization import ROUGH_START_STEP, START_STEP
from capture_cli.sim.engine import Engine, ModelFields
from capture_cli.sim.quaternion_signs import aligned, continuous, quaternion_columns
from capture_cli.sim.reported_motion import MOST_LATE
from capture_cli.sim.starts import (
    StartEstimate,
    estimate_starts,
    from_episodes,
    known_starts,
    measures_every_coordinate,
    model_starts,
    unmeasured_joints,
    with_known,
)
from capture_cli.sim.windows import Windows, cut
from capture_cli.simulator import Simulator
from capture_cli.stages.difference_step import difference_step
from capture_cli.stores.measured_log import MeasuredLog
from capture_cli.tasks import REGISTRY, load_task
from capture_cli.tasks.base import ActionTask, Channel, Task

MOVES_SHARE = 0.05  # of the range: the step with which a parameter must move some output
MOVES_LEAST = 1e-4  # of the noise floor: less is nothing
AGREES = 1e-3  # p of the first samples of episodes below which they do not begin where their actions say
FEWEST_SAMPLES = 8  # of the longest episode
FEWEST_IN_WINDOW = 4  # samples: with fewer, the start of a window explains all of it
IMPORT_AGAIN = "import it again: columns, scales and offsets are applied by `capture import-log`"
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
            start_step=ROUGH_START_STEP if self.difference_step else START_STEP,
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
        starts = self.starts
        may_move = self._start_sd(simulator)[:, : trial.offsets.shape[2]] > 0
        simulated = simulator.simulate(
            self.windows, starts.starts, trial.parameters, trial.offsets * may_move, starts.reported
        )
        outputs = aligned(simulated.outputs, self.windows.measured, attitudes(self.task))
        return outputs, simulated.diverged


def find_task(task: str | None, log: MeasuredLog) -> Task:
    """The task of `--task`; without it the built-in one that the log names, or a task.toml of that name beside it."""
    if task is not None:
        return load_task(task)
    if log.task in REGISTRY.names():
        return load_task(log.task)
    beside = Path(log.path).parent / "task.toml" if log.path else None
    if beside is not None and beside.is_file():
        found = load_task(str(beside))
        if found.name == log.task:
            return found
    raise OptionError(
        f"the log belongs to the task {log.task!r}, which is not built in, and no task.toml of that name "
        "lies beside it",
        cure="add --task PATH/TO/task.toml",
    )


def named(task: Task) -> str | None:
    """What `--task` is to say for a built-in task, whatever log it is for; None of a task.toml, which has a path."""
    return task.name if task.name in REGISTRY.names() and not hasattr(task, "path") else None


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
    _check_long_enough(log, duration)
    windows = _cut(log, task, duration)
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
    starts = _starts(log, task, windows, noise, threads)
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
    _check_fitted(prepared)
    step, rollouts = difference_step(prepared, threads)
    return replace(prepared, difference_step=step, rollouts=rollouts)


def clock(log: MeasuredLog) -> np.ndarray:
    """Time (step,), s, by the clock of simulations, which counts from the log's first time.

    By a clock that began long before the log the phase of a force that repeats would turn many times over within a
    finite difference of its frequency.
    """
    return log.time - log.time[0]


def driven_by(log: MeasuredLog) -> Sequence[np.ndarray]:
    """What drove each episode: its inputs (step, input), or its action."""
    return [log.inputs[e] for e in log.episodes] if log.actions is None else log.actions


def with_noise(prepared: PreparedLog, noise: NoiseFloor, threads: int | None) -> PreparedLog:
    """The log with another noise floor, which its starts are known by, too."""
    starts = _starts(prepared.log, prepared.task, prepared.windows, noise, threads)
    return replace(prepared, noise=noise, starts=starts)


def attitudes(task: Task) -> list[np.ndarray]:
    """Which outputs make up each attitude, (4,) each."""
    return quaternion_columns(task.model, [c.sensor for c in task.outputs])


def _starts(
    log: MeasuredLog, task: Task, windows: Windows, noise: NoiseFloor, threads: int | None
) -> StartEstimate:
    """Where every window starts: where its action says, if it begins an episode of one; else what the outputs say."""
    sensors = [c.sensor for c in task.outputs]
    acted = begins_by_action(log, task, windows)
    if acted.any():
        starts = task.episodes(log.actions[windows.episode]).starts
        known = known_starts(task.model, sensors, replace(starts, time=windows.time), noise.sd)
        if acted.all():
            return known
    read = estimate_starts(
        task.model,
        sensors,
        time=clock(log),
        outputs=log.values,
        episodes=log.episodes,
        window_first=windows.first,
        window_episode=windows.episode,
        noise_sd=noise.sd,
        sampled=log.sampled,
        unmeasured=None
        if measures_every_coordinate(task.model, sensors)
        else _simulate_episodes(log, task, windows, threads),
    )
    return with_known(read, known, acted) if acted.any() else read


def begins_by_action(log: MeasuredLog, task: Task, windows: Windows) -> np.ndarray:
    """Which windows begin an episode whose action says where, (window,)."""
    if not isinstance(task, ActionTask) or log.actions is None:
        return np.zeros(len(windows), dtype=bool)
    return windows.first == np.array([e.start for e in log.episodes])[windows.episode]


def as_acted(prepared: PreparedLog) -> PreparedLog:
    """With no doubt about starts that an action says."""
    acted = begins_by_action(prepared.log, prepared.task, prepared.windows)
    sd = np.where(acted[:, None], 0.0, prepared.starts.sd)
    return replace(prepared, starts=replace(prepared.starts, sd=sd))


def begins_as_acted(prepared: PreparedLog) -> bool:
    """Whether episodes begin where their actions say, as far as the noise lets their first samples tell.

    False where no action says it.
    """
    from scipy.special import chdtrc

    task, windows = prepared.task, prepared.windows
    acted = begins_by_action(prepared.log, task, windows)
    if not acted.any():
        return False
    said = Engine(task.model).rollout(
        starts=prepared.starts.starts.rows(acted),
        controls=task.controls(windows.rows(acted).controls),
        steps=1,
        columns=np.array([c.index for c in task.outputs]),
    )
    apart = (windows.measured[acted, 0] - said.sensors[:, 0]) / prepared.noise.sd
    return bool(chdtrc(apart.size, np.square(apart).sum()) > AGREES)


def _cut(log: MeasuredLog, task: Task, duration: float | None) -> Windows:
    """Windows of `duration` s, or of whole episodes where None, by the clock of simulations."""
    return cut(
        time=clock(log),
        inputs=log.inputs,
        outputs=log.values,
        episodes=log.episodes,
        timestep=task.timestep,
        duration=duration,
        linear=task.linear,
        sampled=log.sampled,
    )


def _simulate_episodes(log: MeasuredLog, task: Task, windows: Windows, threads: int | None) -> StartEstimate:
    """What the coordinates that no output measures do when the nominal model is driven through whole episodes."""
    model = task.model
    whole = _cut(log, task, None)
    own = model_starts(model, len(whole)).starts
    fields = ModelFields(model, len(whole))
    task.write(fields, np.repeat(task.space.nominal[None], len(whole), axis=0))
    rollouts = Engine(model, threads).rollout(
        starts=own,
        controls=task.controls(whole.controls),
        steps=int(whole.grid_steps.max()),
        fields=fields,
        states=True,
    )
    number = np.searchsorted(whole.first, windows.first, side="right") - 1
    step = np.round((windows.time - whole.time[number]) / task.timestep).astype(int)
    step = np.minimum(step, rollouts.qpos.shape[1] - 1)
    return from_episodes(model, rollouts, window_episode=number, window_step=step)


def all_diverged(task: Task) -> FitError:
    """What to say where no simulation of the log's windows stayed finite."""
    cure = (
        "see whether `capture inspect` finds a column in another unit (degrees, mm); tighten the parameters' "
        "bounds, shorten the window, or reduce the model's timestep"
    )
    unseen = unmeasured_joints(task.model, [c.sensor for c in task.outputs])
    if unseen:
        cure += (
            f"; or measure the position of {', '.join(unseen)}, which no output gives: windows begin where a "
            "simulation of the whole episode, driven by the log's inputs, takes it, and that may run away"
        )
    return FitError("every simulation tried diverged", cure=cure)


def check_fits(log: MeasuredLog, task: Task) -> None:
    """Raise LogError where the log's channels are not the task's, or were made of other columns or scales."""
    for kind, found, channels in (
        ("inputs", log.input_names, task.inputs),
        ("outputs", log.output_names, task.outputs),
    ):
        expected = tuple(c.name for c in channels)
        if tuple(found) != expected:
            raise LogError(
                f"{log.path}: its {kind} are ({', '.join(found)}); task {task.name!r} has ({', '.join(expected)})",
                cure="import the log again with this task, or give the task it was made with",
            )
        for recording in log.recordings:
            _check_read_as(log, task, recording, kind, channels)
    _check_sparse(log, task)
    for recording in log.recordings:
        was = recording.get("time_scale", task.log.time_scale)
        if was != task.log.time_scale:
            raise LogError(
                f"{log.path}: the time of {recording['name']!r} was imported as {was:g} s a unit; task {task.name!r} "
                f"now says {task.log.time_scale:g}",
                cure=IMPORT_AGAIN,
            )


def _check_sparse(log: MeasuredLog, task: Task) -> None:
    """Raise LogError where outputs lack samples that the task wants, or part of what one sensor gives."""
    for channel in task.outputs:
        if channel.name in log.sparse and not channel.sparse:
            raise LogError(
                f"{log.path}: output {channel.name!r} was imported as sparse, and task {task.name!r} does not say so",
                cure=f"write sparse = true under [outputs.{task.model.sensor(channel.sensor).name}] again, or fill its "
                "column in the source file and import that",
            )
    sensors = np.array([c.sensor for c in task.outputs])
    for sensor in dict.fromkeys(sensors[log.is_sparse].tolist()):
        own = log.sampled[:, sensors == sensor]
        partly = np.flatnonzero(own.any(axis=1) & ~own.all(axis=1))
        if partly.size:
            raise LogError(
                f"{log.path}: sensor {task.model.sensor(sensor).name!r} has some of its {own.shape[1]} values and not "
                f"the others at {log.time[partly[0]]:.9g} s, step {partly[0]} ({partly.size} such steps)",
                cure="give all values of a sample in one row, or none",
            )


def _check_fitted(prepared: PreparedLog) -> None:
    """Raise LogError where no window is fitted, or those that are hold no sample of an output."""
    fitted = prepared.windows.sampled[~prepared.split.is_test]
    if not len(fitted):
        raise LogError(
            f"{prepared.log.path}: no window is left to fit: each of the {len(prepared.windows)} holds some of what "
            f"was held out ({prepared.split.how})",
            cure="give a shorter --window, or say anew what to hold out (--test)",
        )
    never = [
        c.name for c, any_ in zip(prepared.task.outputs, fitted.any(axis=(0, 1)), strict=True) if not any_
    ]
    if never:
        raise LogError(
            f"{prepared.log.path}: what is fitted holds no sample of {', '.join(never)}: {prepared.split.how}",
            cure="hold out another part (--test), or take that output out of the task.toml and import again",
        )


def _check_read_as(
    log: MeasuredLog, task: Task, recording: Mapping[str, Any], kind: str, channels: Sequence[Channel]
) -> None:
    read_as = (recording.get("channels") or {}).get(kind, {})
    for channel in channels:
        was = tuple(read_as.get(channel.name, channel.read_as))
        if was != channel.read_as:
            raise LogError(
                f"{log.path}: {channel.name} of {recording['name']!r} was imported as {_formula(*was)}; "
                f"task {task.name!r} now says {_formula(*channel.read_as)}",
                cure=IMPORT_AGAIN,
            )


def _formula(column: str, scale: float, offset: float, period: float | None = None) -> str:
    anew = "" if period is None else f", which begins anew after {period:g}"
    return f"{scale:g} * {column}" + (f" + {offset:g}" if offset else "") + anew


def _check_long_enough(log: MeasuredLog, duration: float | None) -> None:
    if duration is not None and not 0 < duration < np.inf:
        raise OptionError(f"--window {duration:g}", cure="give a positive number of seconds")
    longest = log.longest
    if duration is not None and longest < 0.9 * duration:
        raise LogError(
            f"{log.path}: its longest episode lasts {longest:.3g} s, and a window {duration:.3g} s",
            cure="set a shorter `window` under [log] of the task.toml, or pass --window",
        )
    if max(e.stop - e.start for e in log.episodes) < FEWEST_SAMPLES:
        raise LogError(
            f"{log.path}: no episode has {FEWEST_SAMPLES} samples", cure="record longer, or at a higher rate"
        )
    interval = float(np.median(np.concatenate([np.diff(log.time[e]) for e in log.episodes])))
    if duration is not None and duration < FEWEST_IN_WINDOW * interval:
        raise LogError(
            f"{log.path}: a window of {duration:.3g} s holds fewer than {FEWEST_IN_WINDOW} samples, "
            f"which are {interval:.3g} s apart",
            cure="set a longer `window` under [log] of the task.toml, or pass --window",
        )


def check_parameters_move_outputs(prepared: PreparedLog, *, seed: int, threads: int | None) -> int:
    """Raise FitError naming parameters that move no output, at the nominal point, the centre, nor at random ones.

    Returns how many windows were simulated to see that.
    """
    simulator = Simulator(
        prepared.task,
        engine=Engine(prepared.task.model, threads),
        difference_step=prepared.difference_step,
    )
    space = simulator.space
    if not len(space):
        return 0
    generator = np.random.default_rng(seed)
    bases = np.stack(
        [space.to_unit(space.nominal), np.full(len(space), 0.5), generator.uniform(0.1, 0.9, len(space))]
    )
    still, seen = np.ones(len(space), dtype=bool), np.zeros(len(space), dtype=bool)
    some = prepared.part(np.unique(np.linspace(0, len(prepared.windows) - 1, 16).astype(int)))
    evidence = some.evidence(simulator)
    for base in bases:
        columns = np.flatnonzero(still)
        moved = np.repeat(np.clip(base, 0, 1)[None], 1 + len(columns), axis=0)
        for row, column in enumerate(columns, start=1):
            moved[row, column] += MOVES_SHARE if moved[row, column] < 0.5 else -MOVES_SHARE
        trial = Trial(space.from_unit(moved), np.zeros((len(moved), *evidence.start_sd.shape)))
        outputs, diverged = some.evaluate(simulator, trial)
        change = np.abs(evidence.residual(outputs[1:]) - evidence.residual(outputs[:1])).max(axis=2)
        valid = ~(diverged[1:] | diverged[:1])
        seen[columns] |= valid.any(axis=1)
        still[columns[(valid & (change > MOVES_LEAST)).any(axis=1)]] = False
        if not still.any():
            break
    names = [name for name, fixed in zip(space.names, still & seen, strict=True) if fixed]
    if not names:
        return simulator.rollouts  # where everything diverged nothing can be told: the fit will say so
    raise FitError(
        f"task {prepared.task.name!r}: {', '.join(names)} moves no output of this log, so it cannot be identified",
        cure="remove it from the task.toml, correct what it sets, or record a motion in which it matters",
    )
