"""The simulator linearized at a point, with the initial states of all windows eliminated.

In units of the noise, window w has r_w = residual, J_w = d outputs / d parameters and B_w = d outputs / d start, with
parameters in unit-cube coordinates and initial states in units of their prior sd. The initial states are nuisances with
a Gaussian prior from the log, so the step (dx, dz_w) minimizes

    sum_w |r_w - J_w dx - B_w dz_w|^2 + k |z_w + dz_w|^2,

with k the variance of the residual over that of the noise, times its autocorrelation time. While the model is wrong k
is large and the initial states stay where they were measured; when only noise is left k is 1 and they are fitted
freely. So a noisy initial state is not mistaken for a missing effect, and a missing effect is not hidden in the initial
states.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import mujoco
import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.noise.autocorrelation import autocorrelation_time
from capture_cli.model.parameters import ParameterSpace


@frozen
class SETTINGS:
    # of the step of one-sided differences: central ones, of parameters that are confounded
    sharper: float = 0.1
    # Of the prior sd, within the limits below; the latter where bodies touch, and short differences are jumps
    initial_step: float = 0.1
    rough_initial_step: float = 1.0
    # m, rad, m/s, rad/s; the longest is of the sd itself
    shortest: float = 1e-6
    longest: float = 1e-2
    stands_out: float = 2.0  # times the squared error of the median window
    # Ranges: a parameter that is known to no better than this may show only by what finite differences are
    # wrong by, which would take it to the end of its range.
    insensitive: float = 10.0


# arrays of a linearization, (window, ...)
BY_WINDOW = ("corrections", "residual", "by_parameter", "by_initial")


@dataclass(frozen=True)
class Data:
    """What was measured, as arrays.

    measured (window, step, output); mask (window, step, output), False for padding and where an output has no sample.
    noise_sd (output,): the noise floor, which weighs outputs against each other. initial_sd (window, state): how well
    each start is known beforehand; 0 where it may not be moved. hidden_tried (point, hidden state): the last of the
    states are effects' own, of which the log says nothing; values at which they are looked for, nan where one is left
    as it is. initial_step: of finite differences, as a share of initial_sd. movable: the states that may be moved, in
    one window at least. attitudes: which outputs make up each quaternion, (4,): what each shows of the same noise
    depends on the orientation.
    """

    space: ParameterSpace
    measured: np.ndarray
    mask: np.ndarray
    noise_sd: np.ndarray
    initial_sd: np.ndarray
    hidden_tried: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    initial_step: float = SETTINGS.initial_step
    movable: np.ndarray | None = None
    attitudes: Sequence[np.ndarray] = ()

    def __post_init__(self):
        if self.movable is None:
            object.__setattr__(self, "movable", np.flatnonzero((self.initial_sd > 0).any(axis=0)))

    @property
    def hidden(self) -> int:
        """How many of the states are effects' own."""
        return self.hidden_tried.shape[1]

    @property
    def rough(self) -> bool:
        """Whether contacts make outputs jump, so that differences are long."""
        return self.initial_step == SETTINGS.rough_initial_step

    @property
    def count(self) -> int:
        """How many numbers were measured."""
        return int(self.mask.sum())

    def residual(self, outputs: np.ndarray) -> np.ndarray:
        """Measured minus simulated (..., window, step, output), in units of the noise, as (..., window, row)."""
        residual = self.measured - outputs
        # in place: of many candidates and a long log this is what takes memory
        residual /= self.noise_sd
        residual *= self.mask
        return residual.reshape(*residual.shape[:-2], -1)

    def standing_out(self, residual: np.ndarray) -> np.ndarray:
        """The windows that a model with the residual (window, row) explains far worse than most that have samples."""
        count = self.mask.sum(axis=(1, 2))
        squares = np.square(residual).sum(axis=1) / np.maximum(count, 1)
        return np.flatnonzero(squares > SETTINGS.stands_out * np.median(squares[count > 0]))

    def other_initial_states(
        self, corrections: np.ndarray, stuck: np.ndarray, drawn: np.ndarray | None = None
    ) -> np.ndarray:
        """Corrections (trial, window, state) that the windows `stuck` might have been better begun with.

        Those are at the start as it was measured, with hidden states at each of the points where they are looked for,
        and at the points `drawn` (point, state), in units of the initial states' sd; the other windows keep their
        `corrections` (window, state).
        """
        first = corrections.shape[1] - self.hidden
        others = np.repeat(corrections[None], len(self.hidden_tried), axis=0)
        for moved, tried in zip(others, self.hidden_tried, strict=True):
            moved[stuck, :first] = 0.0
            moved[stuck, first:] = np.where(np.isnan(tried), corrections[stuck, first:], tried)
        if drawn is None or not stuck.size:
            return others
        anywhere = np.repeat(corrections[None], len(drawn), axis=0)
        anywhere[:, stuck] = drawn[:, None] * self.initial_sd[stuck]
        return np.concatenate([others, anywhere])

    def rows(self, keep: np.ndarray) -> Data:
        """The data of the windows at `keep`."""
        return replace(
            self, measured=self.measured[keep], mask=self.mask[keep], initial_sd=self.initial_sd[keep]
        )


