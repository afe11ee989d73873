"""Windows, samples and steps of the model that do not suit each other."""

import numpy as np

from capture_cli.log.checks.base import Check, error, warning
from capture_cli.log.shorter_window import set_shorter
from capture_cli.log.step_length import unsuitable_step
from capture_cli.log.windows import SETTINGS as WINDOWS

SMALL_UNITS = {"ms": "1e-3", "us": "1e-6", "ns": "1e-9"}  # as a task.toml has them


class Lengths(Check):
    def findings(self, given):
        episodes, task = given.episodes, given.task
        known = [e for e in episodes if e["duration"] is not None]
        intervals = [e["interval"] for e in episodes if e["interval"] is not None]
        if not known or not intervals:
            return
        longest = max(known, key=lambda e: e["duration"])
        window, interval = task.log.window, float(np.median(intervals))
        window_samples = 5  # fewer in a window say little
        if window is not None and longest["duration"] < WINDOWS.shortest_episode * window:
            yield error(
                "episodes",
                f"the longest lasts {longest['duration']:.3g} s, and a window {window:g} s",
                set_shorter(longest["duration"], longest["steps"], option=True),
            )
        elif window is not None and window < window_samples * interval:
            yield warning(
                "time",
                f"a window of {window:g} s holds {window / interval:.2g} samples, {interval:.3g} s apart",
                f"set a longer [log] window{_time_unit(interval, task.log.time_scale)}",
            )
        unsuitable = unsuitable_step(
            task.timestep, interval, longest["duration"] if window is None else window
        )
        if unsuitable is not None:
            yield error("time", *unsuitable)
        elif task.timestep > 1.001 * interval:
            yield warning(
                "time",
                f"the model steps by {task.timestep:g} s, coarser than the log's {interval:.3g} s",
                "set a smaller timestep in the model's <option>",
            )


def _time_unit(interval: float, time_scale: float) -> str:
    """What else to do about samples so many seconds apart: their times may be in another unit."""
    if time_scale != 1:
        return f"; if one unit of time is not {time_scale:g} s, correct [log] time_scale, and import the files again"
    least_in_ms = 0.1  # s, between samples: times in ms of a sensor that reports at 10 kHz
    if interval < least_in_ms:
        return ""
    long_interval = 0.5  # s, between samples, at most, if a unit of time is to be taken for theirs
    short = (u for u, scale in SMALL_UNITS.items() if interval * float(scale) < long_interval)
    unit = next(short, "ns")
    return (
        f"; if the time column is in {unit}, write time_scale = {SMALL_UNITS[unit]} under [log] and import the files "
        "again"
    )
