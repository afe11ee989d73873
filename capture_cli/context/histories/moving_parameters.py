"""Which parameters of a task move nothing that it observes: learning from its histories could not tell them apart."""

from collections.abc import Sequence

import numpy as np

from capture_cli.common.evenly_spread import evenly_spread
from capture_cli.errors import FitError, TaskError
from capture_cli.model.tasks.base import ActionTask
from capture_cli.model.tasks.sequence_task import SequenceTask
from capture_cli.simulate.simulator import Simulator


def check_parameters_move_trajectories(task: SequenceTask, *, seed: int, threads: int | None) -> None:
    """Raise TaskError where `task` has no parameters, FitError naming those that move no output from end to end of
    their ranges, the others at the nominal point, the centre and a random one.
    """
    if not len(task.space):
        raise TaskError(
            f"task {task.name!r} has no parameters, and histories are of how they are found",
            cure="open one: [parameters.NAME] in the task.toml",
        )
    simulator = Simulator(task, threads=threads)
    still = np.arange(len(task.space))
    # Tried, the more only with parameters that the fewer do not show: a stop may hardly ever be hit
    actions = (8, 64)
    for count in actions:
        rows = evenly_spread(len(task.library), count)
        still = _still(simulator, task.library[rows], still, seed)
    if not still.size:
        return
    names = ", ".join(task.space.names[k] for k in still)
    raise FitError(
        f"task {task.name!r}: {names} moves no output under any action that was tried, so nothing can be learned of it",
        cure="remove it from the task.toml, correct what it sets, or see that the machine moves: drive it further "
        "(--amplitude), for longer (--window), or as a log did (--inputs-from)",
    )


def _still(simulator: Simulator, actions: np.ndarray, candidates: Sequence[int], seed: int) -> np.ndarray:
    """Those of the parameters `candidates` that move no output under the actions (n, action)."""
    space, still = simulator.space, np.asarray(candidates, dtype=int)
    random = np.random.default_rng(seed).uniform(0.1, 0.9, len(space))
    for base in (space.to_unit(space.nominal), np.full(len(space), 0.5), random):
        if not still.size:
            break
        points = np.repeat(np.clip(base, 0, 1)[None], 1 + 2 * len(still), axis=0)
        for row, k in enumerate(still):
            points[1 + 2 * row : 3 + 2 * row, k] = 0, 1
        still = still[~_moved(simulator, space.from_unit(points), actions)]
    return still


def _moved(simulator: Simulator, points: np.ndarray, actions: np.ndarray) -> np.ndarray:
    """Whether any two of the base and both ends, points (1 + 2 * tried, parameter), differ in an output, (tried,).

    Where simulations diverge nothing can be told, and it counts as moved.
    """
    task: ActionTask = simulator.task
    shape = len(points), len(actions)
    trajectories, diverged = simulator.trajectories(
        np.repeat(points, len(actions), axis=0), np.tile(actions, (len(points), 1))
    )
    scaled = trajectories / np.array([f.scale for f in task.features])
    scaled = scaled.reshape(*shape, -1)
    ends = scaled[1:].reshape(-1, 2, *scaled.shape[1:])
    change = np.maximum(
        np.abs(ends - scaled[0]).max(axis=(1, 3)), np.abs(ends[:, 0] - ends[:, 1]).max(axis=2)
    )
    lost = diverged.reshape(shape)
    lost = lost[0] | lost[1:].reshape(-1, 2, len(actions)).any(axis=1)
    moves_least = 1e-9  # of a feature's scale: less is rounding
    return ((change > moves_least) & ~lost).any(axis=1) | lost.all(axis=1)
