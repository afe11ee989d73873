"""Input signals that excite a machine: sums of sines, and how far an input may be driven."""

from collections.abc import Iterator, Mapping

import mujoco
import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.errors import OptionError, did_you_mean
from capture_cli.model.tasks.base import Channel, Task


@frozen
class SETTINGS:
    lines: int = 12  # sines of a multisine
    fade: float = 0.5  # s
    band: tuple[float, float] = (0.1, 3.0)  # Hz, of a multisine unless told otherwise


def multisine(
    time: np.ndarray, count: int, band: tuple[float, float], generator: np.random.Generator
) -> np.ndarray:
    """`count` sums of sines of random phase, frequencies evenly spread in `band` Hz, peaking at 1; (step, count)."""
    signals = np.zeros((len(time), count))
    for k in range(count):
        frequency = np.linspace(*band, SETTINGS.lines) + (band[1] - band[0]) / SETTINGS.lines * (
            generator.random(SETTINGS.lines) - 0.5
        )
        phase = generator.uniform(0, 2 * np.pi, SETTINGS.lines)
        signals[:, k] = np.sin(2 * np.pi * np.abs(frequency) * time[:, None] + phase).sum(axis=1)
        signals[:, k] /= max(np.abs(signals[:, k]).max(), 1e-12)
    return signals


def multisine_sequence(
    machine: Task,
    time: np.ndarray,
    peaks: np.ndarray,
    band: tuple[float, float],
    generator: np.random.Generator,
    *,
    at_rest: bool = False,
) -> np.ndarray:
    """Inputs (step, input): multisines in `band` Hz that go to `peaks` (input,), as `peak` gives them.

    Where a ctrlrange is not symmetric about 0 they fill what of it is no further from 0 than the peak. at_rest: the
    machine is, so they begin at 0, or as near to it as the actuator goes, and come up over `fade` s.
    """
    signals = multisine(time, len(peaks), band, generator)
    sequence = peaks * (from_rest(time, signals) if at_rest else signals)
    for k, low, high in _limited(machine):
        if low == -high:
            continue
        ends = np.clip([-peaks[k], peaks[k]], low, high)
        sequence[:, k] = np.interp(signals[:, k], [signals[:, k].min(), signals[:, k].max()], ends)
        if at_rest:
            rest, up = np.clip(0.0, low, high), _coming_up(time)
            sequence[:, k] = (1 - up) * rest + up * sequence[:, k]
    return into_range(machine, sequence)


def into_range(machine: Task, sequences: np.ndarray) -> np.ndarray:
    """Sequences (..., input), cut off where an actuator goes no further: a log has what reached it."""
    sequences = sequences.copy()
    for k, low, high in _limited(machine):
        sequences[..., k] = np.clip(sequences[..., k], low, high)
    return sequences


def _limited(machine: Task) -> Iterator[tuple[int, float, float]]:
    """Which inputs have actuators with a ctrlrange, and from where to where that goes."""
    for k, channel in enumerate(machine.inputs):
        if machine.model.actuator_ctrllimited[channel.index]:
            yield k, *machine.model.actuator_ctrlrange[channel.index].tolist()


def from_rest(time: np.ndarray, signals: np.ndarray) -> np.ndarray:
    """Signals (step, count) that begin at 0 and come up over `fade` s, peaking at 1: no jump for a machine at rest."""
    faded = signals * _coming_up(time)[:, None]
    return faded / np.maximum(np.abs(faded).max(axis=0), 1e-12)


def _coming_up(time: np.ndarray) -> np.ndarray:
    """From 0 to 1 in `fade` s, (step,)."""
    return 0.5 - 0.5 * np.cos(np.pi * np.minimum((time - time[0]) / SETTINGS.fade, 1.0))


def check_amplitude(machine: Task, amplitude: Mapping[str, float]) -> None:
    """Raise OptionError where --amplitude names no input, or is more than its actuator takes: MuJoCo would clip it."""
    names = [c.name for c in machine.inputs]
    for name in set(amplitude) - set(names):
        raise OptionError(f"--amplitude: the task has no input {name!r}", cure=did_you_mean(name, names))
    for k, low, high in _limited(machine):
        name, unit, farthest = machine.inputs[k].name, machine.inputs[k].unit, max(-low, high)
        if abs(amplitude.get(name, 0.0)) > farthest:
            raise OptionError(
                f"--amplitude {name}={amplitude[name]:g}: its actuator's ctrlrange, {low:g} to {high:g} {unit}, ends "
                "before that",
                cure=f"give {farthest:g} at most, leave it out to go as far as the actuator does, or widen ctrlrange "
                "in the model if the machine takes more",
            )


def check_above_zero(machine: Task, amplitude: Mapping[str, float], otherwise: str) -> None:
    """Raise OptionError where --amplitude is no distance: of -3 nobody knows what is meant, 0 tells nothing.

    otherwise: as far as what the input goes where it is left out.
    """
    units = {c.name: c.unit for c in machine.inputs}
    for name, farthest in amplitude.items():
        if not farthest > 0:
            raise OptionError(
                f"--amplitude {name}={farthest:g}: how far from 0 the input may be driven is a number above 0",
                cure=f"give a number above 0, in {units[name]}, or leave it out to go as far as {otherwise}",
            )


def check_band(band: tuple[float, float]) -> None:
    """Raise OptionError where --band is no range of frequencies in Hz."""
    low, high = band
    if not 0 <= low < high < np.inf:
        raise OptionError(f"--band {low:g} {high:g}", cure="give two frequencies in Hz, the lower one first")


def peaks(machine: Task, amplitude: Mapping[str, float]) -> np.ndarray:
    """How far from 0 each input is driven, (input,), as of `peak`."""
    return np.array([peak(machine.model, channel, amplitude) for channel in machine.inputs])


def peak(model: mujoco.MjModel, channel: Channel, amplitude: Mapping[str, float]) -> float:
    """How far from 0 an input is driven: as `amplitude` (by name) says, otherwise as far as its actuator goes.

    Raises OptionError where neither is known, or the actuator does not come so near to 0.
    """
    limited = bool(model.actuator_ctrllimited[channel.index])
    low, high = model.actuator_ctrlrange[channel.index].tolist()
    if channel.name in amplitude:
        farthest, nearest = amplitude[channel.name], max(low, -high)
        if limited and abs(farthest) < nearest:
            raise OptionError(
                f"input {channel.name!r} is to go no further than {farthest:g} {channel.unit}, and its actuator's "
                f"ctrlrange, {low:g} to {high:g}, begins beyond that",
                cure=f"give --amplitude {channel.name}=VALUE of more than {nearest:g}",
            )
        return farthest
    if limited:
        return max(-low, high)
    raise OptionError(
        f"how far to drive input {channel.name!r} is not known: its actuator has no ctrlrange",
        cure=f"add --amplitude {channel.name}=VALUE (in {channel.unit})",
    )
