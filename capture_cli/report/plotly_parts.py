"""Pieces of plotly figures, in plain dicts. Colours are the names that page.css gives them.

A plot may say its "height", px; the template says that of the others.
"""

import base64
from typing import Any

import numpy as np

Plot = dict[str, Any]

# They would lie over the titles of small plots.
NO_BUTTONS = {"displayModeBar": False}


def line(name: str, color: str, x=None, y=None, *, width: float = 1.5, axes: str = "", **more) -> Plot:
    """A curve. x, y (n,), or neither where "meta" names one of the page's curves. axes: "", "2", …"""
    trace = {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "line": {"color": color, "width": width, **more.pop("line", {})},
        "xaxis": f"x{axes}",
        "yaxis": f"y{axes}",
    }
    if x is not None:
        trace |= {"x": rounded(x), "y": rounded(y)}
    return trace | more


def points(x: list, y: list, marker: Plot, **more) -> Plot:
    """A marker at each x, y (n,)."""
    return {"type": "scatter", "mode": "markers", "x": x, "y": y, "marker": marker, **more}


def swatch(name: str, color: str) -> Plot:
    """A legend entry for something that is shaded."""
    square = {"color": color, "symbol": "square", "size": 14, "line": {"width": 0}}
    return points([None], [None], square, name=name, hoverinfo="skip")


def band(low: float, high: float, *, along: str, across: str, color: str, edge: str | None = None) -> Plot:
    """A shaded stretch of the axis `along` ("x", "y2"), as wide as `across` ("paper", "x2 domain")."""
    own, other = along[0], "y" if along[0] == "x" else "x"
    return {
        "type": "rect",
        f"{own}ref": along,
        f"{own}0": low,
        f"{own}1": high,
        f"{other}ref": across,
        f"{other}0": 0,
        f"{other}1": 1,
        "fillcolor": color,
        "line": {"width": 1, "color": edge, "dash": "dot"} if edge else {"width": 0},
        "layer": "above" if edge else "below",
    }


def mark(x: float) -> Plot:
    """A thin upright line at `x`, as high as the figure."""
    return {
        "type": "line",
        "xref": "x",
        "x0": x,
        "x1": x,
        "yref": "paper",
        "y0": 0,
        "y1": 1,
        "line": {"color": "--rule", "width": 1},
        "layer": "below",
    }


def heading(text: str, number: str) -> Plot:
    """A title over the small plot on the axes `number`: "", "2", …"""
    return {
        "text": text,
        "xref": f"x{number} domain",
        "yref": f"y{number} domain",
        "x": 0,
        "y": 1,
        "xanchor": "left",
        "yanchor": "bottom",
        "showarrow": False,
        "font": {"color": "--ink"},
    }


def in_template(text: str) -> str:
    """A name or a unit within a template, in which plotly takes "%{" for the beginning of a value."""
    # a word joiner between them, which is not seen
    return text.replace("%{", "%\u2060{")


def rounded(values) -> list:
    """JSON numbers (nested as `values`) to six digits; not finite is null, a gap."""
    if np.ndim(values):
        return [rounded(v) for v in values]
    return float(f"{values:.6g}") if np.isfinite(values) else None


def packed(values: np.ndarray, dtype: str) -> dict[str, str]:
    """Numbers (n,) as little-endian bytes in base64. dtype: "f4" or "f8"; what is not finite is a gap."""
    with np.errstate(over="ignore"):
        values = np.asarray(values).astype(f"<{dtype}")
    values = np.where(np.isfinite(values), values, np.nan).astype(f"<{dtype}")
    return {"dtype": dtype, "bdata": base64.b64encode(values.tobytes()).decode("ascii")}
