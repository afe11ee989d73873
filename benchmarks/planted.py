"""Is the right effect found? Is nothing found where nothing is? `python -m benchmarks.planted` does all of it.

Logs are recorded from six machines with one effect planted, of every kind, at every place and in three sizes; with two
at once; with nothing missing; and with effects that the catalogue does not have. One JSON line is kept per log, so
that the work can be stopped and taken up again; a line counts as long as the code that made it is unchanged.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

import numpy as np

from benchmarks import ROOT
from benchmarks._planted import pages, results
from benchmarks._planted.cases import Case, cases
from benchmarks._planted.summary import figures, summary
from benchmarks.base import Benchmark, Figure, Result
from capture_cli.errors import CaptureError, OptionError
from capture_cli.stores.provenance import Provenance, write_json

SEEDS, NOTHING_MISSING = 5, 200
EXAMPLE = "planted/slider/coulomb-friction@x/3/0"
FOLDER = ROOT / "runs" / "planted"


class Planted(Benchmark):
    summary = "planted effects found, and false alarms: `--logs` of the logs of python -m benchmarks.planted"

    def run(self) -> Result:
        folder = self.folder / "planted"
        everything = list(cases(SEEDS, NOTHING_MISSING))
        drawn = np.random.default_rng(0).permutation(len(everything))[: self.logs]
        results.add([everything[i] for i in drawn], folder, jobs=2)
        found = summary(results.newest(folder))
        return Result(figures(found), found)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.planted", description=__doc__.splitlines()[0])
    parser.add_argument(
        "--only", default="", metavar="REGEX", help="of KIND/MACHINE/EFFECT@SITE[&EFFECT@SITE]/ERROR/SEED"
    )
    parser.add_argument("--seeds", type=int, default=SEEDS, help="of each effect, place and size")
    parser.add_argument("--logs", type=int, default=NOTHING_MISSING, help="with nothing missing")
    parser.add_argument("--sample", type=int, help="so many of all of these, drawn at random")
    parser.add_argument("--jobs", type=int, default=2, help="logs worked on at a time")
    parser.add_argument("--out", type=Path, default=FOLDER, help="where lines and summary go")
    parser.add_argument(
        "--versions", type=int, default=1, help="of the code, whose newest line of each log is summed up"
    )
    parser.add_argument("--summary", action="store_true", help="only sum up the lines that there are")
    try:
        _run(parser.parse_args())
    except CaptureError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print(
            "interrupted: the lines of finished logs are kept\n  cure: run the same command again",
            file=sys.stderr,
        )
        sys.exit(2)


def _run(options: argparse.Namespace) -> None:
    provenance = Provenance("benchmarks planted", {k: v for k, v in vars(options).items() if k != "out"}, {})
    if not options.summary:
        results.add(_chosen(options), options.out, options.jobs)
    for figure in sum_up(options.out, options.versions, provenance):
        met = {None: "", True: "met", False: "not met"}[figure.met]
        print(f"{figure.name:64} {figure.value:8.3f} {met}")


def _chosen(options: argparse.Namespace) -> list[Case]:
    everything = list(cases(options.seeds, options.logs))
    form = f"it is searched for in KIND/MACHINE/EFFECT@SITE/ERROR/SEED, for example {EXAMPLE}"
    try:
        pattern = re.compile(options.only)
    except re.error as error:
        raise OptionError(f"--only {options.only!r} is no regular expression: {error}", cure=form) from error
    chosen = [c for c in everything if pattern.search(c.label)]
    if not chosen:
        raise OptionError(f"--only {options.only!r} matches none of {len(everything)} logs", cure=form)
    if options.sample is None:
        return chosen
    return [chosen[i] for i in np.random.default_rng(0).permutation(len(chosen))[: options.sample]]


def sum_up(folder: Path, versions: int, provenance: Provenance) -> list[Figure]:
    """Write summary.json, the confusion table and the figures, of each log as the last of so many `versions` of the
    code that saw it; their numbers.
    """
    code = results.newest_code(folder)
    rows = results.newest(folder, versions)
    if not rows:
        raise OptionError(
            f"{folder} holds no line of a finished log", cure="leave out --summary, to make some"
        )
    found = summary(rows)
    pages.write(rows, found, folder)
    write_json(
        folder / "summary.json",
        {**found, "code": code, "versions": versions, "provenance": provenance.document()},
    )
    return figures(found)


if __name__ == "__main__":
    main()
