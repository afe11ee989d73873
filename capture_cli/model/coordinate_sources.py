"""Which coordinates of a model the outputs of a log give: alone, mixed by gears, tendons or slides, or an attitude."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.model.object_names import object_name

_S = mujoco.mjtSensor
_KINDS = {
    _S.mjSENS_ACTUATORPOS: "position",
    _S.mjSENS_TENDONPOS: "position",
    _S.mjSENS_FRAMEPOS: "position",
    _S.mjSENS_ACTUATORVEL: "velocity",
    _S.mjSENS_TENDONVEL: "velocity",
}
_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


@frozen
class SETTINGS:
    rounding: float = 1e-9  # of a coordinate, that a sum of readings may be off by


@dataclass(frozen=True, eq=False)
class Source:
    """Output columns that give some tangent coordinates: `kind` is position, velocity or orientation.

    data: where in sensordata they stand. qpos: where the coordinates do; () of an angular velocity, which is the
    derivative of no number there. weights (dof or number in qpos, column): what the coordinates are of the columns;
    None where each is one of them. constant (dof,): what is added to that.
    """

    kind: str
    columns: tuple[int, ...]
    data: tuple[int, ...]
    dofs: tuple[int, ...]
    qpos: tuple[int, ...]
    weights: np.ndarray | None = None
    constant: np.ndarray | float = 0.0

    def of(self, values: np.ndarray) -> np.ndarray:
        """What stands in qpos, (..., qpos), where the columns are `values` (..., column)."""
        return self.slope_of(values) + self.constant

    def slope_of(self, values: np.ndarray) -> np.ndarray:
        """Its derivative, where theirs are `values`."""
        return values if self.weights is None else values @ self.weights.T

    def shares(self, dof: int) -> np.ndarray:
        """How much of each column is in the coordinate `dof` of a scalar joint, (column,)."""
        number = self.dofs.index(dof)
        return np.eye(len(self.columns))[number] if self.weights is None else self.weights[number]

    def noise(self, noise_sd: np.ndarray) -> np.ndarray:
        """The noise of each coordinate, (dof,), from that of all outputs, (output,).

        Of an orientation: of a rotation about each axis, half of which is in the four numbers together.
        """
        own = noise_sd[list(self.columns)]
        if self.kind == "orientation":
            return np.full(3, 2 * np.sqrt(np.square(own).sum() / 3))
        return own if self.weights is None else np.sqrt(np.square(self.weights) @ np.square(own))


def sources_of(model: mujoco.MjModel, data: Sequence[int]) -> list[Source]:
    """What the outputs give. data (output,): which number of sensordata each is; -1 of one that is not believed."""
    data = np.asarray(data, dtype=int)
    every = list(_alone(model, data))
    turned = {dof for s in every if s.kind == "orientation" for dof in s.dofs}
    # of a rotation all three velocities are taken from one sensor
    alone = [s for s in every if not (_is_part_of_turn(model, s) and turned & {*s.dofs})]
    return alone + [s for kind in ("position", "velocity") for s in _unmixed(model, data, kind, alone)]


def measures_every_coordinate(model: mujoco.MjModel, data: Sequence[int]) -> bool:
    """Whether every coordinate's position is among the outputs, as of `sources_of`, and there are no activations."""
    return len(_positioned(model, data)) == model.nv and model.na == 0


def unmeasured_joints(model: mujoco.MjModel, data: Sequence[int]) -> list[str]:
    """Names of the joints whose position no output gives; "#3" is the fourth of those without a name."""
    dofs = _positioned(model, data)
    return [object_name(model, "joint", j) for j in range(model.njnt) if int(model.jnt_dofadr[j]) not in dofs]


