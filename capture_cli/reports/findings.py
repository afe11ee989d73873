"""What an estimate says, in words and rows: one source for the page and the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from capture_cli.reports.quantities import bound, scaled_unit, significant, with_unit
from capture_cli.stores.estimate import Estimate

# Of the motion within a window, and times the noise floor: physics seldom leaves so much
LEFT, ABOVE = 0.5, 3.0
TOO_GOOD = 0.7  # times the noise floor: no fit gets so far below it
TITLES = {"explained": "explained", "unexplained": "unexplained", "not-identifiable": "not identifiable"}
UNTRUSTED = "Do not trust the intervals: they leave out what the model lacks."
# In the unit of the errors, a noise floor under this has more zeros than digits.
NEAR = 0.01
FLOOR_SOURCES = {
    "declared": "declared in the task",
    "differences": "from high-order differences",
    "repeats": "from repeats",
    "residual": "from differences of the residual",
    "resolution": "the sensor's steps",
}


@dataclass(frozen=True)
class OutputError:
    """RMSE of one output; None where there is none.

    fit and test are in `unit`, the others in units of their own, which may all carry a prefix: the nominal
    error may well be a thousand times the fitted one, and that a thousand times the noise floor.
    ratio: of the held-out error (the fitted one where nothing was held out) to the noise floor.
    """

    name: str
    unit: str
    nominal: float | None
    nominal_unit: str
    fit: float | None
    test: float | None
    floor: float | None
    floor_unit: str
    floor_source: str
    ratio: float | None


def output_errors(estimate: Estimate) -> list[OutputError]:
    """A row per output, in the order of the log."""
    document = estimate.document
    sources = document.get("noise_floor_source") or {}
    nominal = _nominal_rmse(estimate)
    return [
        _output_error(document, o["name"], o["unit"], nominal[k], sources.get(o["name"], ""))
        for k, o in enumerate(estimate.attributes["outputs"])
    ]


def normalized(document: Mapping[str, Any], part: str) -> float | None:
    """Error over the noise floor on "fit" or "test"; None where that part is empty."""
    return (document["error"].get(part) or {}).get("normalized")


def sentence(document: Mapping[str, Any]) -> str:
    """The verdict in plain words."""
    if document.get("summary"):
        return document["summary"]
    held_out = normalized(document, "test")
    error = held_out if held_out is not None else normalized(document, "fit")
    where = "on data that was never fitted" if held_out is not None else "on the data it was fitted to"
    size = "" if error is None else f": the error {where} is {significant(error)} times the noise floor"
    return {
        "explained": f"These parameters explain the log{size}.",
        "unexplained": f"Something remains that no value of these parameters explains{size}.",
        "not-identifiable": f"This log does not determine every parameter{size}.",
    }[document["verdict"]]


def notes(document: Mapping[str, Any]) -> list[str]:
    """What a reader has to know before using the numbers, most important first."""
    undetermined = [_undetermined(item) for item in document.get("undetermined") or []]
    if not undetermined:  # then the list of parameters is all that is known
        names = [n for n, p in document["parameters"].items() if not p["identifiable"]]
        undetermined = [f"{', '.join(names)}: not determined by this log."] if names else []
    found = [UNTRUSTED] if document["verdict"] == "unexplained" and document["parameters"] else []
    found += [(document.get("in_context") or {}).get("text") or ""]
    found += undetermined
    found += [_at_bound(n, p) for n, p in document["parameters"].items() if p["at_bound"]]
    recordings = document.get("recordings") or {}
    if recordings.get("agree") is False:
        found.append(_disagreement(recordings))
    lack = document.get("lack_of_fit") or {}
    if lack.get("text") or not document.get("summary"):  # a summary has said it
        found.append(_lack_of_fit(lack))
    if lack.get("normalized") is not None and lack["normalized"] < TOO_GOOD:
        size = significant(lack["normalized"], 2)
        found.append(
            f"The error is {size} times the noise floor: the floor is too high and may hide what the model lacks. "
            "Give noise_sd in the task file."
        )
    return [n for n in found if n]


def suspicions(estimate: Estimate) -> list[str]:
    """What looks like a mistake in the log or the task file rather than like physics; to be read before the notes."""
    document = estimate.document
    rmse = (document["error"]["fit"] or {}).get("rmse") or {}
    floors = document.get("noise_floor") or {}
    far = [
        o["name"]
        for o, motion in zip(estimate.attributes["outputs"], _motion(estimate), strict=True)
        if (rmse.get(o["name"]) or 0.0) > max(LEFT * motion, ABOVE * floors.get(o["name"], 0.0))
        and motion > 0
    ]
    if not far:
        return []
    return [
        f"The fit leaves more than half of the motion of {', '.join(far)} within a window: check column, unit "
        "and sign before anything else."
    ]


def _motion(estimate: Estimate) -> np.ndarray:
    """(output,): how far the measured values are from their mean over the window, root mean square."""
    measured = np.asarray(estimate.arrays["step/measured"])
    sampled = np.isfinite(measured)
    measured = np.where(sampled, measured, 0.0)
    _, own = np.unique(np.asarray(estimate.arrays["step/window"]), return_inverse=True)
    sums, counts = (np.zeros((own.max() + 1, measured.shape[1])) for _ in range(2))
    np.add.at(sums, own, measured)
    np.add.at(counts, own, sampled)
    within = (measured - (sums / np.maximum(counts, 1))[own]) * sampled
    return np.sqrt(np.sum(within**2, axis=0) / np.maximum(sampled.sum(axis=0), 1))


def combination(weights: Mapping[str, float]) -> str:
    """A direction in parameter space as text: mass 0.71 and gain -0.7 give "0.71 mass − 0.70 gain"."""
    terms = sorted(weights.items(), key=lambda item: -abs(item[1]))
    text = " ".join(f"{'−' if w < 0 else '+'} {abs(w):.2f} {name}" for name, w in terms)
    return text[2:] if text.startswith("+") else f"−{text[2:]}"


def correlation(estimate: Estimate) -> np.ndarray | None:
    """Correlation of the parameters' errors (parameter, parameter); None for fewer than two parameters."""
    if len(estimate.attributes["parameters"]) < 2:
        return None
    if estimate.document.get("correlation"):
        return np.array(estimate.document["correlation"], dtype=float)
    covariance = np.asarray(estimate.arrays["parameter/covariance"])
    sd = np.sqrt(np.diag(covariance))
    if not np.all(np.isfinite(sd)) or not np.all(sd > 0):
        return None
    return covariance / np.outer(sd, sd)


