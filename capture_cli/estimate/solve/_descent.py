"""A Gauss-Newton descent in the unit cube with a trust region, the starts of all windows eliminated as nuisances.

Nocedal & Wright, Numerical Optimization, 2nd ed., sections 10.3 and 4.1.
"""

from __future__ import annotations

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
    # step lengths tried at once after a step that failed
    shrink: tuple[float, ...] = (1.0, 0.25, 0.0625, 0.015625)
    # Of the objective over k: less that is promised and not kept is lost in roughness; where contacts make
    # the error rough, more, or a descent goes on for a hundred rounds by a tenth of a standard error at a
    # time.
    lost: float = 0.1
    lost_if_rough: float = 0.5
    most_vain: int = 2  # rounds of shorter steps, one after the other, that bring less than that
    # Rounds from where it begins after which k is held. It depends on the residual and the residual on it:
    # where the model is wrong the two can chase each other for ever.
    settled: int = 15
    # of the unit cube: a trust region this small has lost touch with the error's shape
    collapsed: float = 1e-3
    # Beyond FAR noise floors there is no exact fit to be had: a tolerance of 1 is this share of the
    # objective, at least
    far: float = 2.0
    share: float = 0.03
    restarts: int = 2  # times that a descent begins anew where it is
    searches: int = 3  # times that it looks for windows that got stuck
    # share of the error at the last restart above which another would end in the same place
    stuck: float = 0.999
    updates: int = 3  # steps in a row with sensitivities that were updated rather than measured
    pace: int = 8  # rounds: how fast a descent goes is how far it came in these
    # A window goes back alone from a step that helps the others where its objective grows by SPOILT, over k,
    # and takes all that they gain; where they gain more, only if it grows to RUNAWAY times what it was and
    # SPOILT.
    spoilt: float = 9.0
    runaway: float = 2.0
    let_go: float = 10.0  # a window's damping is so many times less after each step


