"""A robot's hand that holds a tool of the plant, in a robosuite scene: bring it there, and fix it."""

import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np

from capture_cli.errors import OptionError

HAND_DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # fingers open along the y axis


class Unreachable(OptionError):
    """A robot that cannot take hold of its tool."""

    def __init__(self, message: str, *, cure: str = 'take robots="Panda", or driven_by="servos"'):
        super().__init__(message, cure=cure)


def grip(hand: str, tool: str) -> ElementTree.Element:
    """A weld of hand and tool, called "grip", stiffer than the arm's control by far."""
    return ElementTree.Element("weld", name="grip", body1=hand, body2=tool, active="false", solref="0.004 1")


def take_options(root: ElementTree.Element, plant: ElementTree.Element) -> None:
    option = root.find("option")
    option.attrib.clear()  # robosuite's contacts are elliptic, and its air resists
    option.attrib.update(plant.find("option").attrib)


def reach(model, data, site: int, goal: np.ndarray, joints, dofs) -> np.ndarray:
    """Joint positions at which `site` is at `goal` and the hand points down, by Gauss-Newton steps.

    Each step ends within the ranges of the joints. Raises Unreachable where the robot does not get there.
    """
    ids = model.dof_jntid[dofs]
    limits = np.where(model.jnt_limited[ids, None], model.jnt_range[ids], [-np.inf, np.inf]).T
    jacobian = np.zeros((6, model.nv))
    # m and rad
    ik_steps = 50
    ik_tolerance = 1e-10
    nearest = np.full(6, np.inf)
    for _ in range(ik_steps):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        turn = HAND_DOWN @ data.site_xmat[site].reshape(3, 3).T
        turn_vector = 0.5 * np.array(
            [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
        )
        error = np.concatenate([goal - data.site_xpos[site], turn_vector])
        if np.abs(error).max() < ik_tolerance:
            return data.qpos[joints].copy()
        nearest = min(nearest, error, key=np.linalg.norm)
        mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], site)
        step = np.linalg.lstsq(jacobian[:, dofs], error, rcond=None)[0]
        data.qpos[joints] = np.clip(data.qpos[joints] + step, *limits)
    raise Unreachable(
        "within the ranges of its joints the robot's hand, pointing down, does not reach the tool's handle: "
        f"at best it is {np.linalg.norm(nearest[:3]):.2g} m and {np.linalg.norm(nearest[3:]):.2g} rad away"
    )


def take_hold(robot, arm: str, model, data, handle: str, servos) -> None:
    """Move the robot's hand to the site `handle` and fix it there; the tool's own `servos` let go."""
    joints = robot._ref_joint_pos_indexes
    # the arm has a joint to spare: from the last episode's posture it would reach the handle in another one
    data.qpos[joints] = robot.robot_model.init_qpos
    goal = data.site(handle).xpos.copy()
    site, dofs = robot.eef_site_id[arm], robot._ref_joint_vel_indexes
    robot.init_qpos = reach(model, data, site, goal, joints, dofs)
    robot.reset(deterministic=True)  # its controllers take the new posture for their own
    data.qpos[joints] = robot.init_qpos
    mujoco.mj_forward(model, data)
    fix(model, data, model.equality("grip").id)
    model.actuator_gainprm[servos] = 0.0
    model.actuator_biasprm[servos] = 0.0


def fix(model, data, weld: int) -> None:
    """Make `weld` hold its two bodies as they are now."""
    hand, held = model.eq_obj1id[weld], model.eq_obj2id[weld]
    away, turn = np.empty(4), np.empty(4)
    mujoco.mju_negQuat(away, data.xquat[hand])
    mujoco.mju_mulQuat(turn, away, data.xquat[held])
    place = data.xmat[hand].reshape(3, 3).T @ (data.xpos[held] - data.xpos[hand])
    model.eq_data[weld, :11] = np.concatenate([np.zeros(3), place, turn, [1.0]])
    data.eq_active[weld] = 1
