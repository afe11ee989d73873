"""Names of the places in a model where effects sit."""

from __future__ import annotations

import json

import mujoco

from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.object_names import KINDS


def with_all_together(sites: list[str]) -> list[str]:
    """The sites, and before them all of them together where there are several."""
    return [GLOBAL, *sites] if len(sites) > 1 else sites


def site_id(model: mujoco.MjModel, kind: str, site: str) -> int:
    """The id of the object that `object_name` calls `site`."""
    number = mujoco.mj_name2id(model, KINDS[kind], site)
    return number if number >= 0 else int(site.removeprefix("#"))


def reference(model: mujoco.MjModel, kind: str, site: str) -> str:
    """Source of what `model.joint(...)` and its like take: the name in quotes, or the number."""
    named = mujoco.mj_name2id(model, KINDS[kind], site) >= 0
    return json.dumps(site, ensure_ascii=False) if named else site.removeprefix("#")