def measured_states(model: mujoco.MjModel, data: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """What the outputs give of a state: places in qpos, and in qvel, those of positions' rates among them."""
    sources = sources_of(model, data)
    qpos = sorted({place for s in sources for place in s.qpos})
    return np.array(qpos, dtype=int), np.array(sorted({d for s in sources for d in s.dofs}), dtype=int)


def _positioned(model: mujoco.MjModel, data: Sequence[int]) -> set[int]:
    """Tangent coordinates whose position is among the outputs."""
    return {d for s in sources_of(model, data) if s.kind != "velocity" for d in s.dofs}


def _is_part_of_turn(model: mujoco.MjModel, source: Source) -> bool:
    """Whether a source gives some of a rotation's three velocities, and not the others."""
    of_scalar = model.jnt_type[model.dof_jntid[source.dofs[0]]] in _SCALAR
    return source.kind == "velocity" and not of_scalar and len(source.dofs) < 3


def _sensors(model: mujoco.MjModel, data: np.ndarray) -> np.ndarray:
    """The sensor of each of the numbers `data` (output,) of sensordata; -1 where that is -1."""
    of_each = np.repeat(np.arange(model.nsensor), model.sensor_dim)
    return np.where(data >= 0, of_each[data], -1)


def _alone(model: mujoco.MjModel, data: np.ndarray) -> Iterator[Source]:
    """Sensors that each give coordinates of their own, those of their numbers that are among `data`."""
    sensors = _sensors(model, data)
    for sensor in dict.fromkeys(int(s) for s in sensors if s >= 0):
        columns = tuple(np.flatnonzero(sensors == sensor).tolist())
        own = tuple(data[list(columns)].tolist())
        number = [d - int(model.sensor_adr[sensor]) for d in own]
        what, which = int(model.sensor_type[sensor]), int(model.sensor_objid[sensor])
        if what in (_S.mjSENS_JOINTPOS, _S.mjSENS_JOINTVEL):
            kind = "position" if what == _S.mjSENS_JOINTPOS else "velocity"
            dof, adr = int(model.jnt_dofadr[which]), int(model.jnt_qposadr[which])
            yield Source(kind, columns, own, (dof,), (adr,))
        elif what == _S.mjSENS_BALLQUAT:
            dof, adr = int(model.jnt_dofadr[which]), int(model.jnt_qposadr[which])
            yield Source("orientation", columns, own, tuple(range(dof, dof + 3)), tuple(range(adr, adr + 4)))
        elif what == _S.mjSENS_GYRO:
            turned = _turned_by(model, int(model.site_bodyid[which]), model.site_quat[which])
            if turned is None:
                continue
            weights = turned.of_velocity
            whole = np.abs(np.delete(weights, number, axis=1)).max(axis=1, initial=0.0) < SETTINGS.rounding
            if whole.any():
                dofs = tuple(np.array(turned.dofs)[whole].tolist())
                yield Source("velocity", columns, own, dofs, (), weights[whole][:, number])
        elif what == _S.mjSENS_FRAMEPOS and _is_free_body_frame(model, sensor):
            joint = int(model.body_jntadr[which])
            dof, adr = int(model.jnt_dofadr[joint]), int(model.jnt_qposadr[joint])
            yield Source(
                "position", columns, own, tuple(dof + n for n in number), tuple(adr + n for n in number)
            )
        elif what == _S.mjSENS_FRAMEQUAT and model.sensor_refid[sensor] < 0:
            body, _, orientation = _frame(model, sensor)
            turned = _turned_by(model, body, orientation)
            if turned is not None:
                yield Source("orientation", columns, own, turned.dofs, turned.qpos, turned.of_frame)


@dataclass(frozen=True, eq=False)
class _Sum:
    """What a number in sensordata is of the coordinates: coefficients (nv,), and a constant beside them."""

    coefficients: np.ndarray
    constant: float = 0.0


def _unmixed(model: mujoco.MjModel, data: np.ndarray, kind: str, alone: Sequence[Source]) -> Iterator[Source]:
    """Coordinates that no sensor gives alone, from the positions of actuators, tendons and frames, which are sums of
    some.
    """
    sensors = _sensors(model, data)
    every = {c: _sum(model, s, int(data[c])) for c, s in enumerate(sensors) if _kind(model, s) == kind}
    sums = {column: found for column, found in every.items() if found is not None}
    if not sums:
        return
    matrix = np.array([s.coefficients for s in sums.values()])
    constants = np.array([s.constant for s in sums.values()])
    given = {
        s.dofs[0]: s.columns[0] for s in alone if s.kind == kind and len(s.dofs) == 1 and s.weights is None
    }
    wanted = [int(d) for d in np.flatnonzero(matrix.any(axis=0)) if d not in given]
    inverse = np.linalg.pinv(matrix[:, wanted])
    for number, dof in enumerate(wanted):
        share = np.where(np.abs(inverse[number]) > SETTINGS.rounding, inverse[number], 0.0)
        found = share @ matrix
        if np.abs(found[wanted] - (np.array(wanted) == dof)).max() > SETTINGS.rounding:
            continue
        weights = dict(zip(sums, share, strict=True)) | {given[d]: -found[d] for d in given}
        used = [column for column, weight in weights.items() if weight]
        yield Source(
            kind,
            tuple(used),
            tuple(int(data[c]) for c in used),
            (dof,),
            (int(model.jnt_qposadr[model.dof_jntid[dof]]),),
            np.array([[weights[column] for column in used]]),
            np.array([-share @ constants]),
        )


def _kind(model: mujoco.MjModel, sensor: int) -> str:
    """Of a sensor of an actuator, a tendon or a frame; "" of others."""
    return _KINDS.get(int(model.sensor_type[sensor]), "") if sensor >= 0 else ""


def _sum(model: mujoco.MjModel, sensor: int, number: int) -> _Sum | None:
    """What a number of sensordata, of a sensor of `_kind`, is of the coordinates; None where it is no sum of them."""
    which = int(model.sensor_objid[sensor])
    if int(model.sensor_type[sensor]) == _S.mjSENS_FRAMEPOS:
        return _along_slides(model, sensor, number - int(model.sensor_adr[sensor]))
    if int(model.sensor_objtype[sensor]) == mujoco.mjtObj.mjOBJ_TENDON:
        row = _tendon(model, which)
        return None if row is None else _Sum(row)
    gear, on = model.actuator_gear[which, 0], int(model.actuator_trnid[which, 0])
    transmission = int(model.actuator_trntype[which])
    if transmission == mujoco.mjtTrn.mjTRN_TENDON:
        row = _tendon(model, on)
        return None if row is None else _Sum(gear * row)
    if transmission in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT):
        return _Sum(gear * _joint(model, on)) if model.jnt_type[on] in _SCALAR else None
    return None


