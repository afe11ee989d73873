"""What drives a recorded machine: multisines, the inputs of a log or a proposal, or one action per episode."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import mujoco
import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.context.checkpoints.policy_checkpoint import load_policy
from capture_cli.errors import OptionError, did_you_mean
from capture_cli.estimate.initial_states.from_outputs import model_initial_states
from capture_cli.log.arrays import slices_until
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.windows import gaps, usual_interval
from capture_cli.model.states import InitialStates
from capture_cli.model.target_names import object_names
from capture_cli.model.tasks.base import ActionTask, Task
from capture_cli.options.record import RecordOptions
from capture_cli.simulate.multisine import SETTINGS as MULTISINE
from capture_cli.simulate.multisine import check_amplitude, check_band, multisine_sequence, peaks
from capture_cli.store.proposal import read_action, read_inputs
from capture_cli.store.zarr_store import SETTINGS as ZARR_STORE
from capture_cli.store.zarr_store import size


@frozen
class SETTINGS:
    duration: float = 10.0  # s, of an episode unless told otherwise
    action_rate: float = 100.0  # Hz, of the log of an action unless told otherwise


# options that mean nothing where the machine is driven in another way
OF_ACTIONS = ("policy", "belief", "actions_from")
OF_POLICIES = ("policy", "belief")
OF_INPUTS = ("duration", "inputs_from", "amplitude", "band", "start", "start_velocity")
OF_MULTISINES = ("episodes", "duration", "rate", "amplitude", "band")


@dataclass(frozen=True)
class Drive:
    """time (step,) s, inputs (step, input), episode ends (episode,), initial (episode), actions (episode, action)."""

    time: np.ndarray
    inputs: np.ndarray
    ends: np.ndarray
    initial: InitialStates
    actions: np.ndarray | None = None

    def rows(self, keep: np.ndarray) -> Self:
        """The episodes numbered `keep`."""
        steps = [np.arange(e.start, e.stop) for e in slices_until(self.ends)]
        kept = np.concatenate([steps[episode] for episode in keep])
        return Drive(
            time=self.time[kept],
            inputs=self.inputs[kept],
            ends=np.cumsum([len(steps[episode]) for episode in keep]),
            initial=self.initial.rows(keep),
            actions=None if self.actions is None else self.actions[keep],
        )

    def log(self, task: Task, outputs: np.ndarray, *, name: str, source: str) -> MeasuredLog:
        """The log of one recording `name`, made by `source`, in which the outputs (step, output) were measured."""
        recording = {"name": name, "source": source, "sha256": None}
        measured = {"time": self.time, "inputs": self.inputs, "outputs": outputs, "actions": self.actions}
        return MeasuredLog.of_recording(task, recording, self.ends, **measured)


def _refuse(asked: RecordOptions, names: Sequence[str], why: str) -> None:
    """Raise OptionError where one of these was given, which means nothing here."""
    for name in names:
        if getattr(asked, name) not in (None, RecordOptions.default(name)):
            raise OptionError(f"--{name.replace('_', '-')} means nothing: {why}", cure="leave it out")


def drive(task: Task, asked: RecordOptions, generator: np.random.Generator) -> Drive:
    """What drives the machine of `task` as asked.

    A task of actions is driven by one action per episode, any other by multisines or by the inputs that `inputs_from`
    holds. Raises OptionError, also for an option that means nothing there.
    """
    if isinstance(task, ActionTask):
        _refuse(asked, OF_INPUTS, f"an episode of {task.name!r} is what its action says")
        if asked.actions_from is not None:
            _refuse(asked, OF_POLICIES, f"the action is that of {asked.actions_from}")
        return _by_actions(task, asked, generator)
    _refuse(asked, OF_ACTIONS, f"{task.name!r} has no actions")
    if asked.inputs_from is not None:
        _refuse(asked, OF_MULTISINES, f"time and inputs are those of {asked.inputs_from}")
    return _by_inputs(task, asked, generator)


# --- by actions ---


def _by_actions(task: ActionTask, asked: RecordOptions, generator: np.random.Generator) -> Drive:
    rate = SETTINGS.action_rate if asked.rate is None else asked.rate
    _check_rate(rate, task)
    _check_samples(_steps(task, rate), task.point_times[-1], rate)
    _check_size(task, asked, asked.episodes * _steps(task, rate), asked.episodes * task.point_times[-1])
    actions = _actions(task, asked, generator)
    return acted(task, actions, rate)


def acted(task: ActionTask, actions: np.ndarray, rate: float) -> Drive:
    """One episode per action, (episode, action), logged at `rate` Hz: the mean of each input over the time until the
    next sample, so that a machine which holds them in between moves as far as the action says.
    """
    driven = task.episodes(actions)
    steps, episodes = _steps(task, rate), len(actions)
    time = np.arange(steps) / rate
    inputs = np.stack([_sampled(sequence, task, time) for sequence in driven.inputs])
    return Drive(
        time=np.tile(time, episodes),
        inputs=inputs.reshape(episodes * steps, -1),
        ends=steps * (1 + np.arange(episodes)),
        initial=driven.initial,
        actions=actions,
    )


def _steps(task: ActionTask, rate: float) -> int:
    """How many samples an episode has at `rate` Hz."""
    return round(task.point_times[-1] * rate) + 1


def _actions(task: ActionTask, asked: RecordOptions, generator: np.random.Generator) -> np.ndarray:
    """Actions (episode, action): of a proposal, or as the policy chooses them under the parameters it believes in."""
    if asked.actions_from is not None:
        action = read_action(asked.actions_from, task.name, task.actions.names)
        return np.repeat(action[None], asked.episodes, axis=0)
    chooser = load_policy(asked.policy or "random", task)
    believed = np.repeat(task.space.nominal[None], asked.episodes, axis=0)
    if asked.belief == "random":  # drawn anew for each episode, as in the course of an identification
        believed = task.space.from_unit(generator.random(believed.shape))
    return chooser.act(believed, generator.random((asked.episodes, len(task.actions))))


def _sampled(sequence: np.ndarray, task: Task, time: np.ndarray) -> np.ndarray:
    """Inputs (grid, input) at `time` (step,): the mean over the first of the commands that there are until the next
    sample; the value where they change evenly.
    """
    timestep = task.timestep
    grid = timestep * np.arange(len(sequence) + 1)
    until = np.diff(time, append=2 * time[-1] - time[-2])
    values = np.empty((len(time), sequence.shape[1]))
    for k, (hold, column) in enumerate(zip(task.holds, sequence.T, strict=True)):
        acts = time + hold.late
        if np.isinf(hold.commands):
            values[:, k] = np.interp(acts, grid[:-1], column)
            continue
        edges = np.stack([acts, acts + until / hold.commands])
        # past its end a sequence holds its last value
        after = np.maximum(edges - grid[-1], 0.0) * column[-1]
        travelled = np.interp(edges, grid, np.append(0.0, timestep * np.cumsum(column))) + after
        values[:, k] = np.diff(travelled, axis=0) / np.diff(edges, axis=0)
    return values


# --- by inputs ---


def _by_inputs(task: Task, asked: RecordOptions, generator: np.random.Generator) -> Drive:
    if asked.inputs_from is None:
        time, inputs, ends = _multisines(task, asked, generator)
    else:
        time, inputs, ends = _recorded_inputs(task, asked)
    return Drive(time, inputs, ends, _initial_states(task.model, len(ends), asked, generator))


def _multisines(
    task: Task, asked: RecordOptions, generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Multisines in `band` Hz that peak at `amplitude`: time (step,), inputs (step, input), episode ends (episode,)."""
    duration = SETTINGS.duration if asked.duration is None else asked.duration
    amplitude = asked.amplitude or {}
    if asked.rate is not None:
        _check_rate(asked.rate, task)
    check_band(asked.band)
    check_amplitude(task, amplitude)
    interval = task.timestep if asked.rate is None else 1.0 / asked.rate
    _check_size(task, asked, asked.episodes * (duration / interval + 1), asked.episodes * duration)
    steps = round(duration / interval) + 1
    _check_samples(steps, duration, 1.0 / interval)
    _check_sampled(asked, interval, task)
    time = interval * np.arange(steps)
    farthest = peaks(task, amplitude)
    sequences = [
        multisine_sequence(task, time, farthest, asked.band, generator) for _ in range(asked.episodes)
    ]
    return np.tile(time, asked.episodes), np.concatenate(sequences), steps * (1 + np.arange(asked.episodes))


