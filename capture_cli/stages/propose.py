"""`capture propose`: an estimate or a diagnosis in, the next action to run on the machine out, as JSON."""

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.context.checkpoints.policy_checkpoint import load_policy
from capture_cli.errors import OptionError
from capture_cli.estimate.initial_states.from_outputs import model_initial_states
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks.base import ActionTask, Task
from capture_cli.options.base import takes_options
from capture_cli.options.propose import ProposeOptions
from capture_cli.select.experiment.excitation_range import ExcitationRange
from capture_cli.select.experiment.expected_information import Axes, information, sensitivities
from capture_cli.select.experiment.next_experiment import SETTINGS as NEXT_EXPERIMENT
from capture_cli.select.experiment.next_experiment import (
    driven_motion,
    driven_windows,
    experiment_sequence,
    experiment_times,
)
from capture_cli.select.recorded_effects import placed_effects, recorded_effects, recorded_values
from capture_cli.simulate.multisine import SETTINGS as MULTISINE
from capture_cli.simulate.multisine import check_above_zero, check_amplitude, multisine_sequence, peak, peaks
from capture_cli.simulate.simulator import Simulator
from capture_cli.stages.excitation.drive import Drive, acted
from capture_cli.stages.excitation.planned_episodes import Known, planned
from capture_cli.stages.recorded.found_model import kind_of, proposed_machine
from capture_cli.stages.recorded.recorded_estimate import RecordedEstimate
from capture_cli.stages.recorded.recorded_task import task_inputs
from capture_cli.store.diagnosis import EXPERIMENT, Diagnosis
from capture_cli.store.document_shape import NUMBER, check_shape, or_none
from capture_cli.store.estimate import Estimate
from capture_cli.store.output import PROVENANCE, refuse_inputs, sha256
from capture_cli.store.proposal import FORMAT, VERSION, ProposalRecord


@frozen
class SETTINGS:
    strongest: int = 2  # of a band: multisines whose information is compared


@takes_options
def propose(options: ProposeOptions) -> dict[str, Any]:
    """What to do next, given the estimate or diagnosis directory `result`: the document of proposal.json.

    Of a task of actions, the candidate that tells most about what the estimate leaves open; with a policy, the action
    it chooses for the estimate. Of any other machine, the most telling of a menu of multisines that peak at `amplitude`
    or below (what the log's inputs peaked at where not given), of those under which the model stays near what the log
    shows; of all of them with `beyond_log`. Of a diagnosis, the experiment that would separate what is tied. Raises
    CaptureError.
    """
    result, amplitude, policy = options.result, options.amplitude, options.policy
    machine, log = proposed_machine(result, options.task)
    for path, option in ((options.out, "--out"), (options.csv, "--csv")):
        if path is not None:
            refuse_inputs(path, [result, log, policy, *task_inputs(machine).values()], option=option)
    check_amplitude(machine, amplitude)
    check_above_zero(machine, amplitude, "the log did")
    if kind_of(result) is Diagnosis:
        if policy is not None:
            raise OptionError(
                f"--policy: {result} is a diagnosis, whose next experiment is proposed",
                cure="leave it out, or propose from the estimate",
            )
        return _of_diagnosis(machine, options)
    recorded = RecordedEstimate.read(result)
    recorded.check_task(machine, "give the task it was made with (--task), or identify again")
    estimate = recorded.estimate
    generator = np.random.default_rng([options.seed, recorded.episodes])  # another draw after every episode
    known = Known.of(machine, estimate, _window(recorded))
    if isinstance(machine, ActionTask):
        if amplitude:
            raise OptionError(f"--amplitude: {machine.name!r} is driven by actions", cure="leave it out")
        if options.beyond_log:
            raise OptionError(f"--beyond-log: {machine.name!r} is driven by actions", cure="leave it out")
        if policy is not None:
            return _by_policy(machine, policy, estimate, generator)
        return _doubted(_action(machine, known, options, generator), estimate)
    if policy is not None:
        raise OptionError(f"--policy: {machine.name!r} has no actions", cure="leave it out")
    farthest = _farthest(result, machine, estimate, amplitude)
    shown = _shown(machine, estimate, known)
    return _doubted(_multisine(machine, known, farthest, shown, options, generator), estimate)


