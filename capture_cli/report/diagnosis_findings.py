"""What a diagnosis says, in words and rows: one source for diagnosis.json, the page, the figures and the terminal."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from capture_cli.common.frozen import frozen
from capture_cli.common.quantities import (
    floor_unit,
    scaled_unit,
    significant,
    titled,
    to_precision_of,
    with_unit,
)
from capture_cli.model.effects.placed import placed_name
from capture_cli.report.findings import (
    UNTRUSTED,
    behind,
    beyond_chance,
    in_unit,
    input_timing,
    not_alike,
    outputs_left,
    said,
)
from capture_cli.store.diagnosis import Diagnosis, DiagnosisRecord

TITLES = {
    "explained": "explained",
    "effect-found": "effect found",
    "tied": "effect found, tied",
    "unexplained": "unexplained",
}
# Of each part of the log, in the words of diagnosis.json: what it was for.
PARTS = {"fit": "fitted", "select": "selecting", "test": "held out"}


@frozen
class SETTINGS:
    hidden: float = 0.7  # of the error on what judges: what was fitted is seldom so much easier
    moved: float = 2.0  # sd: more than chance moves a parameter
    worth_a_logarithm: float = 15.0  # errors that differ by more than this factor
    telling: float = 0.1  # share of a residual's variance that is worth a word


ACCEPTED, TIED, NOT_TRIED = "accepted", "tied", "not tried"


@dataclass(frozen=True)
class Change:
    """RMSE of one output before and after, by part of the log (None: an empty part), all in `unit`; the noise floor as
    it is shown.

    ratio: after over before; over, over_before: after and before over the noise floor; all on held-out data, or on
    what there is.
    """

    name: str
    unit: str
    before: dict[str, float | None]
    after: dict[str, float | None]
    floor: str
    floor_source: str
    ratio: float | None
    over: float | None
    over_before: float | None


@dataclass(frozen=True)
class Moved:
    """A declared parameter that had been absorbing what was missing, in its unit."""

    name: str
    unit: str
    before: float
    after: float
    sd: float | None
    shift_in_sd: float


def placed(effect: Mapping[str, Any]) -> str:
    """EFFECT@SITE of an effect or a candidate."""
    return placed_name(effect.get("name") or effect["effect"], effect["site"])


def listed(names: Sequence[str]) -> str:
    """Names in a sentence: a, b and c."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def best_part(record: DiagnosisRecord) -> str:
    """The part of the log by which the models are judged: held out where there is one."""
    last = record.stages[-1]
    return next(part for part in ("test", "select", "fit") if last[part])


def where(part: str) -> str:
    """On which data, in words."""
    return {
        "test": "on held-out data",
        "select": "on data that was not fitted",
        "fit": "on the data that was fitted",
    }[part]


def normalized(stage: Mapping[str, Any], part: str) -> float | None:
    """Error of a model over the noise floor on a part of the log; None where that part is empty."""
    return stage[part]["normalized"] if stage[part] else None


def changes(diagnosis: Diagnosis) -> list[Change]:
    """A row per output, in the order of the log."""
    return [_change(diagnosis.record, o["name"], o["unit"]) for o in diagnosis.attributes["outputs"]]


def moved(record: DiagnosisRecord) -> list[Moved]:
    """The declared parameters that moved when the effects came in, farthest first."""
    rows = [
        Moved(name=name, sd=record.parameters[name]["sd"], **row) for name, row in record.absorbed.items()
    ]
    return sorted(rows, key=lambda row: -abs(row.shift_in_sd))


def absorbing(record: DiagnosisRecord) -> list[Moved]:
    """Those that moved by more than their interval allows."""
    return [row for row in moved(record) if abs(row.shift_in_sd) > SETTINGS.moved]


def shift(row: Moved) -> str:
    """From where to where, as in 425.4 → 191.1 N s/m."""
    before, after = (to_precision_of(v, row.sd) for v in (row.before, row.after))
    return f"{before} → {with_unit(after, row.unit)}"


def outcome(candidate: Mapping[str, Any], record: DiagnosisRecord) -> str:
    """ACCEPTED, TIED, NOT_TRIED, or "" for one that was rejected."""
    name = placed(candidate)
    if any(placed(e) == name for e in record.effects):
        return ACCEPTED
    if any(name in e["tied_with"] for e in record.effects):
        return TIED
    return "" if candidate["why_rejected"] else NOT_TRIED


def closest_rejected(record: DiagnosisRecord) -> Mapping[str, Any] | None:
    """The rejected candidate that came nearest: the least error where it was refitted, else the highest score."""
    rejected = [c for c in record.candidates if not outcome(c, record)]
    refitted = [c for c in rejected if c["refit_select_error"] is not None]
    if refitted:
        return min(refitted, key=lambda c: c["refit_select_error"])
    scored = [c for c in rejected if c["score"]]
    return max(scored, key=lambda c: c["score"], default=None)


