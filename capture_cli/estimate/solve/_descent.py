"""A Gauss-Newton descent in the unit cube with a trust region, the initial states of all windows eliminated.

Nocedal & Wright, Numerical Optimization, 2nd ed., sections 10.3 and 4.1. At every trial point the initial states are
minimized over, window by window, as in variable projection (Golub & Pereyra 1973): F(x) = sum_w min_z f_w(x, z).
"""

from dataclasses import replace

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.solve.base import Best
from capture_cli.estimate.solve.linearization import (
    Data,
    Known,
    Linearization,
    Trial,
    best_trials,
    columns,
    trial_objectives,
)


@frozen
class SETTINGS:
    radius: float = 0.25  # of the unit cube, the first trust region
    shrink: float = 0.25  # of a step that failed: the next trust region
    most_failed: int = 3  # steps in a row, each shorter than the last, by sensitivities that were measured
    # Of the objective over k: less that is promised and not kept is lost in roughness; where contacts make
    # the error rough, more, or a descent goes on for a hundred rounds by a tenth of a standard error at a
    # time.
    lost: float = 0.1
    lost_if_rough: float = 0.5
    most_vain: int = 2  # steps, one after the other, that were shortened and bring less than that
    # Steps from where it begins after which k is held. It depends on the residual and the residual on it:
    # where the model is wrong the two can chase each other for ever.
    settled: int = 15
    # Beyond FAR noise floors there is no exact fit to be had: a tolerance of 1 is this share of the
    # objective, at least
    far: float = 2.0
    share: float = 0.03
    searches: int = 3  # times that it looks for windows that got stuck
    updates: int = 3  # steps in a row with sensitivities that were updated rather than measured
    pace: int = 8  # rounds: how fast a descent goes is how far it came in these
    # of a window's curvature: by what its initial states move less
    damped: tuple[float, ...] = (0.1, 1.0, 10.0)
    let_go: float = 10.0  # a window's damping is so many times less after each step


