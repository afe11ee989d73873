"""What `diagnose` decides by: noise floor, folds, scores, acceptance, localisation; and what it refuses."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from coloured_noise import coloured
from diagnosing import look_among
from held_inputs import held_machine
from hypothesis import given, settings
from hypothesis import strategies as st
from machines import NAMES, placed
from scipy.signal import butter, lfilter
from scipy.spatial.transform import Rotation
from scipy.stats import ttest_1samp

from capture_cli.common.progress import Progress
from capture_cli.errors import LogError, OptionError, OutputError
from capture_cli.estimate.fit import Fit
from capture_cli.estimate.held_out import HeldOut
from capture_cli.estimate.model_fits import ModelFits
from capture_cli.estimate.noise.autocorrelation import block_squares, correlation_steps
from capture_cli.estimate.noise.lack_of_fit import LackOfFit, lack_held_out
from capture_cli.estimate.noise.noise_floor import noise_floor
from capture_cli.estimate.part_fit import PartFit
from capture_cli.estimate.prepare import prepare
from capture_cli.estimate.solve.base import Best
from capture_cli.estimate.solve.intervals import intervals
from capture_cli.estimate.solve.linearization import Data, Linearization
from capture_cli.estimate.split import UNEQUAL, Divided, NewSplit
from capture_cli.log.arrays import Log
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.white_noise import from_differences, noise_and_spacing, trimmed_sd
from capture_cli.model.effects.placed import Placed
from capture_cli.model.parameters import Parameter, ParameterSpace
from capture_cli.model.tasks import load_task
from capture_cli.report.diagnosis_findings import summary
from capture_cli.select.candidates import SETTINGS as CANDIDATES
from capture_cli.select.candidates import Candidate, all_candidates, worth_a_refit
from capture_cli.select.criterion import bic_gain, paired_p_value, ratio_p_value
from capture_cli.select.explain import Settings
from capture_cli.select.explanation import verdict as judged_as
from capture_cli.select.fit_checks import SETTINGS as FIT_CHECKS
from capture_cli.select.fit_checks import slight
from capture_cli.select.log_parts import FIT, SELECT, TEST, Folds
from capture_cli.select.model_comparison import initial_states_found
from capture_cli.select.residual_curves import SETTINGS as RESIDUAL_CURVES
from capture_cli.select.residual_curves import accelerations, curve, largest_around, residual_curves
from capture_cli.select.score import Score, score
from capture_cli.select.search.answer import Accepted
from capture_cli.stages import diagnose as diagnose_stage
from capture_cli.stages.diagnose import diagnose, diagnose_prepared
from capture_cli.stages.identify import identify
from capture_cli.stages.record import record
from capture_cli.store.diagnosis import DiagnosisRecord
from capture_cli.store.estimate import Estimate

ALIKE_LAGS = ("control-lag", "control-second-order-lag", "sensor-delay")
SLIDER = Path(__file__).parents[1] / "benchmarks" / "machines" / "slider" / "task.toml"


@pytest.mark.parametrize("order", [0, 1])
def test_noise_floor_of_smooth_signal_and_white_noise(order):
    generator = np.random.default_rng(order)
    time = np.linspace(0, 5, 2000)
    signal = np.sin(3 * time) + 0.2 * np.sin(17 * time + order)
    noisy = signal + 1e-3 * generator.standard_normal(len(time))
    assert from_differences([noisy], [time]) == pytest.approx(1e-3, rel=0.08)


@pytest.mark.parametrize("cutoff", [1 / 16, 1 / 8])
@pytest.mark.parametrize("seed", [0, 1])
def test_noise_that_a_filter_has_passed_shows_in_the_spectrum(cutoff, seed):
    time = np.linspace(0, 8, 2000)
    signal = 0.1 * np.sin(3 * time) + 0.02 * np.sin(17 * time)
    noise = 1e-3 * np.random.default_rng(seed).standard_normal(len(time))
    filtered = lfilter(*butter(2, 2 * cutoff), signal + noise)[200:]
    only_noise = lfilter(*butter(2, 2 * cutoff), noise)[200:]
    ((found, spacing),) = noise_and_spacing([[filtered]], [[time[200:]]])
    assert found == from_differences([filtered], [time[200:]]) == pytest.approx(only_noise.std(), rel=0.2)
    assert 0.25 < spacing * cutoff < 1
    assert noise_and_spacing([[signal + noise]], [[time]])[0][1] == 1


@pytest.mark.parametrize("seed", range(3))
def test_where_a_channel_moves_too_fast_others_show_what_the_loggers_filter_leaves(seed):
    """The motion of one has components up to 35 Hz, where the filter acts: from 31 Hz on."""
    generator = np.random.default_rng(seed)
    time = np.linspace(0, 8, 2000)
    noise = [1e-3, 2e-3] * generator.standard_normal((len(time), 2))
    hertz = np.arange(1, 36)
    waves = np.sin(2 * np.pi * (hertz * time[:, None] + generator.uniform(size=len(hertz))))
    slow, fast = np.sin(3 * time), waves @ np.exp(-0.2 * hertz)
    numerator, denominator = butter(2, 0.25)
    seen = [
        [lfilter(numerator, denominator, motion + own)[200:]]
        for motion, own in zip((slow, fast), noise.T, strict=True)
    ]
    times = [[time[200:]]] * 2
    ((alone, _),), (_, (found, spacing)) = (
        noise_and_spacing(seen[1:], times[1:]),
        noise_and_spacing(seen, times),
    )
    only_noise = lfilter(numerator, denominator, noise[:, 1])[200:].std()
    assert found == pytest.approx(only_noise, rel=0.25) and 3 <= spacing <= 5
    assert alone < 0.75 * only_noise


@settings(deadline=None)
@given(
    st.lists(st.tuples(st.floats(0.1, 6.0), st.floats(0.1, 1.0), st.floats(0, 6.3)), min_size=1, max_size=4)
)
def test_motion_without_noise_shows_none_however_far_apart_samples_are(waves):
    time = np.linspace(0, 8, 2000)
    motion = sum(size * np.sin(2 * np.pi * hertz * time + phase) for hertz, size, phase in waves)
    assert from_differences([motion], [time]) < 1e-4


@pytest.mark.parametrize("jitter", [0.1, 0.4])
def test_noise_floor_of_a_log_with_uneven_times(jitter):
    generator = np.random.default_rng(2)
    time = (np.arange(2000) + jitter * generator.uniform(-1, 1, 2000)) / 100
    noisy = np.sin(3 * time) + 0.2 * np.sin(17 * time) + 1e-3 * generator.standard_normal(len(time))
    assert from_differences([noisy], [time]) == pytest.approx(1e-3, rel=0.08)


def test_noise_floor_takes_what_is_declared_and_sees_a_coarse_encoder():
    time = np.linspace(0, 5, 2000)
    outputs = np.stack([np.sin(time), 0.01 * np.round(np.sin(time) / 0.01)], axis=1)
    log = Log(time, outputs, [slice(0, 2000)])
    found = noise_floor(log, [0.5, None], driven_by=[np.zeros((2000, 0))], block=50)
    assert found.sd[0] == 0.5
    assert found.source[0] == "declared"
    assert found.sd[1] >= 0.01 / np.sqrt(12) * 0.99


@pytest.mark.parametrize("turn", [0.1, 3.0])
def test_the_four_numbers_of_an_attitude_have_one_floor(turn):
    """Of a body that is mostly level, w has next to no noise but while it turns."""
    generator = np.random.default_rng(0)
    time = np.arange(4000) / 200
    angle = turn * np.clip(np.sin(0.2 * np.pi * time) - 0.6, 0, 1) / 0.4
    true = Rotation.from_rotvec(angle[:, None] * [1.0, 0.0, 0.0])
    noise = Rotation.from_rotvec(0.005 * generator.standard_normal((len(time), 3)))
    exact, outputs = (r.as_quat(canonical=False)[:, [3, 0, 1, 2]] for r in (true, true * noise))
    arguments = dict(driven_by=[np.zeros((4000, 0))], block=50, attitudes=[np.arange(4)])
    noisy, exactly = (Log(time, values, [slice(0, 4000)]) for values in (outputs, exact))
    found = noise_floor(noisy, [None] * 4, **arguments)
    assert (found.sd == found.sd[0]).all()
    assert found.source == ("differences",) * 4
    assert np.sqrt(np.mean(np.square(outputs - exact))) / found.sd[0] == pytest.approx(1, abs=0.04)
    declared = noise_floor(noisy, [0.0025] * 4, **arguments)
    assert declared.sd == pytest.approx([0.0025] * 4)
    # without noise two of the numbers are 0 throughout, which is no floor of 1
    still = noise_floor(exactly, [None] * 4, **arguments)
    assert still.sd.max() < 1e-6


REPEATS, STEPS = 4, 500


def repeated(generator, noise, start=0.0, same_drive=True):
    """noise_floor of four episodes of a swinging machine, whose initial states differ by `start`; noise (repeat,
    step).
    """
    time = np.arange(STEPS) / 250
    swing = np.sin(6 * time) + start * generator.standard_normal((REPEATS, 1)) * np.cos(6 * time)
    outputs = (swing + noise).reshape(-1, 1)
    drive = [np.sin(3 * time + (0 if same_drive else k))[:, None] for k in range(REPEATS)]
    episodes = [slice(k * STEPS, (k + 1) * STEPS) for k in range(REPEATS)]
    tiled = np.concatenate([time + 7 * k for k in range(REPEATS)])
    return noise_floor(Log(tiled, outputs, episodes), [None], driven_by=drive, block=60)


@pytest.mark.parametrize("seed", range(3))
def test_repeats_show_noise_that_differences_do_not(seed):
    generator = np.random.default_rng(seed)
    noise = coloured((REPEATS, STEPS + 50), generator, sd=1e-3, memory=3.0)[:, 50:]
    found = repeated(generator, noise)
    assert found.source == ("repeats",)
    assert 0.8e-3 < found.sd[0] < 1.05e-3  # the cubics take some of it
    by_differences = repeated(generator, noise, same_drive=False)
    assert by_differences.source == ("differences",)
    assert by_differences.sd[0] < 0.7e-3


@pytest.mark.parametrize("start", [0.0, 3e-4])
def test_repeats_are_not_misled_by_what_a_slightly_different_start_does(start):
    generator = np.random.default_rng(5)
    found = repeated(generator, 1e-3 * generator.standard_normal((REPEATS, STEPS)), start)
    assert found.source == ("repeats",)
    assert found.sd[0] == pytest.approx(1e-3, rel=0.06)


@pytest.mark.parametrize("locked_at", [0.0, 0.3])
def test_an_axis_that_rests_does_not_hide_repeats_of_the_others(locked_at):
    """Its noise is declared; times of day are off by a microsecond, by which a fitted line is, too."""
    generator = np.random.default_rng(7)
    time = np.tile(np.arange(STEPS) / 250, 2) + np.repeat([0.0, 1000.0], STEPS)
    time[STEPS:] += 1e-6 * generator.standard_normal(STEPS)
    swing = np.tile(np.sin(6 * np.arange(STEPS) / 250), 2) + 1e-3 * generator.standard_normal(2 * STEPS)
    outputs = np.stack([swing, np.full(2 * STEPS, locked_at)], axis=1)
    found = noise_floor(
        Log(time, outputs, [slice(0, STEPS), slice(STEPS, 2 * STEPS)]),
        [None, 1e-3],
        driven_by=[np.sin(np.arange(STEPS))[:, None]] * 2,
        block=60,
    )
    assert found.source == ("repeats", "declared")


@pytest.mark.parametrize("count", [6, 12, 40, 1000])
def test_a_trimmed_sd_is_right_of_few_numbers_too(count):
    generator = np.random.default_rng(0)
    found = [trimmed_sd(generator.standard_normal(count)) for _ in range(3000)]
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(1.0, abs=0.03)


def test_episodes_that_start_elsewhere_and_copies_are_no_repeats():
    generator = np.random.default_rng(6)
    noise = 1e-3 * generator.standard_normal((REPEATS, STEPS))
    assert repeated(generator, noise, start=0.05).source == ("differences",)
    assert repeated(generator, np.repeat(noise[:1], REPEATS, axis=0)).source == ("differences",)


@pytest.mark.parametrize(
    ("before", "after", "is_slight"),
    [(10.0, 9.6, True), (10.0, 9.3, False), (1.12, 1.0, False), (1.12, 1.11, True), (3.0, 1.0, False)],
)
def test_an_effect_has_to_take_a_tenth_of_what_is_above_the_floor(before, after, is_slight):
    why = slight(left_by([before]), left_by([after]), FIT_CHECKS.material)
    assert (why is not None) == is_slight
    # nor does it matter how far below its floor another output is
    assert (
        slight(left_by([before, 0.3, 0.3]), left_by([after, 0.3, 0.3]), FIT_CHECKS.material) is not None
    ) == is_slight


def left_by(errors: list[float]) -> Fit:
    """A fit that leaves `errors` (output,) times the noise floor."""
    size = len(errors)
    data = Data(
        ParameterSpace([]),
        np.zeros((2, 50, size)),
        np.ones((2, 50, size), dtype=bool),
        np.ones(size),
        np.zeros((2, 1)),
    )
    none = np.zeros((2, 50 * size, 0))
    residual = np.broadcast_to(errors, (2, 50, size)).reshape(2, -1)
    at = Linearization(data, np.zeros(0), np.zeros((2, 1)), residual, none, none)
    return Fit((), data.space, np.zeros(0), at)


def test_candidates_that_say_the_same_leave_room_for_others():
    """Six copies of the best, then others that differ: three of the copies are fitted, and the best of the others."""
    directions = np.eye(8)
    ranked = _scored(_of_size(1)[:13], [directions[0]] * 6 + list(directions[1:]))
    refitted, others = worth_a_refit(ranked)
    assert refitted == [ranked[k] for k in (0, 1, 2, 6, 7, 8, 9)]
    assert others == [ranked[k] for k in (3, 4, 5, 10, 11, 12)]
    refitted, _ = worth_a_refit([*ranked[:3], *[ranked[6]] * 3, *[ranked[7]] * 3])
    assert len(refitted) == CANDIDATES.refitted


def test_variants_of_one_site_leave_room_for_other_effects():
    """A spring of which the sensors of position and velocity, one, both or neither, are on the motor's side."""
    variants = [Placed("compliance", effect) for m, effect in placed("compliance") if m == "slider"]
    assert len(variants) == 4
    ranked = _scored([*variants, *_of_size(1)[:6]], np.eye(10))
    refitted, _ = worth_a_refit(ranked)
    assert refitted == [ranked[k] for k in (0, 1, 2, 4, 5, 6, 7)]


