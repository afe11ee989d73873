"""Units of logs beside those of a model: MuJoCo's sensors report m, rad, s, N and N m, without a prefix."""

import math
import re
from collections.abc import Mapping
from itertools import product
from typing import Any, NamedTuple, Self

import mujoco

from capture_cli.common.frozen import frozen
from capture_cli.errors import TaskError

_S = mujoco.mjtSensor
_HINGE, _SLIDE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
_TURN = 2 * math.pi
_TURNS = {"rad": _TURN, "deg": 360.0, "turns": 1.0}  # a whole turn, as it may be written


@frozen
class SETTINGS:
    rounded: float = 0.01  # of 6.28 for a turn, or 0.0175 for a degree
    gravity: float = 9.80665  # m/s^2


# How many of the first there are in one of each
_SIZES: dict[str, dict[str, float]] = {
    "m": {
        **{"m": 1.0, "nm": 1e-9, "um": 1e-6, "mm": 1e-3, "cm": 1e-2, "dm": 0.1, "km": 1e3},
        **{"in": 0.0254, "ft": 0.3048},
    },
    "rad": {
        **{"rad": 1.0, "urad": 1e-6, "mrad": 1e-3},
        **{name: _TURN / 360 for name in ("deg", "degs", "degree", "degrees", "°")},
        **{name: _TURN for name in ("rev", "revs", "revolution", "revolutions", "turn", "turns")},
    },
    "s": {
        **{"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
        **{name: 1.0 for name in ("sec", "secs", "second", "seconds")},
        **{name: 60.0 for name in ("min", "mins", "minute", "minutes")},
        **{name: 3600.0 for name in ("h", "hr", "hrs", "hour", "hours")},
    },
    "N": {
        **{"N": 1.0, "uN": 1e-6, "mN": 1e-3, "cN": 1e-2, "daN": 10.0, "kN": 1e3, "MN": 1e6},
        **{
            "gf": 1e-3 * SETTINGS.gravity,
            "kgf": SETTINGS.gravity,
            "kp": SETTINGS.gravity,
            "lbf": 4.4482216153,
        },
    },
    "A": {"A": 1.0, "mA": 1e-3},
    "V": {"V": 1.0, "mV": 1e-3},
}


class _Unit(NamedTuple):
    """How many SI units there are in one, and its dimension: the powers of the keys of _SIZES, in their order."""

    factor: float
    powers: tuple[int, ...]

    @classmethod
    def of(cls, factor: float, **powers: int) -> Self:
        return cls(factor, tuple(powers.get(base, 0) for base in _SIZES))

    def times(self, other: Self, power: int) -> Self:
        powers = (a + power * b for a, b in zip(self.powers, other.powers, strict=True))
        return _Unit(self.factor * other.factor**power, tuple(powers))

    @property
    def turns(self) -> bool:
        """Whether it is one of angles, or of these per time."""
        return self.powers[[*_SIZES].index("rad")] != 0


_SHORT = {
    "g": _Unit.of(SETTINGS.gravity, m=1, s=-2),
    "mg": _Unit.of(1e-3 * SETTINGS.gravity, m=1, s=-2),
    "kph": _Unit.of(1 / 3.6, m=1, s=-1),
    "mph": _Unit.of(0.44704, m=1, s=-1),
    "rpm": _Unit.of(_TURN / 60, rad=1, s=-1),
    "rps": _Unit.of(_TURN, rad=1, s=-1),
    "dps": _Unit.of(_TURN / 360, rad=1, s=-1),
}
_NAMED = _SHORT | {
    name: _Unit.of(size, **{base: 1}) for base, sizes in _SIZES.items() for name, size in sizes.items()
}
_WORD = re.compile(r"([a-zA-Z°]+)(?:\^?([+-]?\d))?")  # m, s^-2, s2
_SIGNS = str.maketrans({**dict(zip("⁻¹²³µμ−", "-123uu-", strict=True)), **dict.fromkeys("·⋅*.", " ")})
_OF_SENSORS = {
    "m": (_S.mjSENS_FRAMEPOS, _S.mjSENS_SUBTREECOM, _S.mjSENS_RANGEFINDER, _S.mjSENS_GEOMDIST),
    "m/s": (_S.mjSENS_FRAMELINVEL, _S.mjSENS_VELOCIMETER, _S.mjSENS_SUBTREELINVEL),
    "rad/s": (_S.mjSENS_FRAMEANGVEL, _S.mjSENS_GYRO, _S.mjSENS_BALLANGVEL),
    "m/s^2": (_S.mjSENS_FRAMELINACC, _S.mjSENS_ACCELEROMETER),
    "rad/s^2": (_S.mjSENS_FRAMEANGACC,),
    "N": (_S.mjSENS_FORCE, _S.mjSENS_TOUCH),
    "N m": (_S.mjSENS_TORQUE,),
}
_OF_JOINTS = {
    _S.mjSENS_JOINTPOS: {_HINGE: "rad", _SLIDE: "m"},
    _S.mjSENS_JOINTVEL: {_HINGE: "rad/s", _SLIDE: "m/s"},
    _S.mjSENS_JOINTACTFRC: {_HINGE: "N m", _SLIDE: "N"},
}
# Endings of names that mean a unit, and nothing else as in, g or turn do, and Nm, which is N m as well
_IN_NAMES = re.compile(
    r"(?:^|[^a-zA-Z])(?:(?P<short>dps|rpm|rps|kph|mph|kN|mNm|m[AV]|[mun]s)"
    r"|(?P<of>[um]rad|deg|degs|degrees?|[umck]m)"
    r"(?:(?:/|_per_)(?P<time>ms|s|sec|min|minute|h|hr|hour)|(?P<second>[p_]s))?)\W*$"
)


def refuse_other_units(
    entry: Mapping[str, Any], unit: str, model: mujoco.MjModel, sensor: int, where: str
) -> None:
    """Raise TaskError where `unit` is another form of what the sensor reports, as mrad, deg or rpm are, or, of what
    turns, per another power of time, as deg where it reports rad/s.

    Nothing is said of words that are no units, nor of other dimensions: a joint that slides may stand for anything. Nor
    of sensors whose unit depends on what drives or measures: actuators, tendons and the user's own. entry: the output's
    table; where: its place, for the error.
    """
    own = reported_unit(model, sensor)
    written = _readings(unit)
    if own is None or not written:
        return
    factor = _ratio(unit, own)
    if factor is None and written[0].turns and _readings(own)[0].turns:
        raise TaskError(
            f"{where}: unit = {unit!r}, and the sensor reports {own}, which measures something else",
            cure=f'write unit = "{own}" if the column has that, or name a sensor that reports {unit.strip()}',
        )
    if factor is None or factor == 1:
        return
    scale = entry.get("scale", 1.0)
    raise TaskError(
        f"{where}: unit = {unit!r} with scale = {scale}, and the sensor reports {own}: what the log has is compared "
        "with that as it is after `scale`",
        cure=f'write unit = "{own}"; and if the column is in {unit.strip()}, column_unit = "{unit.strip()}"',
    )


def factor_between(written: str, own: str, where: str) -> float:
    """How many of the unit `own` there are in one `written`: 1e-3 for mm and m, 1 / 60 for deg/min and deg/s.

    Raises TaskError, with `where`, if one is no unit of what the other measures, or `own` is no unit known here.
    """
    if _plain(written) == _plain(own):
        return 1.0
    if not _readings(own):
        raise TaskError(
            f"{where}: column_unit = {written!r}, and no other units are known of unit = {own!r}",
            cure="give the factor between them instead: scale = ...",
        )
    factor = _ratio(written, own)
    if factor is None:
        raise TaskError(
            f"{where}: column_unit = {written!r} is no unit of what unit = {own!r} measures",
            cure=f"write one of {', '.join(_forms(own))}, or the factor between them: scale = ...",
        )
    return factor


def refuse_period_in_other_unit(period: float, unit: str, scale: float, where: str) -> None:
    """Raise TaskError where `period` is a whole turn in another unit than the column's, as 6.28 is of one in degrees:
    by it every step of the column would be taken for the next turn, or none.

    unit: the output's. scale: how many of it there are in one of the column's.
    """
    turn = _ratio("turn", unit)
    own = None if turn is None else _turn_written(turn / abs(scale))
    written = _turn_written(period)
    if own is None or written is None or own == written:
        return
    raise TaskError(
        f"{where}: period = {period:g} is a whole turn in {written}, and the column is read in {own}, in which it is "
        f"{_TURNS[own]:.6g}: the period is in the column's own unit",
        cure=f"write period = {_TURNS[own]:.6g}; or, if the column is in {written}, correct its column_unit or scale",
    )


def _turn_written(size: float) -> str | None:
    """The unit in which a whole turn is `size`; None where it is so in none of these."""
    return next((u for u, turn in _TURNS.items() if math.isclose(size, turn, rel_tol=SETTINGS.rounded)), None)


def unit_in_name(column: str, own: str) -> tuple[str, float] | None:
    """The unit that a column's name ends in, as that of theta_deg does, and how many `own` there are in one; None where
    it ends in none that is another form of it.
    """
    found = _IN_NAMES.search(column.strip())
    if found is None:
        return None
    unit = (found["short"] or found["of"]).replace("dps", "deg/s")
    if found["time"] or found["second"]:
        unit = f"{unit}/{found['time'] or 's'}"
    factor = _ratio(unit, own)
    return None if factor in (None, 1.0) else (unit, factor)


def reported_unit(model: mujoco.MjModel, sensor: int) -> str | None:
    """The unit of a sensor; None where its kind alone does not say it."""
    kind = int(model.sensor_type[sensor])
    for of, by_joint in _OF_JOINTS.items():
        if kind == int(of):
            joint = int(model.jnt_type[model.sensor_objid[sensor]])
            return next((unit for j, unit in by_joint.items() if int(j) == joint), None)
    return next((unit for unit, kinds in _OF_SENSORS.items() if kind in map(int, kinds)), None)


def _ratio(unit: str, own: str) -> float | None:
    """How many `own` there are in one `unit`; None where they are no units of the same dimension."""
    for one, other in product(_readings(unit), _readings(own)):
        if one.powers == other.powers:
            return one.factor / other.factor
    return None


def _readings(unit: str) -> list[_Unit]:
    """What `unit` may mean, the likeliest first; empty where it is no unit known here.

    A product of words with powers, and after each "/" of those that it is divided by.
    """
    readings = [_Unit.of(1.0)]
    for number, part in enumerate(_plain(unit).split("/")):
        for word in part.split() or [""]:
            found = _WORD.fullmatch(word)
            if found is None:
                return []
            meant = _meant(found[1], int(found[2] or 1))
            readings = [r.times(m, -1 if number else 1) for r, m in product(readings, meant)]
    return readings


def _meant(word: str, power: int) -> list[_Unit]:
    """What a word to a `power` may mean: one unit, or two without a blank, the longer one first, as in Nm and ms^-2.

    But mN is no m N: of what is one unit two are made only where there is a power.
    """
    one = _known(word)
    meant = [] if one is None else [_Unit.of(1.0).times(one, power)]
    if one is not None and power == 1:
        return meant
    for length in range(len(word) - 1, 0, -1):
        left, right = _known(word[:length]), _known(word[length:])
        if left is not None and right is not None:
            meant.append(left.times(right, power))
    return meant


def _known(name: str) -> _Unit | None:
    """The unit of this name, in lower case if not as it is: MM, RPM. But Nm is no nm."""
    return _NAMED.get(name) or (None if name.lower() == "nm" else _NAMED.get(name.lower()))


def _forms(own: str) -> list[str]:
    """Some units of what `own` measures, itself first, each under one name."""
    first, rest = re.fullmatch(r"([a-zA-Z°]+)(.*)", _plain(own)).groups()
    short = [name for name, unit in _SHORT.items() if unit.powers == _readings(own)[0].powers]
    sizes = next((sizes for sizes in _SIZES.values() if first in sizes), {})
    same_size = [name for name, size in sizes.items() if name == next(n for n in sizes if sizes[n] == size)]
    return list(dict.fromkeys([own, *short, *(name + rest for name in same_size)]))


def _plain(unit: str) -> str:
    """A unit as it is parsed: "/" for per, u for micro, powers as 2 and -1 or after ^, blanks for dots and *."""
    text = unit.replace("**", "^").translate(_SIGNS)
    text = re.sub(r"[\s_]per[\s_]", "/", text)
    return " ".join(text.split())
