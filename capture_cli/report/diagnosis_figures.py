"""PNG figures of a diagnosis, for slides and issue threads."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from capture_cli.common.quantities import place, significant, with_unit
from capture_cli.report.curves import Curves
from capture_cli.report.diagnosis_findings import PARTS, moved, shift, stage_errors
from capture_cli.report.diagnosis_plots import (
    COLORS,
    acceleration_scale,
    curve_title,
    drawn_against,
    drawn_curves,
    localisation_columns,
    residual_accelerations,
    whiskers,
)
from capture_cli.report.figure_parts import (
    INK,
    MUTED,
    PALETTE,
    RULE,
    draw_outputs,
    draw_residuals,
    finish,
    legend,
    new_figure,
    restrain,
    rows,
    save,
    title,
)
from capture_cli.report.figure_parts import SETTINGS as FIGURE_PARTS
from capture_cli.store.diagnosis import Diagnosis


def write_figures(diagnosis: Diagnosis, folder: Path) -> list[Path]:
    """Write before_after.png and stages.png into `folder`; also localisation.png where the log is long enough, and
    absorbed.png where effects were found. Returns the paths.
    """
    drawings = {"before_after": partial(_before_after, diagnosis), "stages": partial(_stages, diagnosis)}
    if any(drawn_curves(diagnosis, k) for k in range(len(diagnosis.attributes["outputs"]))):
        drawings["localisation"] = partial(_localisation, diagnosis)
    if diagnosis.record.absorbed:
        drawings["absorbed"] = partial(_absorbed, diagnosis)
    return save(drawings, folder)


def _before_after(diagnosis: Diagnosis) -> Figure:
    curves = Curves.of(diagnosis)
    figure, axes = rows(curves.measured.shape[1], [1.9, 1.2])
    handles = []
    for k, (over, under) in enumerate(axes):
        outputs = draw_outputs(over, curves, k)
        handles.append([*outputs, *draw_residuals(under, curves, k)])
    return finish(figure, axes, curves, max(handles, key=len))


def _stages(diagnosis: Diagnosis) -> Figure:
    found = stage_errors(diagnosis)
    count = len(found.names)
    figure = new_figure(1.1 + 0.62 * (count + bool(found.floor)))
    axis = figure.subplots()
    log = {"log": True} if found.decades else {}
    bar = 0.24  # of the distance between two models
    for number, (part, errors) in enumerate(found.errors.items()):
        at = np.arange(count) + bar * (number - (len(found.errors) - 1) / 2)
        bars = axis.barh(at, errors, bar, color=PALETTE[COLORS[part]], label=PARTS[part], **log)
        text = [with_unit(significant(v), found.unit) for v in errors]
        axis.bar_label(bars, text, padding=3, color=INK, size=8)
    if found.floor:
        bars = axis.barh([count], [found.floor], bar, color=PALETTE["--floor"], **log)
        axis.bar_label(bars, [found.floor_text], padding=3, color=INK, size=8)
    names = [*found.names, *["noise floor"] * bool(found.floor)]
    axis.set_yticks(range(len(names)), names, color=INK)
    axis.set(ylim=(len(names) - 0.5, -0.5), xlabel=found.title)
    largest = max(max(errors) for errors in found.errors.values())
    smallest = min(min(errors) for errors in found.errors.values())
    axis.set_xlim(smallest / 3 if found.decades else 0.0, largest * (2 if found.decades else 1.12))
    restrain(axis)
    axis.tick_params(axis="y", length=0, labelsize=9, labelcolor=INK)
    legend(figure, axis.get_legend_handles_labels()[0])
    return figure


def _absorbed(diagnosis: Diagnosis) -> Figure:
    found, parameters = moved(diagnosis.record), diagnosis.record.parameters
    figure = new_figure(0.9 + 0.5 * len(found))
    axis = figure.subplots()
    for at, row in enumerate(found):
        p = parameters[row.name]
        before, after = place(row.before, p), place(row.after, p)
        reach = [[length] for length in whiskers(p)]
        axis.plot([0, 1], [at, at], color=RULE, lw=2, zorder=1)
        arrow = {"arrowstyle": "-|>", "color": MUTED, "shrinkA": 4, "shrinkB": 4}
        axis.annotate("", (after, at), (before, at), arrowprops=arrow, zorder=2)
        axis.plot(before, at, "o", mfc="white", mec=PALETTE["--before"], mew=2, ms=8, zorder=3)
        look = {"color": PALETTE["--after"], "ms": 8, "zorder": 3, "capsize": 3}
        axis.errorbar(after, at, xerr=reach, fmt="o", **look)
        text = f"{shift(row)}   ({significant(row.shift_in_sd)} sd)"
        axis.annotate(text, (1.04, at), va="center", color=INK, size=9, annotation_clip=False)
    axis.set_yticks(range(len(found)), [row.name for row in found])
    axis.set(xlim=(-0.02, 1.75), ylim=(len(found) - 0.4, -0.6))
    axis.set_xticks([0, 0.5, 1], ["low", "middle", "high"])
    restrain(axis)
    axis.spines[:].set_visible(False)
    axis.tick_params(axis="y", length=0, labelsize=9, labelcolor=INK)
    marks = {"declared": "--before", "with what was found": "--after"}
    handles = [axis.plot([], [], "o", color=PALETTE[c], label=name)[0] for name, c in marks.items()]
    handles[0].set(mfc="white", mew=2)
    legend(figure, handles)
    return figure


def _localisation(diagnosis: Diagnosis) -> Figure:
    outputs = range(min(FIGURE_PARTS.most_outputs, len(diagnosis.attributes["outputs"])))
    drawn = {k: found for k in outputs if (found := drawn_curves(diagnosis, k))}
    columns = localisation_columns(max(len(found) for found in drawn.values()))
    # where there are many, as for the outputs the rest is for the page
    most = columns * max(1, 2 * FIGURE_PARTS.most_outputs // len(drawn))
    drawn = {k: _most_telling(diagnosis, found, most) for k, found in drawn.items()}
    heights = {k: -(-len(found) // columns) for k, found in drawn.items()}
    figure = new_figure(0.5 + 1.9 * sum(heights.values()))
    axes = figure.subplots(sum(heights.values()), columns, squeeze=False)
    first, handles = 0, []
    for k, found in drawn.items():
        own = axes[first : first + heights[k]].ravel()
        first += heights[k]
        for axis, row in zip(own, found, strict=False):
            handles = _draw_curve(axis, diagnosis, k, row)
        for axis in own[len(found) :]:
            axis.set_visible(False)
    legend(figure, handles)
    return figure


def _most_telling(diagnosis: Diagnosis, rows: Sequence[int], most: int) -> list[int]:
    """Of the curves `rows` those that account for most, in their order."""
    share = [diagnosis.attributes["curves"][row]["share"] for row in rows]
    return [rows[k] for k in sorted(np.argsort(share, kind="stable")[::-1][:most])]


def _draw_curve(axis, diagnosis: Diagnosis, k: int, row: int) -> list:
    factor, unit = acceleration_scale(diagnosis, k)
    against = diagnosis.attributes["curves"][row]
    x, x_title = drawn_against(diagnosis, row)
    before, after, error = residual_accelerations(diagnosis, row, factor)
    color = PALETTE["--before"]
    axis.axhline(0, color=RULE, lw=0.8, zorder=0)
    axis.fill_between(x, before - 2 * error, before + 2 * error, color=color, alpha=0.16, lw=0)
    handles = axis.plot(x, before, color=color, lw=1.2, label="declared")
    if diagnosis.record.effects:
        look = {"color": PALETTE["--after"], "lw": 1.2, "marker": "o", "ms": 2.5}
        handles += axis.plot(x, after, label="with what was found", **look)
    name = diagnosis.attributes["outputs"][k]["name"]
    title(axis, f"residual of {name}: {curve_title(against)}")
    axis.set(xlabel=x_title, ylabel=f"[{unit}]")
    restrain(axis)
    return handles