def summary(record: DiagnosisRecord) -> str:
    """The finding in words, with the numbers that it rests on."""
    effects, stages, left = record.effects, record.stages, record.lack_of_fit["after"]
    if record.verdict == "explained":
        return f"Nothing is missing: the error is {significant(left['normalized'])} times the noise floor."
    part, where = ("test", "held-out") if stages[-1]["test"] else ("fit", "fit")
    first, last = (stage[part]["normalized"] for stage in (stages[0], stages[-1]))
    by_stamps = behind(record)
    stamps = f" {by_stamps}" if by_stamps else ""
    if not effects and not left["lacking"]:
        return (
            "The model fits what it was fitted to, but not what was held out: there the error is "
            f"{significant(last)} times the noise floor. {by_stamps or not_alike(record)}"
        )
    if not effects:
        size = f"the {where} error is {significant(last)} times the noise floor{_of_one(left)}"
        if record.out_of_time:
            return f"In the time given no effect was found: {size}.{stamps}"
        error = expression_error(record)
        formula = f" With a formula of the missing force it is {error}." if error else ""
        return f"None of these: {size}, and no effect of the catalogue explains it.{formula}{stamps}"
    tied = [f" (or {', '.join(e['tied_with'])})" if e["tied_with"] else "" for e in effects]
    found = _found(record, [f"{placed(e)}{rivals}" for e, rivals in zip(effects, tied, strict=True)])
    if _fits_alone(record):
        with_it, without = significant(last), significant(first)
        beyond = (record.beyond_fitted or {}).get("text")
        text = f"{found}: there the error is {with_it} times the noise floor, and {without} without."
        return f"{text} {beyond}" if beyond else text
    them = "it" if len(effects) == 1 else "them"
    text = f"{found}: with {them} the {where} error falls to {last / first:.2g} of what it was."
    if record.verdict == "unexplained":
        size, on = (left["normalized"], " on what was fitted") if left["normalized"] > last else (last, "")
        text += f" What is left{on} is still {significant(size)} times the noise floor{_of_one(left)}"
        text += f".{stamps}" if stamps else ": this is not all."
    return text


def _of_one(left: Mapping[str, Any]) -> str:
    """Of the output whose error is beyond what chance allows where that of all together is not."""
    is_of_one = left["lacking"] and left["normalized"] <= left["threshold"]
    return f" (the {beyond_chance(left)})" if is_of_one else ""


def answer(record: DiagnosisRecord) -> str:
    """The summary without the numbers and rivals of what was found, where they stand in lines of their own."""
    if record.verdict == "explained" or not record.effects:
        return record.summary
    found = _found(record, [placed(e) for e in record.effects])
    is_all = record.verdict != "unexplained" or _fits_alone(record)
    return f"{found}." if is_all else f"{found}, and more."


def _found(record: DiagnosisRecord, names: Sequence[str]) -> str:
    """What the effects `names` are to the model."""
    if _fits_alone(record):
        return f"{listed(names)} would explain what was fitted, but not what was held out"
    return f"The model lacks {listed(names)}"


def _fits_alone(record: DiagnosisRecord) -> bool:
    """Whether what was held out is no better with the effects than without."""
    before, after = (record.stages[k]["test"] for k in (0, -1))
    return bool(before) and after["normalized"] >= before["normalized"]


def left_over(record: DiagnosisRecord) -> str:
    """What an answer leaves of the error, small but more than chance would; "" where that is nothing."""
    lack = record.lack_of_fit["after"]
    if record.verdict not in ("effect-found", "tied") or not lack["lacking"]:
        return ""
    return f"A little is left: the {beyond_chance(lack)}"


def initial_states_hide(record: DiagnosisRecord) -> bool:
    """Whether the declared model has far less error on what was fitted than on what judged it, from the same
    recordings: there the initial states of windows make up for what is missing (docs/method.md, Initial states).
    """
    declared = record.stages[0]
    return (
        bool(declared["select"])
        and declared["fit"]["normalized"] < SETTINGS.hidden * declared["select"]["normalized"]
    )


def suspicions(diagnosis: Diagnosis) -> list[str]:
    """What looks like a mistake in the log or the task file; to be read before the notes."""
    return outputs_left(diagnosis, diagnosis.record.stages[-1]["fit"])


