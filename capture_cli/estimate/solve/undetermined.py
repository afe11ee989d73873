"""What of the parameters a log leaves open: one alone, or several of which only ratios or other combinations are known.

Parameters are confounded where each would be known far better if the others were. In units of what each would then be
known by, the information has an eigenvalue next to 0 along what is not known: collinearity diagnostics (Belsley, Kuh
and Welsch, Regression Diagnostics, 1980, chapter 3). Of two parameters it is 1 less their correlation.

Which parameters belong together is told by the projector on all such directions, not by eigenvectors: those of two
joints that are the same would be mixed at random. Parameters that change by the same share along one are known but for
a common factor: a servo's gain, armature, damping and friction, where nothing else says how large forces are.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.solve.intervals import SETTINGS as INTERVALS
from capture_cli.estimate.solve.intervals import Intervals
from capture_cli.model.parameters import ParameterSpace


@frozen
class SETTINGS:
    confounded: float = 0.99  # correlation beyond which two parameters are known together only
    # of two values at least: what confounding leaves open; with less both are known well enough
    matters: float = 0.05
    most: float = 0.5  # of a parameter's variance, that comes from what it is confounded with
    # of the projector: less is between parameters that have nothing to do with each other
    together: float = 0.1
    one_factor: float = 0.1  # by which relative changes differ that are one factor
    rounding: float = 1e-13  # of the largest eigenvalue
    snap: float = 1e-9  # of the range: nearer to a bound a value is at it


NOTHING, RATIOS, PRODUCT, COMBINATION = "nothing", "ratios", "product", "combination"


@dataclass(frozen=True)
class Undetermined:
    """which (member,): numbers of the parameters. known: what is, of them: NOTHING, RATIOS, PRODUCT or COMBINATION.

    open: how many directions are not known. change (member,): one standard deviation along the one that is least known,
    in the unit cube. scaled: which of the members are known but for a factor, and `factor` from and to what: 95 %,
    within the bounds and what the log excludes; of a PRODUCT the second is scaled by its inverse. ends (2, member): the
    values of all at either end; None where they are not known.
    """

    which: np.ndarray
    known: str
    change: np.ndarray
    open: int = 1
    scaled: tuple[int, ...] = ()
    factor: tuple[float, float] | None = None
    ends: np.ndarray | None = None

    @property
    def sd_over_range(self) -> float:
        return float(np.linalg.norm(self.change))


def undetermined(found: Intervals, space: ParameterSpace, point: np.ndarray) -> list[Undetermined]:
    """What the intervals `found` of the parameters at `point` (parameter,) say is open, the most open first."""
    together = [g.told() for g in _confounded(found, space, point) if g.matters]
    told = {int(i) for u in together for i in u.which}
    alone = [_alone(found, space, i) for i in np.flatnonzero(~found.identifiable).tolist() if i not in told]
    return sorted([*together, *alone], key=lambda u: -u.sd_over_range)


def is_confounded(covariance: np.ndarray) -> bool:
    """Whether any parameters are, whose errors have the `covariance` (parameter, parameter)."""
    sd = np.sqrt(np.diag(covariance))
    own = np.flatnonzero(sd > 0)
    if len(own) < 2:
        return False
    projector, _ = _open(covariance[np.ix_(own, own)] / np.outer(sd[own], sd[own]))
    return bool(projector.any())


def _alone(found: Intervals, space: ParameterSpace, number: int) -> Undetermined:
    """A parameter that is open whatever the others are."""
    ends = np.array([[found.low[number]], [found.high[number]]])
    change = np.array([found.sd[number] / space.span[number]])
    return Undetermined(np.array([number]), NOTHING, change, ends=ends)


def _confounded(found: Intervals, space: ParameterSpace, point: np.ndarray) -> Iterator[_Group]:
    """The groups of parameters that are confounded with each other."""
    sd = found.sd / space.span
    own = np.flatnonzero(sd > 0)
    if len(own) < 2:
        return
    scale = np.outer(found.sd[own], found.sd[own])
    projector, open_ = _open(found.covariance[np.ix_(own, own)] / scale)
    members = np.flatnonzero(np.diag(open_) > SETTINGS.most)
    for group in _joined(projector, members):
        if len(group) < 2:
            continue
        most = group[np.argmax((np.diag(open_) * np.square(sd[own]))[group])]
        change = sd[own][group] * open_[group, most] / np.sqrt(open_[most, most])
        directions = max(1, round(float(np.diag(projector)[group].sum())))
        which = own[group]
        bounds = _bounds(found, space)[:, which]
        yield _Group(which, change, directions, space, point, found.quantile(), bounds)


def _bounds(found: Intervals, space: ParameterSpace) -> np.ndarray:
    """From where to where values can be, (2, parameter): within the bounds, where the log does not exclude more."""
    bounds = np.stack([space.low, space.high])
    return bounds if found.limits is None else np.where(np.isnan(found.limits.T), bounds, found.limits.T)


def _open(correlation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The projector (p, p) on the directions that confounding leaves open, and what of the correlation is theirs."""
    values, vectors = np.linalg.eigh(correlation)
    information = (vectors / np.maximum(values, SETTINGS.rounding * values[-1])) @ vectors.T
    alone = 1 / np.sqrt(np.diag(information))  # as each would be known by if the others were
    values, vectors = np.linalg.eigh(information * np.outer(alone, alone))
    is_open = values < 1 - SETTINGS.confounded
    values, vectors = np.maximum(values[is_open], SETTINGS.rounding), vectors[:, is_open]
    moved = alone[:, None] * vectors
    return vectors @ vectors.T, (moved / values) @ moved.T


