"""Input signals that excite a machine: sums of sines, and how far an input may be driven. Shared by stages."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from capture_cli.errors import OptionError
from capture_cli.tasks.base import Channel

LINES = 12  # sines of a multisine
FADE = 0.5  # s
BAND = (0.1, 3.0)  # Hz, of a multisine unless told otherwise


def multisine(
    time: np.ndarray, count: int, band: tuple[float, float], generator: np.random.Generator
) -> np.ndarray:
    """`count` sums of sines of random phase, frequencies evenly spread in `band` Hz, peaking at 1; (step, count)."""
    signals = np.zeros((len(time), count))
    for k in range(count):
        frequency = np.linspace(*band, LINES) + (band[1] - band[0]) / LINES * (generator.random(LINES) - 0.5)
        phase = generator.uniform(0, 2 * np.pi, LINES)
        signals[:, k] = np.sin(2 * np.pi * np.abs(frequency) * time[:, None] + phase).sum(axis=1)
        signals[:, k] /= max(np.abs(signals[:, k]).max(), 1e-12)
    return signals


def from_rest(time: np.ndarray, signals: np.ndarray) -> np.ndarray:
    """Signals (step, count) that begin at 0 and come up over FADE s, peaking at 1: no jump for a machine at rest."""
    faded = signals * (0.5 - 0.5 * np.cos(np.pi * np.minimum((time - time[0]) / FADE, 1.0)))[:, None]
    return faded / np.maximum(np.abs(faded).max(axis=0), 1e-12)


def peak(model: mujoco.MjModel, channel: Channel, amplitude: Mapping[str, float]) -> float:
    """How far an input is driven: as `amplitude` (by name) says, otherwise as far as its actuator goes.

    Raises OptionError where neither is known.
    """
    if channel.name in amplitude:
        return amplitude[channel.name]
    if model.actuator_ctrllimited[channel.index]:
        return float(np.abs(model.actuator_ctrlrange[channel.index]).min())
    raise OptionError(
        f"how far to drive input {channel.name!r} is not known: its actuator has no ctrlrange",
        cure=f"add --amplitude {channel.name}=VALUE (in {channel.unit})",
    )
