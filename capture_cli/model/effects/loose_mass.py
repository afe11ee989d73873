"""Something inside that is not fixed: a liquid that sloshes, a load that swings, a part on soft mounts."""

import numpy as np

from capture_cli.model.effects._joint_force import INERTIA, JointForce, gives_way, inertia_felt
from capture_cli.model.effects._kernel import Companion, call
from capture_cli.model.effects._places import source
from capture_cli.model.effects._scales import characteristic_force, free_inertia
from capture_cli.model.effects._two_mass import MOST_SHARE
from capture_cli.model.effects._vibration import ForceShakenBefore, Shaken, Vibration, VibrationEffect
from capture_cli.model.parameters import Parameter

RIGID = ("dof_armature", "dof_M0")  # MuJoCo takes the inertia of a joint that turns one free body from dof_M0


class Oscillator(Vibration):
    """The force -m d'' on a joint, of whose inertia M the part m hangs on a spring and is d ahead of the rest.

    The model carries all of M rigidly. With a the joint's acceleration and F what the model knows of, M a = F - m d''
    and d'' = -(a + p) / R, so (M - m / R) a = F + m p / R: MuJoCo solves for the acceleration of the step, which the
    next knows from the speeds.
    """

    def __init__(self, *, mass, timestep, **rest):
        super().__init__(timestep=timestep, **rest)
        self.mass = mass
        self.speed, self.taken = None, 0.0 * mass  # the joint's speed, and m / R, of the step before

    def __call__(self, qvel, inertia):
        """The force m p / R, and the inertia m / R that is not rigid. inertia: of the step before, without that."""
        if self.speed is not None:
            self.move((qvel - self.speed) / self.timestep)
        self.speed = np.array(qvel)
        self.taken = np.minimum(self.mass, MOST_SHARE * (inertia + self.taken)) / self.resists
        return self.taken * self.pulled(), self.taken


class ForceOfLooseMass(ForceShakenBefore):
    """The force of a loose mass, and the joint's inertia without it, over a batch, chunk after chunk."""

    def __call__(self, world):
        effect, loose = self.effect, self.kernel_in(world)
        force, taken = loose(effect.read(world, "qvel"), effect.read(world, INERTIA))
        effect.add(world, force)
        for field in RIGID:
            world.vary(field)[:, effect.dof] -= taken


class LooseMass(VibrationEffect, JointForce):
    """Of what the joint moves, `mass` (kg or kg m^2) hangs on a spring along it: it swings at `frequency` (Hz) where
    the joint is held, and `damping_ratio` is of the critical damping.

    The declared inertia holds it: with nothing loose, all of it is rigid.
    """

    summary = "something inside that is not fixed: a liquid that sloshes, a load that swings"
    kernel = Oscillator
    kernel_keeps = ("displaced", "rate", "speed")

    @property
    def total(self) -> float:
        """kg or kg m^2: what a force on the joint accelerates."""
        return free_inertia(self.model, self.joint)

    @property
    def parameters(self):
        most = 0.8  # of what the joint moves
        return (
            Parameter("mass", self.unit("kg", "kg m^2"), 0.0, most * self.total, 0.0),
            *self.swinging,
        )

    def shaken_in(self, log):
        seen = log.seen.get(self.joint)
        if seen is None:
            return None
        path, begun = seen.path[:, None], seen.begun[:, None]
        return Shaken(seen.time, path, np.ones(1), seen.stretches, seen.noise, begun, seen.begun_sd)

    def shaking(self, world):
        return self.read(world, "qpos"), self.read(world, "qvel")

    def force(self, values, timestep, *, states=None, first=None, late=None, **_):
        push = characteristic_force(self.model, self.joint) / self.total
        shown = self.shown_at(first, None if late is None else late[:, self.dof])
        begins = self.begins(values, states, push, timestep=timestep, shown=shown)
        return ForceOfLooseMass(self, self.coefficients(values) | begins, timestep)

    def companion(self, name, values):
        given = ["data.qvel[dof]", "inertia_felt(model, data.qLD, data.qLDiagInv, int(dof[0]))"]
        term, state = call(name, Oscillator, given, self.numbers(values))
        lines = [f"dof = {source(self.model, 'joint', self.joint_name)}.dofadr", f"force, taken = {term}"]
        lines += ["data.qfrc_applied[dof] += force", *(f"model.{field}[dof] -= taken" for field in RIGID)]
        changes = ("data.qfrc_applied", *(f"model.{field}" for field in RIGID))
        return Companion((Oscillator, gives_way, inertia_felt), tuple(lines), state, changes)
