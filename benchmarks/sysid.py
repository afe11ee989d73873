"""A whole fit by our least squares against every backend of `mujoco.sysid`: EMPS, 49 windows of 0.5 s.

All fit mass, damping, Coulomb friction and actuator bias to the same windows, from the same point, with the initial
states of the windows fixed, on all cores. Two objectives: "its residual", mujoco.sysid's own, in which each window is
divided by the norm of what was measured in it, and the "plain residual", the difference. The costs at the end are
computed by one and the same simulation, so that "the same optimum" is checked and not assumed.

The log is that of the real machine (nonlinearbenchmark.org) in $CAPTURE_REAL_DATA or ../shared/data; where there is
none, one recorded from a model of it.
"""

from __future__ import annotations

import contextlib
import io
import logging
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

from benchmarks import EMPS, REAL_DATA
from benchmarks.base import Benchmark, Figure, Result
from capture_cli.errors import OptionError
from capture_cli.estimate.prepare import prepare
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve.base import Data, Trial, run
from capture_cli.estimate.solve.least_squares import LeastSquares
from capture_cli.estimate.split import NewSplit
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks import load_task
from capture_cli.simulate.simulator import Simulator
from capture_cli.stages.import_log import import_log
from capture_cli.stages.record import record

OURS = "capture"
BACKENDS = ("mujoco", "scipy", "scipy_parallel_fd")  # the first is the default
WINDOWS = 49
REPEATS = {"its residual": 3, "plain residual": 1}  # the default backend takes half a minute for the latter
TARGET = 5.0
SAME_OPTIMUM = 1e-3  # relative difference of the costs


class SysidSpeed(Benchmark):
    summary = "a whole EMPS fit against every backend of mujoco.sysid, same windows, start and optimum"

    def run(self) -> Result:
        from mujoco import sysid

        if not hasattr(sysid, "optimize"):
            raise OptionError(
                "mujoco.sysid is not installed", cure="run `make bench`, or pip install 'mujoco[sysid]'"
            )
        logging.getLogger("absl").setLevel(logging.ERROR)
        prepared, source = _emps()
        result = Result(details={"log": source, "windows": WINDOWS, "objectives": {}})
        for objective in (_normalized(prepared), _plain(prepared)):
            ways = {OURS: lambda o=objective: _ours(prepared, o)}
            ways |= {f"mujoco.sysid, {b}": lambda o=objective, b=b: _theirs(prepared, o, b) for b in BACKENDS}
            fits = _interleaved(ways, REPEATS[objective.name])
            result.details["objectives"][objective.name] = _details(prepared, objective, fits)
            result.figures += _figures(objective.name, result.details["objectives"][objective.name])
        return result


# --- the problem ---


@dataclass(frozen=True)
class _Objective:
    """scale (window, 1, output) or (output,): what residuals are divided by."""

    name: str
    scale: np.ndarray
    is_sysids_own: bool


def _emps() -> tuple[PreparedLog, str]:
    """The first 49 windows of 0.5 s of the training log, and where it came from."""
    task = load_task(str(EMPS))
    data = REAL_DATA / "emps"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "emps.zarr"
        if data.is_dir():
            import_log(files=[data / "emps_train.csv"], task=str(EMPS), out=path)
            source = "emps_train.csv, measured"
        else:
            truth = {"mass": 95.0, "damping": 203.0, "coulomb": 20.0, "bias": -3.2}
            record(
                task=str(EMPS),
                out=path,
                parameters=truth,
                noise=1e-6,
                duration=25.0,
                rate=1000,
                amplitude={"drive": 5},
            )
            source = "recorded from a model of the machine"
        log = MeasuredLog.read(path)
    prepared = prepare(log, task, window=0.5, split=NewSplit("none"))
    return prepared.part(np.arange(WINDOWS)), source


def _normalized(prepared: PreparedLog) -> _Objective:
    norm = np.linalg.norm(prepared.windows.measured[:, :-1], axis=1, keepdims=True) / np.sqrt(2)
    return _Objective("its residual", norm, is_sysids_own=True)


def _plain(prepared: PreparedLog) -> _Objective:
    return _Objective("plain residual", np.full(len(prepared.task.outputs), 1e-3), is_sysids_own=False)  # mm


def _start(prepared: PreparedLog) -> np.ndarray:
    return prepared.task.space.nominal  # off the bounds, where mujoco.sysid can stall


def _cost(prepared: PreparedLog, objective: _Objective, point: np.ndarray) -> float:
    """Sum of squared residuals at `point` (parameter,)."""
    still = np.zeros((1, *prepared.initial.sd.shape))
    outputs, _ = prepared.evaluate(Simulator(prepared.task), Trial(point[None], still))
    residual = (prepared.windows.measured - outputs[0]) / objective.scale
    return float(np.square(residual[prepared.windows.mask]).sum())


# --- the ways to solve it: each gives the parameters (parameter,) ---


def _ours(prepared: PreparedLog, objective: _Objective) -> np.ndarray:
    simulator = Simulator(prepared.task)
    windows = prepared.windows
    # far below the error, as a noise floor is: the model does not explain this log
    noise = 1e-4 * objective.scale
    fixed = np.zeros_like(prepared.initial.sd)
    data = Data(simulator.space, windows.measured, windows.sampled, noise, fixed)
    solver = LeastSquares(data, start=_start(prepared), starts=1)
    return run(solver, lambda trial: prepared.evaluate(simulator, trial)).parameters