def notes(record: DiagnosisRecord) -> list[str]:
    """What a reader has to know before using the answer, most important first."""
    found = [f"{left_over(record)}: this may not be all."] if left_over(record) else []
    for effect in record.effects:
        if effect["tied_with"]:
            rivals = " or ".join(effect["tied_with"])
            found.append(f"This log cannot tell {placed(effect)} from {rivals}.")
    if record.verdict == "unexplained":
        if record.effects:
            found.append(
                "Take what was found as a part of the answer: its sizes may change once the rest is known."
            )
        if record.parameters or record.effects:
            found.append(UNTRUSTED)
    found += beside(record)
    found += [
        f"{name} is at the end of its range: the range, not the log, decides it."
        for name, p in record.parameters.items()
        if p["at_bound"]
    ]
    if record.before["test"] is None:
        found.append("Nothing was held out: the errors are those of data that was used.")
    return found


def beside(record: DiagnosisRecord) -> list[str]:
    """What has to be known beside the answer, and it does not say."""
    found = said(record, "out_of_time", "undetermined", "held_out", "impossible_inertia")
    return [*found, *input_timing(record), *said(record, "time_stamps", "time_step")]


def expression(record: DiagnosisRecord) -> str:
    """The formula for what no effect of the catalogue explains; "" where none was looked for."""
    return (record.expression or {}).get("text") or ""


def expression_error(record: DiagnosisRecord) -> str:
    """The error with that formula in the model; "" where it is not known."""
    found = record.expression or {}
    part = next((part for part in ("test", "select") if found.get(part)), None)
    if part is None:
        return ""
    return f"{significant(found[part]['normalized'])} × noise floor {where(part)}"


def strongest_covariate(record: DiagnosisRecord) -> str:
    """What the declared model's residual depends on most; "" where nothing is known."""
    curves = [c for c in record.localisation if c["share"] >= SETTINGS.telling]
    if not curves:
        return ""
    top = max(curves, key=lambda c: c["share"])
    return f"{top['against']} accounts for {100 * top['share']:.0f} % of the residual acceleration of {top['output']}"


def next_experiment(record: DiagnosisRecord) -> str:
    """What to record next; "" where nothing is proposed."""
    return (record.next_experiment or {}).get("text") or ""


def _change(record: DiagnosisRecord, name: str, unit: str) -> Change:
    first, last = record.stages[0], record.stages[-1]
    before, after = (
        {part: stage[part]["rmse"].get(name) if stage[part] else None for part in PARTS}
        for stage in (first, last)
    )
    part = best_part(record)
    shown, floor = after[part], record.noise_floor[name]
    factor, label = scaled_unit(unit, shown or floor)
    return Change(
        name=name,
        unit=label,
        before={k: v if v is None else v * factor for k, v in before.items()},
        after={k: v if v is None else v * factor for k, v in after.items()},
        floor=in_unit(floor or None, *floor_unit(floor, unit, factor, label)),
        floor_source=record.noise_floor_source[name],
        ratio=shown / before[part] if before[part] else None,
        over=shown / floor if floor and shown is not None else None,
        over_before=before[part] / floor if floor and shown is not None else None,
    )


@dataclass(frozen=True)
class StageErrors:
    """Errors of the models, one after the other, for one axis.

    names: of the models. errors: by part (those that have data), of each model. floor: None where there is none;
    floor_text is what it is, in a unit of its own. title: of the axis. unit: after a number.
    decades: whether the errors span so much that a logarithm helps.
    """

    names: list[str]
    errors: dict[str, list[float]]
    floor: float | None
    floor_text: str
    title: str
    unit: str
    decades: bool


def stage_errors(diagnosis: Diagnosis) -> StageErrors:
    """In the unit of the output where there is one, over the noise floor where there are several."""
    record, outputs = diagnosis.record, diagnosis.attributes["outputs"]
    stages = record.stages
    parts = [part for part in PARTS if all(stage[part] for stage in stages)]
    if len(outputs) > 1:
        errors = {part: [normalized(stage, part) for stage in stages] for part in parts}
        floor, floor_text, title, unit = 1.0, "1 ×", "error over the noise floor", "×"
    else:
        name, own = outputs[0]["name"], outputs[0]["unit"]
        factor, unit = scaled_unit(own, stages[-1][parts[-1]]["rmse"][name])
        errors = {part: [factor * stage[part]["rmse"][name] for stage in stages] for part in parts}
        floor, title = record.noise_floor[name], f"RMSE of {titled(name, unit)}"
        floor_text = in_unit(floor, *scaled_unit(own, floor))
        floor = floor * factor if floor else None
    judged = errors[parts[-1]]
    decades = min(judged) > 0 and max(judged) > SETTINGS.worth_a_logarithm * min(judged)
    return StageErrors([stage["model"] for stage in stages], errors, floor, floor_text, title, unit, decades)
