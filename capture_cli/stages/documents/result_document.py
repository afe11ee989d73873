"""What the documents and arrays of an estimate and of a diagnosis have in common."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.common.quantities import bound, percent, scaled_unit, significant, with_unit
from capture_cli.errors import first_of
from capture_cli.estimate.held_out import HeldOut
from capture_cli.estimate.noise.lack_of_fit import LackOfFit
from capture_cli.estimate.noise.time_stamp_jitter import TimeStampJitter
from capture_cli.estimate.part_fit import PartFit
from capture_cli.estimate.prediction import Predicted, PredictionError, PredictionErrors, Runs
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve.intervals import Intervals
from capture_cli.estimate.time_step import ShorterStep
from capture_cli.log.checks.even_times import jitter
from capture_cli.log.input_sequences import Hold
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.effects.base import Effect
from capture_cli.model.fields import ModelFields
from capture_cli.model.mjcf.impossible_inertia import impossible_inertias
from capture_cli.model.parameters import ParameterSpace
from capture_cli.model.tasks.base import Task
from capture_cli.model.tasks.input_hold import keys_of
from capture_cli.simulate.simulator import InitialConditions
from capture_cli.stages.documents.undetermined_document import undetermined_of
from capture_cli.store.output import sha256


@frozen
class SETTINGS:
    most_named: int = 3  # parameters that a sentence says


@dataclass(frozen=True)
class FoundPoint:
    """space, point (parameter,), sure: the parameters of the task and, after them, those of effects; their values; and
    how well these are known. effects: each with its values (parameter,).
    """

    space: ParameterSpace
    point: np.ndarray
    sure: Intervals
    effects: Sequence[tuple[Effect, np.ndarray]] = ()


@dataclass(frozen=True)
class Judged:
    """What judges a point. held: the held-out windows. predicted: its errors in open loop, and those of other models.
    shorter: a shorter time step of the model. stamps: time-stamp jitter in what the point leaves.
    """

    held: HeldOut
    predicted: Predicted
    shorter: ShorterStep | None
    stamps: TimeStampJitter | None


def common_part(
    prepared: PreparedLog, found: FoundPoint, judged: Judged, parts: Mapping[str, np.ndarray], simulated: int
) -> dict[str, Any]:
    """The keys of the document that an estimate and a diagnosis have in common, by name.

    parts: which windows are of "fit", "test" and what else there is, (window,) each. simulated: windows.
    """
    task, log = prepared.task, prepared.log
    space, point = found.space, found.point
    declared = found.sure.rows(space, point, range(len(task.space)))
    return {
        "task": task.name,
        "log": {"path": str(log.path), "sha256": sha256(log.path)},
        "parameters": dict(zip(task.space.names, declared, strict=True)),
        "undetermined": undetermined_of(space, point, found.sure),
        **noise_floor_of(prepared),
        "prediction": prediction_of(prepared, judged.predicted),
        "held_out": held_out_of(prepared, space, point, judged.held, parts["test"]),
        "beyond_fitted": beyond_fitted_of(prepared, judged.held),
        "impossible_inertia": impossible_inertia_of(task, point[: len(task.space)], found.effects),
        "time_step": time_step_of(judged.shorter, space, point),
        "time_stamps": time_stamps_of(prepared, judged.stamps),
        "input_timing": input_timing_of(prepared),
        "split": {
            "how": prepared.split.how,
            **{f"{name}_windows": int(windows.sum()) for name, windows in parts.items()},
        },
        "rollouts": {"measured": len(log.episode_ends), "simulated": simulated},
    }


def error_of(prepared: PreparedLog, on: PartFit) -> dict[str, Any] | None:
    """RMSE and mean absolute error per output, in its unit, and RMSE over the noise floor.

    None where there is no sample; the numbers of an output are None where it has none.
    """
    if not on.data.count:
        return None
    return {
        "rmse": by_output(prepared, on.rmse),
        "mae": by_output(prepared, on.mae),
        "normalized": on.normalized,
    }


def noise_floor_of(prepared: PreparedLog) -> dict[str, Any]:
    """Standard deviation per output, in its unit, and where it comes from."""
    names, noise = [c.name for c in prepared.task.outputs], prepared.noise
    return {
        "noise_floor": dict(zip(names, noise.sd.tolist(), strict=True)),
        "noise_floor_source": dict(zip(names, noise.source, strict=True)),
    }


def lack_of_fit_of(prepared: PreparedLog, lacking: LackOfFit) -> dict[str, Any]:
    """The error of the fit over the noise floor, of all outputs and of each, and what chance allows."""
    return {
        "normalized": lacking.normalized,
        "threshold": lacking.threshold,
        "autocorrelation_time": lacking.autocorrelation_time,
        "outputs": by_output(prepared, lacking.outputs),
        "output_thresholds": by_output(prepared, lacking.output_thresholds),
        "lacking": lacking.lacking,
    }


def held_out_of(
    prepared: PreparedLog, space: ParameterSpace, point: np.ndarray, held: HeldOut, is_test: np.ndarray
) -> dict[str, Any] | None:
    """The parameters that explain the whole log, beside `space` at `point` (parameter,), and what they leave; None
    where the fit holds on what was held out, the windows `is_test` (window,), or no parameters do.
    """
    if held.whole is None:
        return None
    whole, found = PartFit.of(held.whole.at), held.whole.point
    parts = {"fit": whole.rows(~is_test), "test": whole.rows(is_test)}
    error = {name: error_of(prepared, part) for name, part in parts.items()}
    moves = np.abs(space.to_unit(found) - space.to_unit(point))
    most = space.parameters[int(np.argmax(moves))]
    value = with_unit(significant(space.to_dict(found)[most.name]), most.unit)
    return {
        "parameters": space.to_dict(found),
        "error": error,
        "text": (
            f"Held-out data tell more of {most.name} than fitted data: their error is "
            f"{significant(held.lack.normalized)} times the noise floor, and "
            f"{significant(error['test']['normalized'])} with {most.name} {value}, which explains the fitted data as "
            "well."
        ),
    }


def beyond_fitted_of(prepared: PreparedLog, held: HeldOut) -> dict[str, Any] | None:
    """The extrapolation in held-out windows, where the model does not hold there; None where there is none."""
    beyond = held.beyond
    if beyond is None:
        return None
    output = prepared.task.outputs[beyond.output]
    low, high, reached = (
        with_unit(significant(v), output.unit) for v in (beyond.low, beyond.high, beyond.reached)
    )
    return {
        "output": output.name,
        "unit": output.unit,
        "fitted": [beyond.low, beyond.high],
        "reached": beyond.reached,
        "share": beyond.share,
        "text": (
            f"{output.name} was fitted between {low} and {high}, and reaches {reached} in held-out windows with "
            f"{percent(beyond.share)} of the squared error."
        ),
    }


def impossible_inertia_of(
    task: Task, parameters: np.ndarray, effects: Sequence[tuple[Effect, np.ndarray]]
) -> list[dict[str, Any]]:
    """Bodies that cannot be, at `parameters` (parameter,) of the task and with each effect at its own values."""
    fields = ModelFields(task.model, 1)
    task.write(fields, parameters[None])
    for effect, values in effects:
        effect.write(fields, values[None])
    return [
        {"body": i.body, "moments": i.moments, "text": f"{_sentence(i.text)} {_sentence(i.cure)}"}
        for i in impossible_inertias(fields)
    ]


def time_step_of(
    shorter: ShorterStep | None, space: ParameterSpace, point: np.ndarray
) -> dict[str, Any] | None:
    """The parameters that shorter steps of the model would give instead of `space` at `point` (parameter,); None where
    they would give the same.
    """
    if shorter is None:
        return None
    would_be = {space.names[i]: (float(shorter.point[i]), float(point[i])) for i in shorter.moved}
    units = {p.name: p.unit for p in space.parameters}
    said = [
        f"{name} would be about {with_unit(significant(there), units[name])} ({significant(here)})"
        for name, (there, here) in list(would_be.items())[: SETTINGS.most_named]
    ]
    if shorter.error:
        there, here = (significant(error, 2) for error in shorter.error)
        said.append(f"the error would be about {there} times the noise floor ({here})")
    factor, unit = scaled_unit("s", shorter.finer)
    text = (
        f"The model's time step is in the estimate: in steps of {bound(shorter.finer * factor)} {unit}, and not "
        f'{bound(shorter.step * factor)}, {", ".join(said)}. Give the model a shorter timestep, or integrator="RK4".'
    )
    parameters = {name: there for name, (there, _) in would_be.items()}
    error = shorter.error and shorter.error[0]
    return {"finer": shorter.finer, "parameters": parameters, "error": error, "text": text}


def input_timing_of(prepared: PreparedLog) -> dict[str, Any] | None:
    """How inputs act between rows of which the task does not say it; None where the log does not tell."""
    if not prepared.input_timings:
        return None
    said = []
    for hold in dict.fromkeys(t.hold for t in prepared.input_timings):
        names = [t.name for t in prepared.input_timings if t.hold == hold]
        lines = " and ".join(f"{key} = {json.dumps(value)}" for key, value in keys_of(hold).items())
        said.append(
            f"{', '.join(names)}: {_acting(hold)} (write {lines} in [inputs.{names[0]}] to settle it)"
        )
    return {
        "inputs": {
            t.name: {"late": 0.0, **keys_of(t.hold), "gain": t.gain, "error": t.error}
            for t in prepared.input_timings
        },
        "text": f"What inputs do between rows the task does not say, and the log tells: {'; '.join(said)}.",
    }


def _acting(hold: Hold) -> str:
    """How an input acts, in words."""
    if np.isinf(hold.commands):
        between = "an even change from row to row"
    elif hold.commands > 1:
        between = f"{hold.commands:.0f} commands from row to row"
    else:
        between = "held from row to row"
    if not hold.late:
        return between
    when = "before" if hold.late < 0 else "after"
    return f"{between}, {1e3 * abs(hold.late):.3g} ms {when} it is written"


def time_stamps_of(prepared: PreparedLog, stamps: TimeStampJitter | None) -> dict[str, Any] | None:
    """The time-stamp jitter, and what that is of each output's noise; None where nothing tells of any."""
    if stamps is None:
        return None
    outputs = prepared.task.outputs
    off = {
        c.name: (float(sd), float(share))
        for c, sd, share in zip(outputs, stamps.sd, stamps.share, strict=True)
        if sd
    }
    factor, unit = scaled_unit("s", max(sd for sd, _ in off.values()))
    said = [f"{name} by {significant(sd * factor, 2)} {unit}" for name, (sd, _) in off.items()]
    even = jitter(prepared.log) is not None
    share = percent(max(share for _, share in off.values()))
    return {
        "outputs": {name: {"sd": sd, "share": share} for name, (sd, share) in off.items()},
        "explained": stamps.explained,
        "text": (
            "The noise grows with the speed, as time-stamp jitter makes it: "
            f"{first_of(said, SETTINGS.most_named)} (sd). Up to {share} of the noise is that, and may hide what the "
            "model lacks. Stamp samples where they are measured, not where they arrive"
            f"{'; or import these files again with --even-times: that is when they were taken' * even}."
        ),
    }


