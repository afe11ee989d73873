"""Initial states from the outputs of a log, with how well each is known.

Where an output measures a coordinate or its velocity, a local cubic fitted around the window's first sample gives
value and derivative; its half-width is the widest at which its residual still looks like the output's noise. What no
output measures is taken from one simulation of the whole episode, and may be off by more than it moves there: a
coordinate that rests stays where it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from capture_cli.sim.engine import Starts

HALF_WIDTHS = (4, 6, 9, 13, 19, 28, 40)  # samples on either side
ACCEPTABLE_RESIDUAL = 1.3  # variance of the local fit's residual over that of the noise
# The local fit uses samples that the window is fitted to as well, so it may not vote with its full weight twice.
PRIOR_INFLATION = 10.0
LAG_LEFT = 0.02  # of the correction for the integrator's lag: higher orders of the timestep
# Times the motion of an unmeasured coordinate in a simulated episode, which may be of another phase and another size
UNMEASURED_MOTION = 3.0
UNKNOWN_VELOCITY_SD = 10.0  # m/s or rad/s, where a position is measured but too seldom to be differentiated


@dataclass(frozen=True)
class StartEstimate:
    """Starts (one per window) and the standard deviation of each tangent coordinate, (window, state).

    The state is (positions (nv), velocities (nv), activations (na)); positions are in the tangent space, so that
    quaternions are moved by a rotation vector. reported: the motion that the sensors showed there; None where the
    starts come from elsewhere.
    """

    starts: Starts
    sd: np.ndarray
    reported: ReportedMotion | None = None

    def rows(self, keep) -> StartEstimate:
        """Those of the windows at `keep`."""
        reported = None if self.reported is None else self.reported.rows(keep)
        return StartEstimate(self.starts.rows(keep), self.sd[keep], reported)


@dataclass(frozen=True)
class ReportedMotion:
    """How the numbers of a log moved where its windows start, and which coordinates were read off them.

    jets (window, 3, column): value, slope and curvature, per s and s^2, of each column of sensordata; 0 where it is
    not an output. position, velocity: pairs (column, tangent coordinate) that each was taken from. lag: s, how long
    before the time of a state its velocity is that of its path. read (window,): False for starts that somebody knows,
    which no sensor has to be believed for.
    """

    jets: np.ndarray
    position: tuple[tuple[int, int], ...]
    velocity: tuple[tuple[int, int], ...]
    slope: tuple[tuple[int, int], ...]
    lag: float
    read: np.ndarray

    def rows(self, keep) -> ReportedMotion:
        """That of the windows at `keep`."""
        return replace(self, jets=self.jets[keep], read=self.read[keep])

    def start_change(self, true: np.ndarray, states: int) -> np.ndarray:
        """How far starts move, (simulation, state), where the jets (simulation, 3, column) were `true` in truth.

        Orientations are left as they were reported.
        """
        change = (true - self.jets) * self.read[:, None, None]
        offsets = np.zeros((len(change), states))
        for values, pairs in (
            (change[:, 0], (*self.position, *self.velocity)),
            (change[:, 1] - self.lag * change[:, 2], self.slope),
        ):
            for column, state in pairs:
                offsets[:, state] = values[:, column]
        return offsets


@dataclass(frozen=True)
class _Source:
    """Output columns that give some tangent coordinates: `kind` is position, velocity or orientation.

    data: where in sensordata they stand.
    """

    kind: str
    columns: tuple[int, ...]
    data: tuple[int, ...]
    dofs: tuple[int, ...]
    qpos: tuple[int, ...]


def estimate_starts(
    model: mujoco.MjModel,
    sensors: Sequence[int],
    *,
    time: np.ndarray,
    outputs: np.ndarray,
    episodes: Sequence[slice],
    window_first: np.ndarray,
    window_episode: np.ndarray,
    noise_sd: np.ndarray,
    unmeasured: StartEstimate | None = None,
) -> StartEstimate:
    """Initial state of every window.

    sensors (output,): the sensor of each output column, by id; a sensor of dimension n stands n times in a row.
    time (step,), outputs (step, output), noise_sd (output,). window_first, window_episode (window,).
    unmeasured: what is believed of coordinates that no output measures; the model's own start, fixed, where None.
    """
    count, nv = len(window_first), model.nv
    believed = unmeasured or model_starts(model, count)
    qpos, qvel, act = (a.copy() for a in (believed.starts.qpos, believed.starts.qvel, believed.starts.act))
    sd = believed.sd.copy()
    sources = _sources(model, sensors)
    lag = _velocity_lag(model)
    jets = np.zeros((count, 3, model.nsensordata))
    measured_velocity = {d for s in sources if s.kind == "velocity" for d in s.dofs}
    for w in range(count):
        steps = episodes[int(window_episode[w])]
        at = int(window_first[w])
        for source in sources:
            columns = list(source.columns)
            series = outputs[steps][:, columns]
            if source.kind == "orientation":
                rotation = _rotation_vectors(series, at - steps.start)
                fit = _local_fit(time[steps], rotation, at - steps.start, 2 * noise_sd[columns[:3]])
                mujoco.mju_copy(quat := np.empty(4), series[at - steps.start])
                mujoco.mju_normalize4(quat)
                mujoco.mju_quatIntegrate(quat, fit.value, 1.0)
                qpos[w, list(source.qpos)] = quat
            else:
                fit = _local_fit(time[steps], series, at - steps.start, noise_sd[columns])
                jets[w][:, list(source.data)] = fit.value, fit.slope, fit.curvature
                if source.kind == "position":
                    qpos[w, list(source.qpos)] = fit.value
            dofs = np.array(source.dofs)
            if source.kind == "velocity":
                qvel[w, dofs], sd[w, nv + dofs] = fit.value, PRIOR_INFLATION * fit.value_sd
                continue
            sd[w, dofs] = PRIOR_INFLATION * fit.value_sd
            new = np.array([d not in measured_velocity for d in source.dofs])
            change = lag * fit.curvature
            qvel[w, dofs[new]] = (fit.slope - change)[new]
            left = LAG_LEFT * (np.linalg.norm(change) if source.kind == "orientation" else change)
            sd[w, nv + dofs[new]] = PRIOR_INFLATION * np.hypot(fit.slope_sd, left)[new]
    starts = Starts(qpos, qvel, act, np.asarray(time)[window_first].astype(float))
    return StartEstimate(starts, sd, _reported(jets, sources, measured_velocity, nv, lag))


def _reported(
    jets, sources: list[_Source], measured_velocity: set[int], nv: int, lag: float
) -> ReportedMotion:
    pairs: dict[str, list[tuple[int, int]]] = {"position": [], "velocity": [], "orientation": [], "slope": []}
    for source in sources:
        for column, dof in zip(source.data, source.dofs, strict=False):
            pairs[source.kind].append((column, dof + nv if source.kind == "velocity" else dof))
            if source.kind == "position" and dof not in measured_velocity:
                pairs["slope"].append((column, dof + nv))
    return ReportedMotion(
        jets,
        tuple(pairs["position"]),
        tuple(pairs["velocity"]),
        tuple(pairs["slope"]),
        lag,
        np.ones(len(jets), dtype=bool),
    )


def shift(model: mujoco.MjModel, starts: Starts, offsets: np.ndarray) -> Starts:
    """Starts moved by tangent offsets (simulation, state), state as in StartEstimate."""
    nv = model.nv
    if model.nq == nv:
        qpos = starts.qpos + offsets[:, :nv]
    else:
        qpos = starts.qpos.copy()
        for row, step in zip(qpos, np.ascontiguousarray(offsets[:, :nv]), strict=True):
            mujoco.mj_integratePos(model, row, step, 1.0)
    return Starts(qpos, starts.qvel + offsets[:, nv : 2 * nv], starts.act + offsets[:, 2 * nv :], starts.time)


def model_starts(model: mujoco.MjModel, count: int) -> StartEstimate:
    """The model's own initial state (its first keyframe if it has one), `count` times, taken as known."""
    qpos = model.key_qpos[0] if model.nkey else model.qpos0
    qvel = model.key_qvel[0] if model.nkey else np.zeros(model.nv)
    act = model.key_act[0] if model.nkey else np.zeros(model.na)
    starts = Starts(*(np.repeat(a[None], count, axis=0) for a in (qpos, qvel, act)), np.zeros(count))
    return StartEstimate(starts, np.zeros((count, 2 * model.nv + model.na)))


