"""Fits in the force balance, of the declared model and of models with effects, and how well each predicts blocks that
it was not fitted to. The declared model takes the balance along to its values; others are fitted within one balance.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace
from itertools import pairwise

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.common.processes import in_processes
from capture_cli.estimate.balance.balanced_model import BalancedModel, with_numbers
from capture_cli.estimate.balance.dictionary import SETTINGS as DICTIONARY
from capture_cli.estimate.balance.force_balance import ForceBalance
from capture_cli.estimate.balance.forward_dynamics import Accelerations
from capture_cli.estimate.balance.motion import SmoothedLog
from capture_cli.estimate.balance.regression import Sums, predicted, solved, step_within, with_prior, without
from capture_cli.estimate.balance.whitening import Whitening
from capture_cli.model.effects._periodic_force import PeriodicForce
from capture_cli.model.effects.placed import Placed


@frozen
class SETTINGS:
    """blocks: that are left out in turn. descents: steps of a fit at most, where parameters are nonlinear or it begins
    far off, and straight where neither is. far: its longest step, of a range; shortest: at which it stops early.
    difference: of a range, in differences of effects. at_end: of a range, within which a parameter is at its end.
    ran_away: of rows, beyond which what others add is lost in rounding. determined: of a declared parameter's range, a
    standard deviation below which the balance determines it. remembered: bytes of rows of effects at values that were
    asked before.
    """

    blocks: int = 12
    descents: int = 5
    straight: int = 2
    far: float = 0.3
    shortest: float = 1e-3
    difference: float = 1e-3
    at_end: float = 1e-6
    ran_away: float = 1e15
    determined: float = 0.1
    remembered: int = 200_000_000


def declared_balance(
    smoothed: SmoothedLog, point: np.ndarray, threads: int | None
) -> tuple[ForceBalance, Whitening]:
    """The balance, from `point` (parameter,), at the values of the declared parameters that fill it best."""
    balance = ForceBalance(smoothed, point, threads)
    return declared(balance, Whitening(balance))


def declared(balance: ForceBalance, whitening: Whitening) -> tuple[ForceBalance, Whitening]:
    """The balance at the values that fill it best, from its own. whitening: of the same log."""
    smoothed, point, space = balance.smoothed, balance.point, balance.smoothed.task.space
    whitening = whitening.along(balance)
    whitening.reset()  # what was asked before is not to matter
    for _ in range(SETTINGS.descents):
        whitening = whitening.along(balance)
        white = np.concatenate(whitening.whitened(whitening.rows([balance.null, *by_parameter(balance)])))
        step = step_within(white[:, 1:] * space.span, white[:, 0], point, space.low, space.high, SETTINGS.far)
        point = np.clip(point + step * space.span, space.low, space.high)
        balance = ForceBalance(smoothed, point, balance.threads)
        if np.abs(step).max(initial=0.0) < SETTINGS.shortest:
            break
    return balance, whitening.at(balance)


def parameters_sd(whitening: Whitening, rows: Sequence[np.ndarray]) -> np.ndarray:
    """How well a balance determines each declared parameter, by the noise of the sensors, in its range (parameter,).

    rows: of the parameters.
    """
    whitening = copy(whitening)
    whitening.reset()
    white = np.concatenate(whitening.whitened(rows)) * whitening.balance.smoothed.task.space.span
    return np.sqrt(np.diag(np.linalg.inv(with_prior(white.T @ white))))


def by_parameter(balance: ForceBalance) -> list[Accelerations]:
    """The columns of the declared parameters."""
    return [balance.of_parameter(i) for i in range(len(balance.point))]


class BalancedFits:
    """In one balance, on the rows that are made of it. by_parameter: of each stretch, what a unit of each declared
    parameter adds to these, (row, nv, parameter); block_of_row (row,): the block that each white row is of.

    on_work is called before what takes long, which it may end by raising.
    """

    def __init__(
        self, balance: ForceBalance, whitening: Whitening, on_work: Callable[[], None] = lambda: None
    ):
        self.balance, self.whitening, self.on_work = balance, whitening, on_work
        self.space = balance.smoothed.task.space
        self._target = whitening.rows([balance.null])
        self.by_parameter = whitening.rows(by_parameter(balance))
        self._block = whitening.blocks(SETTINGS.blocks)
        self.block_of_row = whitening.block_of_row(self._block)
        self._rows: OrderedDict[tuple, list[np.ndarray]] = OrderedDict()

    @np.errstate(over="ignore", divide="ignore", invalid="ignore")
    def fitted(self, model: BalancedModel, *, far_off: bool = False) -> BalancedModel:
        """The model with all of its parameters fitted in the balance, and how it predicts blocks. far_off: whether it
        begins where it is far from linear.
        """
        self.whitening.reset()  # what was asked before is not to matter
        return self.judged(self._descended(self.judged(model), far_off)).as_it_is()

    def all_fitted(self, models: Sequence[BalancedModel]) -> list[BalancedModel]:
        """As `fitted`, each of them."""
        numbers = in_processes(lambda m: self.fitted(m).numbers, models, self.balance.threads)
        return with_numbers(models, list(numbers))

    @np.errstate(over="ignore", divide="ignore", invalid="ignore")
    def judged(self, model: BalancedModel) -> BalancedModel:
        """The model, and how it predicts blocks: its parameters are fitted to first order, about its values; its own
        error is as large as makes it most likely. Not a number where an effect runs away.
        """
        target, columns = self._system(model)
        if not _is_bounded((*target, *columns)):
            nowhere = np.full(int(self._block.max()) + 1, np.nan)
            return replace(model, likelihood=nowhere, at_values=np.full(len(nowhere), -np.inf))
        slow = np.zeros_like(self.whitening.slow_noise) if model.slow_noise is None else model.slow_noise
        self.whitening.adapt(self._left(model, target, columns), slow)
        target, columns = -self.white(target)[:, 0], self.white(columns)
        sums = Sums.of(target, columns[:, self._free(model, target, columns)], self.block_of_row)
        determinants = np.bincount(self._block, weights=self.whitening.log_determinants())
        likelihood = determinants - 0.5 * predicted(sums)
        [left] = without(columns[:, len(model.start) :], target)
        at_values = determinants - 0.5 * np.bincount(self.block_of_row, weights=left**2)
        beyond_noise = self.whitening.beyond_noise
        return replace(model, likelihood=likelihood, beyond_noise=beyond_noise, at_values=at_values)

    def with_slow_noise(self, model: BalancedModel) -> BalancedModel:
        """The model with the slow noise of the sensors that it leaves."""
        left = self._left(model, *self._system(model))
        return replace(model, slow_noise=self.whitening.slow_noise_of(left))

    @np.errstate(over="ignore", divide="ignore", invalid="ignore")
    def runs_away(self, model: BalancedModel) -> bool:
        """Whether its effects do, along the log."""
        target, columns = self._system(model)
        return not _is_bounded((*target, *columns))

    def white_system(self, model: BalancedModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The target (row,) and the columns (row, column) of the parameters that are free, white; and which are."""
        target, columns = self._system(model)
        target, columns = -self.white(target)[:, 0], self.white(columns)
        free = self._free(model, target, columns)
        return target, columns[:, free], free

    def white(self, rows: Sequence[np.ndarray]) -> np.ndarray:
        """White rows (row, column), from those of each stretch (row, nv, column)."""
        return np.concatenate(self.whitening.whitened(rows))

    def moved(self, model: BalancedModel, step: np.ndarray) -> BalancedModel:
        """A step (column,) in ranges away, within them; its first columns are the parameters."""
        low, high = self._bounds(model)
        whole = np.clip(model.start + step[: len(low)] * (high - low), low, high)
        ends = np.cumsum([len(self.space), *(len(v) for v in model.values)])
        values = tuple(whole[a:b] for a, b in pairwise(ends))
        return replace(model, point=whole[: ends[0]], values=values)

    def at_ends(self, model: BalancedModel) -> tuple[np.ndarray, np.ndarray]:
        """Which parameters of the model are at the lower end of their range, and at the upper one, (parameter,)."""
        low, high = self._bounds(model)
        near = SETTINGS.at_end * (high - low)
        return model.start <= low + near, model.start >= high - near

    def _bounds(self, model: BalancedModel) -> tuple[np.ndarray, np.ndarray]:
        spaces = [self.space, *(e.effect.space for e in model.effects)]
        return np.concatenate([s.low for s in spaces]), np.concatenate([s.high for s in spaces])

    def _free(self, model: BalancedModel, target: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Which parameters are not held at an end of their range, (column,)."""
        at_low, at_high, free = (np.full(columns.shape[1], start) for start in (False, False, True))
        at_low[: len(model.start)], at_high[: len(model.start)] = self.at_ends(model)
        while True:
            step = np.zeros(len(free))
            step[free] = solved(columns[:, free], target)
            out = free & ((at_low & (step < 0)) | (at_high & (step > 0)))
            if not out.any():
                return free
            free &= ~out

    def _left(
        self, model: BalancedModel, target: Sequence[np.ndarray], columns: Sequence[np.ndarray]
    ) -> list[np.ndarray]:
        """What the model leaves of its system once its parameters took a linear step, (row, nv) of each stretch."""
        white, slope = -self.white(target)[:, 0], self.white(columns)
        free = self._free(model, white, slope)
        step = solved(slope[:, free], white)
        return [t[..., 0] + c[..., free] @ step for t, c in zip(target, columns, strict=True)]

    def _descended(self, model: BalancedModel, far_off: bool) -> BalancedModel:
        """Gauss-Newton in the balance, within the bounds, over all parameters of the model and its effects."""
        if not model.effects:
            return model
        low, high = self._bounds(model)
        best, least, far = model, np.inf, SETTINGS.far
        nonlinear = far_off or any(e.effect.shapes for e in model.effects)
        for _ in range(SETTINGS.descents if nonlinear else SETTINGS.straight):
            self.on_work()
            target, columns = self._system(model)
            target, columns = self.white(target)[:, 0], self.white(columns)
            squares = np.inf  # of an effect that runs away
            if np.isfinite(columns).all() and np.abs(target).max() < SETTINGS.ran_away:
                white, by_parameter = without(columns[:, len(low) :], target, columns[:, : len(low)])
                squares = float(white @ white)
            if np.isinf(squares) and np.isinf(least):
                break
            if squares < least:
                done = squares > least * (1 - SETTINGS.shortest)
                best, least, slope, left = model, squares, by_parameter, white
                if done:
                    break
            else:
                far /= 4
                if far < SETTINGS.shortest:
                    break
            model = self.moved(best, step_within(slope, left, best.start, low, high, far))
        return best

    def _system(self, model: BalancedModel) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Rows of what is left at a model's values, (row, nv, 1), and by a unit of range of each parameter, (row, nv,
        parameter), of each stretch; last by amplitudes that other recordings have for themselves.
        """
        moved = model.point - self.balance.point
        target = [t + (x @ moved)[..., None] for t, x in zip(self._target, self.by_parameter, strict=True)]
        columns = [x * self.space.span for x in self.by_parameter]
        for placed, values in zip(model.effects, model.values, strict=True):
            rows = self._rows_of(placed, values)
            target = [t + r[..., :1] for t, r in zip(target, rows, strict=True)]
            columns = [np.concatenate([c, r[..., 1:]], axis=-1) for c, r in zip(columns, rows, strict=True)]
        apart = self.whitening.rows(self._apart(model))
        return target, [np.concatenate(pair, axis=-1) for pair in zip(columns, apart, strict=True)]

    def _rows_of(self, placed: Placed, values: np.ndarray) -> list[np.ndarray]:
        """What an effect adds at these values, and by a unit of range of each of its parameters, (row, nv, 1 +
        parameter) of each stretch: the same in every model, so that the last ones are remembered.
        """
        key = placed.name, values.tobytes()
        if key in self._rows:
            self._rows.move_to_end(key)
            return self._rows[key]
        space, share = placed.effect.space, SETTINGS.difference
        steps = np.where(values + share * space.span <= space.high, share, -share)
        points = np.vstack([values, values + np.diag(steps * space.span)])
        rows = self.whitening.rows(self._changes(placed, points))
        found = [np.concatenate([r[..., :1], (r[..., 1:] - r[..., :1]) / steps], axis=-1) for r in rows]
        self._rows[key] = found
        room = SETTINGS.remembered - sum(r.nbytes for own in self._rows.values() for r in own)
        while room < 0 and len(self._rows) > 1:
            room += sum(r.nbytes for r in self._rows.popitem(last=False)[1])
        return found

    def _apart(self, model: BalancedModel) -> list[Accelerations]:
        """By amplitudes that other recordings than the reference have for themselves."""
        found = []
        for placed, values in zip(model.effects, model.values, strict=True):
            effect = placed.effect
            if isinstance(effect, PeriodicForce):
                known = DICTIONARY.known * effect.space.span[_amplitudes(effect)]
                for own in effect.apart(self.balance.points.step):
                    waves = self.balance.of_waves(effect, np.stack([values, values]))[0]
                    found += [
                        self.balance.of_joint_force(effect.dof, k * w * own)
                        for k, w in zip(known, waves, strict=True)
                    ]
        return found

    def _changes(self, placed: Placed, values: np.ndarray) -> list[Accelerations]:
        effect = placed.effect
        if not isinstance(effect, PeriodicForce):
            return self.balance.of_effect(effect, values)
        amplitudes, here = _amplitudes(effect), ~effect.apart(self.balance.points.step).any(axis=0)
        waves = [self.balance.of_waves(effect, np.stack([v, v]))[0] for v in values]
        forces = [np.tensordot(v[amplitudes], w, axes=1) * here for v, w in zip(values, waves, strict=True)]
        return [self.balance.of_joint_force(effect.dof, force) for force in forces]


def _is_bounded(rows: Sequence[np.ndarray]) -> bool:
    """Whether no effect runs away in these rows of each stretch."""
    return all(np.abs(r).max(initial=0.0) < SETTINGS.ran_away for r in rows)


def _amplitudes(effect: PeriodicForce) -> list[int]:
    return [i for i, n in enumerate(effect.space.names) if n not in effect.shapes]
