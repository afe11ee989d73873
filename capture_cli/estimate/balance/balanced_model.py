"""A model in the force balance, effects at values beside the declared parameters, and how it compares with another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from capture_cli.estimate.balance.regression import sum_and_error
from capture_cli.model.effects.placed import Placed


@dataclass(frozen=True)
class BalancedModel:
    """Effects at values, fitted in the balance. point (parameter,): of the task; values: of each effect, (parameter,).

    likelihood (block,): of each block, by the model that is fitted to the others. slow_noise (memory, nv): of the
    sensors, as far as a model that this one grew from leaves it; none where None. beyond_noise: what it leaves, as of
    `Whitening`. at_values (block,): likelihood with the parameters as they are; `likelihood` has them a linear step on,
    which need not be there, or within their ranges.
    """

    effects: tuple[Placed, ...]
    point: np.ndarray
    values: tuple[np.ndarray, ...]
    likelihood: np.ndarray = field(default_factory=lambda: np.zeros(0))
    slow_noise: np.ndarray | None = None
    beyond_noise: float = np.inf
    at_values: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def start(self) -> np.ndarray:
        """All parameters, those of effects last."""
        return np.concatenate([self.point, *self.values])

    @property
    def key(self) -> tuple:
        """Its effects and values."""
        return tuple(e.name for e in self.effects), np.asarray(self.start).tobytes()

    @property
    def numbers(self) -> dict[str, Any]:
        """All of it but the effects, by name."""
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name != "effects"}

    def as_it_is(self) -> BalancedModel:
        """Where a descent did not get to what a linear step promises: with the likelihood that it has."""
        kept = self.at_values.sum() >= self.likelihood.sum() or np.isnan(self.likelihood).any()
        return self if kept else replace(self, likelihood=self.at_values)

    def gain(self, other: BalancedModel) -> tuple[float, float]:
        """Of predictive log likelihood over another model, and its standard error over blocks."""
        return sum_and_error(self.likelihood - other.likelihood)


def with_numbers(models: Sequence[BalancedModel], numbers: Sequence[dict[str, Any]]) -> list[BalancedModel]:
    """The models with these `numbers` in place of their own."""
    return [replace(m, **own) for m, own in zip(models, numbers, strict=True)]
