"""PNG figures of an estimate, for slides and issue threads."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from capture_cli.common.quantities import bound, estimated, place, to_precision_of
from capture_cli.report.curves import Curves
from capture_cli.report.figure_parts import (
    INK,
    MUTED,
    PALETTE,
    RULE,
    draw_outputs,
    draw_residuals,
    finish,
    named,
    new_figure,
    restrain,
    rows,
    save,
)
from capture_cli.store.estimate import Estimate

PATHS = ("#1f6391", "#c8430a", "#1b7a4a", "#7546b8", "#b0476a", "#8a6d1f", "#3d8f96", "#5c6772")


def write_figures(estimate: Estimate, folder: Path) -> list[Path]:
    """Write overlay.png and residual.png into `folder`; also parameters.png and convergence.png where the
    estimate has parameters and rounds. Returns the paths.
    """
    curves = Curves.of(estimate)
    drawings = {
        "overlay": partial(_of_outputs, curves, 1.9, draw_outputs),
        "residual": partial(_of_outputs, curves, 1.5, draw_residuals),
    }
    if estimate.record.parameters:
        drawings["parameters"] = partial(_parameters, estimate)
    if len(estimate.arrays["round/error"]):
        drawings["convergence"] = partial(_convergence, estimate)
    return save(drawings, folder)


def _of_outputs(curves: Curves, height: float, draw: Callable[[Axes, Curves, int], list]) -> Figure:
    """What `draw` draws of each output, in rows of this height, inches."""
    figure, axes = rows(curves.measured.shape[1], [height])
    handles = [draw(axis, curves, k) for k, (axis,) in enumerate(axes)]
    return finish(figure, axes, curves, max(reversed(handles), key=len))


def _parameters(estimate: Estimate) -> Figure:
    parameters = estimate.record.parameters
    figure = new_figure(0.7 + 0.52 * len(parameters))
    axis = figure.subplots()
    for row, p in enumerate(parameters.values()):
        axis.plot([0, 1], [row, row], color=RULE, lw=3, solid_capstyle="butt", zorder=1)
        if p.get("ci95"):
            ends = place(np.clip(p["ci95"], p["low"], p["high"]), p)
            axis.plot(
                ends,
                [row, row],
                color=PALETTE["--residual"],
                alpha=0.45,
                lw=7,
                solid_capstyle="butt",
                zorder=2,
            )
        color = PALETTE["--simulated" if p["at_bound"] or not p["identifiable"] else "--residual"]
        axis.plot(place(p["value"], p), row, "o", color=color, mec="white", ms=8, zorder=3)
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
    figure = new_figure(3.0)
    axes = figure.subplots(1, 2 if names else 1, squeeze=False)[0]
    marker = "o" if len(errors) <= 60 else ""
    axes[0].plot(errors, color=INK, lw=1.2, marker=marker, ms=3)
    if np.all(errors > 0) and errors.max() > 10 * errors.min():
        axes[0].set_yscale("log")
    axes[0].set_ylabel("error / noise floor")
    for k, name in enumerate(names):
        p = estimate.record.parameters[name]
        path = place(np.asarray(estimate.arrays["round/parameters"])[:, k], p)
        axes[1].plot(path, color=PATHS[k % len(PATHS)], lw=1.2, marker=marker, ms=3)
    if 0 < len(names) <= len(PATHS):  # more names would cover the curves they name
        named(axes[1], names)
    if names:
        axes[1].set(ylim=(-0.05, 1.05), ylabel="place in range")
        axes[1].set_yticks([0, 0.5, 1], ["low", "middle", "high"])
    for axis in axes:
        axis.set_xlabel("round")
        axis.xaxis.get_major_locator().set_params(integer=True)
        restrain(axis)
    return figure


def _with_interval(p) -> str:
    text = estimated(p)
    if not p.get("ci95"):
        return text
    low, high = (to_precision_of(v, p.get("sd")) for v in p["ci95"])
    return f"{text}   [{low}, {high}]"
