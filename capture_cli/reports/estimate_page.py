"""report.html of an estimate: the verdict, the numbers, and every curve they come from."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from capture_cli.reports import curve_plots, findings, parameter_plots
from capture_cli.reports.curves import Curves
from capture_cli.reports.made import header, how_it_was_made, source
from capture_cli.reports.page import (
    measured_and_simulated,
    output,
    page,
    plot,
    section,
    side_by_side,
    table,
    tiles,
    verdict,
)
from capture_cli.reports.parameter_cells import PARAMETER_HEAD, parameter_row
from capture_cli.reports.quantities import counted, significant, with_unit
from capture_cli.stores.estimate import Estimate

# Outputs past these are folded: a page of thirty sensors must still open at once.
OPEN_OUTPUTS = 4


def render(estimate: Estimate, provenance: Mapping[str, Any] | None) -> str:
    """The page as HTML. provenance: the document of provenance.json, or None where it is not known."""
    curves, document = Curves.of(estimate), estimate.document
    plots = _plots(estimate, curves)
    badge = findings.TITLES[document["verdict"]]
    sections = [
        header("identify", document, [escape(document["identifier"])], provenance),
        verdict(
            document["verdict"],
            badge,
            document["summary"],
            notes=[*findings.suspicions(estimate), *findings.notes(document)],
            command=document["next_command"],
        ),
        _tiles(document, provenance),
        _parameters(document),
        _errors(estimate),
        _curves(estimate, curves),
        _search(document, plots),
        _recordings(document, plots),
        how_it_was_made(_facts(document), provenance),
        "<footer>Written by <code>capture identify</code>. "
        "The numbers are in estimate.json and the curves in estimate.zarr, beside this page.</footer>",
    ]
    return page(
        title=f"{document['task']}: {badge}",
        body="\n".join(s for s in sections if s),
        plots=plots,
        curves=curve_plots.curve_views(estimate, curves),
    )


def _plots(estimate: Estimate, curves: Curves) -> dict[str, Any]:
    plots = {}
    for k in range(len(estimate.attributes["outputs"])):
        plots[f"overlay-{k}"] = curve_plots.overlay(estimate, curves, k)
        plots[f"residual-{k}"] = curve_plots.residual_statistics(estimate, curves, k)
    plots["correlation"] = parameter_plots.correlation_matrix(estimate)
    plots["convergence"] = parameter_plots.convergence(estimate)
    plots["recordings"] = parameter_plots.recordings(estimate.document)
    return {name: figure for name, figure in plots.items() if figure}


def _tiles(document: Mapping[str, Any], provenance: Mapping[str, Any] | None) -> str:
    shown = []
    for part, title in (("test", "error on held-out data"), ("fit", "error on fitted data")):
        error = findings.normalized(document, part)
        if error is not None:
            shown.append((title, significant(error), "× noise floor"))
    parameters = document["parameters"].values()
    if parameters:
        determined = sum(p["identifiable"] for p in parameters)
        shown.append(("parameters determined", str(determined), f"of {len(parameters)}"))
    seconds = (provenance or {}).get("seconds")
    took = "" if seconds is None else f"in {significant(seconds)} s"
    shown.append(("rollouts simulated", counted(document["rollouts"]["simulated"]), took))
    return tiles(shown)


def _parameters(document: Mapping[str, Any]) -> str:
    if not document["parameters"]:
        lead = "None are declared: only the state at the start of each window was fitted."
        return section("Parameters", lead=lead)
    rows = [parameter_row(name, p) for name, p in document["parameters"].items()]
    lead = "Estimate and 95 % interval, drawn between the bounds the task declares."
    if document["verdict"] == "unexplained":
        lead += f" {findings.UNTRUSTED}"
    return section("Parameters", table(PARAMETER_HEAD, rows, numeric=(1, 2, 3)), lead=lead)


def _errors(estimate: Estimate) -> str:
    errors = findings.output_errors(estimate)
    together = [findings.normalized(estimate.document, part) for part in ("fit", "test")]
    rows = [_error_row(e) for e in errors]
    cells = [with_unit(significant(v), "×") for v in together]
    rows.append(['<span class="quiet">all, over the noise floor</span>', *cells, "", "", "", ""])
    head = ["output", "fitted", "held out", "nominal", "noise floor", "over the floor", "noise floor is"]
    if not any(e.floor_source for e in errors):
        head, rows = head[:-1], [row[:-1] for row in rows]
    lead = (
        "RMSE of measured minus simulated. Of held-out windows nothing was fitted but where they start; "
        "nominal is the model as it was declared, on the same windows (all, where none is held out), from the same "
        "starts. No model can do better than the noise floor."
    )
    return section("Error", table(head, rows, numeric=(1, 2, 3, 4, 5)), lead=lead)


def _error_row(e: findings.OutputError) -> list[str]:
    return [
        f'<span class="name">{escape(e.name)}</span>',
        *(with_unit(significant(v), escape(e.unit)) for v in (e.fit, e.test)),
        with_unit(significant(e.nominal), escape(e.nominal_unit)),
        with_unit(significant(e.floor), escape(e.floor_unit)),
        with_unit(significant(e.ratio), "×"),
        f'<span class="quiet">{escape(findings.FLOOR_SOURCES.get(e.floor_source, e.floor_source))}</span>',
    ]


def _curves(estimate: Estimate, curves: Curves) -> str:
    names = [o["name"] for o in estimate.attributes["outputs"]]
    shown = [output(name, _output(name, k), is_open=k < OPEN_OUTPUTS) for k, name in enumerate(names)]
    return measured_and_simulated(shown, views=len(curves.slices))


def _output(name: str, k: int) -> str:
    over_time = f"{name}: measured, simulated and nominal over time, and the residual"
    statistics = f"{name}: histogram and autocorrelation of the residual"
    caption = (
        "Left: the residual against what the noise floor alone would give. "
        "Right: its autocorrelation; white noise stays in the band."
    )
    return plot(f"overlay-{k}", height=460, label=over_time) + plot(
        f"residual-{k}", height=250, label=statistics, caption=caption
    )


def _search(document: Mapping[str, Any], plots: Mapping[str, Any]) -> str:
    walked = "The best so far, round by round"
    if document["in_context"]:
        walked = "What each round over the episodes proposed, judged on a few of them, then the best so far of the fit"
    captions = {
        "correlation": (
            "Correlation of the estimates",
            "Near ±1 the log fixes a combination of two parameters better than either alone.",
        ),
        "convergence": (
            "Convergence",
            f"{walked}; and where in its range each parameter stands.",
        ),
    }
    parts = [
        f"<div><h3>{title}</h3>{plot(name, height=400, label=title, caption=caption)}</div>"
        for name, (title, caption) in captions.items()
        if name in plots
    ]
    if not parts:
        return ""
    return section("How it got there", side_by_side(*parts) if len(parts) > 1 else parts[0])


def _recordings(document: Mapping[str, Any], plots: Mapping[str, Any]) -> str:
    if "recordings" not in plots:
        return ""
    shown = plot(
        "recordings",
        height=parameter_plots.recordings_height(document),
        label="each parameter as estimated from each recording alone",
        caption="Each recording fitted alone, with 95 % intervals; the band is the joint estimate's.",
    )
    return section("Recording by recording", shown, lead=document["recordings"]["text"])


def _facts(document: Mapping[str, Any]) -> list[tuple[str, str]]:
    facts = [
        ("log", source(document["log"]["path"], document["log"]["sha256"])),
        ("identifier", escape(document["identifier"])),
    ]
    split = document["split"]
    windows = f"{counted(split['fit_windows'])} windows fitted, {counted(split['test_windows'])} held out"
    facts.append(("split", f"{escape(split['how'])}: {windows}"))
    rollouts = {kind: counted(count) for kind, count in document["rollouts"].items()}
    facts.append(("rollouts", f"{rollouts['measured']} measured, {rollouts['simulated']} simulated"))
    return facts
