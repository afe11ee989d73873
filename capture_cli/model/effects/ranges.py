"""Effects that a simulated machine has beside its model: each of their parameters at a value, or in a range."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from capture_cli.model.effects.base import Effect
from capture_cli.model.effects.placed import Placed

WithValues = Mapping[str, tuple[Effect, np.ndarray]]  # {EFFECT@SITE: (effect, its values (parameter,))}


@dataclass(frozen=True)
class EffectRanges:
    """low, high (parameter,): of all parameters of the `placed` effects, one effect's after the other's; alike where
    the value is known.
    """

    placed: tuple[Placed, ...] = ()
    low: np.ndarray = field(default_factory=lambda: np.zeros(0))
    high: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def of(cls, effects: Iterable[tuple[Placed, np.ndarray, np.ndarray]]) -> Self:
        """Of effects with low and high (parameter,) of each."""
        rows = list(effects)
        low, high = (np.concatenate([np.zeros(0), *(row[k] for row in rows)]) for k in (1, 2))
        return cls(tuple(placed for placed, *_ in rows), low, high)

    @property
    def vary(self) -> bool:
        """Whether any parameter has a range."""
        return bool((self.low < self.high).any())

    @property
    def middle(self) -> np.ndarray:
        """The middle of every range, (parameter,)."""
        return self.at(np.full((1, len(self.low)), 0.5))[0]

    def at(self, coordinates: np.ndarray) -> np.ndarray:
        """Values (..., parameter) at coordinates (..., parameter) in the unit cube of the ranges."""
        return np.clip(self.low + coordinates * (self.high - self.low), self.low, self.high)

    def drawn(self, generator: np.random.Generator, count: int) -> np.ndarray:
        """Values (count, parameter), every one anywhere in its range."""
        return self.at(generator.random((count, len(self.low))))

    @property
    def at_middle(self) -> list[tuple[Placed, np.ndarray]]:
        """Each effect with its values (parameter,) in the middle of their ranges."""
        ends = np.cumsum([len(placed.effect.parameters) for placed in self.placed])
        return list(zip(self.placed, np.split(self.middle, ends[:-1]), strict=True)) if self.placed else []

    def rows(self) -> list[dict[str, Any]]:
        """As `effect_rows` at the middle, and of each parameter drawn: [lowest, highest]."""
        rows, ends = effect_rows(self.at_middle), iter(zip(self.low, self.high, strict=True))
        for parameter in (p for row in rows for p in row["parameters"].values()):
            parameter["drawn"] = [float(end) for end in next(ends)]
        return rows


NO_EFFECTS = EffectRanges()


def effect_rows(effects: Iterable[tuple[Placed, np.ndarray]]) -> list[dict[str, Any]]:
    """What a document says of effects with values (parameter,): {name, site, parameters: {NAME: {value, unit, low,
    high}}} each; low, high: between which the effect is looked for.
    """
    return [
        {
            "name": kind,
            "site": effect.site,
            "parameters": {
                p.name: {"value": float(value), "unit": p.unit, "low": p.low, "high": p.high}
                for p, value in zip(effect.parameters, values, strict=True)
            },
        }
        for (kind, effect), values in effects
    ]
