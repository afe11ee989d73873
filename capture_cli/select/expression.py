"""Unknown unknowns: the missing generalised force as a sparse expression in positions, velocities, inputs and time.

Each term is an effect with one coefficient, so that terms are scored, fitted through the simulator and accepted by the
rules that hold for the catalogue. (Sparse regression as in Brunton et al. 2016, but through the simulator, so that
neither accelerations nor noise-free states are needed.) The time t is that since the log's first sample.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.model.effects._kernel import Companion, number
from capture_cli.model.effects._scales import HINGE, SLIDE, characteristic_force, characteristic_speed, travel
from capture_cli.model.effects.base import Effect
from capture_cli.model.effects.placed import Placed
from capture_cli.model.object_names import object_name
from capture_cli.model.parameters import Parameter
from capture_cli.model.world import World

NAME = "expression"


@frozen
class SETTINGS:
    # a motion may use a small part of a joint's travel and speed, and a term must still be able to matter
    room: float = 30.0
    rest: float = 0.02  # of a joint's characteristic speed: where the sign of a velocity is rounded off


@dataclass(frozen=True)
class Term:
    """A basis function: its text, how large it gets, its unit, and its source.

    source: an expression with {data} for what holds the state, and {all} before an index, of a batch of simulations or
    of one. A simulation and the module that `capture export` writes evaluate the same text.
    """

    text: str
    scale: float
    unit: str
    source: str

    def of(self, data: str, every: str) -> str:
        """The source for a state of the name `data`, of which `every` ("" or ":, ") comes before an index."""
        return self.source.replace("{data}", data).replace("{all}", every)


class ExpressionTerm(Effect):
    """`coefficient` times a term, as a force at a joint. Its site is "JOINT: TERM"."""

    place = "force"
    summary = "a term of an expression for the force that is missing"
    where = "every hinge and slide joint"

    def __init__(self, model: mujoco.MjModel, joint: int, term: Term):
        self.model = model
        self.joint = joint
        self.term, self.formula_term = term, term.text
        self.dof = int(model.jnt_dofadr[joint])
        self.site = f"{object_name(model, 'joint', joint)}: {term.text}"

    @classmethod
    def sites(cls, model):
        return [object_name(model, "joint", j) for j in _joints(model)]

    @property
    def parameters(self):
        force = "N m" if int(self.model.jnt_type[self.joint]) == HINGE else "N"
        most = SETTINGS.room * characteristic_force(self.model, self.joint) / self.term.scale
        return (Parameter("coefficient", f"{force} per {self.term.unit}", -most, most, 0.0),)

    @cached_property
    def _value(self) -> Callable[[World], np.ndarray]:
        """The term (simulation,) in a world: compiled once it is simulated; few of many are.

        Of a column of a larger array numpy takes another routine for powers and sines, with another last digit, where
        the memory of the result happens to begin at the column's end: it is given each in a piece.
        """
        source = re.sub(r"world\.\w+\[:, \d+\]", r"np.ascontiguousarray(\g<0>)", self.term.of("world", ":, "))
        return eval(f"lambda world: {source}", {"np": np})

    def force(self, values, timestep, **_):
        def push(world: World) -> None:
            world.qfrc_applied[:, self.dof] += values[world.rows, 0] * self._value(world)

        return push

    def companion(self, name, values):
        force = f"data.qfrc_applied[{self.dof}]"
        value = self.term.of("data", "")
        return Companion((), (f"{force} += {number(values[0])} * ({value})",), changes=("data.qfrc_applied",))


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
    q, v, far, fast, length, speed = _motion(model, joint)
    sign = f"tanh(v/{_rest(fast)})"
    sign_source = f"np.tanh({v} / {_rest(fast)})"
    terms = [
        Term("1", 1.0, "1", "1.0"),
        Term("q", far, length, q),
        Term("q^2", far**2, f"{length}^2", f"{q} ** 2"),
        Term("q^3", far**3, f"{length}^3", f"{q} ** 3"),
        Term("sin(q)", 1.0, "1", f"np.sin({q})"),
        Term("cos(q)", 1.0, "1", f"np.cos({q})"),
        Term("v", fast, speed, v),
        Term("|v|", fast, speed, f"np.abs({v})"),
        Term("v|v|", fast**2, f"({speed})^2", f"{v} * np.abs({v})"),
        Term("v^3", fast**3, f"({speed})^3", f"{v} ** 3"),
        Term(sign, 1.0, "1", sign_source),
        Term("q v", far * fast, f"{length} {speed}", f"{q} * {v}"),
        Term("q^2 v", far**2 * fast, f"{length}^2 {speed}", f"{q} ** 2 * {v}"),
        Term(f"|q| {sign}", far, length, f"np.abs({q}) * {sign_source}"),
        Term("t", 10.0, "s", "{data}.time"),
    ]
    for actuator in inputs:
        name, u = object_name(model, "actuator", actuator), _indexed("ctrl", model.actuator_ctrladr[actuator])
        limited = model.actuator_ctrllimited[actuator]
        top = float(np.abs(model.actuator_ctrlrange[actuator]).max()) if limited else 1.0
        terms += [
            Term(name, top, "ctrl", u),
            Term(f"{name}^3", top**3, "ctrl^3", f"{u} ** 3"),
            Term(f"|{name}| {sign}", top, "ctrl", f"np.abs({u}) * {sign_source}"),
            Term(f"{name} q", top * far, f"ctrl {length}", f"{u} * {q}"),
            Term(f"{name} v", top * fast, f"ctrl {speed}", f"{u} * {v}"),
        ]
    for other in _joints(model):
        if other != joint:
            terms += _coupled(model, other, v, speed)
    return terms


def _rest(fast: float) -> str:
    """The velocity, in the digits of the term's text, at which the sign of one is rounded off; fast: characteristic."""
    return f"{float(f'{SETTINGS.rest * fast:.2g}'):g}"


def _coupled(model: mujoco.MjModel, other: int, v: str, speed: str) -> list[Term]:
    """Terms of another joint's motion, for a joint whose velocity is `v`, in the unit `speed`."""
    name = object_name(model, "joint", other)
    q_other, v_other, far, fast, length, rate = _motion(model, other)
    return [
        Term(f"q_{name}", far, length, q_other),
        Term(f"v_{name}", fast, rate, v_other),
        Term(f"v_{name}|v_{name}|", fast**2, f"({rate})^2", f"{v_other} * np.abs({v_other})"),
        Term(f"v v_{name}", fast**2, f"{speed} {rate}", f"{v} * {v_other}"),
        Term(f"sin(q_{name})", 1.0, "1", f"np.sin({q_other})"),
    ]


def _motion(model: mujoco.MjModel, joint: int) -> tuple[str, str, float, float, str, str]:
    """Of a joint: the source of its position and velocity, how far and fast it goes, and their units."""
    q, v = _indexed("qpos", model.jnt_qposadr[joint]), _indexed("qvel", model.jnt_dofadr[joint])
    hinge = int(model.jnt_type[joint]) == HINGE
    units = ("rad", "rad/s") if hinge else ("m", "m/s")
    return q, v, travel(model, joint), characteristic_speed(model, joint), *units


def _indexed(field: str, index: int) -> str:
    return f"{{data}}.{field}[{{all}}{int(index)}]"
