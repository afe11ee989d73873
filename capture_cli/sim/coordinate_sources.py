"""Which coordinates of a model the outputs of a log give: alone, mixed by gears and tendons, or as an attitude."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from capture_cli.sim.object_names import object_name

_S = mujoco.mjtSensor
_KINDS = {
    _S.mjSENS_ACTUATORPOS: "position",
    _S.mjSENS_TENDONPOS: "position",
    _S.mjSENS_ACTUATORVEL: "velocity",
    _S.mjSENS_TENDONVEL: "velocity",
}
_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
ROUNDING = 1e-9  # of a coordinate, that a sum of readings may be off by


@dataclass(frozen=True, eq=False)
class Source:
    """Output columns that give some tangent coordinates: `kind` is position, velocity or orientation.

    data: where in sensordata they stand. qpos: where the coordinates do; () of an angular velocity, which is the
    derivative of no number there. weights (dof, column): what the coordinates are of the columns; None where each is
    one of them, and for the four columns of an orientation.
    """

    kind: str
    columns: tuple[int, ...]
    data: tuple[int, ...]
    dofs: tuple[int, ...]
    qpos: tuple[int, ...]
    weights: np.ndarray | None = None

    def of(self, values: np.ndarray) -> np.ndarray:
        """What stands in qpos, (..., qpos), where the columns are `values` (..., column)."""
        return values if self.weights is None else values @ self.weights.T

    def noise(self, noise_sd: np.ndarray) -> np.ndarray:
        """The noise of each coordinate, (dof,), from that of all outputs, (output,).

        Of an orientation: of a rotation about each axis, half of which is in the four numbers together.
        """
        own = noise_sd[list(self.columns)]
        if self.kind == "orientation":
            return np.full(3, 2 * np.sqrt(np.square(own).sum() / 3))
        return own if self.weights is None else np.sqrt(np.square(self.weights) @ np.square(own))


def sources_of(model: mujoco.MjModel, sensors: Sequence[int]) -> list[Source]:
    """What the outputs give, whose sensors are `sensors` (output,); -1 of one that is not to be believed.

    A sensor of dimension n stands n times in a row.
    """
    alone = [s for s in _alone(model, np.asarray(sensors)) if len(s.columns) == len(s.data)]
    return alone + [
        s for kind in ("position", "velocity") for s in _unmixed(model, np.asarray(sensors), kind, alone)
    ]


def measures_every_coordinate(model: mujoco.MjModel, sensors: Sequence[int]) -> bool:
    """Whether every coordinate's position is among the outputs, and there are no activations."""
    return len(_positioned(model, sensors)) == model.nv and model.na == 0


def unmeasured_joints(model: mujoco.MjModel, sensors: Sequence[int]) -> list[str]:
    """Names of the joints whose position no output gives; "#3" is the fourth of those without a name."""
    dofs = _positioned(model, sensors)
    return [object_name(model, "joint", j) for j in range(model.njnt) if int(model.jnt_dofadr[j]) not in dofs]


def _positioned(model: mujoco.MjModel, sensors: Sequence[int]) -> set[int]:
    """Tangent coordinates whose position is among the outputs."""
    return {d for s in sources_of(model, sensors) if s.kind != "velocity" for d in s.dofs}


def _alone(model: mujoco.MjModel, sensors: np.ndarray) -> Iterator[Source]:
    """Sensors that each give coordinates of their own."""
    for sensor in dict.fromkeys(int(s) for s in sensors if s >= 0):
        columns = tuple(np.flatnonzero(sensors == sensor).tolist())
        what, which = int(model.sensor_type[sensor]), int(model.sensor_objid[sensor])
        first = int(model.sensor_adr[sensor])
        data = tuple(range(first, first + int(model.sensor_dim[sensor])))
        if what in (_S.mjSENS_JOINTPOS, _S.mjSENS_JOINTVEL):
            kind = "position" if what == _S.mjSENS_JOINTPOS else "velocity"
            dof, adr = int(model.jnt_dofadr[which]), int(model.jnt_qposadr[which])
            yield Source(kind, columns, data, (dof,), (adr,))
        elif what == _S.mjSENS_BALLQUAT:
            dof, adr = int(model.jnt_dofadr[which]), int(model.jnt_qposadr[which])
            yield Source("orientation", columns, data, tuple(range(dof, dof + 3)), tuple(range(adr, adr + 4)))
        elif what == _S.mjSENS_GYRO:
            turned = _turned_by(model, which)
            if turned is not None:
                yield Source("velocity", columns, data, turned[0], (), turned[1])
        elif what in (_S.mjSENS_FRAMEPOS, _S.mjSENS_FRAMEQUAT) and _is_free_body_frame(model, sensor):
            joint = int(model.body_jntadr[which])
            dof, adr = int(model.jnt_dofadr[joint]), int(model.jnt_qposadr[joint])
            if what == _S.mjSENS_FRAMEPOS:
                yield Source(
                    "position", columns, data, tuple(range(dof, dof + 3)), tuple(range(adr, adr + 3))
                )
            else:
                dofs, adrs = tuple(range(dof + 3, dof + 6)), tuple(range(adr + 3, adr + 7))
                yield Source("orientation", columns, data, dofs, adrs)


