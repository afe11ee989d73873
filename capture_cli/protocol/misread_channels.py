"""Whether what no physics would leave is a channel that was read with a wrong sign or in a wrong unit."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from capture_cli.errors import CaptureError
from capture_cli.protocol.model_fits import ModelFits
from capture_cli.protocol.prepare import prepare
from capture_cli.protocol.prepared_log import PreparedLog, attitudes

FACTORS = {  # by which a channel may have to be multiplied
    -1.0: "times -1",
    1e-3: "times 0.001",
    1e3: "times 1000",
    np.pi / 180: "times pi/180, as what is in degrees",
    180 / np.pi: "times 180/pi, as what is in radians already",
    np.pi / 30: "times pi/30, as what is in turns a minute",
}
GLANCE, LOOK = (6, 6), (12, 15)  # windows and rounds of a fit: to each reading, and to the best of them
LOOKED_AT = 4  # of the best at a glance
BETTER = 0.3  # of what the fit leaves as the log was read
RIGHT = 0.25  # of the motion: a model that leaves more, read so, does not tell how the log is to be read
AS_GOOD = 1.5  # times what the best reading leaves: another that may be meant
LARGEST_SHARE = 3.0  # of the motion of one output: beyond it is nonsense, however far


@dataclass(frozen=True)
class Reading:
    """How a log may have to be read: the channels of one `kind`, "inputs" or "outputs", multiplied by `factor`."""

    kind: str
    channels: tuple[str, ...]
    factor: float

    @property
    def text(self) -> str:
        return f"{', '.join(self.channels)} {FACTORS[self.factor]}"


@dataclass(frozen=True)
class Misread:
    """readings: those that would do, best first: of a machine that is alike in both directions a motor's sign is as
    good as a sensor's.

    before, after: what a fit leaves of the motion within windows, root mean square, of the log as it was read, and of
    the best of these.
    """

    readings: tuple[Reading, ...]
    before: float
    after: float

    @property
    def text(self) -> str:
        return (
            f"As the log was read, a fit is off by {100 * self.before:.0f} % of the motion within windows, and by "
            f"{100 * self.after:.2g} % with {', or with '.join(r.text for r in self.readings)}: mend that scale in the "
            "task file, and import the log again."
        )


def misread_channels(
    prepared: PreparedLog, window: float | None, threads: int | None, on_step: Callable[[int, int], None]
) -> tuple[Misread | None, int]:
    """The channels without whose misreading a fit from the nominal values would leave far less of what is fitted, None
    where there are none; and how many windows were simulated for it.

    window: s, as the log was cut. on_step (done, of how many).
    """
    fitted = np.flatnonzero(~prepared.split.is_test)
    rollouts = []

    def read(way: Reading) -> PreparedLog | None:
        """The log read so, cut as it is; None where it cannot be."""
        own = [c.name in way.channels for c in getattr(prepared.task, way.kind)]
        values = np.where(own, way.factor, 1.0) * getattr(prepared.log, way.kind)
        log = replace(prepared.log, **{way.kind: values})
        try:
            part = prepare(log, prepared.task, window=window, test="none", seed=0, threads=threads)
        except CaptureError:
            return None
        rollouts.append(part.rollouts)
        return part

    def left(part: PreparedLog | None, windows: int, rounds: int) -> float:
        if part is None:
            return np.inf
        few = fitted[np.unique(np.linspace(0, len(fitted) - 1, windows).astype(int))]
        share, spent = _left(part.part(few), rounds, threads)
        rollouts.append(spent)
        return share

    ways = [Reading(*group, factor) for group in _groups(prepared) for factor in FACTORS]
    at_a_glance = []
    for done, way in enumerate(ways):
        on_step(done, len(ways))
        at_a_glance.append(left(read(way), *GLANCE))
    best = [ways[i] for i in np.argsort(at_a_glance, kind="stable")[:LOOKED_AT]]
    looked_at = sorted((left(read(way), *LOOK), k) for k, way in enumerate(best))
    before, least = left(prepared, *LOOK), looked_at[0][0]
    if least >= min(BETTER * before, RIGHT):
        return None, sum(rollouts)
    readings = tuple(best[k] for after, k in looked_at if after < AS_GOOD * least)
    return Misread(readings, before, least), sum(rollouts)


def _groups(prepared: PreparedLog) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Each channel, and those of one kind and unit together: who forgets a factor forgets it of all joints.

    Not those of attitudes, whose four numbers have no scale.
    """
    task = prepared.task
    turned = {k for attitude in attitudes(task) for k in attitude.tolist()}
    outputs = [c for k, c in enumerate(task.outputs) if k not in turned]
    for kind, channels in (("inputs", task.inputs), ("outputs", outputs)):
        by_unit: dict[str, list[str]] = {}
        for channel in channels:
            by_unit.setdefault(channel.unit, []).append(channel.name)
            yield kind, (channel.name,)
        yield from ((kind, tuple(names)) for names in by_unit.values() if len(names) > 1)


def _left(part: PreparedLog, rounds: int, threads: int | None) -> tuple[float, int]:
    """Share of the motion that a fit from the nominal values leaves, inf where every trial diverges; and how many
    windows it simulated.
    """
    fits = ModelFits(part, threads)
    fit = fits.fit(part, [], part.task.space.nominal, rounds=rounds)
    if fit is None:
        return np.inf, fits.rollouts
    residual = fit.at.residual.reshape(part.windows.measured.shape) * part.noise.sd
    return _share(part, residual), fits.rollouts


def _share(part: PreparedLog, residual: np.ndarray) -> float:
    """Root mean square over that of the motion within windows; residual (window, step, output). Of all outputs the
    mean square, whatever their units.
    """
    sampled = part.windows.sampled
    count = np.maximum(sampled.sum(axis=1, keepdims=True), 1)
    mean = np.where(sampled, part.windows.measured, 0.0).sum(axis=1, keepdims=True) / count
    left, moved = (
        np.square(np.where(sampled, values, 0.0)).sum(axis=(0, 1))
        for values in (residual, part.windows.measured - mean)
    )
    shares = np.sqrt(left / np.maximum(moved, np.finfo(float).tiny))
    return float(np.sqrt(np.square(np.minimum(shares, LARGEST_SHARE)).mean()))
