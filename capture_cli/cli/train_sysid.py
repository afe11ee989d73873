"""`capture train-sysid`: its help, and what it prints."""

from capture_cli.cli._results import console, print_json
from capture_cli.options.train_sysid import TrainSysidOptions


def train_sysid(options: TrainSysidOptions) -> None:
    """Train an in-context identifier on histories. Needs the extra `learn`.

    Example: capture train-sysid --histories histories.zarr --identifier capture --out runs/capture
    """
    from capture_cli.stages.train_sysid import train_sysid as stage

    document = stage(options)
    if options.json_:
        print_json(document)
    elif not options.quiet:
        from capture_cli.report.training import print_training

        print_training(document, console(), options.out)
