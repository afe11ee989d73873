"""`capture identify`: its help, and what it prints."""

from capture_cli.cli._results import console, fail_on, print_json
from capture_cli.options.identify import IdentifyOptions


def identify(options: IdentifyOptions) -> None:
    """Identify a model's parameters from a measured log.

    Example: capture identify --real-log run.zarr --task task.toml --out run.estimate
    """
    from capture_cli.stages.identify import identify as stage

    estimate = stage(options)
    if options.json_:
        print_json(estimate.document)
    elif not options.quiet:
        from capture_cli.report.terminal import print_estimate

        print_estimate(estimate, console(), options.out)
    fail_on({estimate.record.verdict}, options.fail_on)