def test_the_simplest_of_those_that_say_the_same_is_fitted_too():
    ranked = _scored([_of_size(size)[k] for k, size in enumerate((3, 4, 3, 1))], np.ones((4, 2)))
    refitted, _ = worth_a_refit(ranked)
    assert refitted == [ranked[k] for k in (0, 1, 3)]


def _of_size(parameters: int) -> list[Placed]:
    """Effects of the slider that have so many."""
    every = [Placed(name, effect) for name in NAMES for m, effect in placed(name) if m == "slider"]
    return [p for p in every if len(p.effect.parameters) == parameters]


def _scored(effects: Sequence[Placed], responses: Sequence[np.ndarray]) -> list[Candidate]:
    """Candidates with these responses, (row,) each."""
    none = np.zeros(0)
    pairs = zip(effects, responses, strict=True)
    return [Candidate(p, Score(1.0, none, none, 1.0, response)) for p, response in pairs]


def test_intervals_reach_to_minima_that_are_nearly_as_good():
    """Of a residual that grows with x from either of two places, the descent has found one."""
    space = ParameterSpace([Parameter("a", "1", 0.0, 1.0, 0.5)])
    data = Data(space, np.zeros((1, 50, 1)), np.ones((1, 50, 1), bool), np.ones(1), np.zeros((1, 0)))
    slope = np.full((1, 50, 1), 20.0)
    noise = np.random.default_rng(0).standard_normal((1, 50))
    noise -= noise.mean()

    def minimum(x: float, more: float) -> Linearization:
        residual = noise * np.sqrt(1 + more / np.square(noise).sum())
        return Linearization(data, np.array([x]), np.zeros((1, 0)), residual, slope, np.zeros((1, 50, 0)))

    alone = intervals(minimum(0.5, 0.0)).sd[0]
    beside = intervals(minimum(0.5, 0.0), [minimum(0.6, 0.5)]).sd[0]
    assert alone < 0.02
    weight = np.exp(-0.25 / minimum(0.5, 0.0).inflation)
    assert beside == pytest.approx(np.sqrt(alone**2 + 0.01 * weight / (1 + weight)), rel=1e-6)
    assert intervals(minimum(0.5, 0.0), [minimum(0.6, 80.0)]).sd[0] == pytest.approx(alone, rel=1e-3)


