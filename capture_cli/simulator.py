"""Task + effects + engine -> what the sensors would have reported. Counts every simulation it runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from capture_cli.effects.base import Effect
from capture_cli.parameters import ParameterSpace
from capture_cli.sim.engine import Engine, Force, ModelFields, Rollouts, Starts
from capture_cli.sim.starts import ReportedMotion, shift
from capture_cli.sim.windows import Windows
from capture_cli.tasks.base import Task

LENGTH_RATIO = 1.2  # windows within this ratio of lengths are stepped together


@dataclass(frozen=True)
class Simulated:
    """outputs (candidate, window, step, output) at the log's sampling times; diverged (candidate, window)."""

    outputs: np.ndarray
    diverged: np.ndarray


@dataclass(frozen=True)
class Motion:
    """On the model's grid: qpos (window, grid, nq), contacts (window, grid), how many there are."""

    qpos: np.ndarray
    contacts: np.ndarray


class Simulator:
    """Simulates windows of a log under candidate parameters: those of the task, then those of each effect.

    An effect's parameters are named EFFECT@SITE.PARAMETER. `rollouts` counts the simulations run so far.
    """

    def __init__(
        self,
        task: Task,
        effects: Sequence[tuple[str, Effect]] = (),
        threads: int | None = None,
        engine: Engine | None = None,
    ):
        self.task = task
        self.effects = tuple(effects)
        self.engine = engine or Engine(task.model, threads)
        self.rollouts = 0
        self.space = task.space
        self._columns: list[slice] = []
        longest = max(task.space.steps, default=0.0)
        for name, effect in self.effects:
            self._columns.append(slice(len(self.space), len(self.space) + len(effect.parameters)))
            self.space = self.space + ParameterSpace(
                [
                    replace(p, name=f"{placed_name(name, effect)}.{p.name}", step=max(p.step, longest))
                    for p in effect.parameters
                ]
            )
        self._sensors = np.array([c.index for c in task.outputs])
        self._own_states = 2 * task.model.nv + task.model.na
        self.hidden_states = sum(len(effect.states) for _, effect in self.effects)

    def simulate(
        self,
        windows: Windows,
        starts: Starts,
        parameters: np.ndarray,
        offsets: np.ndarray | None = None,
        reported: ReportedMotion | None = None,
    ) -> Simulated:
        """Simulate every window under every candidate.

        starts: one per window. parameters (candidate, parameter). offsets (candidate, window, state): how far each
        start is moved, in the tangent space of the state, and then what the effects' hidden states begin with; None
        moves none. reported: what the starts were read off, where that was the sensors: the measurement effects
        correct them.
        """
        parameters = np.atleast_2d(np.asarray(parameters, dtype=float))
        candidates = len(parameters)
        outputs = np.zeros((candidates, *windows.measured.shape))
        diverged = np.zeros((candidates, len(windows)), dtype=bool)
        for group in _by_length(windows.grid_steps):
            part = windows.rows(group)
            moved = None if offsets is None else offsets[:, group]
            motion = None if reported is None else reported.rows(group)
            sensors, bad = self._run(part, starts.rows(group), parameters, moved, motion)
            samples = part.sample(sensors)
            outputs[:, group, : samples.shape[2]] = samples
            diverged[:, group] = bad
        self.rollouts += candidates * len(windows)
        return Simulated(outputs, diverged)

    def trajectories(self, parameters: np.ndarray, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """One episode per row: state trajectories (simulation, point, feature) and diverged (simulation,).

        parameters (simulation, parameter), actions (simulation, action); the task is an ActionTask.
        """
        task, count = self.task, len(actions)
        episodes = task.episodes(actions)
        rollouts = self._step(
            episodes.starts,
            task.controls(episodes.inputs),
            np.arange(count),
            task.grid_steps,
            np.asarray(parameters, dtype=float),
        )
        self.rollouts += count
        points = np.rint(task.point_times / task.timestep).astype(int)
        return task.observe(rollouts.sensors[:, points]), rollouts.diverged

    def motion(
        self,
        windows: Windows,
        starts: Starts,
        point: np.ndarray,
        offsets: np.ndarray,
        reported: ReportedMotion | None = None,
    ) -> Motion:
        """What happens inside every window at one point (parameter,); the rest is as for `simulate`."""
        rollouts = self._rollout(windows, starts, point[None], offsets[None], reported, states=True)
        self.rollouts += len(windows)
        return Motion(rollouts.qpos, rollouts.contacts)

    def _run(self, windows: Windows, starts: Starts, parameters: np.ndarray, offsets, reported):
        """Outputs on the grid (candidate, window, grid, output) and diverged (candidate, window)."""
        rollouts = self._rollout(windows, starts, parameters, offsets, reported)
        shape = (len(parameters), len(windows))
        return rollouts.sensors.reshape(*shape, *rollouts.sensors.shape[1:]), rollouts.diverged.reshape(shape)

    def _rollout(
        self,
        windows: Windows,
        starts: Starts,
        parameters: np.ndarray,
        offsets,
        reported,
        states: bool = False,
    ) -> Rollouts:
        """Simulation = candidate * windows + window; the sensors are the outputs, as reported."""
        candidates, count = len(parameters), len(windows)
        each = np.repeat(parameters, count, axis=0)
        row = np.tile(np.arange(count), candidates)
        starts = starts.rows(row)
        hidden = None
        if offsets is not None:
            offsets = offsets.reshape(len(row), -1)
            starts = shift(self.task.model, starts, offsets[:, : self._own_states])
            hidden = offsets[:, self._own_states :]
        if reported is not None and any(effect.place == "measurement" for _, effect in self.effects):
            starts = shift(self.task.model, starts, self._start_change(reported.rows(row), each))
        return self._step(
            starts,
            self.task.controls(windows.controls),
            row,
            int(windows.grid_steps.max()),
            each,
            past=self.task.controls(windows.past),
            hidden=hidden,
            states=states,
        )

    def _step(
        self,
        starts: Starts,
        controls: np.ndarray,
        row: np.ndarray,
        steps: int,
        each: np.ndarray,
        *,
        past: np.ndarray | None = None,
        hidden: np.ndarray | None = None,
        states: bool = False,
    ) -> Rollouts:
        """Rollouts whose sensors are the outputs on the grid; each (simulation, parameter).

        past (row, lead, nu): what came before `controls` (row, grid, nu); their first values where None.
        hidden (simulation, state): what the effects' own states begin with; 0 where None.
        """
        controls, row = self._drive(controls, row, each, past)
        measures = any(effect.place == "measurement" for _, effect in self.effects)
        rollouts = self.engine.rollout(
            starts=starts,
            controls=controls,
            control_row=row,
            steps=steps,
            fields=self._fields(each),
            forces=self._forces(each, hidden),
            columns=None if measures else self._sensors,
            states=states,
        )
        if not measures:
            return rollouts
        sensors = rollouts.sensors
        for (_, effect), columns in zip(self.effects, self._columns, strict=True):
            sensors = effect.measure(sensors, each[:, columns], self.task.timestep)
        return replace(rollouts, sensors=sensors[..., self._sensors])

    def _start_change(self, reported: ReportedMotion, each: np.ndarray) -> np.ndarray:
        """How far starts are from where the sensors showed them, (simulation, state)."""
        true = reported.jets
        for (_, effect), columns in reversed(list(zip(self.effects, self._columns, strict=True))):
            true = effect.true_motion(true, each[:, columns])
        return reported.start_change(true, self._own_states)

    def _fields(self, each: np.ndarray) -> ModelFields:
        fields = ModelFields(self.task.model, len(each))
        self.task.write(fields, each[:, : len(self.task.space)])
        for (_, effect), columns in zip(self.effects, self._columns, strict=True):
            effect.write(fields, each[:, columns])
        return fields

    def _forces(self, each: np.ndarray, hidden: np.ndarray | None) -> list[Force]:
        hidden = np.zeros((len(each), self.hidden_states)) if hidden is None else hidden
        forces, first = [], 0
        for (_, effect), columns in zip(self.effects, self._columns, strict=True):
            own = hidden[:, first : first + len(effect.states)]
            forces.append(effect.force_from(each[:, columns], self.task.timestep, own))
            first += len(effect.states)
        return [f for f in forces if f is not None]

    def _drive(self, controls: np.ndarray, row: np.ndarray, each: np.ndarray, past: np.ndarray | None):
        if not any(effect.place == "control" for _, effect in self.effects):
            return controls, row
        own = [
            (effect, each[:, columns])
            for (_, effect), columns in zip(self.effects, self._columns, strict=True)
        ]
        memory = sum(effect.memory(values) for effect, values in own)
        lead = 0 if past is None else min(int(np.ceil(memory / self.task.timestep)), past.shape[1])
        if lead:
            controls = np.concatenate([past[:, -lead:], controls], axis=1)
        controls = controls[row]
        for effect, values in own:
            controls = effect.drive(controls, values, self.task.timestep)
        return controls[:, lead:], np.arange(len(row))


def placed_name(name: str, effect: Effect) -> str:
    """EFFECT@SITE, or EFFECT alone where it concerns the model as a whole."""
    return f"{name}@{effect.site}" if effect.site else name


def _by_length(grid_steps: np.ndarray) -> list[np.ndarray]:
    """Windows grouped so that none is stepped much further than it needs."""
    key = np.ceil(np.log(np.maximum(grid_steps, 2)) / np.log(LENGTH_RATIO) - 1e-9)
    return [np.flatnonzero(key == k) for k in np.unique(key)]
