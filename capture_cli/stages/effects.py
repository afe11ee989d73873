"""`capture effects`: what a model may lack."""

from __future__ import annotations

from typing import Any

import mujoco

from capture_cli.effects import REGISTRY
from capture_cli.effects.base import Effect
from capture_cli.tasks import load_task

# Something of each kind, so that every effect has a site to show its parameters at.
_EXAMPLE = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1"/>
    <body name="body"><joint name="joint" type="slide" stiffness="1"/><geom name="geom" size=".1" pos="0 0 .1"/></body>
    <body name="free" pos="0 0 1"><freejoint name="free"/><geom name="ball" size=".1"/></body>
  </worldbody>
  <actuator><position name="actuator" joint="joint" kp="10" ctrlrange="-1 1"/></actuator>
  <sensor>
    <jointpos name="sensor" joint="joint"/>
    <framepos name="where" objtype="xbody" objname="free"/><framequat name="how" objtype="xbody" objname="free"/>
  </sensor>
</mujoco>
"""


def describe(task: str | None) -> dict[str, Any]:
    """{"effects": [...]}: each effect with its parameters; with a task, its sites in that model."""
    model = load_task(task).model if task else mujoco.MjModel.from_xml_string(_EXAMPLE)
    return {
        "effects": [_one(name, cls, model, with_sites=task is not None) for name, cls in REGISTRY.items()]
    }


def _one(name: str, cls: type[Effect], model: mujoco.MjModel, *, with_sites: bool) -> dict[str, Any]:
    sites = cls.sites(model)
    row = {"name": name, "place": cls.place, "summary": cls.summary}
    if with_sites:
        row["sites"] = sites
    parameters = cls(model, sites[0]).parameters if sites else ()
    row["parameters"] = [
        {"name": p.name, "unit": p.unit, "low": p.low, "high": p.high, "null": p.nominal} for p in parameters
    ]
    return row
