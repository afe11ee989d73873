"""PNG figures of an estimate, for slides and issue threads. Drawn without pyplot, which is slow to import."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from capture_cli.reports.curve_plots import output_scale, residual_scale
from capture_cli.reports.curves import Curves, thin
from capture_cli.reports.quantities import bound, titled, to_precision_of, with_unit
from capture_cli.stores.estimate import Estimate

DPI = 150
WIDTH = 9.0  # inches
POINTS = 4_000  # of each curve: more than there are pixels
# Rows of a figure: a log with thirty sensors is for the page.
MOST_OUTPUTS = 6
# More names than these would cover the curves they name.
MOST_NAMED = 8

INK, MUTED, RULE = "#15191e", "#5c6772", "#d5dade"
MEASURED, SIMULATED, NOMINAL = "#9fb0c1", "#c8430a", "#8c959e"
RESIDUAL, TEST, FLOOR = "#1f6391", "#7546b8", "#1b7a4a"
PATHS = ("#1f6391", "#c8430a", "#1b7a4a", "#7546b8", "#b0476a", "#8a6d1f", "#3d8f96", "#5c6772")


def write_figures(estimate: Estimate, folder: Path) -> list[Path]:
    """Write overlay.png and residual.png into `folder`; also parameters.png and convergence.png where the
    estimate has parameters and rounds. Returns the paths.
    """
    curves = Curves.of(estimate)
    figures = {"overlay": _overlay(estimate, curves), "residual": _residual(estimate, curves)}
    if estimate.document["parameters"]:
        figures["parameters"] = _parameters(estimate)
    if len(estimate.arrays["round/error"]):
        figures["convergence"] = _convergence(estimate)
    written = []
    for name, figure in figures.items():
        path = Path(folder) / f"{name}.png"
        figure.savefig(path, dpi=DPI, facecolor="white")
        written.append(path)
    return written


def _overlay(estimate: Estimate, curves: Curves) -> Figure:
    figure, axes = _rows(estimate, 1.9)
    for k, axis in enumerate(axes):
        factor, unit = output_scale(estimate, curves, k)
        values = np.stack([curves.measured[:, k], *(s[:, k] for s in curves.simulated.values())], axis=1)
        at, drawn, _ = thin(values * factor, curves.slices, POINTS)
        x = curves.x[at]
        measured = axis.plot(x, drawn[:, 0], color=MEASURED, lw=2.4, label="measured")
        framed = _margins(drawn[:, :2])
        nominal = axis.plot(x, drawn[:, 2], color=NOMINAL, lw=0.9, ls=(0, (2, 2)), label="nominal")
        simulated = axis.plot(x, drawn[:, 1], color=SIMULATED, lw=1.0, label="simulated")
        axis.set_ylim(framed)  # a nominal that runs away must not hide the rest
        _title(axis, titled(estimate.attributes["outputs"][k]["name"], unit))
        _shade_test(axis, curves)
    handles = [*measured, *simulated, *nominal, *_test_patch(curves)]
    return _finished(figure, axes, curves, handles)


def _residual(estimate: Estimate, curves: Curves) -> Figure:
    figure, axes = _rows(estimate, 1.5)
    handles = []
    for k, axis in enumerate(axes):
        output = estimate.attributes["outputs"][k]
        factor, unit = residual_scale(estimate, curves, k)
        at, drawn, _ = thin(curves.residual[:, k : k + 1] * factor, curves.slices, POINTS)
        axis.plot(curves.x[at], drawn[:, 0], color=RESIDUAL, lw=0.8)
        floor = estimate.document["noise_floor"].get(output["name"])
        if floor:
            axis.axhspan(-2 * floor * factor, 2 * floor * factor, color=FLOOR, alpha=0.18, lw=0)
            handles = [Patch(color=FLOOR, alpha=0.18, lw=0, label="noise floor ±2 sd")]
        axis.axhline(0, color=RULE, lw=0.8, zorder=0)
        _title(axis, f"{titled(output['name'], unit)}, measured minus simulated")
        _shade_test(axis, curves)
    return _finished(figure, axes, curves, [*handles, *_test_patch(curves)])


def _parameters(estimate: Estimate) -> Figure:
    parameters = estimate.document["parameters"]
    figure = Figure(figsize=(WIDTH, 0.7 + 0.52 * len(parameters)), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    for row, p in enumerate(parameters.values()):
        span = p["high"] - p["low"]
        axis.plot([0, 1], [row, row], color=RULE, lw=3, solid_capstyle="butt", zorder=1)
        if p.get("ci95"):
            ends = (np.clip(p["ci95"], p["low"], p["high"]) - p["low"]) / span
            axis.plot(ends, [row, row], color=RESIDUAL, alpha=0.45, lw=7, solid_capstyle="butt", zorder=2)
        color = SIMULATED if p["at_bound"] or not p["identifiable"] else RESIDUAL
        axis.plot((p["value"] - p["low"]) / span, row, "o", color=color, mec="white", ms=8, zorder=3)
        for x, text, align in ((0, bound(p["low"]), "left"), (1, bound(p["high"]), "right")):
            axis.annotate(
                text, (x, row), (0, -9), textcoords="offset points", ha=align, va="top", color=MUTED, size=8
            )
        axis.annotate(_with_interval(p), (1.02, row), va="center", color=INK, size=9, annotation_clip=False)
    axis.set_yticks(range(len(parameters)), list(parameters), color=INK)
    axis.set(xlim=(-0.01, 1.4), ylim=(len(parameters) - 0.4, -0.6), xticks=[])
    axis.tick_params(length=0)
    axis.spines[:].set_visible(False)
    return figure


def _convergence(estimate: Estimate) -> Figure:
    errors = np.asarray(estimate.arrays["round/error"])
    names = estimate.attributes["parameters"]
    figure = Figure(figsize=(WIDTH, 3.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 2 if names else 1, squeeze=False)[0]
    marker = "o" if len(errors) <= 60 else ""
    axes[0].plot(errors, color=INK, lw=1.2, marker=marker, ms=3)
    if np.all(errors > 0) and errors.max() > 10 * errors.min():
        axes[0].set_yscale("log")
    axes[0].set_ylabel("error / noise floor")
    for k, name in enumerate(names):
        p = estimate.document["parameters"][name]
        place = (np.asarray(estimate.arrays["round/parameters"])[:, k] - p["low"]) / (p["high"] - p["low"])
        axes[1].plot(place, color=PATHS[k % len(PATHS)], lw=1.2, marker=marker, ms=3, label=name)
    if 0 < len(names) <= MOST_NAMED:
        axes[1].legend(frameon=False, fontsize=8, labelcolor=MUTED)
    if names:
        axes[1].set(ylim=(-0.05, 1.05), ylabel="place in range")
        axes[1].set_yticks([0, 0.5, 1], ["low", "middle", "high"])
    for axis in axes:
        axis.set_xlabel("round")
        axis.xaxis.get_major_locator().set_params(integer=True)
        _restrain(axis)
    return figure


def _rows(estimate: Estimate, height: float):
    count = min(MOST_OUTPUTS, len(estimate.attributes["outputs"]))
    figure = Figure(figsize=(WIDTH, 0.9 + height * count), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]


def _finished(figure: Figure, axes, curves: Curves, handles) -> Figure:
    for axis in axes:
        _restrain(axis)
    axes[-1].set_xlabel(curves.x_title)
    axes[-1].set_xlim(curves.x.min(), curves.x.max())
    if handles:
        figure.legend(
            handles=handles,
            loc="outside upper left",
            ncols=len(handles),
            frameon=False,
            fontsize=9,
            labelcolor=MUTED,
        )
    return figure


def _title(axis, text: str) -> None:
    axis.set_title(text, loc="left", fontsize=9, color=INK, pad=4)


def _restrain(axis) -> None:
    axis.spines[["top", "right"]].set_visible(False)
    axis.spines[["left", "bottom"]].set_color(RULE)
    axis.tick_params(colors=MUTED, labelsize=8, length=3, color=RULE)
    axis.xaxis.label.set(color=MUTED, size=9)
    axis.yaxis.label.set(color=MUTED, size=9)


def _shade_test(axis, curves: Curves) -> None:
    for a, b in curves.spans(curves.is_test):
        axis.axvspan(a, b, color=TEST, alpha=0.09, lw=0)


def _test_patch(curves: Curves) -> list[Patch]:
    return [Patch(color=TEST, alpha=0.15, lw=0, label="held out")] if curves.is_test.any() else []


def _margins(values: np.ndarray) -> tuple[float, float]:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    margin = 0.07 * (high - low) or 1e-3 * abs(high) or 1.0
    return low - margin, high + margin


def _with_interval(p) -> str:
    text = with_unit(to_precision_of(p["value"], p.get("sd")), p["unit"])
    if not p.get("ci95"):
        return text
    low, high = (to_precision_of(v, p.get("sd")) for v in p["ci95"])
    return f"{text}   [{low}, {high}]"
