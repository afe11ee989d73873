"""What the texts of options say: NAME=NUMBER, ranges, standard deviations, verdicts."""

import math
import re
from collections.abc import Sequence

from capture_cli.errors import OptionError, did_you_mean


def named_numbers(texts: list[str], option: str) -> dict[str, float]:
    """NAME=VALUE texts as a dict. Raises OptionError."""
    result = {}
    for text in texts:
        name, equals, value = text.partition("=")
        try:
            if not equals:
                raise ValueError
            result[name] = _finite(value)
        except ValueError:
            raise OptionError(
                f"{option} {text!r} is not NAME=NUMBER", cure=f"for example {option} x=0.5"
            ) from None
    return result


def named_ranges(texts: list[str], option: str) -> dict[str, tuple[float, float]]:
    """NAME=VALUE or NAME=LOW:HIGH texts as a dict of ranges. Raises OptionError."""
    result = {}
    for text in texts:
        name, _, value = text.partition("=")
        low, colon, high = value.partition(":")
        try:
            result[name] = (_finite(low), _finite(high if colon else low))
        except ValueError:
            raise OptionError(
                f"{option} {text!r} is not NAME=VALUE or NAME=LOW:HIGH",
                cure=f"for example {option} x=-0.1:0.1",
            ) from None
        if result[name][0] > result[name][1]:
            raise OptionError(
                f"{option} {text!r}: {low} is above {high}",
                cure=f"the lower one first: {option} {name}={high}:{low}",
            )
    return result


def standard_deviations(texts: list[str], option: str) -> dict[str, float] | float:
    if len(texts) == 1 and "=" not in texts[0]:
        try:
            return float(texts[0])
        except ValueError:
            raise OptionError(f"{option} {texts[0]!r} is not a number", cure="give SD, or NAME=SD") from None
    return named_numbers(texts, option) if texts else 0.0


def byte_count(text: str) -> int:
    """A number of bytes, "500MB" or "2GB". Raises OptionError."""
    found = _BYTES.fullmatch(str(text).strip())
    if found is None or not float(found[1]):
        raise OptionError(
            f"--max-log-size {text!r:.60} is no size", cure="give a number of bytes with a unit: 500MB, 2GB"
        )
    return int(float(found[1]) * _UNITS[(found[2] or "B").upper()])


_UNITS = {"B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
_BYTES = re.compile(r"(\d{1,15}(?:\.\d{1,15})?)\s*([kMGT]?B)?", re.IGNORECASE)


def chosen(possible: Sequence[str], text: str | None, option: str) -> frozenset[str]:
    """What the option names, comma-separated, each one of the `possible`. Raises OptionError."""
    names = frozenset(v.strip() for v in (text or "").split(",") if v.strip())
    for name in sorted(names - set(possible)):
        raise OptionError(f"{option} {name!r}", cure=did_you_mean(name, possible))
    return names


def _finite(text: str) -> float:
    """Raises ValueError."""
    number = float(text)
    if not math.isfinite(number):
        raise ValueError
    return number
