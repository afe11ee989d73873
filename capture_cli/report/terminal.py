"""An estimate or a diagnosis at the terminal: the answer, the numbers that matter, and what to do next."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from pathlib import Path, PurePath
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from capture_cli.common.frozen import frozen
from capture_cli.common.quantities import (
    MISSING,
    bound,
    deviation,
    estimated,
    interval,
    significant,
    told,
    with_unit,
)
from capture_cli.report import diagnosis_findings, findings, prediction
from capture_cli.store.diagnosis import Diagnosis, DiagnosisRecord
from capture_cli.store.estimate import Estimate, EstimateRecord

STYLES = {
    "explained": "bold green",
    "effect-found": "bold green",
    "tied": "bold yellow",
    "unexplained": "bold yellow",
    "not-identifiable": "bold yellow",
}


@frozen
class SETTINGS:
    # Narrower than this, the bounds are left to the page.
    wide: int = 96
    # More than these would push the verdict off a small screen; the page has them all.
    most_notes: int = 4
    most_outputs: int = 8
    most_predicted: int = 5
    # A diagnosis is told in five lines, and a few more where it found several effects.
    most_lines: int = 12
    most_named: int = 2
    short: int = 2
    mark: int = 9  # characters, of the words that open its lines
    column_gap: int = 3  # characters between two columns


_ASCII = str.maketrans("–−×µ·\u00a0", "--xu- ") | str.maketrans(
    {"°": "deg", "²": "^2", "±": "+/-", "→": "->"}
)


def print_estimate(estimate: Estimate, console: Console, out_path: Path) -> None:
    """Print `estimate`, written to the directory `out_path`; plain text where `console` is no terminal."""
    record = estimate.record
    screen = _Screen(console)
    log = PurePath(record.log["path"]).name
    screen.wrapped("", f"{record.task} · {log} · {record.identifier}", "dim")
    screen.blank()
    if record.parameters:
        screen.table(_parameters(record, wide=console.width >= SETTINGS.wide))
        screen.blank()
    errors = findings.output_errors(estimate)
    screen.table(_errors(errors))
    _print_predictions(estimate, screen)
    screen.blank()
    verdict = record.verdict
    screen.wrapped(findings.TITLES[verdict], record.summary, STYLES[verdict])
    for note in _few([*findings.suspicions(estimate), *findings.notes(record)], len(errors)):
        screen.wrapped("note", note, "yellow")
    screen.blank()
    screen.whole("report", str(Path(out_path) / "report.html"))
    if command := findings.next_command(record, str(out_path)):
        screen.whole("next", command)


def print_diagnosis(diagnosis: Diagnosis, console: Console, out_path: Path) -> None:
    """Print `diagnosis`, written to the directory `out_path`: the answer, the error before and after, what had been
    absorbed, what else it might have been, and where the report is.
    """
    record, words = diagnosis.record, diagnosis_findings
    screen = _Screen(console)
    verdict = record.verdict
    is_unexplained = verdict == "unexplained" and not record.effects
    formula, error = words.expression(record), words.expression_error(record)
    screen.wrapped(words.TITLES[verdict], _answer(record), STYLES[verdict])
    for mark, line in (
        ("error", _error_line(diagnosis)),
        ("left", words.left_over(record)),
        ("absorbed", _absorbed_line(record)),
        ("where", words.strongest_covariate(record) if is_unexplained else ""),
        ("formula", f"{formula} ({error})" if error else formula),
        *_rivals_line(record),
        *(("note", note) for note in (*words.suspicions(diagnosis), *words.beside(record))),
        ("next", words.next_experiment(record)),
    ):
        if line:
            cut = mark == "next" and len(record.effects) > 1  # what was found goes before
            screen.wrapped(f"{mark:<{SETTINGS.mark}}", line, "dim", most=SETTINGS.short if cut else None)
    screen.whole(f"{'report':<{SETTINGS.mark}}", f"  {Path(out_path) / 'report.html'}")
    if len(record.effects) > 1:
        _print_sizes(record, screen)
    _print_predictions(diagnosis, screen)


def _print_sizes(record: DiagnosisRecord, screen: _Screen) -> None:
    """What is known of several effects, in a table where there is room for one."""
    rows = _effects(record)
    if screen.lines + len(rows) + 2 <= SETTINGS.most_lines:
        screen.blank()
        screen.table(rows)
    else:
        sizes = "; ".join(f"{diagnosis_findings.placed(e)} {_sizes(e)}".strip() for e in record.effects)
        room = max(SETTINGS.most_lines - screen.lines, SETTINGS.short)
        screen.wrapped(f"{'  sizes':<{SETTINGS.mark}}", sizes, "dim", most=room)


def _print_predictions(result: Estimate | Diagnosis, screen: _Screen) -> None:
    """The errors in open loop on held-out data, or on fitted data where none was held out."""
    for found in prediction.predictions(result.record, result.attributes["outputs"])[:1]:
        screen.blank()
        screen.table(prediction.for_terminal(found, SETTINGS.most_predicted))
        for why in found.left_out:
            screen.wrapped("", why, "dim")


class _Screen:
    """A console that takes plain text, and spells it in ASCII where the terminal knows nothing else.

    lines: how many were printed, but for tables.
    """

    def __init__(self, console: Console):
        self.console = console
        self.ascii = console.options.ascii_only
        self.lines = 0

    def blank(self) -> None:
        self.console.print()

    def wrapped(self, mark: str, content: str, style: str, most: int | None = None) -> None:
        """A word in `style` and a text wrapped beside it, in `most` lines; without a word, the text in `style`."""
        start = f"{mark}  " if mark else ""
        width = max(20, self.console.width - len(start))
        lines = textwrap.wrap(content, width, break_on_hyphens=False, max_lines=most, placeholder=" ...")
        for k, line in enumerate(lines):
            before = self._text(start, style) if k == 0 else Text(" " * len(start))
            self._print(before + self._text(line, "" if mark else style))

    def whole(self, mark: str, content: str) -> None:
        """A path or a command, never broken: it is there to be copied."""
        self._print(self._text(f"{mark:<8}", "dim") + self._text(content))

    def table(self, rows: list[list[str]]) -> None:
        """rows: the head first; all is set right but the first column and those without a title.

        Where the screen is too narrow titles take two lines; where it still is, nothing is left out.
        """
        head, *body = rows
        if _width(rows) > self.console.width:
            head = [head[0], *("\n".join(title.rsplit(" ", 1)) for title in head[1:])]
        width = _width([head, *body])
        is_too_wide = width > self.console.width  # the terminal wraps it
        table = Table(
            box=box.SIMPLE_HEAD,
            pad_edge=False,
            padding=(0, 1),
            header_style="dim",
            show_edge=False,
            width=width if is_too_wide else None,
        )
        for k, title in enumerate(head):
            left = k == 0 or not title
            table.add_column(
                self._text(title),
                justify="left" if left else "right",
                style="bold" if k == 0 else "" if title else "yellow",
                no_wrap=bool(title) or k == 0,
                overflow="fold",
            )
        for row in body:
            table.add_row(*(self._text(cell) for cell in row))
        self.console.print(table, crop=False)

    def _print(self, line: Text) -> None:
        self.lines += 1
        self.console.print(line, soft_wrap=True)

    def _text(self, content: str, style: str = "") -> Text:
        if self.ascii:
            content = content.translate(_ASCII).encode("ascii", "replace").decode("ascii")
        return Text(content, style=style)


def _width(rows: list[list[str]]) -> int:
    """Characters that a table of `rows` takes where only columns without a title are broken between words."""
    head, *_ = rows
    columns = zip(*rows, strict=True)
    pieces = [
        [p for c in column for p in c.split("\n" if t else None)]
        for t, column in zip(head, columns, strict=True)
    ]
    return sum(max(map(len, p), default=0) for p in pieces) + SETTINGS.column_gap * (len(head) - 1)


def _parameters(record: EstimateRecord, *, wide: bool) -> list[list[str]]:
    rows = [["parameter", "estimate", "sd", "95 % interval", *(["bounds"] if wide else []), ""]]
    for name, p in record.parameters.items():
        bounds = [f"{bound(p['low'])} to {bound(p['high'])}"] if wide else []
        remarks = ["at bound"] * p["at_bound"] + [told(p)] * (not p["identifiable"])
        rows.append([name, estimated(p), deviation(p), interval(p), *bounds, ", ".join(remarks)])
    return rows if any(row[-1] for row in rows) else [row[:-1] for row in rows]


def _errors(errors: list[findings.OutputError]) -> list[list[str]]:
    """The outputs that stand farthest above their floor, in the order of the log."""
    farthest = sorted(errors, key=lambda e: -(e.ratio or 0.0))[: _shown(len(errors), SETTINGS.most_outputs)]
    rows = [["output", "fitted", "held out", "nominal", "noise floor", "over the floor"]]
    for e in (e for e in errors if e in farthest):
        rows.append([e.name, e.fit, e.test, e.nominal, e.floor, with_unit(significant(e.ratio), "×")])
    return rows


def _few(notes: list[str], outputs: int) -> list[str]:
    """As many notes as fit, and what else the report holds."""
    shown = _shown(len(notes), SETTINGS.most_notes)
    left = {
        "notes": len(notes) - shown,
        "outputs nearer to their floor": outputs - _shown(outputs, SETTINGS.most_outputs),
    }
    more = [f"{what} ({count})" for what, count in left.items() if count > 0]
    return notes[:shown] + ([f"Only in the report: {' and '.join(more)}."] if more else [])


def _shown(count: int, most: int) -> int:
    """How many of `count` are shown, of `most` in general: one more takes no more room than to mention it."""
    return count if count <= most + 1 else most


def _answer(record: DiagnosisRecord) -> str:
    """The verdict in words; of a single effect, its size and what it is."""
    sentence = diagnosis_findings.answer(record)
    if len(record.effects) != 1:
        return sentence
    effect = record.effects[0]
    size = f" ({_sizes(effect)})" if effect["parameters"] else ""
    what_it_is = effect["summary"].partition(":")[0]  # without examples
    return f"{sentence.removesuffix('.')}{size}: {what_it_is}."


def _sizes(effect: Mapping[str, Any]) -> str:
    """The values of its parameters, as far as the log says them."""
    sizes = {name: estimated(p) if p["identifiable"] else told(p) for name, p in effect["parameters"].items()}
    return ", ".join(f"{name} {size}" for name, size in sizes.items())


def _error_line(diagnosis: Diagnosis) -> str:
    record, rows = diagnosis.record, diagnosis_findings.changes(diagnosis)
    part = diagnosis_findings.best_part(record)
    on = diagnosis_findings.where(part)
    farthest = sorted(rows, key=lambda row: -(row.over_before or 0.0))[: SETTINGS.most_named]
    each = ", ".join(_change(row, part, record) for row in rows if row in farthest)
    if len(rows) == 1:
        return f"{each} {on}; noise floor {rows[0].floor}"
    before, after = (significant(record.stages[k][part]["normalized"]) for k in (0, -1))
    both = f"{before} → {after}" if record.effects else after
    return f"{both} × noise floor {on} ({each})"


def _change(row: diagnosis_findings.Change, part: str, record: DiagnosisRecord) -> str:
    after = with_unit(significant(row.after[part]), row.unit)
    return (
        f"{row.name} {significant(row.before[part])} → {after}" if record.effects else f"{row.name} {after}"
    )


def _absorbed_line(record: DiagnosisRecord) -> str:
    if not record.absorbed:
        return ""
    rows = diagnosis_findings.absorbing(record)
    if not rows:
        return "nothing: no declared parameter had been standing in for it"
    more = f", and {len(rows) - SETTINGS.most_named} more" if len(rows) > SETTINGS.most_named else ""
    return ", ".join(_shift(row) for row in rows[: SETTINGS.most_named]) + more


def _shift(row: diagnosis_findings.Moved) -> str:
    """From where to where, in as many digits as it takes to see it; three at least."""
    for digits in range(3, 9):
        before, after = significant(row.before, digits), significant(row.after, digits)
        if before != after:
            break
    return f"{row.name} {before} → {with_unit(after, row.unit)}"


def _rivals_line(record: DiagnosisRecord) -> list[tuple[str, str]]:
    """What the effects are tied with, or else the candidate that came nearest."""
    tied = [e for e in record.effects if e["tied_with"]]
    if tied:
        each = (f"{diagnosis_findings.placed(e)} with {', '.join(e['tied_with'])}" for e in tied)
        return [("tied", f"{'; '.join(each)}: this log cannot tell")]
    closest = diagnosis_findings.closest_rejected(record)
    if closest is None:
        return []
    name = diagnosis_findings.placed(closest)
    why = closest["why_rejected"].replace(f"{name}.", "")
    if not record.effects:
        name = f"{name}, of {len(record.candidates)} candidates"
    return [("runner-up", f"{name}: {why}")]


def _effects(record: DiagnosisRecord) -> list[list[str]]:
    rows = [["effect", "parameter", "value", "95 % interval"]]
    for effect in record.effects:
        if not effect["parameters"]:
            rows.append([diagnosis_findings.placed(effect), MISSING, MISSING, MISSING])
        for name, p in effect["parameters"].items():
            rows.append([diagnosis_findings.placed(effect), name, estimated(p), interval(p)])
    return rows
