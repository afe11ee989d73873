"""report.html of a diagnosis: what diagnosis_page.html shows of it."""

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
from capture_cli.report.page import page, rollouts_fact, rollouts_tile
from capture_cli.report.prediction import predictions
from capture_cli.store.diagnosis import Diagnosis, DiagnosisRecord

CODE = re.compile(r"`([^`]+)`")  # as in Markdown


def render(diagnosis: Diagnosis, provenance: Mapping[str, Any] | None) -> str:
    """The page as HTML. provenance: the record of provenance.json, or None where it is not known."""
    record, curves = diagnosis.record, Curves.of(diagnosis)
    plots, outputs = _plots(diagnosis, curves), diagnosis.attributes["outputs"]
    open_outputs = 3  # those past them are folded: a page of thirty sensors must still open at once
    return page(
        "diagnosis_page.html",
        plots=plots,
        curves=curve_plots.curve_views(curves),
        document=record,
        provenance=provenance,
        badge=findings.TITLES[record.verdict],
        notes=[*findings.suspicions(diagnosis), *findings.notes(record)],
        tiles=_tiles(diagnosis, provenance),
        findings=findings,
        laws=dict.fromkeys(_law(effect) for effect in record.effects),
        terms=(record.expression or {}).get("terms"),
        changes=findings.changes(diagnosis),
        predictions=predictions(record, outputs),
        floor_sources=FLOOR_SOURCES,
        moved=findings.moved(record) if record.parameters else [],
        outputs=outputs,
        open_outputs=open_outputs,
        views=len(curves.slices),
        localised=[k for k in range(len(outputs)) if f"localisation-{k}" in plots],
        tried=_tried(record),
        key=_key,
        facts=_facts(record),
    )


def _plots(diagnosis: Diagnosis, curves: Curves) -> dict[str, Any]:
    plots = {
        "stages": diagnosis_plots.stages(diagnosis),
        "absorbed": diagnosis_plots.absorbed(diagnosis.record),
    }
    for k in range(len(diagnosis.attributes["outputs"])):
        plots[f"overlay-{k}"] = curve_plots.overlay(curves, k)
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
    told = numbers if record.effects else numbers[1:]
    shown.append((f"error {findings.where(part)}", " → ".join(significant(v) for v in told), unit))
    if len(outputs) == 1 and outputs[0].over is not None:
        shown.append(("over the noise floor", significant(outputs[0].over), "×"))
    elif record.effects and before:
        shown.append(("of the error is left", significant(100 * after / before, 2), "%"))
    shown.append(("effects accepted", str(len(record.effects)), f"of {len(record.candidates)} candidates"))
    return [*shown, rollouts_tile(record, provenance)]


def _law(effect: Mapping[str, Any]) -> tuple[str, tuple[tuple[bool, str], ...]]:
    """What the effect's parameters do: its name, and the first sentences of its law as (whether it is code, text)."""
    pieces = CODE.split(effect["law"].split("\n\n")[0])
    return effect["name"], tuple((k % 2 == 1, text) for k, text in enumerate(pieces))


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
    return [*facts, rollouts_fact(record)]


def _lack_of_fit(lack: Mapping[str, Any]) -> str:
    size, chance, memory = (significant(lack[k]) for k in ("normalized", "threshold", "autocorrelation_time"))
    return f"{size} times the noise floor; chance alone stays under {chance} (the residual remembers {memory} samples)"
