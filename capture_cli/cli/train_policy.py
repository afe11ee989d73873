"""`capture train-policy`: its help, and what it prints."""

from capture_cli.cli._results import console, print_json
from capture_cli.options.train_policy import TrainPolicyOptions


def train_policy(options: TrainPolicyOptions) -> None:
    """Train a policy that knows the parameters: for `gen-histories --policy`, where `random` needs no training.
    Needs the extra `learn`.

    Example: capture train-policy --task air-hockey --out runs/policy
    """
    from capture_cli.stages.train_policy import train_policy as stage

    document = stage(options)
    if options.json_:
        print_json(document)
    elif not options.quiet:
        from capture_cli.report.training import print_policy

        print_policy(document, console(), options.out)