def known_starts(model: mujoco.MjModel, sensors, starts: Starts, noise_sd: np.ndarray) -> StartEstimate:
    """Starts that somebody knows, but for positions that outputs measure: those are as good as a few of their samples.

    sensors, noise_sd (output,) as in `estimate_starts`.
    """
    sd = np.zeros((len(starts), 2 * model.nv + model.na))
    for source in _sources(model, sensors):
        if source.kind != "velocity":
            sd[:, list(source.dofs)] = PRIOR_INFLATION * noise_sd[list(source.columns)][: len(source.dofs)]
    return StartEstimate(starts, sd)


def with_known(read: StartEstimate, known: StartEstimate, which: np.ndarray) -> StartEstimate:
    """Starts that were read off a log, but those that are `known` at `which` (window,)."""
    rows = which[:, None]
    qpos, qvel, act = (
        np.where(rows, getattr(known.starts, name), getattr(read.starts, name))
        for name in ("qpos", "qvel", "act")
    )
    reported = None if read.reported is None else replace(read.reported, read=~which)
    return StartEstimate(
        Starts(qpos, qvel, act, read.starts.time), np.where(rows, known.sd, read.sd), reported
    )


def measures_every_coordinate(model: mujoco.MjModel, sensors: Sequence[int]) -> bool:
    """Whether every coordinate's position is among the outputs, and there are no activations."""
    dofs = {d for s in _sources(model, sensors) if s.kind != "velocity" for d in s.dofs}
    return len(dofs) == model.nv and model.na == 0


