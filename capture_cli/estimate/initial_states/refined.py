"""The initial states of windows fitted alone, the parameters held: Levenberg-Marquardt in every window at once.

Without parameters the objective is a sum over windows that share nothing but k. Each has a damping of its own (Nocedal
& Wright, Numerical Optimization, 2nd ed., section 10.3), and one that has settled is not simulated again.
"""

from collections.abc import Callable

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.solve.linearization import (
    Data,
    Linearization,
    Trial,
    columns,
    inflation,
    trial_objectives,
)


@frozen
class SETTINGS:
    rounds: int = 30
    patience: int = 2  # rounds
    damping_step: float = 10.0
    descents: int = 4  # of the initial states that a window may have, that are descended from
    searches: int = 3  # times that other initial states are looked for
    axis_shares: tuple[float, ...] = (-1.0, -0.3, 0.3, 1.0)  # of a state's sd, by which it alone is moved
    drawn: int = 16  # places where they are, drawn from what is known of initial states beforehand
    # Where contacts make the error jump no slope leads to the bottom: so many places are drawn, and then so
    # often so many about the best of them, each time nearer by that factor.
    drawn_if_rough: int = 128
    nearer_times: int = 5
    children: int = 48
    parents: int = 8
    nearer: float = 0.4


NO_PARAMETERS = np.zeros(0)

# Outputs (candidate, window, step, output) and what diverged (candidate, window) of the windows at an index.
EvaluateWindows = Callable[[np.ndarray, Trial], tuple[np.ndarray, np.ndarray]]


def fit_initial_states(
    data: Data,
    evaluate: EvaluateWindows,
    corrections: np.ndarray,
    *,
    tolerance: float,
    also: np.ndarray | None = None,
    thorough: bool = False,
) -> Linearization:
    """The linearization where initial states near `corrections` (window, state), or near those in `also`, are the best.

    The data has no parameters. tolerance: of the objective over k, summed over windows. thorough: whether windows
    that stand out after all get other initial states, one state after the other.
    """
    found = _settled(data, evaluate, corrections, tolerance)
    if also is not None:
        found = _or_from(found, evaluate, also[None], tolerance, found.inflation)
    generator, count = np.random.default_rng(0), SETTINGS.drawn_if_rough if data.rough else SETTINGS.drawn
    for _ in range(SETTINGS.searches):
        stuck = data.standing_out(found.residual)
        drawn = generator.standard_normal((count, corrections.shape[1]))
        others = data.other_initial_states(found.corrections, stuck, drawn)[:, stuck]
        if not others.size:
            break
        k = _scatter_of_others(found, stuck)
        before = found.windows(stuck)
        own = _of_windows(evaluate, stuck)
        if data.rough:
            others = _nearer(before.data, own, others, k, generator)
        after = _with_other_states(before, own, others, tolerance, k)
        found = found.with_windows(stuck, after)
        if (before.objectives(k) - after.objectives(k)).sum() < tolerance * k:
            break
    return _along_axes(found, evaluate, tolerance) if thorough else found


def _scatter_of_others(found: Linearization, stuck: np.ndarray) -> float:
    """k of what the windows leave that are not `stuck`."""
    rest = np.setdiff1d(np.arange(len(found.residual)), stuck)
    return inflation(found.data.rows(rest), found.residual[rest])


def _along_axes(found: Linearization, evaluate: EvaluateWindows, tolerance: float) -> Linearization:
    """`found`, with the windows that still stand out at initial states of which one is another: a height that
    nothing measures, by which a wheel is pressed to the floor or is in the air. Draws of all states at once are nowhere
    near.
    """
    stuck = found.data.standing_out(found.residual)
    if not stuck.size:
        return found
    before, own = found.windows(stuck), _of_windows(evaluate, stuck)
    k = _scatter_of_others(found, stuck)
    for state in found.data.movable:
        moved = np.repeat(before.corrections[None], len(SETTINGS.axis_shares), axis=0)
        moved[..., state] += np.outer(SETTINGS.axis_shares, before.data.initial_sd[:, state])
        before = _or_from(before, own, moved, tolerance, k)
    return found.with_windows(stuck, before)


def _of_windows(evaluate: EvaluateWindows, which: np.ndarray) -> EvaluateWindows:
    """What evaluates the windows `which`, by their place among these."""
    return lambda keep, trial: evaluate(which[keep], trial)


def _with_other_states(
    found: Linearization,
    evaluate: EvaluateWindows,
    others: np.ndarray,
    tolerance: float,
    k: float,
) -> Linearization:
    """`found`, with the windows that descend to a better start from one of `others` (trial, window, state).

    Descents begin at the most promising: the best before its descent need not be the one that leads to the best. Where
    initial states are known well, or were drawn nearer and nearer, one of them is better as it is, or none is.
    """
    window = np.arange(others.shape[1])
    values = _values(found.data, evaluate, others, k)
    best = others[np.argsort(values, axis=0, kind="stable")[: SETTINGS.descents], window]
    if found.data.hidden and not found.data.rough:
        return _or_from(found, evaluate, best, tolerance, k)
    gains = np.maximum(found.objectives(k) - values.min(axis=0), 0.0)
    better = np.flatnonzero(gains)
    if gains.sum() < tolerance * k:
        return found
    best = best[:, better] if found.data.hidden else best[:1, better]
    after = _or_from(found.windows(better), _of_windows(evaluate, better), best, tolerance, k)
    return found.with_windows(better, after)


