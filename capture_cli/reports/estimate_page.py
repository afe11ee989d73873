"""report.html of an estimate: the verdict, the numbers, and every curve they come from."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from html import escape
from pathlib import PurePath
from typing import Any

from capture_cli.reports import curve_plots, parameter_plots
from capture_cli.reports import findings
from capture_cli.reports.curves import Curves
from capture_cli.reports.quantities import (
    MISSING,
    bound,
    counted,
    shown_unit,
    significant,
    to_precision_of,
    with_unit,
)
from capture_cli.reports.page import folded, page, plot, section, side_by_side, table, view_selector
from capture_cli.stores.estimate import Estimate

# Outputs past these are folded: a page of thirty sensors must still open at once.
OPEN_OUTPUTS = 4


def render(estimate: Estimate, provenance: Mapping[str, Any] | None) -> str:
    """The page as HTML. provenance: the document of provenance.json, or None where it is not known."""
    curves = Curves.of(estimate)
    document = estimate.document
    figures = _figures(estimate, curves)
    body = "\n".join(
        part
        for part in (
            _header(document, provenance),
            _verdict(document),
            _tiles(document, provenance),
            _parameters(document),
            _errors(estimate),
            _curves(estimate, curves),
            _search(figures),
            _recordings(document, figures),
            _made(document, provenance),
            "<footer>Written by <code>capture identify</code>. The numbers are in estimate.json, the curves in "
            "estimate.zarr, beside this page.</footer>",
        )
        if part
    )
    title = f"{document['task']}: {findings.TITLES[document['verdict']]}"
    return page(title=title, body=body, plots=figures, curves=curve_plots.curve_views(estimate, curves))


def _figures(estimate: Estimate, curves: Curves) -> dict[str, Any]:
    found = {}
    for k in range(len(estimate.attributes["outputs"])):
        found[f"overlay-{k}"] = curve_plots.overlay(estimate, curves, k)
        found[f"residual-{k}"] = curve_plots.residual_statistics(estimate, curves, k)
    found["correlation"] = parameter_plots.correlation_matrix(estimate)
    found["convergence"] = parameter_plots.convergence(estimate)
    found["recordings"] = parameter_plots.recordings(estimate.document)
    return {name: figure for name, figure in found.items() if figure}


def _header(document: Mapping[str, Any], provenance: Mapping[str, Any] | None) -> str:
    facts = [
        f"log <code>{escape(PurePath(document['log']['path']).name)}</code>",
        escape(document["identifier"]),
    ]
    if provenance:
        facts.append(datetime.fromisoformat(provenance["began"]).strftime("%-d %B %Y, %H:%M UTC"))
    return (
        '<header><p class="overline">capture identify</p>'
        f'<h1>{escape(document["task"])}</h1><p class="overline">{" · ".join(facts)}</p></header>'
    )


def _verdict(document: Mapping[str, Any]) -> str:
    verdict = document["verdict"]
    notes = "".join(f"<li>{escape(n)}</li>" for n in findings.notes(document))
    command = document.get("next_command")
    following = f'<div class="next"><span>next</span><code>{escape(command)}</code></div>' if command else ""
    return (
        f'<div class="verdict {verdict}"><span class="badge">{findings.TITLES[verdict]}</span>'
        f'<p class="sentence">{escape(findings.sentence(document))}</p>'
        f"{f'<ul>{notes}</ul>' if notes else ''}{following}</div>"
    )


def _tiles(document: Mapping[str, Any], provenance: Mapping[str, Any] | None) -> str:
    parameters = document["parameters"].values()
    tiles = []
    for part, title in (("test", "error on held-out data"), ("fit", "error on fitted data")):
        error = findings.normalized(document, part)
        if error is not None:
            tiles.append((title, significant(error), "× noise floor"))
    found = sum(p["identifiable"] for p in parameters)
    if parameters:
        tiles.append(("parameters determined", str(found), f"of {len(parameters)}"))
    simulated = f"{document['rollouts']['simulated']:,}".replace(",", " ")
    tiles.append(
        ("rollouts simulated", simulated, f"in {significant(provenance['seconds'])} s" if provenance else "")
    )
    cells = "".join(
        f"<div><dt>{title}</dt><dd>{value} <small>{detail}</small></dd></div>"
        for title, value, detail in tiles
    )
    return f'<dl class="tiles">{cells}</dl>'


def _parameters(document: Mapping[str, Any]) -> str:
    title = "Parameters"
    if not document["parameters"]:
        return section(
            title, lead="None are declared: only the state at the start of each window was fitted."
        )
    rows = [_parameter_row(name, p) for name, p in document["parameters"].items()]
    head = ["parameter", "estimate", "sd", "95 % interval", "within its range", "remarks"]
    return section(
        title,
        table(head, rows, numeric=(1, 2, 3)),
        lead="Estimate and 95 % interval, drawn between the bounds the task declares.",
    )


def _parameter_row(name: str, p: Mapping[str, Any]) -> list[str]:
    sd, interval = p.get("sd"), p.get("ci95")
    between = MISSING
    if interval:
        between = f"{to_precision_of(interval[0], sd)} to {to_precision_of(interval[1], sd)}"
    remarks = []
    if not p["identifiable"]:
        remarks.append('<span class="unsure">not determined</span>')
    if p["at_bound"]:
        remarks.append('<span class="warn">at its bound</span>')
    return [
        f'<span class="name">{escape(name)}</span> <span class="unit">{escape(shown_unit(p["unit"]))}</span>',
        f'<span class="name">{to_precision_of(p["value"], sd)}</span>',
        significant(sd, 2),
        between,
        _range(p),
        ", ".join(remarks) or '<span class="quiet">determined</span>',
    ]


def _range(p: Mapping[str, Any]) -> str:
    """The value and its interval on a bar from low to high."""

    def percent(value: float) -> float:
        return 100 * min(1.0, max(0.0, (value - p["low"]) / (p["high"] - p["low"])))

    bar = ""
    if p.get("ci95"):
        a, b = (percent(v) for v in p["ci95"])
        bar = f'<span class="interval" style="left:{a:.2f}%;width:{b - a:.2f}%"></span>'
    return (
        f'<div class="range">{bar}<span class="value" style="left:{percent(p["value"]):.2f}%"></span></div>'
        f'<div class="ends"><span>{bound(p["low"])}</span><span>{bound(p["high"])}</span></div>'
    )


def _errors(estimate: Estimate) -> str:
    document, rows = estimate.document, []
    for e in findings.output_errors(estimate):
        source = findings.FLOOR_SOURCES.get(e.floor_source, e.floor_source)
        rows.append(
            [
                f'<span class="name">{escape(e.name)}</span>',
                with_unit(significant(e.nominal), escape(e.nominal_unit)),
                *(with_unit(significant(v), escape(e.unit)) for v in (e.fit, e.test, e.floor)),
                with_unit(significant(e.ratio), "×"),
                f'<span class="quiet">{escape(source)}</span>',
            ]
        )
    overall = [findings.normalized(document, part) for part in ("fit", "test")]
    rows.append(
        [
            '<span class="quiet">all, over the noise floor</span>',
            "",
            *(with_unit(significant(v), "×") for v in overall),
            "",
            "",
            "",
        ]
    )
    head = ["output", "nominal", "fitted", "held out", "noise floor", "over the floor", "noise floor is"]
    return section(
        "Error",
        table(head, rows, numeric=(1, 2, 3, 4, 5)),
        lead="RMSE of measured minus simulated. Held-out windows were never fitted; nominal is the model as it was "
        "declared, on the same windows. No model can do better than the noise floor.",
    )


def _curves(estimate: Estimate, curves: Curves) -> str:
    blocks = [_output(estimate, curves, k) for k in range(len(estimate.attributes["outputs"]))]
    names = [o["name"] for o in estimate.attributes["outputs"]]
    shown = [f"<h3>{escape(n)}</h3>{b}" for n, b in zip(names, blocks[:OPEN_OUTPUTS], strict=False)]
    hidden = [folded(n, b) for n, b in zip(names[OPEN_OUTPUTS:], blocks[OPEN_OUTPUTS:], strict=True)]
    selector = view_selector("show") if len(curves.slices) > 1 else ""
    return section(
        "Measured and simulated",
        selector,
        *shown,
        *hidden,
        lead="The simulation starts afresh at every window. Drag to zoom, double-click to go back, click a name in "
        "the legend to hide it.",
    )


def _output(estimate: Estimate, curves: Curves, k: int) -> str:
    name = estimate.attributes["outputs"][k]["name"]
    return plot(
        f"overlay-{k}",
        height=460,
        label=f"{name}: measured, simulated and nominal over time, and the residual",
    ) + plot(
        f"residual-{k}",
        height=250,
        label=f"{name}: histogram and autocorrelation of the residual",
        caption="Left: the residual against what the noise floor alone would give. Right: its autocorrelation; "
        "white noise stays in the band.",
    )


def _search(figures: Mapping[str, Any]) -> str:
    parts = []
    if "correlation" in figures:
        parts.append(
            _titled_plot(
                "Correlation of the estimates",
                plot(
                    "correlation",
                    height=400,
                    label="correlation matrix of the parameters",
                    caption="Near ±1 the log fixes a combination of two parameters better than either alone.",
                ),
            )
        )
    if "convergence" in figures:
        parts.append(
            _titled_plot(
                "Convergence",
                plot(
                    "convergence",
                    height=400,
                    label="error and parameters of the best so far, per round",
                    caption="The best so far, round by round, and where in its range each parameter stands.",
                ),
            )
        )
    if not parts:
        return ""
    return section("How it got there", side_by_side(*parts) if len(parts) > 1 else parts[0])


def _titled_plot(title: str, figure: str) -> str:
    return f"<div><h3>{title}</h3>{figure}</div>"


def _recordings(document: Mapping[str, Any], figures: Mapping[str, Any]) -> str:
    if "recordings" not in figures:
        return ""
    found = document["recordings"]
    answer = {
        True: "The recordings agree: their estimates differ no more than their intervals allow.",
        False: "The recordings disagree: their estimates differ by more than their intervals allow.",
        None: "Too little is known to say whether the recordings agree.",
    }[found.get("agree")]
    return section(
        "Recording by recording",
        plot(
            "recordings",
            height=parameter_plots.recordings_height(document),
            label="each parameter as estimated from each recording alone",
            caption="Each recording fitted alone, with 95 % intervals; the band is the interval of the joint estimate.",
        ),
        lead=found.get("text") or answer,
    )


def _made(document: Mapping[str, Any], provenance: Mapping[str, Any] | None) -> str:
    log = document["log"]
    facts = [
        (
            "log",
            f"<code>{escape(str(log['path']))}</code><br><code class=quiet>sha256 {escape(log['sha256'])}</code>",
        )
    ]
    facts.append(("identifier", escape(document["identifier"])))
    split = document.get("split")
    if split:
        windows = f"{counted(split['fit_windows'], 'window')} fitted, {split['test_windows']} held out"
        facts.append(("split", f"{escape(split['how'])}: {windows}"))
    if document.get("starts"):
        refined = (
            "refined together with the parameters" if document["starts"]["refined"] else "taken from the log"
        )
        facts.append(("start of each window", refined))
    rollouts = document["rollouts"]
    facts.append(
        (
            "rollouts",
            f"{rollouts['measured']:,} measured, {rollouts['simulated']:,} simulated".replace(",", " "),
        )
    )
    facts += _provenance_facts(provenance) if provenance else []
    listed = "".join(f"<dt>{title}</dt><dd>{value}</dd>" for title, value in facts)
    return section("How it was made", f'<dl class="facts">{listed}</dl>')


def _provenance_facts(provenance: Mapping[str, Any]) -> list[tuple[str, str]]:
    packages = [f"{name} {version}" for name, version in provenance["packages"].items()]
    made_by = [f"capture {provenance['capture']}", f"python {provenance['python']}", *packages]
    facts = [("command", f"<code>{escape(str(provenance['command']))}</code>")]
    options = {name: value for name, value in provenance["options"].items() if value is not None}
    if options:
        text = "<br>".join(f"{escape(name)} = {escape(str(value))}" for name, value in options.items())
        facts.append(("options", f"<code>{text}</code>"))
    for name, source in provenance["inputs"].items():
        digest = f"<code class=quiet>sha256 {escape(source['sha256'])}</code>"
        facts.append((f"input: {escape(name)}", f"<code>{escape(source['path'])}</code><br>{digest}"))
    facts.append(("versions", escape(", ".join(made_by))))
    facts.append(("machine", escape(provenance["platform"])))
    facts.append(("began", escape(f"{provenance['began']}, took {significant(provenance['seconds'])} s")))
    return facts
