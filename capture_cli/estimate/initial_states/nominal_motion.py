"""How a machine moves through whole episodes, with its states: at the nominal values of its parameters or elsewhere."""

import numpy as np

from capture_cli.estimate.initial_states.from_outputs import model_initial_states
from capture_cli.model.fields import ModelFields
from capture_cli.model.states import InitialStates
from capture_cli.model.tasks.base import Task
from capture_cli.simulate.engine import Engine, Keep, Rollouts


def nominal_motion(task: Task, controls: np.ndarray, *, threads: int | None = None) -> Rollouts:
    """Rollouts, with states, under controls (episode, grid, nu), from the start that the model gives."""
    initial = model_initial_states(task.model, len(controls)).states
    return motion_at(task, task.space.nominal, initial, controls, threads=threads)


def motion_at(
    task: Task, point: np.ndarray, initial: InitialStates, controls: np.ndarray, *, threads: int | None
) -> Rollouts:
    """Likewise at parameters `point` (parameter,), from `initial` (episode,)."""
    fields = ModelFields(task.model, len(controls))
    task.write(fields, np.repeat(point[None], len(controls), axis=0))
    return Engine(task.model, threads).rollout(initial, controls, fields=fields, keep=Keep(states=True))
