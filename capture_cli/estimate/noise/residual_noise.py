"""The noise floor of what a fitted model leaves.

Differences of the samples of a slow sensor show a fast motion beside the noise, and a floor that is too high hides what
the model lacks. A model that is nearly right has the same motion: what it leaves shows the noise.

A floor from differences leaves out the largest of them, which may be impacts, and so the outliers of a camera or of a
disturbed line as well; with them a model that lacks nothing is beyond it. No machine is elsewhere, or moves otherwise,
for one sample alone: what of a position or a velocity stands out by itself is noise, whatever the model lacks.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from capture_cli.estimate.fit import Fit
from capture_cli.estimate.noise.lack_of_fit import SETTINGS as LACK_OF_FIT
from capture_cli.estimate.noise.noise_floor import NoiseFloor, least_floor, shared
from capture_cli.estimate.prepare import with_noise
from capture_cli.estimate.prepared_log import PreparedLog, attitudes
from capture_cli.estimate.solve.linearization import Linearization
from capture_cli.log.white_noise import white_noise


def with_noise_of_residual(
    prepared: PreparedLog, part: PreparedLog, fit: Fit, threads: int | None
) -> PreparedLog:
    """The log with lower noise floors of outputs whose own differences show more than the residual of `fit`, and then
    `with_outliers`.

    As it is where nothing is clearly otherwise. fit: the declared model, on that `part` of the log. Floors that come
    from repeats, a sensor's steps or the task are not lowered.
    """
    noise = prepared.noise
    sd = shared(_noise(part, fit.at), attitudes(prepared.task))
    by_differences = np.array([source == "differences" for source in noise.source])
    # Of a floor: one that is lower than this is lower by more than the scatter of two estimates from the same
    # samples.
    clearly_lower = 0.8
    lower = by_differences & (sd < clearly_lower * noise.sd)
    if lower.any():
        prepared = _with(prepared, lower, sd, "residual", threads)
    return with_outliers(prepared, part, fit, threads)


def with_outliers(prepared: PreparedLog, part: PreparedLog, fit: Fit, threads: int | None) -> PreparedLog:
    """The log with higher noise floors of outputs with outliers in the residual of `fit`, which is to that `part`; as
    it is where none is clearly higher. Floors that come from a sensor's steps or the task stay.
    """
    noise = prepared.noise
    sd = shared(noise.sd * _more_with_outliers(part, fit.at, noise.sd), attitudes(prepared.task))
    trimmed = np.array([source in ("differences", "repeats", "residual") for source in noise.source])
    clearly_higher = 1.05
    higher = trimmed & (sd > clearly_higher * noise.sd)
    return _with(prepared, higher, sd, "outliers", threads) if higher.any() else prepared


def _with(
    prepared: PreparedLog, new: np.ndarray, sd: np.ndarray, source: str, threads: int | None
) -> PreparedLog:
    """The log with floors `sd` (output,) from that source where they are `new` (output,)."""
    noise = prepared.noise
    sources = [source if is_new else old for is_new, old in zip(new, noise.source, strict=True)]
    return with_noise(prepared, NoiseFloor(np.where(new, sd, noise.sd), tuple(sources)), threads)


def _noise(part: PreparedLog, at: Linearization) -> np.ndarray:
    """Standard deviations (output,) of the noise in the residual, in the outputs' units; inf where it cannot tell."""
    log, windows = part.log, part.windows
    taken = at.leverage.reshape(at.data.measured.shape)
    sd = np.full(taken.shape[2], np.inf)
    # Share of an output's noise that initial states may take up: beyond it there is too little left to tell.
    most_taken = 0.5
    for k, series in enumerate(_left(part, at)):
        sampled = windows.sampled[..., k]
        times = [
            log.time[first + np.flatnonzero(there)]
            for first, there in zip(windows.first, sampled, strict=True)
        ]
        found, share = white_noise(series, times), float(taken[..., k][sampled].mean())
        if found is not None and share < most_taken:
            sd[k] = max(found / np.sqrt(1 - share), least_floor(part.samples(k)))
    return sd


def _more_with_outliers(part: PreparedLog, at: Linearization, sd: np.ndarray) -> np.ndarray:
    """How many times `sd` (output,) the noise in the residual is with its outliers, (output,): 1 or more."""
    more = np.ones(len(sd))
    for k, (channel, series) in enumerate(zip(part.task.outputs, _left(part, at), strict=True)):
        of_motion = part.task.model.sensor_needstage[channel.sensor] != mujoco.mjtStage.mjSTAGE_ACC
        if sd[k] > 0 and of_motion:
            more[k] = np.sqrt(1 + max(_of_outliers([s / sd[k] for s in series]), 0.0))
    return more


def _of_outliers(series: Sequence[np.ndarray]) -> float:
    """What samples that stand out by themselves add to the mean square of series (step,), in units of the noise floor;
    0 where the others are beyond it, too: then the model lacks something, and it may be that.
    """
    inner = np.concatenate([s[1:-1] for s in series if len(s) > 2] or [np.zeros(0)])
    before, after = (
        np.concatenate([s[own] for s in series if len(s) > 2] or [np.zeros(0)])
        for own in (slice(None, -2), slice(2, None))
    )
    off = inner - (before + after) / 2
    # Noise floors: where a sample stands out. Of Gaussian noise one in 2000 does, which raises no floor.
    outlying = 3.5
    alone = (np.abs(off) > outlying * np.sqrt(1.5)) & (np.abs(after - before) < outlying * np.sqrt(2))
    if not alone.any() or np.square(inner[~alone]).mean() > LACK_OF_FIT.practical_of_one**2:
        return 0.0
    return float((np.square(off[alone]) - 1.5).sum() / len(off))


def _left(part: PreparedLog, at: Linearization) -> list[list[np.ndarray]]:
    """What the fit leaves of the samples of each output in each window, (sample,), in the output's unit."""
    residual = at.residual.reshape(at.data.measured.shape) * at.data.noise_sd
    sampled = part.windows.sampled
    return [
        [own[there] for own, there in zip(residual[..., k], sampled[..., k], strict=True)]
        for k in range(residual.shape[2])
    ]
