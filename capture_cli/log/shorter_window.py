"""A window that a log is long enough for: what to set where the one that is set is too long."""

from __future__ import annotations

import numpy as np

from capture_cli.log.windows import SETTINGS as WINDOWS_SETTINGS


def fitting_window(duration: float, samples: int) -> float | None:
    """A window, s, in one digit, of which an episode of that `duration`, s, and so many samples holds four or more.

    None where such a window would hold too few samples itself.
    """
    if not duration > 0:
        return None
    windows = 4  # in the longest episode, so that some can be held out
    longest = duration / windows
    power = np.floor(np.log10(longest))
    window = float(f"{np.floor(longest / 10**power)}e{power:.0f}")
    return window if window * (samples - 1) >= WINDOWS_SETTINGS.fewest_in_window * duration else None


def set_shorter(duration: float, samples: int, *, option: bool) -> str:
    """The cure for a window that is too long for an episode of that `duration`, s. option: whether --window sets it."""
    window = fitting_window(duration, samples)
    if window is None:
        return "record longer"
    passed = f" (or pass --window {window:g})" if option else ""
    return f"set `window = {window:g}` under [log] of the task.toml{passed}, or record longer"
