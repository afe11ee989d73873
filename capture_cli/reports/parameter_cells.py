"""A parameter's cells in a table of a page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from html import escape
from typing import Any

from capture_cli.reports.quantities import (
    MISSING,
    bound,
    deviation,
    place,
    shown_unit,
    to_precision_of,
    told,
)

PARAMETER_HEAD = ["parameter", "estimate", "sd", "95 % interval", "within its range", "remarks"]


def parameter_row(name: str, p: Mapping[str, Any]) -> list[str]:
    """Cells under PARAMETER_HEAD, as HTML."""
    return [
        named(name, p["unit"]),
        f'<span class="name">{to_precision_of(p["value"], p["sd"])}</span>',
        deviation(p),
        interval(p),
        range_bar(p),
        remarks(p) or '<span class="quiet">determined</span>',
    ]


def named(name: str, unit: str) -> str:
    """A name and its unit."""
    return f'<span class="name">{escape(name)}</span> <span class="unit">{escape(shown_unit(unit))}</span>'


def interval(p: Mapping[str, Any]) -> str:
    """ "199.8 to 207.2"."""
    return " to ".join(to_precision_of(v, p["sd"]) for v in p["ci95"]) if p["ci95"] else MISSING


def remarks(p: Mapping[str, Any]) -> str:
    """What is wrong with the value; "" where nothing is."""
    found = [f'<span class="unsure">{told(p)}</span>'] * (not p["identifiable"])
    found += ['<span class="warn">at its bound</span>'] * p["at_bound"]
    return ", ".join(found)


def range_bar(p: Mapping[str, Any], shown: Callable[[float], str] = bound) -> str:
    """The value and its interval on a bar from low to high; `shown` writes those."""

    def percent(value: float) -> float:
        return 100 * min(1.0, max(0.0, place(value, p)))

    shade = ""
    if p["ci95"]:
        a, b = (percent(v) for v in p["ci95"])
        shade = f'<span class="interval" style="left:{a:.2f}%;width:{b - a:.2f}%"></span>'
    value = f'<span class="value" style="left:{percent(p["value"]):.2f}%"></span>'
    ends = f"<span>{shown(p['low'])}</span><span>{shown(p['high'])}</span>"
    return f'<div class="range">{shade}{value}</div><div class="ends">{ends}</div>'
