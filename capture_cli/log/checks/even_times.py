"""Time-stamp jitter about the even times at which samples were taken, as where messages are stamped as they arrive."""

from dataclasses import dataclass, replace

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.errors import LogError
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.white_noise import SETTINGS as WHITE_NOISE
from capture_cli.log.white_noise import from_differences


@frozen
class SETTINGS:
    fewest: int = 20  # steps of an episode whose interval can be told
    followed: float = 0.05  # of what a stamp is off: how fast the even times follow the stamps
    most_off: float = 0.4  # intervals, sd: beyond, nobody knows which sample is which
    smoother: float = 0.8  # of the noise by differences at the stamps


@dataclass(frozen=True)
class Jitter:
    """sd: s, of stamps about even times. smoother: outputs whose noise by differences is less there, in their units: at
    the stamps, and at even times.
    """

    sd: float
    smoother: dict[str, list[float]]


def with_even_times(log: MeasuredLog) -> MeasuredLog:
    """The log with the times of each episode's samples at even intervals, lost ones left out; those of recordings that
    are shorter than `fewest` steps as they are. `evened_times` of each recording says by how much stamps were off, s.

    Raises LogError where no even times are near the stamps.
    """
    time, off = log.time.copy(), [[] for _ in log.recordings]
    for number, episode in zip(log.recording, log.episodes, strict=True):
        even = _even(log.time[episode])
        if even is None:
            name = log.recording_names[number]
            raise LogError(
                f"{log.path}: the times of {name!r} are not those of samples at even intervals, or off by more than "
                f"{SETTINGS.most_off:g} of one",
                cure="leave --even-times out, and log the time at which each sample is measured",
            )
        off[number].append(log.time[episode] - even)
        time[episode] = even
    sds = [float(np.concatenate(own).std()) if own else 0.0 for own in off]
    recordings = tuple({**r, "evened_times": sd} for r, sd in zip(log.recordings, sds, strict=True))
    return replace(log, time=time, recordings=recordings)


def jitter(log: MeasuredLog) -> Jitter | None:
    """Time-stamp jitter, where outputs are smoother, and none is rougher, at even times; None where there is none."""
    if not np.isfinite(log.time).all() or not any(_is_uneven(log.time[e]) for e in log.episodes):
        return None
    even = [_even(log.time[e]) for e in log.episodes]
    if any(times is None for times in even):
        return None
    smoother = {}
    for k, name in enumerate(log.output_names):
        own = [np.flatnonzero(np.isfinite(log.outputs[e, k])) for e in log.episodes]
        series = [log.outputs[e, k][steps] for e, steps in zip(log.episodes, own, strict=True)]
        here, there = (
            from_differences(series, [t[steps] for t, steps in zip(times, own, strict=True)])
            for times in ([log.time[e] for e in log.episodes], even)
        )
        if there < SETTINGS.smoother * here:
            smoother[name] = [here, there]
        elif here < SETTINGS.smoother * there:
            return None
    off = np.concatenate([log.time[e] - times for e, times in zip(log.episodes, even, strict=True)])
    return Jitter(float(off.std()), smoother) if smoother else None


def _is_uneven(time: np.ndarray) -> bool:
    steps = np.diff(time)
    return len(steps) > 0 and bool(
        (steps > 0).all() and np.ptp(steps) > WHITE_NOISE.uneven * np.median(steps)
    )


def _even(time: np.ndarray) -> np.ndarray | None:
    """Even times (step,) for the stamps `time` (step,), s; None where none are near.

    The line through the stamps where none was lost, or where those were that they jump over, whichever is nearer.
    """
    if len(time) < SETTINGS.fewest:
        return time
    lag = SETTINGS.fewest // 2
    interval = float(np.median(time[lag:] - time[:-lag])) / lag
    if not interval > 0:
        return None
    lines = [_line(n, time) for n in (np.arange(len(time)), _followed(time, interval))]
    nearest = min(lines, key=lambda line: float((time - line).std()))
    return nearest if (time - nearest).std() < SETTINGS.most_off * interval else None


def _line(number: np.ndarray, time: np.ndarray) -> np.ndarray:
    return np.polynomial.Polynomial.fit(number, time, 1)(number)


def _followed(time: np.ndarray, interval: float) -> np.ndarray:
    """Which sample each stamp is of, lost ones counted, (step,)."""
    number, even = np.zeros(len(time)), float(time[0])
    for k, stamp in enumerate(time[1:], start=1):
        steps = max(round((stamp - even) / interval), 1)
        number[k] = number[k - 1] + steps
        even += steps * interval
        even += SETTINGS.followed * (stamp - even)
    return number
