"""What an estimate says, in words and rows: one source for the page and the terminal."""

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.common.quantities import bound, floor_unit, scaled_unit, significant, with_unit
from capture_cli.store.estimate import Estimate, EstimateRecord
from capture_cli.store.result import Record, Result


@frozen
class SETTINGS:
    # Of the motion within a window, and times the noise floor: physics seldom leaves so much
    left: float = 0.5
    above: float = 3.0
    too_good: float = 0.7  # times the noise floor: no fit gets so far below it
    most: float = 0.5  # of what is beyond chance


# In `next_command` of estimate.json: the folder it lies in, by which two equal estimates do not differ.
THIS_ESTIMATE = "ESTIMATE"
TITLES = {"explained": "explained", "unexplained": "unexplained", "not-identifiable": "not identifiable"}
NOT_ALIKE = "The two parts of the log are not alike: see what differs between them"
FIT_BOTH = (
    "hold out another with --test; with --test none both are fitted, and what differs remains as error."
)
UNTRUSTED = "Do not trust the intervals: they leave out what the model lacks."
FLOOR_SOURCES = {
    "declared": "declared in the task",
    "differences": "from high-order differences",
    "repeats": "from repeats",
    "residual": "from differences of the residual",
    "outliers": "with the outliers in the residual",
    "resolution": "the sensor's steps",
}


@dataclass(frozen=True)
class OutputError:
    """RMSE of one output as it is shown, fit and test in one unit, the others in units of their own: the nominal error
    may well be a thousand times the fitted one, and that a thousand times the noise floor.

    ratio: of the held-out error (the fitted one where nothing was held out) to the noise floor; None without one.
    """

    name: str
    fit: str
    test: str
    nominal: str
    floor: str
    floor_source: str
    ratio: float | None


def beyond_chance(lack: Mapping[str, Any]) -> str:
    """By how much an error is beyond what chance allows: that of all outputs, or of the one that is the farthest."""
    size, chance, which = lack["normalized"], lack["threshold"], ""
    if size <= chance:
        over = {o: v / lack["output_thresholds"][o] for o, v in lack["outputs"].items()}
        worst = max(over, key=over.get)
        size, chance, which = lack["outputs"][worst], lack["output_thresholds"][worst], f" of {worst}"
    return f"error{which} is {significant(size)} times the noise floor (chance allows {significant(chance)})"


def is_fit_explained(record: EstimateRecord) -> bool:
    """Whether the fitted data are explained: an estimate that is "unexplained" is so by its held-out data then.

    False where the record does not say.
    """
    lack = record.lack_of_fit or {"lacking": True}
    return not lack["lacking"] and not record.diverged_windows


def not_alike(record: Record) -> str:
    """Why a model that holds where it was fitted may fail on what was held out; earlier versions did not look."""
    beyond = record.beyond_fitted
    return f"{beyond['text']} To fit that too, {FIT_BOTH}" if beyond else f"{NOT_ALIKE}, or {FIT_BOTH}"


def output_errors(estimate: Estimate) -> list[OutputError]:
    """A row per output, in the order of the log."""
    nominal = _nominal_rmse(estimate)
    return [
        _output_error(estimate.record, o["name"], o["unit"], own)
        for o, own in zip(estimate.attributes["outputs"], nominal, strict=True)
    ]


def next_command(record: EstimateRecord, folder: str | None) -> str | None:
    """The command to run next, of an estimate in `folder` (None: it is not known); None where there is none."""
    command, here = record.next_command, f" {THIS_ESTIMATE}"
    if command is None or folder is None or not command.endswith(here):
        return command
    return f"{command.removesuffix(here)} {shlex.quote(folder)}"


def in_unit(value: float | None, factor: float, unit: str) -> str:
    """A value times the factor, which brings it to the unit; missing where there is none."""
    return with_unit(significant(None if value is None else value * factor), unit)


def normalized(record: EstimateRecord, part: str) -> float | None:
    """Error over the noise floor on "fit" or "test"; None where that part is empty."""
    error = record.error[part]
    return error["normalized"] if error else None


