"""report.html of a diagnosis: what the model lacks, the error before and after, and how that was found."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from html import escape
from typing import Any

from capture_cli.reports import curve_plots, diagnosis_plots
from capture_cli.reports import diagnosis_findings as findings
from capture_cli.reports.curves import Curves
from capture_cli.reports.findings import FLOOR_SOURCES
from capture_cli.reports.made import header, how_it_was_made, source
from capture_cli.reports.page import (
    browser,
    measured_and_simulated,
    output,
    page,
    plot,
    section,
    table,
    tiles,
    verdict,
)
from capture_cli.reports.parameter_cells import (
    PARAMETER_HEAD,
    interval,
    named,
    parameter_row,
    range_bar,
    remarks,
)
from capture_cli.reports.quantities import MISSING, counted, significant, to_precision_of, with_unit
from capture_cli.stores.diagnosis import Diagnosis

CODE = re.compile(r"`([^`]+)`")  # as in Markdown
# Outputs past these are folded: a page of thirty sensors must still open at once.
OPEN_OUTPUTS = 3


def render(diagnosis: Diagnosis, provenance: Mapping[str, Any] | None) -> str:
    """The page as HTML. provenance: the document of provenance.json, or None where it is not known."""
    document, curves = diagnosis.document, Curves.of(diagnosis)
    badge = findings.TITLES[document["verdict"]]
    plots = _plots(diagnosis, curves)
    sections = [
        header("diagnose", document, [], provenance),
        verdict(
            document["verdict"],
            badge,
            document["summary"],
            notes=[*findings.suspicions(diagnosis), *findings.notes(document)],
        ),
        _tiles(diagnosis, provenance),
        _effects(document),
        _errors(diagnosis),
        _parameters(document),
        _curves(diagnosis, curves),
        _localisation(diagnosis, plots),
        _candidates(document),
        _next(document),
        how_it_was_made(_facts(document), provenance),
        "<footer>Written by <code>capture diagnose</code>. "
        "The numbers are in diagnosis.json and the curves in diagnosis.zarr, beside this page.</footer>",
    ]
    return page(
        title=f"{document['task']}: {badge}",
        body="\n".join(s for s in sections if s),
        plots=plots,
        curves=curve_plots.curve_views(diagnosis, curves),
    )


def _plots(diagnosis: Diagnosis, curves: Curves) -> dict[str, Any]:
    plots = {
        "stages": diagnosis_plots.stages(diagnosis),
        "absorbed": diagnosis_plots.absorbed(diagnosis.document),
    }
    for k in range(len(diagnosis.attributes["outputs"])):
        plots[f"overlay-{k}"] = curve_plots.overlay(diagnosis, curves, k)
        plots[f"localisation-{k}"] = diagnosis_plots.localisation(diagnosis, k)
    return {name: figure for name, figure in plots.items() if figure}


def _tiles(diagnosis: Diagnosis, provenance: Mapping[str, Any] | None) -> str:
    document, shown = diagnosis.document, []
    part = findings.best_part(document)
    before, after = (document["stages"][k][part]["normalized"] for k in (0, -1))
    outputs = findings.changes(diagnosis)
    if len(outputs) == 1:
        numbers, unit = (outputs[0].before[part], outputs[0].after[part]), outputs[0].unit
    else:
        numbers, unit = (before, after), "× floor"
    kept = numbers if document["effects"] else numbers[1:]
    shown.append((f"error {findings.where(part)}", " → ".join(significant(v) for v in kept), unit))
    if len(outputs) == 1 and outputs[0].over is not None:
        shown.append(("over the noise floor", significant(outputs[0].over), "×"))
    elif document["effects"] and before:
        shown.append(("of the error is left", significant(100 * after / before, 2), "%"))
    shown.append(
        ("effects accepted", str(len(document["effects"])), f"of {len(document['candidates'])} candidates")
    )
    seconds = (provenance or {}).get("seconds")
    took = "" if seconds is None else f"in {significant(seconds)} s"
    shown.append(("rollouts simulated", counted(document["rollouts"]["simulated"]), took))
    return tiles(shown)


# --- what was found ---


def _effects(document: Mapping[str, Any]) -> str:
    rows = [row for effect in document["effects"] for row in _effect_rows(effect)]
    formula = findings.expression(document)
    if not rows and not formula:
        return ""
    head = [
        "effect",
        "parameter",
        "value",
        "sd",
        "95 % interval",
        "within its range",
        "p, fitted",
        "p, unseen",
    ]
    parts = [table(head, rows, numeric=(2, 3, 4, 6, 7))] if rows else []
    parts += dict.fromkeys(_law(effect) for effect in document["effects"])
    parts += [
        f"<p>{escape(findings.placed(e))} is <span class=unsure>tied</span> with "
        f"{escape(findings.listed(e['tied_with']))}: on this log they explain the same.</p>"
        for e in document["effects"]
        if e["tied_with"]
    ]
    if formula:
        parts.append(_formula(document, formula))
    lead = (
        "p, fitted: how often chance alone would gain as much if there were no such effect, corrected for the number "
        "of candidates tried. p, unseen: how often it would help as much on data that it was not fitted to."
    )
    return section("What the model lacks", *parts, lead=lead if rows else "")


def _law(effect: Mapping[str, Any]) -> str:
    """What the effect's parameters do, in the first sentences of its law."""
    first = CODE.sub(r"<code>\1</code>", escape(effect["law"].split("\n\n")[0]))
    return f'<p class="quiet">{escape(effect["name"])}: {first}</p>'


