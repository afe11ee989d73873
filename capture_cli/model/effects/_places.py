"""Names of the places in a model where effects sit, and effects that sit at one object."""

import json
from abc import abstractmethod
from collections.abc import Iterable
from typing import ClassVar

import mujoco

from capture_cli.model.effects.base import GLOBAL, Effect
from capture_cli.model.object_names import object_name


def with_all_together(sites: list[str]) -> list[str]:
    """The sites, and before them all of them together where there are several."""
    return [GLOBAL, *sites] if len(sites) > 1 else sites


def site_id(model: mujoco.MjModel, kind: str, site: str) -> int:
    """The id of the object that `object_name` calls `site`."""
    number = mujoco.mj_name2id(model, mujoco.mju_str2Type(kind), site)
    return number if number >= 0 else int(site.removeprefix("#"))


def source(model: mujoco.MjModel, kind: str, site: str) -> str:
    """Source of the object that `object_name` calls `site`: `model.joint("x")`, or by its number."""
    named = mujoco.mj_name2id(model, mujoco.mju_str2Type(kind), site) >= 0
    return f"model.{kind}({json.dumps(site, ensure_ascii=False) if named else site.removeprefix('#')})"


def ids_source(model: mujoco.MjModel, kind: str, ids: Iterable[int]) -> str:
    """Source of a list of ids of objects, by what they are called."""
    return f"[{', '.join(f'{source(model, kind, object_name(model, kind, i))}.id' for i in ids)}]"


class ObjectEffect(Effect):
    """An effect at one object of the model. kind: as `object_name` has it. number: the object's id."""

    kind: ClassVar[str]

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.number = site_id(model, self.kind, site)

    @classmethod
    def sites(cls, model):
        return [object_name(model, cls.kind, int(i)) for i in cls.suited(model)]

    @classmethod
    @abstractmethod
    def suited(cls, model: mujoco.MjModel) -> Iterable[int]:
        """Ids of the objects that it can sit at."""
