"""The integral term of a position servo: a PID drive whose model has gains on position and speed alone."""

from dataclasses import fields
from functools import lru_cache

import mujoco
import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.log.turning_points import SETTINGS as TURNING_POINTS
from capture_cli.log.turning_points import WaysBefore
from capture_cli.model.effects._followed_force import Begins, FollowedForce
from capture_cli.model.effects._followed_log import measured_stretches
from capture_cli.model.effects._joint_force import ForceOfKernel
from capture_cli.model.effects._kernel import Companion, call
from capture_cli.model.effects._linear_actuators import OnJoint
from capture_cli.model.effects._places import source
from capture_cli.model.effects._scales import POSITION_ERROR, driven_joint
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.object_names import object_name
from capture_cli.model.parameters import Parameter
from capture_cli.model.world import World


@frozen
class SETTINGS:
    fastest: float = 10.0  # 1/s, of ki over kp: with more, a servo that is damped as usual swings by itself
    usual: float = 0.3  # s, for which an error lasts, of which no log says how long it did
    # s, of kp over ki: what takes longer to take up a load is hardly told from a constant force
    longest: float = 3.0
    tiny: float = 1e-12  # of ki: none holds nothing
    kept: int = 16  # integrals of a log's errors, the last ones: each gear that is tried has another
    least_limit: float = 1e-3  # of how far the integral of the error goes
    rounded: float = 1e-3  # of how far it commonly is from its mean: less is no way back


BIAS, GEAR = "actuator_biasprm", "actuator_gear"


class IntegralTerm:
    """The mean of ki z over a step, with dz/dt = set_point - length, and z stops at +-limit: anti-windup by
    clamping.

    set_point and length are held over the step. integral: z at the start.
    """

    def __init__(self, *, ki, limit, timestep, integral=0.0):
        self.ki, self.limit, self.timestep = ki, limit, timestep
        self.integral = integral + 0.0 * ki

    def __call__(self, set_point, length):
        before = self.integral
        self.move(self.timestep * (set_point - length))
        return self.ki * (before + self.integral) / 2

    def move(self, way):
        """Add the integral of an error (m s or rad s) of one sign."""
        self.integral = np.clip(self.integral + way, -self.limit, self.limit)


