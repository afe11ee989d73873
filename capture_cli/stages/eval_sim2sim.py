"""`capture eval-sim2sim`: identifiers against each other on simulated truths (paper, Section IV-C and Appendix)."""

from typing import Any

from capture_cli.errors import OptionError
from capture_cli.options.base import takes_options
from capture_cli.options.eval_sim2sim import EvalSim2SimOptions
from capture_cli.stages.evaluation.evaluation_run import evaluate
from capture_cli.stages.evaluation.evaluation_suite import evaluate_suite


@takes_options
def eval_sim2sim(options: EvalSim2SimOptions) -> dict[str, Any]:
    """One evaluation, or those of a suite (of some cells of it alone, if any); returns evaluation.json or suite.json.

    Raises CaptureError.
    """
    if options.suite is None:
        if options.cells:
            raise OptionError("--cell without --suite", cure="give --suite paper, or leave it out")
        return evaluate(options).document
    of_suites = {
        "--world": options.world != "plant" or options.robot is not None,
        "--histories": options.histories is not None,
        "--effect": options.effects,
        "--known-noise": options.known_noise,
        f"--noise {options.noise}": options.noise != "none",
    }
    for option, given in of_suites.items():
        if given:
            raise OptionError(f"{option} with --suite", cure="leave it out: a suite has its own")
    return evaluate_suite(options)
