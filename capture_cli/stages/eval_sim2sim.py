"""`capture eval-sim2sim`: identifiers against each other on simulated truths (paper, Section IV-C and Appendix)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from capture_cli.errors import OptionError
from capture_cli.stages.evaluation.evaluation_run import evaluate
from capture_cli.stages.evaluation.evaluation_suite import evaluate_suite


def eval_sim2sim(
    *,
    suite: str | None = None,
    cells: Sequence[str] = (),
    noise: str = "none",
    known_noise: bool = False,
    effects: Sequence[str] = (),
    **options,
) -> dict[str, Any]:
    """One evaluation, or those of a `suite` (of `cells` of it alone, if any); returns evaluation.json or suite.json.

    options: as of `evaluate` and `evaluate_suite`. Raises CaptureError.
    """
    if suite is None:
        if cells:
            raise OptionError("--cell without --suite", cure="give --suite paper, or leave it out")
        return evaluate(noise=noise, known_noise=known_noise, effects=effects, **options).document
    if noise != "none" or known_noise or effects:
        option = "--effect" if effects else "--known-noise" if known_noise else f"--noise {noise}"
        raise OptionError(f"{option} with --suite", cure="leave it out: a suite has its own")
    return evaluate_suite(suite=suite, only=cells, **options)