def _unmixed(
    model: mujoco.MjModel, sensors: np.ndarray, kind: str, alone: Sequence[Source]
) -> Iterator[Source]:
    """Coordinates that no sensor gives alone, from the positions of actuators and tendons, which are sums of some."""
    rows = {c: _sum(model, int(sensor)) for c, sensor in enumerate(sensors) if _kind(model, sensor) == kind}
    rows = {column: row for column, row in rows.items() if row is not None}
    if not rows:
        return
    sums = np.array(list(rows.values()))
    given = {s.dofs[0]: s.columns[0] for s in alone if s.kind == kind and len(s.dofs) == 1}
    wanted = [int(d) for d in np.flatnonzero(sums.any(axis=0)) if d not in given]
    inverse = np.linalg.pinv(sums[:, wanted])
    for number, dof in enumerate(wanted):
        share = np.where(np.abs(inverse[number]) > ROUNDING, inverse[number], 0.0)
        found = share @ sums
        if np.abs(found[wanted] - (np.array(wanted) == dof)).max() > ROUNDING:
            continue
        weights = dict(zip(rows, share, strict=True)) | {given[d]: -found[d] for d in given}
        used = [column for column, weight in weights.items() if weight]
        yield Source(
            kind,
            tuple(used),
            tuple(int(model.sensor_adr[sensors[column]]) for column in used),
            (dof,),
            (int(model.jnt_qposadr[model.dof_jntid[dof]]),),
            np.array([[weights[column] for column in used]]),
        )


def _kind(model: mujoco.MjModel, sensor: int) -> str:
    """Of a sensor of an actuator or of a tendon; "" of others."""
    return _KINDS.get(int(model.sensor_type[sensor]), "") if sensor >= 0 else ""


def _sum(model: mujoco.MjModel, sensor: int) -> np.ndarray | None:
    """What an actuator's or a tendon's position is of the coordinates, (nv,); None where it is no sum of them."""
    which = int(model.sensor_objid[sensor])
    if int(model.sensor_objtype[sensor]) == mujoco.mjtObj.mjOBJ_TENDON:
        return _tendon(model, which)
    gear, on = model.actuator_gear[which, 0], int(model.actuator_trnid[which, 0])
    transmission = int(model.actuator_trntype[which])
    if transmission == mujoco.mjtTrn.mjTRN_TENDON:
        row = _tendon(model, on)
        return None if row is None else gear * row
    if transmission in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT):
        return gear * _joint(model, on) if model.jnt_type[on] in _SCALAR else None
    return None


def _tendon(model: mujoco.MjModel, tendon: int) -> np.ndarray | None:
    """Of a fixed tendon."""
    path = range(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
    if any(model.wrap_type[k] != mujoco.mjtWrap.mjWRAP_JOINT for k in path):
        return None
    return sum(model.wrap_prm[k] * _joint(model, int(model.wrap_objid[k])) for k in path)


def _joint(model: mujoco.MjModel, joint: int) -> np.ndarray:
    return (np.arange(model.nv) == model.jnt_dofadr[joint]).astype(float)


def _turned_by(model: mujoco.MjModel, site: int) -> tuple[tuple[int, ...], np.ndarray] | None:
    """Of a site that a free or a ball joint turns, and nothing else: the coordinates of that turning, and the rotation
    (3, 3) from the site's frame to that of the joint's body, in which their velocities are given. None of others.
    """
    frame, body, turning = np.array(model.site_quat[site]), int(model.site_bodyid[site]), []
    while body:
        first = int(model.body_jntadr[body])
        joints = range(first, first + int(model.body_jntnum[body]))
        turning += [j for j in joints if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_SLIDE]
        if not turning:
            mujoco.mju_mulQuat(frame, model.body_quat[body], frame.copy())
        body = int(model.body_parentid[body])
    if len(turning) != 1 or model.jnt_type[turning[0]] == mujoco.mjtJoint.mjJNT_HINGE:
        return None
    is_free = bool(model.jnt_type[turning[0]] == mujoco.mjtJoint.mjJNT_FREE)
    dof = int(model.jnt_dofadr[turning[0]]) + 3 * is_free
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, frame)
    return (dof, dof + 1, dof + 2), rotation.reshape(3, 3)


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
