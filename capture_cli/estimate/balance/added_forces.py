"""What forces that effects add do to the accelerations of a model along a motion that is known.

One that does not remember acts at every point by itself; one that does is led along every stretch. What joints feel of
either takes no calculation by MuJoCo, nor does what linear actuators give.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from mujoco import batch

from capture_cli.common.frozen import frozen
from capture_cli.common.processes import own_threads
from capture_cli.estimate.balance.actuation import NUMBERS, Actuation
from capture_cli.estimate.balance.forward_dynamics import Accelerations, ForwardDynamics, felt_inertia
from capture_cli.estimate.balance.recorded_world import AT_JOINTS, OF_INERTIA, RecordedWorld
from capture_cli.estimate.balance.resting import mass_matrix
from capture_cli.estimate.balance.trees import AtPoints, in_whole_trees, times
from capture_cli.model.effects._followed_force import FollowedForce
from capture_cli.model.effects.base import Effect
from capture_cli.model.world import APPLIED, World

_OF_ACTUATORS = ("actuator_gear", *NUMBERS)


@frozen
class SETTINGS:
    lanes: int = 1 << 15  # points whose accelerations are solved for at a time


@dataclass(frozen=True)
class _Seen:
    """What forces see at the points: the world, what actuators do, and all forces but those of constraints, `smooth`
    (point, nv).
    """

    world: World
    actuation: Actuation | None
    smooth: np.ndarray


class AddedForces:
    """Changes of accelerations by forces that come in beside those of a model. threads: of simulations; all cores
    where 0.
    """

    def __init__(self, dynamics: ForwardDynamics, threads: int):
        self.dynamics, self.threads = dynamics, threads
        self.model, self.points = dynamics.model, dynamics.points

    def of_effect(self, effect: Effect, values: np.ndarray) -> list[Accelerations]:
        """Changes by an effect's force at each of `values` (variant, parameter)."""
        return self._of_followed(effect, values) if _remembers(effect) else self._of_force(effect, values)

    def of_controls(self, driven: np.ndarray) -> list[Accelerations]:
        """Changes by what actuators give under other controls (variant, point, nu)."""
        dynamics, actuation = self.dynamics, self._actuation
        moved = np.flatnonzero((driven != dynamics.controls).any(axis=(0, 1)))
        if actuation is None or dynamics.unshown.size or not actuation.linear[moved].all():
            return [dynamics.moved(controls=c).forces - dynamics.null.forces for c in driven]
        here = np.tile(np.arange(len(self.points)), len(driven))
        acts = actuation.changed(actuation.given(driven.reshape(len(here), -1), here=here), here)
        loss = np.broadcast_to(self.model.dof_frictionloss, acts.shape)
        return self._as_changes(self._led(acts, loss, here))

    @cached_property
    def actuator_force(self) -> np.ndarray:
        """N or N m, (point, actuator)."""
        return np.array(self._seen.world.actuator_force)

    # --- which points follow each other ---

    def _of_force(self, effect: Effect, values: np.ndarray) -> list[Accelerations]:
        """Of a force that does not remember: every point is a step of its own, and all variants are side by side."""
        index = np.tile(np.arange(len(self.points)), len(values))[:, None]
        each = np.repeat(values, len(self.points), axis=0)
        [led] = self._led_along(effect, each, self.dynamics.timestep, index)
        return self._as_changes(led)

    def _of_followed(self, effect: Effect, values: np.ndarray) -> list[Accelerations]:
        """Of forces that remember: they are led along the motion, all stretches and variants side by side."""
        stretches = self.points.stretches
        longest = max(own.stop - own.start for own in stretches)
        index = [np.minimum(np.arange(own.start, own.start + longest), own.stop - 1) for own in stretches]
        index = np.tile(np.array(index), (len(values), 1))  # (variant and part, point)
        each = np.repeat(values, len(stretches), axis=0)
        led = self._led_along(effect, each, self.points.interval, index)
        changes = np.zeros((len(values), len(self.points), self.model.nv))
        for part, own in enumerate(stretches):
            changes[:, own] = led[: own.stop - own.start, part :: len(stretches)].swapaxes(0, 1)
        return self._as_changes(changes)

    def _as_changes(self, accelerations: np.ndarray) -> list[Accelerations]:
        """Of predicted accelerations (variant and point, nv) alone."""
        measured = self.dynamics.state[2]
        changes = accelerations.reshape(-1, *measured.shape)
        return [Accelerations(np.zeros_like(measured), c) for c in changes]

    def _led_along(
        self, effect: Effect, values: np.ndarray, timestep: float, index: np.ndarray
    ) -> np.ndarray:
        """Accelerations (step, lane, nv) by an effect's force at `values` (lane, parameter) along the points `index`
        (lane, step), a `timestep` after each other, s.
        """

        def force() -> Callable:
            points, first = self.points, index[:, 0]
            began = (points.time - points.elapsed)[first]
            return effect.force(values, timestep, first=points.step[first], began=began)

        led = self._led_at_joints(force(), index)
        return self._led_elsewhere(force(), index) if led is None else led

    # --- what joints feel ---

    def _led_at_joints(self, force: Callable, index: np.ndarray) -> np.ndarray | None:
        """Accelerations (step, lane, nv) by a force along the points `index` (lane, step); None where it changes
        something else than what joints feel: other fields of the model, or forces on bodies.
        """
        model, (_, qvel, qacc) = self.model, self.dynamics.state
        world = RecordedWorld(model, self._recorded, index)
        applied, friction, damping = world.qfrc_applied, *(world.vary(name) for name in AT_JOINTS)
        armature = world.vary(OF_INERTIA[0])
        mean = qvel + 0.5 * model.opt.timestep * qacc
        acts, loss, heavier = (np.zeros((index.shape[1], len(index), model.nv)) for _ in range(3))
        for step, here in enumerate(index.T):
            world.go_to(step)
            force(world)
            if world.is_changed_elsewhere:
                return None
            acts[step] = applied - (damping - model.dof_damping) * mean[here]
            loss[step] = friction
            heavier[step] = armature - model.dof_armature
        lanes, here = [values.reshape(-1, model.nv) for values in (acts, loss, heavier)], index.T.ravel()
        if not heavier.any():
            return self._led(*lanes[:2], here).reshape(acts.shape)
        parts = np.array_split(np.arange(len(here)), -(-len(here) // SETTINGS.lanes))
        led = [self._heavier(*(values[some] for values in lanes), here[some]) for some in parts]
        return np.concatenate(led).reshape(acts.shape)

    def _recorded(self, name: str) -> np.ndarray:
        """A field of MjData at the points, of the model as it is; the acceleration is the predicted one."""
        if name == "qacc":
            return self.dynamics.null.forces.predicted
        return getattr(self._seen.world, name)

    def _led(self, acts: np.ndarray, loss: np.ndarray, here: np.ndarray) -> np.ndarray:
        """Accelerations (lane, nv) by forces `acts` at the points `here`, with frictionloss `loss`, (lane, nv) each."""
        forces = acts + self._friction_changed(acts, loss, here)
        return times(self.model, AtPoints(self.dynamics.inverse_inertia, here), forces)

    def _friction_changed(self, acts: np.ndarray, loss: np.ndarray, here: np.ndarray) -> np.ndarray:
        """By how much dry friction is other, (lane, nv): as of `_led`."""
        dynamics, null = self.dynamics, self.dynamics.null
        found = np.zeros_like(acts)
        if not loss.any() and not null.friction.any():
            return found
        # other trees do not feel what one does
        changed = in_whole_trees(self.model, (acts != 0) | (loss != self.model.dof_frictionloss))
        some = np.flatnonzero(changed.any(axis=1))
        at, changed = here[some], changed[some]
        felt, mass = np.where(changed, loss[some], 0.0), AtPoints(dynamics.inverse_mass, at)
        friction = dynamics.friction(self.model, mass, null.smooth[at] + acts[some], felt, at)
        found[some] = np.where(changed, friction - null.friction[at], 0.0)
        return found

    def _heavier(
        self, acts: np.ndarray, loss: np.ndarray, heavier: np.ndarray, here: np.ndarray
    ) -> np.ndarray:
        """As of `_led`, where the inertia of each coordinate is larger by `heavier` (lane, nv): trees in which nothing
        changes stay as they are.
        """
        dynamics, model, null = self.dynamics, self.model, self.dynamics.null
        changed = in_whole_trees(model, (acts != 0) | (heavier != 0) | (loss != model.dof_frictionloss))
        rest = dynamics.at_rest[here]
        mass, felt = (
            AtPoints(i, here, heavier * ~rest) for i in (dynamics.inverse_mass, dynamics.inverse_felt)
        )
        applied = null.smooth[here] + acts
        applied += dynamics.friction(model, mass, applied, np.where(changed, loss, 0.0), here)
        applied = np.where(rest, dynamics.state[2][here], applied)
        free = np.where(changed, times(model, felt, np.where(changed, applied, 0.0)), null.free[here])
        return dynamics.resting(free, null.pushed[here]) - null.forces.predicted[here]

    # --- what else changes ---

    def _led_elsewhere(self, force: Callable, index: np.ndarray) -> np.ndarray:
        """As `_led_at_joints`, of a force that changes anything; MuJoCo works out at every step what that does, but for
        what actuators give where their numbers are others.
        """
        dynamics, model = self.dynamics, self.model
        world = RecordedWorld(model, self._recorded, index)
        friction, damping = (world.vary(name) for name in AT_JOINTS)
        given = world.actuator_force  # as they gave it under the force of the step before
        acts, loss = (np.zeros((index.shape[1], len(index), model.nv)) for _ in range(2))
        otherwise: dict[int, np.ndarray] = {}  # accelerations of steps in which inertias are others
        runner = cache(lambda: batch.Batch(model, len(index), own_threads(self.threads)))
        for k, here in enumerate(index.T):
            world.go_to(k)
            world.actuator_force = given
            force(world)
            worked_out = self._by_actuators(world, here) or self._by_mujoco(world, here, runner())
            applied, given, inertia = worked_out
            loss[k] = friction
            acts[k] = applied - (damping - model.dof_damping) * model.opt.timestep * dynamics.state[2][here]
            if world.changes(but=(*APPLIED, *AT_JOINTS, *_OF_ACTUATORS)):
                otherwise[k] = self._with_inertia(acts[k], loss[k], inertia, here)
        led = self._led(acts.reshape(-1, model.nv), loss.reshape(-1, model.nv), index.T.ravel())
        led = led.reshape(acts.shape)
        for k, accelerations in otherwise.items():
            led[k] = accelerations
        return led

    def _by_actuators(
        self, world: RecordedWorld, here: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, None] | None:
        """As `_by_mujoco`, where a force changes no more than what joints feel and numbers of linear actuators, so that
        the inertia is not asked for; None where it changes something else.
        """
        dynamics, actuation = self.dynamics, self._seen.actuation
        if actuation is None or world.changes(but=(APPLIED[0], *AT_JOINTS, *NUMBERS)):
            return None
        numbers = world.changed(NUMBERS)
        if not actuation.follows(numbers):
            return None
        given = actuation.given(dynamics.controls[here], numbers, here)
        damping = world.vary("dof_damping") - self.model.dof_damping
        applied = world.qfrc_applied - damping * dynamics.begins[here]
        return applied + actuation.changed(given, here), given, None

    def _by_mujoco(
        self, world: RecordedWorld, here: np.ndarray, runner: batch.Batch
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What comes in (lane, nv) at the points `here` by a force that changed `world`; what actuators then give,
        (lane, actuator), and the inertia, as mjData.M packs it.
        """
        smooth, inertia, actuators = (runner.bind(n) for n in ("qfrc_smooth", "M", "actuator_force"))
        runner.bind("time")[...] = self.points.time[here]
        world.write(runner)
        dynamics = self.dynamics
        dynamics.forward(runner, dynamics.state[0][here], dynamics.begins[here], dynamics.controls[here])
        return smooth - self._seen.smooth[here], actuators.copy(), inertia

    def _with_inertia(
        self, acts: np.ndarray, loss: np.ndarray, inertia: np.ndarray, here: np.ndarray
    ) -> np.ndarray:
        """As of `_led`, where the inertia is this, as mjData.M packs it."""
        dynamics, model, null = self.dynamics, self.model, self.dynamics.null
        mass, felt = (dynamics.inverse(of(model, inertia), here) for of in (mass_matrix, felt_inertia))
        applied = null.smooth[here] + acts
        applied += dynamics.friction(model, mass, applied, loss, here)
        applied = np.where(dynamics.at_rest[here], dynamics.state[2][here], applied)
        free = (felt @ applied[..., None])[..., 0]
        return dynamics.resting(free, null.pushed[here]) - null.forces.predicted[here]

    # --- at the points as they are ---

    @cached_property
    def _seen(self) -> _Seen:
        dynamics = self.dynamics
        runner = dynamics.runner(self.model)
        smooth, at = runner.bind("qfrc_smooth"), (dynamics.state[0], dynamics.begins, dynamics.controls)
        actuation = Actuation.of(self.model, runner, lambda: dynamics.forward(runner, *at))
        world = World(runner, np.arange(len(self.points)))
        world.qacc = dynamics.null.forces.predicted
        world.stepped = True
        return _Seen(world, actuation, smooth.copy())

    @cached_property
    def _actuation(self) -> Actuation | None:
        """What actuators do as a step takes it, with all forces."""
        dynamics = self.dynamics
        runner = dynamics.runner(self.model)
        at = dynamics.state, dynamics.controls
        return Actuation.of(self.model, runner, lambda: dynamics.applied(runner, *at))


def _remembers(effect: Effect) -> bool:
    """Whether its force depends on what was before, other than by what the log tells."""
    return not isinstance(effect, FollowedForce) and inspect.isclass(getattr(type(effect), "kernel", None))
