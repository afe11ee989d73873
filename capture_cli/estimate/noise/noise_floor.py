"""The noise floor of each output: how far a perfect model would still be from the log.

From repeats where the log has them (repeats.py), otherwise from high-order differences of the log itself
(log/white_noise.py). Noise that is not white is underestimated by differences, and so is said to be something the model
lacks.

A sensor that reports in steps has a floor of its own, the step over the square root of 12: its steps are noise, nothing
that a model lacks.

The four numbers of an attitude have one floor: what each shows of the same noise depends on the orientation.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.noise.repeats import SETTINGS as REPEATS
from capture_cli.estimate.noise.repeats import SHORTEST, from_repeats, repeats
from capture_cli.log.arrays import Log
from capture_cli.log.quantisation import scatter_of_steps
from capture_cli.log.white_noise import noise_and_spacing, trimmed_sd


@frozen
class SETTINGS:
    smallest: float = 1e-7  # of the output's own standard deviation: floor for logs without noise
    rounding: float = 1e-12  # of the largest number: an output that changes by less is always the same


@dataclass(frozen=True)
class NoiseFloor:
    """sd (output,) in the outputs' units, 0 of one that never changes; source (output,): "declared", "repeats",
    "differences", "resolution", "residual" (differences of what a fitted model left) or "outliers" (with those).
    """

    sd: np.ndarray
    source: tuple[str, ...]


def noise_floor(
    log: Log,
    declared: Sequence[float | None],
    *,
    driven_by: Sequence[np.ndarray],
    block: int,
    attitudes: Sequence[np.ndarray] = (),
) -> NoiseFloor:
    """Of the log's outputs, each by its own samples; `declared` (output,) are known values, None where there are none.

    driven_by: the inputs or the action of each episode; block: samples over which repeats are compared. attitudes:
    which outputs make up each quaternion, (4,).
    """
    time, outputs, episodes, sampled = log.time, log.outputs, log.episodes, log.sampled
    own = [[s.start + np.flatnonzero(sampled[s, k]) for s in episodes] for k in range(len(declared))]
    series = [[outputs[steps, k] for steps in own[k]] for k in range(len(declared))]
    times = [[time[steps] for steps in own[k]] for k in range(len(declared))]
    sd = shared(np.array([noise for noise, _ in noise_and_spacing(series, times)]), attitudes)
    source = ["differences"] * len(declared)
    known_sd = np.array([by if known is None else known for known, by in zip(declared, sd, strict=True)])
    numbers = repeats(time, driven_by, outputs, episodes, known_sd, sampled)
    groups = [[episodes[number] for number in group] for group in numbers]
    smallest = SETTINGS.smallest * outputs.std(axis=0, where=sampled)
    for k, known in enumerate(declared):
        if known is not None:
            sd[k], smallest[k], source[k] = known, 0.0, "declared"
            continue
        if _is_constant(np.concatenate(series[k])):
            sd[k] = smallest[k] = 0.0  # equal numbers are a bit off their own mean, which is no noise
            continue
        common = [_in_common(outputs[:, k], sampled[:, k], g) for g in groups]
        deviations, degrees = from_repeats(common, max(SHORTEST, round(block * sampled[:, k].mean())))
        if degrees >= REPEATS.fewest:
            sd[k], source[k] = trimmed_sd(deviations), "repeats"
        by_steps = scatter_of_steps(series[k])
        if by_steps > sd[k]:
            sd[k], source[k] = by_steps, "resolution"
    source = shared_source(source, sd, attitudes)
    return NoiseFloor(np.maximum(shared(sd, attitudes), shared(smallest, attitudes)), source)


def _is_constant(values: np.ndarray) -> bool:
    """Whether values (sample,) are one and the same but for rounding."""
    return not len(values) or bool(np.ptp(values) <= SETTINGS.rounding * np.abs(values).max())


def _in_common(output: np.ndarray, sampled: np.ndarray, repeated: Sequence[slice]) -> np.ndarray:
    """An output (step,) in episodes that repeat each other, at the steps that all have a sample of, (repeat, step)."""
    common = np.all([sampled[e] for e in repeated], axis=0)
    return np.stack([output[e][common] for e in repeated])


def shared(sd: np.ndarray, attitudes: Sequence[np.ndarray]) -> np.ndarray:
    """Standard deviations (output,), those of the four numbers of each attitude replaced by their root mean square.

    A small turn changes the four by half of it in all; the orientation only says how that is shared out. Near level
    w has next to no noise, and more of it in the moments that the trimming leaves out.
    """
    sd = sd.copy()
    for columns in attitudes:
        sd[columns] = np.sqrt(np.mean(np.square(sd[columns])))
    return sd


def shared_source(source: Sequence[str], sd: np.ndarray, attitudes: Sequence[np.ndarray]) -> tuple[str, ...]:
    """Sources (output,), those of the four numbers of each attitude replaced by that of the noisiest."""
    source = list(source)
    for columns in attitudes:
        noisiest = source[columns[np.argmax(sd[columns])]]
        for k in columns:
            source[k] = noisiest
    return tuple(source)


def least_floor(series: Sequence[np.ndarray]) -> float:
    """The least that the floor of such an output can be: the scatter of its steps, and more than nothing."""
    return max(scatter_of_steps(series), SETTINGS.smallest * float(np.concatenate(series).std()))
