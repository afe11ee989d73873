"""Pieces of PNG figures. Drawn without pyplot, which is slow to import."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.text import Text

from capture_cli.common.frozen import frozen
from capture_cli.common.processes import in_processes
from capture_cli.common.quantities import titled
from capture_cli.report.curve_plots import SHADES
from capture_cli.report.curves import Curves, thin


@frozen
class SETTINGS:
    dpi: int = 150
    width: float = 9.0  # inches
    compression: int = 2  # of zlib, not 6: a seventh more bytes, written in half the time
    points: int = 4_000  # of each curve: more than there are pixels
    # Around and between the rows of a figure, inches: matplotlib's own layout measures every number of every
    # axis twice.
    left: float = 0.62
    right: float = 0.1
    above: float = 0.55
    below: float = 0.42
    between: float = 0.28
    # Rows of a figure: a log with thirty sensors is for the page.
    most_outputs: int = 6


INK, MUTED, RULE = "#15191e", "#5c6772", "#d5dade"
# The light colours of page.css, by their names there.
PALETTE = {
    "--measured": "#9fb0c1",
    "--simulated": "#c8430a",
    "--nominal": "#8c959e",
    "--before": "#1f6391",
    "--after": "#c8430a",
    "--residual": "#1f6391",
    "--test": "#7546b8",
    "--test-shade": "#7546b8",
    "--select": "#b98a1d",
    "--select-shade": "#b98a1d",
    "--floor": "#1b7a4a",
}
DASHES = {"solid": "-", "dot": (0, (2, 2)), "dash": (0, (5, 2))}


# What makes a figure.
Drawing = Callable[[], Figure]


def save(drawings: Mapping[str, Drawing], folder: Path) -> list[Path]:
    """Write NAME.png of every drawing; returns the paths."""
    paths = [Path(folder) / f"{name}.png" for name in drawings]
    for _ in in_processes(_draw, list(zip(paths, drawings.values(), strict=True)), None):
        pass
    return paths


def _draw(job: tuple[Path, Drawing]) -> None:
    path, drawing = job
    figure = drawing()
    _without_formulas(figure)
    # savefig lays out and draws everything twice
    figure.canvas.print_png(path, pil_kwargs={"compress_level": SETTINGS.compression})


def _without_formulas(figure: Figure) -> None:
    """Draw all texts as they are, also names with a $; only the powers of ten of a logarithmic axis are formulas."""
    scales = [axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)]
    powers = {
        label for axis in scales if axis.get_scale() == "log" for label in axis.get_ticklabels(which="both")
    }
    for text in figure.findobj(Text):
        text.set_parse_math(text in powers)


def new_figure(height: float, layout: str | None = "constrained") -> Figure:
    """An empty figure, as wide as all of them and `height` inches high."""
    figure = Figure(figsize=(SETTINGS.width, height), dpi=SETTINGS.dpi, layout=layout, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def rows(outputs: int, heights: Sequence[float]) -> tuple[Figure, np.ndarray]:
    """A figure and its axes (output, one for each of `heights` in inches), under each other on one time axis."""
    count = min(SETTINGS.most_outputs, outputs)
    heights = np.tile(heights, count)
    height = SETTINGS.above + heights.sum() + SETTINGS.below - SETTINGS.between
    figure = new_figure(height, layout=None)
    figure.subplots_adjust(
        SETTINGS.left / SETTINGS.width,
        SETTINGS.below / height,
        1 - SETTINGS.right / SETTINGS.width,
        1 - SETTINGS.above / height,
    )
    within = heights - SETTINGS.between
    axes = figure.subplots(
        len(heights),
        1,
        sharex=True,
        squeeze=False,
        height_ratios=within,
        gridspec_kw={"hspace": SETTINGS.between / within.mean()},
    )
    return figure, axes[:, 0].reshape(count, -1)


def draw_outputs(axis: Axes, curves: Curves, k: int) -> list:
    """Output k, measured and simulated over time; returns the legend's handles."""
    factor, unit = curves.scale(k)
    values = [curves.measured[:, k], *(curves.simulated[m.name][:, k] for m in curves.models)]
    at, drawn, _ = thin(np.stack(values, axis=1) * factor, curves.slices, SETTINGS.points)
    x = curves.x[at]
    look = _drawn(curves, "measured", k, PALETTE["--measured"], 2.4)
    handles = axis.plot(x, drawn[:, 0], label="measured", **look)
    for m, values in reversed(list(zip(curves.models, drawn.T[1:], strict=True))):
        look = _drawn(curves, m.name, k, PALETTE[m.color], 0.7 * m.width, DASHES[m.dash])
        handles += axis.plot(x, values, label=m.title, **look)
    framed = [0, *(1 + i for i, m in enumerate(curves.models) if m.framed)]
    axis.set_ylim(margins(drawn[:, framed]))
    title(axis, titled(curves.names[k], unit))
    shade_parts(axis, curves)
    return handles


