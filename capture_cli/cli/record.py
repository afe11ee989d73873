"""`capture record`: its help, and what it prints."""

from capture_cli.cli._results import print_json
from capture_cli.common.warn import warn
from capture_cli.options.record import RecordOptions


def record(options: RecordOptions) -> None:
    """Record a log from a simulated machine, with noise and effects of your choice.

    Example: capture record --task task.toml --effect coulomb-friction@x=3 --noise 0.0005 --out run.zarr
    """
    from capture_cli.stages.record import record as stage

    recording = stage(options)
    for doubt in () if options.quiet else recording.doubts:
        warn(doubt)
    if options.json_:
        print_json(recording.truth)
    elif not options.quiet:
        steps, count = len(recording.log.time), len(recording.log.episode_ends)
        of_episodes = f"{count} episode{'s' * (count > 1)}"
        noise = "" if any(recording.truth["noise_sd"].values()) else ", without noise (--noise SD adds some)"
        print(f"{options.out}: {steps} steps in {of_episodes}{noise}; truth in {recording.truth_path}")
