"""Whether what no physics would leave is a channel read with a wrong sign or unit, or from another's column."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from capture_cli.common.evenly_spread import evenly_spread
from capture_cli.common.frozen import frozen
from capture_cli.errors import CaptureError
from capture_cli.estimate.model_fits import Effort, ModelFits
from capture_cli.estimate.prepare import Excerpt, prepare
from capture_cli.estimate.prepared_log import PreparedLog, attitudes
from capture_cli.estimate.split import NewSplit
from capture_cli.model.quaternion_order import SETTINGS as QUATERNION_ORDER
from capture_cli.model.quaternion_order import order_in_names
from capture_cli.model.tasks.base import Channel, Task

FACTORS = {  # by which a channel may have to be multiplied
    -1.0: "times -1",
    1e-3: "times 0.001",
    1e3: "times 1000",
    np.pi / 180: "times pi/180, as what is in degrees",
    180 / np.pi: "times 180/pi, as what is in radians already",
    np.pi / 30: "times pi/30, as what is in turns a minute",
}


@frozen
class SETTINGS:
    # Windows and rounds of a fit: to each reading, to the best share of them, and to the best of these
    screening: tuple[int, int] = (3, 3)
    second_screening: tuple[int, int] = (6, 6)
    look: tuple[int, int] = (12, 15)
    best: float = 0.25
    looked_at: int = 4
    better: float = 0.3  # of what the fit leaves as the log was read
    # of the motion: a model that leaves more, read so, does not tell how the log is to be read
    right: float = 0.25
    as_good: float = 1.5  # times what the best reading leaves: another that may be meant
    most_pairs: int = 56  # of channels that are exchanged: all of eight in each of two units
    above: float = 3.0  # times the noise floor: an output that moves less does not
    largest_share: float = 3.0  # of the motion of one output: beyond it is nonsense, however far


@dataclass(frozen=True)
class Reading:
    """How a log may have to be read: the channels of one `kind`, "inputs" or "outputs", multiplied by `factor`, or from
    other `columns`, one each; None where from their own.
    """

    kind: str
    channels: tuple[str, ...]
    factor: float = 1.0
    columns: tuple[str, ...] | None = None

    @property
    def text(self) -> str:
        if self.columns is None:
            return f"{', '.join(self.channels)} {FACTORS[self.factor]}"
        return ", ".join(
            f"{c} from {column!r}" for c, column in zip(self.channels, self.columns, strict=True)
        )

    def cure(self, task: Task) -> str:
        """What to write in the task file; of a sensor of several values, which are one output there, that it is to be
        mended.
        """
        own = {c.name: c for c in getattr(task, self.kind)}
        if self.kind == "outputs" and any(task.model.sensor_dim[own[c].sensor] > 1 for c in self.channels):
            return "Mend that in the task file"
        if self.columns is None:
            values = [f"scale = {own[c].scale * self.factor:.10g}" for c in self.channels]
        else:
            values = [f'column = "{column}"' for column in self.columns]
        lines = [f"`{v}` below [{self.kind}.{c}]" for c, v in zip(self.channels, values, strict=True)]
        return f"Write {', '.join(lines)} in the task file"


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

    def text(self, task: Task) -> str:
        """A sentence, with what to write in the file of the `task`."""
        first = "" if len(self.readings) == 1 else " for the first of these"
        return (
            f"As the log was read, a fit is off by {100 * self.before:.0f} % of the motion within windows, and by "
            f"{100 * self.after:.2g} % with {', or with '.join(r.text for r in self.readings)}. "
            f"{self.readings[0].cure(task)}{first}, and import the log again."
        )


def misread_channels(
    prepared: PreparedLog, window: float | None, threads: int | None, on_step: Callable[[int, int], None]
) -> tuple[Misread | None, int]:
    """The channels without whose misreading a fit from the nominal values would leave far less of what is fitted, None
    where there are none; and how many windows were simulated for it.

    window: s, as the log was cut. on_step (done, of how many).
    """
    looks = _Looks(prepared, window, threads)
    shares = looks.shares(prepared, *SETTINGS.look)
    before = _total(shares)
    orders = list(_orders(prepared.task))
    others = [Reading(*group, factor) for group in _groups(prepared.task) for factor in FACTORS]
    others += _exchanges(prepared.task, shares)
    total = len(orders) + len(others) + _of_best(others)
    # an attitude that is turned about leaves nothing to see of the others
    for first, ways in ((0, orders), (len(orders), others)):

        def tell(number: int, first: int = first) -> None:
            on_step(first + number, total)

        tell(0)
        best = looks.promising(ways, tell)
        left = sorted((looks.left(way, *SETTINGS.look), k) for k, way in enumerate(best))
        if left and left[0][0] < min(SETTINGS.better * before, SETTINGS.right):
            least = left[0][0]
            readings = tuple(best[k] for after, k in left if after < SETTINGS.as_good * least)
            return Misread(readings, before, least), looks.rollouts
    return None, looks.rollouts


class _Looks:
    """What fits from the nominal values leave of a few of the windows that are fitted, of a log that is read otherwise.

    rollouts: how many windows were simulated so far.
    """

    def __init__(self, prepared: PreparedLog, window: float | None, threads: int | None):
        self.prepared, self.window, self.threads = prepared, window, threads
        self.fitted = np.flatnonzero(~prepared.split.is_test)
        self.rollouts = 0

    def promising(self, ways: Sequence[Reading], on_step: Callable[[int], None]) -> Sequence[Reading]:
        """Those of `ways` that leave least in a screening; all where they are few. on_step (number of a screening)."""
        done = 0
        for screening, most in (
            (SETTINGS.screening, _of_best(ways)),
            (SETTINGS.second_screening, SETTINGS.looked_at),
        ):
            if len(ways) <= most:
                continue
            left = []
            for number, way in enumerate(ways, start=done):
                on_step(number)
                left.append(self.left(way, *screening))
            done += len(ways)
            ways = [ways[i] for i in np.argsort(left, kind="stable")[:most]]
        return ways

    def left(self, way: Reading, windows: int, rounds: int) -> float:
        """Share of the motion that a fit leaves of the log read so, cut as it is; inf where it cannot be read so.

        Differences are as long as of the log as it was read: to see how long they have to be costs more than the fit.
        """
        prepared = self.prepared
        read = _values(getattr(prepared.task, way.kind), getattr(prepared.log, way.kind), way)
        log = replace(prepared.log, **{way.kind: read})
        excerpt = Excerpt(self._few(windows), prepared.difference_step)
        how = {"window": self.window, "split": NewSplit("none"), "threads": self.threads}
        try:
            part = prepare(log, prepared.task, **how, excerpt=excerpt)
        except CaptureError:
            return np.inf
        return _total(self._shares(part, rounds))

    def shares(self, whole: PreparedLog, windows: int, rounds: int) -> np.ndarray:
        """Share of the motion of each output that a fit to so many windows leaves, (output,), `largest_share` at most,
        NaN of those that do not move and inf where every trial diverges.
        """
        return self._shares(whole.part(self._few(windows)), rounds)

    def _few(self, windows: int) -> np.ndarray:
        return self.fitted[evenly_spread(len(self.fitted), windows)]

    def _shares(self, part: PreparedLog, rounds: int) -> np.ndarray:
        fits = ModelFits(part, self.threads)
        fit = fits.fit(part, [], part.task.space.nominal, effort=Effort(rounds=rounds))
        self.rollouts += fits.rollouts
        if fit is None:
            return np.full(len(part.task.outputs), np.inf)
        return _shares(part, fit.at.residual.reshape(part.windows.measured.shape) * part.noise.sd)


def _of_best(ways: Sequence[Reading]) -> int:
    """How many of so many are screened once more."""
    return max(SETTINGS.looked_at, round(SETTINGS.best * len(ways)))


def _values(channels: Sequence[Channel], values: np.ndarray, way: Reading) -> np.ndarray:
    """The log's inputs or outputs (step, channel), whichever are read anew, as they are then."""
    values = values.copy()
    number = {c.name: k for k, c in enumerate(channels)}
    own = [number[name] for name in way.channels]
    if way.columns is None:
        values[:, own] *= way.factor
        return values
    number = {channels[k].column: k for k in own}
    others = [number[column] for column in way.columns]
    scale, offset = (np.array([getattr(c, key) for c in channels]) for key in ("scale", "offset"))
    columns = (values[:, others] - offset[others]) / scale[others]
    values[:, own] = scale[own] * columns + offset[own]
    return values