class Descent:
    """One Gauss-Newton descent in the unit cube, from x (parameter,); known: as of `Identifier`.

    Given the parameters the objective is a sum over windows. So a window that a step makes worse than foreseen (a
    contact lost, a joint that sticks) is simulated again alone, with initial states that move less or not at all, and
    takes the best; the others keep their step. Each window has a damping of its own.
    """

    def __init__(
        self,
        data: Data,
        x: np.ndarray,
        corrections: np.ndarray,
        tolerance: float,
        known: Known | None,
        *,
        measured: bool,
    ):
        # whether first order will do for sensitivities: what jumps has none, and where only ratios are known its error
        # would say how large they are
        self._near = not (data.rough or measured)
        self.data = data
        self.tolerance = tolerance
        self.x = np.clip(x, 0.0, 1.0)
        self.corrections = corrections
        self.error = np.inf
        self.converged = False
        self.stopped_early = False  # by whoever asks, who knows of a better one
        self.rounds = 0
        self._moves = 0
        self._known = known
        self._measured = measured
        self._at: Linearization | None = None
        self._k = np.inf
        self._settled = SETTINGS.settled
        self._radius = SETTINGS.radius
        self._damping = np.zeros(len(data.initial_sd))
        self._windows: np.ndarray | None = None  # that a trial concerns, where not all
        self._predicted_gain = np.inf
        self._tried = ()  # the step that windows are asked for again with
        self._failed = 0
        self._vain = 0
        # where a smaller model has its minimum other initial states were looked for
        self._searches = 0 if known is not None and known.at_minimum else SETTINGS.searches
        self._errors: list[float] = []  # after each round
        self._promises: list[float] = []  # the least error by each linearization that was measured
        self._since = np.inf  # the objective at the last of them
        self._measure()

    @property
    def best(self) -> Best:
        return Best(self.data.space.from_unit(self.x), self.corrections, self.error)

    @property
    def at(self) -> Linearization | None:
        """The linearization where it is, measured there or updated; None before the first."""
        return self._at

    @property
    def _updates(self) -> int:
        return self._at.updates if self._at else 0

    @property
    def expected(self) -> float:
        """The error that its next step promises by sensitivities that were measured; 0 where they were not."""
        if self._updates or not np.isfinite(self._predicted_gain):
            return 0.0
        return self._error_after(self._predicted_gain)

    @property
    def _little(self) -> float:
        """Of the objective: a gain that is not worth another round."""
        far = self.error > SETTINGS.far
        return self.tolerance * max(self._k, SETTINGS.share * self.error**2 * self.data.count * far)

    @property
    def _lost(self) -> float:
        """Of the objective: what is promised, and not kept, for roughness alone."""
        return max((SETTINGS.lost_if_rough if self.data.rough else SETTINGS.lost) * self._k, self._little)

    def ask(self) -> Trial:
        """One candidate, with its finite differences where they are due; or several without, to choose from."""
        if self._told == self._tell_measured:
            return columns(self.data, *self._trials[0], known=self._known, near=self._near)
        x, corrections = (np.stack(part) for part in zip(*self._trials, strict=True))
        return Trial(self.data.space.from_unit(x), corrections, self._windows)

    def tell(self, outputs, diverged, exact: bool = True):
        """A trial of few windows is no round of its own. exact: whether all was simulated."""
        of_all = self._windows is None
        self._exact = exact
        self._told(outputs, diverged)
        if of_all:
            self.rounds += 1
            self._errors.append(self.error)

    def would_reach(self, error: float, rounds: int) -> bool:
        """Whether it gets down to `error` in so many more rounds if it goes on as in the last `pace`."""
        if self.error <= error or len(self._errors) <= SETTINGS.pace:
            return True
        gained = self._errors[-1 - SETTINGS.pace] - self.error
        return self.error - rounds / SETTINGS.pace * gained <= error

    def falls_short_of(self, error: float) -> bool:
        """Whether the last two linearizations that were measured put their least error above `error`."""
        return len(self._promises) > 1 and min(self._promises[-2:]) > error

    def _measure(self) -> None:
        """Ask next for the sensitivities where it is."""
        self._trials, self._told = [(self.x, self.corrections)], self._tell_measured

    def _measure_exactly(self) -> None:
        """Likewise, and from now on by simulations of each."""
        self._near, self._failed, self._vain = False, 0, 0
        self._measure()

    def _tell_measured(self, outputs, diverged) -> None:
        x, corrections = self._trials[0]
        there = Linearization.from_columns(self.data, x, corrections, outputs, diverged)
        there = replace(there, exact=self._exact)
        if self._known is not None:
            there, self._known = self._known.completed(there), None
        if diverged[0].any() or not np.isfinite(there.residual).all():
            self.converged = True
            return
        self._move(there)
        self._propose()

    def _tell_step(self, outputs, diverged) -> None:
        """Windows that are worse than foreseen are asked for again; with the others' step it is judged after that."""
        x, corrections = self._trials[0]
        k, at = self._k, self._at
        before = at.objectives(k)
        [after] = trial_objectives(self.data, corrections[None], outputs, diverged, k)
        foreseen = before - at.predicted_gains(x - self.x, corrections, k)
        self._tried = x, corrections, self.data.residual(outputs[0]), after
        worse = (after > np.maximum(before, foreseen + k)) & (corrections != self.corrections).any(axis=1)
        if not worse.any():
            self._judge(worse)
            return
        dampings = [self._damping + share * self._curvature for share in SETTINGS.damped]
        damped = [at.corrections_after(x - self.x, k, damping) for damping in dampings]
        self._trials = [(x, z) for z in (self.corrections, *damped)]
        self._windows, self._told = np.flatnonzero(worse), self._tell_worse

    @property
    def _curvature(self) -> np.ndarray:
        """Of each window's objective along its initial states, on average, (window,): of less, directions that show
        little take no notice.
        """
        return np.trace(self._at.products[2], axis1=1, axis2=2) / max(len(self.data.movable), 1) + self._k

    def _tell_worse(self, outputs, diverged) -> None:
        """Each takes the best of its initial states."""
        self._windows = None
        x, corrections, residual, after = self._tried
        others, values = self._trials_judged(outputs, diverged)
        best, found = best_trials(others, values)
        residuals = self.data.residual(outputs)[values.argmin(axis=0), np.arange(len(after))]
        back = found < after
        self._tried = (
            x,
            np.where(back[:, None], best, corrections),
            np.where(back[:, None], residuals, residual),
            np.where(back, found, after),
        )
        self._judge(back)

    def _judge(self, back: np.ndarray) -> None:
        """Take the step that was tried, or not. back (window,): which windows went back; those are damped if it is."""
        x, corrections, residual, after = self._tried
        gained = float((self._at.objectives(self._k) - after).sum())
        if gained < self._little:
            self._reject(x)
            return
        less = np.where(self._damping > 1e-3 * self._k, self._damping / SETTINGS.let_go, 0.0)
        more = np.maximum(self._damping, self._curvature / SETTINGS.let_go)
        self._damping = np.where(back, more, less)
        self._accept(self._at.moved(x, corrections, residual), gained)

    def _accept(self, there: Linearization, gained: float) -> None:
        self._vain = self._vain + 1 if self._failed and gained < self._lost else 0
        self._failed = 0
        if self._moves == 1:
            self._searches = SETTINGS.searches
        self._radius = min(2 * self._radius, 1.0)
        self._move(there)
        if self._vain == SETTINGS.most_vain:
            self._give_up()
        elif self._updates > SETTINGS.updates or not self.x.size:
            self._measure()
        else:
            self._propose()

    def _reject(self, x: np.ndarray) -> None:
        self._failed += not self._updates
        if self._updates:
            self._measure()
        elif self._predicted_gain < self._lost or self._failed == SETTINGS.most_failed:
            self._give_up()
        else:
            moved = float(np.abs(x - self.x).max(initial=0.0))
            if moved:  # else initial states moved alone
                self._radius = SETTINGS.shrink * moved
            self._damping = np.maximum(self._damping / SETTINGS.shrink, self._k)
            self._propose()

    def _settle(self) -> None:
        """Nothing more to gain: done, if the sensitivities that say so were measured here, or need not be and nothing
        was gained since they were.
        """
        gained = self._since - float(self._at.objectives(self._k).sum())
        if self._updates and (self._measured or gained > self._little):
            self._measure()
        elif self._searches:
            self._propose_other_initial_states()
        else:
            self.converged = True

    def _give_up(self) -> None:
        """No way on from here; there may be one by exact sensitivities, or from where hidden states are others."""
        if not self._at.exact:
            self._measure_exactly()
        elif self._may_search:
            self._propose_other_initial_states()
        else:
            self.converged = True

    @property
    def _may_search(self) -> bool:
        return self._searches > 0 and len(self.data.hidden_tried) > 0

    def _propose_other_initial_states(self) -> None:
        """Where each window might have got stuck: its start as it was measured, and hidden states elsewhere, which are
        many and looked for where windows stand out alone.
        """
        self._searches -= 1
        stuck = self.data.standing_out(self._at.residual)
        hidden = self.data.other_initial_states(self.corrections, stuck) if stuck.size else ()
        others = [np.zeros_like(self.corrections), *hidden]
        self._trials, self._told = [(self.x, o) for o in others], self._tell_other_initial_states
        self._windows = stuck if len(hidden) else None

    def _tell_other_initial_states(self, outputs, diverged) -> None:
        """Go on where some windows have a better start after all."""
        self._windows = None
        corrections, values = self._trials_judged(outputs, diverged)
        best, found = best_trials(corrections, values)
        before = self._at.objectives(self._k)
        keeps = before <= found
        if (before - found)[~keeps].sum() < self._little:
            self.converged = True
        else:
            self._restart(np.where(keeps[:, None], self.corrections, best))

    def _trials_judged(self, outputs, diverged) -> tuple[np.ndarray, np.ndarray]:
        """Corrections (trial, window, state) of what was asked for, and objectives (trial, window): inf where lost."""
        corrections = np.stack([corrections for _, corrections in self._trials])
        return corrections, trial_objectives(self.data, corrections, outputs, diverged, self._k)

    def _move(self, there: Linearization) -> None:
        self._at, self.x, self.corrections = there, there.x, there.corrections
        self._moves += 1
        if self._moves <= self._settled:
            self._k = there.inflation
        self.error = float(np.sqrt(np.square(there.residual).sum() / self.data.count))
        if not there.updates:
            self._since = float(there.objectives(self._k).sum())
            self._promises.append(self._error_after(self._at.whole_gain(self._k)))

    def _error_after(self, gain: float) -> float:
        """The error where the objective is lower by `gain`."""
        return float(np.sqrt(max(self.error**2 - gain / self.data.count, 0.0)))

    def _propose(self) -> None:
        k = self._k
        dx = self._step(self._radius, self._damping)
        corrections = self._at.corrections_after(dx, k, self._damping)
        self._predicted_gain = self._at.predicted_gain(dx, corrections, k)
        if self._predicted_gain < self._little and self._damping.any():  # they may be what holds it back
            self._damping[:] = 0.0
            self._propose()
            return
        if self._predicted_gain < self._little:
            self._settle()
            return
        self._trials, self._told = [(np.clip(self.x + dx, 0, 1), corrections)], self._tell_step

    def _restart(self, corrections: np.ndarray) -> None:
        """Go on from `corrections` (window, state) as if begun there: steps that failed elsewhere do not count."""
        self._settled = self._moves + SETTINGS.settled
        self._vain = self._failed = 0
        self._radius = SETTINGS.radius
        self._damping[:] = 0.0
        self.corrections = corrections
        self._measure()

    def _step(self, radius: float, damping: np.ndarray) -> np.ndarray:
        """The Gauss-Newton step (parameter,) within the trust region and the unit cube."""
        low, high = np.maximum(-radius, -self.x), np.minimum(radius, 1 - self.x)
        return self._at.bounded_step(self._k, low, high, damping)
