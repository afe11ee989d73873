"""The steps of an encoder are found however its ticks were written down."""

from __future__ import annotations

import numpy as np
import pytest

from capture_cli.log.quantisation import distinct, grid_step, scatter_of_steps

TICK = 360 / 4096  # degrees


def ticks(seed: int = 0) -> np.ndarray:
    """What a 12-bit encoder says of a turn that goes to and fro, (sample,), in ticks."""
    time = np.linspace(0, 20, 4000)
    return np.round((30 + 40 * np.sin(time + seed)) / TICK)


def unwound(series: np.ndarray) -> np.ndarray:
    """Of a heading within 0 and 360 degrees, added up step by step, with the rounding that comes of it."""
    return np.unwrap(series % 360, period=360)


WRITTEN = {
    "exact": lambda t: t * TICK,
    "degrees, 3 digits": lambda t: np.round(t * TICK, 3),
    "a heading, 3 digits": lambda t: unwound(np.round((t * TICK) % 360, 3)),
    "rad, 4 digits": lambda t: np.round(np.deg2rad(t * TICK), 4),
    "rad, 5 digits": lambda t: np.round(np.deg2rad(t * TICK), 5),
}


@pytest.mark.parametrize("how", WRITTEN)
def test_ticks_are_found_however_they_are_written(how):
    unit = np.deg2rad(TICK) if how.startswith("rad") else TICK
    series = [WRITTEN[how](ticks(seed)) for seed in range(3)]
    assert scatter_of_steps(series) == pytest.approx(unit / np.sqrt(12), rel=0.01)


def test_few_levels_and_noise_are_no_grid():
    rng = np.random.default_rng(0)
    assert scatter_of_steps([np.repeat([0.0, 1.0], 9)]) == 0
    assert scatter_of_steps([rng.normal(size=500)]) == 0
    assert scatter_of_steps([np.repeat(rng.normal(size=50), 10)]) == 0
    assert scatter_of_steps([np.zeros(9)]) == 0


@pytest.mark.parametrize("offset", [0.1, 0.37, 0.5])  # of a tick
def test_an_encoder_may_begin_elsewhere_in_every_episode(offset):
    series = [(ticks(seed) + offset * seed) * TICK for seed in range(3)]
    assert scatter_of_steps(series) == pytest.approx(TICK / np.sqrt(12))


def test_short_episodes_show_the_steps_together():
    series = list(ticks().reshape(100, 40) * TICK)  # in which hardly any value comes twice
    assert scatter_of_steps(series) == pytest.approx(TICK / np.sqrt(12))


def test_contacts_in_every_episode_are_no_grid():
    assert scatter_of_steps([np.repeat([0.0, 1.0], 9)] * 4) == 0


@pytest.mark.parametrize("series", [[], [np.zeros(0)], [np.zeros(0), np.zeros(0)]])
def test_without_samples_there_are_no_steps(series):
    assert scatter_of_steps(series) == 0


def test_an_episode_without_samples_says_nothing_about_the_others():
    assert scatter_of_steps([ticks() * TICK, np.zeros(0)]) == pytest.approx(TICK / np.sqrt(12))


@pytest.mark.parametrize(("levels", "step"), [(900_000, 1e-3), (1_200_000, None)])
def test_a_grid_is_told_from_rounding_to_a_millionth_of_the_range(levels, step):
    assert grid_step(distinct(np.arange(levels) * 1e-3)) == (step and pytest.approx(step))