def split_of(windows: Sequence[int], recordings: int | None = None, seed: int = 0, **options):
    """The default split of episodes of so many `windows` each, in a recording each or in so many."""
    recordings = len(windows) if recordings is None else recordings
    episode = np.repeat(np.arange(len(windows)), windows)
    log = {
        "samples": np.full(len(episode), 50),
        "recording": np.arange(len(windows)) % recordings,
        "names": [f"run {i}" for i in range(recordings)],
        "longest": 10.0,
    }
    first = 50 * np.arange(len(episode))
    return NewSplit(seed=seed).of(Divided(first=first, episode=episode, **{**log, **options}))


def test_two_episodes_hold_out_the_last():
    assert split_of([2, 2], 1).is_test.tolist() == [False, False, True, True]


@given(
    st.lists(st.integers(1, 40), min_size=2, max_size=9),
    st.integers(0, 3),
)
def test_neither_what_is_fitted_nor_what_is_held_out_is_next_to_nothing(windows, seed):
    """However long the episodes are, and in whatever order: of a log of two windows at least, all as long."""
    split = split_of(windows, seed=seed)
    assert 0.05 <= split.is_test.mean() <= 2 / 3
    of_each = np.split(split.is_test, np.cumsum(windows)[:-1])
    assert all(len(set(own)) == 1 for own in of_each) or split.how.endswith(UNEQUAL)


