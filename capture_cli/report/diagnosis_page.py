"""report.html of a diagnosis: what diagnosis_page.html shows of it."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from capture_cli.common.quantities import counted, significant
from capture_cli.report import curve_plots, diagnosis_plots
from capture_cli.report import diagnosis_findings as findings
from capture_cli.report.curves import Curves
from capture_cli.report.findings import FLOOR_SOURCES
from capture_cli.report.page import page
from capture_cli.report.prediction import predictions
from capture_cli.store.diagnosis import Diagnosis, DiagnosisRecord

CODE = re.compile(r"`([^`]+)`")  # as in Markdown


def render(diagnosis: Diagnosis, provenance: Mapping[str, Any] | None) -> str:
    """The page as HTML. provenance: the record of provenance.json, or None where it is not known."""
    record, curves = diagnosis.record, Curves.of(diagnosis)
    plots, stages = _plots(diagnosis, curves), record.stages
    # Outputs past these are folded: a page of thirty sensors must still open at once.
    open_outputs = 3
    return page(
        "diagnosis_page.html",
        plots=plots,
        curves=curve_plots.curve_views(diagnosis, curves),
        document=record,
        provenance=provenance,
        badge=findings.TITLES[record.verdict],
        notes=[*findings.suspicions(diagnosis), *findings.notes(record)],
        tiles=_tiles(diagnosis, provenance),
        has_effects=bool(record.effects),
        placed=findings.placed,
        listed=findings.listed,
        laws=dict.fromkeys(_law(effect) for effect in record.effects),
        formula=findings.expression(record),
        formula_error=findings.expression_error(record),
        terms=(record.expression or {}).get("terms"),
        parts_of_log=list(findings.PARTS),
        part_names=list(findings.PARTS.values()),
        changes=findings.changes(diagnosis),
        together=[[_normalized(stage, part) for stage in (stages[0], stages[-1])] for part in findings.PARTS],
        predictions=predictions(record, diagnosis.attributes["outputs"]),
        floor_sources=FLOOR_SOURCES,
        starts_hide=findings.starts_hide(record),
        stages_height=diagnosis_plots.stages_height(diagnosis),
        moved=findings.moved(record) if record.parameters else [],
        least_moved=findings.SETTINGS.moved,
        absorbed_height=diagnosis_plots.absorbed_height(record),
        outputs=diagnosis.attributes["outputs"],
        open_outputs=open_outputs,
        views=len(curves.slices),
        localisation_heights={
            k: diagnosis_plots.localisation_height(diagnosis, k)
            for k in range(len(diagnosis.attributes["outputs"]))
            if f"localisation-{k}" in plots
        },
        tried=_tried(record),
        key=_key,
        next_experiment=findings.next_experiment(record),
        facts=_facts(record),
    )


def _plots(diagnosis: Diagnosis, curves: Curves) -> dict[str, Any]:
    plots = {
        "stages": diagnosis_plots.stages(diagnosis),
        "absorbed": diagnosis_plots.absorbed(diagnosis.record),
    }
    for k in range(len(diagnosis.attributes["outputs"])):
        plots[f"overlay-{k}"] = curve_plots.overlay(diagnosis, curves, k)
        plots[f"localisation-{k}"] = diagnosis_plots.localisation(diagnosis, k)
    return {name: figure for name, figure in plots.items() if figure}


def _tiles(diagnosis: Diagnosis, provenance: Mapping[str, Any] | None) -> list[tuple[str, str, str]]:
    """(title, number, what it counts)."""
    record, shown = diagnosis.record, []
    part = findings.best_part(record)
    before, after = (record.stages[k][part]["normalized"] for k in (0, -1))
    outputs = findings.changes(diagnosis)
    if len(outputs) == 1:
        numbers, unit = (outputs[0].before[part], outputs[0].after[part]), outputs[0].unit
    else:
        numbers, unit = (before, after), "× floor"
    kept = numbers if record.effects else numbers[1:]
    shown.append((f"error {findings.where(part)}", " → ".join(significant(v) for v in kept), unit))
    if len(outputs) == 1 and outputs[0].over is not None:
        shown.append(("over the noise floor", significant(outputs[0].over), "×"))
    elif record.effects and before:
        shown.append(("of the error is left", significant(100 * after / before, 2), "%"))
    shown.append(("effects accepted", str(len(record.effects)), f"of {len(record.candidates)} candidates"))
    seconds = (provenance or {}).get("seconds")
    took = "" if seconds is None else f"in {significant(seconds)} s"
    shown.append(("rollouts simulated", counted(record.rollouts["simulated"]), took))
    return shown


def _law(effect: Mapping[str, Any]) -> tuple[str, tuple[tuple[bool, str], ...]]:
    """What the effect's parameters do: its name, and the first sentences of its law as (whether it is code, text)."""
    pieces = CODE.split(effect["law"].split("\n\n")[0])
    return effect["name"], tuple((k % 2 == 1, text) for k, text in enumerate(pieces))


def _normalized(stage: Mapping[str, Any], part: str) -> float | None:
    return stage[part]["normalized"] if stage[part] else None


@dataclass(frozen=True)
class Tried:
    """A row of the table of candidates. tone: the CSS class of its outcome."""

    effect: str
    site: str
    score: float | None
    error: float | None
    outcome: str
    tone: str


def _tried(record: DiagnosisRecord) -> list[Tried]:
    """A row per candidate; none where not one was tried."""
    rows = [(c, findings.outcome(c, record)) for c in record.candidates]
    if all(outcome == findings.NOT_TRIED for _, outcome in rows):
        return []
    tones = {findings.ACCEPTED: "good name", findings.TIED: "unsure name"}
    return [
        Tried(
            effect=c["effect"],
            site=c["site"],
            score=c["score"],
            error=c["refit_select_error"],
            outcome=": ".join(
                t for t in (outcome, c["why_rejected"] if outcome != findings.ACCEPTED else "") if t
            ),
            tone=tones.get(outcome, "quiet"),
        )
        for c, outcome in rows
    ]


def _key(value: float | None) -> float | str:
    """What a cell of `value` is sorted by."""
    return value if value is not None and math.isfinite(value) else ""


def _facts(record: DiagnosisRecord) -> list[tuple[str, str]]:
    split = record.split
    counts = [f"{counted(split[f'{part}_windows'])} {name}" for part, name in findings.PARTS.items()]
    facts = [
        ("split", f"{split['how']}; windows: {', '.join(counts)}"),
        ("lack of fit, declared", _lack_of_fit(record.lack_of_fit["before"])),
    ]
    if record.effects:
        facts.append(("lack of fit, with what was found", _lack_of_fit(record.lack_of_fit["after"])))
    rollouts = {kind: counted(count) for kind, count in record.rollouts.items()}
    return [*facts, ("rollouts", f"{rollouts['measured']} measured, {rollouts['simulated']} simulated")]


def _lack_of_fit(lack: Mapping[str, Any]) -> str:
    size, chance, memory = (significant(lack[k]) for k in ("normalized", "threshold", "autocorrelation_time"))
    return f"{size} times the noise floor; chance alone stays under {chance} (the residual remembers {memory} samples)"
