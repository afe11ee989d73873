"""About how long an evaluation takes, before it begins."""

import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from capture_cli.context.evaluation.evaluated_identifier import Evaluated
from capture_cli.context.evaluation.sim2sim import Sim2Sim
from capture_cli.model.effects.ranges import NO_EFFECTS


@dataclass(frozen=True)
class Expected:
    """Rollouts that are to be simulated, measured ones as well, and seconds that they take here and now."""

    rollouts: float = 0.0
    seconds: float = 0.0

    def __add__(self, other: Self) -> Self:
        return Expected(self.rollouts + other.rollouts, self.seconds + other.seconds)

    def __str__(self) -> str:
        return f"about {self.rollouts:.3g} rollouts, {_duration(self.seconds)}"


def expected(todo: Iterable[tuple[Evaluated, Sim2Sim]]) -> Expected | None:
    """Of the parts `todo`, all of one task; None for so few pairs that looking would take longer than doing.

    What identifiers simulate by themselves is seen on a few pairs and rounds, and taken to go on so.
    """
    todo = list(todo)
    smallest_planned = 50  # pairs in all, from which on it is said how long it will take
    in_world = any(draw.world for _, draw in todo)
    if not todo or (not in_world and sum(draw.pairs for _, draw in todo) < smallest_planned):
        return None
    by_itself: dict[str, float] = {}
    simulated, measured = 0.0, 0.0
    for e, draw in todo:
        if e.kind.simulates and e.label not in by_itself:
            by_itself[e.label] = _by_itself(e, draw)
        # a round is measured, and simulated with every candidate
        simulated += draw.pairs * (draw.rounds * e.kind.candidates + by_itself.get(e.label, 0.0))
        measured += draw.pairs * draw.rounds
    first = todo[0][1]
    seconds = simulated / _rollouts_per_second(replace(first, world=None))
    seconds += measured / _rollouts_per_second(first)
    return Expected(simulated + measured, seconds)


def _by_itself(e: Evaluated, draw: Sim2Sim) -> float:
    """Rollouts a pair that the identifier simulates besides its candidates."""
    # of identifiers that simulate by themselves
    probed_pairs = 2
    probed_rounds = 5
    probe = replace(draw, pairs=probed_pairs, rounds=min(draw.rounds, probed_rounds), world=None)
    spent = probe.run(e.make, known=e.effects)["simulated_rollouts"].mean(axis=0)
    total = spent[-1] + (draw.rounds - probe.rounds) * (spent[-1] - spent[-2])
    return max(0.0, total - draw.rounds * e.kind.candidates)


def _rollouts_per_second(draw: Sim2Sim) -> float:
    """Of machines without effects."""
    probed = 64 if draw.world is None else 2  # episodes, simulated to see how many a second there are
    draw = replace(draw, pairs=probed, rounds=1, effects=NO_EFFECTS)
    source, _ = draw.ends()
    uniform = np.random.default_rng(0).random((probed, len(draw.task.actions)))
    actions = draw.policy.act(source, uniform)
    began = time.monotonic()
    draw.machine()(source, actions)
    return probed / (time.monotonic() - began)


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
