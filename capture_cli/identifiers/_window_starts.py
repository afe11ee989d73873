"""The starts of windows fitted alone, the parameters held: Levenberg-Marquardt in every window at once.

Without parameters the objective is a sum over windows that share nothing but k. Each has a damping of its own (Nocedal
& Wright, Numerical Optimization, 2nd ed., section 10.3), and one that has settled is not simulated again.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from capture_cli.linearization import (
    Evidence,
    Linearization,
    Trial,
    best_trials,
    columns,
    scatter,
    trial_objectives,
)

ROUNDS = 30
DAMPING_STEP = 10.0
SEARCHES = 2  # times that windows which stand out are begun elsewhere
DRAWN = 16  # places where they are, drawn from what is known of starts beforehand
NO_PARAMETERS = np.zeros(0)

# Outputs (candidate, window, step, output) and what diverged (candidate, window) of the windows at an index.
EvaluateWindows = Callable[[np.ndarray, Trial], tuple[np.ndarray, np.ndarray]]


def fit_starts(
    evidence: Evidence,
    evaluate: EvaluateWindows,
    offsets: np.ndarray,
    *,
    tolerance: float,
    rounds: int = ROUNDS,
) -> Linearization:
    """The linearization where starts near `offsets` (window, state) are the best.

    The evidence has no parameters. tolerance: of the objective over k, summed over windows.
    """
    found = _settled(evidence, evaluate, offsets, tolerance, rounds)
    drawn = np.random.default_rng(0).standard_normal((DRAWN, offsets.shape[1]))
    for _ in range(SEARCHES):
        others = evidence.other_starts(found.offsets, found.residual, drawn)
        if not len(others):
            break
        outputs, diverged = evaluate(np.arange(len(offsets)), Trial(np.zeros((len(others), 0)), others))
        k = found.scatter
        best, values = best_trials(others, trial_objectives(evidence, others, outputs, diverged, k))
        gains = np.maximum(found.objectives(k) - values, 0.0)
        if gains.sum() < tolerance * k:
            break
        begin = np.where(gains[:, None] > 0, best, found.offsets)
        found = _settled(evidence, evaluate, begin, tolerance, rounds)
    return found


def _settled(
    evidence: Evidence, evaluate: EvaluateWindows, offsets: np.ndarray, tolerance: float, rounds: int
) -> Linearization:
    """Where the descent of every window ends."""
    best, settled = None, np.zeros(len(offsets), dtype=bool)
    damping = np.zeros(len(offsets))
    tried = offsets.copy()
    for _ in range(rounds):
        active = np.flatnonzero(~settled)
        own = evidence.rows(active)
        outputs, diverged = evaluate(active, columns(own, NO_PARAMETERS, tried[active]))
        there = Linearization.from_columns(own, NO_PARAMETERS, tried[active], outputs, diverged)
        best, better = (there, ~diverged[0]) if best is None else _better(best, there, active, diverged[0])
        k = scatter(evidence, best.residual)
        damping[active] = np.where(
            better, damping[active] / DAMPING_STEP, np.maximum(DAMPING_STEP * damping[active], k)
        )
        damping[damping < 1e-3 * k] = 0.0
        tried = best.start_offsets(NO_PARAMETERS, k, damping)
        gain = best.predicted_gains(NO_PARAMETERS, tried, k)
        settled = gain < tolerance * k / len(gain)
        if gain[~settled].sum() < tolerance * k:
            break
    return best


def _better(
    best: Linearization, there: Linearization, active: np.ndarray, diverged: np.ndarray
) -> tuple[Linearization, np.ndarray]:
    """`best` with those of the `active` windows that got better `there`, and which of them did."""
    k = best.scatter
    better = (there.objectives(k) < best.objectives(k)[active]) & ~diverged
    return best.with_windows(active[better], there.windows(better)), better
