"""Initial states from the outputs of a log, with how well each is known.

Where outputs measure a coordinate or its velocity, their motion around the window's first sample gives value and
derivative. What no output measures is taken from a simulation of the whole episode, and may be off by more than it
moves there: a coordinate that rests stays where it is. Both are then made to satisfy the equality constraints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import mujoco
import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.initial_states.local_motion import SETTINGS as LOCAL_MOTION
from capture_cli.estimate.initial_states.local_motion import LocalMotion, Neighbours, local_motion
from capture_cli.estimate.initial_states.rotations import rotations, turned
from capture_cli.log.arrays import Log
from capture_cli.log.range_ends import piled_up_from
from capture_cli.log.reported_motion import SETTINGS as REPORTED_MOTION
from capture_cli.log.reported_motion import ReportedMotion, extended
from capture_cli.model.coordinate_sources import Source, sources_of
from capture_cli.model.loop_closure import LoopClosure, MeasuredPositions
from capture_cli.model.states import InitialStates
from capture_cli.simulate.engine import Rollouts


@frozen
class SETTINGS:
    # The local fit uses samples that the window is fitted to as well, so it may not vote with its full weight twice.
    prior_inflation: float = 10.0
    lag_left: float = 0.02  # of the correction for the integrator's lag: higher orders of the timestep
    # Times the motion of an unmeasured coordinate in a simulated episode, which may be of another phase and
    # another size
    unmeasured_motion: float = 3.0
    still: float = 1e-9  # m, rad, or per s: what moves less does not, but for rounding


@dataclass(frozen=True)
class InitialStateEstimate:
    """Initial states (one per window) and the standard deviation of each tangent coordinate, (window, state).

    The state is (positions (nv), velocities (nv), activations (na)); positions are in the tangent space, so that
    quaternions are moved by a rotation vector. reported: the motion that the sensors showed there; None where the
    initial states come from elsewhere. open_loops: equality constraints that the outputs contradict, as `left_open` has
    them.
    """

    states: InitialStates
    sd: np.ndarray
    reported: ReportedMotion | None = None
    open_loops: Mapping[str, float] = field(default_factory=dict)

    def rows(self, keep) -> InitialStateEstimate:
        """Those of the windows at `keep`."""
        reported = None if self.reported is None else self.reported.rows(keep)
        return InitialStateEstimate(self.states.rows(keep), self.sd[keep], reported, self.open_loops)


@dataclass(frozen=True)
class Places:
    """Where windows begin in a log: of each its first step and its episode, (window,)."""

    log: Log
    first: np.ndarray
    episode: np.ndarray


@dataclass(frozen=True)
class _Outputs:
    """values (step, output), where they were sampled, likewise, and noise_sd (output,)."""

    values: np.ndarray
    sampled: np.ndarray
    noise_sd: np.ndarray

    def between_samples(self, log: Log) -> np.ndarray:
        """The values with straight lines between samples: near enough to follow a loop by."""
        if self.sampled.all():
            return self.values
        values = self.values.copy()
        for steps in log.episodes:
            for k in np.flatnonzero(~self.sampled[steps].all(axis=0)):
                own = steps.start + np.flatnonzero(self.sampled[steps, k])
                values[steps, k] = np.interp(log.time[steps], log.time[own], values[own, k])
        return values


def estimated_initial_states(
    model: mujoco.MjModel,
    data: Sequence[int],
    places: Places,
    noise_sd: np.ndarray,
    *,
    unmeasured: InitialStateEstimate | None = None,
    slack: np.ndarray | None = None,
) -> InitialStateEstimate:
    """Initial state of every window.

    data (output,): which number of sensordata each output is; -1 of one that is not to be believed.
    noise_sd (output,). All values of a sensor have a sample in a step, or none.
    unmeasured: what is believed of coordinates that no output measures; the model's own start, fixed, where None.
    slack: how far equality constraints give way, as for LoopClosure.
    """
    count, nv, sampled = len(places.first), model.nv, places.log.sampled
    believed = unmeasured or model_initial_states(model, count)
    qpos, qvel, act = (a.copy() for a in (believed.states.qpos, believed.states.qvel, believed.states.act))
    sd = believed.sd.copy()
    measured = _Outputs(places.log.outputs, sampled, noise_sd)
    # of two that give a coordinate the last has the say: one that is not sparse
    sources = sorted(sources_of(model, data), key=lambda s: bool(sampled[:, list(s.columns)].all()))
    lag = _velocity_lag(model)
    knots = _Knots.of(places, merged=not sampled.all(axis=0).any())
    path = np.zeros((count, knots.count, 3, model.nsensordata))
    measured_velocity = {d for s in sources if s.kind == "velocity" for d in s.dofs}
    for source in sources:
        columns, dofs = list(source.columns), np.array(source.dofs)
        every = _motion(knots, measured, columns)
        motion = np.stack([every.value, every.slope, every.curvature], axis=1)
        path[..., list(source.data)] = motion.reshape(count, knots.count, 3, -1)
        if source.kind == "orientation":
            fit, qpos[:, list(source.qpos)] = _turning(knots, measured, source)
        else:
            fit = at_initial = every.rows(slice(None, None, knots.count))
            if source.weights is not None:
                fit = fit.mixed(source.weights)
            if source.kind == "position":
                qpos[:, list(source.qpos)] = fit.value + source.constant
        if source.kind == "velocity":
            qvel[:, dofs] = fit.value
            beyond = _beyond_range(source, measured, at_initial.value)
            sd[:, nv + dofs] = np.hypot(SETTINGS.prior_inflation * fit.value_sd, beyond)
            continue
        sd[:, dofs] = SETTINGS.prior_inflation * fit.value_sd
        new = np.array([d not in measured_velocity for d in source.dofs])
        velocity, velocity_sd = _velocity(fit, lag, source)
        qvel[:, dofs[new]], sd[:, nv + dofs[new]] = (
            velocity[:, new],
            SETTINGS.prior_inflation * velocity_sd[:, new],
        )
    initial = InitialStates(qpos, qvel, act, places.log.time[places.first].astype(float))
    open_loops: Mapping[str, float] = {}
    if model.neq:
        initial, sd, open_loops = _closed(LoopClosure(model, slack), initial, sd, sources, measured, places)
    reported = _reported(
        extended(path, knots.before, knots.known), knots.before, sources, measured_velocity, nv, lag
    )
    return InitialStateEstimate(initial, sd, reported, open_loops)


def _beyond_range(source: Source, measured: _Outputs, value: np.ndarray) -> np.ndarray:
    """How far velocities may be beyond what is reported, (window, dof), where windows begin with `value` (window,
    column): as far again where that is where numbers pile up, the end of the sensor's range.
    """
    columns = list(source.columns)
    reported = np.where(measured.sampled, measured.values, np.nan)[:, columns]
    ends = np.array([piled_up_from(column[:, None]) for column in reported.T])
    beyond = np.where(np.abs(value) > ends, np.abs(value), 0.0)
    return beyond if source.weights is None else np.sqrt(np.square(beyond) @ np.square(source.weights).T)


def _velocity(fit: LocalMotion, lag: float, source: Source) -> tuple[np.ndarray, np.ndarray]:
    """Of coordinates whose motion is `fit`, as the integrator has it, and how well it is known, (window, dof)."""
    change = lag * fit.curvature
    size = np.linalg.norm(change, axis=1, keepdims=True) if source.kind == "orientation" else change
    return fit.slope - change, np.hypot(fit.slope_sd, SETTINGS.lag_left * size)


def _turning(knots: _Knots, measured: _Outputs, source: Source) -> tuple[LocalMotion, np.ndarray]:
    """At the initial states, of an orientation: the motion of its rotation vector, and the quaternion, (window, 4)."""
    columns = list(source.columns)
    at_initial = knots.around(measured.sampled[:, columns[0]]).rows(slice(None, None, knots.count))
    quaternions = source.of(measured.values[at_initial.index][..., columns])
    rotation, near = rotations(quaternions, at_initial)
    fit = local_motion(near, rotation, source.noise(measured.noise_sd))
    return fit, turned(quaternions[:, LOCAL_MOTION.half_widths[-1]], fit.value)


def _motion(knots: _Knots, measured: _Outputs, columns: list[int]) -> LocalMotion:
    """That of output columns at all knots, (window and knot, column)."""
    sampled = measured.sampled[:, columns]
    if (sampled == sampled[:, :1]).all():
        near = knots.around(sampled[:, 0])
        return local_motion(near, measured.values[near.index][..., columns], measured.noise_sd[columns])
    parts = [vars(_motion(knots, measured, [c])) for c in columns]
    return LocalMotion(**{name: np.hstack([p[name] for p in parts]) for name in parts[0]})


def _closed(
    loops: LoopClosure,
    initial: InitialStates,
    sd: np.ndarray,
    sources: Sequence[Source],
    measured: _Outputs,
    places: Places,
) -> tuple[InitialStates, np.ndarray, Mapping[str, float]]:
    """Initial states and their sd (window, state) that satisfy the model's equality constraints, and those that outputs
    contradict.
    """
    positions = [s for s in sources if s.kind != "velocity"]
    qpos, dofs = (
        np.array([i for s in positions for i in getattr(s, n)], dtype=int) for n in ("qpos", "dofs")
    )
    outputs = measured.between_samples(places.log)
    coordinates = np.hstack([outputs[:, :0], *(s.of(outputs[:, list(s.columns)]) for s in positions)])
    known = np.concatenate([s.noise(measured.noise_sd) for s in positions] or [np.zeros(0)])
    begin = model_initial_states(loops.model, 1).states.qpos[0]
    followed = np.zeros_like(initial.qpos)
    for number, steps in enumerate(places.log.episodes):
        own = places.episode == number
        at = places.first[own] - steps.start
        logged = MeasuredPositions(coordinates[steps], qpos, dofs, known)
        followed[own] = loops.follow(places.log.time[steps], logged, begin, at)
    at_initial = MeasuredPositions(coordinates[places.first], qpos, dofs, known)
    open_loops = loops.left_open(followed, at_initial)
    return *loops.close(initial, sd, followed), open_loops


@dataclass(frozen=True)
class _Knots:
    """Steps at which the outputs' motion is looked at: where each window starts, and some before.

    time (step,) s; at, first, stop (place,): these steps, window by window, and the steps of their episodes. before
    (window, knot): s, before the start. known (window, knot): False before the episode.
    """

    time: np.ndarray
    at: np.ndarray
    first: np.ndarray
    stop: np.ndarray
    before: np.ndarray
    known: np.ndarray

    @property
    def count(self) -> int:
        """Of each window."""
        return self.before.shape[1]

    @cached_property
    def _near(self) -> Neighbours:
        return Neighbours.of(self.time, self.at, self.first, self.stop)

    def around(self, sampled: np.ndarray) -> Neighbours:
        """The samples around all knots, window by window, of outputs that have one where `sampled` (step,)."""
        if sampled.all():
            return self._near
        return Neighbours.of(self.time, self.at, self.first, self.stop, np.flatnonzero(sampled))

    @classmethod
    def of(cls, places: Places, *, merged: bool) -> _Knots:
        """merged: whether steps are those of several sensors, and may be next to each other."""
        time, episodes, window_first = places.log.time, places.log.episodes, places.first
        steps = np.concatenate([np.diff(time[e]) for e in episodes])
        interval = float(np.mean(steps) if merged else np.median(steps))
        stride = max(1, round(REPORTED_MOTION.knot_interval / interval))
        count = 1 + int(np.ceil(REPORTED_MOTION.most_late / (stride * interval) - 1e-6))
        first, stop = (np.array([getattr(e, n) for e in episodes])[places.episode] for n in ("start", "stop"))
        at = window_first[:, None] - stride * np.arange(count)
        even = stride * interval * np.arange(count)
        before = time[window_first][:, None] - time[np.maximum(at, first[:, None])]
        known = (at >= first[:, None]) & (before < 2 * even + interval)  # and not before a gap
        at = np.where(known, at, window_first[:, None])
        before = np.where(known, before, even)
        first, stop = (np.repeat(a, count) for a in (first, stop))
        return cls(time, at.ravel(), first, stop, before, known)


def _reported(
    path: np.ndarray,
    before: np.ndarray,
    sources: Sequence[Source],
    measured_velocity: set[int],
    nv: int,
    lag: float,
) -> ReportedMotion:
    """The motion that the sensors showed, and which of its columns (`Source.data`) say what of the state.

    path (window, knot, 3, column); before (window, knot): s, before the start. measured_velocity: dofs
    whose velocity an output measures; of the others it is the slope of the position. lag: s, as of `_velocity_lag`.
    """
    taken: dict[str, dict[int, list[tuple[int, float]]]] = {"position": {}, "velocity": {}, "slope": {}}
    orientation = []
    for source in sources:
        if source.kind == "orientation":
            column, dof = source.data[0], source.dofs[0]
            turning = None if dof in measured_velocity else slice(nv + dof, nv + dof + 3)
            weights = np.eye(4) if source.weights is None else source.weights
            orientation.append((slice(column, column + 4), weights, slice(dof, dof + 3), turning))
            continue
        weights = np.eye(len(source.dofs)) if source.weights is None else source.weights
        for dof, row in zip(source.dofs, weights, strict=True):
            terms = [(column, float(w)) for column, w in zip(source.data, row, strict=True) if w]
            taken[source.kind][dof + nv if source.kind == "velocity" else dof] = terms
            if source.kind == "position" and dof not in measured_velocity:
                taken["slope"][dof + nv] = terms
    position, velocity, slope = (
        tuple((column, state, weight) for state, terms in states.items() for column, weight in terms)
        for states in taken.values()
    )
    return ReportedMotion(
        path,
        before,
        position,
        velocity,
        slope,
        tuple(orientation),
        lag,
        np.ones(len(path), dtype=bool),
    )


def model_initial_states(model: mujoco.MjModel, count: int) -> InitialStateEstimate:
    """The model's own initial state (its first keyframe if it has one), `count` times, taken as known."""
    qpos = model.key_qpos[0] if model.nkey else model.qpos0
    qvel = model.key_qvel[0] if model.nkey else np.zeros(model.nv)
    act = model.key_act[0] if model.nkey else np.zeros(model.na)
    initial = InitialStates(*(np.repeat(a[None], count, axis=0) for a in (qpos, qvel, act)), np.zeros(count))
    return InitialStateEstimate(initial, np.zeros((count, 2 * model.nv + model.na)))


