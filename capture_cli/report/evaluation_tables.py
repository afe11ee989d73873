"""An evaluation as tables, the paper's numbers beside ours: at the terminal and as Markdown, from the same rows."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from capture_cli.common.frozen import frozen
from capture_cli.common.quantities import MISSING, significant
from capture_cli.model.effects.placed import placed_name
from capture_cli.report import paper_numbers
from capture_cli.report.terminal import SETTINGS as TERMINAL
from capture_cli.store.evaluation import EvaluationRecord, SuiteRecord


@frozen
class SETTINGS:
    parameter_round: int = 7  # where the paper's text compares parameter differences
    ratio_round: int = 10


IN_PAPER = "  in the paper"


@dataclass(frozen=True)
class Rows:
    """A table: `header`, and rows of cells; note: what the cells are."""

    title: str
    note: str
    header: tuple[str, ...]
    cells: list[tuple[str, ...]]


def tables(document: Mapping[str, Any]) -> list[Rows]:
    """The tables of evaluation.json `document`."""
    record = EvaluationRecord.of(document)
    found = [_trajectories(record), _parameters(record)]
    if len(record.parameters) > 1:
        found.append(_each_parameter(record))
    if all(e["success"] is not None for e in record.identifiers.values()):
        found.append(_success(record))
    if any(e.get("paired") for e in record.identifiers.values()):
        found.append(_paired(record))
    return [*found, _cost(record)]


def print_evaluation(document: Mapping[str, Any], console: Console, out_path: Path) -> None:
    """Print the tables of evaluation.json `document`, written to the directory `out_path`."""
    console.print(_heading(EvaluationRecord.of(document)), style="dim")
    for rows in tables(document):
        blocks = list(_blocks(rows, console.width))
        for number, columns in enumerate(blocks):
            title = rows.title if number == 0 else f"{rows.title}, continued"
            caption = rows.note if number == len(blocks) - 1 else None
            table = Table(box=box.SIMPLE_HEAD, title=title, title_justify="left", caption=caption)
            table.caption_justify = "left"
            for k in columns:
                table.add_column(rows.header[k], justify="right" if k else "left", no_wrap=bool(k))
            for cells in rows.cells:
                table.add_row(*(cells[k] for k in columns))
            console.print(table)
    console.print(f"written to {out_path}: tables.md, figures, evaluation.json, evaluation.zarr", style="dim")


def _blocks(rows: Rows, width: int) -> Iterator[list[int]]:
    """Columns that have room beside each other in `width` characters, after the first one, which all begin with."""
    widths = [
        max(map(len, column)) + TERMINAL.column_gap for column in zip(rows.header, *rows.cells, strict=True)
    ]
    block, used = [0], widths[0]
    for k in range(1, len(widths)):
        if used + widths[k] >= width and len(block) > 1:
            yield block
            block, used = [0], widths[0]
        block.append(k)
        used += widths[k]
    yield block


def print_suite(document: Mapping[str, Any], console: Console, out_path: Path) -> None:
    """Print suite.json `document`, written to the directory `out_path`."""
    suite = SuiteRecord.of(document)
    for name, evaluation in suite.cells.items():
        print_evaluation(evaluation, console, Path(out_path) / name)
    if suite.without:
        console.print(f"no checkpoints for: {', '.join(suite.without)}", style="yellow")
    for checkpoint in suite.not_used:
        console.print(f"not used: {checkpoint}", style="yellow")


def markdown(document: Mapping[str, Any], title: str | None = None) -> str:
    """The tables as a page."""
    record = EvaluationRecord.of(document)
    title = title or f"Evaluation on {record.task}"
    lines = [f"# {escape(title, quote=False)}", "", f"{escape(_heading(record), quote=False)}.", ""]
    for rows in tables(document):
        lines += [f"## {rows.title}", "", f"{escape(rows.note, quote=False)}.", "", _line(rows.header)]
        lines += [f"|---|{'---:|' * (len(rows.header) - 1)}", *map(_line, rows.cells), ""]
    if record.task in paper_numbers.SAID and record.robot is None:
        lines += [f"{paper_numbers.SAID[record.task]}.", ""]
    return "\n".join(lines)


def _heading(record: EvaluationRecord) -> str:
    has = ", ".join(placed_name(row["name"], row["site"]) for row in record.effects)
    return (
        f"{record.task}: {record.pairs} pairs, {record.seeds} seed{'s' * (record.seeds > 1)}, {record.rounds} rounds; "
        f"policy {record.policy}, noise {record.noise}{f'; machines with {has}' * bool(has)}"
        f"{f'; machines in {record.world}, played by {record.robot}' * (record.robot is not None)}"
    )


def _line(cells: Sequence[str]) -> str:
    """A row in Markdown, which takes tags for what they are: names are text."""
    return f"| {' | '.join(escape(cell, quote=False).replace('|', '&#124;') for cell in cells)} |"


def _trajectories(record: EvaluationRecord) -> Rows:
    rounds, at = record.table_rounds, _at(record, SETTINGS.ratio_round)
    cells = []
    for label, e in record.identifiers.items():
        ours = [_of_several(e["trajectory_difference"][r], e["trajectory_difference_sd"][r]) for r in rounds]
        cells.append((label, *ours, *([significant(e["ratio"][at], 2)] if e["ratio"] else [])))
        paper = paper_numbers.trajectory_difference(record.task, record.noise, e, record.world)
        if paper:
            theirs = ["{:.2f} ± {:.2f}".format(*paper[r]) if r in paper else MISSING for r in rounds]
            ratios = [_paper_ratio(paper, at, record.world)] if e["ratio"] else []
            cells.append((IN_PAPER, *theirs, *ratios))
    ratio = [f"ratio at {at}"] if record.yardstick else []
    note = "Sum over the points of the distance, after so many rounds"
    if record.seeds > 1:
        note += "; mean ± sd of the seeds"
    if ratio:
        note += f". Ratio: to {record.yardstick}"
    if any(c[0] == IN_PAPER for c in cells):
        note += f". Paper: {paper_numbers.SOURCE[record.world]}"
    return Rows("Trajectory difference", note, ("identifier", *map(str, rounds), *ratio), cells)


def _paper_ratio(paper: Mapping[int, tuple[float, float]], at: int, world: str) -> str:
    yardstick = paper_numbers.trajectory_difference(
        "air-hockey", "none", {"identifier": "domain-randomization"}, world
    )
    return significant(paper[at][0] / yardstick[at][0], 2) if at in paper else MISSING


def _parameters(record: EvaluationRecord) -> Rows:
    shown = [0, 1, 2, 3, 5, _at(record, SETTINGS.parameter_round), *record.table_rounds]
    shown = sorted(r for r in set(shown) if r <= record.rounds)
    cells = [
        (label, *(significant(e["parameter_difference"]["mean"][r], 2) for r in shown))
        for label, e in record.identifiers.items()
    ]
    note = "Mean of |estimate - truth| over the parameter's range, after so many rounds"
    return Rows("Parameter difference", note, ("identifier", *map(str, shown)), cells)


def _each_parameter(record: EvaluationRecord) -> Rows:
    at, names = _at(record, SETTINGS.parameter_round), record.parameters
    cells = [
        (label, *(significant(e["parameter_difference"][name][at], 2) for name in names))
        for label, e in record.identifiers.items()
    ]
    note = f"|estimate - truth| over the parameter's range, after {at} rounds"
    return Rows("Parameter by parameter", note, ("identifier", *names), cells)


def _success(record: EvaluationRecord) -> Rows:
    shown = sorted({r for r in (0, 1, 2, 3, 4, 5, 7, *record.table_rounds) if r <= record.rounds})
    cells = []
    for label, e in record.identifiers.items():
        lowest = f"{min(e['success'][_at(record, 5) :]):.3f}"
        cells.append((label, *(f"{e['success'][r]:.3f}" for r in shown), lowest))
        if paper := paper_numbers.success(record.task, record.noise, e, record.world):
            theirs = [f"{paper[r]:.2f}" if r in paper else MISSING for r in shown]
            cells.append((IN_PAPER, *theirs, MISSING))
    note = "Share of the pairs in which the action chosen for the estimate succeeds, after so many rounds"
    if any(c[0] == IN_PAPER for c in cells):
        note += f". Paper: {paper_numbers.SUCCESS_SOURCE}"
    lowest = f"lowest from {_at(record, 5)}"
    return Rows("Success", note, ("identifier", *map(str, shown), lowest), cells)


def _paired(record: EvaluationRecord) -> Rows:
    shown = sorted({r for r in (1, 2, 3, *record.table_rounds) if r <= record.rounds})
    compared = {label: e["paired"] for label, e in record.identifiers.items() if e.get("paired")}
    ours = next(label for label in record.identifiers if label not in compared)
    cells = []
    for label, c in compared.items():
        counts = [f"{c['nearer'][r]} / {c['as_near'][r]} / {c['further'][r]}" for r in shown]
        gained = [_of_several(c["gained"][r], c["gained_se"][r]) for r in shown]
        cells += [(label, *counts), ("  nearer by", *gained)]
    note = (
        f"Pairs in which {ours} is nearer / as near (within 0.001 of the range) / further, and the mean "
        "by which its parameter difference is smaller ± its standard error"
    )
    return Rows("Pair by pair", note, (f"{ours} against", *map(str, shown)), cells)


def _cost(record: EvaluationRecord) -> Rows:
    rounds = record.table_rounds
    with_coverage = any(e["coverage"] for e in record.identifiers.values())
    cells = []
    for label, e in record.identifiers.items():
        row = [label, *(f"{e['simulated_rollouts'][r]:.0f}" for r in rounds)]
        if with_coverage:
            row.append(f"{e['coverage'][_at(record, 10) - 1]:.3f}" if e["coverage"] else MISSING)
        cells.append(tuple(row))
    header = ("identifier", *map(str, rounds), *([f"cover at {_at(record, 10)}"] if with_coverage else []))
    note = "Simulated rollouts per pair, up to there; measured rollouts are one a round"
    if with_coverage:
        note += ". Cover: share of the truths in the 95 % intervals"
    return Rows("Cost", note, header, cells)


def _of_several(mean: float, sd: float) -> str:
    """sd is 0 where there is one, a seed or a pair, and then says nothing."""
    return f"{significant(mean, 3)}{f' ± {significant(sd, 2)}' * bool(sd)}"


def _at(record: EvaluationRecord, number: int) -> int:
    """The round `number`, or the last one."""
    return min(number, record.rounds)
