"""Initial states of many simulations, and moves of them."""

from dataclasses import dataclass, replace
from typing import Self

import mujoco
import numpy as np


@dataclass(frozen=True)
class InitialStates:
    """Initial states. qpos (simulation, nq), qvel (simulation, nv), act (simulation, na), time (simulation,) in s.

    together (simulation, 2, nv, nv): what a move of the positions, and one of the velocities, is made into, so that
    constraints hold on; None where each coordinate moves on its own.
    """

    qpos: np.ndarray
    qvel: np.ndarray
    act: np.ndarray
    time: np.ndarray
    together: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.qpos)

    def rows(self, index) -> Self:
        """The initial states at `index`."""
        together = None if self.together is None else self.together[index]
        return InitialStates(self.qpos[index], self.qvel[index], self.act[index], self.time[index], together)


def shift(model: mujoco.MjModel, initial: InitialStates, corrections: np.ndarray) -> InitialStates:
    """Initial states moved by tangent corrections (simulation, state), state as in InitialStateEstimate, as constraints
    let them.
    """
    nv = model.nv
    if initial.together is not None:
        moves = corrections[:, : 2 * nv].reshape(-1, 2, nv, 1)
        corrections = np.hstack([(initial.together @ moves).reshape(-1, 2 * nv), corrections[:, 2 * nv :]])
    if model.nq == nv:
        qpos = initial.qpos + corrections[:, :nv]
    else:
        qpos = initial.qpos.copy()
        for row, step in zip(qpos, np.ascontiguousarray(corrections[:, :nv]), strict=True):
            mujoco.mj_integratePos(model, row, step, 1.0)
    return replace(
        initial,
        qpos=qpos,
        qvel=initial.qvel + corrections[:, nv : 2 * nv],
        act=initial.act + corrections[:, 2 * nv :],
    )


def corrections_between(model: mujoco.MjModel, begin: InitialStates, end: InitialStates) -> np.ndarray:
    """Tangent corrections (simulation, state) by which `shift` takes the initial states `begin` to `end`, as
    constraints let it.
    """
    nv = model.nv
    positions = end.qpos - begin.qpos if model.nq == nv else np.zeros((len(begin), nv))
    if model.nq != nv:
        for row, here, there in zip(positions, begin.qpos, end.qpos, strict=True):
            mujoco.mj_differentiatePos(model, row, 1.0, here, there)
    moves = np.stack([positions, end.qvel - begin.qvel], axis=1)
    dependent = 1e-6  # of the largest singular value: a move that constraints do not let be
    if begin.together is not None:
        moves = (np.linalg.pinv(begin.together, rcond=dependent) @ moves[..., None])[..., 0]
    return np.hstack([moves.reshape(-1, 2 * nv), end.act - begin.act])
