"""What a parameter's cells say in a table of a page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from capture_cli.reports.quantities import MISSING, place, to_precision_of, told


def interval(p: Mapping[str, Any]) -> str:
    """ "199.8 to 207.2"."""
    return " to ".join(to_precision_of(v, p["sd"]) for v in p["ci95"]) if p["ci95"] else MISSING


def remarks_on(p: Mapping[str, Any]) -> list[tuple[str, str]]:
    """(CSS class, text) of what is wrong with the value; none where nothing is."""
    found = [("unsure", told(p))] * (not p["identifiable"])
    return [*found, *[("warn", "at its bound")] * p["at_bound"]]


@dataclass(frozen=True)
class OnRange:
    """Where a value lies between its bounds, in percent from the left; interval: (left, width), None without one."""

    value: str
    interval: tuple[str, str] | None


def on_range(p: Mapping[str, Any]) -> OnRange:
    """The value and its interval on a bar from low to high."""

    def percent(value: float) -> float:
        return 100 * min(1.0, max(0.0, place(value, p)))

    value = f"{percent(p['value']):.2f}"
    if not p["ci95"]:
        return OnRange(value, None)
    a, b = (percent(v) for v in p["ci95"])
    return OnRange(value, (f"{a:.2f}", f"{b - a:.2f}"))
