"""The long steps of a diagnosis: fits, what they leave of other windows, scores. What an interrupted run made is kept.

A diagnosis does the same steps in the same order every time, so a run that is begun again takes those that were made
and comes to where the other was, to the same bits. What lies between them is fast, and done again.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import is_dataclass, replace
from functools import wraps
from typing import TYPE_CHECKING, Any

import numpy as np

from capture_cli.estimate.fit import Fit
from capture_cli.estimate.part_fit import PartFit
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve.linearization import Linearization
from capture_cli.model.effects.placed import Placed
from capture_cli.model.parameters import ParameterSpace

if TYPE_CHECKING:
    from capture_cli.estimate.model_fits import ModelFits

LEFT = ("corrections", "residual", "taken", "taken_by_hidden")  # of a PartFit

Values = dict[str, Any]  # arrays, and what JSON can hold


class Checkpoint(ABC):
    """What was made of the steps so far, in their order."""

    @property
    @abstractmethod
    def anything(self) -> bool:
        """Whether there is something to go on from."""

    @abstractmethod
    def step(self, name: str, given: Sequence[Any], make: Callable[[], Values]) -> Values:
        """What the next step makes, or made. given: arrays and numbers that tell it from another."""


def checkpointed_fit(method: Callable[..., Fit | None]) -> Callable[..., Fit | None]:
    """Makes a step of a method of `ModelFits` that fits."""

    @wraps(method)
    def fit(fits: ModelFits, part: PreparedLog, effects: Sequence[Placed], start: np.ndarray, **options):
        def make() -> Fit | None:
            return method(fits, part, effects, start, **options)

        if fits.checkpoint is None:
            return make()
        given = [part, start, *(told for value in options.values() for told in _parts(value))]
        values = made_or_taken(fits, method.__name__, effects, given, lambda: _of_fit(make()))
        return _as_fit(values, fits, part, effects)

    return fit


def checkpointed_part(method: Callable[..., PartFit]) -> Callable[..., PartFit]:
    """Makes a step of `ModelFits.on`."""

    @wraps(method)
    def on(fits: ModelFits, part: PreparedLog, fit: Fit, *more, **options):
        def make() -> PartFit:
            return method(fits, part, fit, *more, **options)

        if fits.checkpoint is None:
            return make()
        given = [part, fit, *more, *options.values()]
        values = made_or_taken(fits, "on", fit.effects, given, lambda: what_is_there(make(), LEFT))
        data = replace(part.data(fits.simulator(fit.effects)), space=ParameterSpace([]))
        return PartFit(data, **values)

    return on


def made_or_taken(
    fits: ModelFits, what: str, effects: Sequence[Placed], given: Sequence[Any], make: Callable[[], Values]
) -> Values:
    """What the step makes, or made, with `fits.rollouts` as if it were made now."""
    before = fits.rollouts

    def counted() -> Values:
        values = make()
        return {**values, "rollouts": fits.rollouts - before}

    known = [fits.prepared.noise.sd, fits.prepared.difference_step]
    name = " + ".join([what, *(e.name for e in effects)])
    values = dict(fits.checkpoint.step(name, [_told(g) for g in (*known, *given)], counted))
    fits.rollouts = before + values.pop("rollouts")
    return values


def _parts(given: Any) -> Sequence[Any]:
    """What an argument is made of: the numbers and the rival of an Effort, itself otherwise."""
    return [given] if isinstance(given, Fit) or not is_dataclass(given) else [*vars(given).values()]


def _told(given: Any) -> Any:
    """What tells one argument of a step from another."""
    if isinstance(given, PreparedLog):
        return given.windows.first
    if isinstance(given, Fit):
        return np.concatenate([given.point, given.corrections.ravel()])
    if isinstance(given, tuple | list):
        return ", ".join(e.name for e in given)
    return given


# --- results as values, and back; each array with its elements in the order in which it was made ---


def what_is_there(found: Any, names: Sequence[str]) -> Values:
    """Those of `found` that are not None; of None there are none."""
    return {name: v for name in names if (v := getattr(found, name, None)) is not None}


def _of_fit(fit: Fit | None) -> Values:
    if fit is None:
        return {}
    values = {
        "point": fit.point,
        **what_is_there(fit, ("finished", "promised")),
        **what_is_there(fit.at, ("x", "corrections", "residual", "updates", "exact")),
    }
    slopes = {n: np.moveaxis(getattr(fit.at, n), -1, 0) for n in ("by_parameter", "by_initial")}
    return {**values, **slopes}


def _as_fit(values: Values, fits: ModelFits, part: PreparedLog, effects: Sequence[Placed]) -> Fit | None:
    if not values:
        return None
    simulator = fits.simulator(effects)
    slopes = [np.moveaxis(values[n], 0, -1) for n in ("by_parameter", "by_initial")]
    found = (values[n] for n in ("x", "corrections", "residual"))
    at = Linearization(part.data(simulator), *found, *slopes, values["updates"], values["exact"])
    stopped = values["finished"], values.get("promised")
    return Fit(tuple(effects), simulator.space, values["point"], at, *stopped)