def _formula(document: Mapping[str, Any], text: str) -> str:
    """The expression for what no effect explains, its terms, and the error with it."""
    shown = f'<h3>As a formula</h3><pre class="formula">{escape(text)}</pre>'
    error = findings.expression_error(document)
    if error:
        shown += f"<p>With it the error is {escape(error)}.</p>"
    rows = [
        [
            f'<span class="name">{escape(term["site"])}</span>',
            to_precision_of(term["coefficient"], term["sd"]),
            significant(term["sd"], 2),
            escape(term["unit"]),
        ]
        for term in document["expression"].get("terms") or []
    ]
    return shown + (table(["term", "coefficient", "sd", "unit"], rows, numeric=(1, 2)) if rows else "")


def _effect_rows(effect: Mapping[str, Any]) -> list[list[str]]:
    """A row per parameter; the effect is named in the first. One without parameters has a row, too."""
    title = (
        f'<span class="name">{escape(findings.placed(effect))}</span>'
        f'<span class="under">{escape(effect["summary"])}</span>'
    )
    chances = [_chance(effect["p_value"]), _chance(effect["p_select"])]
    if not effect["parameters"]:
        return [[title, *[""] * 5, *chances]]
    rows = []
    for k, (name, p) in enumerate(effect["parameters"].items()):
        sd, first = p["sd"], k == 0
        warning = f" {remarks(p)}" if remarks(p) else ""
        rows.append(
            [
                title if first else "",
                named(name, p["unit"]) + warning,
                f'<span class="name">{to_precision_of(p["value"], sd)}</span>',
                significant(sd, 2),
                interval(p),
                range_bar(p, shown=significant),
                *(chances if first else ["", ""]),
            ]
        )
    return rows


def _chance(p: float | None) -> str:
    if p is None:
        return MISSING
    return "&lt; 1e-16" if p < 1e-16 else significant(p, 2)


# --- the error ---


def _errors(diagnosis: Diagnosis) -> str:
    stages, has_effects = diagnosis.document["stages"], bool(diagnosis.document["effects"])
    rows = [_change_row(change, has_effects) for change in findings.changes(diagnosis)]
    if len(rows) > 1:
        both = [_pair(stages[0][part], stages[-1][part], has_effects) for part in findings.PARTS]
        rows.append(['<span class="quiet">all, over the noise floor</span>', *both, "", "", "", ""])
    head = ["output", *findings.PARTS.values(), "is left", "noise floor", "over the floor", "noise floor is"]
    if not has_effects:
        head, *rows = ([*row[:4], *row[5:]] for row in (head, *rows))
    lead = (
        f"RMSE of measured minus simulated, by the declared model{' and with what was found' * has_effects}, "
        "each fitted again. Selecting: windows that decide which effects are accepted. Held-out windows were "
        "looked at once, at the end. No model can do better than the noise floor."
    )
    if findings.starts_hide(diagnosis.document):
        lead += (
            " The declared model has far less error on what was fitted than on what selected: the starts of the fitted "
            "windows have moved to hide what is missing. Believe the others."
        )
    chart = plot(
        "stages",
        height=diagnosis_plots.stages_height(diagnosis),
        label="error of each model on each part of the log, beside the noise floor",
        caption="One effect is added after the other, and everything is fitted again." * has_effects,
    )
    title = "Error before and after" if has_effects else "Error"
    return section(title, table(head, rows, numeric=range(1, len(head) - 1)), chart, lead=lead)


