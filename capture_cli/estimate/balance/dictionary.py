"""Every effect that could act, at values of its nonlinear parameters, as columns of the force balance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.common.similarity import similarity
from capture_cli.estimate.balance.force_balance import ForceBalance
from capture_cli.estimate.balance.forward_dynamics import Accelerations
from capture_cli.model.effects._periodic_force import PeriodicForce
from capture_cli.model.effects.base import Effect
from capture_cli.model.effects.placed import Placed


@frozen
class SETTINGS:
    """shapes: values of one nonlinear parameter; shapes_of_several: of each where there are two, and of more one in the
    middle, for the fit moves them; most_shapes: with those between neighbours whose columns have a cosine below `near`.
    periods: of a force that repeats. step: of an amplitude's range, at which a column is taken; far_steps: of effects
    that remember; same_way: the cosine of columns at the first and at the last step beyond which none is taken between.
    beyond_onset: of effects with a threshold, below which they do nothing, likewise: of the range from where they begin
    to; and halvings: by which that is found; of_threshold: a standard deviation of such a column's coefficient about 1,
    for the steps are some 1.6 to 2.6 times apart. known: of its range, how large an amplitude may be beforehand, a
    standard deviation: ranges are guesses, but within some times. largest: acceleration by a step, over the largest
    that the model predicts: what is beyond it has run away. linear: of what an effect does, by which a step and its
    reverse may differ to be one column. rounding: of the largest that the model predicts, below which a column is none.
    """

    shapes: int = 6
    shapes_of_several: int = 3
    most_shapes: int = 32
    near: float = 0.8
    periods: int = 160
    step: float = 0.02
    far_steps: tuple[float, ...] = (0.1, 0.3, 0.7)
    same_way: float = 0.98
    beyond_onset: tuple[float, ...] = (0.03, 0.08, 0.16, 0.3, 0.5, 0.75)
    halvings: int = 5
    of_threshold: float = 0.5
    known: float = 3.0
    largest: float = 1e3
    linear: float = 0.05
    rounding: float = 1e-10


@dataclass(frozen=True)
class Atom:
    """An effect at values (parameter,) of its nonlinear parameters, null in the others: one column for each amplitude.
    Of one with a threshold a column is what the effect does there: its coefficient is about 1.

    amplitudes: which parameters those are; after their columns come those of `apart` amplitudes that other recordings
    have for themselves, which belong to no parameter. unit (amplitude,): what a coefficient of 1 is of each, in its
    range, of which it is the `share`; known (amplitude,): how large coefficients may be beforehand, a standard
    deviation. one_way: of an effect that does not do the reverse at the reverse: friction never drives.
    """

    placed: Placed
    values: np.ndarray
    amplitudes: tuple[int, ...]
    unit: np.ndarray
    known: np.ndarray
    one_way: bool = False
    apart: int = 0
    share: float = 0.0

    @property
    def scale(self) -> np.ndarray:
        """How large a coefficient of each column may be beforehand, (column,)."""
        return np.resize(self.known, len(self.amplitudes) + self.apart)

    @property
    def expected(self) -> np.ndarray:
        """The coefficient of each column beforehand, over how far from that it may be, (column,)."""
        return self.placed.effect.has_threshold / self.scale

    def alone(self, columns: Sequence[Accelerations]) -> Iterator[tuple[Atom, list[Accelerations]]]:
        """Each amplitude by itself, the others null, where there are several and not every sign is allowed."""
        space, own = self.placed.effect.space, list(self.amplitudes)
        null = self.values[own]
        if len(own) == 1 or ((space.low[own] < null) & (space.high[own] > null)).all():
            return
        for k, index in enumerate(own):
            one = slice(k, k + 1)
            yield replace(self, amplitudes=(index,), unit=self.unit[one], known=self.known[one]), [columns[k]]

    def amplitudes_by(self, coefficients: np.ndarray) -> np.ndarray:
        """Those of its amplitudes, (amplitude,), of coefficients of all of its columns, (column,), over `scale`."""
        return coefficients[: len(self.known)] * self.known

    def allows(self, coefficients: np.ndarray) -> bool:
        """Whether coefficients (amplitude,) have the signs that the effect's range allows, and the atom's own."""
        if self.one_way and (coefficients < 0).any():
            return False
        space, own = self.placed.effect.space, list(self.amplitudes)
        wanted = self.values[own] + coefficients * self.unit
        null = self.values[own]
        below, above = space.low[own] < null, space.high[own] > null
        return bool(np.all(np.where(wanted < null, below, above)))

    def at(self, coefficients: np.ndarray) -> np.ndarray:
        """Values (parameter,) with coefficients (amplitude,), within the effect's range."""
        effect = self.placed.effect
        space, found = effect.space, self.values.copy()
        # a threshold is where the column was taken: what it cuts off is not in proportion to it
        steps = (coefficients > 0) if effect.has_threshold else coefficients
        found[list(self.amplitudes)] += steps * self.unit
        return np.clip(found, space.low, space.high)


