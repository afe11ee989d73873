"""Task + effects + engine -> what the sensors would have reported. Counts every simulation it runs."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Self

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.log.input_sequences import CachedSequences, InputSequences
from capture_cli.log.reported_motion import ReportedMotion
from capture_cli.log.windows import Windows, at_times
from capture_cli.model.effects.base import Effect
from capture_cli.model.effects.placed import Placed
from capture_cli.model.fields import ModelFields
from capture_cli.model.parameters import ParameterSpace
from capture_cli.model.states import InitialStates, shift
from capture_cli.model.tasks.base import Task
from capture_cli.model.world import Force
from capture_cli.simulate.engine import Engine, Keep, Rollouts
from capture_cli.simulate.tangent_linear import NearSimulations, cost
from capture_cli.simulate.uncoupled import Slot, Trees, as_they_act, groups


@frozen
class SETTINGS:
    episodes: int = 1024  # simulated at once: bounds the memory that recorded sensors take
    sequence_bytes: int = 64 << 20  # of controls of one call, of which effects make several copies
    sensor_bytes: int = 64 << 20  # of outputs of one call, which are interpolated in several copies
    shows: float = 0.25  # of an effect's memory: the rest is for the last digits
    length_ratio: float = 1.2  # windows within this ratio of lengths are stepped together


@dataclass(frozen=True)
class Simulated:
    """outputs (candidate, window, step, output) at the log's sampling times; diverged (candidate, window)."""

    outputs: np.ndarray
    diverged: np.ndarray


@dataclass(frozen=True)
class InitialConditions:
    """Where simulations begin: their states (simulation,) and, there, hidden states of the effects, (simulation,
    state).

    early (simulation,): s, before the window, where a sensor reports late. drift (simulation,): s, how much later than
    the window's start that is by the clock of the controls. late (simulation, nv): s, after the window's start, when
    the log shows each coordinate as it is at the beginning; None where no sensor differs from the truth.
    """

    states: InitialStates
    hidden: np.ndarray
    early: np.ndarray
    drift: np.ndarray
    late: np.ndarray | None = None


@dataclass(frozen=True)
class _Runs:
    """Simulations of the windows `row` (simulation,), each (simulation, parameter); initial states are one per window.

    corrections (simulation, state), reported and logged are as for `Simulator.simulate`. near: how many candidates they
    are, one after the other, that differ little from the first.
    """

    windows: Windows
    initial: InitialStates
    row: np.ndarray
    each: np.ndarray
    corrections: np.ndarray | None
    reported: ReportedMotion | None
    logged: bool = False
    near: int = 1

    @classmethod
    def at(
        cls,
        windows: Windows,
        initial: InitialStates,
        point: np.ndarray,
        corrections: np.ndarray | None,
        reported: ReportedMotion | None,
    ) -> Self:
        """One of every window, at one point (parameter,)."""
        each = np.repeat(point[None], len(windows), axis=0)
        return cls(windows, initial, np.arange(len(windows)), each, corrections, reported)


@dataclass(frozen=True)
class _Drives:
    """What drives simulations for so many `steps`; the last inputs are held after the end of a sequence.

    row (simulation,): which of them drives each. known (simulation,): how many before the first step are from the log.
    began (simulation,): s, when the episode of each did. first (simulation,): the step of the log that each begins at;
    None where there is no log. late: as of InitialConditions.
    """

    sequences: InputSequences
    row: np.ndarray
    known: np.ndarray
    steps: int
    began: np.ndarray
    first: np.ndarray | None = None
    late: np.ndarray | None = None

    def of(self, some: np.ndarray) -> Self:
        """What drives the simulations of these numbers."""
        own = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("sequences", "steps")}
        return replace(self, **{name: v if v is None else v[some] for name, v in own.items()})


def _slots(effects: Sequence[Effect], first: int, hidden: int) -> list[Slot]:
    """One after the other, from there on among all parameters and hidden states."""
    slots = []
    for effect in effects:
        parameters = slice(first, first + len(effect.parameters))
        states = slice(hidden, hidden + len(effect.states))
        slots.append(Slot(effect, parameters, states))
        first, hidden = parameters.stop, states.stop
    return slots


