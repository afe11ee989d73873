"""Units of columns: how many of a sensor's own there are in one, and which the names of columns end in."""

from __future__ import annotations

from itertools import permutations, product
from math import pi

import pytest

from capture_cli.errors import TaskError
from capture_cli.model.sensor_units import factor_between, refuse_period_in_other_unit, unit_in_name

TIMES = {
    **{"s": 1, "sec": 1, "second": 1, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    **{"min": 60, "minute": 60, "h": 3600, "hr": 3600, "hour": 3600},
}
LENGTHS = {
    "m": 1,
    "nm": 1e-9,
    "um": 1e-6,
    "µm": 1e-6,
    "mm": 1e-3,
    "cm": 1e-2,
    "km": 1e3,
    "in": 0.0254,
    "ft": 0.3048,
}
ANGLES = {
    **{"rad": 1, "urad": 1e-6, "mrad": 1e-3},
    **{name: pi / 180 for name in ("deg", "degs", "degree", "Degrees", "°")},
    **{name: 2 * pi for name in ("rev", "revolutions", "turn")},
}
FORCES = {
    "N": 1,
    "mN": 1e-3,
    "daN": 10,
    "kN": 1e3,
    "MN": 1e6,
    "gf": 9.80665e-3,
    "kgf": 9.80665,
    "lbf": 4.4482216153,
}
OF_ONE_KIND = {"s": TIMES, "m": LENGTHS, "rad": ANGLES, "N": FORCES, "A": {"mA": 1e-3}, "V": {"mV": 1e-3}}
SOME = {  # of every dimension
    **{own: list(units) for own, units in OF_ONE_KIND.items()},
    "m/s": ["mm/s", "m/min", "ft/hr", "kph", "km/h", "ms^-1"],
    "rad/s": ["deg/s", "deg/ms", "deg/minute", "deg/hr", "rpm", "rps", "dps", "rev/min"],
    "m/s^2": ["g", "mg", "mm/s^2", "cm/s/s", "ms^-2"],
    "rad/s^2": ["deg/s^2", "rpm/s", "deg/s/s"],
    "N m": ["mN m", "Nm", "N mm", "kgf cm", "lbfin"],
}


@pytest.mark.parametrize("own", OF_ONE_KIND)
def test_a_unit_of_one_kind_is_so_many_of_the_own(own):
    for unit, size in OF_ONE_KIND[own].items():
        assert factor_between(unit, own, "here") == pytest.approx(size, rel=1e-12), unit


@pytest.mark.parametrize(("own", "units"), [("m", LENGTHS), ("rad", ANGLES)])
def test_the_factor_of_a_rate_is_that_of_the_one_over_that_of_the_other(own, units):
    for (unit, size), (time, duration) in product(units.items(), TIMES.items()):
        rate, twice = pytest.approx(size / duration, rel=1e-12), pytest.approx(size / duration**2, rel=1e-12)
        for written in (f"{unit}/{time}", f"{unit} / {time}", f"{unit} per {time}", f"{unit} {time}^-1"):
            assert factor_between(written, f"{own}/s", "here") == rate, written
        for written in (f"{unit}/{time}^2", f"{unit}/{time}²", f"{unit}/{time}/{time}", f"{unit} {time}⁻²"):
            assert factor_between(written, f"{own}/s^2", "here") == twice, written
        assert factor_between(f"{unit}/{time}", f"{unit}/s", "here") == pytest.approx(1 / duration, rel=1e-12)


def test_the_factor_of_a_torque_is_that_of_the_force_times_that_of_the_length():
    for (force, newtons), (length, metres) in product(FORCES.items(), LENGTHS.items()):
        for written in (f"{force} {length}", f"{force}·{length}", f"{force}*{length}", force + length):
            assert factor_between(written, "N m", "here") == pytest.approx(newtons * metres, rel=1e-12), (
                written
            )


@pytest.mark.parametrize(
    ("unit", "own", "factor"),
    [
        ("deg/hr", "rad/s", pi / 180 / 3600),
        ("rpm", "rad/s", pi / 30),
        ("RPM", "deg/s", 6),
        ("mph", "km/h", 1.609344),
        ("g", "m/s^2", 9.80665),
        ("mms^-1", "m/s", 1e-3),
        ("degs^-1", "rad/s", pi / 180),
        ("DEG/MIN", "rad/s", pi / 180 / 60),
        ("A", "A", 1),
        ("ticks", "ticks", 1),
    ],
)
def test_units_written_otherwise(unit, own, factor):
    assert factor_between(unit, own, "here") == pytest.approx(factor, rel=1e-12)


@pytest.mark.parametrize(("own", "other"), list(permutations(SOME, 2)))
def test_a_unit_of_another_dimension_is_refused(own, other):
    for written in (other, *SOME[other]):
        with pytest.raises(TaskError, match=r"outputs\.q: .* is no unit of what") as caught:
            factor_between(written, own, "outputs.q")
        assert caught.value.cure.startswith(f"write one of {own}")


@pytest.mark.parametrize("unit", ["deg/√h", "degrees/week", "deg/", "/s", "0.1 deg/s", "", "degC/s"])
def test_what_is_no_unit_is_refused(unit):
    with pytest.raises(TaskError, match="is no unit of what unit = 'rad/s' measures"):
        factor_between(unit, "rad/s", "outputs.q")


@pytest.mark.parametrize(
    ("column", "own", "unit", "factor"),
    [
        ("theta_deg", "rad", "deg", pi / 180),
        ("x [mm]", "m", "mm", 1e-3),
        ("v_mm_s", "m/s", "mm/s", 1e-3),
        ("v.mmps", "m/s", "mm/s", 1e-3),
        ("gyro_x (deg/s)", "rad/s", "deg/s", pi / 180),
        ("gyro_dps", "rad/s", "deg/s", pi / 180),
        ("gyro (deg/hr)", "rad/s", "deg/hr", pi / 180 / 3600),
        ("v_mm_per_min", "m/s", "mm/min", 1e-3 / 60),
        ("wheel_rpm", "rad/s", "rpm", pi / 30),
        ("t_ms", "s", "ms", 1e-3),
        ("time_us", "s", "us", 1e-6),
        ("current_mA", "A", "mA", 1e-3),
        ("F_kN", "N", "kN", 1e3),
        ("trq_mNm", "N m", "mNm", 1e-3),
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
        ("theta_deg", "rad/s"),
        ("theta_deg_min", "rad/s"),
        ("theta_deg", "degrees"),
        ("x_mm", "any unit of one's own"),
        ("damps", "rad/s"),
        ("", "m"),
    ],
)
def test_names_that_mean_no_other_unit_are_left_alone(column, own):
    assert unit_in_name(column, own) is None


@pytest.mark.parametrize(
    ("period", "unit", "scale", "whole"),
    [
        (6.2832, "rad", pi / 180, "360"),
        (6.28, "rad", -0.0174533, "360"),
        (360.0, "rad", 1.0, "6.28319"),
        (2 * pi, "rad", 2 * pi, "1"),
        (360.0, "deg", 1.0, None),
        (360.0, "rad", pi / 180, None),
        (2 * pi, "rad", -1.0, None),
        (4096.0, "rad", 2 * pi / 4096, None),
        (360.0, "rad", 2 * pi / 4096, None),  # of counts, whatever they are
        (5760.0, "rad", pi / 180, None),  # an encoder of sixteen turns
        (360.0, "m", 1.0, None),
    ],
)
def test_a_period_is_a_turn_in_the_unit_of_the_column(period, unit, scale, whole):
    if whole is None:
        return refuse_period_in_other_unit(period, unit, scale, "here")
    with pytest.raises(TaskError, match=f"here: period = {period:g} ") as refused:
        refuse_period_in_other_unit(period, unit, scale, "here")
    assert refused.value.cure.startswith(f"write period = {whole};")
