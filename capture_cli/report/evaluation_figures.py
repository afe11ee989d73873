"""PNG figures of an evaluation in the paper's form: identifiers against each other, by round."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from capture_cli.report.figure_parts import legend, new_figure, restrain, save, title
from capture_cli.store.evaluation import EvaluationRecord

OURS, PAPER = "#1f6391", "#c8430a"
OTHERS = ("#1b7a4a", "#7546b8", "#b98a1d", "#5c6772", "#b0476a", "#3d8f96", "#8c959e", "#8a6d1f")


def write_figures(document: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write parameter_difference.png, trajectory_difference.png, cost.png and, where there is one, success.png."""
    record = EvaluationRecord.of(document)
    drawings = {
        "parameter_difference": partial(_parameters, record),
        "trajectory_difference": partial(_single, record, _trajectory),
        "cost": partial(_single, record, _cost),
    }
    if all(e["success"] is not None for e in record.identifiers.values()):
        drawings["success"] = partial(_single, record, _success)
    return save(drawings, folder)


def _parameters(record: EvaluationRecord) -> Figure:
    names = record.parameters
    columns = 3
    rows = -(-len(names) // columns)
    figure = new_figure(0.9 + 2.6 * rows)
    axes = figure.subplots(rows, min(columns, len(names)), squeeze=False, sharex=True, sharey=True).ravel()
    for axis, name in zip(axes, names, strict=False):
        for label, e, look in _looks(record):
            axis.plot(e["parameter_difference"][name], label=label, **look)
        title(axis, name)
        _frame(axis, "normalised difference")
    for axis in axes[len(names) :]:
        axis.set_visible(False)
    return _finished(figure, record)


def _single(record: EvaluationRecord, draw: Callable[[Axes, Mapping[str, Any]], None]) -> Figure:
    figure = new_figure(4.2)
    draw(figure.subplots(), record)
    return _finished(figure, record)


def _trajectory(axis: Axes, record: EvaluationRecord) -> None:
    for label, e, look in _looks(record):
        mean, sd = np.array(e["trajectory_difference"]), np.array(e["trajectory_difference_sd"])
        axis.plot(mean, label=label, **look)
        axis.fill_between(np.arange(len(mean)), mean - sd, mean + sd, color=look["color"], alpha=0.12, lw=0)
    _frame(axis, "trajectory difference")


def _success(axis: Axes, record: EvaluationRecord) -> None:
    for label, e, look in _looks(record):
        axis.plot(e["success"], label=label, **look)
    axis.set_ylim(-0.02, 1.02)
    _frame(axis, "success")


def _cost(axis: Axes, record: EvaluationRecord) -> None:
    smallest = 1e-4  # of a range: what is nearer is drawn there, where axes are logarithmic
    for label, e, look in _looks(record):
        spent = np.array(e["simulated_rollouts"][1:])
        axis.loglog(spent, np.maximum(e["parameter_difference"]["mean"][1:], smallest), label=label, **look)
    _frame(axis, "normalised parameter difference")
    axis.set_xlabel("simulated rollouts per pair")


def _frame(axis: Axes, what: str) -> None:
    restrain(axis)
    axis.set_ylabel(what)
    axis.set_xlabel("rounds")
    if axis.get_yscale() == "linear":
        axis.set_ylim(bottom=min(0, axis.get_ylim()[0]))


def _looks(record: EvaluationRecord):
    """(label, entry of evaluation.json, look of its line): solid, and dashed for ablations, as in the paper."""
    others = iter(OTHERS * (1 + len(record.identifiers) // len(OTHERS)))
    for label, e in record.identifiers.items():
        ablation = "(" in label
        color = {"capture": PAPER, "capture-refined": OURS}.get(label) or next(others)
        yield label, e, {"color": color, "lw": 1.5, "ls": (0, (4, 2)) if ablation else "-"}


def _finished(figure: Figure, record: EvaluationRecord) -> Figure:
    handles = [Line2D([], [], label=label, **look) for label, _, look in _looks(record)]
    legend(figure, handles, columns=4)
    return figure
