"""Where `capture gen-histories` writes, and how it resumes a run that ended early."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.context.checkpoints.checkpoint_hash import with_new_hashes
from capture_cli.context.checkpoints.training_state import check_made
from capture_cli.errors import Interrupted, OutputError
from capture_cli.store.histories import HistoriesWriter, is_url, shard_rows
from capture_cli.store.output import GO_ON, resumable_directory


@contextmanager
def place(out: str, *, force: bool, resume: bool) -> Iterator[str]:
    """Where to write: a folder beside `out` that becomes `out`, or the URL itself.

    Raises OutputError where something is, and is neither to be replaced nor gone on with; Interrupted.
    """
    if not is_url(out):
        with resumable_directory(Path(out), kept=_kept, force=force, resume=resume) as folder:
            yield str(folder)
        return
    found = HistoriesWriter(out).attributes()
    if found is not None and not (force or resume):
        state = "holds histories" if found["complete"] else "holds an unfinished run"
        raise OutputError(
            f"{out} {state}", cure="choose another --out, go on with --resume, or add --force to replace it"
        )
    if found is not None and force:
        HistoriesWriter(out).clear()
    try:
        yield out
    except KeyboardInterrupt as error:
        kept = _kept(out)
        cure = GO_ON if kept else "begin anew with the same command and --force"
        raise Interrupted(f"interrupted: {kept or 'no histories are kept'}", cure=cure) from error


def shards_to_make(
    writer: HistoriesWriter, attributes: dict[str, Any], checkpoints: Sequence[str]
) -> list[int]:
    """Numbers of the shards that are still to be made; the store is created where there is none.

    checkpoints: folders whose hashes are among the attributes.

    Raises OptionError where another run was begun.
    """
    found = writer.attributes()
    if found is None:
        writer.create(attributes)
    else:
        _check_same(with_new_hashes(found, checkpoints), attributes, writer)
        writer.remove_halves()
    marked = writer.is_written()
    return [s for s in range(len(marked)) if not (marked[s] and writer.is_sound(s))]


def is_complete(writer: HistoriesWriter, attributes: dict[str, Any], checkpoints: Sequence[str]) -> bool:
    """Whether this very run has been completed. Raises OptionError where another was."""
    found = writer.attributes()
    if found is None or not found["complete"]:
        return False
    _check_same(with_new_hashes(found, checkpoints), attributes, writer)
    return True


def _check_same(found: Mapping[str, Any], wanted: Mapping[str, Any], writer: HistoriesWriter) -> None:
    check_made(found, wanted, f"the run at {writer.location}")


def _kept(location: str | Path) -> str:
    """What can be gone on with of an unfinished store, in words; "" for nothing."""
    writer = HistoriesWriter(str(location))
    attributes = writer.attributes()
    if attributes is None:
        return ""
    pairs = attributes["pairs"]
    rows = [shard_rows(int(s), attributes["shard_pairs"], pairs) for s in np.flatnonzero(writer.is_written())]
    count = sum(r.stop - r.start for r in rows)
    return f"{count} of {pairs} histories are kept" if count else ""