class ServoIntegral(OnJoint, FollowedForce):
    """The actuator gives `ki` z more than its gains on position and speed, within its forcerange together, with ki in
    N/(m s) or N m/(rad s) and z the integral of set point - length, m s or rad s, which stays within +- `limit`: the
    force within ki limit.

    The limit is one of z, not of the force, as what z does is then the same at every ki. z at the start of a window
    follows from set points and positions before, which the log has to have, and from what it was when the episode
    began, or went on after a gap, which nobody knows. A simulation that begins otherwise begins with none.
    """

    summary = "an integral term of a position servo, clamped against windup, that the model lacks"
    where = "every position servo of a hinge or slide joint whose position is measured"
    shapes = ("limit",)
    states = ("integral",)  # when the episode began, over what is common in it
    states_tried = np.linspace(-1, 1, 9)[:, None]  # at its limit it does not move with a small change
    states_scored = np.array([[0.0], [-1.0], [-0.5], [0.5], [1.0]])
    states_mean = (
        "`integral`: z, in m s or rad s, when the episode began. At 1 what z commonly changes in the log, or what "
        "holds the load on the joint where that is more, and `limit` where that is less"
    )
    kernel = IntegralTerm
    kernel_keeps = ("integral",)
    adds_to = BIAS

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.control = int(model.actuator_ctrladr[self.actuator])
        self.gear = float(model.actuator_gear[self.actuator, 0])
        self._clamps = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL
        self._kp = float(model.actuator_gainprm[self.actuator, 0])
        self._went = SETTINGS.usual * POSITION_ERROR  # m s or rad s: how far the integral of the error goes
        self._most = self._went  # where it may end

    @classmethod
    def sites(cls, model):
        return [object_name(model, "actuator", a) for a in range(model.nactuator) if _is_servo(model, a)]

    @property
    def parameters(self):
        return (
            Parameter("ki", self.unit("N/(m s)", "N m/(rad s)"), 0.0, SETTINGS.fastest * self._kp, 0.0),
            Parameter(
                "limit", self.unit("m s", "rad s"), SETTINGS.least_limit * self._went, self._most, self._most
            ),
        )

    def shape_grid(self, count=5):
        # of limits that do the same, as nothing reaches them, the first is taken: it is to be the highest
        return super().shape_grid(count)[::-1]

    def look_in(self, log):
        super().look_in(log)
        if self.shows:
            errors = self._integrated(self.model.opt.timestep, self.gear)
            parts = [errors[e] for e in self.seen.stretches]
            self._went = 2 * max(float(np.ptp(z)) for z in parts)  # it may have begun at either end
            self._most = max(self._went, self._holding(self._kp / SETTINGS.longest))
            self._common = float(np.std(np.concatenate([z - z.mean() for z in parts])))
            self._integrals = lru_cache(maxsize=SETTINGS.kept)(self._integrated_ways)

    @property
    def shows(self):
        return super().shows and self.actuator in self.seen.controls

    def force_since(self, given, timestep, begins):
        return ForceSinceBefore(self, given | vars(begins), timestep)

    def gears(self, world: World) -> np.ndarray:
        """(simulation,), which a parameter may have changed."""
        return world.vary(GEAR)[:, self.actuator, 0]

    def read(self, world, field):
        if field == "length":
            return self.gears(world) * super().read(world, "qpos")
        if field != "set_point":
            return super().read(world, field)
        control = world.ctrl[:, self.control]
        if not self._clamps:
            return control
        low, high = world.vary("actuator_ctrlrange")[:, self.actuator].T
        limited = world.vary("actuator_ctrllimited")[:, self.actuator]
        return np.where(limited, np.clip(control, low, high), control)

    def add(self, world, term):
        world.vary(BIAS)[:, self.actuator, 0] += term

    def companion(self, name, values):
        given = ["set_point", f"model.{GEAR}[servo, 0] * data.qpos[at]"]
        term, state = call(name, IntegralTerm, given, self.numbers(values))
        clamped = (
            "if model.actuator_ctrllimited[servo]:",
            "    set_point = np.clip(set_point, *model.actuator_ctrlrange[servo])",
        )
        lines = (
            f"servo = {source(self.model, 'actuator', self.site)}.id",
            f"at = {source(self.model, 'joint', self.joint_name)}.qposadr[0]",
            "set_point = data.ctrl[model.actuator_ctrladr[servo]]",
            *clamped * self._clamps,
            f"model.{BIAS}[servo, 0] += {term}",
        )
        return Companion((IntegralTerm,), lines, state, (f"model.{BIAS}",))

    def _integrated(self, timestep: float, gear: float, late: float = 0.0) -> np.ndarray:
        """The integral of the error from the start of each stretch of the log, (step,), m s or rad s, unclamped.

        As a simulation with that timestep sums it up, which holds positions over each step. late: s, after which the
        log shows a position.
        """
        seen, ctrl = self.seen, self.seen.controls[self.actuator]
        if self._clamps and self.model.actuator_ctrllimited[self.actuator]:
            ctrl = np.clip(ctrl, *self.model.actuator_ctrlrange[self.actuator])
        errors = np.zeros(len(seen.path))
        for steps, time, path in measured_stretches(seen.time, seen.path, seen.stretches):
            length = gear * path(time + late)
            ways = np.diff(time) * (ctrl[steps][:-1] - (length[1:] + length[:-1]) / 2)
            ways += timestep / 2 * np.diff(length)  # of a sum of values held, beyond the trapezoids
            errors[steps][1:] = np.cumsum(ways)
        return errors

    def _integrated_ways(self, timestep: float, gear: float, late: float) -> tuple[np.ndarray, WaysBefore]:
        """The integral of the error, (step,), and how it went to and fro before any step of the log."""
        errors = self._integrated(timestep, gear, late)
        return errors, WaysBefore(errors, self.seen.stretches, SETTINGS.rounded * self._common)

    def integral(
        self,
        *,
        ki: np.ndarray,
        limit: np.ndarray,
        begins: Begins,
        gears: np.ndarray,
        timestep: float,
    ) -> np.ndarray:
        """z (simulation,) where simulations begin, whose state is what it was at the start of the stretch of the log,
        over what is common, or what it takes to hold a load: it may have been held for long.
        """
        common = np.maximum(self._common, self._holding(np.maximum(ki, SETTINGS.tiny)))
        begin = np.clip(np.minimum(common, limit) * begins.states[:, 0], -limit, limit)
        term = IntegralTerm(ki=np.zeros(len(limit)), limit=limit, timestep=0.0, integral=begin)
        ways = np.zeros((len(limit), 1 + TURNING_POINTS.remembered))
        for gear, late in np.unique(np.stack([gears, begins.late], axis=1), axis=0).tolist():
            rows = (gears == gear) & (begins.late == late)
            ways[rows] = self._ways(begins.first[rows], timestep, gear, late)
        for way in ways.T:
            term.move(way)
        return term.integral

    def _holding(self, ki: np.ndarray | float) -> np.ndarray | float:
        """m s or rad s: the integral of the error that holds what the joint may have to."""
        return self.characteristic_force / (abs(self.gear) * ki)

    def _ways(self, first: np.ndarray, timestep: float, gear: float, late: float) -> np.ndarray:
        """The ways (simulation, way) that z, unclamped, grew and fell in turn from the start of the stretch to the
        steps `first` of the log; the rest is as for `_integrated`.
        """
        errors, ways_before = self._integrals(timestep, gear, late)
        ways = ways_before(first)
        before = errors[first] - ways.sum(axis=1)  # all that was before the ways that are remembered
        return np.column_stack([before, ways])


class ForceSinceBefore(ForceOfKernel):
    """The force of an integral term that has been at work in the log: it begins with what its gear made of that."""

    def own(self, world):
        own = super().own(world)
        begins = Begins(**{f.name: own.pop(f.name) for f in fields(Begins)})
        gears = self.effect.gears(world)
        own["integral"] = self.effect.integral(**own, begins=begins, gears=gears, timestep=self.timestep)
        return own


def _is_servo(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether the actuator, which has no state of its own, drives a joint with kp (control - length) - kv speed."""
    kp = model.actuator_gainprm[actuator, 0]
    return bool(
        driven_joint(model, actuator) >= 0
        and model.actuator_ctrlnum[actuator] == 1
        and model.actuator_actnum[actuator] == 0
        and model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE
        and kp == -model.actuator_biasprm[actuator, 1] > 0
        and model.actuator_gear[actuator, 0] != 0
    )