def _along_slides(model: mujoco.MjModel, sensor: int, axis: int) -> _Sum | None:
    """Of a frame's position in the world along an `axis`; None where more than slides moves it, or turns them."""
    if model.sensor_refid[sensor] >= 0:
        return None
    body, position, _ = _frame(model, sensor)
    slides = _slides_alone(model, body, position)
    if not slides:
        return None
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    coefficients = np.zeros(model.nv)
    coefficients[model.jnt_dofadr[slides]] = data.xaxis[slides, axis]
    here = data.xpos[body, axis] + data.xmat[body].reshape(3, 3)[axis] @ position
    begin = model.qpos0[model.jnt_qposadr[slides]] @ data.xaxis[slides, axis]
    return _Sum(coefficients, float(here - begin))


def _slides_alone(model: mujoco.MjModel, body: int, position: np.ndarray) -> list[int]:
    """The slides that move a point of `body`, at `position` in its frame; [] where more does, or turns them."""
    slides: list[int] = []
    own = body
    while body:
        first = int(model.body_jntadr[body])
        for joint in reversed(range(first, first + int(model.body_jntnum[body]))):
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
                slides.append(joint)
                continue
            about_the_point = body == own and np.array_equal(model.jnt_pos[joint], position)
            free = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
            if free or slides or not about_the_point:
                return []
        body = int(model.body_parentid[body])
    return slides


