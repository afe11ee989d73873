"""report.html of an estimate: what estimate_page.html shows of it."""

from collections.abc import Mapping
from typing import Any

from capture_cli.common.quantities import counted, significant
from capture_cli.report import curve_plots, findings, parameter_plots
from capture_cli.report.curves import Curves
from capture_cli.report.page import page, rollouts_fact, rollouts_tile
from capture_cli.report.prediction import predictions
from capture_cli.store.estimate import Estimate, EstimateRecord


def render(estimate: Estimate, provenance: Mapping[str, Any] | None) -> str:
    """The page as HTML. provenance: the record of provenance.json, or None where it is not known."""
    curves, record = Curves.of(estimate), estimate.record
    plots = _plots(estimate, curves)
    open_outputs = 4  # those past them are folded: a page of thirty sensors must still open at once
    return page(
        "estimate_page.html",
        plots=plots,
        curves=curve_plots.curve_views(curves),
        document=record,
        provenance=provenance,
        badge=findings.TITLES[record.verdict],
        notes=[*findings.suspicions(estimate), *findings.notes(record)],
        tiles=_tiles(record, provenance),
        next_command=findings.next_command(record, (provenance or {}).get("options", {}).get("out")),
        findings=findings,
        errors=findings.output_errors(estimate),
        predictions=predictions(record, estimate.attributes["outputs"]),
        outputs=estimate.attributes["outputs"],
        open_outputs=open_outputs,
        views=len(curves.slices),
        facts=_facts(record),
    )


def _plots(estimate: Estimate, curves: Curves) -> dict[str, Any]:
    plots = {}
    for k in range(len(estimate.attributes["outputs"])):
        plots[f"overlay-{k}"] = curve_plots.overlay(curves, k)
        plots[f"residual-{k}"] = curve_plots.residual_statistics(curves, k)
    plots["correlation"] = parameter_plots.correlation_matrix(estimate)
    plots["convergence"] = parameter_plots.convergence(estimate)
    plots["recordings"] = parameter_plots.recordings(estimate.record)
    return {name: figure for name, figure in plots.items() if figure}


def _tiles(record: EstimateRecord, provenance: Mapping[str, Any] | None) -> list[tuple[str, str, str]]:
    """(title, number, what it counts)."""
    shown = []
    for part, title in (("test", "error on held-out data"), ("fit", "error on fitted data")):
        error = findings.normalized(record, part)
        if error is not None:
            shown.append((title, significant(error), "× noise floor"))
    parameters = record.parameters.values()
    if parameters:
        determined = sum(p["identifiable"] for p in parameters)
        shown.append(("parameters determined", str(determined), f"of {len(parameters)}"))
    return [*shown, rollouts_tile(record, provenance)]


def _facts(record: EstimateRecord) -> list[tuple[str, str]]:
    split = record.split
    windows = f"{counted(split['fit_windows'])} windows fitted, {counted(split['test_windows'])} held out"
    return [("identifier", record.identifier), ("split", f"{split['how']}: {windows}"), rollouts_fact(record)]
