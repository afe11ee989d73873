"""What no sensor shows, where it rests on something: carried along by the model, while the rest follows the log.

A puck's height, a tool's turn about an axis that nothing turns it about: what is measured is set anew at every sample,
and the model moves what is not. Only where that rests is it known: what moves depends on what the model may lack.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import batch

from capture_cli.common.frozen import frozen
from capture_cli.log.arrays import Log
from capture_cli.model.fields import ModelFields
from capture_cli.model.mujoco_warnings import silence_mujoco
from capture_cli.model.tasks.base import Task


@frozen
class SETTINGS:
    """energy: of the mean kinetic energy of the log, below which what is carried along rests. mean: s, over which its
    velocity is taken, for on a stiff contact it chatters. lasts: s, before and after, for what swings turns back.
    """

    energy: float = 1e-4
    mean: float = 0.05
    lasts: float = 0.5


@dataclass(frozen=True)
class Resting:
    """qpos (step, nq): positions, with those that no sensor shows carried along. rests (step,): where these rest."""

    qpos: np.ndarray
    rests: np.ndarray


def resting(task: Task, log: Log, qpos: np.ndarray, qvel: np.ndarray, shown: np.ndarray) -> Resting:
    """Of a log. qpos (step, nq), qvel (step, nv): as measured, of the coordinates that are `shown` (nv,)."""
    model, time, episodes = task.model, log.time, log.episodes
    at = model.jnt_qposadr[model.dof_jntid[~shown]]
    if not at.size:
        return Resting(qpos, np.ones(len(time), dtype=bool))
    silence_mujoco()
    qpos = qpos.copy()
    energy, known = np.zeros(len(time)), np.zeros(len(time))
    paths = _carried(task, log, qpos, qvel, shown, at)
    for steps, path in zip(episodes, paths, strict=True):
        qpos[steps, at] = path.positions
        own, others = _mean_velocity(time[steps], path.positions), qvel[steps][:, shown]
        energy[steps] = _kinetic(own, path.inertia[:, ~shown][:, :, ~shown])
        known[steps] = _kinetic(others, path.inertia[:, shown][:, :, shown])
    moves = energy > SETTINGS.energy * known.mean()
    for steps in episodes:
        when = time[steps][moves[steps]]
        before, after = (
            np.searchsorted(when, time[steps] + late) for late in (-SETTINGS.lasts, SETTINGS.lasts)
        )
        moves[steps] = after > before
    return Resting(qpos, ~moves)


@dataclass(frozen=True)
class _Path:
    """Of one episode, at its samples: positions (sample, coordinate) of what is carried along, and inertia (sample, nv,
    nv).
    """

    positions: np.ndarray
    inertia: np.ndarray


def _carried(task: Task, log: Log, qpos, qvel, shown, at) -> list[_Path]:
    """The nominal model through all episodes side by side, set to what is measured at every sample."""
    model, time, episodes = task.model, log.time, log.episodes
    controls = task.controls(log.inputs[None])[0]
    shown_at = model.jnt_qposadr[model.dof_jntid[shown]]
    longest = max(e.stop - e.start for e in episodes)
    index = np.array([np.minimum(np.arange(e.start, e.start + longest), e.stop - 1) for e in episodes])
    runner = batch.Batch(model, len(episodes), 1)
    fields = ModelFields(model, len(episodes))
    task.write(fields, np.repeat(task.space.nominal[None], len(episodes), axis=0))
    for name, values in fields.values.items():
        runner.expand(name)[...] = values
    runner.set_const()
    runner.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
    position, velocity, inertia = runner.bind("qpos"), runner.bind("qvel"), runner.bind("M")
    position[...] = model_start(model)
    positions = np.zeros((longest, len(episodes), len(at)))
    inertias = np.zeros((longest, len(episodes), model.nv, model.nv))
    for k, here in enumerate(index.T):
        position[:, shown_at], velocity[:, shown] = qpos[here][:, shown_at], qvel[here][:, shown]
        if model.nu:
            runner.bind("ctrl")[...] = controls[here]
        positions[k] = position[:, at]
        ahead = index[:, min(k + 1, longest - 1)]
        count = np.maximum(np.round((time[ahead] - time[here]) / model.opt.timestep), 1).astype(int)
        for steps in np.unique(count):
            runner.step(np.flatnonzero(count == steps), nstep=int(steps))
        inertias[k] = mass_matrix(model, inertia)
    counts = [e.stop - e.start for e in episodes]
    return [_Path(positions[:n, e], inertias[:n, e]) for e, n in enumerate(counts)]


def _mean_velocity(time: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Of a path (sample, coordinate), about each sample."""
    ends = np.clip(time[:, None] + np.array([-0.5, 0.5]) * SETTINGS.mean, time[0], time[-1])
    at = [np.stack([np.interp(e, time, own) for own in positions.T], axis=1) for e in ends.T]
    return (at[1] - at[0]) / np.maximum(np.diff(ends, axis=1), 1e-12)


def _kinetic(velocity: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """J, (sample,), of velocities (sample, coordinate)."""
    return 0.5 * np.einsum("si,sij,sj->s", velocity, inertia, velocity)


def mass_matrix(model: mujoco.MjModel, packed: np.ndarray) -> np.ndarray:
    """M (point, nv, nv) from mjData.M (point, nC), its lower triangle row by row."""
    dense = np.zeros((len(packed), model.nv, model.nv))
    for row in range(model.nv):
        first, count = int(model.M_rowadr[row]), int(model.M_rownnz[row])
        for k in range(first, first + count):
            column = int(model.M_colind[k])
            dense[:, row, column] = dense[:, column, row] = packed[:, k]
    return dense


def model_start(model: mujoco.MjModel) -> np.ndarray:
    """Positions (nq,) that the model begins with."""
    return model.key_qpos[0] if model.nkey else model.qpos0
