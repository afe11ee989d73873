"""What drives a recorded machine: multisines, the inputs of a log or a proposal, or one action per episode."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from capture_cli.errors import OptionError, did_you_mean
from capture_cli.multisine import check_amplitude, multisine_tape, peak
from capture_cli.sim.engine import Starts
from capture_cli.sim.starts import model_starts
from capture_cli.sim.target_names import object_names
from capture_cli.sim.windows import gaps, usual_interval
from capture_cli.stages.policy_checkpoint import load_policy
from capture_cli.stores.measured_log import MeasuredLog
from capture_cli.stores.proposal import read_action, read_inputs
from capture_cli.tasks.base import ActionTask, Task

DURATION = 10.0  # s, of an episode unless told otherwise
ACTION_RATE = 100.0  # Hz, of the log of an action unless told otherwise


@dataclass(frozen=True)
class Drive:
    """time (step,) s, inputs (step, input), episode ends (episode,), starts (episode), actions (episode, action)."""

    time: np.ndarray
    inputs: np.ndarray
    ends: np.ndarray
    starts: Starts
    actions: np.ndarray | None = None


def drive_by_actions(
    task: ActionTask,
    *,
    episodes: int,
    rate: float | None,
    policy: str | None,
    generator: np.random.Generator,
    actions_from: Path | None = None,
    belief: str = "nominal",
) -> Drive:
    """One action per episode, as the policy (a random one where None) chooses it under the parameters it believes in.

    belief: "nominal", or "random": drawn anew for each episode, as in the course of an identification.
    actions_from: a proposal, whose action every episode takes instead.

    Inputs are logged at `rate` Hz (`ACTION_RATE` where None): the mean of each over the time until the next sample, so
    that a machine which holds them in between moves as far as the action says.
    """
    rate = ACTION_RATE if rate is None else rate
    _check_positive(episodes=episodes, rate=rate)
    if actions_from is not None:
        action = read_action(actions_from, task.name, task.actions.names)
        actions = np.repeat(action[None], episodes, axis=0)
    else:
        chooser = load_policy(policy or "random", task)
        believed = np.repeat(task.space.nominal[None], episodes, axis=0)
        if belief == "random":
            believed = task.space.from_unit(generator.random(believed.shape))
        actions = chooser.act(believed, generator.random((episodes, len(task.actions))))
    driven = task.episodes(actions)
    steps = round(task.point_times[-1] * rate) + 1
    _check_samples(steps, task.point_times[-1], rate)
    time = np.arange(steps) / rate
    inputs = np.stack([_sampled(tape, task.timestep, time, task.linear) for tape in driven.inputs])
    return Drive(
        time=np.tile(time, episodes),
        inputs=inputs.reshape(episodes * steps, -1),
        ends=steps * (1 + np.arange(episodes)),
        starts=driven.starts,
        actions=actions,
    )


def _sampled(tape: np.ndarray, timestep: float, time: np.ndarray, linear: np.ndarray) -> np.ndarray:
    """A tape (grid, input) at `time` (step,): its value where it is `linear`, its mean until the next sample if not."""
    grid = timestep * np.arange(len(tape) + 1)
    edges = np.append(time, 2 * time[-1] - time[-2])
    values = np.empty((len(time), tape.shape[1]))
    for k, column in enumerate(tape.T):
        if linear[k]:
            values[:, k] = np.interp(time, grid[:-1], column)
            continue
        # past its end a tape holds its last value
        after = np.maximum(edges - grid[-1], 0.0) * column[-1]
        travelled = np.interp(edges, grid, np.append(0.0, timestep * np.cumsum(column))) + after
        values[:, k] = np.diff(travelled) / np.diff(edges)
    return values


def drive_by_inputs(
    machine: Task,
    *,
    episodes: int,
    duration: float | None,
    rate: float | None,
    inputs_from: Path | None,
    amplitude: Mapping[str, float],
    band: tuple[float, float],
    start: Mapping[str, tuple[float, float]],
    start_velocity: Mapping[str, tuple[float, float]],
    generator: np.random.Generator,
) -> Drive:
    """Multisines in `band` Hz that peak at `amplitude`, or the inputs of `inputs_from`, a log or a proposal.

    Raises OptionError.
    """
    duration = DURATION if duration is None else duration
    time, inputs, ends = _tapes(machine, episodes, duration, rate, inputs_from, amplitude, band, generator)
    return Drive(time, inputs, ends, _starts(machine.model, len(ends), start, start_velocity, generator))


def _tapes(machine, episodes, duration, rate, inputs_from, amplitude, band, generator):
    """time (step,), inputs (step, input) and episode ends (episode,)."""
    if inputs_from is not None and Path(inputs_from).is_file():  # a log is a folder
        time, inputs = read_inputs(inputs_from, machine.name, [c.name for c in machine.inputs])
        return time, inputs, np.array([len(time)])
    if inputs_from is not None:
        source = MeasuredLog.read(inputs_from)
        if source.input_names != tuple(c.name for c in machine.inputs):
            raise OptionError(
                f"--inputs-from {inputs_from}: its inputs are ({', '.join(source.input_names)})",
                cure=f"give a log with the task's inputs ({', '.join(c.name for c in machine.inputs)})",
            )
        _refuse_gaps(source)
        return source.time, source.inputs, source.episode_ends
    _check_positive(episodes=episodes, duration=duration, rate=machine.timestep if rate is None else rate)
    if not 0 <= band[0] < band[1] < np.inf:
        raise OptionError(
            f"--band {band[0]:g} {band[1]:g}", cure="give two frequencies in Hz, the lower one first"
        )
    check_amplitude(machine, amplitude)
    interval = machine.timestep if rate is None else 1.0 / rate
    steps = round(duration / interval) + 1
    _check_samples(steps, duration, 1.0 / interval)
    time = interval * np.arange(steps)
    peaks = np.array([peak(machine.model, channel, amplitude) for channel in machine.inputs])
    tapes = [multisine_tape(machine, time, peaks, band, generator) for _ in range(episodes)]
    return np.tile(time, episodes), np.concatenate(tapes), steps * (1 + np.arange(episodes))


def _refuse_gaps(source: MeasuredLog) -> None:
    """Raise OptionError where nobody knows what drove the machine: windows end there, and what is recorded cannot."""
    for number, steps in enumerate(source.episodes):
        time = source.time[steps]
        usual = usual_interval(time, source.sampled[steps])
        found = gaps(time, usual)
        if found.size:
            begin, end = time[found[0] : found[0] + 2]
            raise OptionError(
                f"--inputs-from {source.path}: episode {number} has a gap of {end - begin:.3g} s after {begin:.9g} s "
                f"({found.size} in all), and samples {usual:.3g} s apart elsewhere: nobody knows what was put in there",
                cure="import the log again with what comes before and after as episodes of their own ([log] episode)",
            )


def _starts(model, count: int, positions, velocities, generator) -> Starts:
    """The model's own, but for joints of which positions or velocities are given."""
    starts = model_starts(model, count).starts
    for option, given, state, address in (
        ("--start", positions, starts.qpos, model.jnt_qposadr),
        ("--start-velocity", velocities, starts.qvel, model.jnt_dofadr),
    ):
        for joint, (low, high) in given.items():
            number = _joint_of_one_coordinate(model, joint, option)
            state[:, address[number]] = generator.uniform(low, high, count)
    return starts


def _joint_of_one_coordinate(model: mujoco.MjModel, joint: str, option: str) -> int:
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint)
    if number < 0:
        raise OptionError(
            f"{option}: the model has no joint {joint!r}",
            cure=did_you_mean(joint, object_names(model, "joint")),
        )
    kind = mujoco.mjtJoint(model.jnt_type[number])
    if kind not in (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE):
        name = kind.name.removeprefix("mjJNT_").lower()
        raise OptionError(
            f"{option} gives joint {joint!r} one number, and it is a {name} joint, which has several coordinates",
            cure="write where it begins into the model's first keyframe, <key qpos=... qvel=...>; "
            f"{option} is for joints that slide or turn about one axis",
        )
    return number


def _check_samples(steps: int, duration: float, rate: float) -> None:
    if steps < 2:
        raise OptionError(
            f"an episode of {duration:g} s at {rate:g} Hz has a single sample",
            cure=f"give a --rate of {1 / duration:g} Hz or more, or record for longer",
        )


def _check_positive(**numbers: float) -> None:
    for name, number in numbers.items():
        if not 0 < number < np.inf:
            raise OptionError(f"--{name} {number:g}", cure="give a positive number")
