"""Kinematic trees: what moves in one has no inertia in another, so that matrices fall into a block for each."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np


def trees(model: mujoco.MjModel) -> list[slice]:
    """The coordinates of each tree, which follow each other."""
    first = np.flatnonzero(np.diff(model.dof_treeid, prepend=-1))
    return [slice(int(a), int(b)) for a, b in zip(first, [*first[1:], model.nv], strict=True)]


def inverse_of(
    model: mujoco.MjModel, matrices: np.ndarray, some: Sequence[slice] | None = None
) -> np.ndarray:
    """Of matrices (point, nv, nv) that fall into the trees' blocks; 0 but in `some` of them, where given."""
    inverse = np.zeros_like(matrices)
    for own in trees(model) if some is None else some:
        inverse[:, own, own] = np.linalg.inv(matrices[:, own, own])
    return inverse


def made_heavier(inverse: np.ndarray, heavier: np.ndarray) -> np.ndarray:
    """The inverse (point, nv, nv) of matrices whose diagonal is larger by `heavier` (point, nv), by the formula of
    Sherman and Morrison.
    """
    for dof in np.flatnonzero(heavier.any(axis=0)):
        more = heavier[:, dof]
        share = more / (1 + more * inverse[:, dof, dof])
        inverse = inverse - share[:, None, None] * inverse[:, :, dof, None] * inverse[:, None, dof]
    return inverse


def solved(
    model: mujoco.MjModel, matrices: np.ndarray, vectors: np.ndarray, some: Sequence[slice] | None = None
) -> np.ndarray:
    """What such matrices map to the vectors (point, nv); 0 but in `some` trees, where given."""
    found = np.zeros_like(vectors)
    for own in trees(model) if some is None else some:
        found[:, own] = np.linalg.solve(matrices[:, own, own], vectors[:, own, None])[..., 0]
    return found


@dataclass(frozen=True)
class AtPoints:
    """Of the inverse `matrices` (point, nv, nv) those at the points `here` (lane,), where the inertia of coordinates is
    larger by `heavier` (lane, nv); only what is asked for is picked.
    """

    matrices: np.ndarray
    here: np.ndarray
    heavier: np.ndarray | None = None

    def __getitem__(self, at: tuple) -> np.ndarray:
        lanes, rows, columns = at
        found = self.matrices[self.here[lanes], rows, columns]
        return found if self.heavier is None else made_heavier(found, self.heavier[lanes, rows])


def times(model: mujoco.MjModel, matrices: AtPoints, vectors: np.ndarray) -> np.ndarray:
    """The products with vectors (lane, nv), of trees in which there is any."""
    found = np.zeros_like(vectors)
    for own in trees(model):
        lanes = np.flatnonzero(vectors[:, own].any(axis=1))
        if lanes.size:
            found[lanes, own] = (matrices[lanes, own, own] @ vectors[lanes, own, None])[..., 0]
    return found


def in_whole_trees(model: mujoco.MjModel, which: np.ndarray) -> np.ndarray:
    """Where `which` (point, nv) is true for any coordinate of the tree, (point, nv)."""
    found = np.zeros_like(which)
    for own in trees(model):
        found[:, own] = which[:, own].any(axis=1, keepdims=True)
    return found