def from_episodes(model: mujoco.MjModel, qpos, qvel, *, window_episode, window_step) -> StartEstimate:
    """Starts of windows from simulations of whole episodes: qpos, qvel (episode, grid, ...), window_step (window,).

    The standard deviation of each coordinate is UNMEASURED_MOTION times that of its motion over the episode.
    Activations are 0.
    """
    count, nv = len(window_episode), model.nv
    starts = Starts(
        qpos[window_episode, window_step],
        qvel[window_episode, window_step],
        np.zeros((count, model.na)),
        np.zeros(count),
    )
    moved = np.zeros((len(qpos), qpos.shape[1], nv))
    for episode, path in enumerate(qpos):
        for step, position in enumerate(path):
            mujoco.mj_differentiatePos(model, moved[episode, step], 1.0, path[0], position)
    motion = UNMEASURED_MOTION * np.concatenate([moved.std(axis=1), qvel.std(axis=1)], axis=1)
    sd = np.concatenate([motion, np.ones((len(qpos), model.na))], axis=1)
    return StartEstimate(starts, sd[window_episode])


def _sources(model: mujoco.MjModel, sensors: Sequence[int]) -> list[_Source]:
    kind = mujoco.mjtSensor
    sources = []
    sensors = np.asarray(sensors)
    for sensor in dict.fromkeys(int(s) for s in sensors):
        columns = tuple(np.flatnonzero(sensors == sensor).tolist())
        what, which = int(model.sensor_type[sensor]), int(model.sensor_objid[sensor])
        first = int(model.sensor_adr[sensor])
        data = tuple(range(first, first + int(model.sensor_dim[sensor])))
        if what in (kind.mjSENS_JOINTPOS, kind.mjSENS_JOINTVEL):
            name = "position" if what == kind.mjSENS_JOINTPOS else "velocity"
            sources.append(
                _Source(
                    name, columns, data, (int(model.jnt_dofadr[which]),), (int(model.jnt_qposadr[which]),)
                )
            )
        elif what == kind.mjSENS_BALLQUAT:
            dof, adr = int(model.jnt_dofadr[which]), int(model.jnt_qposadr[which])
            sources.append(
                _Source("orientation", columns, data, tuple(range(dof, dof + 3)), tuple(range(adr, adr + 4)))
            )
        elif what in (kind.mjSENS_FRAMEPOS, kind.mjSENS_FRAMEQUAT) and _is_free_body_frame(model, sensor):
            joint = int(model.body_jntadr[which])
            dof, adr = int(model.jnt_dofadr[joint]), int(model.jnt_qposadr[joint])
            if what == kind.mjSENS_FRAMEPOS:
                sources.append(
                    _Source("position", columns, data, tuple(range(dof, dof + 3)), tuple(range(adr, adr + 3)))
                )
            else:
                dofs, adrs = tuple(range(dof + 3, dof + 6)), tuple(range(adr + 3, adr + 7))
                sources.append(_Source("orientation", columns, data, dofs, adrs))
    return [s for s in sources if len(s.columns) == len(s.qpos)]


def _is_free_body_frame(model: mujoco.MjModel, sensor: int) -> bool:
    """Whether a frame sensor reads, in world coordinates, the frame that a free joint moves."""
    body = int(model.sensor_objid[sensor])
    is_xbody = int(model.sensor_objtype[sensor]) == mujoco.mjtObj.mjOBJ_XBODY
    is_body = (
        int(model.sensor_objtype[sensor]) == mujoco.mjtObj.mjOBJ_BODY and model.body_sameframe[body] == 1
    )
    if not (is_xbody or is_body) or model.sensor_refid[sensor] >= 0 or model.body_jntnum[body] != 1:
        return False
    return int(model.jnt_type[model.body_jntadr[body]]) == mujoco.mjtJoint.mjJNT_FREE


