"""Noise that a logger's low-pass has passed, on smooth series, by its power spectrum S over f, in cycles a sample.

Where the motion has ended and the filter does not act yet, S is level, and is so below, where the motion hides it. The
variance of the noise is

    2 (f S(f) + integral of S from f to 1/2),    f where S falls least steeply.

The periodograms of stationary noise are distributed alike in each stretch of a series: exponentially, so that their
mean is their median over ln 2. Those of what a motion leaves at high frequencies are not.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture_cli.common.frozen import frozen


@frozen
class SETTINGS:
    segments: tuple[int, ...] = (128, 64)  # samples, the first that there are enough of
    overlap: int = 4  # segments that have a sample in common
    fewest: int = 8  # segments
    # Differences leave little of the motion, which would leak to where the noise is.
    order: int = 2
    # cycles a sample, between which the spectrum is to be level: motion below, the end of the spectrum above
    lowest: float = 3 / 64
    highest: float = 0.3
    neighbours: int = 3  # of a frequency of the longest segment, on either side, that its slope is told from
    level: float = -1.5  # slope d log S / d log f, from which on it is
    # of that slope: where S is level nowhere, the first is taken that is so near the least steep
    as_level: float = 0.5
    # mean over median, and over that of noise, beyond which what is there is not the same in every stretch
    even: float = 1.1


@dataclass(frozen=True)
class _Spectrum:
    """power (frequency,): S at `frequency` (frequency,), cycles a sample; at: the number of the one where it is level.
    evenness: of the periodograms beyond that, mean over median; 1 of noise.
    """

    frequency: np.ndarray
    power: np.ndarray
    at: int
    slope: float
    evenness: float

    @property
    def level(self) -> float:
        """S where it is level."""
        return float(np.exp(np.log(self.power[self.at - 1 : self.at + 2]).mean()))

    @property
    def variance(self) -> float:
        """Of the noise."""
        beyond = self.power[self.at :].sum() * self.frequency[0]
        return 2 * float(self.frequency[self.at] * self.level + beyond)

    def scaled_from(self, other: "_Spectrum") -> float:
        """The variance where the noise of both has the spectrum of the `other` one but for a factor."""
        beyond = slice(max(self.at, other.at), None)
        return other.variance * float(np.median(self.power[beyond] / other.power[beyond]))


def filtered_noise(series: Sequence[Sequence[np.ndarray]]) -> list[tuple[float, int] | None]:
    """Of each channel the standard deviation of its noise, and of how many samples one has noise of its own; None where
    what is at high frequencies is no noise. series: of each channel evenly sampled stretches, (step,) each.

    A logger has one filter: the channel whose spectrum is the most level tells its shape, also where another moves too
    fast for that.
    """
    spectra = [_spectrum(stretches) for stretches in series]
    even = [s for s in spectra if s is not None and s.evenness < SETTINGS.even]
    if not even:
        return [None] * len(series)
    clearest = max(even, key=lambda s: (min(s.slope, SETTINGS.level), -s.at))
    spacing = int(np.ceil(clearest.level / clearest.variance))
    return [s and (float(np.sqrt(_variance(s, clearest))), spacing) for s in spectra]


def _variance(own: _Spectrum, clearest: _Spectrum) -> float:
    is_clear = own.evenness < SETTINGS.even and own.slope > SETTINGS.level
    if is_clear or len(own.power) != len(clearest.power):
        return own.variance
    return own.scaled_from(clearest)


def _spectrum(stretches: Sequence[np.ndarray]) -> _Spectrum | None:
    """By the median over segments, which leaves out what happens in few of them; None where there are too few."""
    differences = [np.diff(s, SETTINGS.order) for s in stretches]
    for length in SETTINGS.segments:
        segments = [_segments(d, length) for d in differences if len(d) >= length]
        if sum(map(len, segments)) >= SETTINGS.fewest:
            return _level(*_periodograms(np.concatenate(segments)))
    return None


def _segments(series: np.ndarray, length: int) -> np.ndarray:
    return np.lib.stride_tricks.sliding_window_view(series, length)[:: length // SETTINGS.overlap]


def _periodograms(segments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (frequency,), and of what the `segments` (segment, sample) are differences of the periodograms there,
    (segment, frequency).
    """
    from scipy.signal.windows import blackmanharris

    length = segments.shape[1]
    window = blackmanharris(length)
    frequency = np.arange(1, length // 2 + 1) / length
    spectra = np.fft.rfft((segments - segments.mean(axis=1, keepdims=True)) * window, axis=1)[:, 1:]
    passed = (2 * np.sin(np.pi * frequency)) ** (2 * SETTINGS.order)
    return frequency, np.square(np.abs(spectra)) / np.square(window).sum() / passed


def _level(frequency: np.ndarray, periodograms: np.ndarray) -> _Spectrum | None:
    """The spectrum, and where it is level first, or least steep; None of a series without noise."""
    power = np.median(periodograms, axis=0) / np.log(2)
    if not power.all():
        return None
    near = max(1, round(SETTINGS.neighbours * 2 * len(frequency) / SETTINGS.segments[0]))
    inside = np.flatnonzero((frequency >= SETTINGS.lowest) & (frequency < SETTINGS.highest))
    around = inside[:, None] + np.arange(-near, near + 1)
    x, y = np.log(frequency)[around], np.log(power)[around]
    x = x - x.mean(axis=1, keepdims=True)
    slope = (x * y).sum(axis=1) / np.square(x).sum(axis=1)
    number = int(np.argmax(slope > min(SETTINGS.level, slope.max() - SETTINGS.as_level)))
    at = int(inside[number])
    evenness = float(np.median(periodograms.mean(axis=0)[at:] / power[at:]))
    return _Spectrum(frequency, power, at, float(slope[number]), evenness)
