"""Kernels: what an effect computes, apart from where its numbers come from and where they go.

A kernel takes its inputs by position and its coefficients by keyword. It is a function of both or, where it
keeps a state from step to step, a class that is made of the coefficients and whose instances take the inputs.
Simulations run it on arrays with one row each. `capture export` pastes its source into a module that knows
one simulation and nothing of this package: beside numpy a kernel uses only other kernels and numbers.
"""

import inspect
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

Coefficients = Mapping[str, np.ndarray]
INDENT = "    "
MODELS_STEP = "model.opt.timestep"  # source of a kernel's timestep, s, on forces
OWN_STEP = "self.timestep"  # and on controls and sensors: of the grid of those, maybe several of the model's
WIDTH = 72  # characters past which a call is broken: it stands indented, and to the right of an assignment


@dataclass(frozen=True)
class Companion:
    """How an effect is applied in a plain loop: its part of the module that `capture export` writes.

    kernels: what has to be pasted. state: an expression for what it keeps from step to step, "" where nothing.
    lines: statements at the effect's place, which know model, data and self.state (by the effect's name), or,
    on measurement, model and sensors. Those on control and measurement run once per step of the machine's own grid.
    changes: the fields that they change for one step only. after: statements behind the step, which know
    data.sensordata of its beginning.
    """

    kernels: tuple[Callable, ...]
    lines: tuple[str, ...]
    state: str = ""
    changes: tuple[str, ...] = ()
    after: tuple[str, ...] = ()


def inputs(kernel: Callable) -> list[str]:
    """Names of what a kernel takes by position."""
    function = kernel.__call__ if inspect.isclass(kernel) else kernel
    parameters = inspect.signature(function).parameters.values()
    return [p.name for p in parameters if p.kind is p.POSITIONAL_OR_KEYWORD and p.name != "self"]


def bound(kernel: Callable, coefficients: Coefficients, timestep: float) -> Callable:
    """The kernel as a callable of its inputs alone; afresh, where it keeps a state."""
    given = dict(coefficients) | ({"timestep": timestep} if _takes_timestep(kernel) else {})
    return kernel(**given) if inspect.isclass(kernel) else partial(kernel, **given)


def call(
    name: str, kernel: Callable, given: Sequence[str], values: Coefficients, timestep: str = MODELS_STEP
) -> tuple[str, str]:
    """Source that runs the kernel on the expressions `given`: (the call, the state it needs or "").

    name: of the effect at its site. values: coefficients of one simulation. timestep: MODELS_STEP or OWN_STEP.
    """
    keywords = [f"{n}={number(v)}" for n, v in values.items()]
    keywords += [f"timestep={timestep}"] * _takes_timestep(kernel)
    if inspect.isclass(kernel):
        return _joined(kept(name), given), _joined(kernel.__name__, keywords)
    return _joined(kernel.__name__, [*given, *keywords]), ""


def kept(name: str) -> str:
    """Source of the kernel with a state that the effect `name` keeps."""
    return f"self.state[{json.dumps(name, ensure_ascii=False)}]"


def number(value) -> str:
    """A number, or an array of one dimension, as source that evaluates to it, bit by bit."""
    if isinstance(value, int):
        return repr(value)
    if np.ndim(value):
        return f"np.array([{', '.join(number(v) for v in value)}])"
    return repr(float(value)) if np.isfinite(value) else f"{'-' if value < 0 else ''}np.inf"


def _takes_timestep(kernel: Callable) -> bool:
    return "timestep" in inspect.signature(kernel).parameters


def _joined(function: str, arguments: Sequence[str]) -> str:
    line = f"{function}({', '.join(arguments)})"
    if len(line) <= WIDTH:
        return line
    return "\n".join([f"{function}(", *(f"{INDENT}{a}," for a in arguments), ")"])
