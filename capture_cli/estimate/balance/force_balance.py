"""The force balance: what the measured motion needs, less what the model gives, and what would fill the gap.

Along the smoothed motion (q, v, a) the model misses the acceleration

    r = a - M(q)^-1 f(q, v, u),      f = actuators + passive forces - Coriolis and gravity - dry friction,

which is the missing generalised force over the inertia. In accelerations "no inertia and no force" is no solution, as
it is of M a = f where all inertias are open. A declared parameter and an effect each add a column, the derivative of r,
taken from their own laws: fields of the model, forces, controls, and, for sensors, the motion that they would have
reported wrongly. An inertia's column has the predicted acceleration, not the measured one, whose noise would bias it
(an instrument, Janot et al. 2014). Nothing is simulated over time: no windows, no initial states, no local minima in
the state.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cache, cached_property

import mujoco
import numpy as np
from mujoco import batch

from capture_cli.common.frozen import frozen
from capture_cli.common.processes import own_threads
from capture_cli.estimate.balance.actuation import NUMBERS, Actuation
from capture_cli.estimate.balance.arriving_controls import ArrivingControls
from capture_cli.estimate.balance.dry_friction import dry_friction
from capture_cli.estimate.balance.motion import SmoothedLog
from capture_cli.estimate.balance.points import Points
from capture_cli.estimate.balance.recorded_world import AT_JOINTS, OF_INERTIA, RecordedWorld
from capture_cli.estimate.balance.reported_motion import ReportedMotion
from capture_cli.estimate.balance.resting import mass_matrix
from capture_cli.estimate.balance.trees import (
    AtPoints,
    in_whole_trees,
    inverse_of,
    solved,
    times,
    trees,
)
from capture_cli.log.input_sequences import Hold
from capture_cli.model.effects._followed_force import FollowedForce
from capture_cli.model.effects._periodic_force import PeriodicForce
from capture_cli.model.effects.base import AtValues, Effect
from capture_cli.model.fields import ModelFields, model_field
from capture_cli.model.mujoco_warnings import silence_mujoco
from capture_cli.model.world import APPLIED, World


@frozen
class SETTINGS:
    """step: of a parameter's range, in differences. touches: of the model's extent, nearer than which bodies touch, for
    a stiff contact chatters. none: standard deviations of a velocity, below which it may be none. resting: half periods
    of the fastest motion that is smoothed, for which it is then at rest: a turning point is shorter. lanes: points
    whose accelerations are solved for at a time. rounding: MuJoCo works out trees on one fixed body about the centre of
    mass of all.
    """

    step: float = 1e-3
    touches: float = 1e-4
    none: float = 3.0
    resting: float = 2.0
    lanes: int = 1 << 15
    rounding: float = 1e-12


# A step works out a from the velocity that it begins with, and q(t+h) - 2 q(t) + q(t-h) is h^2 a(t): that velocity,
# (q(t) - q(t-h)) / h, is the one at t - h / 2. What the integrator takes implicitly has the velocity at its end:
# `implicit` everything, `implicitfast` all but Coriolis and centrifugal forces.
_INTEGRATOR = mujoco.mjtIntegrator
_IMPLICIT = (_INTEGRATOR.mjINT_IMPLICIT, _INTEGRATOR.mjINT_IMPLICITFAST)
_DISABLE = mujoco.mjtDisableBit
# contacts are left, and joints' dry friction is worked out here
_NO_STOPS = _DISABLE.mjDSBL_FRICTIONLOSS | _DISABLE.mjDSBL_LIMIT | _DISABLE.mjDSBL_EQUALITY
_OF_IMPACTS = ("geom_size", "geom_solref", "geom_solimp", "pair_solref", "pair_solimp")
_OF_FRICTION = ("dof_frictionloss", "dof_damping", "dof_solref", "dof_solimp", "dof_invweight0")
_OF_ACTUATORS = ("actuator_gear", *NUMBERS)


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
class _Seen:
    """What forces see at the points: the world, the inverse of the inertia (point, nv, nv), what actuators do, and all
    forces but those of constraints, `smooth` (point, nv).
    """

    world: World
    inverse: np.ndarray
    actuation: Actuation | None
    smooth: np.ndarray


@dataclass(frozen=True)
class _WorkedOut:
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


class ForceBalance:
    """The balance of a log along its smoothed motion, at one point (parameter,) of the task.

    acting: effects at values that the balance has, from which changes are counted: on fields of the model, on controls,
    and on what sensors report, of which the motion is freed. Forces add up, and are none of these. unknown (point,):
    where the motion is reported before or after the stretch.
    """

    def __init__(
        self,
        smoothed: SmoothedLog,
        point: np.ndarray,
        threads: int | None = None,
        acting: Sequence[AtValues] = (),
    ):
        silence_mujoco()
        self.acting = [own for own in acting if own[0].place != "force" and not own[0].reads_actuators]
        self.smoothed, self.point, self.threads = smoothed, point, threads or 0
        task = smoothed.task
        self.model = copy(task.model)
        self.unshown = np.setdiff1d(np.arange(self.model.nv), smoothed.dofs)
        self.model.opt.disableflags |= int(_NO_STOPS if self.unshown.size else _DISABLE.mjDSBL_CONSTRAINT)
        self.model.geom_margin[:] += SETTINGS.touches / 2 * self.model.stat.extent
        self.model.pair_margin[:] += SETTINGS.touches * self.model.stat.extent
        self.points = Points.of(smoothed)
        reporting = self._acting("measurement")
        self.reports = ReportedMotion(smoothed, self.points, lambda: self.actuator_force)
        self.late = self.reports.lateness(reporting)
        self.numbers = self.reports.numbers(self.late)
        self.state = smoothed.states(self.reports.true(self.numbers, reporting), self.points.step)
        self.speed_sd = smoothed.sd(1)
        self.at_rest = self._at_rest()
        self.unknown = self._unknown()
        self.arriving = ArrivingControls(smoothed, self.points)
        self.controls = self.arriving.behind([self._acting("control")])[0]

    # --- what acts ---

    @cached_property
    def null(self) -> Accelerations:
        """Of the model as it is."""
        return self._null.forces

    @cached_property
    def _null(self) -> _WorkedOut:
        return self._worked_out()

    def read_as(self, holds: Sequence[Hold]) -> ForceBalance:
        """The balance with inputs that act so between rows."""
        task = self.smoothed.task.with_holds(holds)
        return ForceBalance(replace(self.smoothed, task=task), self.point, self.threads, self.acting)

    def of_parameter(self, index: int) -> Accelerations:
        """Derivative of the balance by a declared parameter, per its unit: the column of it."""
        space = self.smoothed.task.space
        step = SETTINGS.step * space.span[index]
        step = step if self.point[index] + step <= space.high[index] else -step
        moved = self.point.copy()
        moved[index] += step
        return (self._forces(point=moved) - self.null) / step

    def of_effect(self, effect: Effect, values: np.ndarray) -> list[Accelerations]:
        """Changes of the balance by an effect at each of `values` (variant, parameter)."""
        if effect.place == "model":
            return [self._of_written(self._with(effect, v)) for v in values]
        if effect.place == "control":
            return self._of_controls(self.arriving.behind([self._with(effect, v) for v in values]))
        if effect.place == "measurement":
            return [self._of_report(effect, v) for v in values]
        return self._of_followed(effect, values) if _remembers(effect) else self._of_force(effect, values)

    def along(self, effect: PeriodicForce) -> np.ndarray:
        """What a force repeats along, at the points, (point,)."""
        if effect.along == "time":
            return self.points.time - effect.began(self.points.step)
        return self.state[0][:, effect.model.jnt_qposadr[effect.joint]]

    def of_waves(self, effect: PeriodicForce, values: np.ndarray) -> np.ndarray:
        """Forces of a unit of sine, and of cosine, at the effect's joint for each of `values` (shape, parameter):
        (shape, 2, point).
        """
        return effect.carrier(self.actuator_force) * effect.waves(values, self.along(effect))

    def of_joint_force(self, dof: int, force: np.ndarray) -> Accelerations:
        """Of a force (point,) on one coordinate."""
        return Accelerations(np.zeros_like(self.state[1]), self.inverse_inertia[:, :, dof] * force[:, None])

    def slopes(self) -> tuple[np.ndarray, np.ndarray]:
        """Median change of each coordinate's predicted acceleration by its own position and velocity, (nv,) each, 1/s^2
        and 1/s: what the noise of positions does to the prediction.
        """
        found = np.zeros((2, self.model.nv))
        for dof in self.smoothed.dofs:
            places = int(self.model.jnt_qposadr[self.model.dof_jntid[dof]]), dof
            for which, place in enumerate(places):
                state = [s.copy() for s in self.state]
                step = SETTINGS.step * max(float(state[which][:, place].std()), 1e-9)
                state[which][:, place] += step
                moved = self._forces(state=tuple(state)).predicted - self.null.predicted
                found[which, dof] = np.median(moved[:, dof]) / step
        return found[0], found[1]

    # --- parts ---

    def _acting(self, place: str) -> list[AtValues]:
        """The effects that act at a place."""
        return [own for own in self.acting if own[0].place == place]

    def _with(self, effect: Effect, values: np.ndarray) -> list[AtValues]:
        """Those at the place of `effect`, which is at these values (parameter,), not at its own, or comes last."""
        others = self._acting(effect.place)
        found = [(e, values if _is_same(e, effect) else v) for e, v in others]
        return found if any(_is_same(e, effect) for e, _ in others) else [*found, (effect, values)]

    def _of_written(self, writing: Sequence[AtValues]) -> Accelerations:
        """Change of the balance where fields of the model are written; not a number where other bodies would touch, or
        where these say how bodies hit, of which nothing is left in the balance.
        """
        written = self._worked_out(writing=writing)
        change = written.forces - self.null
        hits = self.smoothed.hits and self._writes_impacts(writing)
        if not hits and np.array_equal(written.contacts, self._null.contacts):
            return change
        return Accelerations(change.measured, np.full_like(change.predicted, np.nan))

    def _of_controls(self, driven: np.ndarray) -> list[Accelerations]:
        """Changes of the balance by controls (variant, point, nu)."""
        actuation = self._actuation
        moved = np.flatnonzero((driven != self.controls).any(axis=(0, 1)))
        if actuation is None or self.unshown.size or not actuation.linear[moved].all():
            return [self._forces(controls=c) - self.null for c in driven]
        variants, points = driven.shape[:2]
        here = np.tile(np.arange(points), variants)
        acts = actuation.changed(actuation.given(driven.reshape(len(here), -1), here=here), here)
        loss = np.broadcast_to(self._model.dof_frictionloss, acts.shape)
        return self._as_changes(self._led(acts, loss, here), variants)

    @cached_property
    def _actuation(self) -> Actuation | None:
        """What actuators do as a step takes it, with all forces."""
        runner = self._runner(self._model)
        return Actuation.of(self._model, runner, lambda: self._set(runner, self.state, self.controls))

    def _as_changes(self, accelerations: np.ndarray, variants: int) -> list[Accelerations]:
        """Of predicted accelerations (variant and point, nv) alone."""
        changes = accelerations.reshape(variants, len(self.points), self.model.nv)
        return [Accelerations(np.zeros_like(self.state[1]), c) for c in changes]

    def _writes_impacts(self, writing: Sequence[AtValues]) -> bool:
        fields = ModelFields(self.model, 1)
        for effect, values in writing:
            effect.write(fields, values[None])
        return any(name in _OF_IMPACTS for name in fields.values)

    def _of_report(self, effect: Effect, values: np.ndarray) -> Accelerations:
        """Change of the balance where the sensors report what they do through an effect at `values` (parameter,).

        The predicted acceleration stands for the measured one, as it does for inertias: of a reading that is off in
        proportion "no motion at all" is no solution. Velocities are as measured, however much later: by the predicted
        acceleration a damped joint's rows would shrink, all noise in them, too.
        """
        reporting, reports, step = self._with(effect, values), self.reports, self.points.step
        late = reports.lateness(reporting)
        numbers = reports.numbers(late, known=(self.late, self.numbers))
        qpos, qvel, _ = self.smoothed.states(reports.true(numbers, reporting), step)
        predicted = reports.with_curvatures(numbers, late - self.late, self.predicted_smooth)
        acceleration = self.smoothed.states(reports.true(predicted, reporting), step)[2]
        predicted = self._forces(state=(qpos, qvel, self.state[2])).predicted
        return Accelerations(acceleration - self._instrumented, predicted - self.null.predicted)

    @cached_property
    def _instrumented(self) -> np.ndarray:
        """The acceleration where the predicted one stands for the measured one, (point, nv)."""
        predicted = self.reports.with_curvatures(
            self.numbers, np.zeros_like(self.late), self.predicted_smooth
        )
        true = self.reports.true(predicted, self._acting("measurement"))
        return self.smoothed.states(true, self.points.step)[2]

    @cached_property
    def predicted_smooth(self) -> np.ndarray:
        """The predicted acceleration behind the filter that the measured one went through, (point, nv)."""
        return self.smoothed.filtered(self.null.predicted, self.points.part, self.points.step)

    @cached_property
    def inverse_inertia(self) -> np.ndarray:
        """Acceleration by a unit of force, (point, nv, nv)."""
        return self._seen.inverse

    def _written(self, point: np.ndarray, writing: Sequence[AtValues]) -> mujoco.MjModel:
        fields = ModelFields(self.smoothed.task.model, 1)
        self.smoothed.task.write(fields, point[None])
        for effect, values in writing:
            effect.write(fields, values[None])
        self._written_fields.update(fields.values)
        model = copy(self.model)
        for name, values in fields.values.items():
            target = getattr(model.opt, name[4:]) if name.startswith("opt.") else getattr(model, name)
            if np.ndim(target):
                target[...] = values[0].reshape(np.shape(target))
            else:
                setattr(
                    model.opt if name.startswith("opt.") else model,
                    name.removeprefix("opt."),
                    float(values[0]),
                )
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model

    def _differs_in_friction_alone(self, model: mujoco.MjModel) -> bool:
        """Whether it is the model as it is but for dry friction, which is worked out here."""
        pairs = (
            [model_field(m, name) for m in (model, self._model)]
            for name in self._written_fields - {"dof_frictionloss"}
        )
        return all(np.array_equal(one, other) for one, other in pairs)

    @cached_property
    def _written_fields(self) -> set[str]:
        """Names of the fields in which models differ that were written so far."""
        return set()

    def _runner(self, model: mujoco.MjModel) -> batch.Batch:
        """A simulation at every point, none of which is stepped."""
        runner = batch.Batch(model, len(self.points), 1)  # a copy of this process would wait for its threads
        runner.bind("time")[...] = self.points.time
        return runner

    def _set(self, runner: batch.Batch, state: tuple[np.ndarray, ...], controls: np.ndarray) -> np.ndarray:
        """Work out forces as a step does: those that it sums, without dry friction, (point, nv)."""
        qpos, qvel, qacc = state
        smooth = runner.bind("qfrc_smooth")
        later = self._half if self._integrator in _IMPLICIT else -self._half
        self._forward(runner, qpos, qvel + later * qacc, controls)
        return smooth + self._coriolis_gained

    def _forward(self, runner: batch.Batch, qpos: np.ndarray, qvel: np.ndarray, controls: np.ndarray) -> None:
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
        runner, found = self._runner(self._model), []
        bias = runner.bind("qfrc_bias")
        runner.bind("qpos")[...] = self.state[0]
        for velocity in (self._begins, self.state[1] + self._half * self.state[2]):
            runner.bind("qvel")[...] = velocity
            runner.forward(stage=mujoco.mjtStage.mjSTAGE_VEL)
            found.append(bias.copy())
        return found[1] - found[0]

    def _forces(self, **changes) -> Accelerations:
        """As the model gives them with other parameters, written fields, states or controls than its own."""
        return self._worked_out(**changes).forces

    def _worked_out(self, *, point=None, writing=None, state=None, controls=None) -> _WorkedOut:
        """As of `_forces`."""
        moved = state is not None or controls is not None
        state = self.state if state is None else state
        controls = self.controls if controls is None else controls
        model, applied = self._applied(point, writing, (state, controls), moved=moved)
        smooth, push, contacts, inertia = applied
        changed = self._changed(model, smooth, inertia, moved=moved)
        here = np.zeros(model.nv, dtype=bool)
        for own in changed:
            here[own] = True
        if here.all():
            friction, free = np.zeros_like(smooth), np.zeros_like(smooth)
        else:
            friction, free = self._null.friction.copy(), self._null.free.copy()
        if model.dof_frictionloss.any():
            same = "_null" in self.__dict__ and np.array_equal(inertia, self._null.inertia)
            inverse = self._own_inverse_mass if same else self._inverse_mass(model, inertia, some=changed)
            loss = np.where(here, model.dof_frictionloss, 0.0)
            friction[:, here] = self._friction(model, inverse, smooth, loss, state)[:, here]
        forces = smooth + friction
        felt = self._holding(_felt(model, inertia))
        free[:, here] = solved(model, felt, np.where(self.at_rest, state[2], forces), changed)[:, here]
        pushed = np.zeros_like(free)
        if self.unshown.size:
            pushed = solved(model, felt, np.where(self.at_rest, 0.0, push))
        accelerations = Accelerations(state[2], self._resting(free, pushed))
        kept = (a.copy() for a in (push, contacts, inertia))
        return _WorkedOut(accelerations, smooth, friction, free, pushed, *kept)

    def _applied(
        self, point, writing, at: tuple[tuple[np.ndarray, ...], np.ndarray], *, moved: bool
    ) -> tuple[mujoco.MjModel, tuple[np.ndarray, ...]]:
        """The model with other parameters and written fields, and what it applies `at` states and controls: forces but
        dry friction, what contacts push by, (point, nv) each, how many these are, (point,), and the inertia as
        mjData.M packs it.
        """
        if point is None and writing is None:
            model, runner = self._model, self._plain
        else:
            writing = self._acting("model") if writing is None else writing
            model, runner = self._written(self.point if point is None else point, writing), None
        if runner is None and not moved and self._differs_in_friction_alone(model):
            null = self._null
            return model, (null.smooth, null.push, null.contacts, null.inertia)
        runner = self._runner(model) if runner is None else runner
        rest = [runner.bind(name) for name in ("qfrc_constraint", "ncon", "M")]
        return model, (self._set(runner, *at), *rest)

    def _changed(
        self, model: mujoco.MjModel, smooth: np.ndarray, inertia: np.ndarray, *, moved: bool
    ) -> list[slice]:
        """The trees in which forces `smooth`, mjData.M or what dry friction follows from are not as in the model as it
        is; all where states or controls were `moved`, and where bodies touch.
        """
        every, own = trees(model), self._model
        is_known = "_null" in self.__dict__ and model.opt.timestep == own.opt.timestep
        if moved or len(every) == 1 or self.unshown.size or not is_known:
            return every
        differs = _apart(smooth, self._null.smooth).any(axis=0)
        for name in _OF_FRICTION:
            one, other = (getattr(m, name).reshape(model.nv, -1) for m in (model, own))
            differs |= _apart(one, other).any(axis=1)
        entries = np.flatnonzero(_apart(inertia, self._null.inertia).any(axis=0))
        differs[model.M_colind[entries]] = True
        return [tree for tree in every if differs[tree].any()]

    def _resting(self, free: np.ndarray, pushed: np.ndarray, change: np.ndarray | None = None) -> np.ndarray:
        """Accelerations (point, nv) of what moves by `free` without contacts, and is `pushed` by them as hard as keeps
        what no sensor shows where it is: a puck that is heavier presses more, and its friction is more. A stiff contact
        chatters; this is the mean of it. With a `change` of what is free: what that changes.
        """
        found = own = free if change is None else change
        for tree in np.unique(self.model.dof_treeid[self.unshown]):
            dofs = self.unshown[self.model.dof_treeid[self.unshown] == tree]
            held, here = pushed[:, dofs], self.model.dof_treeid == tree
            size = np.square(held).sum(axis=1)
            size = np.where(size, size, 1.0)
            presses = (held * free[:, dofs]).sum(axis=1) < 0
            share = np.where(presses, -(held * own[:, dofs]).sum(axis=1) / size, 0.0)
            found = found + share[:, None] * np.where(here, pushed, 0.0)
        return found

    def _holding(self, felt: np.ndarray, here: np.ndarray | slice = slice(None)) -> np.ndarray:
        """What accelerations are solved with (point, nv, nv) where coordinates at rest keep the acceleration that they
        have: dry friction holds them by a force that nobody knows.
        """
        point, dof = np.nonzero(self.at_rest[here])
        felt[point, dof] = 0.0
        felt[point, dof, dof] = 1.0
        return felt

    def _at_rest(self) -> np.ndarray:
        """Where a coordinate is at rest for longer than a turn of the motion takes, (point, nv)."""
        cutoff = max(s[0].cutoff for s in self.smoothed.series.values())
        shortest = max(int(np.ceil(SETTINGS.resting * np.pi / cutoff / self.points.interval)), 2)
        slow = np.abs(self.state[1]) < SETTINGS.none * self.speed_sd
        found = np.zeros_like(slow)
        for own in self.points.stretches:
            for dof in range(self.model.nv):
                edges = np.flatnonzero(
                    np.diff(np.concatenate([[False], slow[own, dof], [False]]).astype(int))
                )
                for a, b in zip(edges[::2], edges[1::2], strict=True):
                    if b - a >= shortest:
                        found[own.start + a : own.start + b, dof] = True
        return found

    def _unknown(self) -> np.ndarray:
        """Where what is true is reported before or after the stretch, (point,)."""
        found, time = np.zeros(len(self.points), dtype=bool), self.smoothed.log.time
        for own, part in zip(self.points.stretches, self.smoothed.parts, strict=True):
            at = self.points.since[own, None] + self.late[own]
            found[own] = ((at < 0) | (at > time[part.stop - 1] - time[part.start])).any(axis=1)
        return found

    @property
    def _half(self) -> float:
        """s, from the beginning of a step to the time of its acceleration."""
        return (self._integrator != _INTEGRATOR.mjINT_RK4) * self.model.opt.timestep / 2

    @property
    def _integrator(self) -> int:
        return int(self.model.opt.integrator)

    @cached_property
    def _begins(self) -> np.ndarray:
        """Velocities that steps begin with, (point, nv)."""
        return self.state[1] - self._half * self.state[2]

    @cached_property
    def _plain(self) -> batch.Batch:
        """Simulations of the model as it is."""
        return self._runner(self._model)

    def _inverse_mass(
        self,
        model: mujoco.MjModel,
        packed: np.ndarray,
        here: np.ndarray | slice = slice(None),
        some: Sequence[slice] | None = None,
    ) -> np.ndarray:
        """What dry friction works against, (point, nv, nv), from mjData.M at the points `here`, of `some` trees."""
        return inverse_of(model, self._holding(mass_matrix(model, packed), here), some)

    def _inverse_felt(
        self, model: mujoco.MjModel, packed: np.ndarray, here: np.ndarray | slice = slice(None)
    ) -> np.ndarray:
        """Of what accelerations are solved with, (point, nv, nv), from mjData.M at the points `here`."""
        return inverse_of(model, self._holding(_felt(model, packed), here))

    def _friction(
        self,
        model: mujoco.MjModel,
        inverse: np.ndarray,
        applied: np.ndarray,
        loss: np.ndarray,
        state: tuple[np.ndarray, ...],
        here: np.ndarray | slice = slice(None),
    ) -> np.ndarray:
        """Dry friction (point, nv) at the points `here` where forces are `applied` (point, nv) beside it.

        What is at rest has none, and the acceleration that it has.
        """
        rest = self.at_rest[here]
        begins = state[1] - self._half * state[2]
        driven = np.where(rest, state[2], applied)
        return dry_friction(model, inverse, driven, begins, self.speed_sd, np.where(rest, 0.0, loss))

    def _of_force(self, effect: Effect, values: np.ndarray) -> list[Accelerations]:
        """Of a force that does not remember: every point is a step of its own, and all variants are side by side."""
        variants, points = len(values), np.arange(len(self.points))
        here = np.tile(points, variants)

        def force() -> Callable:
            return effect.force(
                np.repeat(values, len(points), axis=0),
                self.model.opt.timestep,
                first=self.points.step[here],
                began=(self.points.time - self.points.elapsed)[here],
            )

        [led] = self._led_along(force, here[:, None])
        return self._as_changes(led, variants)

    def _accelerated(
        self,
        acts: np.ndarray,
        loss: np.ndarray,
        inverse: np.ndarray,
        felt: np.ndarray,
        here: np.ndarray,
    ) -> np.ndarray:
        """Accelerations (point, nv) at the points `here`, where forces `acts` (point, nv) come in beside those of the
        model, frictionloss is `loss` (point, nv), and inverse, felt (point, nv, nv) are the inverses of what dry
        friction works against and of what accelerations are solved with.
        """
        applied = self._null.smooth[here] + acts
        state = tuple(s[here] for s in self.state)
        applied += self._friction(self._model, inverse, applied, loss, state, here)
        return (felt @ np.where(self.at_rest[here], state[2], applied)[..., None])[..., 0]

    def _friction_changed(
        self, acts: np.ndarray, loss: np.ndarray, here: np.ndarray | slice = slice(None)
    ) -> np.ndarray:
        """By how much dry friction is other, (point, nv), where forces `acts` (point, nv) come in beside those of the
        model, and frictionloss is `loss` (point, nv).
        """
        if not loss.any() and not self._null.friction.any():
            return np.zeros_like(acts)
        # other trees do not feel what one does
        changed = in_whole_trees(self._model, (acts != 0) | (loss != self._model.dof_frictionloss))
        some = np.flatnonzero(changed.any(axis=1))
        at = some if isinstance(here, slice) else here[some]
        applied = self._null.smooth[at] + acts[some]
        state = tuple(s[at] for s in self.state)
        felt = np.where(changed[some], loss[some], 0.0)
        friction = self._friction(self._model, AtPoints(self._own_inverse_mass, at), applied, felt, state, at)
        found = np.zeros_like(acts)
        found[some] = np.where(changed[some], friction - self._null.friction[at], 0.0)
        return found

    @cached_property
    def _own_inverse_mass(self) -> np.ndarray:
        """Of the model as it is, (point, nv, nv)."""
        return self._inverse_mass(self._model, self._null.inertia)

    @cached_property
    def _own_inverse_felt(self) -> np.ndarray:
        """Of the model as it is, (point, nv, nv)."""
        return self._inverse_felt(self._model, self._null.inertia)

    def _of_followed(self, effect: Effect, values: np.ndarray) -> list[Accelerations]:
        """Of forces that remember: they are led along the motion, all stretches and variants side by side."""
        parts, variants = len(self.smoothed.parts), len(values)
        longest = max(own.stop - own.start for own in self.points.stretches)
        index = np.array(
            [
                np.minimum(np.arange(own.start, own.start + longest), own.stop - 1)
                for own in self.points.stretches
            ]
        )
        index = np.tile(index, (variants, 1))  # (variant and part, point)

        def force() -> Callable:
            return effect.force(
                np.repeat(values, parts, axis=0),
                self.points.interval,
                first=self.points.step[index[:, 0]],
                began=(self.points.time - self.points.elapsed)[index[:, 0]],
            )

        led = self._led_along(force, index)
        changes = np.zeros((variants, len(self.points), self.model.nv))
        for part, own in enumerate(self.points.stretches):
            changes[:, own] = led[: own.stop - own.start, part::parts].swapaxes(0, 1)
        return [Accelerations(np.zeros_like(self.state[1]), c) for c in changes]

    def _led_along(self, force: Callable[[], Callable], index: np.ndarray) -> np.ndarray:
        """Accelerations (step, lane, nv) by a force, made by `force`, along the points `index` (lane, step)."""
        led = self._led_at_joints(force(), index)
        return self._led_elsewhere(force(), index) if led is None else led

    def _led_at_joints(self, force: Callable, index: np.ndarray) -> np.ndarray | None:
        """Accelerations (step, lane, nv) by a force along the points `index` (lane, step); None where it changes
        something else than what joints feel: other fields of the model, or forces on bodies.
        """
        _, qvel, qacc = self.state
        world = RecordedWorld(self._model, self._recorded, index)
        applied, friction, damping = world.qfrc_applied, *(world.vary(name) for name in AT_JOINTS)
        armature = world.vary(OF_INERTIA[0])
        own_damping, mean = self._model.dof_damping, qvel + 0.5 * self._model.opt.timestep * qacc
        acts, loss, heavier = (np.zeros((index.shape[1], len(index), self._model.nv)) for _ in range(3))
        for step, here in enumerate(index.T):
            world.go_to(step)
            force(world)
            if world.is_changed_elsewhere:
                return None
            acts[step] = applied - (damping - own_damping) * mean[here]
            loss[step] = friction
            heavier[step] = armature - self._model.dof_armature
        lanes = [values.reshape(-1, self._model.nv) for values in (acts, loss, heavier)]
        if heavier.any():
            return self._led_with_inertia(*lanes, index.T.ravel()).reshape(acts.shape)
        return self._led(*lanes[:2], index.T.ravel()).reshape(acts.shape)

    def _led_with_inertia(
        self, acts: np.ndarray, loss: np.ndarray, heavier: np.ndarray, index: np.ndarray
    ) -> np.ndarray:
        """Accelerations (lane, nv) by forces `acts` at the points `index` (lane,), with frictionloss `loss`, where the
        inertia of each coordinate is larger by `heavier`, (lane, nv) each.
        """
        parts = []
        for some in np.array_split(np.arange(len(index)), -(-len(index) // SETTINGS.lanes)):
            parts.append(self._heavier(acts[some], loss[some], heavier[some], index[some]))
        return np.concatenate(parts)

    def _heavier(
        self, acts: np.ndarray, loss: np.ndarray, heavier: np.ndarray, here: np.ndarray
    ) -> np.ndarray:
        """As of `_led_with_inertia`: trees in which nothing changes stay as they are."""
        model, null = self._model, self._null
        changed = in_whole_trees(model, (acts != 0) | (heavier != 0) | (loss != model.dof_frictionloss))
        more = heavier * ~self.at_rest[here]
        state = tuple(s[here] for s in self.state)
        mass, felt = (AtPoints(i, here, more) for i in (self._own_inverse_mass, self._own_inverse_felt))
        applied = null.smooth[here] + acts
        applied += self._friction(model, mass, applied, np.where(changed, loss, 0.0), state, here)
        applied = np.where(self.at_rest[here], state[2], applied)
        free = np.where(changed, times(model, felt, np.where(changed, applied, 0.0)), null.free[here])
        return self._resting(free, null.pushed[here]) - self.null.predicted[here]

    def _led(self, acts: np.ndarray, loss: np.ndarray, here: np.ndarray) -> np.ndarray:
        """Accelerations (lane, nv) by forces `acts` at the points `here`, with frictionloss `loss`, (lane, nv) each."""
        forces = acts + self._friction_changed(acts, loss, here)
        return times(self._model, AtPoints(self.inverse_inertia, here), forces)

    def _recorded(self, name: str) -> np.ndarray:
        """A field of MjData at the points, of the model as it is; the acceleration is the predicted one."""
        if name == "qacc":
            return self.null.predicted
        return getattr(self._seen.world, name)

    def _led_elsewhere(self, force: Callable, index: np.ndarray) -> np.ndarray:
        """As `_led_at_joints`, of a force that changes anything; MuJoCo works out at every step what that does, but for
        what actuators give where their numbers are others.
        """
        nv, step = self._model.nv, self._model.opt.timestep
        world = RecordedWorld(self._model, self._recorded, index)
        friction, damping = (world.vary(name) for name in AT_JOINTS)
        given = world.actuator_force  # as they gave it under the force of the step before
        acts, loss = (np.zeros((index.shape[1], len(index), nv)) for _ in range(2))
        otherwise: dict[int, np.ndarray] = {}  # accelerations of steps in which inertias are others
        runner = cache(lambda: batch.Batch(self._model, len(index), own_threads(self.threads)))
        for k, here in enumerate(index.T):
            world.go_to(k)
            world.actuator_force = given
            force(world)
            applied, given, inertia = self._by_actuators(world, here) or self._by_mujoco(
                world, here, runner()
            )
            loss[k] = friction
            acts[k] = applied - (damping - self._model.dof_damping) * step * self.state[2][here]
            if world.changes(but=(*APPLIED, *AT_JOINTS, *_OF_ACTUATORS)):
                own = (
                    inverse(self._model, inertia, here)
                    for inverse in (self._inverse_mass, self._inverse_felt)
                )
                free = self._accelerated(acts[k], loss[k], *own, here)
                otherwise[k] = self._resting(free, self._null.pushed[here]) - self.null.predicted[here]
        led = self._led(acts.reshape(-1, nv), loss.reshape(-1, nv), index.T.ravel()).reshape(acts.shape)
        for k, accelerations in otherwise.items():
            led[k] = accelerations
        return led

    def _by_actuators(
        self, world: RecordedWorld, here: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, None] | None:
        """As `_by_mujoco`, where a force changes no more than what joints feel and numbers of linear actuators, so that
        the inertia is not asked for; None where it changes something else.
        """
        actuation = self._seen.actuation
        if actuation is None or world.changes(but=(APPLIED[0], *AT_JOINTS, *NUMBERS)):
            return None
        numbers = world.changed(NUMBERS)
        if not actuation.follows(numbers):
            return None
        given = actuation.given(self.controls[here], numbers, here)
        velocity = self._begins[here]
        applied = world.qfrc_applied - (world.vary("dof_damping") - self._model.dof_damping) * velocity
        return applied + actuation.changed(given, here), given, None

    def _by_mujoco(
        self, world: RecordedWorld, here: np.ndarray, runner: batch.Batch
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What comes in (lane, nv) at the points `here` by a force that changed `world`; what actuators then give,
        (lane, actuator), and the inertia, as mjData.M packs it.
        """
        smooth, inertia, actuators = (runner.bind(n) for n in ("qfrc_smooth", "M", "actuator_force"))
        runner.bind("time")[...] = self.points.time[here]
        world.write(runner)
        self._forward(runner, self.state[0][here], self._begins[here], self.controls[here])
        return smooth - self._seen.smooth[here], actuators.copy(), inertia

    @cached_property
    def actuator_force(self) -> np.ndarray:
        """N or N m, (point, actuator)."""
        return np.array(self._seen.world.actuator_force)

    @cached_property
    def _model(self) -> mujoco.MjModel:
        return self._written(self.point, self._acting("model"))

    @cached_property
    def _seen(self) -> _Seen:
        model = self._model
        runner = self._runner(model)
        smooth = runner.bind("qfrc_smooth")
        actuation = Actuation.of(
            model, runner, lambda: self._forward(runner, self.state[0], self._begins, self.controls)
        )
        world = World(runner, np.arange(len(self.points)))
        world.qacc = self.null.predicted
        world.stepped = True
        inverse = self._own_inverse_felt * ~self.at_rest[:, None, :]
        return _Seen(world, self._yielding(inverse), actuation, smooth.copy())

    def _yielding(self, inverse: np.ndarray) -> np.ndarray:
        """Acceleration by a unit of force, (point, nv, nv): what no sensor shows stays where contacts keep it."""
        if not self.unshown.size:
            return inverse
        free, pushed = self._null.free, self._null.pushed
        columns = [self._resting(free, pushed, inverse[..., dof]) for dof in range(self.model.nv)]
        return np.stack(columns, axis=-1)


def _remembers(effect: Effect) -> bool:
    """Whether its force depends on what was before, other than by what the log tells."""
    return not isinstance(effect, FollowedForce) and inspect.isclass(getattr(type(effect), "kernel", None))


def _is_same(one: Effect, other: Effect) -> bool:
    return type(one) is type(other) and one.site == other.site


def _apart(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Where values (..., column) differ by more than rounding does of what is common in their column."""
    return np.abs(one - other) > SETTINGS.rounding * np.abs(other).max(axis=0)


def _felt(model: mujoco.MjModel, packed: np.ndarray) -> np.ndarray:
    """What accelerations are solved with, (point, nv, nv), from mjData.M: Euler's method takes damping at the end of
    the step, M + h D.
    """
    dense = mass_matrix(model, packed)
    if int(model.opt.integrator) == mujoco.mjtIntegrator.mjINT_EULER:
        own = np.arange(model.nv)
        dense[:, own, own] += model.opt.timestep * model.dof_damping
    return dense
