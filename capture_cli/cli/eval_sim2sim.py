"""`capture eval-sim2sim`: its help, and what it prints."""

from capture_cli.cli._results import console, print_json
from capture_cli.options.eval_sim2sim import EvalSim2SimOptions


def eval_sim2sim(options: EvalSim2SimOptions) -> None:
    """Evaluate identifiers on simulated truths: errors, success and cost by round, the paper's numbers beside.

    Example: capture eval-sim2sim --task air-hockey --identifier runs/capture --out evaluation
    """
    from capture_cli.stages.eval_sim2sim import eval_sim2sim as stage

    document = stage(options)
    if options.json_:
        print_json(document)
    elif not options.quiet:
        from capture_cli.report.evaluation_tables import print_evaluation, print_suite

        show = print_suite if options.suite else print_evaluation
        show(document, console(), options.out)
