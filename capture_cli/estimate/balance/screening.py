"""Every effect at once: how much better does each predict the accelerations of blocks that it was not fitted to?

The declared parameters, and the effects that a model has already, are fitted anew with each addition, in the force
balance; nothing is simulated. What comes out is a ranking, with the values that a fit through the simulator begins at.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence, Set
from contextlib import closing
from copy import copy
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from capture_cli.common.frozen import frozen
from capture_cli.common.processes import in_processes
from capture_cli.common.similarity import similarity
from capture_cli.errors import LogError
from capture_cli.estimate.balance.dictionary import SETTINGS as DICTIONARY
from capture_cli.estimate.balance.dictionary import Atom, atoms
from capture_cli.estimate.balance.force_balance import ForceBalance
from capture_cli.estimate.balance.forward_dynamics import Accelerations
from capture_cli.estimate.balance.motion import SmoothedLog
from capture_cli.estimate.balance.regression import Sums, additions, best_pairs, predicted, with_prior
from capture_cli.estimate.balance.whitening import Whitening
from capture_cli.log.input_sequences import Hold
from capture_cli.model.effects._periodic_force import PeriodicForce
from capture_cli.model.effects.placed import Placed


@frozen
class SETTINGS:
    """blocks: that are left out in turn. polished: of the best additions, whose nonlinear parameters are fitted in the
    balance; more are, so many times as many at most, until as many predict better than the next one's columns;
    polished_for_best: where one is asked for.
    descents: steps of such a fit at most, where parameters are nonlinear or it begins far off, and straight where
    neither is. far: its longest step, of a range; shortest: at which it stops early.
    difference: of a range, in differences of effects. at_once: atoms whose sums are in memory. at_end: of a range,
    within which a parameter is at its end. alike: cosine of responses beyond which effects do not differ. ran_away: of
    rows, beyond which what others add is lost in rounding. determined: of a declared parameter's range, a standard
    deviation below which the balance determines it. by_chance: how often the best addition to a model that lacks
    nothing may be taken for an effect; sure: standard errors of a gain beyond which there is one. remembered: bytes of
    rows of effects at values that were asked before.
    """

    blocks: int = 12
    polished: int = 8
    most_polished: int = 3
    polished_for_best: int = 2
    descents: int = 5
    straight: int = 2
    far: float = 0.3
    shortest: float = 1e-3
    difference: float = 1e-3
    at_once: int = 400
    at_end: float = 1e-6
    alike: float = 0.98
    ran_away: float = 1e15
    determined: float = 0.1
    by_chance: float = 0.01
    sure: float = 3.0
    remembered: int = 200_000_000


@dataclass(frozen=True)
class BalancedModel:
    """Effects at values, fitted in the balance. point (parameter,): of the task; values: of each effect, (parameter,).

    likelihood (block,): of each block, by the model that is fitted to the others. slow_noise (memory, nv): of the
    sensors, as far as a model that this one grew from leaves it; none where None. beyond_noise: what it leaves, as of
    `Whitening`. at_values: log likelihood of the whole log with the parameters as they are; `likelihood` has them a
    linear step on.
    """

    effects: tuple[Placed, ...]
    point: np.ndarray
    values: tuple[np.ndarray, ...]
    likelihood: np.ndarray = field(default_factory=lambda: np.zeros(0))
    slow_noise: np.ndarray | None = None
    beyond_noise: float = np.inf
    at_values: float = -np.inf

    @property
    def start(self) -> np.ndarray:
        """All parameters, those of effects last."""
        return np.concatenate([self.point, *self.values])

    @property
    def key(self) -> tuple:
        """Its effects and values."""
        return tuple(e.name for e in self.effects), np.asarray(self.start).tobytes()

    @property
    def numbers(self) -> dict[str, Any]:
        """All of it but the effects, by name."""
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name != "effects"}

    def gain(self, other: BalancedModel) -> tuple[float, float]:
        """Of predictive log likelihood over another model, and its standard error over blocks."""
        gains = self.likelihood - other.likelihood
        return float(gains.sum()), float(gains.std(ddof=1) * np.sqrt(len(gains)))


def _with_numbers(models: Sequence[BalancedModel], numbers: Sequence[dict[str, Any]]) -> list[BalancedModel]:
    return [replace(m, **own) for m, own in zip(models, numbers, strict=True)]


@dataclass(frozen=True)
class Addition:
    """A model with one effect more, its last. gain: of predictive log likelihood, over the model without it, and error,
    its standard error over blocks; response (row,): what the effect adds to the white rows, less what the other
    parameters would. elsewhere: with the effect at other shapes, of one that mixes.
    """

    model: BalancedModel
    gain: float
    error: float
    response: np.ndarray
    elsewhere: tuple[BalancedModel, ...] = ()

    @property
    def placed(self) -> Placed:
        return self.model.effects[-1]

    def is_sure(self, tried: int) -> bool:
        """Whether the gain of the best of so many `tried` is beyond chance. Under null a ratio of predictive
        likelihoods has mean 1, and is beyond K once in K times (Markov's inequality).
        """
        return self.gain > max(np.log(tried / SETTINGS.by_chance), SETTINGS.sure * self.error)


class Screening:
    """Of `placed` effects, in a balance of a smoothed log and the rows that are made of it.

    on_work is called before what takes long, which it may end by raising.
    """

    def __init__(
        self,
        balance: ForceBalance,
        whitening: Whitening,
        placed: Sequence[Placed],
        *,
        on_step: Callable[[str, int, int], None] = lambda *_: None,
    ):
        self.placed = placed
        self.on_work: Callable[[], None] = lambda: None
        self.space = balance.smoothed.task.space
        self._set(balance, whitening)
        self.atoms: list[Atom] = []
        self.columns = self._dictionary(placed, on_step)
        self.covered = frozenset(a.placed.name for a in self.atoms)

    @property
    def decided(self) -> frozenset[str]:
        """Of the effects that are `covered`, those that simulations need not be asked of, too: none on sensors where
        bodies hit. Impacts are left out of the balance, and they tell where a body is.
        """
        if not self.balance.smoothed.hits:
            return self.covered
        return self.covered - {p.name for p in self.placed if p.effect.place == "measurement"}

    @classmethod
    def of(
        cls,
        smoothed: SmoothedLog,
        placed: Sequence[Placed],
        point: np.ndarray,
        threads: int | None = None,
        on_step: Callable[[str, int, int], None] = lambda *_: None,
    ) -> Screening:
        """In the balance of the declared model, from `point` (parameter,) of its task on."""
        return cls(*declared_balance(smoothed, point, threads), placed, on_step=on_step)

    def read_as(self, holds: Sequence[Hold]) -> Screening:
        """The same with inputs that act so between rows, about the same values of the declared parameters."""
        balance = self.balance.read_as(holds)
        return self._in(balance, self.whitening.along(balance))

    def declared_as(self, holds: Sequence[Hold]) -> Screening:
        """The same, about the values that fill that balance best: misread inputs move them far."""
        return self._in(*declared(self.balance.read_as(holds), self.whitening))

    def about(self, point: np.ndarray, effects: Sequence[Placed], values: Sequence[np.ndarray]) -> Screening:
        """The same about a model with `effects` at `values`, (parameter,) each, and the task at `point` (parameter,).

        What the declared model lacks moves its parameters, and late or wrong sensors the states at which forces are
        worked out. Far from the declared model changes do not add up. LogError where effects run away along the log.
        """
        acting = [(p.effect, v) for p, v in zip(effects, values, strict=True)]
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            balance = ForceBalance(self.balance.smoothed, point, self.balance.threads, acting)
            other = self._in(balance, Whitening(balance))
            target, columns = other._system(BalancedModel(tuple(effects), point, tuple(values)))
        if not _is_bounded((*target, *columns)):
            names = " and ".join(p.name for p in effects)
            raise LogError(f"with {names} the model runs away along the log", cure="")
        return other

    def with_new_columns(self, places: Set[str]) -> Screening:
        """The same, with the columns of effects of these `places` made in this balance: far from the declared model a
        late command acts at other states.
        """
        new, other = [p for p in self.placed if p.effect.place in places], copy(self)
        other._known, other.atoms = {}, []
        columns = other._dictionary(new, lambda *_: None)
        old = [a.placed.effect.place not in places for a in self.atoms]
        of_old = np.repeat(old, [len(a.scale) for a in self.atoms])
        other.atoms = [a for a, keep in zip(self.atoms, old, strict=True) if keep] + other.atoms
        other.columns = [
            np.concatenate([own[..., of_old], more], axis=-1)
            for own, more in zip(self.columns, columns, strict=True)
        ]
        return other

    def _in(self, balance: ForceBalance, whitening: Whitening) -> Screening:
        """The same in another balance of the same log.

        Atoms keep their columns, which say what is worth polishing; what is polished has its own.
        """
        other = copy(self)
        other._set(balance, whitening)
        return other

    def _set(self, balance: ForceBalance, whitening: Whitening) -> None:
        self.balance, self.whitening = balance, whitening
        self.block = whitening.blocks(SETTINGS.blocks)
        self.target = whitening.rows([balance.null])
        self.by_parameter = whitening.rows(by_parameter(balance))
        self._known: dict[tuple, object] = {}
        self._rows: OrderedDict[tuple, list[np.ndarray]] = OrderedDict()

    def additions(
        self, effects: Sequence[Placed], values: Sequence[np.ndarray], polished: int | None = None
    ) -> list[Addition]:
        """Of each effect that is not among `effects`, which have these values, best first; so many of the best, or as
        many as the settings say, are polished.
        """
        return self._fitted_and_additions(effects, values, polished)[1]

    def _fitted_and_additions(
        self, effects: Sequence[Placed], values: Sequence[np.ndarray], polished: int | None = None
    ) -> tuple[BalancedModel, list[Addition]]:
        """The model with `effects` alone, and as of `additions`."""
        count = SETTINGS.polished if polished is None else polished
        begin = BalancedModel(tuple(effects), self.balance.point, tuple(values))
        return self.remembered(("additions", begin.key, count), lambda: self._additions(begin, count))

    def knows(self, key: tuple) -> bool:
        """Whether something was made under this key."""
        return key in self._known

    def remembered(self, key: tuple, make: Callable):
        """What was made under this key, or what `make` makes."""
        if not self.knows(key):
            self._known[key] = make()
        return self._known[key]

    def _additions(self, begin: BalancedModel, count: int) -> tuple[BalancedModel, list[Addition]]:
        self.whitening.reset()  # what was asked before is not to matter
        model = self.fitted(self._judged(self._with_slow_noise(begin)))
        model = self._judged(self._with_slow_noise(model))
        polished: list[Addition] = []
        rest = self._screened(model)
        asked = rest[: count * SETTINGS.most_polished]
        with closing(self._polished(begin, asked)) as each:
            # the columns of a nonlinear effect may promise more than it keeps
            for addition in asked:
                if sum(a.gain >= addition.gain for a in polished) >= count:
                    break
                begun, rest = next(each), rest[1:]
                gains = [m.gain(model) for m in begun]
                # not by the gain: to first order a start from which no descent gets there promises as much
                best = int(np.argmax([m.at_values for m in begun]))
                more, (gain, error) = begun[best], gains[best]
                if np.isfinite(gain):
                    polished.append(replace(addition, model=more, gain=gain, error=error))
        return model, sorted(polished, key=lambda a: -a.gain) + rest

    def _polished(self, begin: BalancedModel, asked: Sequence[Addition]) -> Iterator[list[BalancedModel]]:
        """The models of each addition to `begin`, fitted when they are asked for."""
        keys = [("polished", begin.key, a.placed.name) for a in asked]
        new = [a for a, key in zip(asked, keys, strict=True) if not self.knows(key)]
        fitted = in_processes(
            lambda a: [self.fitted(m, far_off=far_off).numbers for m, far_off in self._begun(a)],
            new,
            self.balance.threads,
        )
        with closing(fitted):
            for addition, key in zip(asked, keys, strict=True):
                models = [m for m, _ in self._begun(addition)]
                yield self.remembered(key, lambda models=models: _with_numbers(models, next(fitted)))

    def _begun(self, addition: Addition) -> list[tuple[BalancedModel, bool]]:
        """Where fits of an addition begin, and whether that is far off: with each of its shapes; and, of one that
        changes the model, with declared parameters that are at an end of their range at nominal. They may have been
        driven there for want of it: a mass for want of a moment, which is a product with it.
        """
        model = addition.model
        near = SETTINGS.at_end * self.space.span
        at_end = (model.point <= self.space.low + near) | (model.point >= self.space.high - near)
        free = np.where(at_end, self.space.nominal, model.point)
        begun = [(m, False) for m in (model, *addition.elsewhere)]
        if addition.placed.effect.place == "model" and (free != model.point).any():
            begun.append((replace(model, point=free), True))
        return begun

    def screened(self, model: BalancedModel) -> list[Addition]:
        """Of each effect that is not in the model, best first, from columns alone: none is polished."""
        self.whitening.reset()
        return self._screened(self._judged(model))

    def fitted(self, model: BalancedModel, *, far_off: bool = False) -> BalancedModel:
        """The model with all of its parameters fitted in the balance, and how it predicts blocks. far_off: whether it
        begins where it is far from linear.
        """
        self.whitening.reset()  # what was asked before is not to matter
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            return self._judged(self._fitted(self._judged(model), far_off))

    def all_fitted(self, models: Sequence[BalancedModel]) -> list[BalancedModel]:
        """As `fitted`, each of them."""
        numbers = in_processes(lambda m: self.fitted(m).numbers, models, self.balance.threads)
        return _with_numbers(models, list(numbers))

    def judged(self, model: BalancedModel) -> BalancedModel:
        """The model, and how it predicts blocks: its parameters are fitted to first order, about its values."""
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            return self._judged(model)

    def pairs(
        self, effects: Sequence[Placed], values: Sequence[np.ndarray], count: int
    ) -> list[BalancedModel]:
        """The model with two effects more than `effects`, which have these values: of those pairs that differ in their
        responses the `count` which take most of what it leaves, best first, by what they explain together.

        All pairs of effects are compared, each by its response at the values that it has alone: neither has to be among
        the best alone, where a third does more than either.
        """
        model, additions = self._fitted_and_additions(effects, values)
        self.whitening.reset()
        target, own, _ = self._white_system(self._judged(model))
        found = []
        for one, other in best_pairs(
            np.array([a.response for a in additions]),
            target - own @ _solved(own, target),
            np.array([len(a.placed.effect.parameters) for a in additions]),
            SETTINGS.alike,
            count,
        ):
            first, second = additions[one].model, additions[other].model
            both = (*first.effects, second.effects[-1]), (*first.values, second.values[-1])
            found.append(replace(first, effects=both[0], values=both[1]))
        return found

    def groups(self, additions: Sequence[Addition]) -> list[list[Addition]]:
        """`additions`, best first, with those together whose responses are alike."""
        groups: list[list[Addition]] = []
        for addition in additions:
            own = next((g for g in groups if self._are_alike(g[0], addition)), None)
            if own is None:
                groups.append([addition])
            else:
                own.append(addition)
        return groups

    def _are_alike(self, one: Addition, other: Addition) -> bool:
        return abs(similarity(one.response, other.response)) > SETTINGS.alike

    def best(self) -> BalancedModel:
        """The declared model, or that with the one effect that predicts most."""
        declared, additions = self._fitted_and_additions((), (), SETTINGS.polished_for_best)
        added = [a.model for a in additions if a.model.likelihood.size]
        return max([declared, *added], key=lambda m: m.likelihood.sum())

    def simpler(self, model: BalancedModel) -> list[BalancedModel]:
        """Of a model with one effect: those with another that has fewer parameters, and does nearly the same."""
        additions = self.additions((), (), SETTINGS.polished_for_best)
        own = next((a for a in additions if (a.placed,) == model.effects), None)
        if own is None:
            return []
        simpler = [a for a in additions if len(a.model.start) < len(model.start) and self._are_alike(own, a)]
        return [self.fitted(a.model) for a in simpler]

    # --- the balance ---

    def _white(self, rows: Sequence[np.ndarray]) -> np.ndarray:
        return np.concatenate(self.whitening.whitened(rows))

    @property
    def _block_of_row(self) -> np.ndarray:
        return self.whitening.block_of_row(self.block)

    def _dictionary(self, placed: Sequence[Placed], on_step: Callable) -> list[np.ndarray]:
        """Rows (row, nv, column) of each stretch of the atoms, in single precision: there may be thousands, or none."""
        rows = [[t[..., :0].astype(np.float32) for t in self.target]]
        found = in_processes(self._atoms, placed, self.balance.threads)
        for number, one in enumerate(placed):
            on_step("balance", number, len(placed))
            own, columns = next(found)
            if own:
                self.atoms += [replace(atom, placed=one) for atom in own]
                rows.append(columns)
        return [np.concatenate([r[n] for r in rows], axis=-1) for n in range(len(self.whitening.averages))]

    def _atoms(self, placed: Placed) -> tuple[list[Atom], list[np.ndarray]]:
        """Its atoms, without the effect, and their rows (row, nv, column) of each stretch, in single precision."""
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # what runs away is left out
            own = list(atoms(self.balance, placed))
        columns = [c for _, columns in own for c in columns]
        rows = [r.astype(np.float32) for r in self.whitening.rows(columns)] if own else []
        return [replace(atom, placed=None) for atom, _ in own], rows

    # --- one model ---

    def _system(self, model: BalancedModel) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Rows of what is left at a model's values, (row, nv, 1), and by a unit of range of each parameter, (row, nv,
        parameter), of each stretch; last by amplitudes that other recordings have for themselves.
        """
        moved = model.point - self.balance.point
        target = [t + (x @ moved)[..., None] for t, x in zip(self.target, self.by_parameter, strict=True)]
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
        points, steps = self._differences(placed, values)
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

    def _differences(self, placed: Placed, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`values`, and with a step of each parameter, (1 + parameter, parameter); the steps, in ranges."""
        space, share = placed.effect.space, SETTINGS.difference
        steps = np.where(values + share * space.span <= space.high, share, -share)
        return np.vstack([values, values + np.diag(steps * space.span)]), steps

    def _changes(self, placed: Placed, values: np.ndarray) -> list[Accelerations]:
        effect = placed.effect
        if not isinstance(effect, PeriodicForce):
            return self.balance.of_effect(effect, values)
        amplitudes, here = _amplitudes(effect), ~effect.apart(self.balance.points.step).any(axis=0)
        waves = [self.balance.of_waves(effect, np.stack([v, v]))[0] for v in values]
        forces = [np.tensordot(v[amplitudes], w, axes=1) * here for v, w in zip(values, waves, strict=True)]
        return [self.balance.of_joint_force(effect.dof, force) for force in forces]

    def _left(
        self, model: BalancedModel, target: Sequence[np.ndarray], columns: Sequence[np.ndarray]
    ) -> list[np.ndarray]:
        """What the model leaves of its system once its parameters took a linear step, (row, nv) of each stretch."""
        white, slope = -self._white(target)[:, 0], self._white(columns)
        free = self._free(model, white, slope)
        step = _solved(slope[:, free], white)
        return [t[..., 0] + c[..., free] @ step for t, c in zip(target, columns, strict=True)]

    def _white_system(self, model: BalancedModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The target (row,) and the columns (row, column) of the parameters that are free, white; and which are."""
        target, columns = self._system(model)
        target, columns = -self._white(target)[:, 0], self._white(columns)
        free = self._free(model, target, columns)
        return target, columns[:, free], free

    def _with_slow_noise(self, model: BalancedModel) -> BalancedModel:
        """The model with the slow noise of the sensors that it leaves."""
        return replace(
            model, slow_noise=self.whitening.slow_noise_of(self._left(model, *self._system(model)))
        )

    def _judged(self, model: BalancedModel) -> BalancedModel:
        """With the likelihood of each block; the model's own error is as large as makes it most likely. Not a number
        where an effect runs away.
        """
        target, columns = self._system(model)
        if not _is_bounded((*target, *columns)):
            nowhere = np.full(int(self.block.max()) + 1, np.nan)
            return replace(model, likelihood=nowhere, at_values=-np.inf)
        slow = np.zeros_like(self.whitening.slow_noise) if model.slow_noise is None else model.slow_noise
        self.whitening.adapt(self._left(model, target, columns), slow)
        target, columns = -self._white(target)[:, 0], self._white(columns)
        sums = Sums.of(target, columns[:, self._free(model, target, columns)], self._block_of_row)
        determinants = np.bincount(self.block, weights=self.whitening.log_determinants())
        likelihood = determinants - 0.5 * predicted(sums)
        [left] = _without(columns[:, len(model.start) :], target)
        at_values = float(determinants.sum() - 0.5 * left @ left)
        beyond_noise = self.whitening.beyond_noise
        return replace(model, likelihood=likelihood, beyond_noise=beyond_noise, at_values=at_values)

    def _bounds(self, model: BalancedModel) -> tuple[np.ndarray, np.ndarray]:
        spaces = [self.space, *(e.effect.space for e in model.effects)]
        return np.concatenate([s.low for s in spaces]), np.concatenate([s.high for s in spaces])

    def _free(self, model: BalancedModel, target: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Which parameters are not held at an end of their range, (column,)."""
        low, high = self._bounds(model)
        near = SETTINGS.at_end * (high - low)
        at_low, at_high, free = (np.full(columns.shape[1], start) for start in (False, False, True))
        at_low[: len(low)], at_high[: len(low)] = model.start <= low + near, model.start >= high - near
        while True:
            step = np.zeros(len(free))
            step[free] = _solved(columns[:, free], target)
            out = free & ((at_low & (step < 0)) | (at_high & (step > 0)))
            if not out.any():
                return free
            free &= ~out

    def _moved(self, model: BalancedModel, step: np.ndarray) -> BalancedModel:
        """A step (column,) in ranges away, within them; its first columns are the parameters."""
        low, high = self._bounds(model)
        whole = np.clip(model.start + step[: len(low)] * (high - low), low, high)
        ends = np.cumsum([len(self.space), *(len(v) for v in model.values)])
        values = tuple(whole[a:b] for a, b in pairwise(ends))
        return replace(model, point=whole[: ends[0]], values=values)

    def _fitted(self, model: BalancedModel, far_off: bool) -> BalancedModel:
        """Gauss-Newton in the balance, within the bounds, over all parameters of the model and its effects."""
        if not model.effects:
            return model
        low, high = self._bounds(model)
        best, least, far = model, np.inf, SETTINGS.far
        nonlinear = far_off or any(e.effect.shapes for e in model.effects)
        for _ in range(SETTINGS.descents if nonlinear else SETTINGS.straight):
            self.on_work()
            target, columns = self._system(model)
            target, columns = self._white(target)[:, 0], self._white(columns)
            squares = np.inf  # of an effect that runs away
            if np.isfinite(columns).all() and np.abs(target).max() < SETTINGS.ran_away:
                white, by_parameter = _without(columns[:, len(low) :], target, columns[:, : len(low)])
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
            model = self._moved(best, _step(slope, left, best.start, low, high, far))
        return best

    # --- all at once ---

    def _screened(self, model: BalancedModel) -> list[Addition]:
        """The best atom of each effect that is not in the model, best first."""
        target, own, free = self._white_system(model)
        row_block = self._block_of_row
        base = Sums.of(target, own, row_block)
        blocks = [np.flatnonzero(row_block == b) for b in range(len(base.count))]
        first = np.cumsum([0] + [len(a.scale) for a in self.atoms])
        names = {e.name for e in model.effects}
        best: dict[tuple[str, int], Addition] = {}
        for size in sorted({len(a.scale) for a in self.atoms}):
            numbers = [
                k for k, a in enumerate(self.atoms) if len(a.scale) == size and a.placed.name not in names
            ]
            for some in np.array_split(numbers, -(-len(numbers) // SETTINGS.at_once)) if numbers else []:
                self.on_work()
                which = (first[some][:, None] + np.arange(size)).ravel()
                known = np.concatenate([self.atoms[n].scale for n in some])
                white = self._white([c[..., which] for c in self.columns]) * known
                each = white.reshape(len(white), len(some), size)
                gain = additions(
                    base,
                    np.array([(own[p].T @ white[p]).reshape(-1, len(some), size) for p in blocks]),
                    np.array([np.einsum("rma,rmc->mac", each[p], each[p]) for p in blocks]),
                    np.array([(target[p] @ white[p]).reshape(len(some), size) for p in blocks]),
                    np.array([self.atoms[n].expected for n in some]),
                )
                for k, number in enumerate(some):
                    atom, coefficients = self.atoms[number], gain.coefficients[k]
                    amplitudes = coefficients[-size:][: len(atom.known)] * atom.known
                    key = atom.placed.name, number if atom.placed.effect.mixes else 0
                    known_best = best.get(key)
                    if not (np.isfinite(gain.mean[k]) and atom.allows(amplitudes)):
                        continue
                    if known_best and known_best.gain >= gain.mean[k]:
                        continue
                    step = np.zeros(len(free))
                    step[free] = coefficients[:-size]
                    more = self._moved(model, step)
                    more = replace(
                        more,
                        effects=(*more.effects, atom.placed),
                        values=(*more.values, atom.at(amplitudes)),
                        likelihood=np.zeros(0),
                    )
                    response = each[:, k] @ coefficients[-size:]
                    best[key] = Addition(more, float(gain.mean[k]), float(gain.error[k]), response)
        shapes: dict[str, list[Addition]] = {}
        for addition in sorted(best.values(), key=lambda a: -a.gain):
            shapes.setdefault(addition.placed.name, []).append(addition)
        return [
            replace(
                first,
                response=first.response - own @ _solved(own, first.response),
                elsewhere=tuple(a.model for a in others),
            )
            for first, *others in shapes.values()
        ]


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
        step = _step(white[:, 1:] * space.span, white[:, 0], point, space.low, space.high, SETTINGS.far)
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


def _is_bounded(rows: Sequence[np.ndarray]) -> bool:
    """Whether no effect runs away in these rows of each stretch."""
    return all(np.abs(r).max(initial=0.0) < SETTINGS.ran_away for r in rows)


def _amplitudes(effect: PeriodicForce) -> list[int]:
    return [i for i, n in enumerate(effect.space.names) if n not in effect.shapes]


def _without(apart: np.ndarray, *rows: np.ndarray) -> list[np.ndarray]:
    """Each of `rows` (row, ...) less what the columns `apart` (row, column) fit of it."""
    return [r - apart @ _solved(apart, r) for r in rows]


def _solved(columns: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Coefficients (column,) of least squares with a prior of 1 about 0."""
    return np.linalg.solve(with_prior(columns.T @ columns), columns.T @ target)


def _step(slope, target, here, low, high, far) -> np.ndarray:
    """The step (column,), in ranges, that takes most from `target` (row,), within the bounds and a distance."""
    if not len(here):
        return np.zeros(0)
    span = high - low
    bottom, top = np.maximum((low - here) / span, -far), np.minimum((high - here) / span, far)
    whole = np.vstack([slope, np.eye(len(here))]), np.append(-target, np.zeros(len(here)))
    return lsq_linear(*whole, bounds=(bottom - 1e-12, top + 1e-12)).x
