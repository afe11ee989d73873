"""`python -m fuzz.worker`: one share of a run over all kinds, a line of JSON for each input.

A process of its own, without threads: it is copied for every input.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from fuzz.cases import Case
from fuzz.drawing import draw
from fuzz.forked_run import warm_up
from fuzz.kept import keep, read
from fuzz.kinds import KINDS, seeds
from fuzz.sound_inputs import make_inputs
from fuzz.trial import attempt

BATCH = 20  # cases that are drawn at once, all of one kind


def main() -> None:
    options = _options()
    with tempfile.TemporaryDirectory() as root:
        warm_up()
        inputs = make_inputs(Path(root) / "inputs")
        began, after_seeds = time.monotonic(), 0
        for kind, label, case in _cases(options, inputs):
            if not case.name and not options.replay:
                after_seeds += 1
                late = time.monotonic() - began > options.seconds
                if late or (options.most is not None and after_seeds > options.most):
                    break
            outcome = attempt(case, inputs, Path(root) / "case")
            if outcome.faults and options.keep:
                keep(outcome, kind, options.keep / label.replace("/", "-").replace(" ", "-"))
            _tell(kind, label, outcome)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m fuzz.worker", description=__doc__)
    parser.add_argument(
        "--seconds", type=float, default=0.0, help="after which no input is begun any more, but seeds"
    )
    parser.add_argument("--most", type=int, help="inputs that are drawn at most")
    parser.add_argument("--batch", type=int, default=BATCH, help="of one kind before the next comes")
    parser.add_argument("--seed", type=int, default=0, help="of what is drawn")
    parser.add_argument(
        "--share", type=int, nargs=2, default=(0, 1), metavar=("I", "OF"), help="which of how many"
    )
    parser.add_argument("--kind", choices=KINDS, help="this alone")
    parser.add_argument("--keep", type=Path, help="where inputs go that do not end as they have to")
    parser.add_argument("--replay", type=Path, help="one of those, alone")
    return parser.parse_args()


def _cases(options: argparse.Namespace, inputs: Path) -> Iterator[tuple[str, str, Case]]:
    """(kind, how it is called, case) of this share: its seeds, and then what is drawn, without end."""
    if options.replay:
        yield (
            json.loads((options.replay / "case.json").read_text())["kind"],
            options.replay.name,
            read(options.replay, inputs),
        )
        return
    share, of = options.share
    known = [
        (kind, case) for kind, some in seeds(inputs).items() for case in some if options.kind in (None, kind)
    ]
    for kind, case in known[share::of]:
        yield kind, f"{kind} seed {case.name}", case
    drawn = [
        kind for kind, module in KINDS.items() if hasattr(module, "cases") and options.kind in (None, kind)
    ]
    strategies = {kind: KINDS[kind].cases(inputs) for kind in drawn}
    batch = share
    while drawn:
        kind = drawn[batch // of % len(drawn)]
        for number, case in enumerate(draw(strategies[kind], options.seed * 10**6 + batch, options.batch)):
            yield kind, f"{kind} {options.seed}-{batch}-{number}", case
        batch += of


def _tell(kind: str, label: str, outcome) -> None:
    case, ended = outcome.case, outcome.ended
    row = {
        "kind": kind,
        "label": label,
        "seed": bool(case.name),
        "known": case.expected is not None,
        "arguments": [a[:100] for a in case.arguments],
        "code": ended.code,
        "seconds": round(ended.seconds, 3),
        "memory": ended.memory,
        "faults": outcome.faults,
    }
    print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
    sys.stdout.flush()
