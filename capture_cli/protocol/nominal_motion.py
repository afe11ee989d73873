"""How a machine moves at the nominal values of its parameters, from the start that its model gives."""

from __future__ import annotations

import numpy as np

from capture_cli.sim.engine import Engine, ModelFields, Rollouts
from capture_cli.sim.starts import model_starts
from capture_cli.tasks.base import Task


def nominal_motion(
    task: Task, controls: np.ndarray, *, steps: int | None = None, threads: int | None = None
) -> Rollouts:
    """Rollouts, with states, of `steps` steps (all where None) under controls (episode, grid, nu)."""
    count = len(controls)
    fields = ModelFields(task.model, count)
    task.write(fields, np.repeat(task.space.nominal[None], count, axis=0))
    return Engine(task.model, threads).rollout(
        starts=model_starts(task.model, count).starts,
        controls=controls,
        steps=controls.shape[1] if steps is None else steps,
        fields=fields,
        states=True,
    )
