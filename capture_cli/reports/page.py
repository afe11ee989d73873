"""A page that stands alone: one HTML file with its style, its script and plotly.js inside.

Colours are named, not given: a string "--ink" in a plot is the CSS variable of that name, looked up when the
plot is drawn, so that one page serves light, dark and paper.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np

# Nothing may be fetched: a page that is mailed around must not call home, nor break without a network.
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data: blob:; form-action 'none'"
)


def page(*, title: str, body: str, plots: Mapping[str, Any], curves: Mapping[str, Any] | None = None) -> str:
    """The whole page. plots: plotly figures ({"data", "layout"}) by the id of the `plot` that shows them.

    curves: {"sets": {SET: {SERIES: packed}}, "views": [{"label", "set", "first", "last"}, …]}. A trace with
    "meta": {"series": NAME} takes its points from there: those of the view that `view_selector` has chosen.
    """
    data = json.dumps({"plots": _verbatim(plots), "curves": curves}, allow_nan=False, separators=(",", ":"))
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en">',
            "<head>",
            '<meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<meta name="color-scheme" content="light dark">',
            f"<title>{escape(title)}</title>",
            f"<style>\n{_asset('page.css')}</style>",
            "</head>",
            "<body>",
            f"<main>\n{body}\n</main>",
            f"<script>{_plotly()}</script>",
            f'<script type="application/json" id="data">{_inside_script(data)}</script>',
            f"<script>\n{_asset('page.js')}</script>",
            "</body>",
            "</html>",
            "",
        ]
    )


def section(title: str, *parts: str, lead: str = "") -> str:
    """A section with a heading and, under it, a sentence on how to read it."""
    under = f'<p class="lead">{escape(lead)}</p>' if lead else ""
    return (
        f"<section>\n<h2>{escape(title)}</h2>\n{under}\n" + "\n".join(p for p in parts if p) + "\n</section>"
    )


def verdict(tone: str, badge: str, sentence: str, *, notes: Sequence[str], command: str | None = None) -> str:
    """The box at the top: a badge, the verdict in plain words, what to know beside it, and what to run next.

    tone: the CSS class that colours it; it is a verdict of estimate.json or diagnosis.json.
    """
    listed = "".join(f"<li>{escape(n)}</li>" for n in notes)
    parts = [
        f'<span class="badge">{escape(badge)}</span>',
        f'<p class="sentence">{escape(sentence)}</p>',
        f"<ul>{listed}</ul>" if listed else "",
        f'<div class="next"><span>next</span><code>{escape(command)}</code></div>' if command else "",
    ]
    return f'<div class="verdict {tone}">{"".join(parts)}</div>'


def tiles(shown: Sequence[tuple[str, str, str]]) -> str:
    """A row of single numbers: (title, number, what it counts)."""
    cells = "".join(
        f"<div><dt>{escape(title)}</dt><dd>{escape(number)} <small>{escape(detail)}</small></dd></div>"
        for title, number, detail in shown
    )
    return f'<dl class="tiles">{cells}</dl>'


def plot(name: str, *, height: int, label: str, caption: str = "") -> str:
    """The place of the plot `name`, `height` px high; `label` tells those who cannot see it what it shows."""
    under = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    attributes = f'id="{escape(name)}" role="img" aria-label="{escape(label)}" style="height:{height}px"'
    return f'<figure><div class="plot" {attributes}></div>{under}</figure>'


def side_by_side(*parts: str) -> str:
    """Parts beside each other where the page is wide enough."""
    return f'<div class="side-by-side">{"".join(parts)}</div>'


def folded(title: str, content: str) -> str:
    """Content behind a title; it opens on a click, and on paper."""
    return f"<details><summary>{escape(title)}</summary>\n{content}\n</details>"


def output(name: str, content: str, *, is_open: bool) -> str:
    """What belongs to one output, under its name; folded where it is not open."""
    return f"<h3>{escape(name)}</h3>{content}" if is_open else folded(name, content)


def measured_and_simulated(outputs: Sequence[str], *, views: int) -> str:
    """The section of the curves over time, a part per output; views: how many the reader chooses among."""
    lead = "Drag to zoom, double-click to go back, click a name in the legend to hide it."
    if views > 1:
        lead = f"The simulation starts afresh at every window. {lead}"
    selector = view_selector("show") if views > 1 else ""
    return section("Measured and simulated", selector, *outputs, lead=lead)


def view_selector(label: str) -> str:
    """The control that chooses which of the curves' views all plots show."""
    return (
        f'<div class="views"><label for="view">{escape(label)}</label>'
        '<button type="button" id="view-before" aria-label="the one before">‹</button>'
        '<select id="view"></select>'
        '<button type="button" id="view-after" aria-label="the next one">›</button></div>'
    )


def table(head: Sequence[str], rows: Sequence[Sequence[str]], *, numeric: Sequence[int] = ()) -> str:
    """A table; cells are HTML already. numeric: the columns that are set right."""

    def cells(tag: str, row: Sequence[str]) -> str:
        return "".join(f"<{tag}{' class=num' if k in numeric else ''}>{c}</{tag}>" for k, c in enumerate(row))

    body = "\n".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return (
        f'<div class="scroll"><table>\n<thead><tr>{cells("th", head)}</tr></thead>\n'
        f"<tbody>\n{body}\n</tbody>\n</table></div>"
    )


def browser(
    head: Sequence[str],
    rows: Sequence[Sequence[tuple[str, float | str]]],
    *,
    numeric: Sequence[int],
    label: str,
) -> str:
    """A long table that a click on its head sorts and that typing filters. rows of (cell as HTML, what to sort by).

    label: what is listed, "candidates".
    """

    def row(cells: Sequence[tuple[str, float | str]]) -> str:
        return "".join(
            f'<td{" class=num" if k in numeric else ""} data-key="{escape(str(key))}">{cell}</td>'
            for k, (cell, key) in enumerate(cells)
        )

    titles = "".join(
        f'<th{" class=num" if k in numeric else ""}><button type="button">{escape(title)}</button></th>'
        for k, title in enumerate(head)
    )
    body = "\n".join(f"<tr>{row(cells)}</tr>" for cells in rows)
    return (
        f'<div class="browser"><div class="filter"><input type="search" placeholder="filter {escape(label)}" '
        f'aria-label="filter {escape(label)}"><span class="quiet">{len(rows)} {escape(label)}</span></div>'
        f'<div class="scroll tall"><table>\n<thead><tr>{titles}</tr></thead>\n'
        f"<tbody>\n{body}\n</tbody>\n</table></div></div>"
    )


def packed(values: np.ndarray, dtype: str) -> dict[str, str]:
    """Numbers (n,) as little-endian bytes in base64. dtype: "f4" or "f8"; what is not finite is a gap."""
    with np.errstate(over="ignore"):
        values = np.asarray(values).astype(f"<{dtype}")
    values = np.where(np.isfinite(values), values, np.nan).astype(f"<{dtype}")
    return {"dtype": dtype, "bdata": base64.b64encode(values.tobytes()).decode("ascii")}


def _asset(name: str) -> str:
    return files("capture_cli.reports").joinpath(name).read_text(encoding="utf-8")


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


def _plotly() -> str:
    from plotly.offline import get_plotlyjs

    return get_plotlyjs()


def _inside_script(text: str) -> str:
    return text.replace("<", "\\u003c")  # "</script>" in a name must not end the block
