"""The interactive plots of an estimate's parameters: correlation, convergence, and recording by recording."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from capture_cli.common.quantities import place, shown_unit, titled
from capture_cli.report.findings import correlation
from capture_cli.report.plotly_parts import (
    NO_BUTTONS,
    Plot,
    band,
    heading,
    in_template,
    line,
    points,
    rounded,
)
from capture_cli.store.estimate import Estimate, EstimateRecord

# Of one luminance, so that they hold on light and on dark.
PATHS = ("#2f7fb8", "#d9772b", "#3c9d6b", "#9a6fd0", "#c25573", "#8c7a3d", "#4f9fa5", "#7d8790")


def correlation_matrix(estimate: Estimate) -> Plot | None:
    """Correlation of the parameters' errors; None for fewer than two parameters."""
    matrix, names = correlation(estimate), estimate.attributes["parameters"]
    if matrix is None:
        return None
    heatmap = {
        "type": "heatmap",
        "x": names,
        "y": names,
        "z": rounded(matrix),
        "zmin": -1,
        "zmax": 1,
        "xgap": 2,
        "ygap": 2,
        "colorscale": [[0, "--minus"], [0.5, "--zero"], [1, "--plus"]],
        "colorbar": {"thickness": 10, "outlinewidth": 0, "tickvals": [-1, -0.5, 0, 0.5, 1]},
        "hovertemplate": "%{y} and %{x}: %{z:.3f}<extra></extra>",
        "textfont": {"color": "--ink"},
    }
    most_numbered = 10
    if len(names) <= most_numbered:
        heatmap["texttemplate"] = "%{z:.2f}"
    layout = {
        "hovermode": "closest",
        "margin": {"l": 20, "r": 10, "t": 12, "b": 20},
        "xaxis": {
            "type": "category",
            "showgrid": False,
            "tickangle": 0 if sum(map(len, names)) < 45 else -40,
        },
        "yaxis": {
            "type": "category",
            "showgrid": False,
            "ticks": "",
            "autorange": "reversed",
            "ticklabelstandoff": 6,
        },
    }
    return {"data": [heatmap], "layout": layout, "config": NO_BUTTONS}


def convergence(estimate: Estimate) -> Plot | None:
    """The best so far, round by round: its error, its parameters in their ranges; None before any round."""
    errors = np.asarray(estimate.arrays["round/error"])
    if not len(errors):
        return None
    names, rounds = estimate.attributes["parameters"], np.arange(len(errors))
    legend = {"orientation": "h", "x": 0, "y": -0.2, "xanchor": "left", "yanchor": "top"}
    # Past these, markers make a thick line, numbers in the matrix a smudge, and a legend takes the plot's room.
    most_markers = 60
    marks = {"mode": "lines+markers" if len(rounds) <= most_markers else "lines", "marker": {"size": 5}}
    hover = {"hovertemplate": "error %{y:.4g}<extra></extra>"}
    data = [line("error", "--ink", rounds, errors, showlegend=False, **marks, **hover)]
    most_named = 8
    layout = {
        "hovermode": "closest",
        "margin": {"l": 58, "r": 12, "t": 12, "b": 44},
        "legend": legend,
        "showlegend": len(names) <= most_named,
        "xaxis": {"title": {"text": "round", "standoff": 6}, "anchor": "y2" if names else "y"},
        "yaxis": {"title": {"text": "error / noise floor"}, "domain": [0.56 if names else 0, 1]},
    }
    # over less than a decade a logarithmic axis has next to no labels
    positive = errors[np.isfinite(errors) & (errors > 0)]
    in_decades = positive.size and positive.max() >= 10 * positive.min()
    layout["yaxis"] |= {"type": "log", "dtick": 1} if in_decades else {"rangemode": "tozero"}
    if names:
        data += [_path(estimate, k, rounds, marks) for k in range(len(names))]
        layout["yaxis2"] = {
            "title": {"text": "place in range"},
            "domain": [0, 0.46],
            "range": [-0.05, 1.05],
            "tickvals": [0, 0.5, 1],
            "ticktext": ["low", "middle", "high"],
        }
    return {"data": data, "layout": layout, "config": NO_BUTTONS}


