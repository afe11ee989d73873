"""`python -m benchmarks [NAME...]`: measure, print a table, write runs/benchmarks/NAME.json."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks import REGISTRY
from benchmarks.base import Figure, measure
from capture_cli.errors import CaptureError


def main() -> None:
    names = REGISTRY.names()
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="Measure what the README claims.",
        epilog="benchmarks: " + "; ".join(f"{n}: {b.summary}" for n, b in REGISTRY.items()),
    )
    parser.add_argument("name", nargs="*", metavar="NAME", help="which ones; all by default")
    parser.add_argument("--logs", type=int, default=40, help="logs per machine, for coverage (default 40)")
    parser.add_argument(
        "--pairs", type=int, default=10_000, help="most histories, for growth (default 10000)"
    )
    parser.add_argument(
        "--kills", type=int, default=200, help="runs that are killed, for kills (default 200)"
    )
    parser.add_argument(
        "--minutes", type=float, default=20.0, help="for which inputs are drawn, for fuzz (default 20)"
    )
    parser.add_argument("--out", type=Path, help="where results go, rather than to runs")
    options = parser.parse_args()
    try:
        chosen = [(name, REGISTRY.get(name)) for name in options.name or names]
        for name, benchmark in chosen:
            sizes = {size: getattr(options, size) for size in ("logs", "pairs", "kills", "minutes")}
            result, path = measure(name, benchmark(**sizes, folder=options.out or benchmark.home))
            _print(f"{name}: {benchmark.summary}", result.figures, path)
    except CaptureError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)


def _print(title: str, figures: list[Figure], path: Path) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD)
    for column, justify in (("figure", "left"), ("measured", "right"), ("target", "right"), ("", "left")):
        table.add_column(column, justify=justify)
    for f in figures:
        unit = "" if f.unit == "1" else f" {f.unit}"
        met = {None: "", True: "met", False: "[yellow]not met[/yellow]"}[f.met]
        value = f"{f.value:,.0f}" if abs(f.value) >= 1e4 else f"{f.value:.4g}"
        table.add_row(f.name, value + unit, _target(f), met)
    console = Console(highlight=False)
    console.print(table)
    console.print(f"{path}\n", soft_wrap=True)


def _target(figure: Figure) -> str:
    if figure.target is None:
        return ""
    low, high = figure.target
    if low is None:
        return f"at most {high:g}"
    return f"at least {low:g}" if high is None else f"{low:g} to {high:g}"


main()
