"""Dry friction as MuJoCo has it: a soft constraint that holds a joint up to its frictionloss, and lets it creep."""

import mujoco
import numpy as np
from scipy.special import ndtr

from capture_cli.common.frozen import frozen
from capture_cli.estimate.balance.trees import trees


@frozen
class SETTINGS:
    """sweeps: at most, over the joints of a tree, each of which holds against what the friction of the others leaves;
    at each point they end where none changes by more than the share `settled` of its loss. sure: standard deviations
    beyond which a number is on one side of a limit. impedance: as far as MuJoCo lets it be.
    """

    sweeps: int = 30
    settled: float = 1e-3
    sure: float = 8.0
    impedance: tuple[float, float] = (1e-4, 0.9999)


def dry_friction(
    model: mujoco.MjModel,
    inverse: np.ndarray,
    applied: np.ndarray,
    velocity: np.ndarray,
    velocity_sd: np.ndarray,
    loss: np.ndarray,
) -> np.ndarray:
    """Generalised forces of friction (point, nv), the mean over velocities that are known with velocity_sd (nv,).

    inverse (point, nv, nv): of the inertia; applied (point, nv): all other forces; loss (point, nv): frictionloss. With
    A the diagonal of the inverse, R = (1 - d) / d times `dof_invweight0` and the reference acceleration -b v, each is

        f = -(a + b v) / (A + R), no larger than its loss,

    where a is the acceleration without it (MuJoCo, Computation: friction loss; d and b from solimp and solref). What
    one tree holds is nothing to another, so that each is worked out by itself, where it has losses, and those of one
    size side by side.
    """
    force, lanes = np.zeros_like(applied), {}
    damping, softness = _reference(model)
    each = (damping * velocity, damping * velocity_sd, softness, applied, loss)
    each = [np.broadcast_to(values, applied.shape) for values in each]
    for own in trees(model):
        rows = np.flatnonzero(loss[:, own].any(axis=1))
        if rows.size:
            lanes.setdefault(own.stop - own.start, []).append((rows, own))
    for alike in lanes.values():
        found = _in_trees(
            np.concatenate([inverse[rows, own, own] for rows, own in alike]),
            *(np.concatenate([values[rows, own] for rows, own in alike]) for values in each),
        )
        first = 0
        for rows, own in alike:
            force[rows, own] = found[first : first + len(rows)]
            first += len(rows)
    return force


def _in_trees(
    inverse: np.ndarray,
    reference: np.ndarray,
    reference_sd: np.ndarray,
    softness: np.ndarray,
    applied: np.ndarray,
    loss: np.ndarray,
) -> np.ndarray:
    """As `dry_friction`, (lane, dof), each lane being a tree at a point.

    reference, reference_sd: b v, and how well it is known; softness: R.
    """
    found, left = np.zeros_like(applied), np.arange(len(applied))
    moved = np.flatnonzero(loss.any(axis=0))
    # lanes last, so that what is worked out for all of them at once is in one piece
    inverse = np.ascontiguousarray(inverse.transpose(1, 2, 0))
    reference, loss = (np.ascontiguousarray(a.T) for a in (reference, loss))
    force = -np.sign(reference) * loss  # sliding, as most do
    total = np.einsum("ddl->dl", inverse) + softness.T
    sd = reference_sd.T / total
    acceleration = np.einsum("ijl,jl->il", inverse, applied.T + force)
    for _ in range(SETTINGS.sweeps if moved.size > 1 else 1):
        before = force.copy()
        for dof in moved:
            without = acceleration[dof] - inverse[dof, dof] * force[dof]
            held = _limited(-(without + reference[dof]) / total[dof], sd[dof], loss[dof])
            acceleration += inverse[:, dof] * (held - force[dof])
            force[dof] = held
        found[left] = force.T
        more = (np.abs(force - before) > SETTINGS.settled * loss).any(axis=0)
        left = left[more]
        if not left.size:
            break
        inverse, reference, loss, force, total, sd, acceleration = (
            a[..., more] for a in (inverse, reference, loss, force, total, sd, acceleration)
        )
    return found


def _reference(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """b, 1/s, and R, (nv,) each."""
    least, most = (np.clip(model.dof_solimp[:, i], *SETTINGS.impedance) for i in range(2))
    first, second = model.dof_solref.T
    time = np.maximum(first, 2 * model.opt.timestep)
    damping = np.where(first > 0, 2 / (most * np.where(first > 0, time, 1.0)), -second / most)
    return damping, (1 - least) / least * model.dof_invweight0


def _limited(mean: np.ndarray, sd: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """The mean of a normal number, cut off at +- limit: (point,) each."""
    found = np.clip(mean, -limit, limit)
    near = np.flatnonzero(np.abs(np.abs(mean) - limit) < SETTINGS.sure * sd)
    mean, sd, limit = mean[near], sd[near], limit[near]
    low, high = (-limit - mean) / sd, (limit - mean) / sd
    below = ndtr(low)
    inside = mean * (ndtr(high) - below) + sd * (_density(low) - _density(high))
    found[near] = inside + limit * (ndtr(-high) - below)
    return found


def _density(x: np.ndarray) -> np.ndarray:
    return np.exp(-0.5 * np.square(np.clip(x, -40.0, 40.0))) / np.sqrt(2 * np.pi)