@pytest.mark.parametrize(
    ("windows", "held"), [((1, 40), 10), ((40, 1), 10), ((10, 40), 10), ((9, 12, 1), 12)]
)
def test_of_unequal_episodes_those_are_held_out_that_leave_enough(windows, held):
    assert split_of(windows).is_test.sum() == held


@pytest.mark.parametrize(
    ("windows", "how"),
    [((0, 30, 20), "last of 2 episodes held out"), ((0, 10, 30), "1 of 2 episodes held out: episode 1")],
)
def test_the_last_of_few_episodes_is_called_that_where_others_have_no_windows(windows, how):
    assert split_of(windows).how == how


def test_of_a_log_that_is_one_window_long_a_shorter_window_is_named():
    def refused(duration: float, samples: int) -> str:
        with pytest.raises(LogError, match=f"the log, {duration:g} s, is one window long") as error:
            split_of([1], samples=np.array([samples]), longest=duration)
        return error.value.cure

    assert refused(0.59, 60).startswith(
        "set `window = 0.1` under [log] of the task.toml (or pass --window 0.1)"
    )
    assert refused(4.0, 60).startswith("set `window = 1` under")
    assert refused(0.59, 12).startswith("record longer, or pass --test none")


def test_what_is_held_out_is_named():
    held = np.flatnonzero(split_of([3] * 8).is_test[::3])
    assert split_of([3] * 8).how == f"2 of 8 episodes held out: run {held[0]}, run {held[1]}"
    assert split_of([3] * 8, 2).how == f"2 of 8 episodes held out: episodes {held[0]}, {held[1]}"
    assert split_of([3] * 24).how == "6 of 24 episodes held out"


@pytest.mark.parametrize(("windows", "held"), [(2, 1), (4, 1), (7, 2), (40, 10)])
def test_of_a_single_episode_the_last_windows_are_held_out(windows, held):
    split = split_of([windows])
    assert split.is_test.tolist() == [False] * (windows - held) + [True] * held
    assert split.how == f"last {held} of {windows} windows held out"


@pytest.mark.parametrize("test", ["", ",", " , "])
def test_holding_out_nothing_has_to_be_said(test):
    each = np.array([0, 0, 1, 1])
    log = Divided(50 * np.arange(4), np.full(4, 50), each, np.array([0, 1]), ["a", "b"], longest=2.0)
    with pytest.raises(OptionError, match="names no recording") as error:
        NewSplit(test).of(log)
    assert "--test none" in error.value.cure
    assert not NewSplit("none").of(log).is_test.any()


@pytest.mark.parametrize("blocks", [3, 4, 16])
def test_paired_test_has_its_level_and_its_power(blocks):
    generator = np.random.default_rng(0)
    p = np.array(
        [paired_p_value(*generator.chisquare(20, (2, blocks)), seed=s) for s in range(400)]
    )  # nothing happened
    rejected = (p < 0.05).sum()
    assert rejected <= 38  # binomial(400, 0.05) exceeds 38 with probability 2e-4
    before = generator.chisquare(20, blocks)
    assert paired_p_value(before, 0.5 * before, seed=0) < 0.01


def test_one_block_proves_nothing_and_no_change_is_none():
    assert paired_p_value(np.array([100.0]), np.array([1.0]), seed=0) == 1.0
    assert paired_p_value(np.ones(4), np.ones(4), seed=0) == 0.5


def test_few_blocks_are_put_to_students_test():
    before, after = np.random.default_rng(2).chisquare(20, (2, 9))
    student = ttest_1samp(np.log(before / after), 0, alternative="greater").pvalue
    assert paired_p_value(before, after, seed=0) == pytest.approx(student)


@pytest.mark.parametrize("memory", [0.0, 0.6, 0.85])
def test_correlation_is_seen_where_starts_were_fitted(memory):
    """Of an autoregressive error in windows of 45 steps, parabolas taken out: (1 + memory) / (1 - memory) steps."""
    generator = np.random.default_rng(3)
    error = generator.standard_normal((40, 145))
    for step in range(1, error.shape[1]):
        error[:, step] += memory * error[:, step - 1]
    error = error[:, 100:]
    time = np.linspace(-1, 1, error.shape[1])
    basis, _ = np.linalg.qr(time[:, None] ** np.arange(3))
    residual = error - error @ basis @ basis.T
    truth = (1 + memory) / (1 - memory)
    found = correlation_steps(residual[..., None], np.ones((*residual.shape, 1), dtype=bool))
    assert 0.25 * truth < found < 1.15 * truth  # without the care: 0.12, of the longest memory


