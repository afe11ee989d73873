"""Where the windows of a log start: where an action says, or what the outputs say; and whether the two agree."""

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from capture_cli.common.evenly_spread import evenly_spread
from capture_cli.estimate.initial_states.followed_motion import followed_motion
from capture_cli.estimate.initial_states.from_outputs import (
    InitialStateEstimate,
    Places,
    estimated_initial_states,
    from_episodes,
    known_initial,
    with_known,
)
from capture_cli.estimate.initial_states.nominal_motion import nominal_motion
from capture_cli.estimate.log_windows import clocked, cut_log
from capture_cli.estimate.noise.noise_floor import NoiseFloor
from capture_cli.estimate.prepared_log import PreparedLog, attitudes
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.windows import Windows
from capture_cli.model.coordinate_sources import measures_every_coordinate, sources_of, unmeasured_joints
from capture_cli.model.fields import ModelFields
from capture_cli.model.loop_closure import SETTINGS as LOOP_CLOSURE
from capture_cli.model.loop_closure import LoopClosure
from capture_cli.model.quaternion_signs import aligned
from capture_cli.model.tasks.base import ActionTask, Task
from capture_cli.simulate.engine import Engine, Keep, Rollouts
from capture_cli.simulate.simulator import Simulator


def log_initial_states(
    log: MeasuredLog, task: Task, windows: Windows, noise: NoiseFloor, threads: int | None
) -> InitialStateEstimate:
    """Where every window starts: where its action says, if it begins an episode of one; else what the outputs say."""
    data = readable(task)
    acted = begins_by_action(log, task, windows)
    if acted.any():
        initial = task.episodes(log.actions[windows.episode]).initial
        known = known_initial(task.model, data, replace(initial, time=windows.time), noise.sd)
        if acted.all():
            return known
    all_measured = measures_every_coordinate(task.model, data)
    believed: Sequence[InitialStateEstimate | None] = [None]
    slack = None
    if task.model.neq or not all_measured:
        simulated, slack = _of_whole_episodes(log, task, windows, noise, threads)
        believed = believed if all_measured else simulated
    reads = [
        estimated_initial_states(
            task.model,
            data,
            Places(clocked(log), windows.first, windows.episode),
            noise.sd,
            unmeasured=unmeasured,
            slack=slack,
        )
        for unmeasured in believed
    ]
    read = _nearest(task, windows, noise, reads, threads)
    return with_known(read, known, acted) if acted.any() else read


def _nearest(
    task: Task,
    windows: Windows,
    noise: NoiseFloor,
    reads: Sequence[InitialStateEstimate],
    threads: int | None,
) -> InitialStateEstimate:
    """The one of `reads` of the windows' initial states from which the nominal model comes nearest to the log; the
    first of those that come as near.
    """
    if len(reads) == 1:
        return reads[0]
    # windows, evenly spread, that tell which of several ways to read initial states is nearer to the log
    judged = 40
    some = evenly_spread(len(windows), judged)
    own, simulator = windows.rows(some), Simulator(task, threads=threads)

    def distance(read: InitialStateEstimate) -> float:
        found = simulator.simulate(own, read.states.rows(some), task.space.nominal)
        outputs = aligned(found.outputs[0], own.measured, attitudes(task))
        squares = np.where(own.sampled, np.square((outputs - own.measured) / noise.sd), 0.0).sum(axis=(1, 2))
        return float(np.median(np.where(found.diverged[0], np.inf, squares / own.sampled.sum(axis=(1, 2)))))

    return min(reads, key=distance)


def readable(task: Task) -> list[int]:
    """Which number of sensordata each output is; -1 of an actuator's where gears are open, and what it says of the
    joints with them.
    """
    fields = ModelFields(task.model, 1)
    task.write(fields, task.space.nominal[None])
    data = [c.index for c in task.outputs]
    if "actuator_gear" not in fields.values:
        return data
    objects = task.model.sensor_objtype[[c.sensor for c in task.outputs]]
    return np.where(objects == mujoco.mjtObj.mjOBJ_ACTUATOR, -1, data).tolist()


def begins_by_action(log: MeasuredLog, task: Task, windows: Windows) -> np.ndarray:
    """Which windows begin an episode whose action says where, (window,)."""
    if not isinstance(task, ActionTask) or log.actions is None:
        return np.zeros(len(windows), dtype=bool)
    return windows.first == np.array([e.start for e in log.episodes])[windows.episode]


def as_acted(prepared: PreparedLog) -> PreparedLog:
    """With no doubt about initial states that an action says."""
    acted = begins_by_action(prepared.log, prepared.task, prepared.windows)
    sd = np.where(acted[:, None], 0.0, prepared.initial.sd)
    return replace(prepared, initial=replace(prepared.initial, sd=sd))


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
        prepared.initial.states.rows(acted),
        task.controls(windows.rows(acted).controls)[:, :1],
        keep=Keep(columns=np.array([c.index for c in task.outputs])),
    )
    apart = (windows.measured[acted, 0] - said.sensors[:, 0]) / prepared.noise.sd
    # p of the first samples of episodes below which they do not begin where their actions say
    agrees = 1e-3
    return bool(chdtrc(apart.size, np.square(apart).sum()) > agrees)


def _of_whole_episodes(
    log: MeasuredLog, task: Task, windows: Windows, noise: NoiseFloor, threads: int | None
) -> tuple[list[InitialStateEstimate], np.ndarray | None]:
    """What the nominal model shows in whole episodes: what the coordinates do that no output measures, and how far
    equality constraints give way (2, row); None where there are none or all simulations diverge.

    Driven by the inputs alone; and, where there are no such constraints, kept to what outputs measure.
    """
    model, data = task.model, readable(task)
    whole = cut_log(log, task, None)
    driven = nominal_motion(task, task.controls(whole.controls), threads=threads)
    motions = [driven]
    if not model.neq and unmeasured_joints(model, data) and sources_of(model, data):
        motions.append(followed_motion(log, task, whole, data, noise.sd, threads))
    number, step = in_whole_episodes(windows, whole)
    believed = [from_episodes(model, m, window_episode=number, window_step=step) for m in motions]
    return believed, _slack(
        model, driven, whole.grid_steps, max(1, round(LOOP_CLOSURE.every / task.timestep))
    )


def in_whole_episodes(windows: Windows, whole: Windows) -> tuple[np.ndarray, np.ndarray]:
    """In which of the `whole` episodes each window begins, and at which step of their rollouts, (window,) each."""
    number = np.searchsorted(whole.first, windows.first, side="right") - 1
    step = np.round((windows.time - whole.time[number]) / windows.timestep).astype(int)
    return number, np.minimum(step, int(whole.grid_steps.max()) - 1)


def _slack(model: mujoco.MjModel, whole: Rollouts, steps: np.ndarray, stride: int) -> np.ndarray | None:
    """How far equality constraints give way in episodes of so many `steps` (episode,)."""
    kept = [(e, slice(0, steps[e], stride)) for e in np.flatnonzero(~whole.diverged)]
    if not model.neq or not kept:
        return None
    return LoopClosure(model).slack_of(
        *(np.concatenate([states[at] for at in kept]) for states in (whole.qpos, whole.qvel))
    )
