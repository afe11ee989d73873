"""What `capture inspect` found, at the terminal: what it is, tables, and the findings with their cures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from capture_cli.common.quantities import bound, percent, significant, with_unit
from capture_cli.report.inspected_results import result_tables
from capture_cli.store.inspection import Inspection
from capture_cli.store.zarr_store import size

STYLES = {"error": "bold red", "warning": "yellow", "note": "dim"}
SEVERITIES = ("error", "warning", "note")


_KINDS = {
    "file": "file",
    "measured-log": "measured log",
    "estimate": "estimate",
    "diagnosis": "diagnosis",
    "identifier": "learned identifier",
    "policy": "trained policy",
    "evaluation": "evaluation",
    "proposal": "proposal",
    "unfinished": "unfinished run",
    "zarr": "Zarr store",
    "directory": "result of `capture`",
}


def render(seen: Inspection, console: Console) -> None:
    """Print an inspection; plain text where `console` is no terminal."""
    console.print(Text(seen.path, style="bold"), soft_wrap=True)
    console.print(Text(_headline(seen), style="dim"))
    for head, rows in _tables(seen):
        if rows:
            console.print()
            _print_table(console, head, rows)
    console.print()
    _print_findings(console, seen.findings, checked=seen.checked)


def complaints(seen: Inspection) -> list[str]:
    """The findings that results will suffer from, in the form of error messages: what, where, and the cure."""
    serious = sorted(seen.findings, key=lambda f: SEVERITIES.index(f["severity"]))
    return [
        f"{f['severity']}: {seen.path}: {f['where']}: {f['message']}\n  cure: {f['cure']}"
        for f in serious
        if f["severity"] != "note"
    ]


def _headline(seen: Inspection) -> str:
    store, provenance = seen.store, seen.provenance
    parts = [_KINDS[seen.kind]]
    if store["format"]:
        parts.append(f"{store['format']} version {store['version']}")
    if seen.task:
        parts.append(f"task {seen.task}")
    parts += [f"{n} {noun if n != 1 else noun.removesuffix('s')}" for noun, n in seen.sizes.items()]
    parts.append(size(store["bytes"]))
    if provenance and provenance.get("command"):
        made = f"made by `capture {provenance['command']}` {provenance.get('capture')}"
        parts.append(f"{made}, {provenance.get('began')}")
    return ", ".join(parts)


def _tables(seen: Inspection) -> Iterator[tuple[list[str], list[list[str]]]]:
    if seen.kind == "measured-log":
        yield (
            ["recording", "episodes", "steps", "duration", "rate"],
            _recordings(seen.recordings, seen.channels),
        )
        yield ["channel", "range", "rms", "notes"], _channels(seen.channels)
    elif seen.kind == "zarr":
        arrays = seen.arrays
        yield (
            ["array", "shape", "type"],
            [[a["path"], " x ".join(map(str, a["shape"])), a["dtype"]] for a in arrays],
        )
    else:
        yield from result_tables(seen)


def _recordings(
    recordings: Sequence[Mapping[str, Any]], channels: Sequence[Mapping[str, Any]]
) -> list[list[str]]:
    unknown = "by channel" if any(c.get("sampling") for c in channels) else "?"
    return [
        [
            r["name"],
            str(r.get("episodes", "?")),
            str(r.get("steps", "?")),
            _number(r.get("duration"), 4, "s"),
            unknown if r.get("rate") is None else _number(r["rate"], 4, "Hz"),
        ]
        for r in recordings
    ]


def _channels(channels: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    rows = []
    for c in channels:
        low, high = (_number(c[side] and c[side]["value"]) for side in ("low", "high"))
        rows.append([c["name"], with_unit(f"{low} to {high}", c["unit"]), _number(c["rms"]), _movement(c)])
    return rows


def _movement(channel: Mapping[str, Any]) -> str:
    fine = 0.01  # of the change from sample to sample: steps below it are how many digits the file has
    if channel["kind"] == "output":
        said = ["output"]
        if channel.get("sampling"):
            said.append(
                f"{channel['sampling']['samples']} samples, {_number(channel['sampling']['rate'], 3, 'Hz')}"
            )
        step, change = channel["quantisation"]["step"], channel["quantisation"]["change"]
        if step is None or (change is not None and step < fine * change):
            return ", ".join(said)
        return ", ".join([*said, with_unit(f"steps of {bound(float(f'{step:.3g}'))}", channel["unit"])])
    moves = channel["excitation"]
    parts = ["input"]
    least_rest = 0.01  # share of the samples
    if moves["at_rest"] is not None and moves["at_rest"] >= least_rest:
        parts.append(f"at rest {percent(moves['at_rest'])}")
    if moves["frequency_95"] is not None:
        parts.append(
            f"half its power below {significant(moves['median_frequency'], 2)} Hz, "
            f"95 % below {significant(moves['frequency_95'], 2)} Hz"
        )
    return ", ".join(parts)


def _number(value: float | None, digits: int = 3, unit: str = "") -> str:
    return "?" if value is None else with_unit(significant(value, digits), unit)


def _print_table(console: Console, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1), header_style="dim", show_edge=False)
    for k, title in enumerate(head):
        last = k == len(head) - 1 and title == "notes"
        table.add_column(Text(title), justify="left" if k == 0 or last else "right", overflow="fold")
    # More rows would push the findings off the screen; --json has them all.
    most_rows = 12
    # one more is as short as its mention
    shown = rows if len(rows) == most_rows + 1 else rows[:most_rows]
    for row in shown:
        table.add_row(*(Text(cell, style="bold" if k == 0 else "") for k, cell in enumerate(row)))
    console.print(table)
    if len(rows) > len(shown):
        console.print(Text(f"and {len(rows) - len(shown)} more: --json has them all", style="dim"))


def _print_findings(console: Console, findings: Sequence[Mapping[str, str]], *, checked: bool) -> None:
    if not findings:
        nothing = Text("nothing wrong was found", style="bold green")
        console.print(nothing if checked else Text("what is in it was not checked", style="dim"))
        return
    grid = Table.grid(padding=(0, 2))
    grid.add_column(no_wrap=True)
    grid.add_column(overflow="fold")
    for f in sorted(findings, key=lambda f: SEVERITIES.index(f["severity"])):
        says = Text.assemble((f"{f['where']}: ", "bold"), f["message"])
        grid.add_row(Text(f["severity"], style=STYLES[f["severity"]]), says)
        grid.add_row("", Text(f["cure"], style="dim"))
    console.print(grid)
