"""`capture propose`: an estimate or a diagnosis in, the next action to run on the machine out, as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.errors import OptionError
from capture_cli.multisine import check_above_zero, check_amplitude, multisine_tape, peak, peaks
from capture_cli.protocol.next_experiment import (
    BANDS,
    SHARES,
    driven_window,
    experiment_tape,
    experiment_times,
)
from capture_cli.sim.starts import model_starts
from capture_cli.simulator import Simulator
from capture_cli.stages.policy_checkpoint import load_policy
from capture_cli.stages.recorded_log import recorded_log
from capture_cli.stages.recorded_task import load_recorded, task_inputs
from capture_cli.stores.diagnosis import EXPERIMENT, Diagnosis
from capture_cli.stores.document_shape import check_shape
from capture_cli.stores.estimate import Estimate
from capture_cli.stores.output import refuse_inputs
from capture_cli.stores.proposal import FORMAT, VERSION
from capture_cli.stores.result import Result, read_provenance
from capture_cli.tasks.base import ActionTask, Task

CANDIDATES = 48  # actions that are compared
LARGEST_SD, SMALLEST_SD = 0.3, 2e-3  # of the range: how far from the estimate it is looked, along each axis
WIDER = (1, 4, 16, 64)  # times that far, in turn, until some action would tell something
LABEL_SD = 0.5  # of a feature that has no noise of its own, over its scale: what a label may be wrong by


def propose(
    *,
    result: Path,
    task: str | None = None,
    policy: str | None = None,
    candidates: int = CANDIDATES,
    amplitude: Mapping[str, float] | None = None,
    seed: int = 0,
    threads: int | None = None,
    out: Path | None = None,
) -> dict[str, Any]:
    """What to do next, given the estimate or diagnosis directory `result`: the document of proposal.json.

    Of a task of actions, the one of `candidates` random actions that tells most about what the estimate leaves open;
    with `policy`, the action it chooses for the estimate. Of any other machine, the most telling of a menu of
    multisines that peak at `amplitude` or below (what the log's inputs peaked at where not given). Of a diagnosis, the
    experiment that would separate what is tied. out: where the document will go. Raises CaptureError.
    """
    diagnosed = (Path(result) / "diagnosis.json").is_file()
    machine, log = _machine(Path(result), task, Diagnosis if diagnosed else Estimate)
    if out is not None:
        refuse_inputs(out, [result, log, policy, *task_inputs(machine).values()])
    check_amplitude(machine, amplitude or {})
    check_above_zero(machine, amplitude or {}, "the log did")
    if diagnosed:
        if policy is not None:
            raise OptionError(
                f"--policy: {result} is a diagnosis, whose next experiment is proposed",
                cure="leave it out, or propose from the estimate",
            )
        return _of_diagnosis(Path(result), machine, amplitude or {}, seed)
    estimate = Estimate.read(Path(result))
    if (
        estimate.document["task"] != machine.name
        or tuple(estimate.document["parameters"]) != machine.space.names
    ):
        raise OptionError(
            f"{result} is of the task {estimate.document['task']!r} with "
            f"({', '.join(estimate.document['parameters'])}); this one is {machine.name!r} with "
            f"({', '.join(machine.space.names)})",
            cure="give the task it was made with (--task), or identify again",
        )
    measured = int(estimate.document["rollouts"]["measured"])
    generator = np.random.default_rng([seed, measured])  # another draw after every episode
    simulator = Simulator(machine, threads=threads)
    if isinstance(machine, ActionTask):
        if amplitude:
            raise OptionError(f"--amplitude: {machine.name!r} is driven by actions", cure="leave it out")
        if policy is not None:
            return _by_policy(machine, policy, estimate, generator)
        return _action(simulator, estimate, candidates, generator)
    if policy is not None:
        raise OptionError(f"--policy: {machine.name!r} has no actions", cure="leave it out")
    return _multisine(Path(result), simulator, estimate, amplitude or {}, generator)


def _machine(folder: Path, task: str | None, kind: type[Result]) -> tuple[Task, str]:
    """The task of the result in `folder`, and where its log was."""
    log = kind.read_document(folder)["log"]["path"]
    provenance = read_provenance(folder, kind.CURE)
    return load_recorded(folder, provenance, task, log), log


# --- how much an episode would tell ---


def sigma_points(space, estimate: np.ndarray, covariance: np.ndarray, wider: float = 1) -> np.ndarray:
    """Pairs of points (2 axis, parameter), `wider` sd either side of the estimate along each axis of its covariance.

    They are differences over what is open, not derivatives: so a label, which has none, is judged alike.
    """
    x = space.to_unit(estimate)
    steps = wider * _axes(space, covariance).T
    return space.from_unit(np.clip(np.concatenate([x + steps, x - steps]), 0, 1))


def _axes(space, covariance: np.ndarray) -> np.ndarray:
    """Axes of a covariance in the unit cube, one sd long, within limits (parameter, axis)."""
    values, axes = np.linalg.eigh(covariance / np.outer(space.span, space.span))
    return axes * np.clip(np.sqrt(np.maximum(values, 0)), SMALLEST_SD, LARGEST_SD)


def information(outputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Expected information (n,), nats, and what is left of each axis' variance (n, axis).

    outputs (n, 2 axis, d) at the sigma points, in units of the noise: G, half their differences, gives the gain
    log det(1 + G'G) / 2 (Lindley 1956, for Gaussians), by which a D-optimal experiment is chosen.
    """
    axes = outputs.shape[1] // 2
    half = (outputs[:, :axes] - outputs[:, axes:]) / 2
    precision = np.eye(axes) + half @ half.swapaxes(1, 2)
    return np.linalg.slogdet(precision)[1] / 2, np.linalg.inv(precision)


def _sd_after(space, covariance: np.ndarray, left: np.ndarray) -> dict[str, float]:
    """Standard deviations (by name) that are to be expected, left (axis, axis) of what the axes had."""
    spread = _axes(space, covariance)
    sd = np.sqrt(np.diag(spread @ left @ spread.T)) * space.span
    return dict(zip(space.names, np.minimum(sd, np.sqrt(np.diag(covariance))).tolist(), strict=True))


# --- kinds of proposals ---


def _action(simulator: Simulator, estimate: Estimate, candidates: int, generator) -> dict[str, Any]:
    task: ActionTask = simulator.task
    covariance = np.asarray(estimate.arrays["parameter/covariance"])
    actions = task.draw_actions(generator.random((candidates, len(task.actions))))
    floor = estimate.document["noise_floor"]
    noise = np.array([floor.get(f.name) or LABEL_SD * f.scale for f in task.features])
    for wider in WIDER:
        points = sigma_points(
            task.space, np.asarray(estimate.arrays["parameter/estimate"]), covariance, wider
        )
        trajectories, diverged = simulator.trajectories(
            np.tile(points, (candidates, 1)), np.repeat(actions, len(points), axis=0)
        )
        scaled = (trajectories / noise).reshape(candidates, len(points), -1)
        gain, left = information(np.nan_to_num(scaled))
        gain = np.where(diverged.reshape(candidates, -1).any(axis=1), -np.inf, gain)
        if gain.max() > 0:
            break
    best = int(np.argmax(gain))
    text = (
        f"the most telling of {candidates} actions: {gain[best]:.2g} nats, their median {np.median(gain):.2g}"
    )
    return {
        **_head(task, "action", text),
        "action": _values(task, actions[best]),
        "information": float(gain[best]),
        "expected_sd": _sd_after(
            task.space, covariance, left[best] if wider == 1 else np.eye(len(points) // 2)
        ),
    }


def _by_policy(task: ActionTask, policy: str, estimate: Estimate, generator) -> dict[str, Any]:
    chosen = load_policy(policy, task)
    parameters = np.asarray(estimate.arrays["parameter/estimate"])[None]
    action = chosen.act(parameters, generator.random((1, len(task.actions))))[0]
    return {**_head(task, "action", f"as the policy {policy} acts"), "action": _values(task, action)}


def _multisine(
    folder: Path, simulator: Simulator, estimate: Estimate, amplitude, generator
) -> dict[str, Any]:
    task = simulator.task
    covariance = np.asarray(estimate.arrays["parameter/covariance"])
    points = sigma_points(task.space, np.asarray(estimate.arrays["parameter/estimate"]), covariance)
    farthest = _farthest(folder, task, estimate, amplitude)
    noise = np.array([estimate.document["noise_floor"][c.name] for c in task.outputs])
    time = experiment_times(task)
    menu = [
        (band, multisine_tape(task, time, share * farthest, band, generator, at_rest=True))
        for band in BANDS
        for share in SHARES
    ]
    scaled, sound = [], []
    for _, tape in menu:
        windows = driven_window(task, time, tape)
        simulated = simulator.simulate(windows, model_starts(task.model, 1).starts, points)
        scaled.append((simulated.outputs[:, 0] / noise).reshape(len(points), -1))
        sound.append(not simulated.diverged.any() and bool(np.isfinite(scaled[-1]).all()))
    if not any(sound):
        raise OptionError(
            f"task {task.name!r} diverges under every multisine that was tried",
            cure="drive it less: --amplitude NAME=VALUE",
        )
    gain, left = information(np.nan_to_num(np.stack(scaled)))
    best = int(np.argmax(np.where(sound, gain, -np.inf)))
    band, tape = menu[best]
    return {
        **_head(
            task, "inputs", f"the most telling of {len(menu)} multisines from rest: {gain[best]:.2g} nats"
        ),
        **_tape(task, band, time, tape),
        "information": float(gain[best]),
        "expected_sd": _sd_after(task.space, covariance, left[best]),
    }


def _of_diagnosis(folder: Path, task: Task, amplitude: Mapping[str, float], seed: int) -> dict[str, Any]:
    found = Diagnosis.read_document(folder)
    experiment = found.get("next_experiment")
    if experiment is None:
        raise OptionError(
            f"{folder} has no next experiment: its verdict is {found['verdict']!r}, and nothing is tied that "
            "one of its menu would separate",
            cure="propose from the estimate instead: capture propose ESTIMATE",
        )
    check_shape(experiment, EXPERIMENT, f"{folder / 'diagnosis.json'}: next_experiment", Diagnosis.CURE)
    farthest = [
        peak(task.model, c, amplitude) if c.name in amplitude else p
        for c, p in zip(task.inputs, experiment["peaks"], strict=True)
    ]
    # one of before experiments kept their seed is driven by that of the proposal
    time, tape = experiment_tape(task, {"seed": seed, **experiment, "peaks": farthest})
    return {
        **_head(task, "inputs", experiment["text"]),
        **_tape(task, experiment["band_hz"], time, tape),
    }


def _head(task: Task, kind: str, text: str) -> dict[str, Any]:
    return {"format": FORMAT, "version": VERSION, "task": task.name, "kind": kind, "text": text}


def _values(task: ActionTask, action: np.ndarray) -> dict[str, Any]:
    return {p.name: {"value": float(v), "unit": p.unit} for p, v in zip(task.actions, action, strict=True)}


def _tape(task: Task, band, time: np.ndarray, tape: np.ndarray) -> dict[str, Any]:
    inputs = {c.name: tape[:, k] for k, c in enumerate(task.inputs)}
    return {
        "band_hz": [float(f) for f in band],
        "peaks": {name: float(np.abs(values).max()) for name, values in inputs.items()},
        "time_s": time.tolist(),
        "inputs": {name: values.tolist() for name, values in inputs.items()},
    }


def _farthest(folder: Path, task: Task, estimate: Estimate, amplitude: Mapping[str, float]) -> np.ndarray:
    """How far each input may be driven (input,): as told, else as its log did, which the machine has borne."""
    if not task.inputs:
        raise OptionError(f"task {task.name!r} has no inputs to drive", cure="there is nothing to propose")
    if {c.name for c in task.inputs} <= set(amplitude):
        return peaks(task, amplitude)
    log = estimate.document["log"]
    # estimates of before the peaks were kept have none
    return peaks(task, (log.get("input_peaks") or recorded_log(folder, log).input_peaks) | dict(amplitude))
