"""Steps of a log at which measured coordinates hit something: how hard depends on micrometres that no sensor shows.

What rests on something presses along a coordinate that no sensor shows, and slides across it: that the model tells. A
contact whose normal moves a measured coordinate is a force that the log does not tell, and its steps are left out.
"""

from copy import copy

import mujoco
import numpy as np

from capture_cli.common.frozen import frozen


@frozen
class SETTINGS:
    """near: standard deviations of a measured distance, within which bodies may touch. normal: m, or m per rad, that a
    coordinate moves along a normal, below which it does not.
    """

    near: float = 4.0
    normal: float = 1e-3


def impacts(
    model: mujoco.MjModel,
    qpos: np.ndarray,
    sd: np.ndarray,
    travel: np.ndarray,
) -> np.ndarray:
    """Where bodies may touch so that measured coordinates feel it, (step,).

    qpos (step, nq). sd (nv,): of each coordinate's noise, 0 of those that no sensor shows. travel (step, nv): how far
    each may be from there before the next sample and the last one.
    """
    near = copy(model)
    farthest = float(model.stat.extent) * (
        SETTINGS.near * sd.sum() + np.abs(travel).sum(axis=1).max(initial=0.0)
    )
    near.geom_margin[:] += farthest / 2  # margins of both geoms are added
    near.pair_margin[:] += farthest
    near.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data, found = mujoco.MjData(near), np.zeros(len(qpos), dtype=bool)
    for step, position in enumerate(qpos):
        data.qpos[:] = position
        mujoco.mj_kinematics(near, data)
        mujoco.mj_comPos(near, data)
        mujoco.mj_collision(near, data)
        found[step] = _hits(near, data, sd, travel[step], farthest)
    return found


def _hits(model, data, sd: np.ndarray, travel: np.ndarray, farthest: float) -> bool:
    """Whether some contact may be one, and its normal moves a measured coordinate."""
    if not data.ncon:
        return False
    asked, contacts, jacobian = set(), data.contact, np.zeros((3, model.nv))
    frames, pairs, positions = contacts.frame, contacts.geom, contacts.pos
    for k, room in enumerate(contacts.dist - (contacts.includemargin - farthest)):
        key = *pairs[k].tolist(), *frames[k, :3].tolist()
        if key in asked:  # one of several points of a face
            continue
        along = np.zeros(model.nv)
        for geom, sign in zip(pairs[k], (-1, 1), strict=True):
            mujoco.mj_jac(model, data, jacobian, None, positions[k], int(model.geom_bodyid[geom]))
            along += sign * (frames[k, :3] @ jacobian)
        along[sd == 0] = 0.0
        if np.abs(along).max() <= SETTINGS.normal:
            asked.add(key)
        elif room < SETTINGS.near * np.linalg.norm(along * sd) + np.abs(along) @ travel:
            return True
    return False
