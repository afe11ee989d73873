"""Kinematic trees that nothing joins: what differs in one moves no output of another.

So candidates that differ from the first in one tree each are simulated together, one of every tree: the groups of
columns by which a sparse Jacobian is differenced (Curtis, Powell & Reid 1974).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from capture_cli.model.contacts import touching_pairs
from capture_cli.model.effects.base import Effect
from capture_cli.model.fields import ModelFields
from capture_cli.model.object_names import object_name
from capture_cli.model.parameters import ParameterSpace

SEVERAL = -1  # in place of the number of a tree: of more than one, or of none

_ON_JOINTS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_O = mujoco.mjtObj
_OBJECTS = {
    **{int(_O.mjOBJ_BODY): "body", int(_O.mjOBJ_XBODY): "body", int(_O.mjOBJ_JOINT): "jnt"},
    **{int(_O.mjOBJ_SITE): "site", int(_O.mjOBJ_GEOM): "geom", int(_O.mjOBJ_ACTUATOR): "actuator"},
}
# What may have a name after which a site is called, by how fields of the model begin
NAMED = {name: name for name in ("body", "site", "geom", "actuator", "sensor")} | {"jnt": "joint"}


@dataclass(frozen=True)
class Slot:
    """An effect with where its parameters stand among all, and its states among the hidden ones."""

    effect: Effect
    parameters: slice
    states: slice


def as_they_act(slots: Sequence[Slot]) -> list[Slot]:
    """In the order in which their forces are added: those that read the acceleration come last."""
    return sorted(slots, key=lambda slot: slot.effect.reads_acceleration)


@dataclass(frozen=True)
class ModelTrees:
    """The tree of each object of a model, by what the object is called in its fields, and of each column of
    sensordata.
    """

    of_objects: dict[str, np.ndarray]
    of_columns: np.ndarray

    @classmethod
    def of(cls, model: mujoco.MjModel) -> ModelTrees | None:
        """None where there is one tree, where several may be joined, or a sensor or an actuator is not of one."""
        if model.ntree < 2 or _may_be_joined(model):
            return None
        body, dof = model.body_treeid, model.dof_treeid
        joint = dof[model.jnt_dofadr]
        driven = np.isin(model.actuator_trntype, _ON_JOINTS)
        actuator = np.where(driven, joint[np.where(driven, model.actuator_trnid[:, 0], 0)], SEVERAL)
        objects = {"body": body, "jnt": joint, "dof": dof, "actuator": actuator}
        objects |= {"site": body[model.site_bodyid], "geom": body[model.geom_bodyid]}
        sensors = [_tree_of_sensor(model, sensor, objects) for sensor in range(model.nsensor)]
        objects["sensor"] = np.array(sensors, dtype=int)
        if SEVERAL in actuator or SEVERAL in sensors:
            return None
        return cls(objects, np.repeat(objects["sensor"], model.sensor_dim))

    def of_site(self, effect: Effect) -> int:
        """The tree that all objects are of after which the site of an effect is named."""
        names = {effect.site, *effect.site.split("+")}
        found = {
            int(tree)
            for kind in NAMED
            for number, tree in enumerate(self.of_objects[kind])
            if object_name(effect.model, NAMED[kind], number) in names
        }
        return found.pop() if len(found) == 1 else SEVERAL

    def of_fields(self, fields: ModelFields) -> list[set[int]]:
        """The trees of what is another in each simulation than in the first, those after it."""
        found: list[set[int]] = [set() for _ in range(fields.simulations - 1)]
        for name, values in fields.values.items():
            trees = self.of_objects.get(name.partition("_")[0], np.full(1, SEVERAL))
            differs = (values[1:] != values[0]).reshape(len(values) - 1, len(trees), -1).any(axis=2)
            for number, object_ in zip(*np.nonzero(differs), strict=True):
                found[number].add(int(trees[object_]))
        return found


@dataclass(frozen=True)
class Trees:
    """The tree of each parameter, initial state and output of a simulator, of all numbers that a path goes on with from
    one step to the next (what forces remember last), and of each column of sensordata and actuator.
    """

    parameters: np.ndarray
    states: np.ndarray
    outputs: np.ndarray
    path: np.ndarray
    columns: np.ndarray
    actuators: np.ndarray

    @classmethod
    def of(
        cls,
        model: mujoco.MjModel,
        space: ParameterSpace,
        slots: Sequence[Slot],
        outputs: np.ndarray,
        fields: Callable[[np.ndarray], ModelFields],
    ) -> Trees | None:
        """None where candidates cannot be told apart by them.

        slots: the effects, in the order of their hidden states. outputs: columns of sensordata. fields: of points
        (point, parameter).
        """
        trees = ModelTrees.of(model)
        if trees is None:
            return None
        if any(_joins(slot.effect, trees.of_site(slot.effect)) for slot in slots):
            return None
        parameters = _of_parameters(trees, space, fields)
        for slot in slots:
            if slot.effect.place != "model" and slot.parameters.start < len(space):
                parameters[slot.parameters] = trees.of_site(slot.effect)
        hidden = [trees.of_site(s.effect) for s in slots for _ in s.effect.states]
        kept = [trees.of_site(s.effect) for s in as_they_act(slots) for _ in s.effect.kernel_keeps]
        dof, actuator = trees.of_objects["dof"], trees.of_objects["actuator"]
        path = [*dof, *dof, *np.repeat(actuator, np.maximum(model.actuator_actnum, 0))]
        return cls(
            parameters,
            np.array([*path, *hidden], dtype=int),
            trees.of_columns[outputs],
            np.array([*path, *kept], dtype=int),
            trees.of_columns,
            actuator,
        )


@dataclass(frozen=True)
class Grouped:
    """Candidates that are simulated in groups. group (candidate,): the number of the one that each is in; tree
    (candidate,): in which of its trees, SEVERAL where it is alone in it.

    parameters (group, parameter), corrections (group, window, state).
    """

    group: np.ndarray
    tree: np.ndarray
    parameters: np.ndarray
    corrections: np.ndarray

    @classmethod
    def of(cls, trees: Trees | None, parameters: np.ndarray, corrections: np.ndarray) -> Grouped | None:
        """Of candidates that differ from the first; None where there are no fewer groups.

        parameters (candidate, parameter), corrections (candidate, window, state).
        """
        if trees is None or len(parameters) < 3:
            return None
        moved = np.concatenate(
            [parameters != parameters[0], (corrections != corrections[0]).any(axis=1)], axis=1
        )
        tree = _common(moved, np.concatenate([trees.parameters, trees.states]))
        group, count = groups(tree)
        if count == len(parameters):
            return None
        own, begun = (np.repeat(first[:1], count, axis=0) for first in (parameters, corrections))
        for candidate, number in enumerate(group):
            here, there = np.split(moved[candidate], [parameters.shape[1]])
            own[number, here] = parameters[candidate, here]
            begun[number][:, there] = corrections[candidate][:, there]
        return cls(group, tree, own, begun)

    def apart(self, trees: Trees, outputs: np.ndarray, diverged: np.ndarray, *more: Any) -> tuple:
        """Outputs (candidate, window, step, output) and diverged (candidate, window) from those of the groups, and
        what is said of all of them.
        """
        each = outputs[self.group]
        for tree in np.unique(self.tree[self.tree != SEVERAL]):
            which, others = np.flatnonzero(self.tree == tree), np.flatnonzero(trees.outputs != tree)
            each[which[:, None], :, :, others] = np.moveaxis(outputs[0][..., others], -1, 0)
        return each, diverged[self.group], *more


def groups(tree: np.ndarray) -> tuple[np.ndarray, int]:
    """The number of the group that each of candidates is in, (candidate,), and how many there are: one of every tree in
    each; those of SEVERAL, (candidate,), are alone.
    """
    group, alone = np.zeros(len(tree), dtype=int), tree == SEVERAL
    group[alone] = np.arange(alone.sum())
    for own in np.unique(tree[~alone]):
        group[tree == own] = alone.sum() + np.arange((tree == own).sum())
    return group, int(group.max()) + 1


def _common(moved: np.ndarray, trees: np.ndarray) -> np.ndarray:
    """The tree of all that is `moved` (candidate, number); SEVERAL where that are several. trees (number,)."""
    highest = np.where(moved, trees, SEVERAL).max(axis=1, initial=SEVERAL)
    lowest = np.where(moved, trees, highest[:, None]).min(axis=1, initial=np.iinfo(int).max)
    return np.where(highest == lowest, highest, SEVERAL)


def _of_parameters(
    trees: ModelTrees, space: ParameterSpace, fields: Callable[[np.ndarray], ModelFields]
) -> np.ndarray:
    """By which fields of the model differ between the ends of a parameter's range, (parameter,)."""
    ends = np.stack([np.diag(space.low), np.diag(space.high)], axis=1)
    middle = (space.low + space.high) / 2
    points = np.where(np.eye(len(space), dtype=bool)[:, None], ends, middle).reshape(
        2 * len(space), len(space)
    )
    found = trees.of_fields(fields(np.concatenate([middle[None], points])))
    each = [one | other for one, other in zip(found[::2], found[1::2], strict=True)]
    return np.array([own.pop() if len(own) == 1 else SEVERAL for own in each], dtype=int)


def _joins(effect: Effect, tree: int) -> bool:
    """Whether by an effect at `tree` what is in one tree may move another, or change when its sensors are read."""
    return effect.reports_late or (tree == SEVERAL and effect.place != "model")


def _may_be_joined(model: mujoco.MjModel) -> bool:
    """Whether anything but its joints may pass a force from one tree to another, or the solver works on all at once."""
    pairs = model.body_treeid[model.geom_bodyid[touching_pairs(model)]]
    touch = (pairs[:, 0] != pairs[:, 1]) & (pairs >= 0).all(axis=1)
    counts = (model.neq, model.ntendon, model.nflex, model.npair, model.nplugin)
    return bool(touch.any() or any(counts) or model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_ISLAND)


def _tree_of_sensor(model: mujoco.MjModel, sensor: int, objects: dict[str, np.ndarray]) -> int:
    kind, number = int(model.sensor_objtype[sensor]), int(model.sensor_objid[sensor])
    name = _OBJECTS.get(kind)
    return SEVERAL if name is None or model.sensor_refid[sensor] >= 0 else int(objects[name][number])