def _doubted(proposed: dict[str, Any], estimate: Estimate) -> dict[str, Any]:
    """The proposal for the estimate, with a warning where the model lacks something."""
    if estimate.record.verdict != "unexplained":
        return proposed
    doubt = "; the model does not explain its log, and then what is expected means little"
    return {**proposed, "text": proposed["text"] + doubt}


def _window(recorded: RecordedEstimate) -> float | None:
    """s, what --window said when the estimate was made."""
    where = f"{recorded.path / PROVENANCE}: options"
    check_shape(recorded.options, {"window?": or_none(NUMBER)}, where, Estimate.KIND.cure)
    return recorded.options.get("window")


# --- what an episode would add ---


def _most_telling(
    task: Task, driven: Drive, known: Known, threads: int | None, cure: str
) -> tuple[int, np.ndarray, dict[str, Any]]:
    """Which episode of `driven` adds most to the estimate, what each adds (episode,), nats, and the expected numbers.

    -inf of one that diverges. Raises OptionError where all do.
    """
    gains, left = np.full(len(driven.ends), -np.inf), {}
    prepared, sound = planned(task, driven, known, threads)
    if prepared is not None:
        simulator = Simulator(task, threads=threads, difference_step=prepared.difference_step)
        axes = Axes.of(simulator.space, known.covariance)
        told = sensitivities(prepared, simulator, known.point, axes)
        k = known.inflation(float(driven.time[1] - driven.time[0]))
        for number, episode in enumerate(sound):
            own = prepared.windows.episode == number
            if not told.diverged[own].any():
                gains[episode], left[episode] = information(told.precision(own, k))
    if not left:
        raise OptionError(f"task {task.name!r} diverges under everything that was tried", cure=cure)
    best = int(np.argmax(gains))
    sd = np.sqrt(np.diag(axes.covariance(left[best]))) * task.space.span
    expected = {"information": float(gains[best]), "expected_sd": task.space.to_dict(sd)}
    return best, gains, expected


# --- kinds of proposals ---


def _action(task: ActionTask, known: Known, options: ProposeOptions, generator) -> dict[str, Any]:
    candidates = options.candidates
    actions = task.draw_actions(generator.random((candidates, len(task.actions))))
    driven = acted(task, actions, rate=1 / max(known.interval, task.timestep))
    cure = "compare more actions (--candidates), or another --seed"
    best, gains, expected = _most_telling(task, driven, known, options.threads, cure)
    middle = np.median(gains[np.isfinite(gains)])
    text = f"the most telling of {candidates} actions: {gains[best]:.2g} nats, their median {middle:.2g}"
    return {**_head(task, "action", text), "action": _values(task, actions[best]), **expected}


def _by_policy(task: ActionTask, policy: str, estimate: Estimate, generator) -> dict[str, Any]:
    chosen = load_policy(policy, task)
    parameters = np.asarray(estimate.arrays["parameter/estimate"])[None]
    action = chosen.act(parameters, generator.random((1, len(task.actions))))[0]
    return {**_head(task, "action", f"as the policy {policy} acts"), "action": _values(task, action)}