def _sentence(words: str) -> str:
    return f"{words[0].upper()}{words[1:]}."


def measured_arrays(prepared: PreparedLog) -> dict[str, np.ndarray]:
    """Which window is which, and what was measured in it; the steps of all windows are one after the other."""
    windows = prepared.windows
    return {
        "window/episode": windows.episode,
        "window/first": windows.first,
        "step/window": np.repeat(np.arange(len(windows)), windows.samples),
        "step/time": prepared.log.time[prepared.log_steps[windows.mask]],
        "step/measured": np.where(windows.sampled, windows.measured, np.nan)[windows.mask],
    }


def initial_state_arrays(prepared: PreparedLog, initial: InitialConditions) -> dict[str, np.ndarray]:
    """The state that the simulation of each window begins with, and its time by the log's clock."""
    states = initial.states
    return {
        "window/start_time": prepared.log.time[prepared.windows.first] + initial.drift,
        "window/start_qpos": states.qpos,
        "window/start_qvel": states.qvel,
        "window/start_act": states.act,
    }


def attributes_of(log: MeasuredLog) -> dict[str, Any]:
    """What outputs and recordings are called, beside the arrays."""
    outputs = zip(log.output_names, log.output_units, strict=True)
    return {
        "outputs": [{"name": name, "unit": unit} for name, unit in outputs],
        "recordings": list(log.recording_names),
    }


