"""The interactive plots of a record's curves: measured and simulated over time, and their residual."""

from typing import Any

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.common.quantities import scaled_unit, titled
from capture_cli.report.curves import HELD_OUT, Curves, Model, autocorrelation, bin_edges, thin
from capture_cli.report.plotly_parts import Plot, band, in_template, line, mark, packed, swatch

# Shades of the parts of a log; what is fitted has none.
SHADES = {"selecting": "--select-shade", HELD_OUT: "--test-shade"}


@frozen
class SETTINGS:
    # Numbers of all curves together: 2 MB for the whole log, and half of that for the windows held apart.
    numbers: int = 400_000
    most_points: int = 40_000
    fewest_points: int = 2_000
    most_window_points: int = 4_000
    fewest_window_points: int = 500
    # px, of a sample of an output that is drawn by points, where a line would be 1 px wide
    point: float = 2.6
    # More marks than these are a grey wall.
    most_episode_marks: int = 60


def curve_views(curves: Curves) -> dict[str, Any]:
    """The points of every curve, and the views of them: the whole log, and windows.

    Where the log is short enough to be drawn point by point, every window can be chosen; otherwise the best,
    the median and the worst of the held-out and of the fitted ones, whose points are then held apart.
    """
    values, names = _series(curves)
    budget = _budget(SETTINGS.numbers, len(names), SETTINGS.fewest_points, SETTINGS.most_points)
    at, rows, ends = thin(values, curves.slices, budget)
    sets = {"log": _packed_set(curves.x[at], rows, names)}
    views = [{"label": "the whole log", "set": "log", "first": 0, "last": len(at)}]
    error = curves.window_rms(_scale(curves))
    if len(curves.x) <= budget:
        if len(ends) > 1:
            views += [_view(curves, w, error[w], "log", ends[w]) for w in range(len(ends))]
        return {"sets": sets, "views": views}
    budget = _budget(
        SETTINGS.numbers // 2, 6 * len(names), SETTINGS.fewest_window_points, SETTINGS.most_window_points
    )
    for w, kind in _telling_windows(curves, error).items():
        steps = curves.slices[w]
        at, rows, ends = thin(values[steps], (slice(0, steps.stop - steps.start),), budget)
        sets[f"window-{w}"] = _packed_set(curves.x[steps][at], rows, names)
        views.append(_view(curves, w, error[w], f"window-{w}", ends[0], f"{kind} "))
    return {"sets": sets, "views": views}


def overlay(curves: Curves, k: int) -> Plot:
    """Output k: measured and simulated over time, and the residual under them."""
    unit, residual_unit = curves.scale(k)[1], curves.residual_scale(k)[1]
    floor = _floor(curves, k)

    def curve(name: str, title: str, color: str, hover_unit: str, *, frame: bool = True, **more) -> Plot:
        source = {"series": f"{name}/{k}", "frame": frame}
        if curves.has_gaps(name, k):
            more |= {
                "mode": "markers",
                "marker": {"color": color, "size": SETTINGS.point * more.get("width", 1.5) ** 0.5},
            }
        return line(title, color, meta=source, hovertemplate=f"%{{y:.5g}} {in_template(hover_unit)}", **more)

    data = [curve("measured", "measured", "--measured", unit, width=3.2)]
    for m in reversed(curves.models):
        dash = {"dash": m.dash}
        data.append(curve(m.name, m.title, m.color, unit, frame=m.framed, width=m.width, line=dash))
        if m.residual_color:
            more = {"width": 1.0, "yaxis": "y2", "showlegend": False}
            data.append(curve(residual_name(curves, m), m.title, m.residual_color, residual_unit, **more))
    data += [swatch("noise floor ±2 sd", "--floor-shade")] if floor else []
    data += [swatch(part, shade) for part, shade in SHADES.items() if curves.windows_of(part).any()]
    name = curves.names[k]
    layout = {
        "xaxis": {"title": {"text": curves.x_title}, "anchor": "y2"},
        "yaxis": {"title": {"text": titled(name, unit)}, "domain": [0.38, 1.0], "zeroline": False},
        "yaxis2": {"title": {"text": titled("residual", residual_unit)}, "domain": [0.0, 0.31]},
        "shapes": _marks(curves, floor),
    }
    return {"data": data, "layout": layout}


def residual_statistics(curves: Curves, k: int) -> Plot:
    """Output k: how the residual is distributed, and how long it remembers."""
    factor, unit = curves.residual_scale(k)
    samples = curves.samples(k)
    residual, floor = samples.residual * factor, _floor(curves, k)
    held_out = int(samples.is_test.sum())
    edges = bin_edges(residual, floor, min(held_out or len(residual), len(residual) - held_out))
    histograms = _histograms(residual, samples.is_test, edges)
    data = histograms + ([_gauss(floor, edges)] if floor else [])
    densest = max(max(h["y"]) for h in histograms)
    # a floor far under the residual is a needle: it may leave the plot, but not flatten the histogram
    top = 1.1 * min(2 * densest, max(max(curve["y"]) for curve in data))

    coefficients = autocorrelation(residual, samples.slices)
    lag_factor, lag_unit = scaled_unit("s", samples.interval * len(coefficients))
    lag = np.arange(len(coefficients)) * samples.interval * lag_factor
    fill = {"fill": "tozeroy", "fillcolor": "--grid", "showlegend": False}
    hover = {"hovertemplate": "%{y:.3f}<extra></extra>"}
    data.append(line("autocorrelation", "--residual", lag, coefficients, axes="2", **fill, **hover))
    chance = 1.96 / np.sqrt(len(residual))
    lowest = min(-0.35, float(coefficients.min()) - 0.05)
    layout = {
        "hovermode": "closest",
        "xaxis": {"title": {"text": titled("residual", unit)}, "domain": [0.0, 0.46]},
        "yaxis": {"title": {"text": "density"}, "range": [0, top], "showticklabels": False},
        "xaxis2": {"title": {"text": titled("lag", lag_unit)}, "domain": [0.56, 1.0], "anchor": "y2"},
        "yaxis2": {"title": {"text": "autocorrelation"}, "range": [lowest, 1.05], "anchor": "x2"},
        "shapes": [band(-chance, chance, along="y2", across="x2 domain", color="--floor-shade")],
    }
    return {"data": data, "layout": layout}


