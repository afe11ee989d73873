"""What is added to a number of the model that is never negative."""

from typing import ClassVar

import numpy as np

from capture_cli.model.effects.base import Effect, raised
from capture_cli.model.fields import model_field
from capture_cli.model.parameters import Parameter


class Raised(Effect):
    """An effect whose one parameter is added to a number of the model, such that the sum is not negative.

    field: of MjModel: in a row of it the number of the effect's degree of freedom, joint or tendon, or that of the
    whole model. term: which of several numbers in that row.
    """

    place = "model"
    field: ClassVar[str]
    term: ClassVar[tuple[int, ...]] = ()

    @property
    def at(self) -> tuple[int, ...]:
        """Where the number stands in the field."""
        row = {"dof": "dof", "jnt": "joint", "tendon": "tendon"}.get(self.field.partition("_")[0])
        return self.term if row is None else (getattr(self, row), *self.term)

    def added(self, name: str, unit: str, high: float) -> tuple[Parameter]:
        """The parameter, `high` at most."""
        own = float(np.asarray(model_field(self.model, self.field))[self.at])
        return (Parameter(name, unit, min(0.0, -own), high, 0.0),)

    def write(self, fields, values):
        field, at = fields[self.field], (slice(None), *self.at)
        field[at] = raised(field[at], values[:, 0])