@dataclass(frozen=True)
class Trial:
    """Simulations asked for: parameters (candidate, parameter), corrections of the initial states (candidate, window,
    state).

    windows: the numbers of those that need to be simulated; all where None. near: whether all differ little from the
    first, so that first order will do.
    """

    parameters: np.ndarray
    corrections: np.ndarray
    windows: np.ndarray | None = None
    near: bool = False

    def __len__(self) -> int:
        return len(self.parameters)

    @property
    def but_first(self) -> Trial:
        """Without its first candidate."""
        return Trial(self.parameters[1:], self.corrections[1:])


def columns(
    data: Data,
    x: np.ndarray,
    corrections: np.ndarray,
    *,
    parameters: bool = True,
    known: Known | None = None,
    near: bool = False,
) -> Trial:
    """The point x (parameter,), in the unit cube, and one finite difference per parameter and start coordinate; those
    that are `known` do not move, so that nothing is simulated for them. near: as of `Trial`.
    """
    moves = np.eye(len(x)) * parameter_steps(data.space, x) if parameters else np.zeros((0, len(x)))
    shifts = _initial_steps(data)
    if known is not None:
        moves *= ~known.parameters[:, None]
        shifts = shifts * ~known.initial
    movable = data.movable
    points = np.concatenate([x[None], x + moves, np.repeat(x[None], len(movable), axis=0)])
    moved = np.repeat(corrections[None], len(points), axis=0)
    for row, state in enumerate(movable, start=1 + len(moves)):
        moved[row, :, state] += shifts[:, state]
    return Trial(data.space.from_unit(points), moved, near=near)


def parameter_steps(space: ParameterSpace, x: np.ndarray) -> np.ndarray:
    """Finite-difference steps (parameter,) that stay in the unit cube."""
    return np.where(x + space.steps <= 1, space.steps, -space.steps)


def _initial_steps(data: Data) -> np.ndarray:
    return np.maximum(data.initial_step * np.minimum(data.initial_sd, SETTINGS.longest), SETTINGS.shortest)


@dataclass(frozen=True)
class Known:
    """Sensitivities that were measured elsewhere, by another model or with fewer initial states that may move.

    parameters (parameter,), initial (window, state): which. by_parameter (window, row, parameter) and by_initial
    (window, row, movable state), 0 for the others. updates: as of a linearization. at_minimum: whether a smaller
    model has its minimum where the descent begins, with what it lacks at null.
    """

    parameters: np.ndarray
    initial: np.ndarray
    by_parameter: np.ndarray
    by_initial: np.ndarray
    updates: int
    at_minimum: bool = False

    def completed(self, measured: Linearization) -> Linearization:
        """The linearization with these, from one in which what is known did not move."""
        return replace(
            measured,
            by_parameter=measured.by_parameter + self.by_parameter,
            by_initial=measured.by_initial + self.by_initial,
            updates=self.updates,
        )


