"""What a log and a task have to be for anything to be found: raised before any work, with the cure."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from capture_cli.common.evenly_spread import evenly_spread
from capture_cli.errors import FitError, LogError, ModelError, OptionError
from capture_cli.estimate.log_windows import interval_of
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve.base import Trial
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.shorter_window import set_shorter
from capture_cli.log.step_length import unsuitable_step
from capture_cli.log.windows import SETTINGS as WINDOWS
from capture_cli.model.coordinate_sources import unmeasured_joints
from capture_cli.model.tasks.base import Channel, Task
from capture_cli.simulate.engine import Engine
from capture_cli.simulate.simulator import Simulator

IMPORT_AGAIN = "import it again: columns, scales and offsets are applied by `capture import-log`"


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


def check_changes(log: MeasuredLog, task: Task, noise_sd: np.ndarray) -> None:
    """Raise LogError where an output never changes, so that the log does not say how noisy it is."""
    for channel, sd, values, sampled in zip(task.outputs, noise_sd, log.values.T, log.sampled.T, strict=True):
        if sd == 0:
            raise LogError(
                f"{log.path}: output {channel.name!r} never changes: always {values[sampled][0]:.6g} {channel.unit}",
                cure=f"if it should move, mend the sensor or the column {channel.column!r}; if it rests, take it out "
                "of the task.toml and import again, or say there how noisy it is (noise_sd)",
            )


def check_fitted(prepared: PreparedLog) -> None:
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


def check_long_enough(log: MeasuredLog, duration: float | None) -> None:
    """Raise LogError where episodes, or windows of `duration` s, are too short to tell anything; whole episodes where
    None. OptionError where `duration` is none.
    """
    if duration is not None and not 0 < duration < np.inf:
        raise OptionError(f"--window {duration:g}", cure="give a positive number of seconds")
    longest = log.longest
    if duration is not None and longest < WINDOWS.shortest_episode * duration:
        raise LogError(
            f"{log.path}: its longest episode lasts {longest:.3g} s, and a window {duration:.3g} s",
            cure=set_shorter(longest, log.steps_of_longest, option=True),
        )
    fewest_samples = 8  # of the longest episode
    if max(e.stop - e.start for e in log.episodes) < fewest_samples:
        raise LogError(
            f"{log.path}: no episode has {fewest_samples} samples",
            cure="record longer, or at a higher rate",
        )
    interval = interval_of(log)
    if duration is not None and duration < WINDOWS.fewest_in_window * interval:
        raise LogError(
            f"{log.path}: a window of {duration:.3g} s holds fewer than {WINDOWS.fewest_in_window} samples, "
            f"which are {interval:.3g} s apart",
            cure="set a longer `window` under [log] of the task.toml, or pass --window",
        )


def check_step(log: MeasuredLog, task: Task, duration: float | None) -> None:
    """Raise ModelError where the model's time step does not suit the log, or windows of `duration` s; whole episodes
    where None.
    """
    lasts = log.longest if duration is None else duration
    found = unsuitable_step(task.timestep, interval_of(log), lasts)
    if found is not None:
        raise ModelError(f"{log.path}: {found[0]}", cure=found[1])


def check_parameters_move_outputs(prepared: PreparedLog, *, seed: int, threads: int | None) -> int:
    """Raise FitError naming parameters that move no output, at the nominal point, the centre, nor at random ones.

    Some windows and a short move tell of most. What seems to show nowhere is taken to the ends of its range in all
    windows: a wheel may slip, or a stop be hit, in few of them, and not near these points. Returns how many windows
    were simulated to see that.
    """
    simulator = Simulator(
        prepared.task,
        engine=Engine(prepared.task.model, threads),
        difference_step=prepared.difference_step,
    )
    space = simulator.space
    if not len(space):
        return 0
    random = np.random.default_rng(seed).uniform(0.1, 0.9, len(space))
    bases = np.clip([space.to_unit(space.nominal), np.full(len(space), 0.5), random], 0, 1)
    moved_at_first = 16  # windows, evenly spread
    some = prepared.part(evenly_spread(len(prepared.windows), moved_at_first))
    moves_share = 0.05  # of the range: the step with which a parameter must move some output
    short = [(some, base, base + np.where(base < 0.5, moves_share, -moves_share)) for base in bases]
    far = [(prepared, base, np.full(len(space), end)) for base in bases for end in (0.0, 1.0)]
    still, seen = np.ones(len(space), dtype=bool), np.zeros(len(space), dtype=bool)
    for part, base, to in [*short, *far]:
        if not still.any():
            return simulator.rollouts
        moves, finite = _moves_outputs(part, simulator, base, to, np.flatnonzero(still))
        seen[still] |= finite
        still[still] = ~moves
    names = [name for name, fixed in zip(space.names, still & seen, strict=True) if fixed]
    if not names:
        return simulator.rollouts  # where everything diverged nothing can be told: the fit will say so
    raise FitError(
        f"task {prepared.task.name!r}: {', '.join(names)} moves no output of this log, so it cannot be identified",
        cure="remove it from the task.toml, correct what it sets, or record a motion in which it matters",
    )


def _moves_outputs(
    part: PreparedLog, simulator: Simulator, base: np.ndarray, to: np.ndarray, columns: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Whether outputs differ where each of the parameters `columns` is as in `to` and not as in `base` (parameter,), in
    the unit cube, and whether both were simulated in some window, (column,) each.
    """
    data = part.data(simulator)
    moved = np.repeat(base[None], 1 + len(columns), axis=0)
    moved[np.arange(1, len(moved)), columns] = to[columns]
    corrections = np.zeros((len(moved), *data.initial_sd.shape))
    outputs, diverged = part.evaluate(simulator, Trial(simulator.space.from_unit(moved), corrections))
    change = np.abs(data.residual(outputs[1:]) - data.residual(outputs[:1])).max(axis=2)
    valid = ~(diverged[1:] | diverged[:1])
    moves_least = 1e-4  # of the noise floor: less is nothing
    return (valid & (change > moves_least)).any(axis=1), valid.any(axis=1)


def all_diverged(task: Task) -> FitError:
    """What to say where no simulation of the log's windows stayed finite."""
    cure = (
        "see whether `capture inspect` finds a column in another unit (degrees, mm); tighten the parameters' "
        "bounds, shorten the window, or reduce the model's timestep"
    )
    unseen = unmeasured_joints(task.model, [c.index for c in task.outputs])
    if unseen:
        cure += (
            f"; or measure the position of {', '.join(unseen)}, which no output gives: windows begin where a "
            "simulation of the whole episode, driven by the log's inputs, takes it, and that may run away"
        )
    return FitError("every simulation tried diverged", cure=cure)