@dataclass(frozen=True)
class Mixture(Atom):
    """An effect that `mixes`, with an amplitude at each of several `shapes` (shape, parameter): what does as all those
    together do.
    """

    shapes: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    def allows(self, coefficients: np.ndarray) -> bool:
        return self._whole(coefficients) is not None

    def at(self, coefficients: np.ndarray) -> np.ndarray:
        space = self.placed.effect.space
        return np.clip(self._whole(coefficients), space.low, space.high)

    def _whole(self, coefficients: np.ndarray) -> np.ndarray | None:
        effect, [index] = self.placed.effect, set(self.amplitudes)
        return effect.mixture(self.shapes, coefficients * self.unit / effect.space.span[index])


def atoms(balance: ForceBalance, placed: Placed) -> Iterator[tuple[Atom, list[Accelerations]]]:
    """Atoms of an effect, each with what a unit of each amplitude does to the balance; none where nothing tells."""
    effect = placed.effect
    space = effect.space
    amplitudes = tuple(i for i, n in enumerate(space.names) if n not in effect.shapes)
    if not amplitudes or (effect.place == "force" and effect.reported):
        return  # of a force that moves its own sensors the reported motion is not the joint's
    if effect.shows_at_rest or acts_unshown(balance, effect):
        return
    if isinstance(effect, PeriodicForce):
        yield from _repeating(balance, placed, amplitudes)
        return
    points, shares = _shapes(effect), _shares(effect)
    found = _usable(balance, placed, points, amplitudes, shares)
    if _may_saturate(effect) and not _do_the_same(found, shares):
        between = (-SETTINGS.step, *SETTINGS.far_steps[:-1])
        found += _usable(balance, placed, points, amplitudes, between)
        shares += between
    if not (effect.has_threshold or effect.mixes) and 1 <= len(effect.shapes) <= 2:
        found += _resolved(balance, placed, found, amplitudes, shares)
    if effect.mixes and len(found) > 1:
        yield _mixture(found)
    at_steps = {(atom.values.tobytes(), atom.share): columns for atom, columns in found}
    for atom, columns in found:
        reverse = at_steps.get((atom.values.tobytes(), -atom.share))
        if reverse and not _is_reverse(columns, reverse, SETTINGS.linear):
            atom = replace(atom, one_way=True)
        elif reverse and atom.unit[0] < 0:
            continue
        yield atom, columns
        yield from atom.alone(columns)


def _usable(
    balance: ForceBalance,
    placed: Placed,
    points: np.ndarray,
    amplitudes: tuple[int, ...],
    shares: Sequence[float],
) -> list[tuple[Atom, list[Accelerations]]]:
    """Atoms of an effect at the shapes of these points (point, parameter), with steps of these `shares` of the
    amplitudes' ranges, that do something, and nothing absurd.
    """
    space, own = placed.effect.space, list(amplitudes)
    size = np.abs(balance.null.predicted).max()
    largest, least = SETTINGS.largest * size, SETTINGS.rounding * size
    values, owners = [], []
    for point in points:
        onset = _onset(balance, placed.effect, point, amplitudes, least)
        for share in shares:
            reach = onset + (1 - onset) * share
            units = np.array([_reach(space, point, i, s) for i, s in zip(amplitudes, reach, strict=True)])
            if ((point[own] + units < space.low[own]) | (point[own] + units > space.high[own])).any():
                continue
            known = SETTINGS.known * space.span[own] / np.abs(units)
            if placed.effect.has_threshold:
                known = np.full(len(own), SETTINGS.of_threshold)
            owners.append(Atom(placed, point, amplitudes, units, known, share=share))
            values += [
                point + np.eye(len(point))[i] * unit for i, unit in zip(amplitudes, units, strict=True)
            ]
    if not owners:
        return []
    changes = iter(balance.of_effect(placed.effect, np.array(values)))
    found = [(atom, [next(changes) for _ in amplitudes]) for atom in owners]
    return [(atom, columns) for atom, columns in found if _can_be_compared(columns, largest, least)]


