"""Episodes that a log has twice: if one of them is held out, it was fitted as well, and tests nothing."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from capture_cli.errors import LogError
from capture_cli.log.measured_log import MeasuredLog


def equal_episodes(log: MeasuredLog) -> list[tuple[int, int]]:
    """Pairs of episodes, by their numbers, of which the second holds what the first holds."""
    first: dict[str, int] = {}
    changing = [(number, digest) for number, digest in enumerate(_digests(log)) if digest is not None]
    pairs = [(first.setdefault(digest, number), number) for number, digest in changing]
    return [(earlier, later) for earlier, later in pairs if earlier != later]


def refuse_repeated(logs: Sequence[MeasuredLog]) -> None:
    """Raise LogError where a recording is in an earlier log, or in its own log beside it if that is of several files.

    By the file that it was read from, whatever its name, and by what its episodes hold. What a log that is stored has
    twice is not refused, so that it can be added to.
    """
    seen: dict[str, str] = {}
    for log in logs:
        of_log: dict[str, str] = {}
        stored, digests = Path(log.path).is_dir(), _digests(log)
        for number, recording in enumerate(log.recordings):
            marks = _marks(log, number, digests)
            source = recording["source"] if recording.get("sha256") else str(log.path)
            if again := next((seen[m] for m in marks if m in seen), None):
                raise LogError(
                    f"{source} is in {again}",
                    cure="leave it out; to read a file in anew, import all files again with --force, without --append",
                )
            named = f"{log.path if stored else source} already, as the recording {recording['name']!r}"
            (of_log if stored else seen).update(dict.fromkeys(marks, named))
        seen |= of_log


def _marks(log: MeasuredLog, recording: int, digests: Sequence[str | None]) -> list[str]:
    """What tells a recording from others: the hash of its file, and the digests of its episodes."""
    own = [digests[episode] for episode in np.flatnonzero(log.recording == recording)]
    return [mark for mark in (log.recordings[recording].get("sha256"), *own) if mark]


def _digests(log: MeasuredLog) -> list[str | None]:
    """Of what each episode holds, time, inputs, outputs and the action, (episode,); None where no output changes.

    Episodes of machines at rest are the same.
    """
    found = []
    for number, steps in enumerate(log.episodes):
        outputs = log.outputs[steps]
        if not np.any(outputs != outputs[:1]):
            found.append(None)
            continue
        digest = hashlib.sha256()
        for array in (log.time[steps], log.inputs[steps], outputs, *_action(log, number)):
            digest.update(np.ascontiguousarray(array).tobytes())
        found.append(digest.hexdigest())
    return found


def _action(log: MeasuredLog, episode: int) -> list[np.ndarray]:
    """Its action (action,), as the only one; none where the log has none."""
    return [] if log.actions is None else [log.actions[episode]]
