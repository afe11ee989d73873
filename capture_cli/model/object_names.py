"""What objects of a model are called, those without a name too."""

from __future__ import annotations

import mujoco

KINDS = {
    "body": mujoco.mjtObj.mjOBJ_BODY,
    "joint": mujoco.mjtObj.mjOBJ_JOINT,
    "geom": mujoco.mjtObj.mjOBJ_GEOM,
    "site": mujoco.mjtObj.mjOBJ_SITE,
    "tendon": mujoco.mjtObj.mjOBJ_TENDON,
    "equality": mujoco.mjtObj.mjOBJ_EQUALITY,
    "actuator": mujoco.mjtObj.mjOBJ_ACTUATOR,
    "sensor": mujoco.mjtObj.mjOBJ_SENSOR,
}


def object_name(model: mujoco.MjModel, kind: str, number: int) -> str:
    """The name of a body, joint, ..., or "#number" where it has none."""
    return mujoco.mj_id2name(model, KINDS[kind], number) or f"#{number}"
