"""What grows, or falls, with the time since a machine was started: a motor that warms, a tank that runs empty."""

from collections.abc import Callable, Sequence

import numpy as np

from capture_cli.model.effects._kernel import Coefficients, Companion, call
from capture_cli.model.parameters import Parameter
from capture_cli.model.world import Force, World

TIME_CONSTANT = Parameter("time_constant", "s", 0.5, 100.0, 10.0)


def grown(time, *, change, time_constant):
    """How many times as large at `time`, s, since it began: 1 + change (1 - e^(-time / time_constant))."""
    return 1 - change * np.expm1(-np.maximum(time, 0.0) / time_constant)


class Elapsed:
    """Time, s, since it was first asked: at the first step of an episode."""

    def __init__(self):
        self.began = None

    def __call__(self, time):
        if self.began is None:
            self.began = time
        return time - self.began


def growing(
    kernel: Callable, coefficients: Coefficients, began: np.ndarray | float, fields: Sequence[str], at: int
) -> Force:
    """The force of an effect by which the `fields` of a model, at their place `at`, are so many times as large as the
    kernel says of the time since the episode began, `began` s. coefficients: of the kernel, (simulation,) each.
    """
    began, *_ = np.broadcast_arrays(began, *coefficients.values())

    def force(world: World) -> None:
        rows = world.rows
        growth = kernel(world.time - began[rows], **{name: v[rows] for name, v in coefficients.items()})
        for field in fields:
            world.vary(field)[:, at].T[...] *= growth

    return force


def growing_companion(
    name: str, kernel: Callable, numbers: Coefficients, at: str, fields: Sequence[str]
) -> Companion:
    """The companion of an effect by which `fields` are so many times as large as the kernel says of the time since the
    episode began. at: the statement that says where. Those of the model are changed for one step.
    """
    elapsed, state = call(name, Elapsed, ["data.time"], {})
    growth, _ = call(name, kernel, ["elapsed"], numbers)
    index = at.partition(" ")[0]
    lines = (
        at,
        f"elapsed = {elapsed}",
        f"growth = {growth}",
        *(f"{field}[{index}] *= growth" for field in fields),
    )
    changes = tuple(field for field in fields if field.startswith("model."))
    return Companion((Elapsed, kernel), lines, state, changes)
