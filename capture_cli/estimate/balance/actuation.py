"""What actuators give at points of a motion, where other controls reach them or other numbers are theirs.

Neither moves what they act on: lengths, speeds and moment arms are those of the motion, and MuJoCo has worked them out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import batch

from capture_cli.common.frozen import frozen

# fields of MjModel, (actuator, ...), whose change is worked out here
NUMBERS = ("actuator_gainprm", "actuator_biasprm", "actuator_forcelimited", "actuator_forcerange")
_READ = (
    "ctrl",
    "actuator_length",
    "actuator_velocity",
    "actuator_force",
    "qfrc_actuator",
    "actuator_moment",
    "moment_rownnz",
    "moment_rowadr",
    "moment_colind",
)
_AFFINE_GAIN, _AFFINE_BIAS = int(mujoco.mjtGain.mjGAIN_AFFINE), int(mujoco.mjtBias.mjBIAS_AFFINE)
_GAINS = int(mujoco.mjtGain.mjGAIN_FIXED), _AFFINE_GAIN
_BIASES = int(mujoco.mjtBias.mjBIAS_NONE), _AFFINE_BIAS


@frozen
class SETTINGS:
    rounding: float = 1e-9  # of the largest force, by which what is worked out here may differ from MuJoCo's


@dataclass(frozen=True)
class Actuation:
    """linear (actuator,): whose force follows from control, length and speed, (point, actuator) each. force (point,
    actuator): what they give; moment (point, actuator, nv): of a unit of it; joints (point, nv): what all of that is
    before joints limit it.
    """

    model: mujoco.MjModel
    linear: np.ndarray
    length: np.ndarray
    speed: np.ndarray
    force: np.ndarray
    moment: np.ndarray
    joints: np.ndarray

    @classmethod
    def of(cls, model: mujoco.MjModel, runner: batch.Batch, forward: Callable[[], None]) -> Actuation | None:
        """Of simulations whose forces MuJoCo works out by `forward`; None where it does more than is known here."""
        if not model.nu or not _is_known(model):
            forward()
            return None
        live = {name: runner.bind(name) for name in _READ}  # filled by what follows
        forward()
        controls, length, speed, force, joints = (live[name].copy() for name in _READ[:5])
        linear = np.isin(model.actuator_gaintype, _GAINS) & np.isin(model.actuator_biastype, _BIASES)
        moment = _moments(model, *(live[name] for name in _READ[5:]))
        free = np.einsum("pan,pa->pn", moment, force)
        found = cls(model, linear, length, speed, force, moment, free)
        same = _is_same(found.given(controls), force) and _is_same(found._limited(free), joints)
        return found if same else None

    def given(
        self,
        controls: np.ndarray,
        numbers: Mapping[str, np.ndarray] | None = None,
        here: np.ndarray | slice = slice(None),
    ) -> np.ndarray:
        """Forces (lane, actuator) at the points `here` under other controls (lane, nu), or with other `numbers` (lane,
        actuator, ...) of `NUMBERS` than the model has. What is not linear gives what it did.
        """
        model, own = self.model, dict(numbers or {})
        gain, bias, limited, bounds = (own.get(name, getattr(model, name)) for name in NUMBERS)
        length, speed = self.length[here], self.speed[here]
        if not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL:
            low, high = np.where(
                np.asarray(model.actuator_ctrllimited, dtype=bool)[:, None],
                model.actuator_ctrlrange,
                [-np.inf, np.inf],
            ).T
            controls = np.clip(controls, low, high)
        force = controls * _affine(gain, model.actuator_gaintype == _AFFINE_GAIN, length, speed)
        biased = model.actuator_biastype == _AFFINE_BIAS
        force += np.where(biased, _affine(bias, biased, length, speed), 0.0)
        force = np.where(limited, np.clip(force, bounds[..., 0], bounds[..., 1]), force)
        return np.where(self.linear, force, self.force[here])

    def follows(self, numbers: Mapping[str, np.ndarray]) -> bool:
        """Whether these are numbers of linear actuators alone, (lane, actuator, ...) each."""
        others = ~self.linear
        return all((v[:, others] == getattr(self.model, n)[others]).all() for n, v in numbers.items())

    def changed(self, force: np.ndarray, here: np.ndarray | slice = slice(None)) -> np.ndarray:
        """By how much more than before joints are driven, (lane, nv), by forces (lane, actuator) at the points."""
        more = force - self.force[here]
        found = np.zeros((len(more), self.model.nv))
        for actuator in np.flatnonzero(more.any(axis=0)):
            found += self.moment[here, actuator] * more[:, actuator, None]
        if not self.model.jnt_actfrclimited.any():
            return found
        before = self.joints[here]
        return self._limited(before + found) - self._limited(before)

    def _limited(self, joints: np.ndarray) -> np.ndarray:
        """What joints take of that (lane, nv)."""
        model, found = self.model, joints.copy()
        for joint in np.flatnonzero(model.jnt_actfrclimited):
            dof = model.jnt_dofadr[joint]
            found[:, dof] = np.clip(found[:, dof], *model.jnt_actfrcrange[joint])
        return found


def _affine(numbers: np.ndarray, affine: np.ndarray, length: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """(lane, actuator) of parameters (..., actuator, number): the first, and where it is affine all three."""
    first, by_length, by_speed = (numbers[..., k] for k in range(3))
    return first + np.where(affine, by_length * length + by_speed * speed, 0.0)


def _is_known(model: mujoco.MjModel) -> bool:
    """Whether each actuator has one control and one force, at once, and nothing but joints limits what they add to."""
    single = (model.actuator_ctrlnum == 1).all() and (model.actuator_outnum == 1).all()
    plain = not (
        model.actuator_actnum.any() or model.actuator_delay.any() or (model.actuator_plugin >= 0).any()
    )
    elsewhere = model.jnt_actgravcomp.any() or model.tendon_actfrclimited.any()
    off = model.opt.disableactuator or model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_ACTUATION
    return bool(model.nu == model.nactuator and single and plain and not elsewhere and not off)


def _moments(model: mujoco.MjModel, packed, count, first, column) -> np.ndarray:
    """(point, actuator, nv), from the rows that MuJoCo packs."""
    found = np.zeros((len(packed), model.nactuator, model.nv))
    for actuator in range(model.nactuator):
        for k in range(int(count[:, actuator].max())):
            points = np.flatnonzero(k < count[:, actuator])
            at = first[points, actuator] + k
            found[points, actuator, column[points, at]] = packed[points, at]
    return found


def _is_same(one: np.ndarray, other: np.ndarray) -> bool:
    return bool(np.allclose(one, other, rtol=0.0, atol=SETTINGS.rounding * np.abs(other).max(initial=1.0)))
