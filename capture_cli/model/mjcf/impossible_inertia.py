"""Principal moments of inertia that no body has: however its mass is spread, none is more than the others together."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture_cli.model.fields import ModelFields


@dataclass(frozen=True)
class ImpossibleInertia:
    """A body by name, and its moments (3,), kg m^2, in ascending order."""

    body: str
    moments: Sequence[float]

    @property
    def text(self) -> str:
        """What is wrong, as the beginning of a sentence or of a message."""
        least, middle, most = (f"{m:.3g}" for m in self.moments)
        return (
            f"no body has the moments of inertia of {self.body}, {least}, {middle} and {most} kg m^2: "
            "the largest is more than the others together"
        )

    @property
    def cure(self) -> str:
        return (
            f"let a parameter set body:{self.body}:inertia, a factor on all three, in the place of one of them, "
            "or the armature of the joint that turns it"
        )


def impossible_inertias(fields: ModelFields) -> list[ImpossibleInertia]:
    """Of the bodies of one simulation with the values of `fields`."""
    if "body_inertia" not in fields.values:
        return []
    moments = fields["body_inertia"][0]
    # of a moment: of a flat body one is the sum of the others, but for the last digits
    rounding = 1e-12
    beyond = (moments > (1 + rounding) * _of_the_others(moments)).any(axis=1)
    return [
        ImpossibleInertia(fields.model.body(body).name or f"body {body}", np.sort(moments[body]).tolist())
        for body in np.flatnonzero(beyond)
    ]


def without_rounding(moments: np.ndarray) -> np.ndarray:
    """Moments (body, 3) of flat bodies, as MuJoCo takes them: to the last digit no more than the others together."""
    return np.minimum(moments, _of_the_others(moments))


def _of_the_others(moments: np.ndarray) -> np.ndarray:
    """The sum of the other two moments of the same body, for each of (body, 3)."""
    return moments[:, [1, 2, 0]] + moments[:, [2, 0, 1]]