def _change_row(change: findings.Change, has_effects: bool) -> list[str]:
    def arrow(part: str) -> str:
        before, after = change.before[part], change.after[part]
        if after is None:
            return MISSING
        return _arrow(before, after, escape(change.unit), has_effects)

    left = MISSING if change.ratio is None or not has_effects else f"{significant(100 * change.ratio, 2)} %"
    return [
        f'<span class="name">{escape(change.name)}</span>',
        *(arrow(part) for part in findings.PARTS),
        left,
        with_unit(significant(change.floor), escape(change.floor_unit)),
        with_unit(significant(change.over), "×"),
        f'<span class="quiet">{escape(FLOOR_SOURCES.get(change.floor_source, change.floor_source))}</span>',
    ]


def _pair(before: Mapping[str, Any] | None, after: Mapping[str, Any] | None, has_effects: bool) -> str:
    if not after:
        return MISSING
    return _arrow(before["normalized"], after["normalized"], "×", has_effects)


def _arrow(before: float | None, after: float, unit: str, has_effects: bool) -> str:
    now = f'<span class="name">{with_unit(significant(after), unit)}</span>'
    return f'<span class="quiet">{significant(before)} →</span> {now}' if has_effects else now


# --- the declared parameters ---


def _parameters(document: Mapping[str, Any]) -> str:
    if not document["parameters"]:
        return ""
    moved = findings.moved(document)
    if not moved:
        rows = [parameter_row(name, p) for name, p in document["parameters"].items()]
        lead = "Estimate and 95 % interval, drawn between the bounds the task declares."
        return section("Declared parameters", table(PARAMETER_HEAD, rows, numeric=(1, 2, 3)), lead=lead)
    rows = [_moved_row(row, document["parameters"][row.name]) for row in moved]
    head = [
        "parameter",
        "declared model, refitted",
        "with what was found",
        "sd",
        "95 % interval",
        "moved by",
        "",
    ]
    chart = plot(
        "absorbed",
        height=diagnosis_plots.absorbed_height(document),
        label="where in its range each declared parameter stood before, and where it stands now",
    )
    lead = (
        "A model that lacks something bends its parameters to make up for it. This is how far each of them "
        "moved when the effects came in, in its own unit and in standard deviations of the new value."
    )
    return section(
        "What the declared parameters had absorbed", table(head, rows, numeric=range(1, 6)), chart, lead=lead
    )


def _moved_row(row: findings.Moved, p: Mapping[str, Any]) -> list[str]:
    absorbing = abs(row.shift_in_sd) > findings.MOVED
    verdict_ = "had absorbed" if absorbing else "stayed"
    tone = "warn" if absorbing else "quiet"
    return [
        named(row.name, row.unit),
        to_precision_of(row.before, row.sd),
        f'<span class="name">{to_precision_of(row.after, row.sd)}</span>',
        significant(row.sd, 2),
        interval(p),
        f"{significant(row.shift_in_sd)} sd",
        ", ".join(t for t in (f'<span class="{tone}">{verdict_}</span>', remarks(p)) if t),
    ]


# --- the curves ---


def _curves(diagnosis: Diagnosis, curves: Curves) -> str:
    names = [o["name"] for o in diagnosis.attributes["outputs"]]
    shown = []
    for k, name in enumerate(names):
        label = f"{name}: measured and simulated over time, and the residual"
        block = plot(f"overlay-{k}", height=480, label=label)
        shown.append(output(name, block, is_open=k < OPEN_OUTPUTS))
    return measured_and_simulated(shown, views=len(curves.slices))