def _recorded_inputs(task: Task, asked: RecordOptions) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of a log or a proposal: time (step,), inputs (step, input), episode ends (episode,)."""
    path = asked.inputs_from
    names = tuple(c.name for c in task.inputs)
    if Path(path).is_file():  # a log is a folder
        time, inputs = read_inputs(path, task.name, list(names))
        _check_size(task, asked, len(time), time[-1] - time[0])
        return time, inputs, np.array([len(time)])
    source = MeasuredLog.read(path, asked.max_log_size)
    if source.input_names != names:
        raise OptionError(
            f"--inputs-from {path}: its inputs are ({', '.join(source.input_names)})",
            cure=f"give a log with the task's inputs ({', '.join(names)})",
        )
    _refuse_gaps(source)
    _check_size(task, asked, len(source.time), source.longest * len(source.episode_ends))
    return source.time, source.inputs, source.episode_ends


def _refuse_gaps(source: MeasuredLog) -> None:
    """Raise OptionError for a gap, in which the inputs are unknown: windows may end there, but not a recording."""
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


def _initial_states(
    model: mujoco.MjModel, count: int, asked: RecordOptions, generator: np.random.Generator
) -> InitialStates:
    """The model's own, but for joints of which positions or velocities are given."""
    initial = model_initial_states(model, count).states
    for option, given, state, address in (
        ("--start", asked.start, initial.qpos, model.jnt_qposadr),
        ("--start-velocity", asked.start_velocity, initial.qvel, model.jnt_dofadr),
    ):
        for joint, (low, high) in (given or {}).items():
            number = _joint_of_one_coordinate(model, joint, option)
            state[:, address[number]] = generator.uniform(low, high, count)
    return initial


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