def recordings(record: EstimateRecord) -> Plot | None:
    """Each recording's own estimate and 95 % interval beside the joint one; None for a single recording."""
    found = record.recordings or {}
    names, parameters = found.get("names") or [], found.get("parameters") or {}
    if len(names) < 2 or not parameters:
        return None
    data, annotations, shapes, axes = [], [], [], {}
    # as many beside each other as their titles allow
    longest = max(len(_recording_title(record, name)) for name in parameters)
    columns = min(len(parameters), 3 if longest <= 24 else 2)
    rows = -(-len(parameters) // columns)
    for k, (name, own) in enumerate(parameters.items()):
        joint, number = record.parameters[name], "" if k == 0 else str(k + 1)
        axes |= _panel(*divmod(k, columns), rows, columns, number)
        data.append(_recording_points(names, own, joint["unit"], number))
        annotations.append(heading(_recording_title(record, name), number))
        if joint.get("ci95"):
            shapes.append(
                band(*joint["ci95"], along=f"x{number}", across=f"y{number} domain", color="--floor-shade")
            )
    margin = {"l": 20, "r": 12, "t": 30, "b": 34 if rows == 1 else 10}
    layout = {"hovermode": "closest", "margin": margin, "annotations": annotations, "shapes": shapes, **axes}
    height = rows * (75 + 26 * len(names)) + 30
    return {"data": data, "layout": layout, "config": NO_BUTTONS, "height": height}


def _recording_title(record: EstimateRecord, name: str) -> str:
    p = record.recordings["parameters"][name].get("p_value")
    title = titled(name, record.parameters[name]["unit"])
    return title if p is None else f"{title}   p = {p:.2g}"


def _path(estimate: Estimate, k: int, rounds: np.ndarray, marks: Plot) -> Plot:
    name = estimate.attributes["parameters"][k]
    parameter = estimate.record.parameters[name]
    values = np.asarray(estimate.arrays["round/parameters"])[:, k]
    unit = in_template(shown_unit(parameter["unit"]))
    template = f"{in_template(name)} %{{customdata:.5g}} {unit}<extra></extra>"
    more = {"customdata": rounded(values), "yaxis": "y2", "hovertemplate": template}
    return line(name, PATHS[k % len(PATHS)], rounds, place(values, parameter), **marks, **more)


def _panel(row: int, column: int, rows: int, columns: int, number: str) -> Plot:
    """The axes of one small plot of a grid."""
    left, top = column / columns, 1 - row / rows
    below, above = (0.25 / rows, 0.1 / rows) if rows > 1 else (0.0, 0.0)
    return {
        f"xaxis{number}": {
            "domain": [left + (0.03 if column else 0), left + 1 / columns - 0.01],
            "anchor": f"y{number}",
            "nticks": 5,
        },
        f"yaxis{number}": {
            "domain": [top - 1 / rows + below, top - above],
            "anchor": f"x{number}",
            "autorange": "reversed",
            "type": "category",
            "showticklabels": column == 0,
            "ticklabelstandoff": 6,
        },
    }


def _recording_points(names, own: Mapping[str, Any], unit: str, number: str) -> Plot:
    half = [1.96 * (sd or 0.0) for sd in own["sd"]]
    return points(
        own["values"],
        names,
        {"color": "--accent", "size": 8},
        error_x={"array": half, "color": "--accent", "thickness": 1.5, "width": 4},
        xaxis=f"x{number}",
        yaxis=f"y{number}",
        showlegend=False,
        hovertemplate=f"%{{y}}: %{{x:.5g}} {in_template(shown_unit(unit))}<extra></extra>",
    )
