"""Units of logs beside those of a model: MuJoCo's sensors report m, rad, s, N and N m, without a prefix."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

import mujoco

from capture_cli.errors import TaskError

_S = mujoco.mjtSensor
_HINGE, _SLIDE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
_PER_TIME = {"/s": 1.0, "/min": 1 / 60, "/h": 1 / 3600}
# How many of the sensor's own unit there are in one of these, without blanks
_LENGTHS = {"nm": 1e-9, "um": 1e-6, "mm": 1e-3, "cm": 1e-2, "dm": 0.1, "km": 1e3, "in": 0.0254, "ft": 0.3048}
_TURN = 2 * math.pi
_ANGLES = {
    **{"urad": 1e-6, "mrad": 1e-3},
    **{name: _TURN / 360 for name in ("deg", "degs", "degree", "degrees", "°")},
    **{name: _TURN for name in ("rev", "revs", "revolution", "revolutions", "turn", "turns")},
}
_FORCES = {"uN": 1e-6, "mN": 1e-3, "cN": 1e-2, "daN": 10.0, "kN": 1e3, "MN": 1e6}
_WEIGHTS = {"gf": 9.80665e-3, "kgf": 9.80665, "kp": 9.80665, "lbf": 4.4482216153}


def _speeds(own: str, lengths: Mapping[str, float]) -> dict[str, float]:
    """Lengths or angles, and their `own` unit, per second, minute and hour."""
    per_time = {f"{n}{t}": f * s for n, f in {own: 1.0, **lengths}.items() for t, s in _PER_TIME.items()}
    return {name: factor for name, factor in per_time.items() if name != f"{own}/s"}


def _accelerations(lengths: Mapping[str, float]) -> dict[str, float]:
    return {f"{name}/s^2": factor for name, factor in lengths.items()}


_FORMS: dict[str, dict[str, float]] = {
    "m": _LENGTHS,
    "rad": _ANGLES,
    "m/s": _speeds("m", _LENGTHS) | {"kph": 1 / 3.6, "mph": 0.44704},
    "rad/s": _speeds("rad", _ANGLES) | {"rpm": _TURN / 60, "rps": _TURN},
    "m/s^2": _accelerations(_LENGTHS) | {"g": 9.80665, "mg": 9.80665e-3},
    "rad/s^2": _accelerations(_ANGLES),
    "N": _FORCES | _WEIGHTS,
    "N m": {
        **{f"{force}m": factor for force, factor in (_FORCES | _WEIGHTS).items()},
        **{
            f"{force}{length}": factor * _LENGTHS[length]
            for force, factor in ({"N": 1.0} | _FORCES | _WEIGHTS).items()
            for length in ("mm", "cm", "in", "ft")
        },
    },
    "A": {"mA": 1e-3},
    "V": {"mV": 1e-3},
    "s": {"ms": 1e-3, "us": 1e-6, "ns": 1e-9},
}
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
    r"(?:^|[^a-zA-Z])((?:[um]rad|deg|degs|degrees?|[umck]m)(?:(?:/|_per_|p|_)s|ps)?|dps|rpm|rps|kph|mph|kN|m[AV]|[mun]s)\W*$"
)
_DEGREES = re.compile(r"(deg(ree)?s?|°)(?![a-z])")


def refuse_other_units(
    entry: Mapping[str, Any], unit: str, model: mujoco.MjModel, sensor: int, where: str
) -> None:
    """Raise TaskError where `unit` is another form of what the sensor reports, as mrad, deg or rpm are.

    Nothing is said of words that are no units, nor of sensors whose unit depends on what drives or measures: actuators,
    tendons and the user's own. entry: the output's table; where: its place, for the error.
    """
    own = _reported(model, sensor)
    if own is None or _factor(unit, own) is None:
        return
    scale = entry.get("scale", 1.0)
    raise TaskError(
        f"{where}: unit = {unit!r} with scale = {scale}, and the sensor reports {own}: what the log has is compared "
        "with that as it is after `scale`",
        cure=f'write unit = "{own}"; and if the column is in {unit.strip()}, column_unit = "{unit.strip()}"',
    )


def factor_between(written: str, own: str, where: str) -> float:
    """How many of the unit `own` there are in one `written`: 1e-3 for mm and m.

    Raises TaskError, with `where`, if one is no form of the other, or `own` is none of the units that have others.
    """
    if _plain(written) == _plain(own):
        return 1.0
    base = next((unit for unit in _FORMS if _plain(unit) == _plain(own)), None)
    if base is None:
        raise TaskError(
            f"{where}: column_unit = {written!r}, and no other units are known of unit = {own!r}",
            cure="give the factor between them instead: scale = ...",
        )
    factor = _factor(written, base)
    if factor is None:
        raise TaskError(
            f"{where}: column_unit = {written!r} is no unit of what unit = {own!r} measures",
            cure=f"write one of {', '.join([base, *_FORMS[base]][:12])}, or the factor between them: scale = ...",
        )
    return factor


def unit_in_name(column: str, own: str) -> tuple[str, float] | None:
    """The unit that a column's name ends in, as that of theta_deg does, and how many `own` there are in one; None where
    it ends in none that is another form of it.
    """
    found = _IN_NAMES.search(column.strip())
    forms = _FORMS.get(own)
    if found is None or forms is None:
        return None
    written = found[1].replace("dps", "deg/s")
    per_second = re.fullmatch(r"(.*?)(?:/|_per_|_|p)s", written)
    unit = f"{per_second[1]}/s" if per_second and per_second[1] in (*_LENGTHS, *_ANGLES) else written
    return (unit, forms[unit]) if unit in forms else None


def _reported(model: mujoco.MjModel, sensor: int) -> str | None:
    """The unit of a sensor; None where its kind alone does not say it."""
    kind = int(model.sensor_type[sensor])
    for of, by_joint in _OF_JOINTS.items():
        if kind == int(of):
            joint = int(model.jnt_type[model.sensor_objid[sensor]])
            return next((unit for j, unit in by_joint.items() if int(j) == joint), None)
    return next((unit for unit, kinds in _OF_SENSORS.items() if kind in map(int, kinds)), None)


def _factor(unit: str, own: str) -> float | None:
    """How many `own` there are in one `unit`; None where that is no other form of it."""
    written, forms = _plain(unit), _FORMS[own]
    for known in (written, written.lower()):
        if known in forms and ("N" not in written or known == written):  # N m is no nm
            return forms[known]
    degrees = _DEGREES.match(written.lower())
    return _TURN / 360 if degrees and own.startswith("rad") else None


def _plain(unit: str) -> str:
    """A unit as the forms are written: without blanks, dots and asterisks, "/s", "/s^2", u for micro."""
    text = unit.replace("²", "^2").replace("**", "^").replace("µ", "u").replace("μ", "u")
    text = re.sub(r"[\s·⋅.*]", "", text)
    text = re.sub(r"(?i)/sec(ond)?s?", "/s", text)
    text = re.sub(r"/s/s$|/s2$|s\^?[-−]2$|s⁻²$", "/s^2", text)
    return re.sub(r"(?<=[a-z°])s\^?[-−]1$|s⁻¹$", "/s", text)
