"""Mass, centre and inertia of bodies, in batches."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np

from capture_cli.model.effects._rotation import body_vectors
from capture_cli.model.fields import ModelFields

CONJUGATE = np.array([1, -1, -1, -1])
ALIGNED = 1 - 1e-9  # a direction this close to a principal axis is one


def add_point_mass(fields: ModelFields, body: int, mass: np.ndarray, position: np.ndarray) -> None:
    """Fix a point `mass` (simulation,), kg, to `body`, at `position` (simulation, 3), m, in its frame."""
    own, centre = fields["body_mass"][:, body].copy(), fields["body_ipos"][:, body].copy()
    total = own + mass
    fields["body_mass"][:, body] = total
    apart = position - centre
    if not apart.any():
        return
    fields["body_ipos"][:, body] += (mass / total)[:, None] * apart
    _add_spread(fields, body, own * mass / total, apart)


def _add_spread(fields: ModelFields, body: int, mass: np.ndarray, apart: np.ndarray) -> None:
    """Add the inertia of two masses, of reduced mass `mass`, that lie `apart` (simulation, 3)."""
    local = body_vectors(fields["body_iquat"][:, body] * CONJUGATE, apart)  # in the principal frame
    added = mass[:, None, None] * (
        np.square(local).sum(axis=1)[:, None, None] * np.eye(3) - local[:, :, None] * local[:, None, :]
    )
    moments = fields["body_inertia"][:, body]
    length = np.linalg.norm(apart, axis=1)
    along_axis = (np.abs(local) >= ALIGNED * length[:, None]).any(axis=1)
    moments[along_axis] += np.diagonal(added, axis1=1, axis2=2)[along_axis]
    for row in np.flatnonzero(~along_axis & (mass != 0)):
        moments[row], turn = _principal(np.diag(moments[row]) + added[row])
        mujoco.mju_mulQuat(quaternion := np.empty(4), fields["body_iquat"][row, body], turn)
        fields["body_iquat"][row, body] = quaternion


def _principal(inertia: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Moments (3,) and orientation (4,) of the principal frame that is turned least from the present one."""
    moments, vectors = np.linalg.eigh(inertia)
    order = max(itertools.permutations(range(3)), key=lambda p: np.abs(np.diagonal(vectors[:, p])).sum())
    vectors = vectors[:, order] * np.sign(np.diagonal(vectors[:, order]) + 1e-300)
    if np.linalg.det(vectors) < 0:
        vectors[:, np.argmin(np.abs(np.diagonal(vectors)))] *= -1
    mujoco.mju_mat2Quat(turn := np.empty(4), np.ascontiguousarray(vectors).ravel())
    return moments[list(order)], turn