def _resolved(
    balance: ForceBalance,
    placed: Placed,
    known: Sequence[tuple[Atom, list[Accelerations]]],
    amplitudes: tuple[int, ...],
    shares: Sequence[float],
) -> list[tuple[Atom, list[Accelerations]]]:
    """Atoms between the `known` shapes whose columns have little in common: what swings at 3 Hz for 3 s is not seen at
    4. At one step where the known columns are the same at all `shares` but for their size and sign.
    """
    count, found = len({atom.values.tobytes() for atom, _ in known}), []
    alike = np.abs(_cosines(known, shares[0])) > SETTINGS.same_way
    steps = shares[:1] if alike.all() else shares
    while count < SETTINGS.most_shapes:
        near = [own for own in (*known, *found) if own[0].share == shares[0]]
        more = _between_neighbours(placed.effect, near)[: SETTINGS.most_shapes - count]
        if not len(more):
            break
        count += len(more)
        found += _usable(balance, placed, more, amplitudes, steps)
    return found


def _between_neighbours(effect: Effect, found: Sequence[tuple[Atom, list[Accelerations]]]) -> np.ndarray:
    """The middles (point, parameter) of neighbours along one shape whose columns have little in common, those that have
    least first.
    """
    space, middles = effect.space, []
    points = np.array([atom.values for atom, _ in found]).reshape(-1, len(space))
    columns = [np.concatenate([c.predicted.ravel() for c in own]) for _, own in found]
    for axis in (i for i, name in enumerate(space.names) if name in effect.shapes):
        line = np.delete(points, axis, axis=1)
        for a, b in pairwise(np.lexsort([points[:, axis], *line.T])):
            cosine = similarity(columns[a], columns[b])
            if np.array_equal(line[a], line[b]) and cosine < SETTINGS.near:
                ends = points[[a, b], axis]
                middle = points[a].copy()
                middle[axis] = np.sqrt(ends.prod()) if space.low[axis] > 0 else ends.mean()
                middles.append((cosine, middle))
    return np.array([m for _, m in sorted(middles, key=lambda own: own[0])]).reshape(-1, len(space))


def _mixture(parts: Sequence[tuple[Atom, list[Accelerations]]]) -> tuple[Atom, list[Accelerations]]:
    """Of atoms of one effect, each of one amplitude at a shape of its own: all of them at once."""
    owners = [atom for atom, _ in parts]
    together = Mixture(
        owners[0].placed,
        owners[0].values,
        tuple(i for atom in owners for i in atom.amplitudes),
        np.concatenate([atom.unit for atom in owners]),
        np.concatenate([atom.known for atom in owners]),
        shapes=np.array([atom.values for atom in owners]),
    )
    return together, [column for _, columns in parts for column in columns]


def acts_unshown(balance: ForceBalance, effect: Effect) -> bool:
    """Whether it acts on a joint that no sensor shows: contacts take up what it does there, as far as they need to."""
    joint = getattr(effect, "joint", None)
    return joint is not None and int(balance.model.jnt_dofadr[joint]) in balance.unshown


def _onset(
    balance: ForceBalance,
    effect: Effect,
    point: np.ndarray,
    amplitudes: Sequence[int],
    least: float,
) -> np.ndarray:
    """Of the range of each amplitude, (amplitude,), the part in which the effect does less than `least`, from its null
    at the `point` on: of a limit that little comes near, most of it.
    """
    found = np.zeros(len(amplitudes))
    for k, index in enumerate(amplitudes if effect.has_threshold else ()):
        for halving in range(1, SETTINGS.halvings + 1):
            share = found[k] + 0.5**halving
            moved = point.copy()
            moved[index] += _reach(effect.space, point, index, share)
            [change] = balance.of_effect(effect, moved[None])
            if _size(change) <= least:
                found[k] = share
    return found