@dataclass(frozen=True)
class Linearization:
    """residual (window, row), by_parameter (window, row, parameter), by_initial (window, row, state).

    updates: by how many steps its sensitivities were updated since they were measured. exact: whether what they were
    measured by was simulated, not taken to first order.
    """

    data: Data
    x: np.ndarray
    corrections: np.ndarray
    residual: np.ndarray
    by_parameter: np.ndarray
    by_initial: np.ndarray
    updates: int = 0
    exact: bool = True

    @classmethod
    def from_columns(cls, data: Data, x, corrections, outputs, diverged, *, parameters: bool = True):
        """From what the trial of `columns` gave. A difference that diverged counts as no sensitivity."""
        residuals = data.residual(outputs)
        size = len(x) if parameters else 0
        residual, slopes = residuals[0].copy(), residuals[1:]
        np.subtract(residual, slopes, out=slopes)
        slopes *= ~diverged[1:, :, None]
        by_parameter, by_initial = slopes[:size], slopes[size:]
        by_parameter /= parameter_steps(data.space, x)[:size, None, None]
        scale = (data.initial_sd / _initial_steps(data))[:, data.movable]
        by_initial *= scale.T[:, :, None]
        return cls(
            data, x, corrections, residual, np.moveaxis(by_parameter, 0, -1), np.moveaxis(by_initial, 0, -1)
        )

    def central(self) -> Trial:
        """Central differences along the parameters: first all to one side, then all to the other."""
        points = self.data.space.from_unit(np.concatenate(self._sides()))
        return Trial(points, np.repeat(self.corrections[None], len(points), axis=0))

    def with_central(self, outputs: np.ndarray, diverged: np.ndarray) -> Linearization:
        """With sensitivities from what the trial of `central` gave; a parameter of which one side is beyond the bounds
        or diverged keeps its own.
        """
        above, below = self._sides()
        steps = np.diag(above - below)
        after, before = np.split(self.data.residual(outputs), 2)
        known = (np.diag(above) != self.x) & (np.diag(below) != self.x)
        slopes = (before - after) / np.where(known, steps, 1.0)[:, None, None]
        known = known[:, None] & ~np.logical_or(*np.split(diverged, 2))
        slopes = np.where(known[:, :, None], slopes, np.moveaxis(self.by_parameter, -1, 0))
        return replace(self, by_parameter=np.moveaxis(slopes, 0, -1))

    def _sides(self) -> tuple[np.ndarray, np.ndarray]:
        """Points (parameter, parameter) above and below x in one parameter each; x where that is beyond a bound."""
        steps = np.diag(self.data.space.steps * (1.0 if self.data.rough else SETTINGS.sharper))
        above, below = self.x + steps, self.x - steps
        return np.where(above > 1, self.x, above), np.where(below < 0, self.x, below)

    def moved(self, x: np.ndarray, corrections: np.ndarray, residual: np.ndarray) -> Linearization:
        """This linearization updates to x (parameter,), corrections (window, state) and the residual (window, row)
        there.

        The sensitivities get the least change that explains the residual (Broyden 1965); those of parameters that
        showed next to nothing get none.
        """
        dx = x - self.x
        dz = scaled_corrections(self.data, corrections - self.corrections)[:, self.data.movable]
        expected = self.residual - self.by_parameter @ dx - (self.by_initial @ dz[..., None])[..., 0]
        along = np.where(self.insensitive, 0.0, dx)
        square = float(along @ along)
        change = (expected - residual)[..., None] * (along / square) if square > 0 else 0.0
        by_parameter = self.by_parameter + change
        return replace(
            self,
            x=x,
            corrections=corrections,
            residual=residual,
            by_parameter=by_parameter,
            updates=self.updates + 1,
        )

    def known_in(self, data: Data, parameters: int, states: int) -> Known | None:
        """What this says of `data`, whose first `parameters` and `states` are those of this one; None where it has
        other samples.
        """
        own = self.data
        if own.measured.shape != data.measured.shape or not np.array_equal(own.mask, data.mask):
            return None
        by_parameter = np.zeros((*self.residual.shape, len(data.space)))
        by_parameter[..., :parameters] = self.by_parameter[..., :parameters]
        sd, now = own.initial_sd[:, :states], data.initial_sd[:, :states]
        initial = np.zeros(data.initial_sd.shape, dtype=bool)
        initial[:, :states] = (sd == now) & (sd > 0)
        by_initial = np.zeros((*self.residual.shape, len(data.movable)))
        for column, state in enumerate(data.movable):
            if initial[:, state].any():
                known = self.by_initial[..., np.searchsorted(own.movable, state)]
                by_initial[..., column] = known * initial[:, state, None]
        which = np.arange(len(data.space)) < parameters
        return Known(which, initial, by_parameter, by_initial, self.updates)

    def windows(self, keep: np.ndarray) -> Linearization:
        """The linearization of the windows at `keep`."""
        arrays = {name: getattr(self, name)[keep] for name in BY_WINDOW}
        return replace(self, data=self.data.rows(keep), **arrays)

    def with_windows(self, index: np.ndarray, other: Linearization) -> Linearization:
        """This one with the windows at `index` taken from `other`, which has those windows alone."""
        arrays = {name: getattr(self, name).copy() for name in BY_WINDOW}
        for name, values in arrays.items():
            values[index] = getattr(other, name)
        return replace(self, **arrays)

    @cached_property
    def z(self) -> np.ndarray:
        """Corrections of the movable initial states in units of their sd, (window, state)."""
        movable = self.data.movable
        sd = self.data.initial_sd[:, movable]
        return np.divide(self.corrections[:, movable], sd, out=np.zeros_like(sd), where=sd > 0)

    @property
    def insensitive(self) -> np.ndarray:
        """Which parameters show next to nothing here, (parameter,)."""
        return np.square(self.by_parameter).sum(axis=(0, 1)) <= self.inflation / SETTINGS.insensitive**2

    @cached_property
    def inflation(self) -> float:
        """k: the variance of the residual over that of the noise times its autocorrelation time; at least 1."""
        return inflation(self.data, self.residual)

    @cached_property
    def products(self) -> tuple[np.ndarray, ...]:
        """JJ (window, p, p), JB (window, p, s), BB (window, s, s), Jr (window, p), Br (window, s)."""
        j, b, r = self.by_parameter, self.by_initial, self.residual[..., None]
        jt, bt = j.swapaxes(1, 2), b.swapaxes(1, 2)
        return jt @ j, jt @ b, bt @ b, (jt @ r)[..., 0], (bt @ r)[..., 0]

    def initial_gain(self, k: float, damping: np.ndarray | float = 0.0) -> np.ndarray:
        """(B'B + (k + damping) 1)^-1, (window, state, state); damping per window (window,) or one for all."""
        bb = self.products[2]
        ridge = np.broadcast_to(k + damping, len(bb))[:, None, None]
        return np.linalg.inv(bb + ridge * np.eye(bb.shape[-1]))

    @property
    def fitted_initial(self) -> float:
        """How many free numbers the initial states amount to, their prior counted."""
        k = self.inflation
        return float((1 - k * np.diagonal(self.initial_gain(k), axis1=1, axis2=2)).sum())

    @cached_property
    def taken_by_hidden(self) -> np.ndarray:
        """By how many squares of the noise hidden states of effects make those of the residual less by chance,
        (window,): by more than their own share where the other states go along with them.
        """
        hidden = self.data.movable >= self.data.initial_sd.shape[1] - self.data.hidden
        # never fewer than the others alone (eigenvalues interlace), but for rounding
        return np.maximum(self.taken - self._taken_by(~hidden), 0.0)

    @cached_property
    def taken(self) -> np.ndarray:
        """Likewise all initial states, (window,)."""
        return self._taken_by(np.ones(len(self.data.movable), dtype=bool))

    def _taken_by(self, states: np.ndarray) -> np.ndarray:
        """Likewise of these states (movable state,) alone: with H what they make of a residual r, the squares of
        (1 - H) r are those of n - tr(2 H - H^2) numbers.
        """
        k, bb = self.inflation, self.products[2][:, states][:, :, states]
        left = k / (np.linalg.eigvalsh(bb) + k)
        return (1 - np.square(left)).sum(axis=1)

    @property
    def information(self) -> np.ndarray:
        """What each window says of each parameter alone, its start fitted too, (window, parameter)."""
        through = self.initial_gain(self.inflation) @ self.products[1].swapaxes(1, 2)
        return np.square(self.by_parameter - self.by_initial @ through).sum(axis=1)

    @property
    def leverage(self) -> np.ndarray:
        """What share of each residual's own noise the initial states take up, (window, row)."""
        b = self.by_initial
        return ((b @ self.initial_gain(self.inflation)) * b).sum(axis=-1)

    def normal(self, k: float, damping: np.ndarray | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Hessian (p, p) and downhill gradient (p,) of half the objective, initial states eliminated."""
        jj, jb, _, jr, br = self.products
        gain = self.initial_gain(k, damping)
        through = jb @ gain
        hessian = (jj - through @ jb.swapaxes(1, 2)).sum(axis=0)
        gradient = (jr - (through @ (br - k * self.z)[..., None])[..., 0]).sum(axis=0)
        return hessian, gradient

    @property
    def whole_step(self) -> np.ndarray:
        """The parameter step (parameter,), in the unit cube, to where the linearization is lowest within it."""
        return self.bounded_step(self.inflation, -self.x, 1 - self.x)

    def whole_gain(self, k: float) -> float:
        """How much the objective should fall by the whole step."""
        dx = self.whole_step
        return self.predicted_gain(dx, self.corrections_after(dx, k), k)

    def bounded_step(
        self, k: float, low: np.ndarray, high: np.ndarray, damping: np.ndarray | float = 0.0
    ) -> np.ndarray:
        """Likewise to where it is lowest within low <= step <= high (parameter,). What shows next to nothing stays."""
        return held_step(*self.normal(k, damping), k, low, high)

    def corrections_after(self, dx: np.ndarray, k: float, damping: np.ndarray | float = 0.0) -> np.ndarray:
        """Corrections (window, state), SI, that belong to the parameter step dx (parameter,)."""
        _, jb, _, _, br = self.products
        right = br - (jb.swapaxes(1, 2) @ dx) - k * self.z
        dz = (self.initial_gain(k, damping) @ right[..., None])[..., 0]
        movable = self.data.movable
        corrections = self.corrections.copy()
        corrections[:, movable] = (self.z + dz) * self.data.initial_sd[:, movable]
        return corrections

    def predicted_gain(self, dx: np.ndarray, corrections: np.ndarray, k: float) -> float:
        """How much the objective should fall by the step to `corrections` (window, state) and dx (parameter,)."""
        return float(self.predicted_gains(dx, corrections, k).sum())

    def predicted_gains(self, dx: np.ndarray, corrections: np.ndarray, k: float) -> np.ndarray:
        """Likewise of each window, (window,)."""
        z = scaled_corrections(self.data, corrections)[:, self.data.movable]
        dz = z - self.z
        residual = self.residual - self.by_parameter @ dx - (self.by_initial @ dz[..., None])[..., 0]
        return self.objectives(k) - objectives(residual, z, k)

    def objectives(self, k: float) -> np.ndarray:
        """The objective of each window, (window,)."""
        return objectives(self.residual, self.z, k)


def objectives(residual: np.ndarray, z: np.ndarray, k: float) -> np.ndarray:
    """Squared residuals (..., window, row) and, weighed by k, initial states' corrections (..., window, state), per
    window.
    """
    return np.square(residual).sum(axis=-1) + k * np.square(z).sum(axis=-1)


def trial_objectives(
    data: Data, corrections: np.ndarray, outputs: np.ndarray, diverged: np.ndarray, k: float
) -> np.ndarray:
    """Objectives (trial, window) of what states moved by `corrections` (trial, window, state) gave: inf where it
    diverged.

    outputs (trial, window, step, output), diverged (trial, window).
    """
    values = objectives(data.residual(outputs), scaled_corrections(data, corrections), k)
    return np.where(diverged | ~np.isfinite(values), np.inf, values)


def best_trials(corrections: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The best trial of each window: its corrections (window, state) and its value (window,).

    corrections (trial, window, state), values (trial, window).
    """
    pick, window = np.argmin(values, axis=0), np.arange(values.shape[1])
    return corrections[pick, window], values[pick, window]


def scaled_corrections(data: Data, corrections: np.ndarray) -> np.ndarray:
    """Corrections (..., window, state) in units of their prior sd."""
    sd = data.initial_sd
    return np.divide(
        corrections, sd, out=np.zeros_like(corrections), where=np.broadcast_to(sd > 0, corrections.shape)
    )


def inflation(data: Data, residual: np.ndarray) -> float:
    """Variance of the residual (window, row), in units of the noise's, times its autocorrelation time; at least 1."""
    variance = float(np.square(residual).sum() / max(data.count, 1))
    shaped = residual.reshape(data.measured.shape)
    return max(1.0, variance * autocorrelation_time(shaped, data.mask))


def held_step(
    hessian: np.ndarray, gradient: np.ndarray, k: float, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """As `box_step`, of an objective whose noise has the variance k; what shows next to nothing stays."""
    return box_step(hessian + k / SETTINGS.insensitive**2 * np.eye(len(gradient)), gradient, low, high)


def box_step(hessian: np.ndarray, gradient: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Minimizes d'Hd/2 - g'd over low <= d <= high, which may be equal; directions without curvature are left alone."""
    size = len(gradient)
    if size == 0:
        return np.zeros(0)
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-12 * max(np.trace(hessian), 1e-300)))
    regular = hessian / np.outer(scale, scale) + 1e-9 * np.eye(size)
    step = np.zeros(size)
    factor = np.zeros((size, size + 7))
    bottom, top = low * scale, high * scale
    top = np.maximum(top, np.nextafter(bottom, np.inf))  # mju_boxQP takes no bounds that are equal
    rank = mujoco.mju_boxQP(step, factor, None, regular, -gradient / scale, bottom, top)
    return step / scale if rank >= 0 else np.clip(gradient / scale**2, low, high)