# --- either ---


def _check_samples(steps: int, duration: float, rate: float) -> None:
    if steps < 2:
        raise OptionError(
            f"an episode of {duration:g} s at {rate:g} Hz has a single sample",
            cure=f"give a --rate of {1 / duration:g} Hz or more, or record for longer",
        )


def _check_size(task: Task, asked: RecordOptions, steps: float, duration: float) -> None:
    """Raise OptionError where a log of so many steps in `duration` s, or its simulation, takes more memory than is
    read.
    """
    most = ZARR_STORE.most if asked.max_log_size is None else asked.max_log_size
    channels = 1 + len(task.inputs) + len(task.outputs)
    taken = 8.0 * channels * max(steps, duration / task.timestep)
    if taken > most:
        raise OptionError(
            f"{steps:.3g} samples of {channels} channels, simulated for {duration:.3g} s in steps of "
            f"{task.timestep:g} s, take {size(taken)}; the most that is recorded is {size(most)}",
            cure="record less: fewer --episodes, a shorter --duration; or allow more: --max-log-size 2GB",
        )


def _check_rate(rate: float, task: Task) -> None:
    if rate * task.timestep > 1 + 1e-6:
        raise OptionError(
            f"--rate {rate:g}: the model makes {1 / task.timestep:g} steps per second, and knows nothing in between",
            cure=f"give {1 / task.timestep:g} at most, or the model a smaller timestep",
        )


def _check_sampled(asked: RecordOptions, interval: float, task: Task) -> None:
    """Raise OptionError where a --band that was given has frequencies that samples every `interval` s cannot have."""
    (low, high), highest = asked.band, 0.5 / interval
    if asked.band == MULTISINE.band or high <= highest:
        return
    faster = f", or a higher --rate (the model allows {1 / task.timestep:g})"
    raise OptionError(
        f"--band {low:g} {high:g}: {1 / interval:g} samples per second tell nothing above {highest:g} Hz",
        cure=f"give {highest:g} Hz at most" + ("" if asked.rate is None else faster),
    )
