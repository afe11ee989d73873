"""Fit and test: which windows of a log are fitted, and which are kept back to be looked at once."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.errors import LogError, OptionError
from capture_cli.log.shorter_window import set_shorter


@frozen
class SETTINGS:
    test_share: float = 0.25
    # Of the samples, that whole episodes may keep back: with fewer what judges says nothing, with more what
    # is fitted does
    least_held: float = 0.05
    most_held: float = 2 / 3
    enough_episodes: int = 4  # to choose those that are kept back at random, rather than the last
    draws: int = 20  # of episodes that are about as long as they should be
    most_named: int = 5  # episodes that are kept back and named


UNEQUAL = "the episodes are too unequal to hold out whole ones"


@dataclass(frozen=True)
class Split:
    """is_test (window,); `how`, in words."""

    is_test: np.ndarray
    how: str


@dataclass(frozen=True)
class Divided:
    """A log as it is cut. first, samples, episode (window,): the step that each begins at, how many it has, and the
    number of its episode. recording (episode,): which of `names` each comes from. longest: s, of the longest episode.
    chosen: s, of windows that nobody set; None where they were.
    """

    first: np.ndarray
    samples: np.ndarray
    episode: np.ndarray
    recording: np.ndarray
    names: Sequence[str]
    longest: float
    chosen: float | None = None


@dataclass(frozen=True)
class EarlierSplit:
    """What was held out of a log before, so that it stays so.

    first (window,): steps of the log at which the windows of then began, in their order. is_test (window,); how, in
    words.
    """

    first: np.ndarray
    is_test: np.ndarray
    how: str

    def of(self, log: Divided) -> Split:
        """Its windows that hold any of what was held out."""
        return Split(self.held_in(log.first, log.samples), self.how)

    def held_in(self, first: np.ndarray, samples: np.ndarray) -> np.ndarray:
        """Which windows that begin at the steps `first` (window,) and have so many samples hold any of it."""
        begins, ends = (
            np.searchsorted(self.first, at, side="right") - 1 for at in (first, first + samples - 1)
        )
        held = np.concatenate([[0], np.cumsum(self.is_test)])
        return held[ends + 1] > held[begins]


@dataclass(frozen=True)
class NewSplit:
    """By recording (`test`, names or patterns divided by commas), by episode, or by contiguous block; `test` "none"
    keeps nothing back.
    """

    test: str | None = None
    seed: int = 0

    def of(self, log: Divided) -> Split:
        """Raises OptionError for a pattern that matches no recording or all of them, or where there is none; LogError
        where the log is too short.
        """
        split = self._of(log)
        if log.chosen is None:
            return split
        return replace(split, how=f"{split.how}; windows of {log.chosen:g} s, for none are set")

    def _of(self, log: Divided) -> Split:
        if self.test == "none":
            return Split(np.zeros(len(log.episode), dtype=bool), "nothing held out")
        if self.test is not None:
            return _by_recording(log, self.test)
        episodes, of_window = np.unique(log.episode, return_inverse=True)
        if len(episodes) == 1:
            return _last_block(log)
        shares = np.bincount(of_window, weights=log.samples) / log.samples.sum()
        for held in _tries(len(episodes), self.seed):
            if SETTINGS.least_held <= shares[held].sum() <= SETTINGS.most_held:
                names = [log.names[i] for i in log.recording]
                return Split(np.isin(of_window, held), _said(held, episodes, names))
        block = _last_block(log)
        return Split(block.is_test, f"{block.how}: {UNEQUAL}")


def _tries(count: int, seed: int) -> Iterator[np.ndarray]:
    """Of so many episodes the numbers of those that may be kept back, the most welcome first."""
    if count < SETTINGS.enough_episodes:
        yield from (np.array([last]) for last in reversed(range(count)))
        return
    generator = np.random.default_rng(seed)
    size = max(1, round(SETTINGS.test_share * count))
    yield from (generator.choice(count, size=size, replace=False) for _ in range(SETTINGS.draws))


def _said(held: np.ndarray, episodes: np.ndarray, names: Sequence[str]) -> str:
    """held: which of `episodes`, the numbers of those that have windows; names: as of `episodes_held_out`."""
    count = len(episodes)
    if count < SETTINGS.enough_episodes and held[0] == count - 1:
        return f"last of {count} episodes held out"
    return episodes_held_out(episodes[held], count, names)


def episodes_held_out(held: Sequence[int], count: int, names: Sequence[str] = ()) -> str:
    """That the episodes `held` of `count` are kept back, in words; names (episode,): of their recordings, by which they
    go where no two share one.
    """
    how, held = f"{len(held)} of {count} episodes held out", sorted(held)
    if len(held) > SETTINGS.most_named:
        return how
    if len(names) == len(set(names)) == count:
        return f"{how}: {', '.join(names[i] for i in held)}"
    return f"{how}: episode{'s' * (len(held) > 1)} {', '.join(map(str, held))}"


def _by_recording(log: Divided, test: str) -> Split:
    names = log.names
    patterns = [p.strip() for p in test.split(",") if p.strip()]
    if not patterns:  # as of a shell's variable that is not set
        raise OptionError(
            f"--test {test!r} names no recording",
            cure="name those to hold out, or leave --test out; to hold out nothing, pass --test none",
        )
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise OptionError(
                f"--test {pattern!r} matches no recording of the log",
                cure=f"its recordings are: {', '.join(names)}",
            )
    held = [i for i, name in enumerate(names) if any(fnmatchcase(name, p) for p in patterns)]
    is_test = np.isin(np.asarray(log.recording)[log.episode], held)
    if is_test.all():
        raise OptionError(
            f"--test {test!r} holds out the whole log", cure="leave at least one recording to fit"
        )
    return Split(is_test, "recordings held out: " + ", ".join(names[i] for i in held))


def _last_block(log: Divided) -> Split:
    windows, duration, samples = len(log.episode), log.longest, int(log.samples.sum())
    is_test = np.zeros(windows, dtype=bool)
    if windows < 2:
        raise LogError(
            f"the log, {duration:.3g} s, is one window long: too short to hold any back",
            cure=f"{set_shorter(duration, samples, option=True)}, or pass --test none to hold out nothing",
        )
    count = max(1, round(SETTINGS.test_share * windows))
    is_test[-count:] = True
    return Split(is_test, f"last {count} of {windows} windows held out")
