"""What a model gives at every point of a motion that is known: forces, dry friction, and accelerations by all of them.

Where coordinates rest they keep the acceleration that they have, and what no sensor shows stays where contacts keep it.
Nothing is stepped.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from mujoco import batch

from capture_cli.common.frozen import frozen
from capture_cli.estimate.balance.dry_friction import dry_friction
from capture_cli.estimate.balance.motion import SmoothedLog
from capture_cli.estimate.balance.points import Points
from capture_cli.estimate.balance.resting import mass_matrix
from capture_cli.estimate.balance.trees import inverse_of, solved, trees
from capture_cli.model.fields import ModelFields, model_field


@frozen
class SETTINGS:
    """touches: of the model's extent, nearer than which bodies touch, for a stiff contact chatters. rounding: MuJoCo
    works out trees on one fixed body about the centre of mass of all.
    """

    touches: float = 1e-4
    rounding: float = 1e-12


# A step works out a from the velocity that it begins with, and q(t+h) - 2 q(t) + q(t-h) is h^2 a(t): that velocity,
# (q(t) - q(t-h)) / h, is the one at t - h / 2. What the integrator takes implicitly has the velocity at its end:
# `implicit` everything, `implicitfast` all but Coriolis and centrifugal forces.
_INTEGRATOR = mujoco.mjtIntegrator
_IMPLICIT = (_INTEGRATOR.mjINT_IMPLICIT, _INTEGRATOR.mjINT_IMPLICITFAST)
_DISABLE = mujoco.mjtDisableBit
# contacts are left, and joints' dry friction is worked out here
_NO_STOPS = _DISABLE.mjDSBL_FRICTIONLOSS | _DISABLE.mjDSBL_LIMIT | _DISABLE.mjDSBL_EQUALITY
_OF_FRICTION = ("dof_frictionloss", "dof_damping", "dof_solref", "dof_solimp", "dof_invweight0")

State = tuple[np.ndarray, np.ndarray, np.ndarray]  # qpos (point, nq), qvel and qacc (point, nv)


@dataclass(frozen=True)
class Accelerations:
    """At every point, (point, nv): as it was measured, and as the model gives it; or how both change."""

    measured: np.ndarray
    predicted: np.ndarray

    def __sub__(self, other: Accelerations) -> Accelerations:
        return Accelerations(self.measured - other.measured, self.predicted - other.predicted)

    def __truediv__(self, by: float) -> Accelerations:
        return Accelerations(self.measured / by, self.predicted / by)


@dataclass(frozen=True)
class WorkedOut:
    """forces, and what they come from: what is applied but by contacts, without dry friction `smooth`, that friction,
    the acceleration by both, which is `free`, and by how much contacts `pushed`, and what they `push` by, (point, nv)
    each; how many contacts there are, (point,); and the inertia, as mjData.M packs it.
    """

    forces: Accelerations
    smooth: np.ndarray
    friction: np.ndarray
    free: np.ndarray
    pushed: np.ndarray
    push: np.ndarray
    contacts: np.ndarray
    inertia: np.ndarray


class ForwardDynamics:
    """At points of a smoothed log with this state and these controls (point, nu), of its model with `fields` of one
    simulation written. at_rest (point, nv): where coordinates rest; begins (point, nv): velocities that steps begin
    with; timestep: s, of the model with nothing written.
    """

    def __init__(
        self, smoothed: SmoothedLog, points: Points, state: State, controls: np.ndarray, fields: ModelFields
    ):
        self.points, self.state, self.controls, self.fields = points, state, controls, fields
        self._unwritten = model = copy(smoothed.task.model)
        self.unshown = np.setdiff1d(np.arange(model.nv), smoothed.dofs)
        model.opt.disableflags |= int(_NO_STOPS if self.unshown.size else _DISABLE.mjDSBL_CONSTRAINT)
        model.geom_margin[:] += SETTINGS.touches / 2 * model.stat.extent
        model.pair_margin[:] += SETTINGS.touches * model.stat.extent
        self.model = self._model_with(fields)
        self._plain = self.runner(self.model)
        self.timestep, self._integrator = smoothed.task.timestep, int(model.opt.integrator)
        # s, from the beginning of a step to the time of its acceleration
        self._half = (self._integrator != _INTEGRATOR.mjINT_RK4) * self.timestep / 2
        self.speed_sd, self.at_rest = smoothed.sd(1), points.at_rest(smoothed, state[1])
        self.begins = state[1] - self._half * state[2]

    # --- of which model, and where ---

    @cached_property
    def null(self) -> WorkedOut:
        """Of the model as it is."""
        return self.moved()

    def moved(self, state: State | None = None, controls: np.ndarray | None = None) -> WorkedOut:
        """Of the model as it is in another state, or under other controls."""
        state = self.state if state is None else state
        applied = self.applied(self._plain, state, self.controls if controls is None else controls)
        return self._worked_out(self.model, applied, state, trees(self.model))

    def written(self, fields: ModelFields) -> WorkedOut:
        """Of the model with other fields written."""
        model, null = self._model_with(fields), self.null
        # dry friction is none of MuJoCo's
        names = {*fields.values, *self.fields.values} - {"dof_frictionloss"}
        if all(np.array_equal(*(model_field(m, name) for m in (model, self.model))) for name in names):
            applied = null.smooth, null.push, null.contacts, null.inertia
        else:
            applied = self.applied(self.runner(model), self.state, self.controls)
        return self._worked_out(model, applied, self.state, self._changed(model, applied[0], applied[-1]))

    def _model_with(self, fields: ModelFields) -> mujoco.MjModel:
        """The model with these fields written."""
        model = copy(self._unwritten)
        for name, values in fields.values.items():
            target = model_field(model, name)
            if np.ndim(target):
                target[...] = values[0].reshape(np.shape(target))
            else:
                owner = model.opt if name.startswith("opt.") else model
                setattr(owner, name.removeprefix("opt."), float(values[0]))
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model

    def _changed(self, model: mujoco.MjModel, smooth: np.ndarray, inertia: np.ndarray) -> list[slice]:
        """The trees in which forces `smooth`, mjData.M or what dry friction follows from are not as in the model as it
        is; all where bodies touch.
        """
        every, own = trees(model), self.model
        if len(every) == 1 or self.unshown.size or model.opt.timestep != own.opt.timestep:
            return every
        differs = _apart(smooth, self.null.smooth).any(axis=0)
        for name in _OF_FRICTION:
            one, other = (getattr(m, name).reshape(model.nv, -1) for m in (model, own))
            differs |= _apart(one, other).any(axis=1)
        entries = np.flatnonzero(_apart(inertia, self.null.inertia).any(axis=0))
        differs[model.M_colind[entries]] = True
        return [tree for tree in every if differs[tree].any()]

    def _worked_out(
        self, model: mujoco.MjModel, applied: Sequence[np.ndarray], state: State, changed: Sequence[slice]
    ) -> WorkedOut:
        """Of what `applied` gives; all but the `changed` trees are as in the model as it is."""
        smooth, push, contacts, inertia = applied
        here = np.zeros(model.nv, dtype=bool)
        for own in changed:
            here[own] = True
        if here.all():
            friction, free = np.zeros_like(smooth), np.zeros_like(smooth)
        else:
            friction, free = self.null.friction.copy(), self.null.free.copy()
        if model.dof_frictionloss.any():
            same = "null" in self.__dict__ and np.array_equal(inertia, self.null.inertia)
            inverse = self.inverse_mass if same else self.inverse(mass_matrix(model, inertia), some=changed)
            loss = np.where(here, model.dof_frictionloss, 0.0)
            friction[:, here] = self.friction(model, inverse, smooth, loss, state=state)[:, here]
        felt = self._holding(felt_inertia(model, inertia))
        driven = np.where(self.at_rest, state[2], smooth + friction)
        free[:, here] = solved(model, felt, driven, changed)[:, here]
        pushed = np.zeros_like(free)
        if self.unshown.size:
            pushed = solved(model, felt, np.where(self.at_rest, 0.0, push))
        forces = Accelerations(state[2], self.resting(free, pushed))
        return WorkedOut(forces, smooth, friction, free, pushed, push, contacts, inertia)

    # --- what MuJoCo works out ---

    def runner(self, model: mujoco.MjModel) -> batch.Batch:
        """A simulation at every point, none of which is stepped."""
        runner = batch.Batch(model, len(self.points), 1)  # a copy of this process would wait for its threads
        runner.bind("time")[...] = self.points.time
        return runner

    def applied(self, runner: batch.Batch, state: State, controls: np.ndarray) -> tuple[np.ndarray, ...]:
        """What a step works out: the forces that it sums, without dry friction, what contacts push by, (point, nv)
        each, how many these are, (point,), and the inertia as mjData.M packs it.
        """
        qpos, qvel, qacc = state
        smooth, *others = (runner.bind(n) for n in ("qfrc_smooth", "qfrc_constraint", "ncon", "M"))
        later = self._half if self._integrator in _IMPLICIT else -self._half
        self.forward(runner, qpos, qvel + later * qacc, controls)
        return smooth + self._coriolis_gained, *(values.copy() for values in others)

    def forward(self, runner: batch.Batch, qpos: np.ndarray, qvel: np.ndarray, controls: np.ndarray) -> None:
        """Fill the fields of MjData at these states (point, ...) and controls (point, nu)."""
        runner.bind("qpos")[...], runner.bind("qvel")[...] = qpos, qvel
        if self.model.nu:
            runner.bind("ctrl")[...] = controls
        runner.forward()

    @cached_property
    def _coriolis_gained(self) -> np.ndarray | float:
        """By how much more Coriolis and centrifugal forces are at the end of a step than at its beginning, (point, nv),
        where they act as they are there but others as they are at the end; of the model as it is, for a change of it
        hardly changes their difference.
        """
        if self._integrator != _INTEGRATOR.mjINT_IMPLICITFAST:
            return 0.0
        runner, found = self.runner(self.model), []
        bias = runner.bind("qfrc_bias")
        runner.bind("qpos")[...] = self.state[0]
        for velocity in (self.begins, self.state[1] + self._half * self.state[2]):
            runner.bind("qvel")[...] = velocity
            runner.forward(stage=mujoco.mjtStage.mjSTAGE_VEL)
            found.append(bias.copy())
        return found[1] - found[0]

    # --- what coordinates answer with ---

    def friction(
        self,
        model: mujoco.MjModel,
        inverse: np.ndarray,
        applied: np.ndarray,
        loss: np.ndarray,
        here: np.ndarray | slice = slice(None),
        state: State | None = None,
    ) -> np.ndarray:
        """Dry friction (point, nv) at the points `here`, or in another state of them, where forces are `applied`
        (point, nv) beside it, frictionloss is `loss` (point, nv), and it works against `inverse` (point, nv, nv).

        What is at rest has none, and the acceleration that it has.
        """
        qvel, qacc = (s[here] for s in self.state[1:]) if state is None else state[1:]
        rest = self.at_rest[here]
        driven, begins = np.where(rest, qacc, applied), qvel - self._half * qacc
        return dry_friction(model, inverse, driven, begins, self.speed_sd, np.where(rest, 0.0, loss))

    def resting(self, free: np.ndarray, pushed: np.ndarray, change: np.ndarray | None = None) -> np.ndarray:
        """Accelerations (point, nv) of what moves by `free` without contacts, and is `pushed` by them as hard as keeps
        what no sensor shows where it is: a puck that is heavier presses more, and its friction is more. A stiff contact
        chatters; this is the mean of it. With a `change` of what is free: what that changes.
        """
        found = own = free if change is None else change
        treeid = self.model.dof_treeid
        for tree in np.unique(treeid[self.unshown]):
            dofs = self.unshown[treeid[self.unshown] == tree]
            held, here = pushed[:, dofs], treeid == tree
            size = np.square(held).sum(axis=1)
            size = np.where(size, size, 1.0)
            presses = (held * free[:, dofs]).sum(axis=1) < 0
            share = np.where(presses, -(held * own[:, dofs]).sum(axis=1) / size, 0.0)
            found = found + share[:, None] * np.where(here, pushed, 0.0)
        return found

    @cached_property
    def inverse_inertia(self) -> np.ndarray:
        """Acceleration by a unit of force, (point, nv, nv): what no sensor shows stays where contacts keep it."""
        inverse = self.inverse_felt * ~self.at_rest[:, None, :]
        if not self.unshown.size:
            return inverse
        free, pushed = self.null.free, self.null.pushed
        columns = [self.resting(free, pushed, inverse[..., dof]) for dof in range(self.model.nv)]
        return np.stack(columns, axis=-1)

    @cached_property
    def inverse_mass(self) -> np.ndarray:
        """What dry friction works against in the model as it is, (point, nv, nv)."""
        return self.inverse(mass_matrix(self.model, self.null.inertia))

    @cached_property
    def inverse_felt(self) -> np.ndarray:
        """Of what accelerations are solved with in the model as it is, (point, nv, nv)."""
        return self.inverse(felt_inertia(self.model, self.null.inertia))

    def inverse(
        self, inertia: np.ndarray, here: np.ndarray | slice = slice(None), some: Sequence[slice] | None = None
    ) -> np.ndarray:
        """Of inertia (point, nv, nv) at the points `here`, of `some` trees: coordinates at rest take no part in it."""
        return inverse_of(self.model, self._holding(inertia, here), some)

    def _holding(self, inertia: np.ndarray, here: np.ndarray | slice = slice(None)) -> np.ndarray:
        """What accelerations are solved with (point, nv, nv) where coordinates at rest keep the acceleration that they
        have: dry friction holds them by a force that nobody knows.
        """
        point, dof = np.nonzero(self.at_rest[here])
        inertia[point, dof] = 0.0
        inertia[point, dof, dof] = 1.0
        return inertia


def felt_inertia(model: mujoco.MjModel, packed: np.ndarray) -> np.ndarray:
    """What accelerations are solved with, (point, nv, nv), from mjData.M: Euler's method takes damping at the end of
    the step, M + h D.
    """
    dense = mass_matrix(model, packed)
    if int(model.opt.integrator) == _INTEGRATOR.mjINT_EULER:
        own = np.arange(model.nv)
        dense[:, own, own] += model.opt.timestep * model.dof_damping
    return dense


def _apart(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Where values (..., column) differ by more than rounding does of what is common in their column."""
    return np.abs(one - other) > SETTINGS.rounding * np.abs(other).max(axis=0)
