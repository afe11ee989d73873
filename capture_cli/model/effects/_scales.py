"""How large an effect can sensibly be: characteristic forces, lengths and speeds, from the model alone.

They set ranges, not values. A range has to hold the truth and should not be wider by orders of magnitude.
"""

from functools import lru_cache

import mujoco
import numpy as np

from capture_cli.common.frozen import frozen

GRAVITY = 9.81  # m/s^2: friction comes with weight, also where the model, seen from above, has no gravity
POSITION_ERROR = 0.3  # rad or m: the position error at which a servo is taken to give all it has


@frozen
class SETTINGS:
    # rad a step, of the oscillation of what a joint moves on a spring that is simulated as a force
    stiffest: float = 0.5


TRUSTED_AUTHORITY = 10.0  # an actuator many times stronger than its load says nothing about friction
HINGE, SLIDE, FREE = (int(getattr(mujoco.mjtJoint, f"mjJNT_{kind}")) for kind in ("HINGE", "SLIDE", "FREE"))


def travel(model: mujoco.MjModel, joint: int) -> float:
    """Half the joint's range where it is limited, otherwise 1 m or 1 rad."""
    if not model.jnt_limited[joint]:
        return 1.0
    low, high = model.jnt_range[joint]
    return float(max(high - low, 1e-3) / 2)


def inertia(model: mujoco.MjModel, joint: int) -> float:
    """kg or kg m^2: what the joint moves, at qpos0."""
    return float(max(model.dof_M0[model.jnt_dofadr[joint]], 1e-9))


def free_inertia(model: mujoco.MjModel, joint: int) -> float:
    """kg or kg m^2: what a force on the joint accelerates while all other joints are free, at qpos0."""
    return 1 / float(max(model.dof_invweight0[model.jnt_dofadr[joint]], 1e-9))


def characteristic_force(model: mujoco.MjModel, joint: int) -> float:
    """N or N m: the larger of the weight that the joint carries and the force that its actuators can give."""
    weight = _weight(model, joint)
    return max(weight, min(_authority(model, joint), TRUSTED_AUTHORITY * weight))


def characteristic_speed(model: mujoco.MjModel, joint: int) -> float:
    """m/s or rad/s: what the characteristic force gives the joint over its travel."""
    force = characteristic_force(model, joint)
    return float(np.sqrt(2 * force * travel(model, joint) / inertia(model, joint)))


def control_scale(model: mujoco.MjModel, actuator: int) -> float:
    """In the unit of ctrl: how large a control is, from its range, its force range or what it drives."""
    if model.actuator_ctrllimited[actuator]:
        return float(np.abs(model.actuator_ctrlrange[actuator]).max())
    gain = abs(model.actuator_gainprm[actuator, 0])
    if model.actuator_biasprm[actuator, 1] != 0 or gain == 0:  # a position servo: ctrl is a position
        return 1.0
    if model.actuator_forcelimited[actuator]:
        return float(np.abs(model.actuator_forcerange[actuator]).max() / gain)
    joint = driven_joint(model, actuator)
    gear = abs(model.actuator_gear[actuator, 0])
    return _weight(model, joint) / (gain * gear) if joint >= 0 and gear > 0 else 1.0


def driven_joint(model: mujoco.MjModel, actuator: int) -> int:
    """The hinge or slide joint that an actuator drives, or -1."""
    kinds = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    joint = int(model.actuator_trnid[actuator, 0])
    if model.actuator_trntype[actuator] not in kinds or model.jnt_type[joint] not in (HINGE, SLIDE):
        return -1
    return joint


def driven_joints(model: mujoco.MjModel, *, by_tendons: bool = False) -> list[int]:
    """The hinge and slide joints that actuators drive directly, and, `by_tendons`, those that they pull by one."""
    kinds = [mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT]
    kinds += [mujoco.mjtTrn.mjTRN_TENDON] * by_tendons
    driven = _gears(model)[np.isin(model.actuator_trntype, [int(k) for k in kinds])].any(axis=0)
    joints = (j for j in range(model.njnt) if model.jnt_type[j] in (HINGE, SLIDE))
    return [j for j in joints if driven[model.jnt_dofadr[j]]]


def moving_bodies(model: mujoco.MjModel) -> list[int]:
    """Bodies with mass that some joint moves."""
    return [b for b in range(1, model.nbody) if model.body_weldid[b] != 0 and model.body_mass[b] > 0]


def box_edges(model: mujoco.MjModel, body: int) -> np.ndarray:
    """Edges (3,), m, of the uniform box with the body's mass and inertia, as MuJoCo's drag takes it."""
    x, y, z = model.body_inertia[body]
    edges = np.sqrt(np.maximum([y + z - x, x + z - y, x + y - z], 0) * 6 / model.body_mass[body])
    return np.maximum(edges, 1e-4)


def extent(model: mujoco.MjModel) -> float:
    """m: size of the whole scene."""
    return float(np.clip(model.stat.extent, 0.1, 10.0))


def _weight(model: mujoco.MjModel, joint: int) -> float:
    """N or N m: the weight of what the joint carries, on a hinge at its radius of gyration."""
    mass = max(float(model.body_subtreemass[model.jnt_bodyid[joint]]), 1e-9)
    return GRAVITY * float(np.sqrt(mass * inertia(model, joint)))


def _authority(model: mujoco.MjModel, joint: int) -> float:
    """N or N m: what the joint's actuators can give together; 0 where nothing says."""
    gears = _gears(model)[:, model.jnt_dofadr[joint]]
    total = sum(actuator_force(model, a, gears[a]) for a in np.flatnonzero(gears))
    if model.jnt_actfrclimited[joint]:
        total = min(total, float(np.abs(model.jnt_actfrcrange[joint]).max()))
    return total


@lru_cache(maxsize=16)
def _gears(model: mujoco.MjModel) -> np.ndarray:
    """Force on each degree of freedom by a unit of each actuator's, (actuator, dof), without sign, at qpos0."""
    data = mujoco.MjData(model)
    mujoco.mj_fwdPosition(model, data)
    moments = np.zeros((model.nactuator, model.nv))
    if model.nactuator:
        mujoco.mju_sparse2dense(
            moments, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
        )
    return np.abs(moments)


def actuator_force_unit(model: mujoco.MjModel, actuator: int) -> str:
    """Of the force of an actuator."""
    joint = driven_joint(model, actuator)
    if joint < 0:
        return "N or N m"
    return "N m" if model.jnt_type[joint] == HINGE else "N"


def actuator_force_scale(model: mujoco.MjModel, actuator: int) -> float:
    """N or N m: what the actuator can give; the weight of the machine where nothing says."""
    return actuator_force(model, actuator, 1.0) or GRAVITY * float(model.body_subtreemass[0])


def actuator_force(model: mujoco.MjModel, actuator: int, gear: float) -> float:
    """N or N m: what the actuator can give where a unit of its force gives `gear`; 0 where nothing says."""
    if model.actuator_forcelimited[actuator]:
        return gear * float(np.abs(model.actuator_forcerange[actuator]).max())
    if model.actuator_biasprm[actuator, 1] != 0:
        return gear**2 * abs(float(model.actuator_biasprm[actuator, 1])) * POSITION_ERROR
    if model.actuator_ctrllimited[actuator]:
        limit = float(np.abs(model.actuator_ctrlrange[actuator]).max())
        return gear * abs(float(model.actuator_gainprm[actuator, 0])) * limit
    return 0.0
