"""The interactive plots of a diagnosis: error by stage, what parameters had absorbed, where the residual arises."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.common.quantities import place, scaled_unit, significant, titled, with_unit
from capture_cli.report.curves import SETTINGS as CURVES
from capture_cli.report.diagnosis_findings import PARTS, Moved, StageErrors, moved, shift, stage_errors
from capture_cli.report.plotly_parts import NO_BUTTONS, Plot, heading, in_template, line, points, rounded
from capture_cli.store.diagnosis import Diagnosis, DiagnosisRecord

COLORS = {"fit": "--measured", "select": "--select", "test": "--test"}


@frozen
class SETTINGS:
    # px: of the plots of localisation, and what is around them
    above: int = 56
    under: int = 44
    cell: int = 170
    between: int = 76


LEGEND = {"orientation": "h", "x": 0, "y": 1.02, "xanchor": "left", "yanchor": "bottom"}


def stages(diagnosis: Diagnosis) -> Plot:
    """Error of each model, on each part of the log, and the noise floor."""
    found = stage_errors(diagnosis)
    data = []
    for part, errors in found.errors.items():
        text = [with_unit(significant(v), found.unit) for v in errors]
        data.append(_bar(PARTS[part], COLORS[part], found.names, errors, text, offsetgroup=part))
    if found.floor:
        bar = ("noise floor", "--floor", ["noise floor"], [found.floor], [found.floor_text])
        middle = list(found.errors)[len(found.errors) // 2]
        data.append(_bar(*bar, showlegend=False) | {"offsetgroup": middle})
    layout = {
        "barmode": "group",
        "bargap": 0.34,
        "hovermode": "closest",
        "legend": {**LEGEND, "traceorder": "normal"},
        "margin": {"l": 20, "r": 76, "t": 34, "b": 44},
        "xaxis": {"title": {"text": found.title}, **_reach(found)},
        "yaxis": {
            "type": "category",
            "categoryorder": "array",
            "categoryarray": [*found.names, "noise floor"],
            "autorange": "reversed",
            "showgrid": False,
            "ticklabelstandoff": 8,
            "tickfont": {"color": "--ink", "size": 13},
        },
    }
    height = 110 + len(found.names) * (20 + 22 * len(found.errors)) + 40 * bool(found.floor)
    return {"data": data, "layout": layout, "config": NO_BUTTONS, "height": height}


def absorbed(record: DiagnosisRecord) -> Plot | None:
    """Where in its range each declared parameter stood before and stands now; None where nothing was found."""
    rows = moved(record)
    if not rows:
        return None
    spans = {row.name: record.parameters[row.name] for row in rows}
    names = [row.name for row in rows]
    before = [place(row.before, spans[row.name]) for row in rows]
    after = [place(row.after, spans[row.name]) for row in rows]
    below, above = zip(*(whiskers(spans[name]) for name in names), strict=True)
    reach = {"symmetric": False, "array": rounded(above), "arrayminus": rounded(below)}
    ring = {"color": "--paper", "size": 11, "line": {"color": "--before", "width": 2.5}}
    dot = {"color": "--after", "size": 11}
    bars = {**reach, "color": "--after", "thickness": 1.5, "width": 4}
    then = {"text": [_told(row, row.before) for row in rows], "hovertemplate": "%{text}<extra></extra>"}
    now = {**then, "text": [f"{row.name} {shift(row)}" for row in rows], "error_x": bars}
    data = [
        points(rounded(before), names, ring, name="declared", **then),
        points(rounded(after), names, dot, name="with what was found", **now),
    ]
    layout = {
        "hovermode": "closest",
        "legend": LEGEND,
        "margin": {"l": 20, "r": 20, "t": 34, "b": 44},
        "xaxis": {
            "title": {"text": "place in its range"},
            "range": [-0.03, 1.03],
            "tickvals": [0, 0.5, 1],
            "ticktext": ["low", "middle", "high"],
        },
        "yaxis": {
            "type": "category",
            "range": [len(names) - 0.4, -0.6],
            "ticklabelstandoff": 8,
            "tickfont": {"color": "--ink", "size": 13},
        },
        "annotations": [_arrow(*ends) for ends in zip(before, after, names, strict=True)],
    }
    return {"data": data, "layout": layout, "config": NO_BUTTONS, "height": 110 + 44 * len(rows)}


def whiskers(parameter: Mapping[str, Any]) -> list[float]:
    """How far the interval reaches below and above the value, over the range; 0 where it is not known."""
    value = place(parameter["value"], parameter)
    ends = parameter["ci95"] or [parameter["value"]] * 2
    return [abs(place(end, parameter) - value) for end in ends]


def localisation(diagnosis: Diagnosis, k: int) -> Plot | None:
    """Output k: mean residual acceleration against everything it could depend on; None where nothing is known."""
    rows = drawn_curves(diagnosis, k)
    if not rows:
        return None
    data, annotations, axes = [], [], {}
    columns = localisation_columns(len(rows))
    grid = -(-len(rows) // columns)
    total = grid * SETTINGS.cell + (grid - 1) * SETTINGS.between
    factor, unit = acceleration_scale(diagnosis, k)
    has_effects = bool(diagnosis.record.effects)
    for place_, row in enumerate(rows):
        number = "" if place_ == 0 else str(place_ + 1)
        against = diagnosis.attributes["curves"][row]
        data += _curve(diagnosis, row, factor, unit, number, has_effects)
        axes |= _cell(*divmod(place_, columns), total, columns, number)
        axes[f"xaxis{number}"]["title"] = {"text": drawn_against(diagnosis, row)[1], "standoff": 4}
        annotations.append(heading(curve_title(against), number))
    axes["yaxis"]["title"] = {"text": f"[{unit}]", "standoff": 4}
    layout = {
        "hovermode": "closest",
        "legend": {**LEGEND, "y": 1 + 30 / total, "traceorder": "normal"},
        "margin": {"l": 20, "r": 12, "t": SETTINGS.above, "b": SETTINGS.under},
        "annotations": annotations,
        **axes,
    }
    height = SETTINGS.above + SETTINGS.under + total
    return {"data": data, "layout": layout, "config": NO_BUTTONS, "height": height}


def localisation_columns(count: int) -> int:
    """How many curves stand beside each other."""
    return 2 if count == 4 else min(count, 3)


def drawn_curves(diagnosis: Diagnosis, k: int) -> list[int]:
    """Rows of the arrays bin/* that hold curves of output k; those without enough data are empty."""
    name = diagnosis.attributes["outputs"][k]["name"]
    centre = np.asarray(diagnosis.arrays["bin/centre"])
    rows = [row for row, c in enumerate(diagnosis.attributes["curves"]) if c["output"] == name]
    return [row for row in rows if np.ptp(centre[row]) > 0]


def drawn_against(diagnosis: Diagnosis, row: int) -> tuple[np.ndarray, str]:
    """What a curve is drawn against, (bin,), and the title of that axis; by a clock of an epoch, since the start."""
    x, curve = np.asarray(diagnosis.arrays["bin/centre"])[row], diagnosis.attributes["curves"][row]
    if curve["against"] != "time" or np.abs(x).max() <= CURVES.longest_clock:
        return x, titled(curve["against"], curve["unit"])
    return x - np.asarray(diagnosis.arrays["step/time"]).min(), "time since the start [s]"


def acceleration_scale(diagnosis: Diagnosis, k: int) -> tuple[float, str]:
    """(factor, unit) in which the residual acceleration of output k is drawn."""
    rows = drawn_curves(diagnosis, k)
    largest = float(np.abs(np.asarray(diagnosis.arrays["bin/before"])[rows]).max())
    return scaled_unit(acceleration_unit(diagnosis.attributes["outputs"][k]["unit"]), largest)


def acceleration_unit(unit: str) -> str:
    """The unit of the second derivative of an output."""
    if unit in ("1", "-"):
        return "1/s^2"
    return unit.removesuffix("/s") + "/s^3" if unit.endswith("/s") else f"{unit}/s^2"


def curve_title(curve: Mapping[str, Any]) -> str:
    """What the residual is drawn against, and how much of it that accounts for."""
    return f"{curve['against']} accounts for {100 * curve['share']:.0f} %"


def _bar(name: str, color: str, names: list[str], values: list[float], text: list[str], **more) -> Plot:
    return {
        "type": "bar",
        "orientation": "h",
        "name": name,
        "y": names,
        "x": rounded(values),
        "text": text,
        "textposition": "outside",
        "cliponaxis": False,
        "textfont": {"color": "--ink", "size": 11},
        "marker": {"color": color},
        "hovertemplate": f"%{{y}}, {name}: %{{text}}<extra></extra>",
        **more,
    }


def _reach(found: StageErrors) -> Plot:
    """Range of the axis of errors; a floor far below leaves a logarithmic one."""
    if not found.decades:
        return {"rangemode": "tozero"}
    values = [v for errors in found.errors.values() for v in errors if v > 0]
    low = min([*values, found.floor] if found.floor and found.floor > min(values) / 30 else values)
    return {"type": "log", "dtick": 1, "range": [np.log10(low / 2), np.log10(max(values) * 1.3)]}


def _told(row: Moved, value: float) -> str:
    return f"{row.name} {with_unit(significant(value, 4), row.unit)}"


def _arrow(before: float, after: float, name: str) -> Plot:
    return {
        "xref": "x",
        "yref": "y",
        "axref": "x",
        "ayref": "y",
        "x": rounded(after),
        "y": name,
        "ax": rounded(before),
        "ay": name,
        "text": "",
        "showarrow": True,
        "arrowhead": 2,
        "arrowsize": 1.1,
        "arrowwidth": 1.6,
        "arrowcolor": "--muted",
        "standoff": 7,
        "startstandoff": 7,
    }


def residual_accelerations(diagnosis: Diagnosis, row: int, factor: float) -> list[np.ndarray]:
    """Of a curve, times the factor: the means before and after, and the standard error before, (bin,) each."""
    return [factor * np.asarray(diagnosis.arrays[f"bin/{k}"])[row] for k in ("before", "after", "error")]


def _curve(
    diagnosis: Diagnosis, row: int, factor: float, unit: str, number: str, has_effects: bool
) -> list[Plot]:
    x, _ = drawn_against(diagnosis, row)
    before, after, error = residual_accelerations(diagnosis, row, factor)
    hover = {"hovertemplate": f"%{{y:.3g}} {in_template(unit)}<extra></extra>"}
    around = {"mode": "lines", "hoverinfo": "skip", "showlegend": False, "width": 0, "axes": number}
    curves = [
        line("", "--before", x, before - 2 * error, **around),
        line("", "--before", x, before + 2 * error, fill="tonexty", fillcolor="--before-shade", **around),
        line("declared", "--before", x, before, axes=number, showlegend=number == "", **hover),
    ]
    if has_effects:
        more = {"mode": "lines+markers", "marker": {"size": 4}, "showlegend": number == "", **hover}
        curves.append(line("with what was found", "--after", x, after, axes=number, **more))
    return curves


def _cell(row: int, column: int, total: int, columns: int, number: str) -> Plot:
    """The axes of one small plot of a grid, `total` px high."""
    left, width = column / columns, 1 / columns
    top = 1 - row * (SETTINGS.cell + SETTINGS.between) / total
    matched = {} if row == column == 0 else {"matches": "y"}
    return {
        f"xaxis{number}": {
            "domain": [left + (0.04 if column else 0.0), left + width - 0.01],
            "anchor": f"y{number}",
            "nticks": 6,
        },
        f"yaxis{number}": {
            "domain": [max(top - SETTINGS.cell / total, 0.0), top],
            "anchor": f"x{number}",
            "nticks": 5,
        }
        | matched,
    }
