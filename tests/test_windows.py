"""A log cut into windows: nothing used twice, nothing lost, inputs and outputs at the right times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline

from capture_cli.estimate.log_windows import window_of
from capture_cli.estimate.prepare import prepare
from capture_cli.log.arrays import Log
from capture_cli.log.input_sequences import EVENLY, HELD, Hold
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.windows import SETTINGS as WINDOWS
from capture_cli.log.windows import Windows, cut, stretches
from capture_cli.model.tasks.mjcf_file import MjcfFile
from capture_cli.stages.record import record

TIMESTEP = 1 / 512  # s; this and all times are dyadic, so that sums of them are exact
TICK = TIMESTEP / 4
DURATIONS = [None, 1 / 128, 1 / 32, 1 / 8, 1.0]


HOLDS = [HELD, EVENLY, Hold(2.0), Hold(3.0), Hold(1.0, -0.003), Hold(np.inf, 0.0021)]


@st.composite
def episodes(draw) -> list[np.ndarray]:
    """Times (step,) of one to three episodes: uneven, beginning anywhere, some with a pause, some with a gap."""
    result = []
    for _ in range(draw(st.integers(1, 3))):
        ticks = draw(st.lists(st.integers(1, 16), min_size=1, max_size=80))
        for pause in draw(st.sampled_from([(), (100,), (400,), (100, 400), (400, 400)])):
            ticks.insert(draw(st.integers(0, len(ticks))), pause)
        first = draw(st.integers(-1000, 1000))
        result.append(first + TICK * np.cumsum([0, *ticks]))
    return result


def windows_of(times: list[np.ndarray], duration, hold=HELD) -> tuple[Windows, dict[str, np.ndarray]]:
    """The windows, and the log they were cut from: random inputs and outputs."""
    random = np.random.default_rng(0)
    time = np.concatenate(times)
    ends = np.cumsum([len(t) for t in times])
    log = {
        "time": time,
        "inputs": random.standard_normal((len(time), 2)),
        "outputs": random.standard_normal((len(time), 3)),
    }
    spans = [slice(b - len(t), b) for t, b in zip(times, ends, strict=True)]
    samples = Log(**log, episodes=spans)
    return cut(samples, duration, TIMESTEP, [HELD, hold]), log


def steps_of(windows: Windows) -> list[np.ndarray]:
    """The log's steps in each window."""
    return [np.arange(a, a + n) for a, n in zip(windows.first, windows.samples, strict=True)]


def whole_sequence(windows: Windows) -> np.ndarray:
    """All inputs that are known around each window, (window, lead + stop, input)."""
    tapes = windows.sequences
    return tapes.inputs(np.arange(len(windows)), -tapes.lead, tapes.stop)


def is_gap(time: np.ndarray) -> np.ndarray:
    """Which intervals of an episode are gaps, (step - 1,)."""
    if len(time) < 3:
        return np.zeros(len(time) - 1, dtype=bool)
    return np.diff(time) > WINDOWS.gap_factor * np.median(np.diff(time))


@settings(max_examples=60, deadline=None)
@given(episodes(), st.sampled_from(DURATIONS))
def test_every_sample_is_in_one_window_but_those_alone_between_gaps(times, duration):
    windows, _ = windows_of(times, duration)
    used = np.concatenate(steps_of(windows))
    assert len(set(used)) == len(used)
    alone, first = set(), 0
    for time in times:
        gap = np.concatenate([[True], is_gap(time), [True]])
        alone |= set((first + np.flatnonzero(gap[:-1] & gap[1:])).tolist())
        first += len(time)
    assert set(range(first)) - set(used.tolist()) == alone