def _drawn(curves: Curves, name: str, k: int, color: str, width: float, dash="-") -> dict:
    """How a curve of output k looks: by points where it has gaps."""
    if curves.has_gaps(name, k):
        return {"color": color, "ls": "", "marker": "o", "mew": 0, "ms": 1.6 * width**0.5}
    return {"color": color, "ls": dash, "lw": width}


def draw_residuals(axis: Axes, curves: Curves, k: int) -> list:
    """Residual of output k over time, and the noise floor; returns the legend's handles of the floor."""
    factor, unit = curves.residual_scale(k)
    drawn_models = [m for m in curves.models if m.residual_color]
    values = np.stack([curves.residuals[m.name][:, k] for m in drawn_models], axis=1)
    at, drawn, _ = thin(values * factor, curves.slices, SETTINGS.points)
    for m, series in reversed(list(zip(drawn_models, drawn.T, strict=True))):
        axis.plot(curves.x[at], series, **_drawn(curves, "residual", k, PALETTE[m.residual_color], 0.8))
    floor, handles = curves.floors[k], []
    if floor:
        look = {"color": PALETTE["--floor"], "alpha": 0.18, "lw": 0}
        axis.axhspan(-2 * floor * factor, 2 * floor * factor, **look)
        handles = [Patch(label="noise floor ±2 sd", **look)]
    axis.axhline(0, color=RULE, lw=0.8, zorder=0)
    title(axis, f"{titled(curves.names[k], unit)}, measured minus simulated")
    shade_parts(axis, curves)
    return handles


def finish(figure: Figure, axes: np.ndarray, curves: Curves, handles: list) -> Figure:
    """Time axis and legend of a figure of rows."""
    for axis in axes.ravel():
        restrain(axis)
    last = axes.ravel()[-1]
    last.set_xlabel(curves.x_title)
    last.set_xlim(curves.x.min(), curves.x.max())
    shaded = {part: PALETTE[s] for part, s in SHADES.items() if curves.windows_of(part).any()}
    patches = [Patch(color=color, alpha=0.15, lw=0, label=part) for part, color in shaded.items()]
    legend(figure, [*handles, *patches])
    return figure


def legend(figure: Figure, handles: list, columns: int | None = None) -> None:
    """A legend over the figure, in so many columns; beside each other where None."""
    if handles:
        look = {"frameon": False, "fontsize": 9, "labelcolor": MUTED}
        loc = "outside upper left" if figure.get_layout_engine() else "upper left"
        figure.legend(handles=handles, loc=loc, ncols=columns or len(handles), **look)


def named(axis: Axes, names: Sequence[str]) -> None:
    """A legend in the plot, of its lines by `names`; of labels, matplotlib leaves out those that begin with "_"."""
    shown = axis.legend(axis.lines, ["." for _ in names], frameon=False, fontsize=8, labelcolor=MUTED)
    for text, name in zip(shown.get_texts(), names, strict=True):
        text.set_text(name)


def title(axis: Axes, text: str) -> None:
    """A title at the left."""
    axis.set_title(text, loc="left", fontsize=9, color=INK, pad=4)


def restrain(axis: Axes) -> None:
    """Less ink for the frame than for what is in it."""
    axis.spines[["top", "right"]].set_visible(False)
    axis.spines[["left", "bottom"]].set_color(RULE)
    axis.tick_params(colors=MUTED, labelsize=8, length=3, color=RULE)
    axis.xaxis.label.set(color=MUTED, size=9)
    axis.yaxis.label.set(color=MUTED, size=9)


def shade_parts(axis: Axes, curves: Curves) -> None:
    """Shade what was not fitted."""
    for part, shade in SHADES.items():
        for a, b in curves.spans(curves.windows_of(part)):
            axis.axvspan(a, b, color=PALETTE[shade], alpha=0.09, lw=0)


def margins(values: np.ndarray) -> tuple[float, float]:
    """Limits that leave a little room around `values`."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    margin = 0.07 * (high - low) or 1e-3 * abs(high) or 1.0
    return low - margin, high + margin