def test_blocks_hold_every_square_once():
    squares = np.random.default_rng(1).random((4, 10))
    mask = np.ones((4, 10), dtype=bool)
    mask[2, 6:] = False
    mask[3] = False  # a camera that saw nothing for a window
    blocks = block_squares(squares, mask, 3)
    assert blocks.sum() == pytest.approx(squares[mask].sum())
    assert len(blocks) == 3 + 3 + 2


def test_ratio_test_has_its_level_and_counts_the_candidates():
    generator = np.random.default_rng(2)
    noise = generator.standard_normal((600, 100))
    column = np.ones(100) / 10
    after = np.square(noise).sum(axis=1) - np.square(noise @ column)  # one useless parameter fitted
    p = [ratio_p_value(float(n @ n), float(a), 99, 1, 1) for n, a in zip(noise, after, strict=True)]
    rejected = np.sum(np.array(p) < 0.05)
    assert 12 <= rejected <= 52  # binomial(600, 0.05) is outside with probability 2e-4
    assert ratio_p_value(1.2, 1.0, 99, 1, 1) < 1e-4
    assert ratio_p_value(1.2, 1.0, 99, 1, 50) == pytest.approx(50 * ratio_p_value(1.2, 1.0, 99, 1, 1))


def test_bic_charges_for_parameters():
    assert bic_gain(1.0, 1.0, 100, 2) == pytest.approx(-2 * np.log(100))
    assert bic_gain(2.0, 1.0, 100, 2) > 0


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("before", [1e-30, 1.0, 1e20])
def test_a_perfect_fit_is_worth_its_parameters(before):
    assert 0 < bic_gain(before, 0.0, 100, 2) < np.inf
    assert ratio_p_value(before, 0.0, 100, 2, 1) == 0


@pytest.mark.filterwarnings("error")
def test_next_to_a_perfect_fit_nothing_is_worth_more_parameters():
    assert bic_gain(0.0, 0.0, 100, 2) == pytest.approx(-2 * np.log(100))
    assert ratio_p_value(0.0, 0.0, 100, 2, 1) == 1


def test_residual_acceleration_is_found_against_its_cause():
    time = np.tile(np.arange(300) * 0.01, (4, 1))
    phase = np.arange(4)[:, None]
    position = np.sin(2 * time + phase)
    residual = (
        0.05 * np.sin(2 * time + phase)[..., None]
    )  # its acceleration is -0.2 sin: a function of position
    mask = np.ones(time.shape, dtype=bool)
    acceleration = accelerations(residual, time, mask)[..., 0]
    inside = np.isfinite(acceleration)
    assert acceleration[inside] == pytest.approx(-0.2 * position[inside], abs=2e-3)
    by_position, by_time = (
        curve(position.ravel(), acceleration.ravel()),
        curve(time.ravel(), acceleration.ravel()),
    )
    assert by_position.share > 0.99
    assert by_time.share < 0.7
    assert by_position.mean[-1] < 0 < by_position.mean[0]


def test_accelerations_of_unevenly_sampled_residuals():
    time = np.cumsum(np.random.default_rng(0).uniform(5e-4, 3.5e-3, (2, 400)), axis=1)
    residual = np.stack([time, time**2 / 2], axis=-1)
    found = accelerations(residual, time, np.ones(time.shape, dtype=bool))[:, 20:-20]
    np.testing.assert_allclose(found, np.broadcast_to([0.0, 1.0], found.shape), atol=1e-6)


@pytest.mark.parametrize("steps", [3, 17, 40])
def test_contacts_count_for_all_accelerations_that_are_taken_over_them(steps):
    values = np.random.default_rng(0).integers(0, 9, (2, steps))
    around = [
        [
            v[max(0, i - RESIDUAL_CURVES.half_width) : i + RESIDUAL_CURVES.half_width + 1].max()
            for i in range(steps)
        ]
        for v in values
    ]
    assert np.array_equal(largest_around(values), around)


def test_what_cannot_show_in_a_log_is_no_candidate(logs, tmp_path):
    """A sensor that is no output may be late; and of a drive that only pushes nothing is known of its pull."""
    folder = tmp_path / "slider"
    shutil.copytree(SLIDER.parent, folder)
    model = folder / "model.xml"
    model.write_text(model.read_text().replace("<sensor>", '<sensor><jointvel name="speed" joint="x"/>'))
    log = replace(MeasuredLog.read(logs["plain"]), path=None)
    log = replace(log, inputs=np.abs(log.inputs))
    task = load_task(str(folder / "task.toml"))
    candidates = all_candidates(prepare(log, task))
    names = {c.name for c in candidates}
    assert "sensor-delay@q" in names and "sensor-delay@speed" not in names
    assert "control-gain@drive" in names and "control-reverse-gain@drive" not in names
    encoder = {task.model.sensor("q").adr[0]}
    assert all(c.placed.effect.logged == encoder for c in candidates), "without the speed"