def _output_error(document, name: str, unit: str, nominal: float | None, source: str) -> OutputError:
    rmse = {
        part: ((document["error"].get(part) or {}).get("rmse") or {}).get(name) for part in ("fit", "test")
    }
    floor = document["noise_floor"].get(name)
    shown = rmse["test"] if rmse["test"] is not None else rmse["fit"]
    factor, label = scaled_unit(unit, shown or floor)
    nominal_factor, nominal_label = scaled_unit(unit, nominal)
    near = floor and floor * factor >= NEAR  # then it is easier to compare in one unit
    floor_factor, floor_label = (factor, label) if near else scaled_unit(unit, floor)
    return OutputError(
        name=name,
        unit=label,
        nominal=_times(nominal, nominal_factor),
        nominal_unit=nominal_label,
        fit=_times(rmse["fit"], factor),
        test=_times(rmse["test"], factor),
        floor=_times(floor, floor_factor),
        floor_unit=floor_label,
        floor_source=source,
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


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def _undetermined(item: Mapping[str, Any]) -> str:
    if item.get("text"):
        return item["text"]
    spread = (
        ""
        if item.get("sd_over_range") is None
        else f" (sd {significant(item['sd_over_range'], 2)} of its range)"
    )
    return f"Not determined by this log: {combination(item['combination'])}{spread}."


def _at_bound(name: str, parameter: Mapping[str, Any]) -> str:
    upper = abs(parameter["value"] - parameter["high"]) < abs(parameter["value"] - parameter["low"])
    limit = with_unit(bound(parameter["high" if upper else "low"]), parameter["unit"])
    side = "upper" if upper else "lower"
    return f"{name} is at its {side} bound, {limit}: the bound, not the log, decides it."


def _disagreement(recordings: Mapping[str, Any]) -> str:
    if recordings.get("text"):
        return recordings["text"]
    p_values = {n: p["p_value"] for n, p in recordings["parameters"].items() if p.get("p_value") is not None}
    worst = min(p_values, key=p_values.get, default=None)
    which = "" if worst is None else f", {worst} most (p = {significant(p_values[worst], 2)})"
    return f"The recordings do not agree on the parameters{which}."


def _lack_of_fit(lack: Mapping[str, Any]) -> str:
    if lack.get("text"):
        return lack["text"]
    size, threshold = lack.get("normalized"), lack.get("threshold")
    if size is None or threshold is None:
        return ""
    return f"Lack of fit {significant(size)}; chance alone stays under {significant(threshold)}."
