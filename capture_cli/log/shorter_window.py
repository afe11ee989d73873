"""A window that a log is long enough for: what to set where the one that is set is too long."""

import numpy as np

from capture_cli.log.windows import SETTINGS as WINDOWS


def set_shorter(duration: float, samples: int, *, option: bool) -> str:
    """The cure for a window that is too long for an episode of that `duration`, s, and so many samples: one in one
    digit, of which the episode holds four or more, unless it would hold too few samples. option: whether --window sets
    it.
    """
    window = 0.0
    if duration > 0:
        longest = duration / WINDOWS.in_episode
        power = np.floor(np.log10(longest))
        window = float(f"{np.floor(longest / 10**power)}e{power:.0f}")
    if not window or window * (samples - 1) < WINDOWS.fewest_in_window * duration:
        return "record longer"
    passed = f" (or pass --window {window:g})" if option else ""
    return f"set `window = {window:g}` under [log] of the task.toml{passed}, or record longer"