def test_effects_are_told_how_fast_joints_began_to_move(logs):
    log = replace(MeasuredLog.read(logs["plain"]), path=None)
    task = load_task(str(SLIDER))

    def seen(log):
        loose = next(c.placed.effect for c in all_candidates(prepare(log, task)) if c.name == "loose-mass@x")
        return loose.seen

    begun = np.repeat(log.time[np.append(0, log.episode_ends[:-1])], np.diff(log.episode_ends, prepend=0))
    faster = replace(log, outputs=log.outputs + 0.3 * (log.time - begun)[:, None])
    still, moving = seen(log), seen(faster)
    assert len(still.begun) == len(still.stretches) == len(log.episode_ends)
    assert (still.begun_sd < 0.03).all() and (np.abs(still.begun) < 0.1).all()  # it begins at rest
    assert moving.begun - still.begun == pytest.approx(0.3, abs=0.03)


def test_a_covariate_of_few_values_has_a_bin_for_each():
    generator = np.random.default_rng(3)
    contacts = (np.arange(4000) % 50 == 0).astype(float)  # rare, and its own bin all the same
    found = curve(contacts, 5 * contacts + generator.standard_normal(4000))
    assert np.unique(found.centre).tolist() == [0, 1]
    assert found.mean[0] == pytest.approx(0, abs=0.1)
    assert found.mean[-1] == pytest.approx(5, abs=0.6)
    assert found.share == pytest.approx(0.02 * 25 / (1 + 0.02 * 25), rel=0.2)
    assert curve(generator.permutation(contacts), generator.standard_normal(4000)).share < 0.01


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Two logs of the slider, the first with friction that its model lacks."""
    folder, made = tmp_path_factory.mktemp("logs"), {}
    for name, effects, seed in (("friction", ["coulomb-friction@x=3"], 1), ("plain", [], 2)):
        made[name] = folder / f"{name}.zarr"
        record(
            task=str(SLIDER),
            out=made[name],
            effects=effects,
            noise=5e-4,
            episodes=8,
            duration=1.5,
            rate=250,
            seed=seed,
        )
    return made


def test_an_effect_is_found_added_and_its_error_reported_before_and_after(logs, tmp_path, monkeypatch):
    monkeypatch.setattr(diagnose_stage, "_write_pages", lambda *_: None)
    look_among(
        monkeypatch, "coulomb-friction", "stribeck-friction", "quadratic-drag", "sensor-bias", "control-lag"
    )
    document = diagnose(
        real_log=logs["friction"], task=str(SLIDER), out=tmp_path / "found", quiet=True, threads=1
    ).document
    assert document["verdict"] in ("effect-found", "tied")
    names = [e["name"] for e in document["effects"]] + document["effects"][0]["tied_with"]
    assert "coulomb-friction" in names[0] or any("coulomb-friction" in n for n in names)
    assert document["before"]["test"]["normalized"] > 2
    assert document["after"]["test"]["normalized"] < 1.2
    assert document["absorbed"]["damping"]["before"] > document["absorbed"]["damping"]["after"]
    assert all(c["why_rejected"] for c in document["candidates"] if c["effect"] != "coulomb-friction")
    written = json.loads((tmp_path / "found" / "diagnosis.json").read_text())
    assert written == document


def test_a_refit_begins_with_the_starts_that_were_found():
    number = np.array([FIT, TEST, SELECT, FIT, SELECT])
    folds = Folds(number == FIT, ((number == FIT, number == SELECT),), number == FIT)
    fitted, judged = np.array([[1.0], [4]]), np.array([[3.0], [5]])
    assert initial_states_found(folds, fitted, judged).ravel().tolist() == [1, 0, 3, 4, 5]
    assert initial_states_found(folds, fitted, None).ravel().tolist() == [1, 0, 0, 4, 0]


def test_what_arises_in_contact_is_found_there(tmp_path):
    """A puck that hits a wall and rebounds faster than its model: the residual is where more contacts are."""
    task = load_task(str(SLIDER.parents[1] / "puck" / "task.toml"))
    log = record(
        task=str(task.path),
        out=tmp_path / "puck.zarr",
        effects=["contact-restitution@puck=-0.6"],
        noise=1e-4,
        episodes=4,
        duration=1.0,
        rate=250,
        start={"x": (0.7, 0.8)},
        start_velocity={"x": (0.8, 1.0), "y": (-0.5, 0.5)},
        seed=1,
    ).log
    prepared = prepare(log, task, split=NewSplit("none"))
    fits = ModelFits(prepared, 1)
    as_measured = Best(task.space.nominal, np.zeros_like(prepared.initial.sd), error=0.0)
    fit = fits.at(prepared, [], as_measured)
    whole = PartFit.of(fit.at)
    curves = residual_curves(prepared, whole, whole, fits.motion(prepared, fit).contacts)
    share = {(c.output, c.against): c.share for c in curves}
    assert share["x", "number of contacts"] > 0.1
    assert share["y", "number of contacts"] < 0.05  # along the wall nothing is missing


TIED = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
<body><joint name="a" type="slide" axis="1 0 0" damping="2"/><geom size=".03" mass="1"/></body>
<body pos="0 .2 0"><joint name="b" type="slide" axis="1 0 0" damping="2"/><geom size=".03" mass="1"/></body>
</worldbody><tendon><fixed name="tie"><joint joint="a" coef="-1"/><joint joint="b" coef="1"/></fixed></tendon>
<actuator><motor name="u" joint="a" ctrlrange="-5 5"/><motor name="w" joint="b" ctrlrange="-5 5"/></actuator>
<sensor><jointpos name="a" joint="a"/><jointpos name="b" joint="b"/></sensor></mujoco>"""


