"""Fit and test: which windows of a log are fitted, and which are kept back to be looked at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from capture_cli.errors import LogError, OptionError

TEST_SHARE = 0.25
ENOUGH_EPISODES = 4  # to keep whole episodes back rather than the last block of each


@dataclass(frozen=True)
class Split:
    """is_test (window,); `how`, in words."""

    is_test: np.ndarray
    how: str


def split_windows(
    *, episode: np.ndarray, recording: np.ndarray, recording_names: Sequence[str], test: str | None, seed: int
) -> Split:
    """Split windows by recording (`test`, names or patterns divided by commas), by episode, or by contiguous block.

    episode (window,); recording (episode,). `test` "none" keeps nothing back. Raises OptionError for a pattern that
    matches no recording or all of them, LogError where the log is too short.
    """
    if test == "none":
        return Split(np.zeros(len(episode), dtype=bool), "nothing held out")
    if test is not None:
        return _by_recording(episode, recording, recording_names, test)
    episodes = np.unique(episode)
    if len(episodes) >= ENOUGH_EPISODES:
        count = max(1, round(TEST_SHARE * len(episodes)))
        held = np.random.default_rng(seed).choice(episodes, size=count, replace=False)
        return Split(np.isin(episode, held), f"{count} of {len(episodes)} episodes held out")
    return _last_blocks(episode, episodes)


def _by_recording(episode, recording, names, test: str) -> Split:
    patterns = [p.strip() for p in test.split(",") if p.strip()]
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise OptionError(
                f"--test {pattern!r} matches no recording of the log",
                cure=f"its recordings are: {', '.join(names)}",
            )
    held = [i for i, name in enumerate(names) if any(fnmatchcase(name, p) for p in patterns)]
    is_test = np.isin(np.asarray(recording)[episode], held)
    if is_test.all():
        raise OptionError(
            f"--test {test!r} holds out the whole log", cure="leave at least one recording to fit"
        )
    return Split(is_test, "recordings held out: " + ", ".join(names[i] for i in held))


def _last_blocks(episode: np.ndarray, episodes: np.ndarray) -> Split:
    is_test = np.zeros(len(episode), dtype=bool)
    for number in episodes:
        windows = np.flatnonzero(episode == number)
        if len(windows) > 1:
            is_test[windows[-max(1, round(TEST_SHARE * len(windows))) :]] = True
    if not is_test.any() and len(episodes) > 1:
        return Split(episode == episodes[-1], "last episode held out")
    if not is_test.any():
        raise LogError(
            f"the log has {len(episode)} window(s) in {len(episodes)} episode(s): too short to hold any back",
            cure="record more, set a shorter `window` under [log] (or --window), or pass --test none",
        )
    return Split(is_test, f"last {TEST_SHARE:.0%} of each episode held out")


SELECT_SHARE = 1 / 3  # of what is not test
ENOUGH_WINDOWS = 12  # to part with a third of them
BLOCK = 3  # windows in a row


def select_windows(episode: np.ndarray, is_test: np.ndarray) -> np.ndarray:
    """Windows (window,), True, on which effects are selected: neither fitted nor test.

    Whole episodes where there are enough, otherwise blocks of windows in a row; none where the log is short.
    """
    rest = np.flatnonzero(~is_test)
    chosen = np.zeros(len(episode), dtype=bool)
    if len(rest) < ENOUGH_WINDOWS:
        return chosen
    episodes = np.unique(episode[rest])
    if len(episodes) >= 3 * ENOUGH_EPISODES // 2:
        return ~is_test & np.isin(episode, episodes[1::3])
    chosen[rest[(np.arange(len(rest)) // BLOCK) % 3 == 1]] = True
    return chosen