@settings(max_examples=60, deadline=None)
@given(episodes(), st.sampled_from(DURATIONS))
def test_windows_hold_their_samples_of_one_episode_without_a_gap(times, duration):
    windows, log = windows_of(times, duration)
    ends = np.cumsum([len(t) for t in times])
    for w, steps in enumerate(steps_of(windows)):
        number = windows.episode[w]
        assert ends[number] - len(times[number]) <= steps[0] <= steps[-1] < ends[number]
        in_episode = steps - (ends[number] - len(times[number]))
        assert not is_gap(times[number])[in_episode[0] : in_episode[-1]].any()
        assert windows.time[w] == log["time"][steps[0]]
        np.testing.assert_array_equal(windows.measured[w][windows.mask[w]], log["outputs"][steps])
        np.testing.assert_array_equal(windows.mask[w], np.arange(windows.mask.shape[1]) < len(steps))


def mean_over_step(time: np.ndarray, inputs: np.ndarray, begin: float) -> np.ndarray:
    """Of inputs that are held, from `begin` on, piece by piece."""
    changes = time[(time > begin) & (time < begin + TIMESTEP)]
    edges = np.array([begin, *changes, begin + TIMESTEP])
    pieces = inputs[np.maximum(np.searchsorted(time, edges[:-1], side="right") - 1, 0)]
    return np.diff(edges) @ pieces / TIMESTEP


def known_from(windows, times, window, first) -> int:
    """The step of the log from which on there is no gap before the window that begins at its step `first`."""
    own = times[windows.episode[window]]
    begin = np.cumsum([len(t) for t in times])[windows.episode[window]] - len(own)
    before = is_gap(own)[: first - begin]
    return begin + int(np.flatnonzero(before)[-1] + 1 if before.any() else 0)


def assert_same_inputs(found, expected, hold):
    # a cubic through uneven rows is as steep as the steepest: the last digits of times are worth more
    bound = 1e-12 if hold.commands in (1.0, np.inf) else 1e-9
    np.testing.assert_allclose(found, expected, rtol=bound, atol=bound)


def inputs_at(time, inputs, begin, hold) -> list[float]:
    """Of a step from `begin` on: the first input is held, the second acts so."""
    held, at = mean_over_step(time, inputs, begin)[0], begin - hold.late
    if np.isinf(hold.commands):
        return [held, np.interp(at, time, inputs[:, 1])]
    if len(time) == 1:
        return [held, inputs[0, 1]]
    since = time - time[0]  # of late times the last digits would be lost
    rows = np.arange(hold.commands * (len(time) - 1) + 1) / hold.commands
    finer = np.interp(rows, np.arange(len(time)), since)
    commands = CubicHermiteSpline(since, inputs, np.gradient(inputs, since, axis=0))(finer)
    return [held, mean_over_step(finer, commands, at - time[0])[1]]


@settings(max_examples=60, deadline=None)
@given(episodes(), st.sampled_from(DURATIONS), st.sampled_from([h for h in HOLDS if h.late <= 0]))
def test_inputs_are_held_or_interpolated_on_the_grid(times, duration, hold):
    windows, log = windows_of(times, duration, hold)
    for w, steps in enumerate(steps_of(windows)):
        stop = np.cumsum([len(t) for t in times])[windows.episode[w]]
        known = slice(known_from(windows, times, w, steps[0]), stop)
        time, inputs = log["time"][known], log["inputs"][known]
        for g in range(windows.grid_steps[w]):
            expected = inputs_at(time, inputs, windows.time[w] + g * TIMESTEP, hold)
            assert_same_inputs(windows.controls[w, g], expected, hold)


@settings(max_examples=60, deadline=None)
@given(episodes(), st.sampled_from(DURATIONS), st.sampled_from(HOLDS))
def test_the_past_of_a_window_is_that_of_its_log_back_to_a_gap(times, duration, hold):
    windows, log = windows_of(times, duration, hold)
    lead, tape = windows.sequences.lead, whole_sequence(windows)
    for w, steps in enumerate(steps_of(windows)):
        known = known_from(windows, times, w, steps[0])
        time, inputs = log["time"][known : steps[-1] + 1], log["inputs"][known : steps[-1] + 1]
        assert windows.time[w] - time[0] <= lead * TIMESTEP
        assert windows.known_lead[w] == round((windows.time[w] - time[0]) / TIMESTEP)
        for g in range(lead):
            t = windows.time[w] - (lead - g) * TIMESTEP
            expected = inputs_at(time, inputs, t, hold)
            assert_same_inputs(tape[w, g], expected, hold)


