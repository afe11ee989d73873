"""Actions for a machine of the user's own: windows of a log, or multisines: initial states and input sequences."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.errors import FitError, LogError, OptionError
from capture_cli.estimate.initial_states.nominal_motion import nominal_motion
from capture_cli.estimate.log_windows import clock
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.split import NewSplit
from capture_cli.log.input_sequences import LoggedInputs
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.windows import Windows
from capture_cli.model.model_hash import is_of_another
from capture_cli.model.states import InitialStates
from capture_cli.model.tasks.base import Task
from capture_cli.model.tasks.sequence_task import SequenceTask, actions_of, resample
from capture_cli.simulate.multisine import SETTINGS as MULTISINE
from capture_cli.simulate.multisine import (
    check_above_zero,
    check_amplitude,
    check_band,
    into_range,
    multisine_sequence,
    peaks,
)
from capture_cli.store.histories import Histories


@frozen
class SETTINGS:
    points: int = 20
    most_pairs: int = 1024  # of histories, whose actions are taken
    # simulated for a library of multisines, and windows taken from each
    episodes: int = 64
    windows: int = 16
    long: int = 8  # windows that such an episode lasts
    beyond: float = 1.5  # sampling intervals: so much before its end a sequence's last sample may be
    # of a sequence: by less than this windows of uneven times may begin before the one before ends
    overlap: float = 0.1


@dataclass(frozen=True)
class Sequences:
    """actions (sequence, action), and the outputs at the points (sequence, point, output).

    left_out: how many windows of a log begin no sequence.
    """

    actions: np.ndarray
    outputs: np.ndarray
    left_out: int = 0


@dataclass(frozen=True)
class LogWindows:
    """The windows of the log at `path`; max_log_size: its bytes in memory."""

    path: Path
    max_log_size: int | None = None

    def sequences(self, machine: Task, point_times: np.ndarray, window: float, seed: int) -> Sequences:
        """As long as `window` s."""
        log = MeasuredLog.read(self.path, self.max_log_size)
        from capture_cli.estimate.prepare import prepare  # loads SciPy, which actions of no log do without

        return log_sequences(prepare(log, machine, window=window, split=NewSplit(seed=seed)), point_times)


@dataclass(frozen=True)
class Multisines:
    """Windows of the nominal machine driven by multisines in `band` Hz that peak at `amplitude`, by input."""

    amplitude: Mapping[str, float] = field(default_factory=dict)
    band: tuple[float, float] = MULTISINE.band

    def sequences(self, machine: Task, point_times: np.ndarray, window: float, seed: int) -> Sequences:
        """From rest; activations of actuators begin at 0. As long as `window` s, which the last of the points is at."""
        check_amplitude(machine, self.amplitude)
        check_above_zero(machine, self.amplitude, "the actuator does")
        check_band(self.band)
        generator = np.random.default_rng(seed)
        steps = round(point_times[-1] / machine.timestep) + 1
        time = machine.timestep * np.arange(SETTINGS.long * steps)
        farthest = peaks(machine, self.amplitude)
        inputs = np.stack(
            [
                multisine_sequence(machine, time, farthest, self.band, generator)
                for _ in range(SETTINGS.episodes)
            ]
        )
        rollouts = nominal_motion(machine, machine.controls(inputs))
        sound = np.flatnonzero(~rollouts.diverged)
        if not sound.size:
            raise FitError(
                f"task {machine.name!r} diverges when it is driven by multisines",
                cure="drive it less (--amplitude), or take the inputs of a log (--inputs-from)",
            )
        episode = np.repeat(sound, SETTINGS.windows)
        first = generator.integers(0, len(time) - steps, len(episode))
        points = first[:, None] + np.rint(point_times / machine.timestep).astype(int)
        count = len(episode)
        initial = InitialStates(
            rollouts.qpos[episode, first],
            rollouts.qvel[episode, first],
            np.zeros((count, machine.model.na)),
            np.zeros(count),
        )
        driven = inputs[episode[:, None], first[:, None] + np.arange(steps)]
        outputs = rollouts.sensors[episode[:, None], points][..., [c.index for c in machine.outputs]]
        sequences = into_range(machine, resample(driven, machine.timestep, point_times))
        return Sequences(actions_of(initial, sequences), outputs)


def sequence_task(
    machine: Task,
    actions: LogWindows | Multisines | None = None,
    *,
    window: float | None = None,
    points: int = SETTINGS.points,
    seed: int = 0,
) -> SequenceTask:
    """`machine` as a task of such actions, multisines where None: windows of `window` s (the task's own where None),
    read at `points` points. Raises CaptureError.
    """
    window = window if window is not None else machine.log.window
    if window is None or not machine.timestep * (points - 1) <= window < np.inf:
        raise OptionError(
            f"--window {window}: how long an episode of {machine.name!r} lasts"
            + ("" if window is None else f", with {points} points {machine.timestep:g} s apart at least"),
            cure="give a number of seconds with --window, or as `window` under [log] of the task.toml",
        )
    point_times = machine.timestep * np.rint(np.linspace(0, window, points) / machine.timestep)
    sequences = (actions or Multisines()).sequences(machine, point_times, window, seed)
    scale = sequences.outputs.std(axis=(0, 1))
    # in single precision, so that the last bits of a least-squares fit do not make another library elsewhere
    library = np.float32(sequences.actions).astype(float)
    return SequenceTask(machine, point_times, library, np.where(scale > 0, np.float32(scale), 1.0))


def library_hash(task: Task) -> str | None:
    """Of the actions of a task that has so many and no others; None of one whose actions are a range."""
    library = getattr(task, "library", None)
    return None if library is None else hashlib.sha256(np.ascontiguousarray(library).tobytes()).hexdigest()


def task_of_histories(machine: Task, location: Path) -> SequenceTask:
    """`machine` with the actions that the rounds of the histories at `location` had, `most_pairs` pairs at most.

    Raises StoreError, or OptionError where they are of another machine.
    """
    histories = Histories(location)
    about = histories.attributes
    outputs = [c.name for c in machine.outputs]
    differ = [
        what
        for what, same in (
            ("task", about["task"] == machine.name),
            ("parameters", [p["name"] for p in about["parameters"]] == list(machine.space.names)),
            ("outputs", [f["name"] for f in about["features"]] == outputs),
            ("actions", about["library"] is not None),
            ("model", not is_of_another(about, machine.model)),
        )
        if not same
    ]
    if differ:
        raise OptionError(
            f"--histories {location}: of another {', '.join(differ)} than {machine.path}",
            cure="make them again with `capture gen-histories`, without a policy",
        )
    low, high = (np.array([a[end] for a in about["actions"]]) for end in ("low", "high"))
    scales = [f["scale"] for f in about["features"]]
    task = SequenceTask(machine, np.array(about["point_times"]), np.stack([low, high]), scales)
    actions = histories.read(0, min(len(histories), SETTINGS.most_pairs))["actions"]
    task.library = actions.reshape(-1, actions.shape[-1])
    return task


def log_sequences(prepared: PreparedLog, point_times: np.ndarray) -> Sequences:
    """Sequences of a log, from where its windows begin to the last of `point_times` (point,), s.

    A window begins none where that is beyond the windows there are, one behind the other (what was held out is not
    read), or where the sequence before goes on into it. Raises LogError where there is none, or samples lack.
    """
    task, log, windows = prepared.task, prepared.log, prepared.windows
    lacking = [
        name for name, every in zip(log.output_names, log.sampled.all(axis=0), strict=True) if not every
    ]
    if lacking:
        raise LogError(
            f"{log.path}: {', '.join(lacking)} has no sample in some rows, and learned identifiers read trajectories "
            "that are complete",
            cure="identify with --identifier least-squares, which needs no histories; or take that output out of the "
            "task.toml, and import the files and make the histories again",
        )
    lasts = point_times[-1]
    grid = task.timestep * np.arange(round(lasts / task.timestep) + 1)
    inputs, outputs, whole = [], [], []
    clocked, episodes = clock(log), log.episodes
    logged = LoggedInputs(clocked, log.inputs, task.timestep, task.holds)
    before, until = -1, -np.inf  # episode and end of the sequence before
    for w, (episode, start, stop) in enumerate(
        zip(windows.episode, windows.time, _stops(windows), strict=True)
    ):
        steps = episodes[int(episode)]
        time, read = clocked[steps], slice(steps.start, stop)
        ends = start + lasts
        if clocked[stop - 1] < ends - SETTINGS.beyond * np.median(np.diff(time)):
            continue
        if episode == before and start < until - SETTINGS.overlap * lasts:
            continue
        before, until = episode, ends
        inputs.append(logged.part(steps).at(start + grid))
        outputs.append(_at(start + point_times, clocked[read], log.outputs[read]))
        whole.append(w)
    if not whole:
        raise LogError(
            f"{log.path}: nowhere {lasts:g} s that are read without a break",
            cure="record longer, hold out less (--test), or make histories with a shorter --window",
        )
    sequences = resample(np.stack(inputs), task.timestep, point_times)
    initial = prepared.initial.states.rows(whole)
    return Sequences(actions_of(initial, sequences), np.stack(outputs), len(windows) - len(whole))


def _stops(windows: Windows) -> np.ndarray:
    """The step of the log after the windows that lie one behind the other from each on, (window,)."""
    stops = windows.first + windows.samples
    for w in reversed(range(len(windows) - 1)):
        if windows.first[w + 1] == stops[w] and windows.episode[w + 1] == windows.episode[w]:
            stops[w] = stops[w + 1]
    return stops


def _at(times: np.ndarray, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """`values` (step, output), sampled at `time`, at `times`: between samples, and after the last as before it."""
    before = np.clip(np.searchsorted(time, times, side="right") - 1, 0, len(time) - 2)
    weight = ((times - time[before]) / (time[before + 1] - time[before]))[:, None]
    return (1 - weight) * values[before] + weight * values[before + 1]