def test_what_two_bodies_do_to_each_other_is_found_in_their_distance(tmp_path):
    (tmp_path / "tied.xml").write_text(TIED)
    channels = "".join(
        f'[inputs.{u}]\ncolumn = "{u}"\nunit = "N"\n[outputs.{q}]\ncolumn = "{q}"\nunit = "m"\n'
        for u, q in ("ua", "wb")
    )
    task_file = tmp_path / "task.toml"
    task_file.write_text(
        f'format = 1\nname = "tied"\nmodel = "tied.xml"\n{channels}[log]\ntime = "t"\nwindow = 0.5\n'
    )
    task = load_task(str(task_file))
    log = record(
        task=str(task_file),
        out=tmp_path / "tied.zarr",
        effects=["tendon-spring@tie=20", "tendon-spring@tie.rest=0.01"],
        noise=1e-5,
        episodes=4,
        duration=5.0,
        rate=200,
        seed=1,
    ).log
    prepared = prepare(log, task, split=NewSplit("none"))
    fits = ModelFits(prepared, 1)
    fit = fits.at(prepared, [], Best(task.space.nominal, np.zeros_like(prepared.initial.sd), error=0.0))
    whole = PartFit.of(fit.at)
    curves = residual_curves(prepared, whole, whole, fits.motion(prepared, fit).contacts)
    share = {(c.output, c.against): c.share for c in curves}
    for output, apart in (("a", "b - a"), ("b", "a - b")):
        assert share[output, apart] > 0.75
        assert max(curves, key=lambda c: c.share * (c.output == output)).against == apart


def test_silent_when_nothing_is_missing(logs, tmp_path, monkeypatch):
    monkeypatch.setattr(diagnose_stage, "_write_pages", lambda *_: None)
    document = diagnose(
        real_log=logs["plain"], task=str(SLIDER), out=tmp_path / "none", quiet=True, threads=1
    ).document
    assert document["verdict"] == "explained"
    assert document["effects"] == []


def test_an_estimate_of_another_log_is_refused(logs, tmp_path, monkeypatch):
    monkeypatch.setattr("capture_cli.stages.identify._write_pages", lambda *_: None)
    identify(real_log=logs["plain"], task=str(SLIDER), out=tmp_path / "estimate", quiet=True, starts=1)
    other = shutil.copytree(logs["friction"], tmp_path / "of today.zarr")
    with pytest.raises(OptionError, match=r"plain\.zarr") as caught:
        diagnose(real_log=other, estimate=tmp_path / "estimate", out=tmp_path / "x", quiet=True)
    assert caught.value.cure.endswith(f"capture identify --real-log '{other}'")
    assert not (tmp_path / "x").exists()


def test_what_the_estimate_held_out_stays_so(logs, tmp_path, monkeypatch):
    look_among(monkeypatch, "coulomb-friction")
    monkeypatch.setattr("capture_cli.stages.identify._write_pages", lambda *_: None)
    monkeypatch.setattr(diagnose_stage, "_write_pages", lambda *_: None)
    options = {"real_log": logs["plain"], "quiet": True, "threads": 1, "starts": 1}
    made = identify(task=str(SLIDER), out=tmp_path / "estimate", seed=5, **options)
    # as when an estimate was taken up again with more episodes: not what the seed would hold out
    held = np.isin(made.arrays["window/episode"], [1, 6])
    made.arrays["window/is_test"][:] = held
    Estimate(made.document, made.arrays, made.attributes).write(tmp_path / "estimate")
    found = diagnose(estimate=tmp_path / "estimate", out=tmp_path / "same", **options)
    assert np.array_equal(found.arrays["window/part"] == TEST, held)
    provenance = json.loads((tmp_path / "same" / "provenance.json").read_text())
    assert provenance["options"]["seed"] == 5
    shorter = diagnose(
        estimate=tmp_path / "estimate", out=tmp_path / "shorter", window=0.3, seed=7, **options
    )
    test = shorter.arrays["window/part"] == TEST
    assert set(shorter.arrays["window/episode"][test]) == {1, 6}
    assert not set(shorter.arrays["window/episode"][~test]) & {1, 6}
    provenance = json.loads((tmp_path / "shorter" / "provenance.json").read_text())
    assert provenance["options"]["seed"] == 7


def test_windows_that_all_hold_something_held_out_are_refused(logs, tmp_path, monkeypatch):
    monkeypatch.setattr("capture_cli.stages.identify._write_pages", lambda *_: None)
    options = {"real_log": logs["plain"], "quiet": True, "threads": 1, "starts": 1}
    made = identify(task=str(SLIDER), out=tmp_path / "estimate", window=0.5, **options)
    episode = made.arrays["window/episode"]
    made.arrays["window/is_test"][:] = np.append(episode[1:] != episode[:-1], True)  # the end of each
    Estimate(made.document, made.arrays, made.attributes).write(tmp_path / "estimate")
    with pytest.raises(LogError, match=r"plain\.zarr: no window is left to fit: each of the 8 ") as caught:
        diagnose(estimate=tmp_path / "estimate", out=tmp_path / "longer", window=1.5, **options)
    assert "a shorter --window" in caught.value.cure
    assert not (tmp_path / "longer").exists()


def test_an_existing_output_is_refused_before_any_work(logs, tmp_path):
    (tmp_path / "taken").mkdir()
    with pytest.raises(OutputError, match="taken"):
        diagnose(real_log=logs["plain"], task=str(SLIDER), out=tmp_path / "taken", quiet=True)


