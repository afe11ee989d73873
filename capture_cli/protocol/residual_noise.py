"""The noise floor of what a fitted model leaves.

Differences of the samples of a slow sensor show a fast motion beside the noise, and a floor that is too high hides what
the model lacks. A model that is nearly right has the same motion: what it leaves shows the noise.
"""

from __future__ import annotations

import numpy as np

from capture_cli.diagnosis.noise_floor import NoiseFloor, least_floor, shared, white_noise
from capture_cli.linearization import Linearization
from capture_cli.protocol.model_fits import Fit
from capture_cli.protocol.prepare import with_noise
from capture_cli.protocol.prepared_log import PreparedLog, attitudes

# Of a floor: one that is lower than this is lower by more than the scatter of two estimates from the same samples.
CLEARLY_LOWER = 0.8
# Share of an output's noise that starts may take up: beyond it there is too little left to tell.
MOST_TAKEN = 0.5


def with_noise_of_residual(
    prepared: PreparedLog, part: PreparedLog, fit: Fit, threads: int | None
) -> PreparedLog:
    """The log with lower noise floors of outputs whose own differences show more than the residual of `fit`.

    As it is where none is clearly lower. fit: the declared model, on that `part` of the log. Floors that come from
    repeats, a sensor's steps or the task stay.
    """
    noise = prepared.noise
    sd = shared(_noise(part, fit.at), attitudes(prepared.task))
    by_differences = np.array([source == "differences" for source in noise.source])
    lower = by_differences & (sd < CLEARLY_LOWER * noise.sd)
    if not lower.any():
        return prepared
    source = ["residual" if new else old for new, old in zip(lower, noise.source, strict=True)]
    return with_noise(prepared, NoiseFloor(np.where(lower, sd, noise.sd), tuple(source)), threads)


def _noise(part: PreparedLog, at: Linearization) -> np.ndarray:
    """Standard deviations (output,) of the noise in the residual, in the outputs' units; inf where it cannot tell."""
    log, windows, noise_sd = part.log, part.windows, at.evidence.noise_sd
    residual = at.residual.reshape(at.evidence.measured.shape) * noise_sd
    taken = at.leverage.reshape(residual.shape)
    sd = np.full(len(noise_sd), np.inf)
    for k in range(len(noise_sd)):
        sampled = windows.sampled[..., k]
        series = [own[there] for own, there in zip(residual[..., k], sampled, strict=True)]
        times = [
            log.time[first + np.flatnonzero(there)]
            for first, there in zip(windows.first, sampled, strict=True)
        ]
        found, share = white_noise(series, times), float(taken[..., k][sampled].mean())
        if found is not None and share < MOST_TAKEN:
            sd[k] = max(found / np.sqrt(1 - share), least_floor(part.samples(k)))
    return sd