def _theirs(prepared: PreparedLog, objective: _Objective, backend: str) -> np.ndarray:
    from mujoco import sysid

    parameters = sysid.ParameterDict()
    for p, value in zip(prepared.task.space, _start(prepared), strict=True):
        parameters.add(
            sysid.Parameter(
                p.name, nominal=value, min_value=p.low, max_value=p.high, modifier=_MODIFIERS[p.name]
            )
        )
    options = {} if objective.is_sysids_own else {"modify_residual": _difference(objective)}
    residual = sysid.build_residual_fn(models_sequences=[_sequences(prepared)], **options)
    with contextlib.redirect_stdout(io.StringIO()):  # its progress
        found, _ = sysid.optimize(
            initial_params=parameters, residual_fn=residual, optimizer=backend, verbose=False
        )
    return found.as_vector()


def _sequences(prepared: PreparedLog):
    """The windows as mujoco.sysid has them. The position is observed as a state: its sensors lag by one step."""
    from mujoco import sysid

    task, windows, initial = prepared.task, prepared.windows, prepared.initial.states
    states, controls, measured = [], [], []
    for w, samples in enumerate(windows.samples):
        clock = task.timestep * np.arange(samples)
        states.append(sysid.create_initial_state(task.model, initial.qpos[w], initial.qvel[w]))
        controls.append(sysid.TimeSeries(clock, windows.controls[w, :samples]))
        measured.append(
            sysid.TimeSeries.from_names(
                clock,
                windows.measured[w, :samples],
                task.model,
                names=[("x", sysid.SignalType.MjStateQPos)],
            )
        )
    spec = mujoco.MjSpec.from_file(str(task.model_path))
    names = [f"window {w}" for w in range(len(windows))]
    return sysid.ModelSequences("emps", spec, names, states, controls, measured)


def _difference(objective: _Objective) -> Callable:
    def residual(params, predicted, measured, model, return_pred_all, state, sensor_weights=None):
        return (state[:, 1:2] - measured.data[1:]) / objective.scale, measured, measured

    return residual


def _set_mass(spec, parameter) -> None:
    spec.body("carriage").first_geom().mass = float(parameter.value[0])


def _set_damping(spec, parameter) -> None:
    spec.joint("x").damping = np.array([parameter.value[0], 0, 0])


def _set_coulomb(spec, parameter) -> None:
    spec.joint("x").frictionloss = float(parameter.value[0])


def _set_bias(spec, parameter) -> None:
    actuator = spec.actuator("drive")
    actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    actuator.biasprm = np.array([parameter.value[0], *np.zeros(len(actuator.biasprm) - 1)])


_MODIFIERS = {"mass": _set_mass, "damping": _set_damping, "coulomb": _set_coulomb, "bias": _set_bias}


# --- timing and figures ---


@dataclass
class _Fit:
    """Where it ended, and the wall and CPU seconds of every repeat."""

    point: np.ndarray | None = None
    seconds: list[float] = field(default_factory=list)
    cpu_seconds: list[float] = field(default_factory=list)


def _interleaved(ways: dict[str, Callable[[], np.ndarray]], repeats: int) -> dict[str, _Fit]:
    """Every way once, one after the other, and again, `repeats` times."""
    fits = {name: _Fit() for name in ways}
    for _ in range(repeats):
        for name, solve in ways.items():
            wall, cpu = time.perf_counter(), time.process_time()
            fits[name].point = solve()
            fits[name].seconds.append(time.perf_counter() - wall)
            fits[name].cpu_seconds.append(time.process_time() - cpu)
    return fits


def _details(prepared: PreparedLog, objective: _Objective, fits: dict[str, _Fit]) -> dict:
    ours = fits[OURS]
    return {
        name: {
            "seconds": fit.seconds,
            "cpu_seconds": fit.cpu_seconds,
            "times_ours": _ratio(fit.seconds, ours.seconds),
            "times_ours_cpu": _ratio(fit.cpu_seconds, ours.cpu_seconds),
            "cost": _cost(prepared, objective, fit.point),
            "parameters": prepared.task.space.to_dict(fit.point),
        }
        for name, fit in fits.items()
    }


def _ratio(these: list[float], those: list[float]) -> float:
    return float(np.median(np.array(these) / np.array(those)))


def _figures(objective: str, ways: dict) -> list[Figure]:
    others = [w for name, w in ways.items() if name != OURS]
    lowest = min(w["cost"] for w in ways.values())
    return [
        Figure(
            f"fastest mujoco.sysid backend / ours, {objective}",
            min(w["times_ours"] for w in others),
            target=(TARGET, None),
        ),
        Figure("  the same in CPU seconds", min(w["times_ours_cpu"] for w in others)),
        *(Figure(f"  {name}", float(np.median(w["seconds"])), "s") for name, w in ways.items()),
        Figure(
            f"our cost above the lowest of all, {objective}",
            ways[OURS]["cost"] / lowest - 1,
            target=(None, SAME_OPTIMUM),
        ),
    ]
