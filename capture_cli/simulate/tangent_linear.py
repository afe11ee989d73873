"""Simulations that differ little from others, to first order: the step linearized along a path (tangent-linear model).

With dx what a state differs by, in its tangent space, followed by what forces remember, and du what the simulation is
driven by otherwise (a parameter, through the model's fields, forces or controls), its path and what sensors show differ
by

    dx[i + 1] = A dx[i] + B du        dy[i] = C dx[i] + D du

A, B, C and D are differences of single steps, as mjd_transitionFD takes them, from the middle of each `spacing` steps
of the path, under the mean of their controls. So a difference takes a `spacing`-th of a simulation. What forces
remember is there once they were called: the first steps of all are simulated. Where bodies hit something it is wrong:
whoever asks has to check.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.model.fields import ModelFields
from capture_cli.model.states import InitialStates, corrections_between, shift
from capture_cli.model.world import Force
from capture_cli.simulate.engine import Engine, Keep, Rollouts
from capture_cli.simulate.uncoupled import Trees, groups


@frozen
class SETTINGS:
    spacing: int = 8  # steps that share a linearization
    difference: float = 1e-6  # of a state: m, rad, or per s; of what forces remember, of any unit
    simulated: int = 2  # first steps, where forces remember: after them each has all that it keeps
    overhead: int = 64  # steps that take as long as what is done beside them for a span


@dataclass(frozen=True)
class NearSimulations:
    """Simulations (candidate, path) in one axis. Those of the first candidate are the paths that the others are near.

    controls (row, step, nu): simulation i is driven by controls[row[i]]. fields: model values; forces: what acts in the
    simulations of the numbers given. driven (candidate,): which differ by more than their initial state. trees: of what
    is several machines, whose states are moved together.
    """

    initial: InitialStates
    controls: np.ndarray
    row: np.ndarray
    fields: ModelFields
    forces: Callable[[np.ndarray], Sequence[Force]]
    driven: np.ndarray
    trees: Trees | None = None

    @property
    def paths(self) -> int:
        """How many there are."""
        return len(self.initial) // len(self.driven)

    def rollouts(self, engine: Engine, keep: Keep) -> Rollouts:
        """Sensors of all, and forces of actuators where they are kept, to first order about the paths."""
        if self.controls.shape[1] <= SETTINGS.simulated:  # no more than first steps
            return self.simulated(engine, np.arange(len(self.initial)), keep)
        own = np.arange(self.paths)
        base = self.simulated(engine, own, replace(keep, states=True, remembered=True))
        shown = _shown(base.sensors, base.actuator_force, keep)
        shown = shown + _Linearized(engine, self, base, keep).changes()
        shown = shown.reshape(-1, *shown.shape[2:])
        sensors, forces = np.split(shown, [base.sensors.shape[2]], axis=2)
        diverged = np.tile(base.diverged, len(self.driven)) | ~np.isfinite(shown).all(axis=(1, 2))
        return Rollouts(sensors, diverged, actuator_force=forces if keep.actuator_forces else None)

    def simulated(self, engine: Engine, some: np.ndarray, keep: Keep, steps: int | None = None) -> Rollouts:
        """The simulations of these numbers, all or the first of their steps."""
        return engine.rollout(
            self.initial.rows(some),
            self.controls[:, :steps],
            row=self.row[some],
            fields=self.fields.rows(some),
            forces=self.forces(some),
            keep=keep,
        )


def cost(paths: int, states: int, driven: int) -> float:
    """Of paths with so many `states` and `driven` candidates near, in simulations of one path."""
    return paths * (1 + (1 + states + driven) / SETTINGS.spacing) + SETTINGS.overhead / SETTINGS.spacing


class _Linearized:
    """The linearization along the paths `base` of what is `near` them, one for each span of steps."""

    def __init__(self, engine: Engine, near: NearSimulations, base: Rollouts, keep: Keep):
        self.engine, self.near, self.base, self.keep = engine, near, base, keep
        steps = base.sensors.shape[1]
        self.remembered = 0 if base.remembered is None else base.remembered.shape[2]
        self.simulated = SETTINGS.simulated if self.remembered else 0  # of the first steps
        self.first = np.arange(self.simulated, steps, SETTINGS.spacing)
        self.last = np.minimum(self.first + SETTINGS.spacing, steps)
        sums = np.add.reduceat(near.controls, self.first, axis=1)
        self.mean_controls = sums / (self.last - self.first)[:, None]  # (row, span, nu)
        self.states = 2 * engine.model.nv + engine.model.na + self.remembered
        self.columns = slice(None) if keep.columns is None else keep.columns
        # states that are moved together
        self.group, self.groups = np.arange(self.states), self.states
        if near.trees is not None:
            self.group, self.groups = groups(near.trees.path)
        self.columns_shown = base.sensors.shape[2] + engine.model.nu * keep.actuator_forces

    def changes(self) -> np.ndarray:
        """Of what is shown, (candidate, path, step, column)."""
        by_step, next_state = self._maps()
        begun, displaced = self._first_steps() if self.simulated else self._displacements()
        spans, paths, _, columns, inputs = by_step.shape
        begins = np.zeros((spans, paths, inputs, len(self.near.driven)))
        candidates = np.flatnonzero(self.near.driven)
        begins[:, :, np.arange(self.states, inputs), candidates] = 1.0
        begins[0, :, : self.states] = displaced
        for span in range(spans - 1):
            begins[span + 1, :, : self.states] = next_state[span] @ begins[span]
        changes = by_step.reshape(spans, paths, -1, inputs) @ begins
        changes = changes.reshape(spans, paths, SETTINGS.spacing, columns, -1).transpose(4, 1, 0, 2, 3)
        changes = np.concatenate([begun, changes.reshape(*changes.shape[:2], -1, columns)], axis=2)
        return changes[:, :, : self.last[-1]]

    def _maps(self) -> tuple[np.ndarray, np.ndarray]:
        """From the states where a span begins, and then inputs, to what is shown in each step, (span, path, step,
        column, state or input), and to the states where it ends, (span, path, state, state or input).
        """
        ended, shown = self._slopes()
        states = self.states
        by_step = np.zeros((*shown.shape[:2], SETTINGS.spacing, *shown.shape[2:]))
        there = np.zeros_like(ended)
        there[..., :states] = np.eye(states)
        for step in range(SETTINGS.spacing):
            by_step[:, :, step] = shown[..., :states] @ there
            by_step[:, :, step, :, states:] += shown[..., states:]
            there = ended[..., :states] @ there
            there[..., states:] += ended[..., states:]
        return by_step, there

    def _slopes(self) -> tuple[np.ndarray, np.ndarray]:
        """[A B] (span, path, state, state or input) and [C D] (span, path, column, state or input), by a single step
        from the middle of each span: of the path itself, with each state moved, and of each that is driven otherwise.
        """
        near, paths = self.near, self.near.paths
        candidates = np.concatenate([np.zeros(1 + self.groups, dtype=int), np.flatnonzero(near.driven)])
        number = (candidates[:, None] * paths + np.arange(paths)).ravel()
        begins, remembered = self._begins(number, len(candidates))
        stepped = self.engine.single_steps(
            begins,
            self.mean_controls[near.row[number]].swapaxes(0, 1),
            near.fields.rows(number),
            near.forces(number),
            remembered,
        )
        layout = len(self.first), len(candidates), paths
        there = np.tile(np.arange(paths), len(candidates))
        first = (np.arange(len(self.first))[:, None] * len(number) + there).ravel()
        moved = stepped.remembered - stepped.remembered[first]
        ended = corrections_between(self.engine.model, stepped.ends.rows(first), stepped.ends)
        ended = np.concatenate([ended, moved], axis=1)
        shown = _shown(stepped.sensors[..., self.columns], stepped.actuator_force, self.keep)
        ended, shown = (values.reshape(*layout, values.shape[-1]) for values in (ended, shown))
        scale = np.ones(len(candidates) - 1)
        scale[: self.groups] = 1 / SETTINGS.difference
        slopes = ((v[:, 1:] - v[:, :1]) * scale[:, None, None] for v in (ended, shown))
        ended, shown = (np.moveaxis(s, 1, -1) for s in slopes)
        if near.trees is None:
            return ended, shown
        of_shown = near.trees.columns[self.columns]
        if self.keep.actuator_forces:
            of_shown = np.concatenate([of_shown, near.trees.actuators])
        return self._apart(ended, near.trees.path), self._apart(shown, of_shown)

    def _apart(self, slopes: np.ndarray, tree: np.ndarray) -> np.ndarray:
        """Slopes (..., row, state or input) from those by groups of states; tree (row,)."""
        by_state = slopes[..., self.group] * (tree[:, None] == self.near.trees.path)
        return np.concatenate([by_state, slopes[..., self.groups :]], axis=-1)

    def _begins(self, number: np.ndarray, candidates: int) -> tuple[InitialStates, np.ndarray]:
        """The middle of each span of the paths, (span * candidate * path): with a state moved in each of those after
        the first, the others as they are; and what forces remember there, (span * candidate * path, number).
        """
        middle = (self.first + self.last - 1) // 2
        path = np.tile(np.arange(self.near.paths), candidates)
        at = (self.base.qpos, self.base.qvel, self.base.act)
        time = self.near.initial.time[number] + middle[:, None] * self.engine.model.opt.timestep
        begins = InitialStates(
            *(values[path, middle[:, None]].reshape(time.size, values.shape[2]) for values in at),
            time.ravel(),
        )
        moves = np.zeros((candidates, self.states))
        moves[1 + self.group, np.arange(self.states)] = SETTINGS.difference
        moves = np.tile(np.repeat(moves, self.near.paths, axis=0), (len(middle), 1))
        own = self.states - self.remembered
        remembered = moves[:, own:]
        if self.remembered:
            remembered = remembered + self.base.remembered[path, middle[:, None]].reshape(remembered.shape)
        return shift(self.engine.model, begins, moves[:, :own]), remembered

    def _displacements(self) -> tuple[np.ndarray, np.ndarray]:
        """What no step shows, (candidate, path, 0, column), and by what initial states differ from those of the paths,
        (path, state, candidate).
        """
        near = self.near
        between = self._between(replace(near.initial, together=None))
        return np.zeros((len(near.driven), near.paths, 0, self.columns_shown)), between

    def _first_steps(self) -> tuple[np.ndarray, np.ndarray]:
        """By what the first steps, which are simulated, differ: in what is shown, (candidate, path, step, column), and
        in the states that they end in, (path, state, candidate).
        """
        near, at = self.near, self.simulated
        keep = replace(self.keep, states=True, remembered=True)
        begun = near.simulated(self.engine, np.arange(len(near.initial)), keep, at + 1)
        shown = _shown(begun.sensors, begun.actuator_force, self.keep)[:, :at]
        shown = shown.reshape(-1, near.paths, *shown.shape[1:])
        ends = InitialStates(*(v[:, at] for v in (begun.qpos, begun.qvel, begun.act)), near.initial.time)
        return shown - shown[0], self._between(ends, begun.remembered[:, at])

    def _between(self, states: InitialStates, remembered: np.ndarray | None = None) -> np.ndarray:
        """By what states of all, and what forces remember, differ from those of the paths, (path, state, candidate)."""
        near = self.near
        path = np.tile(np.arange(near.paths), len(near.driven))
        between = corrections_between(self.engine.model, states.rows(path), states)
        if remembered is not None:
            between = np.concatenate([between, remembered - remembered[path]], axis=1)
        return np.moveaxis(between.reshape(len(near.driven), near.paths, -1), 0, -1)


def _shown(sensors: np.ndarray, actuator_force: np.ndarray, keep: Keep) -> np.ndarray:
    """Sensors, and after them forces of actuators where they are kept, (..., column)."""
    return np.concatenate([sensors, actuator_force], axis=-1) if keep.actuator_forces else sensors