def known_initial(
    model: mujoco.MjModel, data: Sequence[int], initial: InitialStates, noise_sd: np.ndarray
) -> InitialStateEstimate:
    """Initial states that somebody knows, but for positions that outputs measure: those are as good as a few of their
    samples.

    data, noise_sd (output,) as in `estimated_initial_states`.
    """
    sd = np.zeros((len(initial), 2 * model.nv + model.na))
    for source in sources_of(model, data):
        if source.kind != "velocity":
            sd[:, list(source.dofs)] = SETTINGS.prior_inflation * source.noise(noise_sd)
    return InitialStateEstimate(initial, sd)


def with_known(
    read: InitialStateEstimate, known: InitialStateEstimate, which: np.ndarray
) -> InitialStateEstimate:
    """Initial states that were read off a log, but those that are `known` at `which` (window,)."""
    rows = which[:, None]
    qpos, qvel, act = (
        np.where(rows, getattr(known.states, name), getattr(read.states, name))
        for name in ("qpos", "qvel", "act")
    )
    reported = None if read.reported is None else replace(read.reported, read=~which)
    return InitialStateEstimate(
        replace(read.states, qpos=qpos, qvel=qvel, act=act),
        np.where(rows, known.sd, read.sd),
        reported,
        read.open_loops,
    )