def notes(record: EstimateRecord) -> list[str]:
    """What a reader has to know before using the numbers, most important first."""
    unfinished = cut_short(record)
    found = unfinished + open_loops(record)
    unexplained = record.verdict == "unexplained" and record.parameters
    found += [UNTRUSTED] if unexplained and not unfinished else []
    if record.in_context and record.in_context["text"]:
        found.append(record.in_context["text"])
    found += unmeasured(record)
    found += said(record, "held_out", "undetermined", "impossible_inertia")
    found += [_at_bound(n, p) for n, p in record.parameters.items() if p["at_bound"]]
    found += input_timing(record) + said(record, "time_stamps", "time_step")
    recordings = record.recordings
    if recordings and not recordings["agree"]:
        behind = "; here the time step may be that" if record.time_step else ""
        found.append(recordings["text"] + behind)
    left = record.lack_of_fit["normalized"]
    if left < SETTINGS.too_good:
        size = significant(left, 2)
        found.append(
            f"The error is {size} times the noise floor: the floor is too high and may hide what the model lacks. "
            "Give noise_sd in the task file."
        )
    return found


def said(record: Record, *keys: str) -> list[str]:
    """What the record says in words under each of these, once; nothing where there is nothing, or an earlier version
    did not look.
    """
    found: list[str] = []
    for key in keys:
        items = getattr(record, key) or []
        items = items if isinstance(items, list) else [items]
        found += [item if isinstance(item, str) else item["text"] for item in items]
    return list(dict.fromkeys(found))


def unmeasured(record: EstimateRecord) -> list[str]:
    """Whether a log may be unexplained because initial states are unknown; earlier versions did not look."""
    joints = record.unmeasured_joints
    if record.verdict != "unexplained" or not joints:
        return []
    return [
        f"No output gives the position of {', '.join(joints)}: initial states of windows come from a simulation of the "
        "whole episode, which begins in the model's initial state. If the machine began elsewhere, no effect explains "
        "the log. Measure it by a sensor that gives it (docs/method.md, Initial states), or give the model the "
        "keyframe in which episodes begin."
    ]


def open_loops(record: EstimateRecord) -> list[str]:
    """Whether a log may be unexplained because outputs contradict the model's loops; earlier versions did not look."""
    found = record.open_loops
    if record.verdict != "unexplained" or not found:
        return []
    gaps = ", ".join(f"{name} by {significant(size, 2)}" for name, size in found.items())
    return [
        f"Where joints are as measured, equality constraints stay open: {gaps} (m or rad, where windows begin). "
        "Check zero, sign and unit of what measures them, and the model's lengths."
    ]


def cut_short(record: EstimateRecord) -> list[str]:
    """Whether rounds ran out; earlier versions did not look."""
    rounds = record.cut_short
    if not rounds:
        return []
    return [
        f"The search was stopped after --rounds {rounds}, before it came to rest: values, error and verdict are those "
        "of an unfinished fit. Give it more."
    ]


def input_timing(record: Record) -> list[str]:
    """What inputs do between rows, where that had to be found out and is not the plain case; earlier versions did not
    look.
    """
    found = record.input_timing
    not_held = found and any(i["interpolate"] != "hold" or i.get("late") for i in found["inputs"].values())
    return [found["text"]] if not_held else []


def jitter_share(record: Record) -> float:
    """The share that time-stamp jitter has of what is beyond chance: 1 of all of it."""
    return (record.time_stamps or {}).get("explained") or 0.0


def behind(record: Record) -> str:
    """That time-stamp jitter is behind what is beyond chance, in words; "" where most of it is something else."""
    share = jitter_share(record)
    if share <= SETTINGS.most:
        return ""
    return f"Time-stamp jitter explains {'all' if share == 1 else 'most'} of that."


def suspicions(estimate: Estimate) -> list[str]:
    """What looks like a mistake in the log or the task file rather than like physics; to be read before the notes."""
    record = estimate.record
    if cut_short(record):
        return []
    if record.misread:
        return [record.misread["text"]]
    left = outputs_left(estimate, record.error["fit"])
    if not left:
        return []
    return [
        *undriven(record),
        f"{left[0]} If they are right, `capture diagnose` looks for what the model lacks.",
    ]


