"""Many simulations of one model in lockstep, each with its own parameters, controls and start.

MuJoCo's `mujoco.batch` does the stepping on its thread pool; results are bit-identical for any number of threads.
"""

import ctypes
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from mujoco import _callbacks, batch

from capture_cli.common.processes import own_threads
from capture_cli.model.contacts import can_touch
from capture_cli.model.fields import ModelFields
from capture_cli.model.mujoco_warnings import silence_mujoco
from capture_cli.model.states import InitialStates
from capture_cli.model.world import APPLIED, Force, World

# Working memory of one chunk of simulations: controls and recorded sensors.
CHUNK_BYTES = 256 << 20
CHUNK_SIMULATIONS = 8192


STATES = ("qpos", "qvel", "act")
WORKED_OUT = ("ncon", "nl", "actuator_force")  # in a step, of the state before it
REMEMBERED = "remembered"  # by forces, before a step


def leave_steps_untimed() -> None:
    """Keep MuJoCo from reading the clock some twenty times in each step, for timers that nobody reads here.

    In small machines that takes a third of a step. `mujoco.set_mjcb_time(None)` brings the clock of the Python bindings
    back, so this takes it out of MuJoCo itself, where the platform lets one find it.
    """
    try:
        clock = ctypes.c_void_p.in_dll(ctypes.CDLL(_callbacks.__file__), "mjcb_time")
    except (OSError, ValueError):
        return
    clock.value = None


@dataclass(frozen=True)
class Rollouts:
    """sensors (simulation, step, sensordata): at time start + step * dt. diverged (simulation,): do not believe.

    qpos, qvel, act (simulation, step, ...): the states, where asked for; with them contacts (simulation, step), how
    many, limits (simulation, step), how many joints and tendons are at an end of their range, and actuator_force
    (simulation, step, actuator), N or N m at the actuator, which may be asked for alone. remembered (simulation, step,
    number): by the forces, one after the other, before each step but the first; None without forces.
    """

    sensors: np.ndarray
    diverged: np.ndarray
    qpos: np.ndarray | None = None
    qvel: np.ndarray | None = None
    act: np.ndarray | None = None
    contacts: np.ndarray | None = None
    limits: np.ndarray | None = None
    actuator_force: np.ndarray | None = None
    remembered: np.ndarray | None = None


@dataclass(frozen=True)
class SingleSteps:
    """Each (begin, simulation, ...): what sensors show and actuators give, N or N m, before a step, and after it the
    states (begin * simulation), and what forces remember (begin * simulation, number).
    """

    sensors: np.ndarray
    actuator_force: np.ndarray
    ends: InitialStates
    remembered: np.ndarray


@dataclass(frozen=True)
class Keep:
    """What is kept of simulations: `columns` of sensordata (all where None); with `states` also these, contacts, limits
    and forces of actuators, which `actuator_forces` keeps alone; with `remembered` what forces remember.
    """

    columns: np.ndarray | None = None
    states: bool = False
    actuator_forces: bool = False
    remembered: bool = False

    @property
    def fields(self) -> tuple[str, ...]:
        """Of MjData, beside sensordata."""
        return (*STATES, *WORKED_OUT) if self.states else ("actuator_force",) if self.actuator_forces else ()


SENSORS = Keep()