def prediction_of(prepared: PreparedLog, found: Predicted) -> dict[str, Any]:
    """The errors of each part by its name: by horizon, and of each recording in free run; None of one that is empty."""
    return {name: None if part is None else _part(prepared, part) for name, part in found.items()}


def _part(prepared: PreparedLog, found: PredictionErrors) -> dict[str, Any]:
    *_, free_runs = found.predictions
    return {
        "horizons": [{"horizon": p.horizon, **_runs(prepared, p.runs)} for p in found.predictions],
        "recordings": {name: _runs(prepared, runs) for name, runs in free_runs.recordings.items()},
        "left_out": found.left_out,
    }


def _runs(prepared: PreparedLog, runs: Runs) -> dict[str, Any]:
    models = {name: _error(prepared, error) for name, error in runs.errors.items()}
    return {"runs": runs.count, "longest": runs.longest, "models": models}


def _error(prepared: PreparedLog, error: PredictionError) -> dict[str, Any]:
    return {
        "rmse": by_output(prepared, error.rmse),
        "over_floor": by_output(prepared, error.rmse / prepared.noise.sd),
        "normalized": None if error.diverged else error.normalized,
        "diverged": error.diverged,
    }


def by_output(prepared: PreparedLog, errors: np.ndarray) -> dict[str, float | None]:
    """Errors (output,) by the names of the outputs; None of those that are nan."""
    names = [c.name for c in prepared.task.outputs]
    return {n: None if np.isnan(e) else float(e) for n, e in zip(names, errors, strict=True)}