def _groups(task: Task) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Each channel, and those of one kind and unit together: who forgets a factor forgets it of all joints.

    Not those of attitudes, whose four numbers have no scale.
    """
    turned = {k for attitude in attitudes(task) for k in attitude.tolist()}
    outputs = [c for k, c in enumerate(task.outputs) if k not in turned]
    for kind, channels in (("inputs", task.inputs), ("outputs", outputs)):
        by_unit: dict[str, list[str]] = {}
        for channel in channels:
            by_unit.setdefault(channel.unit, []).append(channel.name)
            yield kind, (channel.name,)
        yield from ((kind, tuple(names)) for names in by_unit.values() if len(names) > 1)


def _exchanges(task: Task, shares: np.ndarray) -> Iterator[Reading]:
    """Two channels of one unit, and all that two joints or sites report, with each other's columns: a message of joint
    states often has another order than the model.

    shares (output,): what a fit leaves of the log as it was read.
    """
    turned = {k for attitude in attitudes(task) for k in attitude.tolist()}
    error = dict(zip((c.name for c in task.outputs), np.nan_to_num(shares, posinf=0.0), strict=True))
    yield from _exchanged("inputs", [{"": c} for c in task.inputs], {})
    yield from _exchanged("outputs", [{"": c} for k, c in enumerate(task.outputs) if k not in turned], error)
    model, objects = task.model, {}
    for c in task.outputs:
        of = (int(model.sensor_objtype[c.sensor]), int(model.sensor_objid[c.sensor]))
        what = (int(model.sensor_type[c.sensor]), c.index - int(model.sensor_adr[c.sensor]))
        objects.setdefault(of, {})[what] = c
    yield from _exchanged("outputs", [o for o in objects.values() if len(o) > 1], error)


def _exchanged(
    kind: str, things: Sequence[Mapping[object, Channel]], error: Mapping[str, float]
) -> Iterator[Reading]:
    """Each two of `things` that say the same with each other's columns: those of the largest error first, then
    neighbours.

    things: the channels of each, by what they say. error: of channels by name; 0 where there is none.
    """
    said = [{what: (c.unit, c.sparse) for what, c in thing.items()} for thing in things]
    size = [max(error.get(c.name, 0.0) for c in thing.values()) for thing in things]
    pairs = [(a, b) for a, b in combinations(range(len(things)), 2) if said[a] == said[b]]
    for pair in sorted(pairs, key=lambda p: (-size[p[0]] - size[p[1]], p[1] - p[0]))[: SETTINGS.most_pairs]:
        one, other = (things[k] for k in pair)
        channels = [*one.values(), *(other[what] for what in one)]
        columns = tuple(c.column for c in channels)
        if len(set(columns)) == len(columns):
            half = len(one)
            names = tuple(c.name for c in channels)
            yield Reading(kind, names, columns=columns[half:] + columns[:half])


def _orders(task: Task) -> Iterator[Reading]:
    """Attitudes whose columns are in another order: the one that their names say, and w last."""
    for own in attitudes(task):
        channels = [task.outputs[k] for k in own]
        columns = [c.column for c in channels]
        if len(set(columns)) < len(columns):
            continue
        for order in dict.fromkeys((order_in_names(columns), QUATERNION_ORDER.w_last)):
            if order not in (None, QUATERNION_ORDER.w_first):
                read_from = tuple(columns[k] for k in order)
                yield Reading("outputs", tuple(c.name for c in channels), columns=read_from)


def _shares(part: PreparedLog, residual: np.ndarray) -> np.ndarray:
    """Root mean square of the residual (window, step, output) over that of the motion within windows, (output,).

    NaN of outputs that do not move: what noise there is says nothing. inf of all where none does.
    """
    sampled = part.windows.sampled
    count = np.maximum(sampled.sum(axis=1, keepdims=True), 1)
    mean = np.where(sampled, part.windows.measured, 0.0).sum(axis=1, keepdims=True) / count
    left, moved = (
        np.square(np.where(sampled, values, 0.0)).sum(axis=(0, 1))
        for values in (residual, part.windows.measured - mean)
    )
    moves = moved > np.square(SETTINGS.above * part.noise.sd) * sampled.sum(axis=(0, 1))
    if not moves.any():
        return np.full(len(moves), np.inf)
    shares = np.sqrt(left / np.maximum(moved, np.finfo(float).tiny))
    return np.where(moves, np.minimum(shares, SETTINGS.largest_share), np.nan)


def _total(shares: np.ndarray) -> float:
    """Of all outputs that move the root mean square, whatever their units."""
    return float(np.sqrt(np.nanmean(np.square(shares))))