class Simulator:
    """Simulates windows of a log under candidate parameters: those of the task, then those of each effect.

    An effect's parameters are named EFFECT@SITE.PARAMETER. Effects that the task has at known values act before these,
    and are no part of `space`. `rollouts` counts the simulations run so far.
    difference_step: the least share of a parameter's range that finite differences take, for the task's sake or an
    effect's.
    """

    def __init__(
        self,
        task: Task,
        effects: Sequence[tuple[str, Effect]] = (),
        threads: int | None = None,
        engine: Engine | None = None,
        difference_step: float = 0.0,
    ):
        self.task = task
        self.effects = tuple(Placed(*e) for e in effects)
        self.engine = engine or Engine(task.model, threads)
        self.rollouts = 0
        all_effects = [effect for _, effect in (*(placed for placed, _ in task.effects), *self.effects)]
        self.difference_step = max([difference_step, *(effect.difference_step for effect in all_effects)])
        longest = max([self.difference_step, *task.space.steps])
        self.space = ParameterSpace([p.with_step_of(self.difference_step) for p in task.space])
        for placed in self.effects:
            self.space = self.space + ParameterSpace(
                [
                    replace(p.with_step_of(longest), name=f"{placed.name}.{p.name}")
                    for p in placed.effect.parameters
                ]
            )
        self._known = np.concatenate([np.zeros(0), *(values for _, values in task.effects)])
        # known values stand after those of candidates
        self._placed = _slots([effect for (_, effect), _ in task.effects], len(self.space), 0)
        hidden = sum(len(own.effect.states) for own in self._placed)
        self._placed += _slots([effect for _, effect in self.effects], len(task.space), hidden)
        self.hidden_states = sum(len(own.effect.states) for own in self._placed)
        self._sensors = np.array([c.index for c in task.outputs])
        self._later = task.reads_later
        self._late_controls = task.model.actuator_ctrladr[
            [c.index for c, late in zip(task.inputs, task.half_late, strict=True) if late]
        ]
        self._own_states = 2 * task.model.nv + task.model.na
        self.substeps = math.prod(effect.substeps for effect in all_effects)

    @cached_property
    def trees(self) -> Trees | None:
        """Of machines that are several."""
        return Trees.of(
            self.task.model,
            self.space,
            self._placed,
            self._sensors,
            lambda points: self._fields(self._with_known(points)),
        )

    @property
    def begins_early(self) -> bool:
        """Whether a simulation may begin before its window does: where a sensor reports late."""
        return any(own.effect.reports_late for own in self._placed)

    @property
    def most_picked_up(self) -> np.ndarray:
        """The most that each column of sensordata may show of the forces of actuators, (column,)."""
        every = [own.effect.most_picked_up for own in self._placed]
        return np.max(every, axis=0, initial=0.0) if every else np.zeros(self.task.model.nsensordata)

    def hidden_sd(self, windows: Windows) -> np.ndarray:
        """How well hidden states are known at the start of each window, (window, hidden state): 0 for certain.

        What was before an episode, or a gap, no longer counts where the inputs are known for long enough.
        """
        sd = np.zeros((len(windows), self.hidden_states))
        for own in self._placed:
            sd[:, own.states] = own.effect.states_sd(windows.first)
            if own.effect.states_before:
                shows = SETTINGS.shows * own.effect.memory(own.effect.space.high[None])
                sd[(windows.known > 0) & (windows.known >= shows), own.states] = 0.0
        return sd

    def hidden_tried(self) -> np.ndarray:
        """Values (point, hidden state) among which those that a window began with are looked for, one effect's after
        the other's; nan leaves a state as it is.
        """
        points = [np.zeros((0, self.hidden_states))]
        for own in self._placed:
            tried = own.effect.states_tried
            if len(tried):
                points.append(np.full((len(tried), self.hidden_states), np.nan))
                points[-1][:, own.states] = tried
        return np.concatenate(points)

    def simulate(
        self,
        windows: Windows,
        initial: InitialStates,
        parameters: np.ndarray,
        corrections: np.ndarray | None = None,
        reported: ReportedMotion | None = None,
        *,
        logged: bool = False,
    ) -> Simulated:
        """Simulate every window under every candidate.

        initial: one per window. parameters (candidate, parameter). corrections (candidate, window, state): how far each
        start is moved, in the tangent space of the state, and then what the effects' hidden states begin with; None
        moves none. reported: what the initial states were read off, where that was the sensors: the measurement effects
        correct them. logged: the windows are what a logger has of whole episodes. It begins when the latest of the
        sensors reports the start; the machine is under its first inputs until then.
        What several candidates share, a window that they do not differ in, is simulated once.
        """
        parameters = np.atleast_2d(np.asarray(parameters, dtype=float))
        candidates = len(parameters)
        outputs = np.zeros((candidates, *windows.measured.shape))
        diverged = np.zeros((candidates, len(windows)), dtype=bool)
        for group in _by_length(windows.grid_steps):
            part = windows.rows(group)
            moved = None if corrections is None else corrections[:, group]
            motion = None if reported is None else reported.rows(group)
            candidate, row, which = _distinct(parameters, moved, len(group))
            steps = part.measured.shape[1]
            for few in self._at_a_time(row, part):
                own = None if moved is None else moved[candidate[few], row[few]]
                each = self._with_known(parameters[candidate[few]])
                rollouts = self._rollout(
                    _Runs(part, initial.rows(group), row[few], each, own, motion, logged)
                )
                number, window = candidate[few], group[row[few]]
                outputs[number, window, :steps] = self._sampled(part, rollouts.sensors, row[few])
                diverged[number, window] = rollouts.diverged
            for number, simulation in enumerate(which):
                shared = candidate[simulation] != number
                first, window = candidate[simulation[shared]], group[shared]
                outputs[number, window] = outputs[first, window]
                diverged[number, window] = diverged[first, window]
            self.rollouts += len(row)
        return Simulated(outputs, diverged)

    def simulate_near(
        self,
        windows: Windows,
        initial: InitialStates,
        parameters: np.ndarray,
        corrections: np.ndarray,
        reported: ReportedMotion | None,
    ) -> Simulated:
        """As `simulate`, of candidates that differ little from the first: to first order about it, but for parameters
        of effects that remember.
        """
        outputs = np.zeros((len(parameters), *windows.measured.shape))
        diverged = np.zeros(outputs.shape[:2], dtype=bool)
        remembering = self._remembering(parameters)
        moving = _moving(parameters, corrections) & ~remembering
        moving[0] = True  # the path itself
        for group in self._near_at_a_time(windows, int(moving.sum())):
            part, row = windows.rows(group), np.tile(np.arange(len(group)), moving.sum())
            each = self._with_known(np.repeat(parameters[moving], len(group), axis=0))
            own = corrections[moving][:, group].reshape(len(row), -1)
            motion = None if reported is None else reported.rows(group)
            rollouts = self._rollout(
                _Runs(part, initial.rows(group), row, each, own, motion, near=moving.sum())
            )
            shown = self._sampled(part, rollouts.sensors, row)
            shown = shown.reshape(-1, len(group), *shown.shape[1:])
            lost = rollouts.diverged.reshape(-1, len(group))
            outputs[:, group, : shown.shape[2]], diverged[:, group] = shown[0], lost[0]
            outputs[np.ix_(moving, group, np.arange(shown.shape[2]))] = shown
            diverged[np.ix_(moving, group)] = lost
            self.rollouts += len(group)
        if remembering.any():
            exact = self.simulate(
                windows, initial, parameters[remembering], corrections[remembering], reported
            )
            outputs[remembering], diverged[remembering] = exact.outputs, exact.diverged
        return Simulated(outputs, diverged)

    def _sampled(self, windows: Windows, sensors: np.ndarray, row: np.ndarray) -> np.ndarray:
        """Sensors (simulation, grid, output) of the windows `row` (simulation,) at their samples."""
        if self._later.any():
            before = sensors[..., self._later]
            rise = np.diff(before, axis=1)
            sensors = sensors.copy()
            half = 0.5 / self.substeps
            sensors[..., self._later] += half * np.concatenate([rise, rise[:, -1:]], axis=1)
        return windows.sample(sensors, row)

    def _at_kicks(self, controls: np.ndarray) -> np.ndarray:
        """Controls (row, step, ctrl) in steps that are shorter: those that are late by half a step by half of these."""
        if self.substeps == 1 or not self._late_controls.size:
            return controls
        earlier = 0.5 * (1 - 1 / self.substeps)
        controls = controls.copy()
        controls[:, :-1, self._late_controls] += earlier * np.diff(controls[..., self._late_controls], axis=1)
        return controls

    def near_is_cheaper(self, parameters: np.ndarray, corrections: np.ndarray) -> bool:
        """Whether `simulate_near`, and a simulation of each window to check it, takes less than `simulate`."""
        windows, remembering = corrections.shape[1], self._remembering(parameters)
        driven = ((parameters != parameters[0]).any(axis=1) & ~remembering).sum()
        if self.trees is None:
            states = self._own_states + sum(len(own.effect.kernel_keeps) for own in self._placed)
        else:
            _, states = groups(self.trees.path)
        near = cost(windows, states, driven) + (1 + remembering.sum()) * windows
        return _moving(parameters, corrections).sum() * windows > near

    def _remembering(self, parameters: np.ndarray) -> np.ndarray:
        """Which candidates differ from the first in a parameter of an effect that remembers, (candidate,): what a
        transmission passes on may go to and fro within the steps that share a linearization.
        """
        differs = parameters != parameters[0]
        own = [differs[:, own.parameters] for own in self._placed if own.effect.kernel_keeps]
        return np.concatenate([differs[:, :0], *own], axis=1).any(axis=1)

    def _near_at_a_time(self, windows: Windows, candidates: int) -> list[np.ndarray]:
        """Numbers of windows that are simulated at a time, under so many candidates that differ little."""
        groups = []
        for group in _by_length(windows.grid_steps):
            steps = windows.sequences.lead + windows.sequences.stop
            size = candidates * steps * (len(self._sensors) + self.task.model.nu) * np.dtype(float).itemsize
            most = max(SETTINGS.sensor_bytes // size, 1)
            groups += np.array_split(group, -(-len(group) // most))
        return groups

    def _with_known(self, parameters: np.ndarray) -> np.ndarray:
        """Parameters (simulation, parameter) of candidates, and after them those of known values."""
        known = np.broadcast_to(self._known, (len(parameters), len(self._known)))
        return np.concatenate([parameters, known], axis=1)

    def _at_a_time(self, row: np.ndarray, windows: Windows) -> list[np.ndarray]:
        """Numbers of the simulations of the windows `row` (simulation,) that are run at a time."""
        order, steps, bound = np.arange(len(row)), windows.grid, SETTINGS.sensor_bytes
        columns = len(self._sensors)
        if self.begins_early or any(own.effect.place == "control" for own in self._placed):
            # each has controls of its own
            steps, columns, bound = (
                windows.sequences.lead + windows.sequences.stop,
                self.task.model.nu,
                SETTINGS.sequence_bytes,
            )
        else:
            # one window's together, whose inputs they share
            order = np.argsort(row, kind="stable")
        size = steps * columns * np.dtype(float).itemsize
        return np.array_split(order, max(min(-(-len(row) * size // bound), len(row)), 1))

    def trajectories(self, parameters: np.ndarray, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """One episode per row: state trajectories (simulation, point, feature) and diverged (simulation,).

        parameters (simulation, parameter), actions (simulation, action), at least one; the task is an ActionTask.
        """
        parts = [slice(i, i + SETTINGS.episodes) for i in range(0, len(actions), SETTINGS.episodes)]
        each = [self._trajectories(parameters[part], actions[part]) for part in parts]
        trajectories, diverged = (np.concatenate(arrays) for arrays in zip(*each, strict=True))
        return trajectories, diverged

    def _trajectories(self, parameters: np.ndarray, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        task, count = self.task, len(actions)
        episodes = task.episodes(actions)
        each = self._with_known(np.asarray(parameters, dtype=float))
        length = (task.grid_steps - 1) * task.timestep
        none = np.zeros(count)
        conditions = InitialConditions(
            episodes.initial, hidden=np.zeros((count, self.hidden_states)), early=none, drift=none
        )
        steps = task.grid_steps + self._steps_beyond(each, np.zeros(count), length)
        sequences = CachedSequences(episodes.inputs)
        drives = _Drives(sequences, np.arange(count), none.astype(int), steps, began=none)
        rollouts = self._step(conditions, drives, each)
        self.rollouts += count
        points = np.rint(task.point_times / task.timestep).astype(int)
        return task.observe(rollouts.sensors[:, points]), rollouts.diverged

    def motion(
        self,
        windows: Windows,
        initial: InitialStates,
        point: np.ndarray,
        corrections: np.ndarray | None = None,
        reported: ReportedMotion | None = None,
    ) -> Rollouts:
        """What happens inside every window, on the model's grid, at one point (parameter,): sensors are the outputs,
        and states are kept. The rest is as for `simulate`.
        """
        runs = _Runs.at(windows, initial, self._with_known(point[None])[0], corrections, reported)
        rollouts = self._rollout(runs, keep_states=True)
        self.rollouts += len(windows)
        return rollouts

    def initial_conditions(
        self,
        windows: Windows,
        initial: InitialStates,
        point: np.ndarray,
        corrections: np.ndarray,
        reported: ReportedMotion | None = None,
    ) -> InitialConditions:
        """Where the simulation of every window begins at one point (parameter,); the rest is as for `simulate`."""
        return self._initial_conditions(
            _Runs.at(windows, initial, self._with_known(point[None])[0], corrections, reported)
        )

    def _initial_conditions(self, runs: _Runs) -> InitialConditions:
        windows, row, each = runs.windows, runs.row, runs.each
        initial = runs.initial.rows(row)
        hidden = np.zeros((len(row), self.hidden_states))
        if runs.corrections is not None:
            initial = shift(self.task.model, initial, runs.corrections[:, : self._own_states])
            hidden = runs.corrections[:, self._own_states :]
        late = self._lateness(each, windows.elapsed[row])
        latest = late[:, self._sensors].max(axis=1, initial=0.0)
        early, shown = latest * runs.logged, None
        if runs.reported is not None and (self._measures or self.substeps > 1):
            here = runs.reported.rows(row)
            early = latest * here.read
            before = early[:, None] - late
            change = self._initial_change(here, before, each, windows.elapsed[row])
            initial = shift(self.task.model, initial, change)
            late = self._filtered_late(each, windows.elapsed[row]) - before
            shown = here.of_coordinates(late, self.task.model.nv)
        drift = self._drift(each, windows.elapsed[row]) - early
        return InitialConditions(replace(initial, time=initial.time + drift), hidden, early, drift, shown)

    def _rollout(self, runs: _Runs, keep_states: bool = False) -> Rollouts:
        """Rollouts whose sensors are the outputs on the grid of the windows."""
        windows, row, each = runs.windows, runs.row, runs.each
        conditions, length = self._initial_conditions(runs), windows.grid * windows.timestep
        drives = _Drives(
            windows.sequences,
            row,
            windows.known_lead[row],
            windows.grid + self._steps_beyond(each, windows.elapsed[row], length, conditions.early),
            began=(windows.time - windows.elapsed)[row],
            first=None if windows.first is None else windows.first[row],
            late=conditions.late,
        )
        rollouts = self._step(conditions, drives, each, keep_states=keep_states, near=runs.near)
        return _from(rollouts, conditions.early / windows.timestep) if conditions.early.any() else rollouts

    def _steps_beyond(
        self, each: np.ndarray, elapsed: np.ndarray, length: float, early: np.ndarray | float = 0.0
    ) -> int:
        """How many steps simulations have to go on for after `length` s: sensors that are ahead, or whose clock is
        late, show what is then.

        each (simulation, parameter); elapsed, early (simulation,): s, since the episode began, and before that, where
        they begin.
        """
        # each by itself: a clock that runs ahead is read before what is late after it
        late = self._each_lateness(each, elapsed + length)
        ahead = sum(-np.minimum(own[:, self._sensors], 0.0).min(axis=1, initial=0.0) for own in late)
        more = early + ahead + self._drift(each, np.full(len(each), length))
        return int(np.ceil(np.max(more, initial=0.0) / self.task.timestep))

    def _step(
        self,
        conditions: InitialConditions,
        drives: _Drives,
        each: np.ndarray,
        *,
        keep_states: bool = False,
        near: int = 1,
    ) -> Rollouts:
        """Rollouts whose sensors are the outputs on the grid, from where they begin; each (simulation, parameter)."""
        initial, hidden, first = conditions.states, conditions.hidden, drives.first
        elapsed = initial.time - drives.began
        controls, row = self._drive(drives, each, conditions, elapsed)
        controls = self._at_kicks(controls)
        measures = self._measures
        keep = Keep(
            columns=None if measures else self._sensors,
            states=keep_states,
            actuator_forces=any(own.effect.reads_actuators for own in self._placed),
        )
        if near > 1:
            rollouts = NearSimulations(
                initial,
                controls,
                row,
                self._fields(each),
                lambda some: self._forces(each[some], hidden[some], drives.of(some)),
                driven=_driven(each, hidden, near),
                trees=self.trees,
            ).rollouts(self.engine, keep)
        else:
            rollouts = self.engine.rollout(
                initial,
                controls,
                row=row,
                fields=self._fields(each),
                forces=self._forces(each, hidden, drives),
                keep=keep,
            )
        if not measures:
            return rollouts
        sensors = rollouts.sensors
        for own in self._placed:
            if own.effect.reads_actuators:
                sensors = own.effect.pick_up(sensors, each[:, own.parameters], rollouts.actuator_force)
        for own in self._placed:
            values, states = each[:, own.parameters], hidden[:, own.states]
            sensors = own.effect.measure(
                sensors, values, self.task.timestep, states=states, elapsed=elapsed, first=first
            )
        return replace(rollouts, sensors=sensors[..., self._sensors])

    def _lateness(self, each: np.ndarray, elapsed: np.ndarray) -> np.ndarray:
        """How late each column of sensordata is reported, s, (simulation, column), elapsed (simulation,) s after the
        episode began.
        """
        none = np.zeros((len(each), self.task.model.nsensordata))
        return sum(self._each_lateness(each, elapsed), none)

    def _each_lateness(self, each: np.ndarray, elapsed: np.ndarray) -> list[np.ndarray]:
        """The same by each effect, (simulation, column)."""
        none = np.zeros((len(each), self.task.model.nsensordata))
        return [none + own.effect.lateness(each[:, own.parameters], elapsed) for own in self._placed]

    def _initial_change(
        self, reported: ReportedMotion, before: np.ndarray, each: np.ndarray, elapsed: np.ndarray
    ) -> np.ndarray:
        """How far initial states are from where the sensors showed them where windows begin, (simulation, state).

        before (simulation, column): s, before that, that what was so at a start was reported. elapsed (simulation,): s,
        since the episode began.
        """
        true = self._true_motion(reported.at(before), each, elapsed)
        return reported.initial_change(true, self._own_states, self.substeps)

    def _true_motion(self, derivatives: np.ndarray, each: np.ndarray, elapsed: np.ndarray) -> np.ndarray:
        """How the sensors' numbers moved in truth where they were reported with `derivatives`, (simulation, 3, column).

        each (simulation, parameter); elapsed as of `_initial_change`.
        """
        for own in reversed(self._placed):
            derivatives = own.effect.true_motion(derivatives, each[:, own.parameters], elapsed)
        return derivatives

    def _filtered_late(self, each: np.ndarray, elapsed: np.ndarray) -> np.ndarray:
        """How late each column of sensordata shows a steady motion beside its lateness, s, (simulation, column)."""
        still = np.zeros((len(each), 3, self.task.model.nsensordata))
        steady = still.copy()
        steady[:, 1] = 1.0
        moved, rested = (self._true_motion(m, each, elapsed)[:, 0] for m in (steady, still))
        return moved - rested

    def _fields(self, each: np.ndarray) -> ModelFields:
        fields = ModelFields(self.task.model, len(each))
        self.task.write(fields, each[:, : len(self.task.space)])
        for own in self._placed:
            own.effect.write(fields, each[:, own.parameters])
        return fields

    def _forces(self, each: np.ndarray, hidden: np.ndarray, drives: _Drives) -> list[Force]:
        timestep = self.task.timestep / self.substeps
        forces = [
            own.effect.force(
                each[:, own.parameters],
                timestep,
                states=hidden[:, own.states],
                began=drives.began,
                first=drives.first,
                late=drives.late,
            )
            for own in as_they_act(self._placed)
        ]
        return [f for f in forces if f is not None]

    @property
    def _measures(self) -> bool:
        return any(own.effect.place == "measurement" for own in self._placed)

    def _drift(self, each: np.ndarray, elapsed: np.ndarray) -> np.ndarray:
        """How far the sensors' clock is behind that of the controls, s, (simulation,)."""
        none = np.zeros(len(each))
        return sum((own.effect.drift(each[:, own.parameters], elapsed) for own in self._placed), none)

    def _drive(
        self, drives: _Drives, each: np.ndarray, conditions: InitialConditions, elapsed: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Controls (simulation or row, steps, nu) as the actuators receive them, and which of them are whose."""
        acting = [
            (own.effect, each[:, own.parameters]) for own in self._placed if own.effect.place == "control"
        ]
        sequences, lead, steps = drives.sequences, drives.sequences.lead, drives.steps
        used, row = np.unique(drives.row, return_inverse=True)
        if not acting and not conditions.drift.any() and steps <= sequences.stop:
            return self.task.controls(sequences.inputs(used, 0, steps)), row
        memory = sum(effect.memory(values) for effect, values in acting)
        # one step at least: what came first is taken to have been for ever
        past = max(min(int(np.ceil(memory / self.task.timestep)), lead), 1)
        since = elapsed - past * self.task.timestep
        at = conditions.drift[:, None] / self.task.timestep + np.arange(lead - past, lead + steps)
        reached = np.clip(at, 0, lead + sequences.stop - 1)
        begin, stop = int(reached.min()), min(int(reached.max()) + 2, lead + sequences.stop)
        controls = self.task.controls(sequences.inputs(used, begin - lead, stop - lead))
        reached -= begin
        controls = _between(controls, row, reached)
        unknown = at < lead - drives.known[:, None]
        controls += unknown[..., None] * self._before(conditions.hidden)[:, None]
        for effect, values in acting:
            controls = effect.drive(controls, values, self.task.timestep, elapsed=since, first=drives.first)
        return controls[:, past:], np.arange(len(each))

    def _before(self, hidden: np.ndarray) -> np.ndarray:
        """By how much controls before an episode began differed from its first, (simulation, nu)."""
        change = np.zeros((len(hidden), self.task.model.nu))
        return sum((own.effect.before(hidden[:, own.states]) for own in self._placed), change)


def _moving(parameters: np.ndarray, corrections: np.ndarray) -> np.ndarray:
    """Which candidates differ from the first, (candidate,)."""
    return (parameters != parameters[0]).any(axis=1) | (corrections != corrections[0]).any(axis=(1, 2))


def _driven(each: np.ndarray, hidden: np.ndarray, candidates: int) -> np.ndarray:
    """Which of so many candidates differ from the first by more than the model's own initial state, (candidate,)."""
    by = np.concatenate([each, hidden], axis=1).reshape(candidates, -1)
    return (by != by[0]).any(axis=1)


def _from(rollouts: Rollouts, steps: np.ndarray) -> Rollouts:
    """`rollouts` from so many `steps` (simulation,) on, which may be fractional."""
    grid = np.arange(rollouts.sensors.shape[1]) + steps[:, None]
    later = replace(rollouts, sensors=at_times(rollouts.sensors, grid[..., None]))
    if rollouts.qpos is None:
        return later
    index = np.minimum(np.rint(grid).astype(int), grid.shape[1] - 1)
    row = np.arange(len(steps))[:, None]
    return replace(
        later,
        qpos=rollouts.qpos[row, index],
        contacts=rollouts.contacts[row, index],
        limits=rollouts.limits[row, index],
        actuator_force=rollouts.actuator_force[row, index],
    )


def _distinct(
    parameters: np.ndarray, corrections: np.ndarray | None, windows: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Candidate and window of the simulations that differ, (simulation,) each, and which of them is meant where,
    (candidate, window). parameters (candidate, parameter); corrections (candidate, window, state), or None.
    """
    number, window = (i.ravel() for i in np.indices((len(parameters), windows)))
    asked = [window[:, None], parameters[number]]
    if corrections is not None:
        asked.append(corrections.reshape(len(number), -1))
    rows = np.concatenate(asked, axis=1)
    keys = rows.view(np.dtype((np.void, rows.itemsize * rows.shape[1]))).ravel()
    _, first, which = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(first)  # as they were asked for
    which = np.argsort(order)[which].reshape(len(parameters), windows)
    return number[first[order]], window[first[order]], which


def _between(controls: np.ndarray, row: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Controls (row, grid, nu) of `row` (simulation,) at fractional grid points (simulation, step).

    Of a part of a step it is the mean over the step.
    """
    before = np.floor(at).astype(int)
    left = controls[row[:, None], before]
    right = controls[row[:, None], np.minimum(before + 1, controls.shape[1] - 1)]
    return left + (at - before)[..., None] * (right - left)


def _by_length(grid_steps: np.ndarray) -> list[np.ndarray]:
    """Windows grouped so that none is stepped much further than it needs."""
    key = np.ceil(np.log(np.maximum(grid_steps, 2)) / np.log(SETTINGS.length_ratio) - 1e-9)
    return [np.flatnonzero(key == k) for k in np.unique(key)]