class Descent:
    """One Gauss-Newton descent in the unit cube, from x (parameter,); known: as of `Identifier`.

    Given the parameters the objective is a sum over windows, so the starts of each have a damping of their own: a
    window whose start ran away (a contact lost, a joint that sticks) goes back alone, the others keep their step.
    """

    def __init__(
        self,
        data: Data,
        x: np.ndarray,
        offsets: np.ndarray,
        tolerance: float,
        known: Known | None = None,
        *,
        measured: bool = True,
    ):
        self.data = data
        self.tolerance = tolerance
        self.x = np.clip(x, 0.0, 1.0)
        self.offsets = offsets
        self.error = np.inf
        self.converged = False
        self.stopped_early = False  # by whoever asks, who knows of a better one
        self.rounds = 0
        self._known = known
        self._measured = measured
        self._at: Linearization | None = None
        self._k = np.inf
        self._settled = SETTINGS.settled
        self._radius = SETTINGS.radius
        self._damping = np.zeros(len(data.start_sd))
        self._windows: np.ndarray | None = None  # that a trial concerns, where not all
        self._repairing = False
        self._promised = np.inf
        self._carry = False
        self._restarts, self._searches = SETTINGS.restarts, SETTINGS.searches
        self._vain = 0
        self._restarted_with = np.inf
        self._errors: list[float] = []  # after each round
        self._promises: list[float] = []  # the least error by each linearization that was measured
        self._since = np.inf  # the objective at the last of them
        self._try(self.x, self.offsets)

    @property
    def best(self) -> Best:
        return Best(self.data.space.from_unit(self.x), self.offsets, self.error)

    @property
    def at(self) -> Linearization | None:
        """The linearization where it is; None where it is about to be measured."""
        return self._at

    @property
    def _updates(self) -> int:
        return self._at.updates if self._at else 0

    @property
    def expected(self) -> float:
        """The error that its next step promises by sensitivities that were measured; 0 where they were not."""
        if self._updates or not np.isfinite(self._promised):
            return 0.0
        return self._error_after(self._promised)

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
        if self._told == self._tell_candidate and not self._carry:
            return columns(self.data, *self._trials[0], known=self._known)
        x, offsets = (np.stack(part) for part in zip(*self._trials, strict=True))
        return Trial(self.data.space.from_unit(x), offsets, self._windows)

    def tell(self, outputs, diverged):
        self.rounds += 1
        self._told(outputs, diverged)
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

    def _try(self, x: np.ndarray, offsets: np.ndarray) -> None:
        """Ask next for the point x (parameter,) with starts at `offsets`."""
        self._trials, self._told = [(x, offsets)], self._tell_candidate

    def _tell_candidate(self, outputs, diverged) -> None:
        x, offsets = self._trials[0]
        if self._carry:
            there = self._at.moved(x, offsets, self.data.residual(outputs[0]))
        else:
            there = Linearization.from_columns(self.data, x, offsets, outputs, diverged)
            if self._known is not None:
                there, self._known = self._known.completed(there), None
        if self._at is None:
            if diverged[0].any() or not np.isfinite(there.residual).all():
                self.converged = True
            else:
                self._move(there)
                self._propose()
            return
        before = self._at.objectives(self._k)
        after = np.where(diverged[0], np.inf, there.objectives(self._k))
        if after.sum() < before.sum():
            self._accept(there, before, after)
        else:
            self._reject(x, offsets, before, after)

    def _accept(self, there: Linearization, before: np.ndarray, after: np.ndarray) -> None:
        k, back = self._k, self.offsets
        gained = float((before - after).sum())
        ran_away = after > SETTINGS.runaway * before + SETTINGS.spoilt * k
        self._move(there)
        self._repairing = bool(ran_away.any())
        if self._repairing:
            self._carry = False
            self._send_back(ran_away, self.x, self.offsets, back)
            return
        self._damping = np.where(self._damping > 1e-3 * k, self._damping / SETTINGS.let_go, 0.0)
        self._radius = min(2 * self._radius, 1.0)
        if gained < self._little:
            self._settle()
        elif self._updates > SETTINGS.updates:
            self._refresh()
        else:
            self._propose()

    def _reject(self, x: np.ndarray, offsets: np.ndarray, before: np.ndarray, after: np.ndarray) -> None:
        spoilt = (after > before + SETTINGS.spoilt * self._k) & (offsets != self.offsets).any(axis=1)
        if (before - after)[~spoilt].sum() > self._lost:
            self._send_back(spoilt, x, offsets, self.offsets)
        elif self._updates:
            self._refresh()
        elif self._repairing:
            self._propose()
        elif self._promised < self._lost:
            self._give_up()
        else:
            self._propose_shorter()

    def _send_back(self, windows: np.ndarray, x: np.ndarray, offsets: np.ndarray, back: np.ndarray) -> None:
        """Ask next for x (parameter,) with starts at `offsets`, those of the `windows` (window,) back and damped.

        By what their objectives bend on average: of less, directions that show little take no notice. And `let_go`
        times as much, which the step that they do not take lets go of.
        """
        bends = np.trace(self._at.products[2], axis1=1, axis2=2) / max(len(self.data.movable), 1)
        damping = SETTINGS.let_go * np.maximum(SETTINGS.let_go * self._damping, bends + self._k)
        self._damping = np.where(windows, damping, self._damping)
        self._try(x, np.where(windows[:, None], back, offsets))

    def _settle(self) -> None:
        """Nothing more to gain: done, if the sensitivities that say so were measured here, or need not be and nothing
        was gained since they were.
        """
        gained = self._since - float(self._at.objectives(self._k).sum())
        if self._updates and (self._measured or gained > self._little):
            self._refresh()
        elif self._searches:
            self._propose_other_starts()
        else:
            self.converged = True

    def _give_up(self) -> None:
        """No way on from here; there may be one from where hidden states are others."""
        if self._may_search:
            self._propose_other_starts()
        else:
            self.converged = True

    @property
    def _may_search(self) -> bool:
        return self._searches > 0 and len(self.data.hidden_tried) > 0

    def _refresh(self) -> None:
        """Measure the sensitivities at the point reached."""
        self._at, self._carry = None, False
        self._try(self.x, self.offsets)

    def _propose_other_starts(self) -> None:
        """Where each window might have got stuck: its start as it was measured, and hidden states elsewhere, which are
        many and looked for where windows stand out alone.
        """
        self._searches -= 1
        stuck = self.data.standing_out(self._at.residual)
        hidden = self.data.other_starts(self.offsets, stuck) if stuck.size else ()
        others = [np.zeros_like(self.offsets), *hidden]
        self._trials, self._told = [(self.x, o) for o in others], self._tell_other_starts
        self._windows = stuck if len(hidden) else None

    def _tell_other_starts(self, outputs, diverged) -> None:
        """Go on where some windows have a better start after all."""
        self._windows = None
        offsets, values = self._trials_judged(outputs, diverged)
        best, found = best_trials(offsets, values)
        before = self._at.objectives(self._k)
        keeps = before <= found
        if (before - found)[~keeps].sum() < self._little:
            self.converged = True
        else:
            self._restart(self.x, np.where(keeps[:, None], self.offsets, best))

    def _trials_judged(self, outputs, diverged) -> tuple[np.ndarray, np.ndarray]:
        """Offsets (trial, window, state) of what was asked for, and objectives (trial, window): inf where lost."""
        offsets = np.stack([offsets for _, offsets in self._trials])
        return offsets, trial_objectives(self.data, offsets, outputs, diverged, self._k)

    def _move(self, there: Linearization) -> None:
        self._at, self.x, self.offsets = there, there.x, there.offsets
        if self.rounds <= self._settled:
            self._k = there.inflation
        self.error = float(np.sqrt(np.square(there.residual).sum() / self.data.count))
        if not there.updates:
            self._since = float(there.objectives(self._k).sum())
            self._promises.append(self._least_error())

    def _least_error(self) -> float:
        """Of the linearization, within the unit cube."""
        dx, k = self._at.whole_step, self._k
        return self._error_after(self._at.predicted_gain(dx, self._at.start_offsets(dx, k), k))

    def _error_after(self, gain: float) -> float:
        """The error where the objective is lower by `gain`."""
        return float(np.sqrt(max(self.error**2 - gain / self.data.count, 0.0)))

    def _propose(self) -> None:
        k = self._k
        self._repairing = False
        dx = self._step(self._radius, self._damping)
        offsets = self._at.start_offsets(dx, k, self._damping)
        self._promised = self._at.predicted_gain(dx, offsets, k)
        if self._promised < self._little:
            self._settle()
            return
        self._carry = self.x.size > 0
        self._try(np.clip(self.x + dx, 0, 1), offsets)

    def _propose_shorter(self) -> None:
        """Shorter steps in parameters and starts, in parameters alone and in starts alone, tried at once."""
        k = self._k
        self._carry = False
        still = np.zeros_like(self.x)
        together, held, alone = [], [], []
        for factor in SETTINGS.shrink:
            damping = self._shorter_damping(factor, k)
            dx = self._step(self._radius * factor / 4, damping)
            x = np.clip(self.x + dx, 0, 1)
            together.append((x, self._at.start_offsets(dx, k, damping)))
            held.append((x, self.offsets))
            alone.append((self.x, self._at.start_offsets(still, k, damping - k)))
        self._trials, self._told = [*together, *held, *alone], self._tell_shorter

    def _tell_shorter(self, outputs, diverged) -> None:
        """Given the parameters, each window takes the start that is best for it; those that keep theirs are damped."""
        k = self._k
        before = self._at.objectives(k)
        offsets, values = self._trials_judged(outputs, diverged)
        together, held, alone = values.reshape(3, len(SETTINGS.shrink), -1)
        chosen = int(np.argmin(np.minimum(together, held).sum(axis=1)))
        moved = np.minimum(together[chosen], held[chosen]).sum()
        moves, found = best_trials(offsets[2 * len(SETTINGS.shrink) :], alone)
        stayed = np.minimum(found, before).sum()
        factor = SETTINGS.shrink[chosen] if moved < before.sum() else SETTINGS.shrink[-1]
        self._radius *= factor / 4
        if moved < min(stayed, before.sum()):
            keeps = held[chosen] < together[chosen]
            better = self._trials[chosen][0], np.where(keeps[:, None], self.offsets, offsets[chosen])
        else:
            keeps = before <= found
            better = self.x, np.where(keeps[:, None], self.offsets, moves)
        self._damping[keeps] = self._shorter_damping(factor, k)[keeps]
        gained = before.sum() - min(moved, stayed)
        self._vain = self._vain + 1 if gained < self._lost else 0
        collapsed = self._radius < SETTINGS.collapsed
        if self._vain == SETTINGS.most_vain or (collapsed and self._may_search):
            self._give_up()
        elif collapsed and self._restarts and self.error < SETTINGS.stuck * self._restarted_with:
            self._restarts -= 1
            self._restart(*better)
        elif gained > self._little:
            self._try(*better)
        else:
            self._propose_shorter()

    def _restart(self, x: np.ndarray, offsets: np.ndarray) -> None:
        """Go on from x (parameter,) and `offsets` as if begun there: steps that failed elsewhere do not count."""
        self._restarted_with = self.error
        self._settled = self.rounds + SETTINGS.settled
        self._vain = 0
        self._radius = SETTINGS.radius
        self._damping[:] = 0.0
        self.x, self.offsets = x, offsets
        self._refresh()

    def _shorter_damping(self, factor: float, k: float) -> np.ndarray:
        return self._damping + k * (4 / factor - 1) / 3

    def _step(self, radius: float, damping: np.ndarray) -> np.ndarray:
        """The Gauss-Newton step (parameter,) within the trust region and the unit cube."""
        low, high = np.maximum(-radius, -self.x), np.minimum(radius, 1 - self.x)
        return self._at.bounded_step(self._k, low, high, damping)
