"""Every command, killed at random: no output is there in part, what is said is true, and the next run is equal."""

from __future__ import annotations

import shutil
import signal
import sys
import tempfile
from collections import Counter
from dataclasses import asdict
from pathlib import Path

import numpy as np

from benchmarks._kills.killing import DONE, UNHEARD, Outcome, Reference, kill, reference
from benchmarks._kills.runs import RUNS, make_inputs
from benchmarks.base import Benchmark, Figure, Result

NUMBERS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
LATE = 1 / 3  # of the kills, when most is done: outputs are put in their places there
BEYOND = 1.1  # times the duration of a run, until when it is killed
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
                Figure("  of runs that had ended before", sum(o.ended == DONE for o in outcomes)),
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
        for count in range(kills):
            name, number = names[count % len(names)], NUMBERS[(count // len(names) + count) % len(NUMBERS)]
            if name not in made:
                made[name] = reference(RUNS[name], Path(root) / "reference", capture)
                shutil.rmtree(Path(root) / "reference")
            earliest = 0.75 if generator.random() < LATE else 0.0
            after = made[name].seconds * generator.uniform(earliest, BEYOND)
            folder = Path(root) / f"run-{count}"
            outcome = kill(RUNS[name], made[name], folder, number, after, capture)
            outcomes.append(outcome)
            _tell(outcome, count + 1, kills)
            shutil.rmtree(folder)
    return outcomes


def _tell(outcome: Outcome, count: int, kills: int) -> None:
    said = "; ".join(outcome.faults)
    line = f"{count} of {kills}: {outcome.command}, {outcome.signal} after {outcome.after:.2f} s: {outcome.ended}, "
    print(f"{line}left: {outcome.left}{f'  FAULT: {said}' if said else ''}", file=sys.stderr, flush=True)
