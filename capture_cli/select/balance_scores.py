"""Scores of effects from the force balance: all at once, without a simulation, wherever the log gives a balance."""

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from capture_cli.errors import LogError
from capture_cli.estimate.balance.screening import Screening
from capture_cli.estimate.fit import Fit
from capture_cli.estimate.log_balance import smoothed_log
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.select.candidates import Candidate
from capture_cli.select.reason import Reason, Rejection
from capture_cli.select.score import Score


def screening_of(
    prepared: PreparedLog,
    fitted: np.ndarray,
    candidates: Sequence[Candidate],
    threads: int | None,
    on_step: Callable[[str, int, int], None],
) -> Screening | None:
    """A screening of the candidates on the windows `fitted` (window,); None where the log gives no balance: a joint
    that no sensor shows moves, loops are closed, actuators have states, or it is too short between impacts.
    """
    smoothed = smoothed_log(prepared, fitted)
    if smoothed is None:
        return None
    placed, nominal = [c.placed for c in candidates], prepared.task.space.nominal
    try:
        return Screening.of(smoothed, placed, nominal, threads, on_step)
    except LogError:  # too short
        return None


def score_in_balance(
    screening: Screening, current: Fit, candidates: Sequence[Candidate], polished: int | None = None
) -> None:
    """Fill in the candidates' scores and where a refit with each begins, or why it is out. polished: as of
    `Screening.additions`.
    """
    shapes_tried = Counter(a.placed.name for a in screening.atoms)
    found = {a.placed.name: a for a in screening.additions(current.effects, current.values, polished)}
    for candidate in candidates:
        candidate.score = None
        candidate.rejection = candidate.start_elsewhere = None
        candidate.shapes_tried = max(shapes_tried[candidate.name], 1)
        addition = found.get(candidate.name)
        if addition is None:
            candidate.rejection = Rejection(Reason.NO_COLUMN)
            continue
        own = len(candidate.placed.effect.parameters)
        start = addition.model.start
        moved = (start[: len(current.point)] - current.point) / current.space.span
        amplitudes = start[len(start) - own :]
        candidate.score = Score(2 * addition.gain, amplitudes, moved, 1.0, addition.response)
        candidate.start = amplitudes
        if addition.gain <= 0:
            facts = {"gain": addition.gain, "standard_error": addition.error}
            candidate.rejection = Rejection(Reason.PREDICTS_NO_BETTER, facts)