def residual_name(curves: Curves, model: Model) -> str:
    """What the residual of one of the curves' models is called among the page's series."""
    return "residual" if model is curves.models[0] else f"residual {model.name}"


def _series(curves: Curves) -> tuple[np.ndarray, list[str]]:
    """Every curve as it is drawn, (step, curve), and its name."""
    columns = {}
    for k in range(curves.measured.shape[1]):
        factor, residual_factor = curves.scale(k)[0], curves.residual_scale(k)[0]
        columns[f"measured/{k}"] = factor * curves.measured[:, k]
        for m in curves.models:
            columns[f"{m.name}/{k}"] = factor * curves.simulated[m.name][:, k]
            if m.residual_color:
                columns[f"{residual_name(curves, m)}/{k}"] = residual_factor * curves.residuals[m.name][:, k]
    return np.stack(list(columns.values()), axis=1), list(columns)


def _packed_set(x: np.ndarray, rows: np.ndarray, names: list[str]) -> dict[str, Any]:
    return {"x": packed(x, "f8")} | {name: packed(rows[:, k], "f4") for k, name in enumerate(names)}


def _budget(numbers: int, curves: int, fewest: int, most: int) -> int:
    return min(most, max(fewest, numbers // curves))


def _scale(curves: Curves) -> np.ndarray:
    """(output,): what each residual is judged by: the noise floor, or its own RMS where there is none."""
    rms = np.sqrt(np.nanmean(curves.residual**2, axis=0))
    return np.array([floor or own or 1.0 for floor, own in zip(curves.floors, rms, strict=True)])


def _view(curves: Curves, w: int, error: float, name: str, ends, kind: str = "") -> dict[str, Any]:
    steps = curves.slices[w]
    episode = f" of episode {curves.episode[w]}" if len(set(curves.episode)) > 1 else ""
    part = curves.parts[curves.part[w]]
    when = f"{curves.time[steps.start]:.3f} to {curves.time[steps.stop - 1]:.3f} s"
    label = f"{kind}window {curves.number[w]}{episode} · {part} · {when} · error {error:.3g} × floor"
    return {"label": label, "set": name, "first": int(ends[0]), "last": int(ends[1])}


def _telling_windows(curves: Curves, error: np.ndarray) -> dict[int, str]:
    """Window -> "worst", "median" or "best" of its part, held out first."""
    chosen: dict[int, str] = {}
    for part in (np.flatnonzero(curves.is_test), np.flatnonzero(~curves.is_test)):
        ranked = part[np.argsort(error[part])[::-1]].tolist()
        for kind, place in (("worst", 0), ("median", len(ranked) // 2), ("best", len(ranked) - 1)):
            if ranked:
                chosen.setdefault(ranked[place], kind)
    return chosen


def _histograms(residual: np.ndarray, is_test: np.ndarray, edges: np.ndarray) -> list[Plot]:
    data = []
    for name, mask, color in (("fitted", ~is_test, "--residual"), ("held out", is_test, "--test")):
        if mask.any():
            density = np.histogram(residual[mask], edges)[0] / (mask.sum() * np.diff(edges))
            steps = {"line": {"shape": "hv"}, "hovertemplate": "%{x:.3g}"}
            data.append(line(name, color, edges, np.append(density, density[-1]), **steps))
    return data


def _gauss(floor: float, edges: np.ndarray) -> Plot:
    x = np.linspace(edges[0], edges[-1], 201)
    density = np.exp(-0.5 * (x / floor) ** 2) / (floor * np.sqrt(2 * np.pi))
    return line("noise floor alone", "--floor", x, density, line={"dash": "dash"}, hoverinfo="skip")


def _marks(curves: Curves, floor: float | None) -> list[Plot]:
    """Parts that were not fitted, the beginnings of episodes, and the band of the noise floor on the residual."""
    shapes = [
        band(a, b, along="x", across="paper", color=shade)
        for part, shade in SHADES.items()
        for a, b in curves.spans(curves.windows_of(part))
    ]
    starts = curves.episode_starts()
    shapes += [mark(x) for x in starts] if len(starts) <= SETTINGS.most_episode_marks else []
    if floor:
        edges = {"color": "--floor-shade", "edge": "--floor"}
        shapes.append(band(-2 * floor, 2 * floor, along="y2", across="paper", **edges))
    return shapes


def _floor(curves: Curves, k: int) -> float | None:
    """The noise floor of output k, in the unit its residual is drawn in."""
    floor = curves.floors[k]
    return floor * curves.residual_scale(k)[0] if floor else None