def test_the_past_is_no_longer_than_any_actuator_remembers():
    windows, _ = windows_of([np.arange(4000) / 256], 0.5)
    assert windows.sequences.lead == WINDOWS.lead / TIMESTEP
    whole, _ = windows_of([np.arange(400) / 256], None)
    assert whole.sequences.lead == 0


def test_inputs_are_known_after_a_window_as_far_as_a_clock_may_drift():
    time = np.arange(4000) / 256
    windows, log = windows_of([time], 0.5)
    ahead = windows.sequences.stop - windows.grid
    assert ahead == np.ceil(WINDOWS.most_drift * windows.time[-1] / TIMESTEP)
    np.testing.assert_array_equal(windows.elapsed, windows.time - time[0])
    after = windows.time[0] + TIMESTEP * (windows.grid + np.arange(ahead))
    held = [mean_over_step(time, log["inputs"], t)[0] for t in after]
    np.testing.assert_allclose(whole_sequence(windows)[0, -ahead:, 0], held, rtol=1e-12)


@settings(max_examples=60, deadline=None)
@given(episodes(), st.sampled_from(DURATIONS))
def test_samples_are_interpolated_at_the_logs_times(times, duration):
    windows, log = windows_of(times, duration)
    grid = int(windows.grid_steps.max())
    row = np.tile(np.arange(len(windows)), 2)
    sensors = np.random.default_rng(1).standard_normal((len(row), grid, 3))
    sampled = windows.sample(sensors, row)
    assert sampled.shape == (len(row), windows.measured.shape[1], 3)
    for w, steps in enumerate(steps_of(windows)):
        on_grid = windows.time[w] + TIMESTEP * np.arange(grid)
        assert on_grid[windows.grid_steps[w] - 1] >= log["time"][steps[-1]]
        for output in range(3):
            simulation = len(windows) + w
            expected = np.interp(log["time"][steps], on_grid, sensors[simulation, :, output])
            found = sampled[simulation, : len(steps), output]
            np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(episodes(), st.sampled_from(DURATIONS), st.integers(-4096, 4096))
def test_when_the_clock_began_does_not_matter(times, duration, shift):
    here, _ = windows_of(times, duration, hold=EVENLY)
    there, _ = windows_of([t + shift for t in times], duration, hold=EVENLY)
    for name in ("episode", "first", "grid_steps", "controls", "index", "weight", "measured", "mask"):
        np.testing.assert_array_equal(getattr(here, name), getattr(there, name), err_msg=name)
    np.testing.assert_array_equal(here.time + shift, there.time)


@settings(max_examples=30, deadline=None)
@given(episodes(), st.sampled_from(DURATIONS), st.randoms(use_true_random=False))
def test_rows_keep_windows_and_trim_padding(times, duration, random):
    windows, _ = windows_of(times, duration)
    keep = sorted(random.sample(range(len(windows)), random.randint(1, len(windows))))
    some = windows.rows(np.array(keep))
    assert some.mask.shape[1] == windows.samples[keep].max()
    assert some.controls.shape[1] == windows.grid_steps[keep].max()
    for row, w in enumerate(keep):
        n, g = windows.samples[w], windows.grid_steps[w]
        assert (some.episode[row], some.first[row], some.time[row]) == (
            windows.episode[w],
            windows.first[w],
            windows.time[w],
        )
        assert (some.samples[row], some.grid_steps[row]) == (n, g)
        for name in ("index", "weight", "measured", "mask"):
            np.testing.assert_array_equal(getattr(some, name)[row, :n], getattr(windows, name)[w, :n])
        np.testing.assert_array_equal(some.controls[row, :g], windows.controls[w, :g])
        np.testing.assert_array_equal(
            whole_sequence(some)[row], whole_sequence(windows)[w, : whole_sequence(some).shape[1]]
        )
        assert some.elapsed[row] == windows.elapsed[w]
    by_mask = windows.rows(np.isin(np.arange(len(windows)), keep))
    np.testing.assert_array_equal(by_mask.measured, some.measured)


