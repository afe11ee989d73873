"""An effect where it sits in a model, and what it is called there."""

from collections.abc import Iterable
from typing import NamedTuple

from capture_cli.model.effects.base import Effect


class Placed(NamedTuple):
    """An effect at a site of a model. kind: the effect's public name."""

    kind: str
    effect: Effect

    @property
    def law(self) -> tuple[str, str]:
        """What it is wherever it sits."""
        return self.kind, self.effect.formula_term

    @property
    def name(self) -> str:
        return placed_name(self.kind, self.effect.site)

    @property
    def is_shorter_step(self) -> bool:
        """Whether it is the model's motion in shorter steps."""
        return self.effect.substeps > 1 and not self.effect.parameters


def placed_name(kind: str, site: str) -> str:
    """EFFECT@SITE, or EFFECT alone where it concerns the model as a whole."""
    return f"{kind}@{site}" if site else kind


def names_of(effects: Iterable[Placed]) -> frozenset[str]:
    """What a set of effects is known by, in any order."""
    return frozenset(e.name for e in effects)
