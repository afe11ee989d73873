"""What a model may lack: one effect = one file. The file's stem is the effect's public name."""

from dataclasses import dataclass
from pathlib import Path

import mujoco

from capture_cli.common.registry import Registry
from capture_cli.model.effects.base import PLACES, Effect
from capture_cli.model.parameters import Parameter

REGISTRY: Registry[Effect] = Registry(
    "capture_cli.model.effects", "Effect", "effect", not_listed=("companion", "placed", "ranges")
)
EXAMPLE = Path(__file__).with_name("_example_machine.xml")


@dataclass(frozen=True)
class Entry:
    """One effect of the catalogue: its sites in a model, and its parameters, each at the first of them that has it."""

    name: str
    kind: type[Effect]
    sites: tuple[str, ...]
    parameters: tuple[Parameter, ...]


def catalogue(model: mujoco.MjModel | None = None) -> list[Entry]:
    """Every effect, by place and name, with its sites in `model`; in the example machine where None."""
    model = model or mujoco.MjModel.from_xml_path(str(EXAMPLE))
    entries = []
    for name, effect in REGISTRY.items():
        sites = tuple(effect.sites(model))
        parameters: dict[str, Parameter] = {}
        for parameter in (p for site in sites for p in effect(model, site).parameters):
            parameters.setdefault(parameter.name, parameter)
        entries.append(Entry(name, effect, sites, tuple(parameters.values())))
    return sorted(entries, key=lambda e: (PLACES.index(e.kind.place), e.name))
