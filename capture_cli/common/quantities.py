"""Numbers as people read them: digits that mean something, and units with a prefix."""

import math
import re
from collections.abc import Mapping
from typing import Any

MISSING = "–"


# These symbols take a prefix where they open a unit and carry no exponent: "m/s" does, "m^2" and "kg" do not.
_PREFIXABLE = re.compile(r"(m|rad|s|N|V|A|W|J|Pa|Hz)(?![\w^²³*])")
_PREFIXES = ((1.0, ""), (1e3, "m"), (1e6, "µ"), (1e9, "n"))

NORMAL_QUANTILE = 1.959964  # standard deviations to either side, of an interval that covers 95 %


def scaled_unit(unit: str, magnitude: float | None) -> tuple[float, str]:
    """(factor, unit to show) that bring a value of about `magnitude`, in `unit`, to 0.1 or more.

    0.00073 m -> (1e3, "mm"). Units that take no prefix come back as they are, and "1" as "".
    """
    if not shown_unit(unit):
        return 1.0, ""
    if not _PREFIXABLE.match(unit) or not magnitude or not math.isfinite(magnitude):
        return 1.0, unit
    for factor, prefix in _PREFIXES:
        if abs(magnitude) * factor >= 0.1:
            return factor, prefix + unit
    return 1.0, unit


def floor_unit(floor: float | None, unit: str, factor: float, label: str) -> tuple[float, str]:
    """(factor, unit to show) of a noise floor in `unit`, beside errors that are shown by `factor` in `label`."""
    # a noise floor under a hundredth of the unit of the errors has more zeros than digits
    near = floor and floor * factor >= 0.01  # then it is easier to compare in one unit
    return (factor, label) if near else scaled_unit(unit, floor)


def place(value, parameter: Mapping[str, Any]):
    """Where in its range a value is, or values (...) are: 0 at the lower bound, 1 at the upper."""
    return (value - parameter["low"]) / (parameter["high"] - parameter["low"])


def significant(value: float | None, digits: int = 3) -> str:
    """`value` to so many significant digits: 0.7304 -> "0.730", 1234.5 -> "1234", 3.2e-7 -> "3.20e-7"."""
    if value is None or not math.isfinite(value):
        return MISSING
    if value == 0:
        return "0"
    exponent = _exponent(value, digits)
    if not -4 <= exponent <= 5:
        return _scientific(value, digits - 1)
    return f"{value:.{max(0, digits - 1 - exponent)}f}"


def bound(value: float) -> str:
    """A declared number, as short as it is: 50.0 -> "50", 0.025 -> "0.025"."""
    return re.sub(r"e([+-])0*", lambda m: "e" + m[1].replace("+", ""), f"{value:.6g}")


def to_precision_of(value: float | None, sd: float | None) -> str:
    """`value` to the second digit of `sd`, and to six digits at most: 95.1078, 0.13 -> "95.11".

    To two digits of its own where it is lost in `sd`: it may be a bound.
    """
    if value is None or not math.isfinite(value):
        return MISSING
    if not sd or not math.isfinite(sd):
        return significant(value, 4)
    lost = 10.0  # times a value: a standard deviation beyond which digits of the value mean nothing
    if 0 < lost * abs(value) < sd:
        return significant(value, 2)
    decimals = 1 - _exponent(sd, 2)
    size = _exponent(value, 6) if value else 0
    if not -4 <= max(size, 1 - decimals) <= 5:
        return _scientific(value, min(5, max(0, size + decimals)))
    return f"{value:.{max(0, min(decimals, 5 - size))}f}"


def with_unit(number: str, unit: str) -> str:
    """A number before its unit, "0.73 mm"; a missing number or unit adds nothing."""
    return number if number == MISSING or not shown_unit(unit) else f"{number} {unit}"


def estimated(p: Mapping[str, Any]) -> str:
    """The value of a parameter to the precision of its standard deviation, with its unit: "2.01 kg"."""
    return with_unit(to_precision_of(p["value"], p.get("sd")), p.get("unit", ""))


def interval(p: Mapping[str, Any]) -> str:
    """The 95 % interval of a parameter: "199.8 to 207.2"; missing where it has none."""
    return " to ".join(to_precision_of(end, p["sd"]) for end in p["ci95"] or ()) or MISSING


def deviation(p: Mapping[str, Any]) -> str:
    """The standard deviation of a parameter; missing where it is the range or beyond: it says nothing then."""
    sd = p["sd"]
    return MISSING if sd is not None and sd >= p["high"] - p["low"] else significant(sd, 2)


def told(p: Mapping[str, Any]) -> str:
    """What a log says of a parameter that it does not determine: "at least 0.62", or "not determined"."""
    limits = p.get("limits") or {"at_least": None, "at_most": None}
    least, most = (significant(limits[end]) for end in ("at_least", "at_most"))
    if MISSING not in (least, most):
        return with_unit(f"between {least} and {most}", p["unit"])
    if least != MISSING:
        return with_unit(f"at least {least}", p["unit"])
    return "not determined" if most == MISSING else with_unit(f"at most {most}", p["unit"])


def percent(share: float, digits: int = 0) -> str:
    """0.0312 -> "3 %", as everywhere with a space; of less than these digits show the first that is not 0."""
    text = f"{100 * share:.{digits}f}"
    return f"{100 * share:.1g} %" if share and not float(text) else f"{text} %"


def shown_unit(unit: str) -> str:
    """The unit as it is shown: nothing for "1" and "-"."""
    return "" if unit in ("1", "-") else unit


def titled(name: str, unit: str) -> str:
    """The title of an axis: "q [mm]"; a number without a unit is its name alone, and a long name is cut."""
    longest = 26  # characters: more do not fit beside a small plot
    name = name if len(name) <= longest else name[: longest - 1] + "…"
    return f"{name} [{unit}]" if shown_unit(unit) else name


def counted(count: int) -> str:
    """A count, its thousands apart by a thin space: 1240 -> "1 240"."""
    return f"{count:,}".replace(",", "\u2009")


def _exponent(value: float, digits: int) -> int:
    """The power of ten of the first digit after rounding to `digits`: 0.0999 to two digits is 0.10, so -1."""
    return int(f"{abs(value):.{digits - 1}e}".split("e")[1])


def _scientific(value: float, decimals: int) -> str:
    mantissa, exponent = f"{value:.{decimals}e}".split("e")
    return f"{mantissa}e{int(exponent)}"