def _shares(effect: Effect) -> tuple[float, ...]:
    """Steps of the amplitudes, in ranges, at which columns are taken."""
    if effect.has_threshold:
        return SETTINGS.beyond_onset
    if effect.place not in ("force", "control"):
        return (SETTINGS.step,)
    if _may_saturate(effect):
        return (SETTINGS.step, SETTINGS.far_steps[-1])
    return (SETTINGS.step, -SETTINGS.step)  # dry friction acts one way, and so do limits of a control


def _may_saturate(effect: Effect) -> bool:
    """Whether what it does need not grow in proportion to its amplitude, nor begin beyond a threshold."""
    may = effect.place in ("force", "control") and not effect.has_threshold
    return may and bool(effect.states or effect.remembers)


def _cosines(found: Sequence[tuple[Atom, list[Accelerations]]], share: float) -> np.ndarray:
    """Of each column with that of its shape at the step `share`, (column,); 0 where there is none."""
    first = {atom.values.tobytes(): columns for atom, columns in found if atom.share == share}
    return np.array(
        [
            similarity(one.predicted.ravel(), other.predicted.ravel()) if one else 0.0
            for atom, columns in found
            for one, other in zip(
                first.get(atom.values.tobytes(), [None] * len(columns)), columns, strict=True
            )
        ]
    )


def _do_the_same(found: Sequence[tuple[Atom, list[Accelerations]]], shares: Sequence[float]) -> bool:
    """Whether each column at the first of these steps has one at each of the others that goes its way."""
    complete = len(found) == len(shares) * sum(atom.share == shares[0] for atom, _ in found)
    return complete and bool((_cosines(found, shares[0]) > SETTINGS.same_way).all())


def _is_reverse(columns: Sequence[Accelerations], others: Sequence[Accelerations], tolerance: float) -> bool:
    """Whether columns are those at the reverse step, with the other sign."""
    return all(
        np.linalg.norm(a.predicted + b.predicted) <= tolerance * np.linalg.norm(a.predicted)
        for a, b in zip(columns, others, strict=True)
    )


def _size(change: Accelerations) -> float:
    """The largest acceleration in it."""
    return max(np.abs(change.predicted).max(), np.abs(change.measured).max())


def _can_be_compared(columns: Sequence[Accelerations], largest: float, least: float) -> bool:
    """Whether an effect does anything, and no absurd acceleration."""
    sizes = [_size(c) for c in columns]
    return bool(np.isfinite(sizes).all() and max(sizes) > least and max(sizes) <= largest)


def _repeating(balance, placed, amplitudes) -> Iterator[tuple[Atom, list[Accelerations]]]:
    effect: PeriodicForce = placed.effect
    along = balance.along(effect)
    span = float(np.ptp(along)) if effect.along == "qpos" else float(balance.points.elapsed.max())
    points, others = effect.sweep(span, SETTINGS.periods), effect.apart(balance.points.step)
    recordings = [~others.any(axis=0), *others]
    for point, waves in zip(points, balance.of_waves(effect, points), strict=True):
        unit = np.ones(len(amplitudes))
        known = SETTINGS.known * effect.space.span[list(amplitudes)]
        yield (
            Atom(placed, point, amplitudes, unit, known, apart=len(others) * len(amplitudes)),
            [balance.of_joint_force(effect.dof, w * own) for own in recordings for w in waves],
        )


def _shapes(effect: Effect) -> np.ndarray:
    if len(effect.shapes) > 2:
        return np.concatenate([effect.shape_grid(1), effect.space.nominal[None]])
    few = len(effect.shapes) == 2 or effect.has_threshold
    return effect.shape_grid(SETTINGS.shapes_of_several if few else SETTINGS.shapes)


def _reach(space, point: np.ndarray, index: int, share: float) -> float:
    """A step of this share of the range, towards where there is more of it, or away from there where below 0."""
    up, down = space.high[index] - point[index], point[index] - space.low[index]
    return share * float(space.span[index]) * (1.0 if up >= down else -1.0)
