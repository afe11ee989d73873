"""A rotor near the floor lifts more than one high above it."""

import mujoco
import numpy as np

from capture_cli.model.effects._kernel import Companion, call
from capture_cli.model.effects._places import ids_source
from capture_cli.model.effects._scales import box_edges
from capture_cli.model.effects.base import GLOBAL, Effect
from capture_cli.model.parameters import Parameter
from capture_cli.model.world import World

MOST = 0.5  # of R / (4 z): nearer to the floor than half a radius nobody measured the law, and it has a pole
TOUCHING = 1e-9  # m
STEEPEST = np.cos(np.pi / 4)  # of a floor, its normal along what is up
FIXED, AFFINE = int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE)
NO_BIAS, AFFINE_BIAS = int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE)


def lift_near_floor(rotors, floors, normals, *, radius):
    """Thrust over that far from any floor, at the same drive, (..., rotor).

    rotors (..., rotor, 3): where they are; floors, normals (..., floor, 3): points of planes, and what is up there. The
    nearest floor below a rotor counts; one that is below all of them is as one that touches.
    """
    away = rotors[..., :, None, :] - floors[..., None, :, :]
    heights = (away * normals[..., None, :, :]).sum(axis=-1)
    height = np.where(heights >= 0, heights, np.inf).min(axis=-1)
    height = np.where(np.isfinite(height), np.maximum(height, TOUCHING), TOUCHING)
    return 1 / (1 - np.minimum(radius / (4 * height), MOST) ** 2)


class GroundEffect(Effect):
    """A rotor at the height z over a floor pushes 1 / (1 - (`radius` / (4 z))^2) times as hard as the model's at the
    same drive. Below z = `radius` / 2 the factor stays the 4/3 that it is there: the law is not valid lower down, where
    it has a pole.

    It is that of Cheeseman and Bennett, "The effect of the ground on a helicopter rotor in forward flight" (1955).
    `radius` (m) is one for all rotors, and that of a rotor by itself: several close together act like a larger one. z
    is the distance of the actuator's site from the nearest plane below it, along the plane's normal, in the step
    before. The forces in the actuator's gear are scaled, behind its filter and its limits; the torques there, the
    reaction to what turns the rotor, are as they were.
    """

    place = "force"
    summary = "rotors that lift more near the floor"
    has_threshold = True  # it grows with the square of the radius
    where = (
        "the model as a whole, where actuators at sites push with a force that does not depend on how fast they are, "
        "over a plane that is fixed and no steeper than 45 degrees"
    )

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.rotors, self.floors = _rotors(model), _floors(model)
        self.at = model.actuator_trnid[self.rotors, 0]  # sites
        # radius: of the machine's size; and m, for a machine of any size
        largest = 2.0
        smallest = 0.01
        self.largest = max(largest * max(_size(model, rotor) for rotor in self.at), smallest)

    @classmethod
    def sites(cls, model):
        return [GLOBAL] if _rotors(model) and _floors(model) else []

    @property
    def parameters(self):
        return (Parameter("radius", "m", 0.0, self.largest, 0.0),)

    def force(self, values, timestep, **_):
        def on_rotors(world: World) -> None:
            floors, frames = world.geom_xpos[:, self.floors], world.geom_xmat[:, self.floors]
            normals = frames.reshape(*floors.shape, 3)[..., 2]
            rotors = world.site_xpos[:, self.at]
            lift = lift_near_floor(rotors, floors, normals, radius=values[world.rows])
            # of what derives from gears only muscles read anything; a force from outside would be a step behind
            world.vary("actuator_gear")[:, self.rotors, :3] *= lift[..., None]

        return on_rotors

    def companion(self, name, values):
        given = ["data.site_xpos[sites]", "data.geom_xpos[floors]", "normals"]
        lift, _ = call(name, lift_near_floor, given, {"radius": values[0]})
        lines = (
            f"rotors = {ids_source(self.model, 'actuator', self.rotors)}",
            f"floors = {ids_source(self.model, 'geom', self.floors)}",
            "sites = model.actuator_trnid[rotors, 0]",
            "normals = data.geom_xmat[floors].reshape(-1, 3, 3)[..., 2]",
            f"lift = {lift}",
            "model.actuator_gear[rotors, :3] *= lift[:, None]",
        )
        return Companion((lift_near_floor,), lines, changes=("model.actuator_gear",))


def _rotors(model: mujoco.MjModel) -> list[int]:
    """Actuators that push what moves with a force at a site, the same one however fast that is.

    Of one that brakes, or has an inertia, gear says as well how fast it is.
    """
    at_site = model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_SITE)
    pushes = model.actuator_gear[:, :3].any(axis=1)
    gain, bias = model.actuator_gaintype, model.actuator_biastype
    steady_gain = (gain == FIXED) | ((gain == AFFINE) & (model.actuator_gainprm[:, 2] == 0))
    steady_bias = (bias == NO_BIAS) | ((bias == AFFINE_BIAS) & (model.actuator_biasprm[:, 2] == 0))
    brakes = (model.actuator_damping != 0) | model.actuator_dampingpoly.any(axis=1)
    steady = steady_gain & steady_bias & ~brakes & (model.actuator_armature == 0)
    fit = np.flatnonzero(at_site & pushes & steady)
    return [int(a) for a in fit if _moves_by_itself(model, *model.actuator_trnid[a])]


def _moves_by_itself(model: mujoco.MjModel, site: int, against: int) -> bool:
    """Whether the site moves, and what acts there acts against nothing else in the model."""
    return against < 0 and model.body_weldid[model.site_bodyid[site]] != 0


def _floors(model: mujoco.MjModel) -> list[int]:
    """Planes that are fixed and that something could lie on."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    gravity = np.linalg.norm(model.opt.gravity)
    up = -model.opt.gravity / gravity if gravity > 0 else np.array([0.0, 0.0, 1.0])
    planes = model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)
    fixed = model.body_weldid[model.geom_bodyid] == 0
    level = data.geom_xmat.reshape(-1, 3, 3)[..., 2] @ up > STEEPEST
    return [int(g) for g in np.flatnonzero(planes & fixed & level)]


def _size(model: mujoco.MjModel, site: int) -> float:
    """m: how far the rotor at `site` is from the middle of its machine, or how long its main body is if longer."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    root = model.body_rootid[model.site_bodyid[site]]
    main = int(np.argmax(np.where(model.body_rootid == root, model.body_mass, 0.0)))
    arm = float(np.linalg.norm(data.site_xpos[site] - data.subtree_com[root]))
    return max(arm, float(box_edges(model, main).max()))
