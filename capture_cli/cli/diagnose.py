"""`capture diagnose`: its help, and what it prints."""

from capture_cli.cli._results import console, fail_on, print_json
from capture_cli.options.diagnose import DiagnoseOptions


def diagnose(options: DiagnoseOptions) -> None:
    """Find what the model lacks, add it, and report the error before and after.

    Example: capture diagnose --real-log run.zarr --estimate run.estimate --out run.diagnosis
    """
    from capture_cli.stages.diagnose import diagnose as stage

    diagnosis = stage(options)
    if options.json_:
        print_json(diagnosis.document)
    elif not options.quiet:
        from capture_cli.report.terminal import print_diagnosis

        print_diagnosis(diagnosis, console(), options.out)
    fail_on({diagnosis.record.verdict}, options.fail_on)
