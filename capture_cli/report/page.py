"""A page that stands alone: one HTML file with its style, its scripts and plotly.js inside.

The files in `templates` make it. What comes from a file is text to them: the engine escapes every value, and the
page's own policy lets the browser run the two scripts that it names by their hashes, and no other.

Colours are named, not given: a string "--ink" in a plot is the CSS variable of that name, looked up when the
plot is drawn, so that one page serves light, dark and paper.
"""

import base64
import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from html import escape
from importlib.resources import files
from pathlib import PurePath
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from capture_cli.common import quantities
from capture_cli.store.result import Record


def page(template: str, *, plots: Mapping[str, Any], curves: Mapping[str, Any] | None, **shown: Any) -> str:
    """The whole page by a template that extends page.html. shown: what it shows, texts and numbers as they are.

    plots: plotly figures ({"data", "layout", "config", "height"}) by the id of the `plot` that shows them.
    curves: {"sets": {SET: {SERIES: packed}}, "views": [{"label", "set", "first", "last"}, …]}. A trace with
    "meta": {"series": NAME} takes its points from there: those of the view that the reader has chosen.
    """
    plotly, script = _plotly(), _asset("page.js")
    return (
        _environment()
        .get_template(template)
        .render(
            shown,
            plots=plots,
            data={"plots": _verbatim(plots), "curves": curves},
            policy=_policy([plotly, script]),
            style=_asset("page.css"),
            plotly=plotly,
            script=script,
        )
    )


@cache
def _environment() -> Environment:
    """Templates, compiled once, and the functions that write values in them."""
    environment = Environment(
        loader=PackageLoader("capture_cli.report", package_path="templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    written = (
        quantities.bound,
        quantities.deviation,
        quantities.interval,
        quantities.shown_unit,
        quantities.significant,
        quantities.to_precision_of,
        quantities.with_unit,
        on_range,
        remarks_on,
        _moment,
    )
    environment.globals |= {function.__name__.strip("_"): function for function in written}
    environment.globals |= {"missing": quantities.MISSING, "file_name": lambda path: PurePath(path).name}
    return environment


def _policy(scripts: Iterable[str]) -> str:
    """What the browser may do with the page: run `scripts`, and fetch nothing.

    A page that is mailed around must not call home, nor break without a network. Styles are inline: plotly.js writes
    its own, and plots have their heights.
    """
    hashes = (base64.b64encode(hashlib.sha256(s.encode()).digest()).decode("ascii") for s in scripts)
    allowed = " ".join(f"'sha256-{h}'" for h in hashes)
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )


def _asset(name: str) -> Markup:
    """A file of `templates`, which the page holds as it is."""
    return Markup(files("capture_cli.report").joinpath("templates", name).read_text(encoding="utf-8"))


def _plotly() -> Markup:
    from plotly.offline import get_plotlyjs

    return Markup(get_plotlyjs())


def _verbatim(value: Any, key: str = "") -> Any:
    """A figure, or a piece of it, whose texts plotly shows as they are: it takes tags and entities in them as HTML.

    key: what the piece is called in the figure; the end of a hovertemplate that hides the name of the trace stays.
    """
    if isinstance(value, Mapping):
        return {name: _verbatim(own, name) for name, own in value.items()}
    if isinstance(value, list | tuple):
        return [_verbatim(own, key) for own in value]
    if not isinstance(value, str):
        return value
    end = "<extra></extra>" if key == "hovertemplate" and value.endswith("<extra></extra>") else ""
    return escape(value.removesuffix(end), quote=False) + end


def _moment(began: str) -> str:
    """An ISO time as people write it."""
    at = datetime.fromisoformat(began)
    return f"{at.day} {at:%B %Y, %H:%M} UTC"


def rollouts_tile(record: Record, provenance: Mapping[str, Any] | None) -> tuple[str, str, str]:
    """(title, number, what it counts): how much was simulated, and how long that took."""
    seconds = (provenance or {}).get("seconds")
    took = "" if seconds is None else f"in {quantities.significant(seconds)} s"
    return "rollouts simulated", quantities.counted(record.rollouts["simulated"]), took


def rollouts_fact(record: Record) -> tuple[str, str]:
    """(title, text): how much was measured and simulated."""
    rollouts = {kind: quantities.counted(count) for kind, count in record.rollouts.items()}
    return "rollouts", f"{rollouts['measured']} measured, {rollouts['simulated']} simulated"


# --- cells of a table of parameters ---


def remarks_on(p: Mapping[str, Any]) -> list[tuple[str, str]]:
    """(CSS class, text) of what is wrong with the value; none where nothing is."""
    found = [("unsure", quantities.told(p))] * (not p["identifiable"])
    return [*found, *[("warn", "at its bound")] * p["at_bound"]]


@dataclass(frozen=True)
class OnRange:
    """Where a value lies between its bounds, in percent from the left; interval: (left, width), None without one."""

    value: str
    interval: tuple[str, str] | None


def on_range(p: Mapping[str, Any]) -> OnRange:
    """The value and its interval on a bar from low to high."""

    def percent(value: float) -> float:
        return 100 * min(1.0, max(0.0, quantities.place(value, p)))

    value = f"{percent(p['value']):.2f}"
    if not p["ci95"]:
        return OnRange(value, None)
    a, b = (percent(v) for v in p["ci95"])
    return OnRange(value, (f"{a:.2f}", f"{b - a:.2f}"))
