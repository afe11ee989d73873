"""Smoothing splines: their noise and derivatives are those of a known series, and forces pass the same filter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_array

from capture_cli.estimate.balance.smoothing import FEWEST, smooth
from capture_cli.estimate.balance.smoothing import SETTINGS as SMOOTHING

RATE, NOISE = 250.0, 1e-3  # Hz; sd of the samples
FREQUENCIES = (0.7, 1.9)  # Hz


def truth(time: np.ndarray, derivative: int = 0) -> np.ndarray:
    """A sum of sines, or a derivative of it."""
    turns = [2 * np.pi * f for f in FREQUENCIES]
    return (
        sum(w**derivative * np.sin(w * time + derivative * np.pi / 2 + k) for k, w in enumerate(turns)) / 10
    )


def clocks(seed: int, uneven: bool = False, stretches: int = 4, samples: int = 500) -> list[np.ndarray]:
    generator = np.random.default_rng(seed)
    found = []
    for number in range(stretches):
        shares = generator.uniform(0.3, 1.7, samples) if uneven else np.ones(samples)
        found.append(10.0 * number + np.cumsum(shares) / RATE)
    return found


def noisy(times, seed: int, noise: float = NOISE) -> list[np.ndarray]:
    generator = np.random.default_rng(seed)
    return [truth(t) + noise * generator.standard_normal(len(t)) for t in times]


def integrated_white_jerk(time: np.ndarray, generator: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Position, velocity and acceleration, (sample,) each, between which a finer grid is integrated exactly."""
    finer, step = 10, (time[1] - time[0]) / 10
    jerk = 100 * generator.standard_normal(finer * len(time)) / np.sqrt(step)
    position, velocity, acceleration = np.zeros((3, len(jerk)))
    for k in range(1, len(jerk)):
        j, a, v = jerk[k], acceleration[k - 1], velocity[k - 1]
        position[k] = position[k - 1] + step * (v + step * (a / 2 + step * j / 6))
        velocity[k] = v + step * (a + step * j / 2)
        acceleration[k] = a + step * j
    return position[::finer], velocity[::finer], acceleration[::finer]


def inner(time: np.ndarray) -> np.ndarray:
    """Those of samples (sample,) whose derivatives do not feel the ends."""
    return time[60:-60]


@pytest.mark.parametrize("noise", [1e-5, 1e-3, 3e-2])
@pytest.mark.parametrize("uneven", [False, True])
def test_likelihood_finds_the_noise(noise, uneven):
    times = clocks(0, uneven)
    series = smooth(times, noisy(times, 1, noise))
    assert series[0].sd == pytest.approx(noise, rel=0.05)  # 2000 samples tell it within 1.6 %
    assert len({s.sd for s in series}) == 1


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("derivative", [0, 1, 2])
def test_derivatives_of_sines_are_within_what_they_say(derivative, uneven):
    errors = []
    for seed in range(5):
        times = clocks(seed, uneven)
        for series, time in zip(smooth(times, noisy(times, seed)), times, strict=True):
            at = inner(time)
            errors.append((series.at(at, derivative) - truth(at, derivative)) / series.sd_of(derivative))
    # sines are smoother than the prior, whose jerk is white: they are known better than it says
    assert 0.3 < np.sqrt(np.mean(np.square(errors))) < 1.1


@pytest.mark.parametrize("derivative", [0, 1, 2])
def test_derivatives_of_what_the_prior_says_are_as_far_off_as_they_say(derivative):
    errors = []
    for seed in range(5):
        times = clocks(seed)
        generator = np.random.default_rng(seed)
        moved = [integrated_white_jerk(t, generator) for t in times]
        values = [m[0] + NOISE * generator.standard_normal(len(m[0])) for m in moved]
        for series, time, motion in zip(smooth(times, values), times, moved, strict=True):
            error = series.at(time, derivative) - motion[derivative]
            errors.append(inner(error) / series.sd_of(derivative))
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(1.0, abs=0.12)


def test_a_parabola_is_its_own_fit_whatever_the_noise():
    times = clocks(2, uneven=True, stretches=2)
    parabolas = [1 - 3 * (t - t[0]) + 2 * (t - t[0]) ** 2 for t in times]
    generator = np.random.default_rng(3)
    series = smooth(times, [p + 0.1 * generator.standard_normal(len(p)) for p in parabolas])
    for one, time in zip(series, times, strict=True):
        assert one.at(time, 2) == pytest.approx(4.0, abs=0.6)  # 0.1 over 2 s of 500 samples: sd 0.09


