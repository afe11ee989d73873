"""The noise floor of repeats, through the simulator: what repeated windows differ by, less what their initial states
can do.
"""

import numpy as np

from capture_cli.estimate.model_fits import Effort, ModelFits
from capture_cli.estimate.noise.noise_floor import NoiseFloor, least_floor, shared, shared_source
from capture_cli.estimate.noise.repeats import SETTINGS as REPEATS
from capture_cli.estimate.noise.repeats import pure_error, repeats
from capture_cli.estimate.prepare import driven_by, with_noise
from capture_cli.estimate.prepared_log import PreparedLog, attitudes
from capture_cli.estimate.solve.base import Best
from capture_cli.log.quantisation import scatter_of_steps
from capture_cli.log.white_noise import trimmed_sd


def with_noise_of_repeats(
    prepared: PreparedLog, start: np.ndarray, *, threads: int | None, seed: int
) -> tuple[PreparedLog, int]:
    """The log with the noise floor that its repeats show, and how many simulations that took.

    As it is where it has no repeats, and for outputs whose noise does not come from them. start (parameter,): where the
    declared model is fitted from, of which only the sensitivities to the initial states are used.
    """
    if "repeats" not in prepared.noise.source:
        return prepared, 0
    fits = ModelFits(prepared, threads)
    fit = fits.fit(prepared.part(~prepared.split.is_test), [], start, effort=Effort(seed=seed, escapes=False))
    if fit is None:
        return prepared, fits.rollouts
    as_measured = np.zeros_like(prepared.initial.sd)
    at = fits.at(prepared, [], Best(fit.point, as_measured, fit.error)).at
    deviations, degrees = pure_error(at, _repeated_windows(prepared))
    sd, source = prepared.noise.sd.copy(), list(prepared.noise.source)
    for k in np.flatnonzero([s == "repeats" for s in source]):
        if degrees[k] >= REPEATS.fewest:
            samples = prepared.samples(k)
            sd[k] *= trimmed_sd(deviations[k])
            if sd[k] < scatter_of_steps(samples):
                source[k] = "resolution"
            sd[k] = max(sd[k], least_floor(samples))
    quaternions = attitudes(prepared.task)
    noise = NoiseFloor(shared(sd, quaternions), shared_source(source, sd, quaternions))
    return with_noise(prepared, noise, threads), fits.rollouts


def _repeated_windows(prepared: PreparedLog) -> list[np.ndarray]:
    """Windows (repeat,) at the same place of episodes that repeat each other."""
    log, windows = prepared.log, prepared.windows
    begins = np.array([episode.start for episode in log.episodes])
    since = windows.first - begins[windows.episode]
    groups = []
    noise_sd = prepared.noise.sd
    for episodes in repeats(log.time, driven_by(log), log.values, log.episodes, noise_sd, log.sampled):
        same = np.flatnonzero(np.isin(windows.episode, episodes))
        for place in np.unique(since[same]):
            group = same[since[same] == place]
            if len(group) > 1:
                groups.append(group)
    return groups
