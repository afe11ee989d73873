"""What objects of a model are called, those without a name too."""

import mujoco


def object_name(model: mujoco.MjModel, kind: str, number: int) -> str:
    """The name of a body, joint, ..., or "#number" where it has none."""
    return mujoco.mj_id2name(model, mujoco.mju_str2Type(kind), number) or f"#{number}"