def _tendon(model: mujoco.MjModel, tendon: int) -> np.ndarray | None:
    """Of a fixed tendon."""
    path = range(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
    if any(model.wrap_type[k] != mujoco.mjtWrap.mjWRAP_JOINT for k in path):
        return None
    return sum(model.wrap_prm[k] * _joint(model, int(model.wrap_objid[k])) for k in path)


def _joint(model: mujoco.MjModel, joint: int) -> np.ndarray:
    return (np.arange(model.nv) == model.jnt_dofadr[joint]).astype(float)


@dataclass(frozen=True, eq=False)
class _Turning:
    """The one free or ball joint that turns a frame: where its orientation stands in qpos and its velocity in qvel.

    The frame's orientation in the world is before * (that in qpos) * after, quaternions all, (4,).
    """

    dofs: tuple[int, ...]
    qpos: tuple[int, ...]
    before: np.ndarray
    after: np.ndarray

    @property
    def of_frame(self) -> np.ndarray | None:
        """(4, 4): the orientation in qpos is so much of each number of the frame's; None where it is the frame's."""
        columns = [
            _product(_inverse(self.before), _product(unit, _inverse(self.after))) for unit in np.eye(4)
        ]
        weights = np.stack(columns, axis=1)
        return None if np.array_equal(weights, np.eye(4)) else weights

    @property
    def of_velocity(self) -> np.ndarray:
        """(3, 3): velocities are given in the frame of the joint's body, and a gyroscope's in its own."""
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, self.after)
        return rotation.reshape(3, 3)


def _turned_by(model: mujoco.MjModel, body: int, frame: np.ndarray) -> _Turning | None:
    """What turns `frame`, a quaternion (4,) within `body`; None where it is not one free or ball joint alone."""
    before, after, turning = np.array([1.0, 0, 0, 0]), np.array(frame), []
    while body:
        first = int(model.body_jntadr[body])
        joints = range(first, first + int(model.body_jntnum[body]))
        turning += [j for j in joints if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_SLIDE]
        if not turning:
            after = _product(model.body_quat[body], after)
        elif model.jnt_type[turning[0]] != mujoco.mjtJoint.mjJNT_FREE:  # whose orientation is the body's own
            before = _product(model.body_quat[body], before)
        body = int(model.body_parentid[body])
    if len(turning) != 1 or model.jnt_type[turning[0]] == mujoco.mjtJoint.mjJNT_HINGE:
        return None
    is_free = bool(model.jnt_type[turning[0]] == mujoco.mjtJoint.mjJNT_FREE)
    dof = int(model.jnt_dofadr[turning[0]]) + 3 * is_free
    adr = int(model.jnt_qposadr[turning[0]]) + 3 * is_free
    return _Turning(tuple(range(dof, dof + 3)), tuple(range(adr, adr + 4)), before, after)


def _frame(model: mujoco.MjModel, sensor: int) -> tuple[int, np.ndarray, np.ndarray]:
    """The body of the frame that a sensor reads, and in that body's own its position (3,) and orientation (4,)."""
    which, kind = int(model.sensor_objid[sensor]), int(model.sensor_objtype[sensor])
    obj = mujoco.mjtObj
    if kind == obj.mjOBJ_XBODY:
        return which, np.zeros(3), np.array([1.0, 0, 0, 0])
    if kind == obj.mjOBJ_BODY:
        return which, model.body_ipos[which], model.body_iquat[which]
    bodies, positions, orientations = {
        obj.mjOBJ_GEOM: (model.geom_bodyid, model.geom_pos, model.geom_quat),
        obj.mjOBJ_SITE: (model.site_bodyid, model.site_pos, model.site_quat),
        obj.mjOBJ_CAMERA: (model.cam_bodyid, model.cam_pos, model.cam_quat),
    }[obj(kind)]
    return int(bodies[which]), positions[which], orientations[which]


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    product = np.zeros(4)
    mujoco.mju_mulQuat(product, a, b)
    return product


def _inverse(quaternion: np.ndarray) -> np.ndarray:
    return quaternion * [1, -1, -1, -1]


def _is_free_body_frame(model: mujoco.MjModel, sensor: int) -> bool:
    """Whether a sensor of position reads, in world coordinates, the frame that a free joint moves."""
    body = int(model.sensor_objid[sensor])
    is_xbody = int(model.sensor_objtype[sensor]) == mujoco.mjtObj.mjOBJ_XBODY
    is_body = (
        int(model.sensor_objtype[sensor]) == mujoco.mjtObj.mjOBJ_BODY and model.body_sameframe[body] == 1
    )
    if not (is_xbody or is_body) or model.sensor_refid[sensor] >= 0 or model.body_jntnum[body] != 1:
        return False
    return int(model.jnt_type[model.body_jntadr[body]]) == mujoco.mjtJoint.mjJNT_FREE