def states_of(whole: Rollouts, episode: np.ndarray, step: np.ndarray) -> InitialStates:
    """The states of simulations with states at `step` (window,) of `episode` (window,), at time 0."""
    states = (whole.qpos, whole.qvel, whole.act)
    return InitialStates(*(values[episode, step] for values in states), np.zeros(len(episode)))


def from_episodes(
    model: mujoco.MjModel, whole: Rollouts, *, window_episode, window_step
) -> InitialStateEstimate:
    """Initial states of windows from simulations of `whole` episodes, with their states. window_step (window,): on
    their grid.

    The standard deviation of each coordinate is `unmeasured_motion` times that of its motion over the episode.
    """
    qpos, qvel, act = whole.qpos, whole.qvel, whole.act
    initial = states_of(whole, window_episode, window_step)
    moved = _since_the_first(model, qpos)
    motion = np.concatenate([states.std(axis=1) for states in (moved, qvel, act)], axis=1)
    motion[motion < SETTINGS.still] = 0.0
    return InitialStateEstimate(initial, SETTINGS.unmeasured_motion * motion[window_episode])


def _since_the_first(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """Tangent moves (simulation, step, nv) from each first position of qpos (simulation, step, nq)."""
    if model.nq == model.nv:
        return qpos - qpos[:, :1]
    moved = np.zeros((*qpos.shape[:2], model.nv))
    for episode, path in enumerate(qpos):
        for step, position in enumerate(path):
            mujoco.mj_differentiatePos(model, moved[episode, step], 1.0, path[0], position)
    return moved


def _velocity_lag(model: mujoco.MjModel) -> float:
    """How long before the time of a state its velocity is that of its path, s.

    The integrators but RK4 step x' = x + h v' with the new velocity: v is the path's slope half a step earlier.
    """
    return 0.0 if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4 else 0.5 * model.opt.timestep
