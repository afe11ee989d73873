"""What an input does between the rows of a log: is it held, does it change evenly from one row to the next, were there
more commands than rows, or did it act before its row?

A logger that writes every second command leaves rows between which the machine was told more. Held commands act later
than even changes do: of n from row to row by (T / n - h) / 2, with rows T and steps of the model h apart. One that
writes a command beside what it led to leaves commands that acted a row earlier. Both look like a delay, a lag or a mass
that is not there. The force balance tells: what the declared model predicts of blocks that it was not fitted to, with
the input read one way and the other.

A step of MuJoCo kicks velocities at its beginning with what a machine feels all through it: held inputs of a machine
act half a step later than those of a log that was simulated in such steps. That is told as well.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from scipy.optimize import minimize_scalar

from capture_cli.common.frozen import frozen
from capture_cli.estimate.balance.balanced_fits import by_parameter, declared
from capture_cli.estimate.balance.force_balance import ForceBalance
from capture_cli.estimate.balance.regression import Sums, predicted, sum_and_error, with_prior
from capture_cli.estimate.balance.whitening import Whitening
from capture_cli.log.input_sequences import EVENLY, HELD, Hold
from capture_cli.model.tasks.base import Task


@frozen
class SETTINGS:
    """blocks: that are left out in turn. sure: standard errors over blocks by which one reading has to be better, and
    least: of predictive log likelihood; otherwise inputs stay as they were read. else_missing: of the variance of the
    sensors' noise in rows, how much more the model may be wrong by: beyond it something else is missing, which may look
    like another timing. asked_again: beyond which the balance does not decide alone, and within which a fit with an
    effect leaves nothing to ask. hopeless: by how much more with one effect in it two are not asked, and
    hopeless_with_two: with two at most, no fit is. far_less: with two effects in, of what held inputs leave beyond it
    others may leave so much. most: commands from row to row that are told from an even change. early: rows, by which an
    input acts before its own where that is looked for, and earliest, up to which it is; finest: in which steps.
    """

    blocks: int = 12
    sure: float = 3.0
    least: float = 5.0
    else_missing: float = 3.0
    asked_again: float = 0.1
    hopeless: float = 100.0
    hopeless_with_two: float = 30.0
    far_less: float = 0.5
    most: int = 5
    early: float = 0.25
    earliest: float = 2.0
    finest: float = 0.02


@dataclass(frozen=True)
class InputTiming:
    """How one input acts, and the gain of that over being held in predictive log likelihood, or where it is held over
    changing evenly; with its standard error over blocks; None where the whole model told. beyond_noise: what the model
    leaves, as of `Whitening`.
    """

    name: str
    hold: Hold
    gain: float | None
    error: float | None
    beyond_noise: float


def input_timings(
    balance: ForceBalance,
    whitening: Whitening,
    rows: Sequence[np.ndarray],
    names: Sequence[str],
    holds: Sequence[Hold | None],
) -> tuple[list[InputTiming], bool]:
    """How each input acts of which nobody says it, and whether that is all: what is missing may look like another
    timing, and one that is not surely better may still be right.

    balance, whitening: of held inputs, at values of the declared parameters that fill it best; rows: of these; names,
    holds: of all inputs, and how they act where somebody says it.

    All are first read as held and as changing evenly together, then each by itself beside the better of these; last
    those that change evenly are asked for commands between rows, and for acting before their rows, together, and those
    that are held for acting half a step later.
    """
    asked = [k for k, hold in enumerate(holds) if hold is None]
    read = [HELD if hold is None else hold for hold in holds]

    def with_(hold: Hold, those: Sequence[int]) -> list[Hold]:
        return [hold if k in those else own for k, own in enumerate(read)]

    held = list(read)
    as_held = _Read(balance, whitening, rows)
    as_changing = _Read.of(*declared(balance.read_as(with_(EVENLY, asked)), whitening))

    def told(read: list[Hold]) -> _Told:
        is_near = [hold.commands for hold in read] == [hold.commands for hold in held]
        return (as_held if is_near else as_changing).told(read)

    def likelihood(read: list[Hold]) -> np.ndarray:
        return told(read).likelihood

    known, other = likelihood(read), likelihood(with_(EVENLY, asked))
    if is_surely_better(known, other):
        read, known = with_(EVENLY, asked), other
    gains = {}
    for k in asked:
        turned = with_(EVENLY if read[k] == HELD else HELD, [k])
        other = likelihood(turned)
        if is_surely_better(known, other):
            read, known, other = turned, other, known
        gains[k] = sum_and_error(known - other)
    evenly = [k for k in asked if read[k] == EVENLY]
    if evenly:
        found = likeliest(lambda hold: (known, likelihood(with_(hold, evenly))), balance)
        read = with_(found, evenly)
    still_held = [k for k in asked if read[k] == HELD]
    if still_held:
        later, a_step = (with_(held_late(balance.smoothed.task, steps), still_held) for steps in (0.5, 1.0))
        # what is a step late, or more, is a delay of the machine
        is_half = all(is_surely_better(likelihood(other), likelihood(later)) for other in (read, a_step))
        if is_half and told(later).beyond_noise < SETTINGS.asked_again:
            read = later
    contradicted = any(gain < -SETTINGS.least for gain, _ in gains.values())
    beyond = told(read).beyond_noise
    timings = [InputTiming(names[k], read[k], *gains[k], beyond) for k in asked]
    return timings, beyond < SETTINGS.else_missing and not contradicted


@dataclass(frozen=True)
class _Told:
    """Of inputs read one way: the log likelihood (block,), the model's own error being as large as makes what is left
    most likely; and `beyond_noise` of `Whitening`.
    """

    likelihood: np.ndarray
    beyond_noise: float


@dataclass(frozen=True)
class _Read:
    """A balance at values that fill it best with inputs read one way, and the rows of the declared parameters: misread
    inputs move these so far that changes no longer add up. known: what it told of inputs.
    """

    balance: ForceBalance
    whitening: Whitening
    rows: Sequence[np.ndarray]
    known: dict[tuple[Hold, ...], _Told] = field(default_factory=dict)

    @classmethod
    def of(cls, balance: ForceBalance, whitening: Whitening) -> Self:
        return cls(balance, whitening, whitening.rows(by_parameter(balance)))

    def told(self, read: Sequence[Hold]) -> _Told:
        """Of inputs that act so."""
        if tuple(read) not in self.known:
            self.known[tuple(read)] = self._told(read)
        return self.known[tuple(read)]

    def _told(self, read: Sequence[Hold]) -> _Told:
        whitening, blocks = self.whitening, self.whitening.blocks(SETTINGS.blocks)
        columns = [c * self.balance.smoothed.task.space.span for c in self.rows]
        target = whitening.rows([self.balance.read_as(read).null])
        whitening.reset()  # what was asked before is not to matter
        _adapt(whitening, target, columns)
        white = np.concatenate(whitening.whitened(target))[:, 0]
        sums = Sums.of(-white, np.concatenate(whitening.whitened(columns)), whitening.block_of_row(blocks))
        likelihood = np.bincount(blocks, weights=whitening.log_determinants()) - 0.5 * predicted(sums)
        return _Told(likelihood, whitening.beyond_noise)


Likelihoods = tuple[np.ndarray, np.ndarray]  # (block,) each


def likeliest(asked: Callable[[Hold], Likelihoods], balance: ForceBalance, known: Hold = EVENLY) -> Hold:
    """How inputs act that change between rows.

    asked: gives the likelihoods of the `known` hold, and of another. That an input acts before its row has to be surely
    better: it is the record's fault.
    """
    row = _row(balance)
    gains = {known: 0.0}
    for hold in changing_holds(balance):
        if hold != known:
            gains[hold] = -float(np.subtract(*asked(hold)).sum())
    if is_surely_better(*asked(Hold(np.inf, -SETTINGS.early * row))):
        early = minimize_scalar(
            lambda late: float(np.subtract(*asked(Hold(np.inf, late))).sum()),
            bounds=(-SETTINGS.earliest * row, 0.0),
            method="bounded",
            options={"xatol": SETTINGS.finest * row},
        )
        # held commands that act a row earlier are as late as that: within half a step the balance tells no difference
        step = balance.smoothed.task.timestep
        is_whole = abs(early.x + (row + step) / 2) < step / 2
        gains[Hold(1.0, -row) if is_whole else Hold(np.inf, float(early.x))] = -float(early.fun)
    return max(gains, key=gains.__getitem__)


def changing_holds(balance: ForceBalance) -> list[Hold]:
    """How inputs may act that change between rows: by two commands, three and so on, and evenly, which is next to most
    of them.
    """
    # more differ from an even change by less than a step of the model
    steps = int(np.ceil(_row(balance) / balance.smoothed.task.timestep - 1e-6))
    return [*(Hold(float(n)) for n in range(2, min(SETTINGS.most + 1, steps))), EVENLY]


def held_late(task: Task, steps: float) -> Hold:
    """Held inputs that act so many steps of the task's model after their rows."""
    return Hold(HELD.commands, steps * task.timestep)


