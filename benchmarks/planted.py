"""Is the right effect found, and nothing where nothing is? `python -m benchmarks.planted run` asks on sealed logs.

    python -m benchmarks.planted run --out DIR                    all kinds of logs, by a seed drawn now
    python -m benchmarks.planted run --out DIR --dress half-rate  some of the same cases as another logger writes them
    python -m benchmarks.planted run --out OTHER --seed N --sample 40 --root CHECKOUT     another version on the same
    python -m benchmarks.planted summary DIR
    python -m benchmarks.planted compare DIR/plain.jsonl OTHER/plain.jsonl

The folder belongs to one version of the code and one seed (frozen.json); a run that ended goes on with the same
command. One JSON line is kept per log, in a file per dress.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path

from benchmarks import ROOT
from benchmarks._planted.frozen import capture_hash, freeze
from benchmarks._planted.rows import add, draws, read
from benchmarks._planted.summary import compare, figures, page, summary
from benchmarks._planted_logs.cases import KINDS, LEFT, NOTHING, PAIR, PLANTED, UNKNOWN, WEAK
from benchmarks._planted_logs.dresses import DRESSES, PLAIN
from benchmarks._planted_logs.machines import MACHINE
from benchmarks.base import Benchmark, Figure, Result
from capture_cli.errors import CaptureError, OptionError
from capture_cli.store.provenance import Provenance, write_json

COUNTS = {PLANTED: 300, NOTHING: 200, PAIR: 60, WEAK: 60, UNKNOWN: 30, LEFT: 12}
COUNTS_OF_A_DRESS = {PLANTED: 100, NOTHING: 100}
FOLDER = ROOT / "runs" / "planted" / "sealed"


class Planted(Benchmark):
    summary = "planted effects found, and false alarms: `--logs` of the logs of python -m benchmarks.planted"

    def run(self) -> Result:
        folder = self.folder / "planted" / capture_hash(ROOT)  # of one version
        frozen = freeze(folder, ROOT, seed=0)
        path = folder / f"{PLAIN}.jsonl"
        add(draws(COUNTS, frozen.seed, PLAIN, tuple(MACHINE), self.logs), path, ROOT, jobs=2)
        found = summary(read(path).values())
        return Result(figures(found, PLAIN), found)


def main() -> None:
    parser = _parser()
    options = parser.parse_args()
    try:
        {"run": _run, "summary": _summary, "compare": _compare}[options.command](options)
    except CaptureError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print(
            "interrupted: the lines of finished logs are kept\n  cure: run the same command again",
            file=sys.stderr,
        )
        sys.exit(130)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.planted",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    run = commands.add_parser("run", help="ask about logs, and sum up")
    run.add_argument("--out", type=Path, default=FOLDER, help=f"default {FOLDER.relative_to(ROOT)}")
    run.add_argument("--dress", choices=DRESSES, default=PLAIN, help="what the logger was like")
    run.add_argument(
        "--count", action="append", default=[], metavar="KIND=N", help=f"logs of a kind: {', '.join(KINDS)}"
    )
    run.add_argument("--machine", action="append", choices=MACHINE, help="of this alone; may be repeated")
    run.add_argument("--sample", type=int, help="so many of all of these, at random")
    run.add_argument("--seed", type=int, help="of the cases; drawn now, and kept, where it is left out")
    run.add_argument(
        "--root", type=Path, default=ROOT, help="checkout whose version is asked; default this one"
    )
    run.add_argument("--jobs", type=int, default=2, help="logs worked on at a time")
    one = commands.add_parser("summary", help="sum up what a folder holds")
    one.add_argument("out", type=Path)
    two = commands.add_parser("compare", help="two files of rows on the cases that both have")
    two.add_argument("a", type=Path)
    two.add_argument("b", type=Path)
    return parser


def _run(options: argparse.Namespace) -> None:
    root = options.root.resolve()
    counts = _counts(options.count) or (COUNTS if options.dress == PLAIN else COUNTS_OF_A_DRESS)
    frozen = freeze(options.out, root, options.seed)
    machines = tuple(options.machine or MACHINE)
    drawn = draws(counts, frozen.seed, options.dress, machines, options.sample)
    path = options.out / f"{options.dress}.jsonl"
    add(drawn, path, root, options.jobs, lambda: freeze(options.out, root, frozen.seed))
    _summary(options)


def _counts(given: list[str]) -> dict[str, int]:
    counts = {}
    for text in given:
        kind, _, number = text.partition("=")
        if kind not in KINDS or not number.isdigit():
            raise OptionError(
                f"--count {text!r} is not KIND=N", cure=f"for example {PLANTED}=40; kinds: {', '.join(KINDS)}"
            )
        counts[kind] = int(number)
    return counts


def _summary(options: argparse.Namespace) -> None:
    rows = {dress: list(read(options.out / f"{dress}.jsonl").values()) for dress in DRESSES}
    rows = {dress: own for dress, own in rows.items() if own}
    if not rows:
        raise OptionError(
            f"{options.out} holds no row of a log", cure="ask about some first: the command `run`"
        )
    found = {dress: summary(own) for dress, own in rows.items()}
    (options.out / "summary.md").write_text(page(rows), encoding="utf-8")
    made = Provenance("benchmarks planted", {}, {})
    write_json(options.out / "summary.json", {"dresses": found, "provenance": made.document()})
    for dress, own in found.items():
        for figure in figures(own, dress):
            _print(figure)


def _print(figure: Figure) -> None:
    met = {None: "", True: "met", False: "not met"}[figure.met]
    print(f"{figure.name:100} {figure.value:8.3f} {met}")


def _compare(options: argparse.Namespace) -> None:
    a, b = _rows_of(options.a), _rows_of(options.b)
    found = compare(a, b)
    print(f"{'':10}{'both':>6}{'A':>6}{'B':>6}{'none':>6}{'p':>8}   right by both, only A, only B, neither")
    for kind, own in found["kinds"].items():
        counts = "".join(f"{own[k]:6}" for k in ("both", "only_a", "only_b", "neither"))
        print(f"{kind:10}{counts}{own['p_value']:8.3g}")
    if found["other_logs"]:
        print(f"left out: {found['other_logs']} cases whose logs are not the same")
    if found["cpu_ratio"] is not None:
        print(f"median CPU ratio, B over A: {found['cpu_ratio']:.3g}")
    for one, other in found["differ"]:
        print(
            f"{one['machine']:10} {'&'.join(one['planted']) or '-':50} {one['outcome']} -> {other['outcome']}"
        )


def _rows_of(path: Path) -> Mapping:
    rows = read(path)
    if not rows:
        raise OptionError(f"{path} holds no row of a log", cure="name a file DRESS.jsonl of a run")
    return rows


if __name__ == "__main__":
    main()