def _velocity_lag(model: mujoco.MjModel) -> float:
    """How long before the time of a state its velocity is that of its path, s.

    The integrators but RK4 step x' = x + h v' with the new velocity: v is the path's slope half a step earlier.
    """
    return 0.0 if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4 else 0.5 * model.opt.timestep


def _rotation_vectors(quaternions: np.ndarray, at: int) -> np.ndarray:
    """Rotations (step, 3) from the orientation at step `at`, in that body's frame, rad."""
    inverse = quaternions[at] * np.array([1, -1, -1, -1]) / np.linalg.norm(quaternions[at])
    out = np.empty((len(quaternions), 3))
    relative = np.empty(4)
    for row, quaternion in zip(out, quaternions, strict=True):
        mujoco.mju_mulQuat(relative, inverse, quaternion / np.linalg.norm(quaternion))
        mujoco.mju_quat2Vel(row, relative, 1.0)
    return out


@dataclass
class _Fit:
    """A local polynomial at one step, (column,) each: value, slope, curvature, the sd of the first two."""

    value: np.ndarray
    slope: np.ndarray
    curvature: np.ndarray
    value_sd: np.ndarray
    slope_sd: np.ndarray

    def take(self, other: _Fit, which: np.ndarray) -> None:
        """Replace the columns `which` (column,) by those of `other`."""
        for name, values in vars(self).items():
            values[which] = getattr(other, name)[which]


def _local_fit(time: np.ndarray, series: np.ndarray, at: int, noise_sd: np.ndarray) -> _Fit:
    """A polynomial through `series` (step, column) around step `at`.

    A cubic over the widest half-width up to which its residual's variance stays near the noise's is taken, column by
    column; in the narrowest ones, of few samples, it may be off by chance. Where the curve stands out of the noise in
    all of them, a quintic over the narrowest is, and its sd is what it changes: the residual of a polynomial tells
    little of how wrong its derivative is.
    """
    columns = series.shape[1]
    best = _Fit(
        value=series[at].astype(float),
        slope=np.zeros(columns),
        curvature=np.zeros(columns),
        value_sd=np.array(noise_sd, dtype=float),
        slope_sd=np.full(columns, UNKNOWN_VELOCITY_SD),
    )
    narrowest = True
    begun, ended = np.zeros(columns, dtype=bool), np.zeros(columns, dtype=bool)
    for half in HALF_WIDTHS:
        a, b = max(0, at - half), min(len(time), at + half + 1)
        if b - a < 6 or ended.all():
            continue
        around = time[a:b] - time[at]
        cubic, variance = _polynomial(around, series[a:b], 3, noise_sd)
        # the residual's variance is itself uncertain: allow three of its standard deviations
        limit = ACCEPTABLE_RESIDUAL + 3 * np.sqrt(2 / (b - a - 4))
        like_noise = variance <= limit * np.square(noise_sd)
        ended |= begun & ~like_noise
        best.take(cubic, like_noise & ~ended)
        if narrowest:
            quintic, _ = _polynomial(around, series[a:b], min(5, b - a - 2), noise_sd)
            quintic.value_sd = np.hypot(quintic.value_sd, quintic.value - cubic.value)
            quintic.slope_sd = np.hypot(quintic.slope_sd, quintic.slope - cubic.slope)
            best.take(quintic, ~like_noise)
            narrowest = False
        begun |= like_noise
    return best


def _polynomial(time: np.ndarray, series: np.ndarray, degree: int, noise_sd: np.ndarray):
    """The least-squares polynomial through `series` (step, column) at time 0, and its residual's variance (column,)."""
    span = time[-1] - time[0]
    basis = np.vander(time / span, degree + 1, increasing=True)
    inverse = np.linalg.inv(basis.T @ basis)
    coefficients = inverse @ (basis.T @ series)
    variance = np.square(series - basis @ coefficients).sum(axis=0) / (len(time) - degree - 1)
    scatter = np.sqrt(np.maximum(variance, np.square(noise_sd)))
    fit = _Fit(
        value=coefficients[0],
        slope=coefficients[1] / span,
        curvature=2 * coefficients[2] / span**2,
        value_sd=scatter * np.sqrt(inverse[0, 0]),
        slope_sd=scatter * np.sqrt(inverse[1, 1]) / span,
    )
    return fit, variance