def is_held(hold: Hold) -> bool:
    """Whether an input is held from row to row, from the row on or a little later."""
    return hold.commands == HELD.commands and hold.late >= 0


def is_alike(one: Hold, other: Hold, balance: ForceBalance) -> bool:
    """Whether two readings differ by less than is looked for."""
    return one.commands == other.commands and abs(one.late - other.late) <= SETTINGS.finest * _row(balance)


def _row(balance: ForceBalance) -> float:
    """s, from a row to the next."""
    smoothed = balance.smoothed
    return float(np.median(np.concatenate([np.diff(smoothed.log.time[p]) for p in smoothed.parts])))


def is_surely_better(known: np.ndarray, other: np.ndarray) -> bool:
    """Whether the likelihoods (block,) of another reading are surely higher."""
    gain, error = sum_and_error(other - known)
    return gain > max(SETTINGS.least, SETTINGS.sure * error)


def _adapt(whitening: Whitening, target: Sequence[np.ndarray], columns: Sequence[np.ndarray]) -> None:
    """Let the model's own error be as large as makes what it leaves most likely."""
    slope = np.concatenate(whitening.whitened(columns))
    left = np.concatenate(whitening.whitened(target))[:, 0]
    step = np.linalg.solve(with_prior(slope.T @ slope), -slope.T @ left)
    left = [t[..., 0] + c @ step for t, c in zip(target, columns, strict=True)]
    whitening.adapt(left, whitening.slow_noise_of(left))