def _localisation(diagnosis: Diagnosis, plots: Mapping[str, Any]) -> str:
    names = [o["name"] for o in diagnosis.attributes["outputs"]]
    shown = []
    for k, name in enumerate(names):
        if f"localisation-{k}" in plots:
            label = f"{name}: mean residual acceleration against time, position, velocity and input"
            height = diagnosis_plots.localisation_height(diagnosis, k)
            block = plot(f"localisation-{k}", height=height, label=label)
            shown.append(output(name, block, is_open=k < OPEN_OUTPUTS))
    if not shown:
        return ""
    lead = (
        "Mean residual acceleration against everything that it could depend on; the band is two standard errors. "
        "The share over each curve is what that quantity alone accounts for in the declared model's residual."
    )
    return section("Where the residual arises", *shown, lead=lead)


# --- the candidates ---


def _candidates(document: Mapping[str, Any]) -> str:
    candidates = document["candidates"]
    if not candidates:
        return ""
    if all(findings.outcome(c, document) == findings.NOT_TRIED for c in candidates):
        lead = f"{len(candidates)} effects could sit somewhere in this model. None was tried: nothing is missing."
        return section("Candidates", lead=lead)
    rows = [_candidate_cells(c, document) for c in candidates]
    head = ["effect", "site", "score", "refitted, selecting", "outcome"]
    lead = (
        "Score: how much of the misfit the effect would explain at first sight, less what the declared parameters "
        "can imitate, in the last round that it was tried in. The best were refitted; their error on the windows "
        "that select is in units of the noise floor."
    )
    return section("Candidates", browser(head, rows, numeric=(2, 3), label="candidates"), lead=lead)


def _candidate_cells(
    candidate: Mapping[str, Any], document: Mapping[str, Any]
) -> list[tuple[str, float | str]]:
    outcome = findings.outcome(candidate, document)
    tone = {findings.ACCEPTED: "good name", findings.TIED: "unsure name"}.get(outcome, "quiet")
    reason = candidate["why_rejected"] if outcome != findings.ACCEPTED else ""
    text = ": ".join(t for t in (outcome, reason) if t)
    score, error = candidate["score"], candidate["refit_select_error"]
    name = f'<span class="name">{escape(candidate["effect"])}</span>'
    return [
        (name, candidate["effect"]),
        (escape(candidate["site"]) or '<span class="quiet">the whole model</span>', candidate["site"]),
        (significant(score), _key(score)),
        (with_unit(significant(error), "×"), _key(error)),
        (f'<span class="{tone}">{escape(text)}</span>', text),
    ]


def _key(value: float | None) -> float | str:
    return value if value is not None and math.isfinite(value) else ""


# --- the rest ---


def _next(document: Mapping[str, Any]) -> str:
    text = findings.next_experiment(document)
    return section("Next experiment", f"<p>{escape(text)}</p>") if text else ""


def _facts(document: Mapping[str, Any]) -> list[tuple[str, str]]:
    facts = [("log", source(document["log"]["path"], document["log"]["sha256"]))]
    split = document["split"]
    counts = [f"{counted(split[f'{part}_windows'])} {name}" for part, name in findings.PARTS.items()]
    facts.append(("split", f"{escape(split['how'])}; windows: {', '.join(counts)}"))
    facts.append(("lack of fit, declared", _lack_of_fit(document["lack_of_fit"]["before"])))
    if document["effects"]:
        facts.append(("lack of fit, with what was found", _lack_of_fit(document["lack_of_fit"]["after"])))
    rollouts = {kind: counted(count) for kind, count in document["rollouts"].items()}
    facts.append(("rollouts", f"{rollouts['measured']} measured, {rollouts['simulated']} simulated"))
    return facts


def _lack_of_fit(lack: Mapping[str, Any]) -> str:
    size, chance, memory = (significant(lack[k]) for k in ("normalized", "threshold", "autocorrelation_time"))
    return f"{size} times the noise floor; chance alone stays under {chance} (the residual remembers {memory} samples)"
