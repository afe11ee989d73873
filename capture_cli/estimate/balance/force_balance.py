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

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.balance.added_forces import AddedForces
from capture_cli.estimate.balance.arriving_controls import ArrivingControls
from capture_cli.estimate.balance.forward_dynamics import Accelerations, ForwardDynamics
from capture_cli.estimate.balance.motion import SmoothedLog
from capture_cli.estimate.balance.points import Points
from capture_cli.estimate.balance.reported_motion import ReportedMotion
from capture_cli.log.input_sequences import Hold
from capture_cli.model.effects._periodic_force import PeriodicForce
from capture_cli.model.effects.base import AtValues, Effect
from capture_cli.model.fields import ModelFields
from capture_cli.model.mujoco_warnings import silence_mujoco

_OF_IMPACTS = ("geom_size", "geom_solref", "geom_solimp", "pair_solref", "pair_solimp")


@frozen
class SETTINGS:
    step: float = 1e-3  # of a parameter's range, in differences


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
        self.model = smoothed.task.model
        self.points = Points.of(smoothed)
        reporting = self._acting("measurement")
        self.reports = ReportedMotion(smoothed, self.points, lambda: self.actuator_force)
        self.late = self.reports.lateness(reporting)
        self.unknown = self.reports.unknown(self.late)
        self.numbers = self.reports.numbers(self.late)
        self.state = smoothed.states(self.reports.true(self.numbers, reporting), self.points.step)
        self.arriving = ArrivingControls(smoothed, self.points)
        self.controls = self.arriving.behind([self._acting("control")])[0]
        fields = self._fields(self._acting("model"), point)
        self.dynamics = ForwardDynamics(smoothed, self.points, self.state, self.controls, fields)
        self.at_rest, self.unshown = self.dynamics.at_rest, self.dynamics.unshown
        self.forces = AddedForces(self.dynamics, self.threads)

    # --- as it is ---

    @property
    def null(self) -> Accelerations:
        """Of the model as it is."""
        return self.dynamics.null.forces

    @cached_property
    def predicted_smooth(self) -> np.ndarray:
        """The predicted acceleration behind the filter that the measured one went through, (point, nv)."""
        return self.smoothed.filtered(self.null.predicted, self.points.part, self.points.step)

    @property
    def inverse_inertia(self) -> np.ndarray:
        """Acceleration by a unit of force, (point, nv, nv)."""
        return self.dynamics.inverse_inertia

    @property
    def actuator_force(self) -> np.ndarray:
        """N or N m, (point, actuator)."""
        return self.forces.actuator_force

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
                moved = self.dynamics.moved(tuple(state)).forces.predicted - self.null.predicted
                found[which, dof] = np.median(moved[:, dof]) / step
        return found[0], found[1]

    # --- what acts ---

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
        written = self.dynamics.written(self._fields(self._acting("model"), moved))
        return (written.forces - self.null) / step

    def of_effect(self, effect: Effect, values: np.ndarray) -> list[Accelerations]:
        """Changes of the balance by an effect at each of `values` (variant, parameter)."""
        if effect.place == "model":
            return [self._of_written(self._with(effect, v)) for v in values]
        if effect.place == "control":
            return self.forces.of_controls(self.arriving.behind([self._with(effect, v) for v in values]))
        if effect.place == "measurement":
            return [self._of_report(effect, v) for v in values]
        return self.forces.of_effect(effect, values)

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

    # --- parts ---

    def _acting(self, place: str) -> list[AtValues]:
        """The effects that act at a place."""
        return [own for own in self.acting if own[0].place == place]

    def _with(self, effect: Effect, values: np.ndarray) -> list[AtValues]:
        """Those at the place of `effect`, which is at these values (parameter,), not at its own, or comes last."""
        others = self._acting(effect.place)
        found = [(e, values if _is_same(e, effect) else v) for e, v in others]
        return found if any(_is_same(e, effect) for e, _ in others) else [*found, (effect, values)]

    def _fields(self, writing: Sequence[AtValues], point: np.ndarray | None = None) -> ModelFields:
        """Of the model, where effects write them; at a point (parameter,) of the task, where given."""
        fields = ModelFields(self.model, 1)
        if point is not None:
            self.smoothed.task.write(fields, point[None])
        for effect, values in writing:
            effect.write(fields, values[None])
        return fields

    def _of_written(self, writing: Sequence[AtValues]) -> Accelerations:
        """Change of the balance where fields of the model are written; not a number where other bodies would touch, or
        where these say how bodies hit, of which nothing is left in the balance.
        """
        written = self.dynamics.written(self._fields(writing, self.point))
        change = written.forces - self.null
        hits = self.smoothed.hits and any(name in _OF_IMPACTS for name in self._fields(writing).values)
        if not hits and np.array_equal(written.contacts, self.dynamics.null.contacts):
            return change
        return Accelerations(change.measured, np.full_like(change.predicted, np.nan))

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
        predicted = self.dynamics.moved((qpos, qvel, self.state[2])).forces.predicted
        return Accelerations(acceleration - self._instrumented, predicted - self.null.predicted)

    @cached_property
    def _instrumented(self) -> np.ndarray:
        """The acceleration where the predicted one stands for the measured one, (point, nv)."""
        predicted = self.reports.with_curvatures(
            self.numbers, np.zeros_like(self.late), self.predicted_smooth
        )
        true = self.reports.true(predicted, self._acting("measurement"))
        return self.smoothed.states(true, self.points.step)[2]


def _is_same(one: Effect, other: Effect) -> bool:
    return type(one) is type(other) and one.site == other.site
