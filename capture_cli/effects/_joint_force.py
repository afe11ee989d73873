"""What forces and frictions at a joint share: where a kernel's numbers come from, and what it adds to."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import numpy as np

from capture_cli.effects._joint_effect import JointEffect, raised
from capture_cli.effects._kernel import Companion, bound, call, inputs
from capture_cli.effects._places import reference
from capture_cli.sim.engine import World

FORCE, FRICTION, DAMPING = "qfrc_applied", "dof_frictionloss", "dof_damping"


class JointForce(JointEffect):
    """An effect that adds what `kernel` gives to the joint's force, dry friction or damping, `adds_to`.

    The kernel's inputs are named as the fields of MjData that they are, at the joint, or dof_damping. Friction and
    damping are those of the model, which MuJoCo integrates implicitly, and never fall below zero.
    """

    place = "force"
    kernel: ClassVar[Callable]
    adds_to: ClassVar[str] = FORCE

    def coefficients(self, values: np.ndarray) -> dict[str, np.ndarray]:
        """The kernel's coefficients, (simulation,) each, from `values` (simulation, parameter)."""
        return dict(zip(self.space.names, values.T, strict=True))

    def force(self, values, timestep):
        return ForceOfKernel(self, self.coefficients(values), timestep)

    def read(self, world: World, field: str) -> np.ndarray:
        """A field of MjData, or its damping, at the joint, (simulation,)."""
        if field == "time":
            return world.time
        if field == DAMPING:
            return world.vary(field)[:, self.dof]
        at = int(self.model.jnt_qposadr[self.joint]) if field == "qpos" else self.dof
        return getattr(world, field)[:, at]

    def add(self, world: World, term: np.ndarray) -> None:
        """Add `term` (simulation,)."""
        if self.adds_to == FORCE:
            world.qfrc_applied[:, self.dof] += term
            return
        own = world.vary(self.adds_to)
        own[:, self.dof] = raised(own[:, self.dof], term)

    def companion(self, name, values):
        reads = [
            {"time": "data.time", "qpos": "data.qpos[at]", DAMPING: f"model.{DAMPING}[dof]"}.get(
                field, f"data.{field}[dof]"
            )
            for field in inputs(self.kernel)
        ]
        numbers = {n: v[0] for n, v in self.coefficients(values[None]).items()}
        term, state = call(name, self.kernel, reads, numbers)
        joint = f"model.joint({reference(self.model, 'joint', self.site)})"
        lines = [f"dof = {joint}.dofadr"] + [f"at = {joint}.qposadr"] * ("data.qpos[at]" in reads)
        if self.adds_to == FORCE:
            lines.append(f"data.qfrc_applied[dof] += {term}")
            return Companion((self.kernel,), tuple(lines), state, ("data.qfrc_applied",))
        own = f"model.{self.adds_to}"
        lines += [f"change = {term}", f"{own}[dof] = raised({own}[dof], change)"]
        return Companion((self.kernel, raised), tuple(lines), state, (own,))


class ForceOfKernel:
    """A JointForce over a batch, chunk after chunk."""

    def __init__(self, effect: JointForce, coefficients: dict[str, np.ndarray], timestep: float):
        self.effect, self.coefficients, self.timestep = effect, coefficients, timestep
        self.reads = inputs(effect.kernel)
        self.world: World | None = None

    def __call__(self, world: World) -> None:
        if world is not self.world:  # another chunk begins, and with it another state
            own = {name: v[world.rows] for name, v in self.coefficients.items()}
            self.world, self.term = world, bound(self.effect.kernel, own, self.timestep)
        self.effect.add(world, self.term(*(self.effect.read(world, field) for field in self.reads)))
