"""What chooses between models: a third of the windows, from every recording, whatever the order of the log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from balances import Made
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_cli.log.arrays import Log
from capture_cli.log.input_sequences import HELD
from capture_cli.log.windows import Windows, cut
from capture_cli.select.explain import Settings, _begin
from capture_cli.select.log_parts import FIT, SELECT, SETTINGS, TEST, LogParts, select_folds

SAMPLES, STEP = 8, 1 / 128  # of a window; s


def windows_of(episodes: Sequence[tuple[float, int]]) -> Windows:
    """Of episodes of a sine each: its amplitude, and how many windows it has."""
    counts = [SAMPLES * windows for _, windows in episodes]
    outputs = [size * np.sin(np.arange(n)) for (size, _), n in zip(episodes, counts, strict=True)]
    stops = np.cumsum(counts)
    log = Log(
        time=np.concatenate([STEP * np.arange(n) for n in counts]),
        outputs=np.concatenate(outputs)[:, None],
        episodes=[slice(stop - n, stop) for n, stop in zip(counts, stops, strict=True)],
        inputs=np.zeros((stops[-1], 1)),
    )
    return cut(log, SAMPLES * STEP, STEP, [HELD])


def judged(episodes: Sequence[tuple[float, int]]) -> set[tuple[float, int]]:
    """The windows that judge: the amplitude of their episode, and their number in it."""
    windows = windows_of(episodes)
    (_, choose), *_ = select_folds(windows, np.zeros(len(windows), dtype=bool)).folds
    number = np.arange(len(windows)) - np.searchsorted(windows.episode, windows.episode)
    return {(episodes[e][0], int(n)) for e, n in zip(windows.episode[choose], number[choose], strict=True)}


@pytest.mark.parametrize("count", [2, 5, SETTINGS.enough_windows, 40])
def test_folds_judge_only_what_was_not_fitted(count):
    is_test = np.arange(count) == count - 1
    found = select_folds(windows_of([(1.0, count)]), is_test)
    for fitted, judging in found.folds:
        assert not (fitted & judging).any()
        assert not (is_test & (fitted | judging)).any()
    assert len(found.folds) == (
        1 if count - 1 >= SETTINGS.enough_windows else min(3, count - 1) * (count > 2)
    )


def test_few_windows_are_all_judged_once():
    folds = select_folds(windows_of([(1.0, 7)]), np.arange(7) == 6).folds
    assert (np.sum([own for _, own in folds], axis=0) == np.r_[np.ones(6), 0]).all()


@settings(deadline=None)
@given(st.data())
def test_the_order_of_the_episodes_does_not_matter(data):
    counts = data.draw(st.lists(st.integers(1, 9), min_size=2, max_size=8))
    episodes = [(1.5**k, windows) for k, windows in enumerate(counts)]
    assert judged(data.draw(st.permutations(episodes))) == judged(episodes)


def test_each_condition_is_fitted_and_judges():
    """Three gains in each of three motions, in this order: every third episode would be of one gain."""
    episodes = [(motion * gain, 4 * SETTINGS.block) for motion in (1, 10, 100) for gain in (1.0, 1.1, 1.2)]
    found = judged(episodes)
    for size, windows in episodes:
        assert 0 < sum(own == size for own, _ in found) < windows


def test_short_episodes_take_turns():
    sizes = [1.3**k for k in range(12)]
    found = {size for size, _ in judged([(size, 1) for size in sizes])}
    assert found == set(sizes[1::3])


@pytest.mark.parametrize("windows", [3, 6, 30])
def test_of_a_long_log_a_few_windows_of_each_recording_are_fitted(windows):
    long = windows_of([(1.5**k, windows) for k in range(9)])
    folds = select_folds(long, np.zeros(len(long), dtype=bool))
    [(fit, judging)] = folds.folds
    assert (fit == folds.fit).all() and (judging == ~folds.balance).all()
    assert not (fit & judging).any()
    assert fit.sum() == min(SETTINGS.fitted, folds.balance.sum())
    of_each, fitted = (np.bincount(long.episode[some], minlength=9) for some in (folds.balance, fit))
    assert (fitted[of_each > 0] > 0).all()


def test_windows_in_which_something_is_left_are_fitted_and_judge():
    windows, left = windows_of([(1.0, 18)]), np.zeros(18)
    alone = [6, 7, 8]  # in one block, which judges or does not
    left[alone] = 1.0
    ((fit, judged),) = select_folds(windows, np.zeros(18, dtype=bool), left).folds
    assert (fit[alone].sum(), judged[alone].sum()) == (2, 1)
    assert judged.sum() == 6


def test_what_shows_only_where_it_judges_is_dealt_out_again():
    """As rare impacts may. Nothing is dealt out where nothing is left, nor twice."""
    prepared = Made.of("slider").prepared
    parts = LogParts.of(prepared)
    judging = np.flatnonzero(parts.number == SELECT)
    measured = prepared.windows.measured.copy()
    measured[judging[:3], 60:] += 20 * prepared.noise.sd
    hit = replace(prepared, windows=replace(prepared.windows, measured=measured))
    for log, dealt in ((prepared, False), (hit, True)):
        begun = _begin(log, Made.of("slider").truth, Settings(threads=1), lambda *_: None, 0)
        assert (begun.prepared.left is not None) == dealt
        number = begun.protocol.parts.number
        assert (number == TEST).tolist() == prepared.split.is_test.tolist()
        assert ((number[judging[:3]] == FIT).any()) == dealt