def _or_from(
    found: Linearization, evaluate: EvaluateWindows, trials: np.ndarray, tolerance: float, k: float
) -> Linearization:
    """`found`, with the windows that descend to a better start from one of `trials` (trial, window, state).

    All descents are simulated at once: a round of few windows takes about as long as one of many.
    """
    window = np.arange(len(found.residual))
    if not len(trials):
        return found
    copies = np.tile(window, len(trials))
    there = _settled(
        found.data.rows(copies),
        _of_windows(evaluate, copies),
        np.concatenate(trials),
        tolerance * len(trials),
        k,
        np.inf if found.data.rough else found.objectives(k)[copies],
    )
    best = there.objectives(k).reshape(len(trials), -1).argmin(axis=0)
    there = there.windows(best * len(window) + window)
    better = there.objectives(k) < found.objectives(k)
    return found.with_windows(better, there.windows(better))


def _nearer(
    data: Data,
    evaluate: EvaluateWindows,
    others: np.ndarray,
    k: float,
    generator: np.random.Generator,
) -> np.ndarray:
    """The best of `others` (trial, window, state) and of what is drawn about the best of them, nearer and nearer.

    A cross-entropy search (Rubinstein, 1999) of every window about several centres, which are not pooled: valleys are
    narrow and many.
    """
    reach = data.initial_sd
    parents, values = _parents(others, _values(data, evaluate, others, k))
    for _ in range(SETTINGS.nearer_times):
        reach = SETTINGS.nearer * reach
        children = np.repeat(parents, SETTINGS.children // SETTINGS.parents, axis=0)
        children = children + reach * generator.standard_normal(children.shape)
        both = np.concatenate([values, _values(data, evaluate, children, k)])
        parents, values = _parents(np.concatenate([parents, children]), both)
    return parents


def _parents(trials: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The best of trials (trial, window, state) in each window, and their values (trial, window)."""
    best = np.argsort(values, axis=0, kind="stable")[: SETTINGS.parents]
    return np.take_along_axis(trials, best[..., None], axis=0), np.take_along_axis(values, best, axis=0)


def _values(data: Data, evaluate: EvaluateWindows, corrections: np.ndarray, k: float) -> np.ndarray:
    """Objectives (trial, window) of initial states moved by `corrections` (trial, window, state)."""
    outputs, diverged = evaluate(
        np.arange(corrections.shape[1]), Trial(np.zeros((len(corrections), 0)), corrections)
    )
    return trial_objectives(data, corrections, outputs, diverged, k)


def _settled(
    data: Data,
    evaluate: EvaluateWindows,
    corrections: np.ndarray,
    tolerance: float,
    held: float | None = None,
    to_beat: np.ndarray | float = np.inf,
) -> Linearization:
    """Where the descent of every window ends. held: k, which follows from the residual where None. to_beat (window,):
    objectives that are known to be possible; a descent that does not promise to get there after `patience` rounds ends.
    """
    every = np.arange(len(corrections))
    near = not data.rough
    outputs, diverged = evaluate(every, columns(data, NO_PARAMETERS, corrections, near=near))
    best = Linearization.from_columns(data, NO_PARAMETERS, corrections, outputs, diverged)
    active, better, damping = every, ~diverged[0], np.zeros(len(corrections))
    for number in range(SETTINGS.rounds - 1):
        k = best.inflation if held is None else held
        damping[active] = np.where(
            better,
            damping[active] / SETTINGS.damping_step,
            np.maximum(SETTINGS.damping_step * damping[active], k),
        )
        damping[damping < 1e-3 * k] = 0.0
        tried = best.corrections_after(NO_PARAMETERS, k, damping)
        gain = best.predicted_gains(NO_PARAMETERS, tried, k)
        settled = gain < tolerance * k / len(gain)
        if number >= SETTINGS.patience:
            settled |= best.objectives(k) - gain > to_beat
        if gain[~settled].sum() < tolerance * k:
            break
        active = np.flatnonzero(~settled)
        best, better = _moved(best, evaluate, active, tried[active])
    return best


def _moved(
    best: Linearization, evaluate: EvaluateWindows, active: np.ndarray, corrections: np.ndarray
) -> tuple[Linearization, np.ndarray]:
    """`best` with those of the `active` windows that are better at `corrections` (window, state), and which of them
    are.

    Sensitivities are measured of these alone: of a descent that is stuck most windows are worse, round after round.
    """
    k = best.inflation
    outputs, diverged = evaluate(active, Trial(NO_PARAMETERS[None], corrections[None]))
    there = trial_objectives(best.data.rows(active), corrections[None], outputs, diverged, k)[0]
    better = there < best.objectives(k)[active]
    which = active[better]
    if not which.size:
        return best, better
    own = best.data.rows(which)
    differences = columns(own, NO_PARAMETERS, corrections[better]).but_first
    moved, lost = evaluate(which, differences)
    outputs = np.concatenate([outputs[:, better], moved])
    diverged = np.concatenate([diverged[:, better], lost])
    at = Linearization.from_columns(own, NO_PARAMETERS, corrections[better], outputs, diverged)
    return best.with_windows(which, at), better
