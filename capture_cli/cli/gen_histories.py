"""`capture gen-histories`: its help, and what it prints."""

from capture_cli.cli._results import print_json
from capture_cli.options.gen_histories import GenHistoriesOptions


def gen_histories(options: GenHistoriesOptions) -> None:
    """Generate adaptation histories: walks from random parameters to a target, with what both would show.

    Example: capture gen-histories --task air-hockey --pairs 1000 --out histories.zarr
    """
    from capture_cli.stages.gen_histories import gen_histories as stage

    made = stage(options)
    if options.json_:
        print_json(made)
    elif not options.quiet:
        new = f"{made['shards_made']} of {made['shards']} shards are new"
        print(f"{options.out}: {made['pairs']} histories of {options.rounds} rounds; {new}")