@pytest.mark.parametrize("every", [1, 3])
def test_polynomials_that_cost_nothing_pass_the_filter(every):
    (time,) = clocks(4, stretches=1, samples=301)
    (series,) = smooth([time], noisy([time], 5, 1e-2))
    at = time[::every]
    columns = np.stack([(at - at[0]) ** k for k in range(SMOOTHING.order + 1)], axis=1)
    passed = series.filtered(columns, at)
    np.testing.assert_allclose(passed[:, : SMOOTHING.order], columns[:, : SMOOTHING.order], rtol=0, atol=1e-6)
    assert (
        np.abs(passed[:, SMOOTHING.order] - columns[:, SMOOTHING.order]).max() > 1e-6
    )  # what costs something does not


def test_the_filter_is_what_the_samples_went_through():
    (time,) = clocks(6, uneven=True, stretches=1)
    (values,) = noisy([time], 7)
    (series,) = smooth([time], [values])
    np.testing.assert_allclose(series.filtered(values[:, None], time)[:, 0], series.at(time), atol=1e-9)


@pytest.mark.parametrize("every", [1, 4])
def test_sums_of_filtered_series_are_filtered_sums(every):
    (time,) = clocks(8, stretches=1)
    (series,) = smooth([time], noisy([time], 9))
    at = time[::every]
    generator = np.random.default_rng(10)
    rows, columns = generator.standard_normal((7, len(at))), generator.standard_normal((len(at), 3))
    np.testing.assert_allclose(
        series.filtering(csr_array(rows), at) @ columns, rows @ series.filtered(columns, at), atol=1e-4
    )


def test_half_of_a_sine_is_left_at_the_cutoff():
    (time,) = clocks(11, stretches=1)
    (series,) = smooth([time], noisy([time], 12, 1e-2))
    for times_the_cutoff, left in ((0.4, 1.0), (1.0, 0.5), (2.5, 0.0)):
        sine = np.sin(times_the_cutoff * series.cutoff * time)
        passed = series.filtered(sine[:, None], time)[:, 0]
        share = inner(passed) @ inner(sine) / (inner(sine) @ inner(sine))
        assert share == pytest.approx(left, abs=0.03)


@pytest.mark.parametrize("derivative", [1, 2])
def test_responses_are_what_a_sample_adds(derivative):
    (time,) = clocks(13, stretches=1, samples=200)
    (values,) = noisy([time], 14)
    (series,) = smooth([time], [values])
    rows = np.random.default_rng(15).standard_normal((2, len(time)))
    response = series.response(csr_array(rows), time, derivative)
    # smoothing is linear in the samples: all of them together make the derivative
    np.testing.assert_allclose(response @ values, rows @ series.at(time, derivative), rtol=1e-6)


def test_sums_over_short_times_are_filtered_and_answer_as_in_the_whole_series():
    """What lies far from a sum is left out: it adds less than the last digits."""
    (time,) = clocks(13, stretches=1, samples=3000)
    (series,) = smooth([time], noisy([time], 14))
    rows = np.zeros((2, len(time)))
    rows[0, 1000:1010], rows[1, 1020:1040] = 0.1, 0.05
    every = np.vstack([rows, np.full((1, len(time)), 1e-12)])  # reaches all of it
    column = np.random.default_rng(15).standard_normal((len(time), 1))
    near = series.filtering(csr_array(rows), time) @ column
    np.testing.assert_allclose(near, rows @ series.filtered(column, time), rtol=1e-5)
    for derivative in range(3):
        short, long = (series.response(csr_array(r), time, derivative)[:2] for r in (rows, every))
        assert short.shape[1] < long.shape[1]
        np.testing.assert_allclose(short @ short.T, long @ long.T, rtol=1e-7)


def test_beyond_its_ends_a_series_is_held():
    (time,) = clocks(16, stretches=1)
    (series,) = smooth([time], noisy([time], 17))
    ends = series.at(np.array([time[0] - 1, time[-1] + 1]), 1)
    np.testing.assert_array_equal(ends, series.at(time[[0, -1]], 1))


@pytest.mark.parametrize("samples", [FEWEST, FEWEST + 1])
def test_the_shortest_stretch_can_be_smoothed(samples):
    times = clocks(18, stretches=1, samples=samples)
    (series,) = smooth(times, noisy(times, 19))
    assert np.isfinite([series.sd, series.cutoff, series.sd_of(2)]).all()
    np.testing.assert_allclose(series.at(times[0]), truth(times[0]), atol=5 * NOISE)


def test_a_stretch_of_fewer_samples_than_turns_is_hardly_smoothed():
    time = np.arange(10) * 0.01
    (series,) = smooth([time], noisy([time], 5, 1e-2), fewest_turns=12.0)
    assert series.cutoff > np.pi / 0.01