def _joined(projector: np.ndarray, members: np.ndarray) -> list[np.ndarray]:
    """The `members` in groups of those that the projector joins, each in order."""
    size = np.sqrt(np.maximum(np.diag(projector), 0.0))
    joined = np.abs(projector) > SETTINGS.together * np.outer(size, size)
    groups, left = [], set(members.tolist())
    while left:
        group, front = set(), {min(left)}
        while front:
            group |= front
            front = {j for i in front for j in left if joined[i, j]} - group
        left -= group
        groups.append(np.array(sorted(group)))
    return groups


@dataclass(frozen=True)
class _Group:
    """Parameters `which` (member,) that are confounded in `open` directions, and their `change` (member,) along the one
    that is least known: one standard deviation, in the unit cube. reach: how many of these 95 % are.
    bounds (2, member): of their values.
    """

    which: np.ndarray
    change: np.ndarray
    open: int
    space: ParameterSpace
    point: np.ndarray
    reach: float
    bounds: np.ndarray

    @property
    def matters(self) -> bool:
        """Whether what is open is more than any use of the parameters would notice."""
        is_wide = float(np.linalg.norm(self.change)) > INTERVALS.undetermined_sd
        return is_wide or int((np.abs(self._moved) > SETTINGS.matters * np.abs(self._value)).sum()) > 1

    def told(self) -> Undetermined:
        if self.open > 1:
            return Undetermined(self.which, COMBINATION, self.change, self.open)
        scaled = self._alike()
        if len(scaled) > 1:
            return self._ratios(scaled)
        if len(self.which) == 2 and np.prod(self._relative) < 0 and _is_one(self._relative):
            return self._product()
        first, last = self._within(self._value, self._moved)  # in standard deviations
        along = np.array([[max(-self.reach, first)], [min(self.reach, last)]])
        return Undetermined(
            self.which, COMBINATION, self.change, ends=self._bounded(self._value + along * self._moved)
        )

    @property
    def _value(self) -> np.ndarray:
        return self.point[self.which]

    @property
    def _moved(self) -> np.ndarray:
        return self.change * self.space.span[self.which]

    @cached_property
    def _relative(self) -> np.ndarray:
        """Changes as shares of the values, (member,); nan of a value that is 0."""
        return np.divide(
            self._moved, self._value, out=np.full(len(self.which), np.nan), where=self._value != 0
        )

    def _alike(self) -> tuple[int, ...]:
        """The most members that change by one factor; of as many others, those that change most."""
        best: tuple[int, ...] = ()
        for sign in (1, -1):
            own = np.flatnonzero(sign * self._relative > 0)
            own = own[np.argsort(-np.abs(self._relative[own]), kind="stable")]
            for k, largest in enumerate(own):
                near = tuple(sorted(int(i) for i in own[k:] if _is_one(self._relative[[largest, i]])))
                best = near if len(near) > len(best) else best
        return best

    def _ratios(self, scaled: tuple[int, ...]) -> Undetermined:
        """Of members that can be `scaled` together; the others change with them."""
        size = float(self._relative[list(scaled)].mean())
        by = self._moved / size  # as the factor grows by 1
        by[list(scaled)] = self._value[list(scaled)]
        factor = self._factor(size, *self._within(self._value - by, by))
        ends = self._bounded(self._value + by * (np.array(factor)[:, None] - 1))
        return Undetermined(self.which, RATIOS, self.change, scaled=scaled, factor=factor, ends=ends)

    def _product(self) -> Undetermined:
        """Of two members one of which falls by the factor that the other grows by, unless they may be a sum of equal
        terms: that shows likewise.
        """
        one, other = (self.space.parameters[i] for i in self.which)
        if (self._value < 0).any() or (one.unit == other.unit and _is_one(self._value)):
            return Undetermined(self.which, COMBINATION, self.change)
        (a, b), (low, least), (high, most) = self._value, *self.bounds
        first, last = max(low / a, b / most), min(high / a, b / least if least > 0 else np.inf)
        factor = self._factor(float(np.abs(self._relative).mean()), first, last)
        ends = np.array([[a * f, b / f] for f in factor])
        return Undetermined(self.which, PRODUCT, self.change, scaled=(0, 1), factor=factor, ends=ends)

    def _factor(self, size: float, first: float, last: float) -> tuple[float, float]:
        """From and to what factor, within `first` and `last`, whose logarithm has the standard deviation `size`."""
        with np.errstate(over="ignore"):
            most = float(np.exp(self.reach * np.abs(size)))
        return max(1 / most, first), min(most, last)

    def _bounded(self, ends: np.ndarray) -> np.ndarray:
        """The values `ends` (2, member), exactly at the bounds where they are at them but for rounding."""
        for bound in self.bounds:
            ends = np.where(np.abs(ends - bound) < SETTINGS.snap * self.space.span[self.which], bound, ends)
        return ends

    def _within(self, begin: np.ndarray, by: np.ndarray) -> tuple[float, float]:
        """From and to which multiple of `by` (member,), added to `begin` (member,), all are within their bounds."""
        own = by != 0
        to = np.sort((self.bounds - begin)[:, own] / by[own], axis=0)
        return float(to[0].max()), float(to[1].min())


def _is_one(shares: np.ndarray) -> bool:
    """Whether shares (n,), whatever their signs, are one number but for what is not known of them."""
    sizes = np.abs(shares)
    return bool(sizes.max() <= (1 + SETTINGS.one_factor) * sizes.min())
