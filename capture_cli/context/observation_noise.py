"""Noise on what is measured, never on what is simulated (paper, Appendix: noisy observations).

A pair's noise comes from its own generator and takes the same number of draws in every round, so that it is the same
however pairs are grouped, and whether its rounds are made at once or one after the other.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.errors import OptionError, did_you_mean


@frozen
class SETTINGS:
    label_every: int = 3  # rounds; the last of three is random
    labels: int = 3
    least_error_rate: float = 1e-3  # of labels that are right: nobody is that sure
    scale_spread: float = 0.1


def apply(
    name: str, measured: np.ndarray, generators: Sequence[np.random.Generator], first_round: int = 0
) -> np.ndarray:
    """State trajectories (pair, round, point, feature) with the noise `name`; a new array.

    generators: one per pair. first_round: the number of the first of these rounds, where earlier ones were made
    before with the same generators. Raises OptionError for an unknown name.
    """
    noise = _find(name)
    uniform = [generator.random(measured.shape[1:]) for generator in generators]
    return noise(measured, np.reshape(uniform, measured.shape), first_round)


def error_rate(name: str) -> Callable[[int], float]:
    """How often the label of round n (0, 1, ...) is wrong. Raises OptionError where `name` is no noise of labels."""
    if _find(name) is not _label:
        raise OptionError(
            f"--known-noise with the noise {name!r}",
            cure="it is for labels: take the noise 'label', or leave it out",
        )
    return lambda number: 1 - 1 / SETTINGS.labels if _is_random(number) else SETTINGS.least_error_rate


def check(name: str, features: Iterable[str]) -> None:
    """Raise OptionError where there is no noise `name`, or none for a trajectory of these features."""
    features = tuple(features)
    if _find(name) is _label and features != ("label",):
        raise OptionError(
            f"the noise 'label' is for tasks that observe a label, and this one observes {', '.join(features)}",
            cure="take the noise 'scale', or 'none'",
        )


def white_sd(name: str, sizes: np.ndarray) -> np.ndarray:
    """Standard deviation of the noise `name` on values of these root mean squares, an array of their shape.

    0 for labels: what is wrong there is another label, and no distance.
    """
    return sizes * SETTINGS.scale_spread / math.sqrt(3) if _find(name) is _scale else np.zeros_like(sizes)


def _label(measured: np.ndarray, uniform: np.ndarray, first_round: int) -> np.ndarray:
    """Every third label is drawn from -1, 0, 1."""
    number = first_round + np.arange(measured.shape[1])
    return np.where(_is_random(number)[:, None, None], np.floor(SETTINGS.labels * uniform) - 1, measured)


def _is_random(number):
    return number % SETTINGS.label_every == SETTINGS.label_every - 1


def _scale(measured: np.ndarray, uniform: np.ndarray, first_round: int) -> np.ndarray:
    """Every value is multiplied by a factor of its own from U(0.9, 1.1)."""
    return measured * (1 + SETTINGS.scale_spread * (2 * uniform - 1))


NOISES: dict[str, Callable[[np.ndarray, np.ndarray, int], np.ndarray]] = {
    "none": lambda measured, _uniform, _first_round: measured.copy(),
    "label": _label,
    "scale": _scale,
}


def _find(name: str) -> Callable[[np.ndarray, np.ndarray, int], np.ndarray]:
    if name not in NOISES:
        raise OptionError(f"unknown noise {name!r}", cure=did_you_mean(name, NOISES))
    return NOISES[name]


def standard_deviations(
    option: str, given: Mapping[str, float] | float, names: Sequence[str], unknown: str
) -> tuple[float, ...]:
    """Standard deviation in SI units per name, 0 for those without one.

    given: of `option`, per name or one for all. unknown: says of what there is none of a name that is not among
    `names`. Raises OptionError for such a name, and for what is no standard deviation.
    """
    if isinstance(given, int | float):
        given = dict.fromkeys(names, float(given))
    for name, sd in given.items():
        if name not in names:
            raise OptionError(f"{option}: {unknown} {name!r}", cure=did_you_mean(name, names))
        if not 0 <= sd < math.inf:
            raise OptionError(
                f"{option} {name}={sd:g}", cure="give a standard deviation of 0 or more, in SI units"
            )
    return tuple(float(given.get(name, 0.0)) for name in names)
