"""`capture tasks`: the built-in tasks, or one task in full."""

from typing import Any

from capture_cli.log.checks.parameter_bounds import warn_of_bounds
from capture_cli.model.tasks import REGISTRY, load_task
from capture_cli.model.tasks.base import Task


def describe(task: str | None) -> list[dict[str, Any]]:
    """Every built-in task, or the one of `task`, with parameters, inputs and outputs."""
    if task is None:
        return [_one(cls()) for _, cls in REGISTRY.items()]
    found = load_task(task)
    warn_of_bounds(found)
    return [_one(found)]


def _one(task: Task) -> dict[str, Any]:
    return {
        "name": task.name,
        "timestep": task.timestep,
        "window": task.log.window,
        "parameters": [
            {"name": p.name, "unit": p.unit, "low": p.low, "high": p.high, "nominal": p.nominal}
            for p in task.space
        ],
        "inputs": [{"name": c.name, "unit": c.unit, "column": c.column} for c in task.inputs],
        "outputs": [
            {"name": c.name, "unit": c.unit, "column": c.column, "noise_sd": c.noise_sd} for c in task.outputs
        ],
    }
