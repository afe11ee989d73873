"""Inputs around windows: what is read off a log when asked for is what would have been kept, to the last digit."""

from __future__ import annotations

import numpy as np
import pytest
from setting_numbers import set_numbers

from capture_cli.log.input_sequences import (
    EVENLY,
    HELD,
    CachedSequences,
    Hold,
    LoggedInputs,
    LogSequences,
    input_sequences,
)

TIMESTEP, LEAD, STOP = 0.002, 60, 90  # s; model steps
FIRST = np.array([0, 20, 55, 130, 170])
KNOWN = np.array([[0, 120], [0, 120], [0, 120], [120, 200], [120, 200]])
TIMES = {
    "on the grid": lambda t: t,
    "off the grid": lambda t: 1.07 * t,
    "several in a step": lambda t: 0.21 * t,
    "uneven": lambda t: t + 0.0009 * np.sin(37 * np.arange(t.size)),
}


@pytest.mark.parametrize("hold", [HELD, EVENLY, Hold(3.0), Hold(1.0, -0.004), Hold(2.0, 0.0013)])
@pytest.mark.parametrize("name", TIMES)
def test_inputs_are_the_same_kept_or_read(name, hold, monkeypatch):
    time, values = TIMES[name](TIMESTEP * np.arange(200)), np.random.default_rng(0).standard_normal((200, 2))
    logged = LoggedInputs(time, values, TIMESTEP, [HELD, hold])
    kept = input_sequences(logged, first=FIRST, known=KNOWN, lead=LEAD, stop=STOP)
    set_numbers(monkeypatch, "capture_cli.log.input_sequences", kept_bytes=0)
    read = input_sequences(logged, first=FIRST, known=KNOWN, lead=LEAD, stop=STOP)
    assert isinstance(kept, CachedSequences) and isinstance(read, LogSequences)
    keep = np.array([3, 1, 4])
    for tapes, one in ((kept, read), (kept.rows(keep, 70), read.rows(keep, 70))):
        assert (one.lead, one.stop) == (tapes.lead, tapes.stop)
        every = np.arange(len(one.first))
        for begin, stop in [(-LEAD, one.stop), (-7, 0), (0, 50), (-20, 33), (69, 70)]:
            for row in (every, every[::-1], every[1:2]):
                np.testing.assert_array_equal(one.inputs(row, begin, stop), tapes.inputs(row, begin, stop))