@pytest.mark.parametrize(
    ("samples", "in_windows"), [(384, [128] * 3), (320, [128, 192]), (460, [128, 128, 128, 76])]
)
def test_windows_of_an_even_log_last_as_long_as_asked(samples, in_windows):
    windows, _ = windows_of([np.arange(samples) / 256], 0.5)
    assert windows.samples.tolist() == in_windows


def test_times_rounded_in_a_file_stay_on_the_grid():
    """A sample that is a rounding error before a grid point gets the input of that point, and no interpolation."""
    exact = 0.002 * np.arange(500)
    log = {"inputs": np.arange(500.0)[:, None], "outputs": np.zeros((500, 1)), "episodes": [slice(0, 500)]}
    for time in (exact, np.round(exact + 7.3, 6) + 1e-9 * (-1) ** np.arange(500)):
        windows = cut(Log(time, **log), 0.25, 0.002, [HELD])
        assert windows.weight.max() < 1e-3
        for w, steps in enumerate(steps_of(windows)):
            np.testing.assert_array_equal(windows.controls[w, : len(steps), 0], steps)


def test_stretches_end_at_the_gaps_of_each_episode():
    time = np.array([0.0, 0.1, 0.2, 5.0, 5.1, 0.0, 0.1, 0.2, 9.0])
    sampled = np.ones((9, 1), dtype=bool)
    found = stretches(time, sampled, [slice(0, 5), slice(5, 9)])
    assert found == [slice(0, 3), slice(3, 5), slice(5, 8), slice(8, 9)]


def log_of(lasts: Sequence[float], rate: float, *, acts: bool = False) -> MeasuredLog:
    """Of episodes that last so long, s, at `rate` samples a second; acts: whether an action says what each does."""
    times = [np.arange(0, duration + 0.5 / rate, 1 / rate) for duration in lasts]
    none = np.zeros((sum(map(len, times)), 1))
    return MeasuredLog(
        task="machine",
        time=np.concatenate(times),
        inputs=none,
        outputs=none,
        episode_ends=np.cumsum([len(t) for t in times]),
        recording=np.zeros(len(times), dtype=int),
        input_names=("u",),
        input_units=("N",),
        output_names=("q",),
        output_units=("m",),
        recordings=({"name": "run"},),
        actions=np.zeros((len(times), 1)) if acts else None,
    )


@pytest.mark.parametrize(
    ("log", "lasts"),
    [
        (log_of([20.0], 125.0), 0.5),
        (log_of([20.0], 20.0), 2.5),  # 50 samples
        (log_of([3.0] * 12, 250.0), 0.5),
        (log_of([0.9, 2.0], 250.0), 0.5),
        (log_of([1.9] * 4, 250.0), None),  # whole episodes
        (log_of([2.9] * 8, 30.0), None),
        (log_of([20.0] * 4, 125.0, acts=True), None),
    ],
)
def test_where_no_window_is_set_long_episodes_are_cut(slider_task, log, lasts):
    task = MjcfFile(slider_task)
    assert window_of(log, task) == 0.5  # the task's
    task.log = replace(task.log, window=0.4)
    assert (window_of(log, task), window_of(log, task, 0.2)) == (0.4, 0.2)
    task.log = replace(task.log, window=None)
    assert (window_of(log, task), window_of(log, task, 0.2)) == (lasts, 0.2)


def test_what_is_held_out_says_that_windows_were_chosen(slider_task, tmp_path):
    slider_task.write_text(slider_task.read_text().replace("window = 0.5\n", ""))
    record(
        task=str(slider_task), out=tmp_path / "log.zarr", episodes=1, duration=8.0, amplitude={"drive": 5.0}
    )
    log, task = MeasuredLog.read(tmp_path / "log.zarr"), MjcfFile(slider_task)
    prepared = prepare(log, task, threads=1)
    assert len(prepared.windows) == 16
    assert prepared.split.how == "last 4 of 16 windows held out; windows of 0.5 s, for none are set"
    assert prepare(log, task, window=0.5, threads=1).split.how == "last 4 of 16 windows held out"
