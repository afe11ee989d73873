"""The confusion table as Markdown, and the two figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._planted.cases import PLANTED
from benchmarks._planted.outcomes import EQUIVALENTS, RIGHT
from benchmarks._planted.summary import Row, confusion, diagnosed, found_for


def write(rows: Sequence[Row], found: dict[str, Any], folder: Path) -> None:
    """confusion.md, confusion.png and power.png into `folder`; found: `summary`."""
    planted = diagnosed(rows, PLANTED)
    (folder / "confusion.md").write_text(_table(planted, found), encoding="utf-8")
    if planted:
        _heatmap(planted, folder / "confusion.png")
    if any(found["power"].values()):
        _power(found["power"], folder / "power.png")


def _table(rows: Sequence[Row], found: dict[str, Any]) -> str:
    lines = ["# Planted by found", "", "`python -m benchmarks.planted` makes this page.", ""]
    lines += ["| planted | logs | right | accepted first, where it was not right |", "|---|---:|---:|---|"]
    for effect in sorted({r["effect"] for r in rows}):
        own = [r for r in rows if r["effect"] == effect]
        wrong = Counter(found_for(r) for r in own if r["outcome"] not in RIGHT)
        others = ", ".join(f"{name} {count}" for name, count in wrong.most_common())
        lines.append(f"| `{effect}` | {len(own)} | {len(own) - wrong.total()} | {others} |")
    if found["nothing_to_find"]:
        lines += [
            "",
            "Nothing to find, because the declared parameters take it up or it moves no output:",
            "",
        ]
        lines += [f"- {text}" for text in found["nothing_to_find"]]
    lines += ["", "Counted as right, because no log can tell them apart:", ""]
    lines += [f"- {e.machine}: {_names(e.planted)} found as {_names(e.found)}: {e.why}" for e in EQUIVALENTS]
    return "\n".join(lines) + "\n"


def _names(effects: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in sorted(effects))


def _heatmap(rows: Sequence[Row], path: Path) -> None:
    from matplotlib.figure import Figure

    planted, found, counts = confusion(rows)
    figure = Figure(figsize=(2.5 + 0.22 * len(found), 2 + 0.22 * len(planted)), layout="constrained")
    axes = figure.subplots()
    share = counts / counts.sum(axis=1, keepdims=True)
    axes.imshow(np.where(counts, share, np.nan), cmap="Blues", vmin=-0.2, vmax=1)
    for i, j in zip(*np.nonzero(counts), strict=True):
        color = "white" if share[i, j] > 0.5 else "black"
        axes.text(j, i, str(counts[i, j]), ha="center", va="center", fontsize=6, color=color)
    axes.set_xticks(range(len(found)), found, rotation=90, fontsize=7)
    axes.set_yticks(range(len(planted)), planted, fontsize=7)
    axes.set_xlabel("accepted first")
    axes.set_ylabel("planted")
    axes.set_title(f"{len(rows)} logs; shade: share of the row", fontsize=9)
    figure.savefig(path, dpi=150)


def _power(power: dict[str, Any], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.5, 3), layout="constrained")
    axes = figure.subplots()
    known = {float(m): s for m, s in power.items() if s}
    shares = np.array([s["share"] for s in known.values()])
    spread = np.array([[s["share"] - s["low"], s["high"] - s["share"]] for s in known.values()]).T
    axes.errorbar(list(known), shares, yerr=np.maximum(spread, 0), marker="o", capsize=3)
    axes.axhline(0.95, linestyle=":", color="0.5")
    axes.set_xscale("log")
    axes.set_xticks(list(known), [f"{m:g}" for m in known])
    axes.minorticks_off()
    axes.set_ylim(0, 1.02)
    axes.set_xlabel("error of the declared model, over the noise")
    axes.set_ylabel("right effect found")
    figure.savefig(path, dpi=150)