@pytest.mark.parametrize(
    ("found", "said", "hint"),
    [
        ([], "so far no effect was found", ""),
        (["coulomb-friction@x"], "so far: coulomb-friction@x", "--most-effects 1 it ends sooner"),
        (["a@x", "a@y", "b@x"], "so far: a@x, a@y, b@x", "--most-effects 2 it ends sooner"),
        (["a@x", "b@x", "c@x"], "so far: a@x, b@x, c@x", ""),
    ],
)
def test_what_was_found_is_said_where_it_is_interrupted(logs, tmp_path, monkeypatch, found, said, hint):
    def stop(prepared, nominal, settings, on_step, as_held):
        on_step("score", 0, 1, found)
        raise KeyboardInterrupt

    monkeypatch.setattr(diagnose_stage, "explain", stop)
    options = {"task": str(SLIDER), "out": tmp_path / "d", "most_effects": 3, "quiet": True}
    with pytest.raises(KeyboardInterrupt, match="nothing was written") as caught:
        diagnose(real_log=logs["plain"], **options)
    message, cure = str(caught.value).split("\n  cure: run the same command again")
    assert message.endswith(said)
    assert (hint in cure) if hint else not cure
    assert not (tmp_path / "d").exists()


def of_one_mass(x: float, residual: np.ndarray, by_mass: np.ndarray) -> Linearization:
    """At `x` of the mass's range, in three windows of 40 steps; by_mass (window, step, 1)."""
    data = Data(
        ParameterSpace([Parameter("mass", "kg", 0.0, 1.0, 0.5)]),
        np.zeros((3, 40, 1)),
        np.ones((3, 40, 1), dtype=bool),
        np.ones(1),
        np.zeros((3, 0)),
    )
    return Linearization(data, np.array([x]), np.zeros((3, 0)), residual, by_mass, np.zeros((3, 40, 0)))


@pytest.mark.parametrize(("x", "unabsorbed"), [(0.5, 0.0), (1.0, 1.0)])
def test_a_parameter_at_the_end_of_its_range_imitates_nothing_more(x, unabsorbed):
    generator = np.random.default_rng(2)
    column = generator.standard_normal((3, 40, 1))
    residual = 5 * column[..., 0] + generator.standard_normal((3, 40))  # more of it is wanted
    at = of_one_mass(x, residual, 10 * column)
    found = score(at, 10 * column, np.array([-1.0]), np.array([1.0]))
    assert found.unabsorbed == pytest.approx(unabsorbed, abs=1e-6)


def test_a_parameter_that_is_held_at_its_bound_is_held_although_the_effect_would_free_it():
    """Alone the mass wants to go beyond its bound; with the effect in, which does the same and more, back."""
    generator = np.random.default_rng(2)
    column, other = np.linalg.qr(generator.standard_normal((120, 2)))[0].T.reshape(2, 3, 40, 1)
    residual = 50 * (column + other)[..., 0]
    at = of_one_mass(1.0, residual, 500 * column)
    found = score(at, 500 * (2 * column + other), np.array([-1.0]), np.array([1.0]))
    assert found.parameters[0] < -0.05
    assert found.unabsorbed == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(
    ("without", "with_it", "verdict"), [(3.0, 1.0, "effect-found"), (1.05, 1.06, "unexplained")]
)
def test_what_does_not_show_in_held_out_data_is_not_found(without, with_it, verdict):
    lacking = [LackOfFit(n, 1.1, 1.0, np.array([n]), np.array([1.2])) for n in (2.0, 1.0)]
    mask = np.ones((4, 50), dtype=bool)
    data = Data(ParameterSpace([]), np.zeros((4, 50, 1)), mask[..., None], np.ones(1), np.zeros((4, 2)))
    residuals = [np.full((4, 50), error) for error in (without, with_it)]
    before = PartFit(data, np.zeros((4, 2)), residuals[0], *np.zeros((2, 4)))
    after = HeldOut(lack_held_out(data, residuals[1]))
    accepted = Accepted(Placed("a", None), None, [], None, share=1.0)
    assert judged_as(*lacking, before, after, [accepted]) == verdict


def test_lags_that_differ_are_told_apart_although_they_come_together(tmp_path, monkeypatch):
    look_among(monkeypatch, *ALIKE_LAGS)
    task = str(held_machine(tmp_path / "arm", "arm", 0.01))
    record(
        task=task,
        out=tmp_path / "arm.zarr",
        effects=["control-lag@shoulder=0.03", "control-lag@elbow=0.05"],
        noise=1e-3,
        episodes=3,
        duration=1.5,
        rate=100,
        seed=3,
    )
    arm = load_task(task)
    log = MeasuredLog.read(tmp_path / "arm.zarr")
    prepared = prepare(log, arm)
    settings, progress = Settings(expression=False, threads=1), Progress("diagnose", "model", quiet=True)
    document = diagnose_prepared(prepared, arm.space.nominal, settings, progress).document
    times = {e["site"]: e["parameters"]["time_constant"]["value"] for e in document["effects"]}
    assert {e["name"] for e in document["effects"]} == {"control-lag"}
    assert times == {"shoulder": pytest.approx(0.03, rel=0.1), "elbow": pytest.approx(0.05, rel=0.1)}
    assert document["verdict"] == "effect-found"


def test_what_is_left_is_told_with_where_it_is():
    found = {
        "verdict": "unexplained",
        "stages": [{"test": {"normalized": 45.1}}, {"test": {"normalized": 16.1}}],
        "effects": [{"name": "cogging", "site": "q", "tied_with": []}],
    }
    for fitted, words in (
        (24.7, "left on what was fitted is still 24.7 times"),
        (9.0, "left is still 16.1 times"),
    ):
        left = {"normalized": fitted, "threshold": 1.1, "lacking": True}
        assert words in summary(DiagnosisRecord.of(found | {"lack_of_fit": {"after": left}}))
    one = {"threshold": 1.1, "outputs": {"q": 1.0, "p": 1.5}, "output_thresholds": {"q": 1.2, "p": 1.2}}
    text = summary(
        DiagnosisRecord.of(found | {"lack_of_fit": {"after": one | {"normalized": 1.05, "lacking": True}}})
    )
    assert "(the error of p is 1.50 times the noise floor (chance allows 1.20))" in text