def _multisine(
    task: Task, known: Known, farthest: np.ndarray, shown: ExcitationRange, options: ProposeOptions, generator
) -> dict[str, Any]:
    """Of every band the two strongest that stay near what the log shows are compared."""
    threads, beyond_log = options.threads, options.beyond_log
    time = experiment_times(task)
    bands = (*NEXT_EXPERIMENT.bands, MULTISINE.band)
    sequences = np.stack(
        [
            multisine_sequence(
                task, time, share * farthest, band, np.random.default_rng(phases), at_rest=True
            )
            for band, phases in zip(bands, generator.integers(2**32, size=len(bands)), strict=True)
            for share in NEXT_EXPERIMENT.shares
        ]
    )
    windows = driven_windows(task, time, sequences)
    outputs, qpos, diverged = driven_motion(Simulator(task, threads=threads), windows, known.point)
    predicted = shown.predicted(outputs, qpos, float(time[1]))
    may = ~diverged if beyond_log else ~diverged & shown.nearest(predicted, ~diverged)
    chosen = _strongest(may, len(bands))
    driven = Drive(
        time=np.tile(time, len(chosen)),
        inputs=np.concatenate(sequences[chosen]),
        ends=len(time) * (1 + np.arange(len(chosen))),
        initial=model_initial_states(task.model, len(chosen)).states,
    )
    cure = "drive it less: --amplitude NAME=VALUE"
    at, gains, expected = _most_telling(task, driven, known, threads, cure)
    best = int(chosen[at])
    where = shown.where_to(predicted, best, "it does not stay" if beyond_log else "none that was tried stays")
    judged = shown.judged(predicted, best)
    is_mildest = not (beyond_log or judged["is_near"])
    what = f"mildest of {len(sequences)}" if is_mildest else f"most telling of {len(chosen)}"
    text = f"the {what} multisines from rest: {gains[at]:.2g} nats; {where}"
    return {
        **_head(task, "inputs", text),
        **_sequence(task, bands[best // len(NEXT_EXPERIMENT.shares)], time, sequences[best]),
        **expected,
        **judged,
    }


def _strongest(may: np.ndarray, bands: int) -> np.ndarray:
    """Numbers of the strongest `strongest` of each band that `may` be compared, (multisine,), band after band, the
    strongest first; all where none may.
    """
    if not may.any():
        return np.arange(len(may))
    return np.flatnonzero(may & (np.cumsum(may.reshape(bands, -1), axis=1).ravel() <= SETTINGS.strongest))


def _shown(task: Task, estimate: Estimate, known: Known) -> ExcitationRange:
    """How far the log of an estimate shows that the machine went."""
    names = ("time", "window", "measured", "simulated")
    steps = {name: np.asarray(estimate.arrays[f"step/{name}"]) for name in names}
    return ExcitationRange.of(task, known.noise.sd, **steps)


def _of_diagnosis(task: Task, options: ProposeOptions) -> dict[str, Any]:
    folder, amplitude = options.result, options.amplitude
    found = Diagnosis.read_document(folder)
    experiment = found.get("next_experiment")
    if experiment is None:
        raise OptionError(
            f"{folder} has no next experiment: its verdict is {found['verdict']!r}, and nothing is tied that "
            "one of its menu would separate",
            cure="propose from the estimate instead: capture propose ESTIMATE",
        )
    check_shape(experiment, EXPERIMENT, f"{folder / 'diagnosis.json'}: next_experiment", Diagnosis.KIND.cure)
    if options.beyond_log and (farther := experiment.get("beyond_log")):
        where = f"{folder / 'diagnosis.json'}: next_experiment.beyond_log"
        check_shape(farther, EXPERIMENT, where, Diagnosis.KIND.cure)
        experiment = farther
    farthest = [
        peak(task.model, c, amplitude) if c.name in amplitude else p
        for c, p in zip(task.inputs, experiment["peaks"], strict=True)
    ]
    # an experiment of an earlier version has no seed: that of the proposal drives it
    time, sequence = experiment_sequence(task, {"seed": options.seed, **experiment, "peaks": farthest})
    judged = {k: experiment[k] for k in ("is_near", "predicted") if k in experiment}
    text = experiment["text"]
    if not judged:
        text += "; where it takes the machine is not known: make the diagnosis again (capture diagnose)"
    elif amplitude:
        where, judged = _driven_to(task, found, experiment, time, sequence, options.threads)
        told = ", ".join(f"{name} {value:g}" for name, value in amplitude.items())
        text += f" (as diagnosed); with peaks of {told}, as told, {where}"
    return {**_head(task, "inputs", text), **_sequence(task, experiment["band_hz"], time, sequence), **judged}


def _driven_to(
    task: Task,
    diagnosis: Mapping[str, Any],
    experiment: Mapping[str, Any],
    time: np.ndarray,
    sequence: np.ndarray,
    threads: int | None,
) -> tuple[str, dict[str, Any]]:
    """Where the diagnosed model is taken by inputs (step, input) that the `experiment` did not judge: in words, and as
    `ExcitationRange.judged`. Raises OptionError where it diverges.
    """
    values = recorded_values(diagnosis["parameters"], task.space, "the diagnosis", "diagnose")
    effects = recorded_effects(diagnosis["effects"], task, "diagnose")
    placed = [placed for placed, _ in placed_effects(effects)]
    point = np.concatenate([values, *(own for _, own in effects.values())])
    windows = driven_windows(task, time, sequence[None])
    outputs, qpos, diverged = driven_motion(Simulator(task, placed, threads), windows, point)
    if diverged.any():
        raise OptionError(
            f"task {task.name!r} diverges when driven so", cure="drive it less: --amplitude NAME=VALUE"
        )
    shown = ExcitationRange.from_document(task, experiment["predicted"])
    predicted = shown.predicted(outputs, qpos, float(time[1]))
    return shown.where_to(predicted, 0, "it does not stay"), shown.judged(predicted, 0)


def _head(task: Task, kind: str, text: str) -> dict[str, Any]:
    return {"format": FORMAT, "version": VERSION, "task": task.name, "kind": kind, "text": text}


def _values(task: ActionTask, action: np.ndarray) -> dict[str, Any]:
    return {p.name: {"value": float(v), "unit": p.unit} for p, v in zip(task.actions, action, strict=True)}


def _sequence(task: Task, band, time: np.ndarray, sequence: np.ndarray) -> dict[str, Any]:
    inputs = {c.name: sequence[:, k] for k, c in enumerate(task.inputs)}
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
    log = estimate.record.log
    # estimates of earlier versions have no peaks
    return peaks(task, (log.get("input_peaks") or recorded_log(folder, log).input_peaks) | dict(amplitude))


def recorded_log(result: Path, recorded: Mapping[str, Any]) -> MeasuredLog:
    """The log of the directory `result`, of which it recorded path and sha256.

    It is looked for from here, from the folder of `result`, and in that folder. Raises OptionError where none of these
    is the log as it was then, StoreError where it cannot be read.
    """
    path, beside = Path(recorded["path"]), Path(result).resolve().parent
    there = [p for p in (path, beside / path, beside / path.name) if p.is_dir()]
    for place in there:
        if sha256(place) == recorded["sha256"]:
            return MeasuredLog.read(place)
    found = f"{there[0]} has changed since" if there else "it is neither here nor beside it"
    raise OptionError(
        f"{result} does not say how far the inputs of its log {path} went, and {found}",
        cure="say how far each input may be driven: --amplitude INPUT=VALUE; or identify again",
    )


def proposal_csv(document: Mapping[str, Any], result: Path, task: str | None) -> str:
    """The inputs of the proposal `document`, made of `result`, in the columns and units of the log; one row of actions.

    Raises CaptureError.
    """
    proposal = ProposalRecord.of(document)
    machine, _ = proposed_machine(Path(result), task)
    if isinstance(machine, ActionTask):
        values = {f"action.{name}": [action["value"]] for name, action in proposal.action.items()}
    else:
        values = {machine.log.time: [t / machine.log.time_scale for t in proposal.time_s]}
        for channel in machine.inputs:
            own = [(u - channel.offset) / channel.scale for u in proposal.inputs[channel.name]]
            if values.setdefault(channel.column, own) != own:
                raise OptionError(
                    f"--csv: column {channel.column!r} drives several inputs, and what is proposed for them differs",
                    cure="give each its own column in the task.toml, or take the JSON",
                )
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(values)
    writer.writerows([f"{v:.9g}" for v in row] for row in zip(*values.values(), strict=True))
    return text.getvalue()
