"""What forces and frictions at a joint share: where a kernel's numbers come from, and what it adds to."""

from collections.abc import Callable
from operator import attrgetter
from typing import ClassVar

import numpy as np

from capture_cli.model.effects._joint_effect import JointEffect
from capture_cli.model.effects._kernel import Companion, bound, call, inputs
from capture_cli.model.effects._places import source
from capture_cli.model.effects.base import Effect, raised
from capture_cli.model.world import World

FORCE, FRICTION, DAMPING = "qfrc_applied", "dof_frictionloss", "dof_damping"
INERTIA, LOAD = "inertia", "load_torque"
# How a companion reads what is no field of MjData at the joint
_READ = {
    "time": "data.time",
    "qpos": "data.qpos[at]",
    DAMPING: f"model.{DAMPING}[dof]",
    FRICTION: f"model.{FRICTION}[dof]",
    INERTIA: "inertia_felt(model, data.qLD, data.qLDiagInv, int(dof[0]))",
    LOAD: "data.qfrc_spring[dof] + data.qfrc_gravcomp[dof] + data.qfrc_fluid[dof] - data.qfrc_bias[dof]",
}


def gives_way(model, factor, inverse_diagonal, forces):
    """u' M^-1 u, with u the `forces` by their dofs and M = L' D L.

    factor (..., nC), inverse_diagonal (..., nv): mjData.qLD and qLDiagInv.
    """
    column, inverse = dict(forces), 0.0  # L'^-1 u, nonzero where those dofs hang on
    for i in range(max(column), -1, -1):
        if i in column:
            inverse = inverse + column[i] ** 2 * inverse_diagonal[..., i]
            first = int(model.M_rowadr[i])
            for k in range(first, first + int(model.M_rownnz[i]) - 1):
                above = int(model.M_colind[k])
                column[above] = column.get(above, 0.0) - factor[..., k] * column[i]
    return inverse


def inertia_felt(model, factor, inverse_diagonal, dof):
    """kg or kg m^2: what a force on `dof` alone has to accelerate; the others as of `gives_way`."""
    return 1 / gives_way(model, factor, inverse_diagonal, {dof: 1.0})


class JointForce(JointEffect):
    """An effect that adds what `kernel` gives to the joint's force, dry friction or damping, `adds_to`.

    The kernel's inputs are named as the fields of MjData that they are, at the joint, or dof_damping, dof_frictionloss,
    inertia: what a force on the joint alone has to accelerate, or load_torque: of springs, the medium, gravity and
    Coriolis forces. Friction and damping are those of the model, which MuJoCo integrates implicitly, and never fall
    below zero.
    """

    place = "force"
    kernel: ClassVar[Callable]
    adds_to: ClassVar[str] = FORCE

    def force(self, values, timestep, **_):
        return ForceOfKernel(self, self.coefficients(values), timestep)

    def read(self, world: World, field: str) -> np.ndarray:
        """A field of MjData, its damping, dry friction or inertia, at the joint, (simulation,)."""
        if field == "time":
            return world.time
        if field in (DAMPING, FRICTION):
            return world.vary(field)[:, self.dof]
        if field == INERTIA:
            return inertia_felt(self.model, world.qLD, world.qLDiagInv, self.dof)
        if field == LOAD:
            dof = self.dof
            passive = world.qfrc_spring[:, dof] + world.qfrc_gravcomp[:, dof] + world.qfrc_fluid[:, dof]
            return passive - world.qfrc_bias[:, dof]
        at = int(self.model.jnt_qposadr[self.joint]) if field == "qpos" else self.dof
        return getattr(world, field)[:, at]

    def source_of(self, field: str) -> str:
        """How a companion reads what `read` gives, for one simulation."""
        return _READ.get(field, f"data.{field}[dof]")

    def add(self, world: World, term: np.ndarray) -> None:
        """Add `term` (simulation,)."""
        if self.adds_to == FORCE:
            world.qfrc_applied[:, self.dof] += term
            return
        own = world.vary(self.adds_to)
        own[:, self.dof] = raised(own[:, self.dof], term)

    def companion(self, name, values):
        fields = inputs(self.kernel)
        reads = [self.source_of(field) for field in fields]
        kernels = (self.kernel, *([gives_way, inertia_felt] if INERTIA in fields else []))
        term, state = call(name, self.kernel, reads, self.numbers(values))
        joint = source(self.model, "joint", self.joint_name)
        lines = [f"dof = {joint}.dofadr"] + [f"at = {joint}.qposadr"] * ("data.qpos[at]" in reads)
        if self.adds_to == FORCE:
            lines.append(f"data.qfrc_applied[dof] += {term}")
            return Companion(kernels, tuple(lines), state, ("data.qfrc_applied",))
        own = f"model.{self.adds_to}"
        lines += [f"change = {term}", f"{own}[dof] = raised({own}[dof], change)"]
        return Companion((*kernels, raised), tuple(lines), state, (own,))


class ForceOfKernel:
    """What a JointForce, or another effect with a kernel, adds over a batch, chunk after chunk. Where it remembers
    anything, that is what the effect's kernel keeps.
    """

    def __init__(self, effect: Effect, coefficients: dict[str, np.ndarray], timestep: float):
        self.effect, self.coefficients, self.timestep = effect, coefficients, timestep
        self.reads = inputs(effect.kernel)
        self.world: World | None = None
        self.recalled: np.ndarray | None = None

    def __call__(self, world: World) -> None:
        term = self.kernel_in(world)
        self.effect.add(world, term(*(self.effect.read(world, field) for field in self.reads)))

    def kernel_in(self, world: World) -> Callable:
        """The kernel with the coefficients of this chunk: afresh where one begins, and with it another state."""
        if world is not self.world:
            if self.world is None or self.recalled is None:
                self.term = bound(self.effect.kernel, self.own(world), self.timestep)
            self.world = world
            if self.recalled is not None:
                for (holder, name), values in zip(self._kept, self.recalled.T, strict=True):
                    setattr(holder, name, values.copy())
                self.recalled = None
        return self.term

    def begins_in(self, world: World) -> bool:
        """Whether simulations begin with the next call in `world`, and do not go on from what was recalled."""
        return world is not self.world and self.recalled is None

    @property
    def remembers(self) -> int:
        return len(self.effect.kernel_keeps)

    def remembered(self) -> np.ndarray:
        """(simulation, number) of this chunk; 0 where there is nothing yet."""
        values = (getattr(holder, name) for holder, name in self._kept)
        size = len(self.world.rows)
        return np.stack([np.broadcast_to(0.0 if v is None else v, size) for v in values], axis=1)

    def recall(self, numbers: np.ndarray) -> None:
        self.recalled = numbers

    @property
    def _kept(self) -> list[tuple[object, str]]:
        """Which attribute of what each number is."""
        paths = (name.rpartition(".") for name in self.effect.kernel_keeps)
        return [(attrgetter(holder)(self.term) if holder else self.term, name) for holder, _, name in paths]

    def own(self, world: World) -> dict[str, np.ndarray]:
        """The kernel's coefficients, (simulation,) of this chunk."""
        return {name: v[world.rows] for name, v in self.coefficients.items()}
