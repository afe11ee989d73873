"""Every command, killed at random: no output is there in part, what is said is true, and the next run is equal."""

from __future__ import annotations

import shutil
import signal
import sys
import tempfile
from collections import Counter
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from benchmarks._kills.killing import DONE, UNHEARD, Ended, Outcome, Reference, kill, reference
from benchmarks._kills.runs import RUNS, make_inputs
from benchmarks.base import Benchmark, Figure, Result

NUMBERS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
LATE, LATELY = 1 / 3, 0.75  # of the kills, and of a run: outputs are put in their places then
SEED = 0


class Kills(Benchmark):
    summary = "runs killed at random: no partial output, every rerun equal, every message true"

    def run(self) -> Result:
        outcomes = kill_at_random(self.kills, list(RUNS))
        faults = [o for o in outcomes if o.faults]
        met = (None, 0.0)
        return Result(
            [
                Figure("kills", len(outcomes)),
                Figure("  of runs that had just done their work", sum(o.ended == DONE for o in outcomes)),
                Figure("  before the program had begun", sum(o.ended == UNHEARD for o in outcomes)),
                Figure(
                    "  after which something was left to go on with", sum(o.left == "kept" for o in outcomes)
                ),
                Figure(
                    "with an output in part, a rerun that differs, or a message that is not true",
                    len(faults),
                    target=met,
                ),
            ],
            {
                "commands": {name: sum(o.command == name for o in outcomes) for name in RUNS},
                "signals": {
                    n.name: dict(Counter(o.ended for o in outcomes if o.signal == n.name)) for n in NUMBERS
                },
                "left": dict(Counter(o.left for o in outcomes)),
                "faults": [asdict(o) for o in faults],
            },
        )


def kill_at_random(kills: int, names: list[str], seed: int = SEED) -> list[Outcome]:
    """Kill the runs called `names` in turn, with every signal in turn, `kills` times in all."""
    capture = [sys.executable, "-P", "-m", "capture_cli"]
    generator = np.random.default_rng(seed)
    outcomes: list[Outcome] = []
    with tempfile.TemporaryDirectory() as root:
        make_inputs(Path(root), capture, names)
        made: dict[str, Reference] = {}
        while len(outcomes) < kills:
            turn, place = divmod(len(outcomes), len(names))
            name, number = names[place], NUMBERS[(turn + place) % len(NUMBERS)]
            if name not in made:
                made[name] = reference(RUNS[name], Path(root) / "reference", capture)
                shutil.rmtree(Path(root) / "reference")
            earliest = LATELY if generator.random() < LATE else 0.0
            after = made[name].seconds * generator.uniform(earliest, 1.0)
            folder = Path(root) / "runs"
            try:
                outcomes.append(kill(RUNS[name], made[name], folder, number, after, capture))
                _tell(outcomes[-1], len(outcomes), kills)
            except Ended as ended:  # quicker than before: another time, then
                made[name] = replace(made[name], seconds=ended.seconds)
            shutil.rmtree(folder)
    return outcomes


def _tell(outcome: Outcome, count: int, kills: int) -> None:
    said = "; ".join(outcome.faults)
    line = f"{count} of {kills}: {outcome.command}, {outcome.signal} after {outcome.after:.2f} s: {outcome.ended}, "
    print(f"{line}left: {outcome.left}{f'  FAULT: {said}' if said else ''}", file=sys.stderr, flush=True)
