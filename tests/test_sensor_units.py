"""Units that the names of columns end in."""

from __future__ import annotations

from math import pi

import pytest

from capture_cli.sim.sensor_units import unit_in_name


@pytest.mark.parametrize(
    ("column", "own", "unit", "factor"),
    [
        ("theta_deg", "rad", "deg", pi / 180),
        ("x [mm]", "m", "mm", 1e-3),
        ("v_mm_s", "m/s", "mm/s", 1e-3),
        ("v.mmps", "m/s", "mm/s", 1e-3),
        ("gyro_x (deg/s)", "rad/s", "deg/s", pi / 180),
        ("gyro_dps", "rad/s", "deg/s", pi / 180),
        ("wheel_rpm", "rad/s", "rpm", pi / 30),
        ("t_ms", "s", "ms", 1e-3),
        ("time_us", "s", "us", 1e-6),
        ("current_mA", "A", "mA", 1e-3),
        ("F_kN", "N", "kN", 1e3),
    ],
)
def test_a_unit_that_a_name_ends_in_is_read(column, own, unit, factor):
    assert unit_in_name(column, own) == (unit, pytest.approx(factor))


@pytest.mark.parametrize(
    ("column", "own"),
    [
        ("rms", "s"),
        ("param", "m"),
        ("motor_in", "m"),
        ("return_turn", "rad"),
        ("tau_Nm", "N m"),
        ("q_rad", "rad"),
        ("theta_deg", "m"),
        ("x_mm", "any unit of one's own"),
        ("damps", "rad/s"),
        ("", "m"),
    ],
)
def test_names_that_mean_no_other_unit_are_left_alone(column, own):
    assert unit_in_name(column, own) is None
