"""Unknown unknowns: the missing generalised force as a sparse expression in positions, velocities, inputs and time.

Each term is an effect with one coefficient, so that terms are scored, fitted through the simulator and accepted by the
rules that hold for the catalogue. (Sparse regression as in Brunton et al. 2016, but through the simulator, so that
neither accelerations nor noise-free states are needed.) The time t is that since the log's first sample.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from capture_cli.effects._scales import HINGE, SLIDE, characteristic_force, characteristic_speed, travel
from capture_cli.effects.base import Effect
from capture_cli.effects.placed import Placed
from capture_cli.parameters import Parameter
from capture_cli.sim.engine import World
from capture_cli.sim.object_names import object_name

NAME = "expression"
ROOM = 30.0  # a motion may use a small part of a joint's travel and speed, and a term must still be able to matter
REST = 0.02  # of a joint's characteristic speed: where the sign of a velocity is rounded off


@dataclass(frozen=True)
class Term:
    """A basis function: its text, how large it gets, its unit, and its value (simulation,) in a world."""

    text: str
    scale: float
    unit: str
    value: Callable[[World], np.ndarray]


class ExpressionTerm(Effect):
    """`coefficient` times a term, as a force at a joint. Its site is "JOINT: TERM"."""

    place = "force"
    summary = "a term of an expression for the force that is missing"
    where = "every hinge and slide joint"

    def __init__(self, model: mujoco.MjModel, joint: int, term: Term):
        self.model = model
        self.joint = joint
        self.term = term
        self.dof = int(model.jnt_dofadr[joint])
        self.site = f"{object_name(model, 'joint', joint)}: {term.text}"

    @classmethod
    def sites(cls, model):
        return [object_name(model, "joint", j) for j in _joints(model)]

    @property
    def parameters(self):
        force = "N m" if int(self.model.jnt_type[self.joint]) == HINGE else "N"
        most = ROOM * characteristic_force(self.model, self.joint) / self.term.scale
        return (Parameter("coefficient", f"{force} per {self.term.unit}", -most, most, 0.0),)

    def force(self, values, timestep, **_):
        def push(world: World) -> None:
            world.qfrc_applied[:, self.dof] += values[world.rows, 0] * self.term.value(world)

        return push


def expression_terms(model: mujoco.MjModel, inputs: Sequence[int]) -> list[Placed]:
    """Every term at every joint, as placed effects; inputs (input,): the actuator of each."""
    return [
        Placed(NAME, ExpressionTerm(model, j, term))
        for j in _joints(model)
        for term in _terms(model, j, inputs)
    ]


def formula(effects: Sequence[ExpressionTerm], coefficients: Sequence[float]) -> str:
    """The expression in words: one line per joint."""
    lines: dict[str, list[str]] = {}
    for effect, coefficient in zip(effects, coefficients, strict=True):
        joint = object_name(effect.model, "joint", effect.joint)
        lines.setdefault(joint, []).append(f"{coefficient:+.4g} {effect.term.text}")
    return "; ".join(f"missing force at {joint} = {' '.join(terms)}" for joint, terms in lines.items())


def _joints(model: mujoco.MjModel) -> list[int]:
    return [j for j in range(model.njnt) if int(model.jnt_type[j]) in (HINGE, SLIDE)]


def _terms(model: mujoco.MjModel, joint: int, inputs: Sequence[int]) -> list[Term]:
    dof, adr = int(model.jnt_dofadr[joint]), int(model.jnt_qposadr[joint])
    far, fast = travel(model, joint), characteristic_speed(model, joint)
    length, speed = ("rad", "rad/s") if int(model.jnt_type[joint]) == HINGE else ("m", "m/s")

    def q(world):
        return world.qpos[:, adr]

    def v(world):
        return world.qvel[:, dof]

    def sign(world):
        return np.tanh(v(world) / (REST * fast))

    terms = [
        Term("1", 1.0, "1", lambda w: np.ones(len(w.rows))),
        Term("q", far, length, q),
        Term("q^2", far**2, f"{length}^2", lambda w: q(w) ** 2),
        Term("q^3", far**3, f"{length}^3", lambda w: q(w) ** 3),
        Term("sin(q)", 1.0, "1", lambda w: np.sin(q(w))),
        Term("cos(q)", 1.0, "1", lambda w: np.cos(q(w))),
        Term("v", fast, speed, v),
        Term("|v|", fast, speed, lambda w: np.abs(v(w))),
        Term("v|v|", fast**2, f"({speed})^2", lambda w: v(w) * np.abs(v(w))),
        Term("v^3", fast**3, f"({speed})^3", lambda w: v(w) ** 3),
        Term("sign(v)", 1.0, "1", sign),
        Term("q v", far * fast, f"{length} {speed}", lambda w: q(w) * v(w)),
        Term("q^2 v", far**2 * fast, f"{length}^2 {speed}", lambda w: q(w) ** 2 * v(w)),
        Term("|q| sign(v)", far, length, lambda w: np.abs(q(w)) * sign(w)),
        Term("t", 10.0, "s", lambda w: w.time),
    ]
    for number in inputs:
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, number)
        top = (
            float(np.abs(model.actuator_ctrlrange[number]).max())
            if model.actuator_ctrllimited[number]
            else 1.0
        )

        def u(world, column=model.actuator_ctrladr[number]):
            return world.ctrl[:, column]

        terms += [
            Term(name, top, "ctrl", u),
            Term(f"{name}^3", top**3, "ctrl^3", lambda w, u=u: u(w) ** 3),
            Term(f"|{name}| sign(v)", top, "ctrl", lambda w, u=u: np.abs(u(w)) * sign(w)),
            Term(f"{name} q", top * far, f"ctrl {length}", lambda w, u=u: u(w) * q(w)),
            Term(f"{name} v", top * fast, f"ctrl {speed}", lambda w, u=u: u(w) * v(w)),
        ]
    for other in _joints(model):
        if other != joint:
            terms += _coupled(model, other, v)
    return terms


def _coupled(model: mujoco.MjModel, other: int, v) -> list[Term]:
    """Terms of another joint's motion."""
    dof, adr = int(model.jnt_dofadr[other]), int(model.jnt_qposadr[other])
    name = object_name(model, "joint", other)
    far, fast = travel(model, other), characteristic_speed(model, other)
    return [
        Term(f"q_{name}", far, "coordinate", lambda w: w.qpos[:, adr]),
        Term(f"v_{name}", fast, "rate", lambda w: w.qvel[:, dof]),
        Term(f"v_{name}|v_{name}|", fast**2, "rate^2", lambda w: w.qvel[:, dof] * np.abs(w.qvel[:, dof])),
        Term(f"v v_{name}", fast**2, "rate^2", lambda w: v(w) * w.qvel[:, dof]),
        Term(f"sin(q_{name})", 1.0, "1", lambda w: np.sin(w.qpos[:, adr])),
    ]
