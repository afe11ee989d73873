"""Times that are written as text: as ISO 8601 says, 2026-11-23T10:00:00.005Z, or of a day, 10:00:00.005."""

import re
from collections.abc import Sequence
from datetime import date

import numpy as np

SECOND = 10**9  # ns
DAY = 86_400 * SECOND
_STAMP = re.compile(
    r"((?P<date>\d{4}-\d\d-\d\d)[T ])?(?P<hour>[01]?\d|2[0-3]):(?P<minute>[0-5]\d):(?P<second>[0-5]\d|60)"
    r"([.,](?P<fraction>\d+))?( ?(?P<zone>Z|UTC|[+-]\d\d(:?\d\d)?))?"
)


def is_stamp(text: str) -> bool:
    """Whether `text` is a time of one of these forms."""
    return _read(text) is not None


def seconds(texts: Sequence[str | None]) -> tuple[np.ndarray, int | None]:
    """Times in s since the first of `texts` (row,), NaN where None; and the first row that is no time, or of another
    form than the first one (a date or none, a zone or none), None where all are.

    Times of day go on after midnight. A zone is what it is ahead of UTC; without one times are taken as they are.
    """
    since, first, before, days = np.full(len(texts), np.nan), None, None, 0
    for row, text in enumerate(texts):
        if text is None:
            continue
        found = _read(text)
        if found is None or (first is not None and found[1:] != first[1:]):
            return since, row
        stamp, has_date, _ = found
        if first is None:
            first = before = found
        if not has_date and before[0] - stamp > DAY // 2:
            days += 1
        before = found
        # whole numbers up to here: a float has no room for microseconds since 1970
        since[row] = (stamp + days * DAY - first[0]) / SECOND
    return since, None


def _read(text: str) -> tuple[int, bool, bool] | None:
    """ns, since the year 1 where there is a date, and whether there is a date and a zone; None of another text."""
    found = _STAMP.fullmatch(text.strip())
    if found is None:
        return None
    try:
        days = date.fromisoformat(found["date"]).toordinal() if found["date"] else 0
    except ValueError:  # no such day
        return None
    whole = (int(found["hour"]) * 60 + int(found["minute"])) * 60 + int(found["second"])
    zone = found["zone"]
    if zone and zone[0] in "+-":
        digits = zone[1:].replace(":", "").ljust(4, "0")
        ahead = (int(digits[:2]) * 60 + int(digits[2:])) * 60
        whole += ahead if zone[0] == "-" else -ahead
    fraction = int((found["fraction"] or "").ljust(9, "0")[:9])
    return days * DAY + whole * SECOND + fraction, bool(found["date"]), bool(zone)
