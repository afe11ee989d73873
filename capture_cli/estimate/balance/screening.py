"""Every effect at once: how much better does each predict the accelerations of blocks that it was not fitted to?

The declared parameters, and the effects that a model has already, are fitted anew with each addition, in the force
balance; nothing is simulated. What comes out is a ranking, with the values that a fit through the simulator begins at.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence, Set
from contextlib import closing
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.common.processes import in_processes
from capture_cli.common.similarity import similarity
from capture_cli.errors import LogError
from capture_cli.estimate.balance.balanced_fits import BalancedFits, declared, declared_balance
from capture_cli.estimate.balance.balanced_model import BalancedModel, with_numbers
from capture_cli.estimate.balance.dictionary import Atom, atoms
from capture_cli.estimate.balance.force_balance import ForceBalance
from capture_cli.estimate.balance.motion import SmoothedLog
from capture_cli.estimate.balance.regression import Gain, Sums, additions, best_pairs, without
from capture_cli.estimate.balance.whitening import Whitening
from capture_cli.log.input_sequences import Hold
from capture_cli.model.effects.placed import Placed


@frozen
class SETTINGS:
    """polished: of the best additions, whose nonlinear parameters are fitted in the balance; more are, so many times as
    many at most, until as many predict better than the next one's columns; polished_for_best: where one is asked for.
    at_once: atoms whose sums are in memory. alike: cosine of responses beyond which effects do not differ.
    by_chance: how often the best addition to a model that lacks nothing may be taken for an effect; sure: standard
    errors of a gain beyond which there is one.
    """

    polished: int = 8
    most_polished: int = 3
    polished_for_best: int = 2
    at_once: int = 400
    alike: float = 0.98
    by_chance: float = 0.01
    sure: float = 3.0


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
    """Of `placed` effects, beside models that are fitted in a balance of a smoothed log by its `fits`.

    covered: effects that have columns; decided: those of them that simulations need not be asked of, too.
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
        self._set(BalancedFits(balance, whitening))
        self.atoms, self.columns = self._dictionary(placed, on_step)
        self.covered = frozenset(a.placed.name for a in self.atoms)
        self.decided = self._decided()

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

    def _decided(self) -> frozenset[str]:
        """Of the effects that are `covered`, those that simulations need not be asked of, too: where bodies hit none on
        sensors or controls, and none that shows in no row. Impacts are left out of the balance, and they tell where a
        body is, and where it was led.
        """
        if not self.balance.smoothed.hits:
            return self.covered
        shown = {a.placed.name for a, white in self._atoms_by_noise() if np.square(white).sum() > 1}
        return frozenset(
            shown - {p.name for p in self.placed if p.effect.place in ("measurement", "control")}
        )

    def _atoms_by_noise(self) -> Iterator[tuple[Atom, np.ndarray]]:
        """Each atom, and its columns (row, column) over the noise of the sensors alone: below 1 in all they say less of
        coefficients than is known beforehand.
        """
        self.whitening.reset()
        for some, which in self._portions(frozenset()):
            white = self._white_columns(some, which)
            yield from ((self.atoms[n], white[:, k]) for k, n in enumerate(some))

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
            other = self._in(balance, self.whitening.about(balance))
        if other.fits.runs_away(BalancedModel(tuple(effects), point, tuple(values))):
            names = " and ".join(p.name for p in effects)
            raise LogError(f"with {names} the model runs away along the log", cure="")
        return other

    def with_new_columns(self, places: Set[str]) -> Screening:
        """The same, with the columns of effects of these `places` made in this balance: far from the declared model a
        late command acts at other states.
        """
        new, other = [p for p in self.placed if p.effect.place in places], copy(self)
        other._known = {}
        made, columns = self._dictionary(new, lambda *_: None)
        old = [a.placed.effect.place not in places for a in self.atoms]
        of_old = np.repeat(old, [len(a.scale) for a in self.atoms])
        other.atoms = [a for a, keep in zip(self.atoms, old, strict=True) if keep] + made
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
        other._set(BalancedFits(balance, whitening, self.fits.on_work))
        return other

    def _set(self, fits: BalancedFits) -> None:
        self.fits, self.balance, self.whitening = fits, fits.balance, fits.whitening
        self._known: dict[tuple, object] = {}

    # --- columns ---

    def _dictionary(self, placed: Sequence[Placed], on_step: Callable) -> tuple[list[Atom], list[np.ndarray]]:
        """Atoms of effects, and rows (row, nv, column) of each stretch of them, in single precision: there may be
        thousands, or none.
        """
        made, rows = [], [[r.astype(np.float32) for r in self.whitening.rows([])]]
        found = in_processes(self._atoms, placed, self.balance.threads)
        for number, one in enumerate(placed):
            on_step("balance", number, len(placed))
            own, columns = next(found)
            if own:
                made += [replace(atom, placed=one) for atom in own]
                rows.append(columns)
        stretches = range(len(self.whitening.averages))
        return made, [np.concatenate([r[n] for r in rows], axis=-1) for n in stretches]

    def _atoms(self, placed: Placed) -> tuple[list[Atom], list[np.ndarray]]:
        """Its atoms, without the effect, and their rows (row, nv, column) of each stretch, in single precision."""
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # what runs away is left out
            own = list(atoms(self.balance, placed))
        columns = [c for _, columns in own for c in columns]
        rows = [r.astype(np.float32) for r in self.whitening.rows(columns)] if own else []
        return [replace(atom, placed=None) for atom, _ in own], rows

    # --- one effect more ---

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
        model = self.fits.fitted(self.fits.judged(self.fits.with_slow_noise(begin)))
        model = self.fits.judged(self.fits.with_slow_noise(model))
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
                best = int(np.argmax([m.at_values.sum() for m in begun]))
                more, (gain, error) = begun[best], gains[best]
                if np.isfinite(gain):
                    polished.append(replace(addition, model=more, gain=gain, error=error))
        return model, sorted(polished, key=lambda a: -a.gain) + rest

    def _polished(self, begin: BalancedModel, asked: Sequence[Addition]) -> Iterator[list[BalancedModel]]:
        """The models of each addition to `begin`, fitted when they are asked for."""
        keys = [("polished", begin.key, a.placed.name) for a in asked]
        new = [a for a, key in zip(asked, keys, strict=True) if not self.knows(key)]
        fitted = in_processes(
            lambda a: [self.fits.fitted(m, far_off=far_off).numbers for m, far_off in self._begun(a)],
            new,
            self.balance.threads,
        )
        with closing(fitted):
            for addition, key in zip(asked, keys, strict=True):
                models = [m for m, _ in self._begun(addition)]
                yield self.remembered(key, lambda models=models: with_numbers(models, next(fitted)))

    def _begun(self, addition: Addition) -> list[tuple[BalancedModel, bool]]:
        """Where fits of an addition begin, and whether that is far off: with each of its shapes; and, of one that
        changes the model, with declared parameters that are at an end of their range at nominal. They may have been
        driven there for want of it: a mass for want of a moment, which is a product with it.
        """
        model = addition.model
        at_end = np.any(self.fits.at_ends(model), axis=0)[: len(model.point)]
        free = np.where(at_end, self.fits.space.nominal, model.point)
        begun = [(m, False) for m in (model, *addition.elsewhere)]
        if addition.placed.effect.place == "model" and (free != model.point).any():
            begun.append((replace(model, point=free), True))
        return begun

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
        return [self.fits.fitted(a.model) for a in simpler]

    # --- from columns alone ---

    def screened(self, model: BalancedModel) -> list[Addition]:
        """Of each effect that is not in the model, best first, from columns alone: none is polished."""
        self.whitening.reset()
        return self._screened(self.fits.judged(model))

    def _screened(self, model: BalancedModel) -> list[Addition]:
        """The best atom of each effect that is not in the model, best first."""
        target, own, free = self.fits.white_system(model)
        base = Sums.of(target, own, self.fits.block_of_row)
        best: dict[tuple[str, int], Addition] = {}
        for some, which in self._portions({e.name for e in model.effects}):
            self.fits.on_work()
            each = self._white_columns(some, which)
            gain = self._gain(base, target, own, each, [self.atoms[n].expected for n in some])
            for k, number in enumerate(some):
                atom, mean, error = self.atoms[number], float(gain.mean[k]), float(gain.error[k])
                of_base, of_atom = np.split(gain.coefficients[k], [-each.shape[2]])
                amplitudes = atom.amplitudes_by(of_atom)
                key = atom.placed.name, number if atom.placed.effect.mixes else 0
                is_best = key not in best or mean > best[key].gain
                if np.isfinite(mean) and atom.allows(amplitudes) and is_best:
                    step = np.zeros(len(free))
                    step[free] = of_base
                    more = _with_atom(self.fits.moved(model, step), atom, amplitudes)
                    best[key] = Addition(more, mean, error, each[:, k] @ of_atom)
        return _by_effect(best.values(), own)

    def _portions(self, inside: Set[str]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Numbers of atoms with as many columns, as many as fit into memory at once, and those of their columns; none
        of the effects `inside`.
        """
        sizes = np.array([len(a.scale) for a in self.atoms], dtype=int)
        first = np.cumsum(sizes) - sizes
        outside = np.array([a.placed.name not in inside for a in self.atoms], dtype=bool)
        for size in np.unique(sizes[outside]):
            numbers = np.flatnonzero(outside & (sizes == size))
            for some in np.array_split(numbers, -(-len(numbers) // SETTINGS.at_once)):
                yield some, (first[some][:, None] + np.arange(size)).ravel()

    def _white_columns(self, some: np.ndarray, which: np.ndarray) -> np.ndarray:
        """Columns `which`, those of the atoms of these numbers, white, over how large their coefficients may be, (row,
        atom, column).
        """
        known = np.concatenate([self.atoms[n].scale for n in some])
        white = self.fits.white([c[..., which] for c in self.columns]) * known
        return white.reshape(len(white), len(some), -1)

    def _gain(
        self,
        base: Sums,
        target: np.ndarray,
        own: np.ndarray,
        each: np.ndarray,
        expected: Sequence[np.ndarray],
    ) -> Gain:
        """Of each atom with columns `each` (row, atom, column) beside the model's `own` (row, column), whose sums are
        `base`. expected (atom, column): of their coefficients, what they are about beforehand.
        """
        block_of_row, (_, *shape) = self.fits.block_of_row, each.shape
        white = each.reshape(len(each), -1)
        blocks = [np.flatnonzero(block_of_row == b) for b in range(len(base.count))]
        return additions(
            base,
            np.array([(own[p].T @ white[p]).reshape(-1, *shape) for p in blocks]),
            np.array([np.einsum("rma,rmc->mac", each[p], each[p]) for p in blocks]),
            np.array([(target[p] @ white[p]).reshape(shape) for p in blocks]),
            np.array(expected),
        )

    # --- two more, and ties ---

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
        target, own, _ = self.fits.white_system(self.fits.judged(model))
        [left], found = without(own, target), []
        for one, other in best_pairs(
            np.array([a.response for a in additions]),
            left,
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


def _with_atom(model: BalancedModel, atom: Atom, amplitudes: np.ndarray) -> BalancedModel:
    """The model, not judged yet, with the atom's effect at these amplitudes."""
    effects, values = (*model.effects, atom.placed), (*model.values, atom.at(amplitudes))
    return replace(model, effects=effects, values=values, likelihood=np.zeros(0))


def _by_effect(found: Iterable[Addition], own: np.ndarray) -> list[Addition]:
    """One addition of each effect, best first, with the others of it `elsewhere`; responses less what the columns `own`
    (row, column) fit of them.
    """
    shapes: dict[str, list[Addition]] = {}
    for addition in sorted(found, key=lambda a: -a.gain):
        shapes.setdefault(addition.placed.name, []).append(addition)
    return [
        replace(
            first,
            response=without(own, first.response)[0],
            elsewhere=tuple(a.model for a in others),
        )
        for first, *others in shapes.values()
    ]