class Engine:
    """Steps many simulations of `model` on `threads` threads (all cores where None); `rollouts`: how many so far.

    on_work is called before each call of `rollout`, which it may end by raising.
    """

    def __init__(self, model: mujoco.MjModel, threads: int | None = None):
        silence_mujoco()
        leave_steps_untimed()
        self.model = _without_idle_stages(model)
        self.threads = threads or 0
        self.rollouts = 0
        self.on_work: Callable[[], None] = lambda: None

    def rollout(
        self,
        initial: InitialStates,
        controls: np.ndarray,
        *,
        row: np.ndarray | None = None,
        fields: ModelFields | None = None,
        forces: Sequence[Force] = (),
        keep: Keep = SENSORS,
    ) -> Rollouts:
        """Step every simulation once for each of its controls, and record its sensors before each step.

        controls: (row, step, nu); simulation i is driven by controls[row[i]] (row i where None).
        fields: per-simulation model values; constants that derive from them are recomputed. They say how many of the
        simulations' own time steps make one step.

        A simulation in which MuJoCo warns of divergence is held from there on and marked.
        """
        self.on_work()
        count = len(initial)
        row = np.arange(count) if row is None else row
        columns = slice(None) if keep.columns is None else keep.columns
        substeps = 1 if fields is None else fields.substeps
        fields_kept = ["sensordata", *keep.fields, *[REMEMBERED] * bool(keep.remembered and forces)]
        recorded: dict[str, list[np.ndarray]] = {name: [] for name in fields_kept}
        diverged = []
        size = self._chunk(controls.shape[1] * substeps)
        for first in range(0, count, size):
            rows = np.arange(first, min(count, first + size))
            runner = self._prepare(rows, initial, fields)
            own = controls[row[rows]]
            chunk, bad = _step(runner, rows, own, forces, fields_kept, substeps)
            chunk["sensordata"] = chunk["sensordata"][..., columns]
            for name, values in chunk.items():
                recorded[name].append(values)
            diverged.append(bad | ~np.isfinite(chunk["sensordata"]).all(axis=(1, 2)))
        self.rollouts += count
        whole = {n: np.concatenate(parts) if len(parts) > 1 else parts[0] for n, parts in recorded.items()}
        return Rollouts(
            whole["sensordata"],
            np.concatenate(diverged),
            *(whole.get(n) for n in (*STATES, *WORKED_OUT, REMEMBERED)),
        )

    def single_steps(
        self,
        begins: InitialStates,
        controls: np.ndarray,
        fields: ModelFields,
        forces: Sequence[Force],
        remembered: np.ndarray,
    ) -> SingleSteps:
        """One step of every simulation from each of the states `begins` (begin * simulation), under the controls
        (begin, simulation, nu), with what forces have `remembered` (begin * simulation, number); fields and forces are
        as for `rollout`. They are no rollouts, and not counted as such.
        """
        self.on_work()
        count = controls.shape[1]
        rows = np.arange(count)
        runner = self._prepare(rows, begins.rows(rows), fields)
        states = {name: runner.bind(name) for name in (*STATES, "time")}
        shown, kept, known = ("sensordata", "actuator_force"), [], []
        for number, own in enumerate(controls):
            here = begins.rows(number * count + rows)
            for name, live in states.items():
                live[...] = getattr(here, name)
            runner.bind("qacc_warmstart")[...] = 0.0
            _recall(forces, remembered[number * count + rows])
            recorded, _ = _step_with_forces(runner, rows, own[:, None], forces, shown, fields.substeps)
            kept.append([*(recorded[n][:, 0] for n in shown), *(live.copy() for live in states.values())])
            known.append(_remembered(forces, count))
        sensors, actuator_force, *ends = (np.stack(each) for each in zip(*kept, strict=True))
        flat = (values.reshape(len(begins), *values.shape[2:]) for values in ends)
        return SingleSteps(sensors, actuator_force, InitialStates(*flat), np.concatenate(known))

    @cached_property
    def _shapes(self) -> mujoco.MjData:
        """What batches read shapes and types of fields off: to make one takes longer than to make a batch."""
        return mujoco.MjData(self.model)

    def _chunk(self, steps: int) -> int:
        row_bytes = 8 * steps * (self.model.nsensordata + self.model.nu + 1)
        return int(np.clip(CHUNK_BYTES // row_bytes, 1, CHUNK_SIMULATIONS))

    def _prepare(self, rows: np.ndarray, initial: InitialStates, fields: ModelFields | None) -> batch.Batch:
        # A batch costs a millisecond and is made anew: values of an earlier call cannot leak into this one.
        runner = batch.Batch(self.model, len(rows), min(own_threads(self.threads), len(rows)))
        runner._data = self._shapes  # which it would make for itself
        if fields is not None and fields.values:
            for name, values in fields.values.items():
                runner.expand(name)[...] = values[rows]
            if any(name in mujoco.MjModel._setconst_inputs for name in fields.values):
                runner.set_const()
        runner.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
        runner.warning[...] = 0
        runner.bind("qpos")[...] = initial.qpos[rows]
        runner.bind("qvel")[...] = initial.qvel[rows]
        if self.model.na:
            runner.bind("act")[...] = initial.act[rows]
        runner.bind("time")[...] = initial.time[rows]
        return runner


def _without_idle_stages(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy that leaves out of mj_step what does nothing in this model: the same bits, in 10 to 20 % less time."""
    idle = 0
    if not can_touch(model):
        idle |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    # islands part what constraints do not join, and say what may sleep; a single tree is in one piece
    if model.ntree == 1 and not model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP:
        idle |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    lean = copy(model)
    lean.opt.disableflags |= int(idle)
    return lean


Recorded = tuple[dict[str, np.ndarray], np.ndarray]


def _step(
    runner, rows, controls: np.ndarray, forces: Sequence[Force], names: Sequence[str], substeps: int
) -> Recorded:
    """Fields `names` (simulation, step, ...) before each step, and which simulations diverged (simulation,)."""
    if forces:
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # of one that runs away
            return _step_with_forces(runner, rows, controls, forces, names, substeps)
    if substeps > 1:
        controls = np.repeat(controls, substeps, axis=1)
    steps = controls.shape[1]
    start = {name: runner.bind(name).copy() for name in names if name in STATES}
    recorded = {name: _room(runner.bind(name), steps) for name in names}
    bad = np.zeros(len(rows), dtype=bool)
    try:
        runner.rollout(
            steps, controls if controls.shape[-1] else None, record=tuple(names), out=dict(recorded)
        )
    except batch.SimulationError as error:
        bad[error.ids] = True
    # States are recorded after each step, sensors describe the state before it.
    for name, first in start.items():
        recorded[name] = np.concatenate([first[:, None], recorded[name][:, :-1]], axis=1)
    bad |= _warnings(runner).any(axis=1)
    for values in recorded.values():
        for simulation in np.flatnonzero(bad):
            _hold(values[simulation])
    return {name: values[:, ::substeps] for name, values in recorded.items()}, bad


def _step_with_forces(
    runner, rows, controls: np.ndarray, forces: Sequence[Force], names: Sequence[str], substeps: int
) -> Recorded:
    world = World(runner, rows)
    ctrl, joint_force, body_force = (runner.bind(n) for n in ("ctrl", *APPLIED))
    live = {name: runner.bind(name) for name in names if name != REMEMBERED}
    recorded = {name: _room(view, controls.shape[1]) for name, view in live.items()}
    remembered = sum(force.remembers for force in _remembering(forces)) if REMEMBERED in names else 0
    if REMEMBERED in names:
        recorded[REMEMBERED] = np.zeros((len(rows), controls.shape[1], remembered))
    reports = [force.report for force in forces if hasattr(force, "report")]
    warnings = _warnings(runner)
    bad, any_bad = np.zeros(len(rows), dtype=bool), False
    for number in range(controls.shape[1] * substeps):
        step, inside = divmod(number, substeps)
        ctrl[...] = controls[:, step]
        joint_force[...] = 0.0
        body_force[...] = 0.0
        world.restore_varied()
        if step and not inside and remembered:
            recorded[REMEMBERED][:, step] = _remembered(forces, len(rows))
        for force in forces:
            force(world)
        if any_bad:
            joint_force[bad] = 0.0
            body_force[bad] = 0.0
            world.restore_varied(bad)
        for name in names:
            if name in STATES and not inside:
                recorded[name][:, step] = live[name]
        try:
            runner.step()
        except batch.SimulationError as error:
            bad[error.ids] = any_bad = True
        world.stepped = True
        if np.count_nonzero(warnings):  # in a fifth of the time of `any`
            bad |= warnings.any(axis=1)
            any_bad = True
        if inside:
            continue
        for name in names:
            if name in WORKED_OUT:
                recorded[name][:, step] = live[name]
        shown = live["sensordata"].copy() if reports else live["sensordata"]
        for report in reports:
            report(shown)
        recorded["sensordata"][:, step] = shown
        if any_bad and step:
            recorded["sensordata"][bad, step] = recorded["sensordata"][bad, step - 1]
    world.restore_varied()
    return recorded, bad


def _recall(forces: Sequence[Force], numbers: np.ndarray) -> None:
    """Let forces go on from what they remembered, (simulation, number), of all one after the other."""
    first = 0
    for force in _remembering(forces):
        force.recall(numbers[:, first : first + force.remembers])
        first += force.remembers


def _remembered(forces: Sequence[Force], simulations: int) -> np.ndarray:
    """What they do, (simulation, number)."""
    each = [force.remembered() for force in _remembering(forces)]
    return np.concatenate([np.zeros((simulations, 0)), *each], axis=1)


def _remembering(forces: Sequence[Force]) -> list[Force]:
    return [force for force in forces if getattr(force, "remembers", 0)]


def _hold(record: np.ndarray) -> None:
    """Keep the last that was simulated to the end of a record (step, ...), which MuJoCo ended with a reset state."""
    differs = np.flatnonzero((record != record[-1]).reshape(len(record), -1).any(axis=1))
    if differs.size:
        record[differs[-1] + 1 :] = record[differs[-1]]


def _room(view: np.ndarray, steps: int) -> np.ndarray:
    """For `steps` of a bound field (simulation, ...): (simulation, step, ...)."""
    return np.zeros((len(view), steps, *view.shape[1:]), dtype=view.dtype)


def _warnings(runner: batch.Batch) -> np.ndarray:
    """How often each simulation has raised each kind of warning so far, (simulation, kind): a live view."""
    return runner.warning[:, :, 1]
