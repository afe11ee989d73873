"""Parameters: named numbers with a unit and bounds, and the space they span."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.errors import OptionError, did_you_mean


@frozen
class SETTINGS:
    at_bound: float = 1e-4  # of the range: nearer to its end a parameter is at it
    step: float = 1e-4  # of the range: well above the solver's tolerance, well below curvature


@dataclass(frozen=True)
class Parameter:
    """A number of the model, in `unit` (SI), between `low` and `high`.

    nominal: the model's own value. For the parameter of an effect it is the null value, at which the model with
        the effect is exactly the model without it.
    step: of finite differences, as a share of the range. A simulation with contacts needs a longer one than one
        without: where between two steps a body arrives makes outputs a little rough. One that is shorter than `step` is
        what the parameter needs, and stays so.
    """

    name: str
    unit: str
    low: float
    high: float
    nominal: float
    step: float = SETTINGS.step

    def __post_init__(self):
        values = (self.low, self.high, self.nominal)
        if not all(math.isfinite(v) for v in values) or self.low >= self.high:
            raise OptionError(
                f"parameter {self.name!r}: low = {self.low:g}, high = {self.high:g}, nominal = {self.nominal:g}",
                cure="give finite bounds with low < high",
            )

    @property
    def span(self) -> float:
        """high - low, in `unit`."""
        return self.high - self.low

    def with_step_of(self, least: float) -> Self:
        """With finite differences of that share of the range at least, where it does not need shorter ones."""
        return self if self.step < SETTINGS.step else replace(self, step=max(self.step, least))


class ParameterSpace:
    """An ordered box of parameters: dict, vector (parameter,) and unit cube are three views of one point."""

    def __init__(self, parameters: Sequence[Parameter]):
        self.parameters = tuple(parameters)
        self.names = tuple(p.name for p in self.parameters)
        repeated = {n for n in self.names if self.names.count(n) > 1}
        if repeated:
            raise OptionError(
                f"parameters declared twice: {', '.join(sorted(repeated))}",
                cure="give each a name of its own",
            )
        self.low = np.array([p.low for p in self.parameters], dtype=float)
        self.high = np.array([p.high for p in self.parameters], dtype=float)
        self.nominal = np.array([p.nominal for p in self.parameters], dtype=float)
        self.steps = np.array([p.step for p in self.parameters], dtype=float)

    def __len__(self) -> int:
        return len(self.parameters)

    def __iter__(self):
        return iter(self.parameters)

    def __add__(self, other: Self) -> Self:
        return ParameterSpace((*self.parameters, *other.parameters))

    @property
    def span(self) -> np.ndarray:
        """high - low, (parameter,), each in its own unit."""
        return self.high - self.low

    def to_unit(self, values: np.ndarray) -> np.ndarray:
        """Values (..., parameter) as coordinates in the unit cube."""
        return (np.asarray(values, dtype=float) - self.low) / self.span

    def from_unit(self, coordinates: np.ndarray) -> np.ndarray:
        """Unit-cube coordinates (..., parameter) as values, kept inside the box against rounding."""
        return np.clip(self.low + np.asarray(coordinates, dtype=float) * self.span, self.low, self.high)

    def ranges(self) -> list[dict[str, str | float]]:
        """As stores have the parameters: name, unit, low and high of each."""
        return [{"name": p.name, "unit": p.unit, "low": p.low, "high": p.high} for p in self.parameters]

    def to_dict(self, values: np.ndarray) -> dict[str, float]:
        """One point (parameter,) by name."""
        return {name: float(v) for name, v in zip(self.names, values, strict=True)}

    def to_vector(self, values: Mapping[str, float], *, default: np.ndarray | None = None) -> np.ndarray:
        """One point by name as (parameter,); those not named take `default` (nominal where None).

        Raises OptionError for a name that is not a parameter, or a value that is not finite.
        """
        vector = np.array(self.nominal if default is None else default, dtype=float)
        for name, value in values.items():
            if name not in self.names:
                raise OptionError(f"unknown parameter {name!r}", cure=did_you_mean(name, self.names))
            if not math.isfinite(value):
                raise OptionError(f"parameter {name!r} is {value}", cure="give a finite number")
            vector[self.names.index(name)] = value
        return vector
