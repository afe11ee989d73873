"""Whether what a model leaves is as if samples had been taken off their time stamps at random.

A stamp that is off by e shifts a sample by e times the speed at which its output changes. Where e is another one for
each sample, as that of a message which is stamped where it arrives, what is left is white in time, as noise is, with a
variance that grows with the square of the speed. A delay is the same for all samples, and what forces leave is smooth:
neither is in differences along the log.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.noise.lack_of_fit import SETTINGS as LACK_OF_FIT
from capture_cli.estimate.noise.lack_of_fit import LackOfFit, lack_held_out, lack_of_fit
from capture_cli.estimate.part_fit import PartFit
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve.linearization import Linearization
from capture_cli.log.white_noise import differences, trimmed_sd

ORDERS = range(2, 7)  # of differences


@frozen
class SETTINGS:
    settled: float = 1.25  # times, at most, the next order gives more or less: otherwise it is not white
    bins: int = 10  # by speed, each with as many differences
    fewest: int = 20  # differences in a bin
    sure: float = 5.0  # sd of the growth with the squared speed
    straight: float = 0.35  # of the variance in a bin is off the line, root mean square
    worth_a_word: float = 0.3  # of the variance of an output's noise


@dataclass(frozen=True)
class TimeStampJitter:
    """sd (output,): s, of stamps about the times of the samples, 0 where nothing shows it. share (output,): of the
    variance of the noise, by that. explained: share of what is beyond chance, 1 where with such noise nothing is; None
    where nothing is without.
    """

    sd: np.ndarray
    share: np.ndarray
    explained: float | None


def time_stamp_jitter(
    prepared: PreparedLog, whole: PartFit, at: Linearization, fitted: np.ndarray
) -> TimeStampJitter | None:
    """What a fit says of the log's stamps; None where nothing.

    whole: on all windows of the log. at: on those that it was `fitted` to (window,).
    Of positions and velocities: accelerations and forces jump with the controls, whatever the stamps.
    """
    windows, model = prepared.windows, prepared.task.model
    time = prepared.log.time[prepared.log_steps]
    residual = whole.residual.reshape(windows.measured.shape)
    simulated = windows.measured - whole.in_units
    noise = np.ones(residual.shape)  # in floors, as it grows with the speed
    sd, share = np.zeros(residual.shape[2]), np.zeros(residual.shape[2])
    for k, channel in enumerate(prepared.task.outputs):
        if model.sensor_needstage[channel.sensor] == mujoco.mjtStage.mjSTAGE_ACC:
            continue
        sound = np.isfinite(residual[..., k]).all(axis=1)  # where the simulation did not run away
        own = [np.flatnonzero(there) for there in windows.sampled[..., k]]
        own = [(w, steps) for w, steps in enumerate(own) if sound[w] and len(steps) > max(ORDERS) + 2]
        series, times = ([values[s] for s in own] for values in (residual[..., k], time))
        speeds = [np.gradient(simulated[..., k][s], t) for s, t in zip(own, times, strict=True)]
        found = _settled(series, times, speeds)
        if found is None:
            continue
        still, slope = found
        moving = slope * np.square(np.concatenate(speeds)).mean()
        if moving < SETTINGS.worth_a_word * (still + moving):
            continue
        off = np.sqrt(slope) * prepared.noise.sd[k]
        if off < np.spacing(np.abs(time).max()):
            continue  # no time stamp can be off by less than its number holds
        sd[k], share[k] = off, moving / (still + moving)
        for steps, speed in zip(own, speeds, strict=True):
            noise[..., k][steps] = np.sqrt(min(still, 1.0) + slope * np.square(speed))
    return TimeStampJitter(sd, share, _explained(noise, whole, at, fitted)) if sd.any() else None


def _explained(noise: np.ndarray, whole: PartFit, at: Linearization, fitted: np.ndarray) -> float | None:
    """The share of what is beyond chance, in what was fitted and in the others of `whole`, that is not where noise
    (window, step, output) is so many floors; None where nothing is.
    """

    def in_noise(residual: np.ndarray, shape: Sequence[int], keep: np.ndarray) -> np.ndarray:
        return (residual.reshape(shape) / noise[keep, : shape[1]]).reshape(residual.shape)

    others = whole.rows(~fitted)
    of_fit = in_noise(at.residual, at.data.measured.shape, fitted)
    of_others = in_noise(others.residual, others.data.measured.shape, ~fitted)
    before = (lack_of_fit(at), lack_held_out(others.data, others.residual))
    after = (lack_of_fit(at, of_fit), lack_held_out(others.data, of_others))
    shares = [
        1 - max(_beyond(left), 0.0) / _beyond(was)
        for was, left in zip(before, after, strict=True)
        if was.lacking
    ]
    return max(min(shares), 0.0) if shares else None


def _beyond(lack: LackOfFit) -> float:
    """By how much the squared error of all outputs, or of one, is beyond what chance allows; 0 or less: it is not."""
    return float(
        max((lack.normalized / lack.threshold) ** 2, np.square(lack.outputs / lack.output_thresholds).max())
        - 1
    )


def _settled(
    series: Sequence[np.ndarray], times: Sequence[np.ndarray], speeds: Sequence[np.ndarray]
) -> tuple[float, float] | None:
    """The variance of white noise in series (sample,) at rest, and its growth with the squared speed; None where it
    does not grow so, or the next order of differences says otherwise.
    """
    found = list(_by_order(series, times, speeds))
    for this, following in pairwise(found):
        if (
            this is not None
            and following is not None
            and 1 / SETTINGS.settled < following[1] / this[1] < SETTINGS.settled
        ):
            return this
    return None


def _by_order(
    series: Sequence[np.ndarray], times: Sequence[np.ndarray], speeds: Sequence[np.ndarray]
) -> Iterator[tuple[float, float] | None]:
    for order in ORDERS:
        left, late = (
            np.concatenate([differences(s, t, order) for s, t in zip(values, times, strict=True)] or [[]])
            for values in (series, speeds)
        )
        if len(left) < SETTINGS.bins * SETTINGS.fewest or not late.any():
            yield None
            continue
        left = left - late * (left @ late) / (late @ late)  # what all are late by, where motion is not smooth
        squares = [
            np.lib.stride_tricks.sliding_window_view(np.square(s), order + 1).mean(axis=1) for s in speeds
        ]
        yield _line(left, np.concatenate(squares))


def _line(values: np.ndarray, squares: np.ndarray) -> tuple[float, float] | None:
    """The line of the variance of `values` (n,) over squared speeds (n,): at rest, and its slope; None where it is no
    line that surely rises. Without the largest in each bin, which impacts may be.
    """
    bins = np.array_split(np.argsort(squares, kind="stable"), SETTINGS.bins)
    unit = squares.mean()
    centres = np.array([squares[b].mean() for b in bins]) / unit
    variances = np.array([trimmed_sd(values[b]) ** 2 for b in bins])
    if np.ptp(centres) == 0 or not ((variances > 0) & np.isfinite(variances)).all():
        return None
    columns, relative = np.stack([np.ones(SETTINGS.bins), centres], axis=1), variances
    for _ in range(2):  # by the variances found, then by those of the line
        weights = 1 / np.square(relative)
        normal = columns.T @ (weights[:, None] * columns)
        still, slope = np.linalg.solve(normal, columns.T @ (weights * variances))
        relative = np.maximum(still + slope * centres, 0.1 * variances)
    uncertain = np.sqrt(
        2 * (1 + LACK_OF_FIT.floor_share) / (len(values) / SETTINGS.bins) * np.linalg.inv(normal)[1, 1]
    )
    off = np.sqrt(np.mean(np.square(variances / relative - 1)))
    if slope < SETTINGS.sure * uncertain or off > SETTINGS.straight:
        return None
    return float(max(still, variances.min() / 2)), float(slope / unit)
