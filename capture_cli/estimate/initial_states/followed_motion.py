"""How a machine moves through whole episodes, kept to what its outputs measure: the rest of it is carried along.

A robot that balances, or walks, falls over in a simulation that is driven by its commands alone. Set anew to what was
measured every few hundredths of a second, its wheels roll and its feet stand where they did, and what no output
measures (where its base is, and how fast it goes) follows from that.
"""

from dataclasses import replace

import numpy as np

from capture_cli.estimate.initial_states.from_outputs import (
    Places,
    estimated_initial_states,
    model_initial_states,
)
from capture_cli.estimate.log_windows import clock, clocked
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.windows import Windows
from capture_cli.model.coordinate_sources import measured_states
from capture_cli.model.fields import ModelFields
from capture_cli.model.states import InitialStates
from capture_cli.model.tasks.base import Task
from capture_cli.simulate.engine import Engine, Keep, Rollouts


def followed_motion(
    log: MeasuredLog, task: Task, whole: Windows, data: list[int], noise_sd: np.ndarray, threads: int | None
) -> Rollouts:
    """Rollouts, with states, of the nominal model through `whole` episodes, whose inputs are the log's.

    Those of shorter episodes stay where they end.
    data, noise_sd (output,): as of `estimated_initial_states`.
    """
    model = task.model
    first, at = _places(log, whole, task.timestep)
    read = estimated_initial_states(
        model,
        data,
        Places(clocked(log), first.ravel(), np.repeat(whole.episode, first.shape[1])),
        noise_sd,
    ).states
    controls = task.controls(whole.controls)
    count, steps = len(whole), int(whole.grid_steps.max())
    engine, fields = Engine(model, threads), ModelFields(model, count)
    task.write(fields, np.repeat(task.space.nominal[None], count, axis=0))
    places = measured_states(model, data)
    states = model_initial_states(model, count).states
    paths = [np.zeros((count, steps, size)) for size in (model.nq, model.nv, model.na)]
    diverged = np.zeros(count, dtype=bool)
    number = np.arange(count)
    for k in range(first.shape[1]):
        states = _set(states, read.rows(number * first.shape[1] + k), *places)
        begin, end = at[:, k], at[:, k + 1]
        run = int((end - begin).max())
        ahead = np.minimum(begin[:, None] + np.arange(run + 1), steps - 1)
        found = engine.rollout(
            states, controls[number[:, None], ahead], fields=fields, keep=Keep(states=True)
        )
        diverged |= found.diverged
        reached = (found.qpos, found.qvel, found.act)
        for path, new in zip(paths, reached, strict=True):
            path[number[:, None], ahead] = new
        states = InitialStates(*(new[number, end - begin] for new in reached), np.zeros(count))
    for path in paths:
        for episode, end in enumerate(whole.grid_steps):
            path[episode, end:] = path[episode, end - 1]
    return Rollouts(np.zeros((count, steps, 0)), diverged, *paths)


def _places(log: MeasuredLog, whole: Windows, timestep: float) -> tuple[np.ndarray, np.ndarray]:
    """The samples at which each of the `whole` episodes is set anew, (episode, time), and the steps of its simulation
    there and at its end, (episode, time + 1); the last ones of a shorter episode are its end.
    """
    time = clock(log)
    length = whole.mask.sum(axis=1)
    interval = float(np.median(np.diff(time)))
    every = 0.05  # s, after which measured coordinates are set anew
    most_times = 1000  # in an episode
    stride = max(1, round(every / interval), int(np.ceil(length.max() / most_times)))
    sample = np.minimum(np.arange(0, length.max(), stride), length[:, None] - 1)
    first = whole.first[:, None] + sample
    at = np.round((time[first] - time[whole.first][:, None]) / timestep).astype(int)
    return first, np.minimum(np.hstack([at, whole.grid_steps[:, None] - 1]), whole.grid_steps[:, None] - 1)


def _set(states: InitialStates, read: InitialStates, qpos: np.ndarray, qvel: np.ndarray) -> InitialStates:
    """`states` with the positions `qpos` and velocities `qvel` (indices) that were `read`."""
    positions, velocities = states.qpos.copy(), states.qvel.copy()
    positions[:, qpos], velocities[:, qvel] = read.qpos[:, qpos], read.qvel[:, qvel]
    return replace(states, qpos=positions, qvel=velocities)
