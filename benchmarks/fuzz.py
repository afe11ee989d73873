"""Hostile inputs of every kind: does `capture` end with 0 or 2, in time, and with a cure? `python -m benchmarks.fuzz`.

    python -m benchmarks.fuzz --minutes 20                 every kind of input, on two cores
    python -m benchmarks.fuzz --minutes 5 --kind model     of this kind alone
    python -m benchmarks.fuzz --replay build/fuzz/LABEL    an input that was kept, once more

The kinds, and the rule that is kept to, are in tests/fuzz. Inputs that end otherwise are kept in build/fuzz.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from benchmarks.base import ROOT, Benchmark, Figure, Result, measure
from capture_cli.errors import CaptureError

sys.path.append(str(ROOT / "tests"))

from fuzz.forked_run import LONGEST, MOST_MEMORY
from fuzz.rule import KINDS as FAULTS
from fuzz.workers import rows

CORES = 2
SEED = 0
LEAST = 100  # inputs a minute: two thousand in twenty
KEPT = ROOT / "build" / "fuzz"
EVERY = 10.0  # s between lines of progress


class Fuzz(Benchmark):
    summary = "hostile inputs of every kind: exit code 0 or 2, no hang, at most 2 GB, nothing left, a cure"
    home = ROOT / "runs"
    seed = SEED
    kind: str | None = None

    def run(self) -> Result:
        began = time.monotonic()
        told = list(_shown(rows(self._options(), CORES), 60 * self.minutes))
        return _result(told, self.minutes, (time.monotonic() - began) / 60, self.seed)

    def _options(self) -> list[str]:
        chosen = [] if self.kind is None else ["--kind", self.kind]
        return ["--seconds", str(60 * self.minutes), "--seed", str(self.seed), "--keep", str(KEPT), *chosen]


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.fuzz",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--minutes", type=float, default=20.0, help="for which inputs are drawn (default 20)")
    parser.add_argument("--seed", type=int, default=SEED, help=f"of what is drawn (default {SEED})")
    parser.add_argument("--kind", help="this alone; then nothing is written to runs")
    parser.add_argument("--replay", type=Path, help="the folder of an input that was kept")
    options = parser.parse_args()
    try:
        sys.exit(_replay(options.replay) if options.replay else _run(options))
    except (CaptureError, RuntimeError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)


def _replay(folder: Path) -> int:
    """Run the input of `folder` once more; the exit code is 1 where it still does not end as it has to."""
    (row,) = rows(["--replay", str(folder)])
    print(
        f"exit code {row['code']}, {row['seconds']} s, {row['memory'] >> 20} MiB: capture {' '.join(row['arguments'])}"
    )
    for kind, words in row["faults"]:
        print(f"  {kind}: {words}")
    return 1 if row["faults"] else 0


def _run(options: argparse.Namespace) -> int:
    benchmark = Fuzz(logs=0, folder=Fuzz.home, minutes=options.minutes)
    benchmark.seed, benchmark.kind = options.seed, options.kind
    if options.kind is None:
        result, path = measure("fuzz", benchmark)
        print(path)
    else:
        result = benchmark.run()
    for figure in result.figures:
        print(f"{figure.value:>10,.4g}  {figure.name}{'' if figure.met in (True, None) else '  NOT MET'}")
    return 1 if any(figure.met is False for figure in result.figures) else 0


def _shown(told: Iterable[dict[str, Any]], seconds: float) -> Iterator[dict[str, Any]]:
    """The rows, and a line about them now and then; one at once for each that is not as it has to be."""
    began = last = time.monotonic()
    counts: Counter[str] = Counter()
    faults = 0
    for row in told:
        counts[row["kind"]] += 1
        faults += bool(row["faults"])
        for kind, words in row["faults"]:
            print(f"{row['label']}: {kind}: {words[:300]}", file=sys.stderr, flush=True)
        now = time.monotonic()
        if now - last > EVERY:
            last = now
            of = ", ".join(f"{count} {kind}" for kind, count in counts.items())
            line = f"{now - began:.0f} of {seconds:.0f} s: {counts.total()} inputs ({of})"
            line += f", {faults} not as they have to be"
            print(line, file=sys.stderr, flush=True)
        yield row


def _result(told: list[dict[str, Any]], minutes: float, taken: float, seed: int) -> Result:
    """minutes: for which inputs were drawn, of all that were taken."""
    found = Counter(kind for row in told for kind, _ in row["faults"])
    figures = [
        Figure("hostile inputs", len(told), target=(LEAST * minutes, None)),
        Figure("  whose end is known", sum(row["known"] for row in told)),
        Figure("  that end with 0", sum(row["code"] == 0 for row in told)),
        Figure("  that end with 2", sum(row["code"] == 2 for row in told)),
        *(Figure(_NAMES[kind], found[kind], target=(None, 0.0)) for kind in FAULTS),
        Figure(
            "longest run on a hostile input",
            max((row["seconds"] for row in told), default=0.0),
            "s",
            (None, LONGEST),
        ),
        Figure(
            "most memory for a hostile input",
            max((row["memory"] for row in told), default=0) / 1e9,
            "GB",
            (None, MOST_MEMORY / 1e9),
        ),
    ]
    kinds = dict.fromkeys(row["kind"] for row in told)
    details = {
        "seed": seed,
        "cores": CORES,
        "minutes": round(taken, 2),
        "kinds": {kind: _of_kind([row for row in told if row["kind"] == kind]) for kind in kinds},
        "faults": [
            {k: row[k] for k in ("label", "arguments", "code", "faults")} for row in told if row["faults"]
        ],
    }
    return Result(figures, details)


_NAMES = {
    "exit code": "hostile inputs with other exit codes than 0 and 2",
    "hang": "hangs",
    "memory": "with more memory",
    "left behind": "that leave something behind",
    "message": "with a message that is too long, or without a cure",
    "traceback": "with a traceback, or a warning of Python's",
    "wrong end": "wrong ends: successes and refusals that are known to be wrong, outputs that are not whole",
}


def _of_kind(told: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "inputs": len(told),
        "seeds": sum(row["seed"] for row in told),
        "known": sum(row["known"] for row in told),
        "codes": dict(sorted(Counter(str(row["code"]) for row in told).items())),
        "faults": sum(bool(row["faults"]) for row in told),
        "longest_s": max((row["seconds"] for row in told), default=0.0),
        "most_bytes": max((row["memory"] for row in told), default=0),
    }


if __name__ == "__main__":
    main()