def undriven(record: EstimateRecord) -> list[str]:
    """Whether nothing drives the machine by the log: no input is ever anything but 0."""
    peaks = record.log.get("input_peaks") or {}
    if not peaks or any(peaks.values()):
        return []
    which = f"Input {', '.join(peaks)} is" if len(peaks) == 1 else f"Inputs {', '.join(peaks)} are"
    return [
        f"{which} 0 throughout the log, and the outputs move as if something drove the machine: check the column "
        "before anything else."
    ]


def outputs_left(result: Result, error: Mapping[str, Any] | None) -> list[str]:
    """Whether the `error` of what was fitted is most of the motion of some output: then it is not physics."""
    rmse, floors = (error or {}).get("rmse") or {}, result.record.noise_floor
    far = [
        o["name"]
        for o, motion in zip(result.attributes["outputs"], _motion(result), strict=True)
        if (rmse.get(o["name"]) or 0.0) > max(SETTINGS.left * motion, SETTINGS.above * floors[o["name"]])
        and motion > 0
    ]
    if not far:
        return []
    return [
        f"The fit leaves more than half of the motion of {', '.join(far)} within a window: check column, unit "
        "and sign before anything else."
    ]


def _motion(result: Result) -> np.ndarray:
    """(output,): how far the measured values are from their mean over the window, root mean square."""
    measured = np.asarray(result.arrays["step/measured"])
    sampled = np.isfinite(measured)
    measured = np.where(sampled, measured, 0.0)
    _, own = np.unique(np.asarray(result.arrays["step/window"]), return_inverse=True)
    sums, counts = (np.zeros((own.max() + 1, measured.shape[1])) for _ in range(2))
    np.add.at(sums, own, measured)
    np.add.at(counts, own, sampled)
    within = (measured - (sums / np.maximum(counts, 1))[own]) * sampled
    return np.sqrt(np.sum(within**2, axis=0) / np.maximum(sampled.sum(axis=0), 1))


def correlation(estimate: Estimate) -> np.ndarray | None:
    """Correlation of the parameters' errors (parameter, parameter); None for fewer than two parameters."""
    if len(estimate.attributes["parameters"]) < 2:
        return None
    return np.array(estimate.record.correlation, dtype=float)


def _output_error(record: EstimateRecord, name: str, unit: str, nominal: float | None) -> OutputError:
    rmse = {part: (record.error[part] or {"rmse": {}})["rmse"].get(name) for part in ("fit", "test")}
    floor = record.noise_floor[name]
    shown = rmse["test"] if rmse["test"] is not None else rmse["fit"]
    scale = scaled_unit(unit, shown or floor)
    return OutputError(
        name=name,
        fit=in_unit(rmse["fit"], *scale),
        test=in_unit(rmse["test"], *scale),
        nominal=in_unit(nominal, *scaled_unit(unit, nominal)),
        floor=in_unit(floor, *floor_unit(floor, unit, *scale)),
        floor_source=record.noise_floor_source[name],
        ratio=shown / floor if floor and shown is not None else None,
    )


def _nominal_rmse(estimate: Estimate) -> list[float | None]:
    """RMSE at the nominal values, per output, on the held-out windows (all where none is)."""
    test = estimate.arrays["window/is_test"][estimate.arrays["step/window"]]
    rows = test if test.any() else np.ones_like(test)
    measured = np.asarray(estimate.arrays["step/measured"])[rows]
    sampled = np.isfinite(measured)
    with np.errstate(over="ignore", invalid="ignore"):
        square = np.square(measured - np.asarray(estimate.arrays["step/nominal"])[rows])
        rmse = np.sqrt(np.where(sampled, square, 0.0).sum(axis=0) / sampled.sum(axis=0))
    return [float(r) if np.isfinite(r) else None for r in rmse]


def _at_bound(name: str, parameter: Mapping[str, Any]) -> str:
    upper = abs(parameter["value"] - parameter["high"]) < abs(parameter["value"] - parameter["low"])
    limit = with_unit(bound(parameter["high" if upper else "low"]), parameter["unit"])
    side = "upper" if upper else "lower"
    return f"{name} is at its {side} bound, {limit}: the bound, not the log, decides it."
