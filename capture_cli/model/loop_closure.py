"""What a model's equality constraints say of its states: closed loops, coupled joints, mimicking fingers.

A coordinate that no output measures is often known all the same, because a loop closes through it. The constraints are
taken as one more measurement of the state, linearised where they hold: a Kalman update, iterated (Bell & Cathey 1993).
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.model.object_names import object_name
from capture_cli.model.states import InitialStates


@frozen
class SETTINGS:
    rounds: int = 20  # of Newton's method at one state
    closed: float = 1e-9  # m or rad: a step less than that ends them
    # m/s^2 or rad/s^2: soft constraints give way under loads that would accelerate by this at least: gravity's
    load: float = 10.0
    # times what they give way by in a simulation, whose parameters and phase may be others
    unlike: float = 3.0
    every: float = 0.01  # s between the samples that a path is followed through
    determined: float = 0.1  # share of a coordinate's standard deviation that the constraints leave, at most
    free: float = 1.0  # rad or m: sd of what nothing measures while a path is followed
    # rad, or share of the model's extent: steps in which a machine is led from one measured position to the
    # next. In longer ones a loop may fold over, or its closing may not be found at all.
    led: float = 0.1
    # Times what noise and softness make of a gap: beyond, what was measured contradicts the constraint.
    open: float = 10.0


@dataclass(frozen=True)
class MeasuredPositions:
    """values (row, column): positions that outputs report, which stand at these columns (column,) of qpos. dofs, sd:
    which tangent coordinates they are, and how well they are known.
    """

    values: np.ndarray
    columns: np.ndarray
    dofs: np.ndarray
    sd: np.ndarray


class LoopClosure:
    """The equality constraints of `model` that are active from the beginning.

    slack: how far they give way in motions like those of the log, as `slack_of` has it; None where nobody knows.
    """

    def __init__(self, model: mujoco.MjModel, slack: np.ndarray | None = None):
        self.model = copy(model)
        self.model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        self.data = mujoco.MjData(self.model)
        self.slack = slack

    def slack_of(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """How far the constraints give way in a simulation, in m or rad, and how fast, per second: (2, row), root mean
        square over its steps: qpos (step, nq), qvel (step, nv).
        """
        off = []
        for position, velocity in zip(qpos, qvel, strict=True):
            self._go(position)
            off.append([self.data.efc_pos[: self.data.ne].copy(), self._jacobian @ velocity])
        # where a constraint has rows of zeros, MuJoCo leaves them out
        most = max(len(position) for position, _ in off)
        return np.sqrt(np.mean(np.square([o for o in off if len(o[0]) == most]), axis=0))

    def follow(
        self, time: np.ndarray, measured: MeasuredPositions, begin: np.ndarray, at: Sequence[int]
    ) -> np.ndarray:
        """Positions (place, nq) at the samples `at` (place,), followed from `begin` (nq,) by continuity.

        time (step,) s, of the rows that were measured.
        """
        known = np.full(self.model.nv, SETTINGS.free)
        known[measured.dofs] = measured.sd
        stride = max(1, int(SETTINGS.every / np.median(np.diff(time)))) if len(time) > 1 else 1
        wanted = {int(step): place for place, step in enumerate(at)}
        found = np.empty((len(at), self.model.nq))
        qpos = begin
        for step in range(max(wanted, default=-1) + 1):
            if step % stride and step not in wanted:
                continue
            qpos = self._led(qpos, measured.values[step], measured.columns, known)
            if step in wanted:
                found[wanted[step]] = qpos
        return found

    def _led(
        self, begin: np.ndarray, measured: np.ndarray, columns: np.ndarray, sd: np.ndarray
    ) -> np.ndarray:
        """Where the constraints hold, (nq,), led from `begin` (nq,) to `measured` (column,), which stand at `columns`.

        sd (dof,): as of `_closed`. A crank may begin an episode at any angle, or turns away from the model's own.
        """
        target, apart = self._with(begin, columns, measured), np.zeros(self.model.nv)
        mujoco.mj_differentiatePos(self.model, apart, 1.0, begin, target)
        steps = int(np.ceil(np.abs(apart / (SETTINGS.led * self._reach)).max(initial=0.0)))
        here = begin
        for step in range(1, steps):
            on_the_way = begin.copy()
            mujoco.mj_integratePos(self.model, on_the_way, apart, step / steps)
            here, _ = self._closed(self._with(here, columns, on_the_way[columns]), sd)
        return self._closed(self._with(here, columns, target[columns]), sd)[0]

    def _with(self, qpos: np.ndarray, columns: np.ndarray, values: np.ndarray) -> np.ndarray:
        """`qpos` (nq,) with positions that were measured, `values` (column,), at `columns`."""
        qpos = qpos.copy()
        qpos[columns] = values
        mujoco.mj_normalizeQuat(self.model, qpos)
        return qpos

    def left_open(self, followed: np.ndarray, measured: MeasuredPositions) -> dict[str, float]:
        """By how much (m or rad, root mean square) constraints stay open where coordinates are as measured and
        the others as near to closing them as they can be; by name, those of which noise and softness are no cause.

        followed (place, nq): from where the others are moved.
        """
        free = np.full(self.model.nv, SETTINGS.free)
        free[measured.dofs] = 0.0
        squares: dict[str, list[tuple[float, float]]] = {}
        for qpos, values in zip(followed, measured.values, strict=True):
            self._go(self._closed(self._with(qpos, measured.columns, values), free)[0])
            rows = slice(self.data.ne)
            by_noise = np.square(self._jacobian[:, measured.dofs] * measured.sd).sum(axis=1)
            allowed = by_noise + np.square(self._softness(per_second=False))
            for row, gap, may in zip(self.data.efc_id[rows], self.data.efc_pos[rows], allowed, strict=True):
                name = object_name(self.model, "equality", int(row))
                squares.setdefault(name, []).append((gap**2, may))
        means = {name: np.sqrt(np.mean(pairs, axis=0)) for name, pairs in squares.items()}
        return {name: float(gap) for name, (gap, may) in means.items() if gap > SETTINGS.open * may}

    def close(
        self, initial: InitialStates, sd: np.ndarray, followed: np.ndarray
    ) -> tuple[InitialStates, np.ndarray]:
        """Initial states that satisfy the constraints, as near to `initial` as their sd (window, state) say, and their
        new sd.

        One coordinate alone cannot move but against the constraints, which would throw it back: the others move along.
        followed (window, nq): where coordinates are that only the constraints determine.
        """
        nv = self.model.nv
        qpos, qvel, sd = initial.qpos.copy(), initial.qvel.copy(), sd.copy()
        together = np.empty((len(initial), 2, nv, nv))
        for window in range(len(initial)):
            position, velocity = sd[window, :nv], sd[window, nv : 2 * nv]
            _, left = self._at(followed[window], position)
            qpos[window] = self._begun(qpos[window], followed[window], left < SETTINGS.determined * position)
            qpos[window], left = self._closed(qpos[window], position)
            together[window, 0] = self._together(position)
            gain, gives = self._gain(velocity, per_second=True)
            together[window, 1] = self._together(velocity, per_second=True)
            qvel[window] -= gain @ (self._jacobian @ qvel[window])
            sd[window] = np.concatenate([left, gives, sd[window, 2 * nv :]])
        return replace(initial, qpos=qpos, qvel=qvel, together=together), sd

    def _begun(self, qpos: np.ndarray, followed: np.ndarray, determined: np.ndarray) -> np.ndarray:
        """`qpos` with the joints that are `determined` (dof,) as they were followed to."""
        qpos = qpos.copy()
        for joint in range(self.model.njnt):
            position, dofs = _places(self.model, joint)
            if determined[dofs].all():
                qpos[position] = followed[position]
        return qpos

    def _closed(self, qpos: np.ndarray, sd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the constraints hold, (nq,), the nearest to `qpos` in units of sd (dof,), and how well it is known."""
        here = qpos.copy()
        moved = np.zeros(self.model.nv)
        for _ in range(SETTINGS.rounds):
            gain, left = self._at(here, sd)
            if not self.data.ne:
                return here, left
            mujoco.mj_differentiatePos(self.model, moved, 1.0, qpos, here)
            whole = gain @ (self._jacobian @ moved - self.data.efc_pos[: self.data.ne])
            here = qpos.copy()
            mujoco.mj_integratePos(self.model, here, whole, 1.0)
            if np.abs(whole - moved).max() < SETTINGS.closed:
                break
        return here, self._at(here, sd)[1]

    def _at(self, qpos: np.ndarray, sd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The constraints' gain at qpos (nq,), and what they leave of sd (dof,)."""
        self._go(qpos)
        return self._gain(sd)

    def _go(self, qpos: np.ndarray) -> None:
        """Work out the constraints at qpos (nq,)."""
        self.data.qpos[:] = qpos
        mujoco.mj_fwdPosition(self.model, self.data)

    @cached_property
    def _reach(self) -> np.ndarray:
        """What is far for each coordinate, (dof,): 1 rad, or the model's extent."""
        model, joint = self.model, self.model.dof_jntid
        within = np.arange(model.nv) - model.jnt_dofadr[joint]
        is_slide = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
        is_free = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
        slides = is_slide | (is_free & (within < 3))
        return np.where(slides, model.stat.extent, 1.0)

    @property
    def _jacobian(self) -> np.ndarray:
        """Of the constraints where the data are, (row, dof)."""
        return self.data.efc_J.reshape(-1, self.model.nv)[: self.data.ne]

    def _gain(self, sd: np.ndarray, per_second: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Kalman's gain (dof, row) of the constraints, and the sd (dof,) that they leave."""
        jacobian = self._jacobian
        spread = jacobian * np.square(sd)
        covariance = spread @ jacobian.T + np.diag(np.square(self._softness(per_second)))
        gain = np.linalg.solve(covariance, spread).T
        left = np.square(sd) - np.einsum("dr,rd->d", gain, spread)
        return gain, np.sqrt(np.maximum(left, 0.0))

    def _together(self, sd: np.ndarray, per_second: bool = False) -> np.ndarray:
        """What a move of each coordinate, in units of what the constraints leave of its sd, is made into: (dof, dof).

        A square root of the covariance that they leave, by QR (Potter & Stern 1963), best known coordinates first: what
        they determine moves along with those, and beside them as far as loads beyond `load` let it.
        """
        gain, left = self._gain(sd, per_second)
        kept = np.eye(self.model.nv) - gain @ self._jacobian
        beyond = np.square(self._softness(per_second)) - np.square(self._under_load(per_second))
        root = np.hstack([kept * sd, gain * np.sqrt(beyond)])
        order = np.argsort(-left / np.where(sd > 0, sd, 1.0), kind="stable")
        lower = np.linalg.qr(root[order].T, mode="r").T
        lower *= np.where(np.diag(lower) < 0, -1.0, 1.0)
        moves = np.eye(self.model.nv)
        moves[np.ix_(order, order)] = lower / np.where(left > 0, left, 1.0)[order]
        moves[:, left == 0] = kept[:, left == 0]
        return moves

    def _softness(self, per_second: bool) -> np.ndarray:
        """How far each constraint (row,) may give way: under `load`, or more where it is known; how fast, per second.

        The joints of a gripper or a wrist are so light that their motors would accelerate them by hundreds of rad/s^2:
        taken as stiffer than it is there, a constraint would move initial states away from where they are measured.
        """
        slack = self._under_load(per_second)
        if self.slack is None or self.slack.shape[1] != len(slack):
            return slack
        return np.maximum(slack, SETTINGS.unlike * self.slack[int(per_second)])

    def _under_load(self, per_second: bool) -> np.ndarray:
        """How far each constraint (row,) gives way under `load`; how fast, per second."""
        rows = slice(self.data.ne)
        stiffness, damping = self.data.efc_KBIP[rows, 0], self.data.efc_KBIP[rows, 1]
        impedance = self.data.efc_KBIP[rows, 2]
        return (1 - impedance) / impedance * SETTINGS.load / (damping if per_second else stiffness)


def _places(model: mujoco.MjModel, joint: int) -> tuple[slice, slice]:
    """Where a joint stands in qpos and in qvel."""
    ends = [*model.jnt_qposadr, model.nq], [*model.jnt_dofadr, model.nv]
    return tuple(slice(int(e[joint]), int(e[joint + 1])) for e in ends)
