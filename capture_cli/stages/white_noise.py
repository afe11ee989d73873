"""How much white noise is put on what is measured: SD for all, or NAME=SD."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from capture_cli.errors import OptionError, did_you_mean


def standard_deviations(
    option: str, given: Mapping[str, float] | float, names: Sequence[str], unknown: str
) -> tuple[float, ...]:
    """Standard deviation in SI units per name, 0 for those without one.

    given: of `option`, per name or one for all. unknown: says of what there is none of a name that is not among
    `names`. Raises OptionError for such a name, and for what is no standard deviation.
    """
    if isinstance(given, int | float):
        given = dict.fromkeys(names, float(given))
    for name, sd in given.items():
        if name not in names:
            raise OptionError(f"{option}: {unknown} {name!r}", cure=did_you_mean(name, names))
        if not 0 <= sd < math.inf:
            raise OptionError(
                f"{option} {name}={sd:g}", cure="give a standard deviation of 0 or more, in SI units"
            )
    return tuple(float(given.get(name, 0.0)) for name in names)
