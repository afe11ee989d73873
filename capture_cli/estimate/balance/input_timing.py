"""What an input does between the rows of a log: is it held, does it change evenly from one row to the next, or were
there more commands than rows, of which the log has every n-th?

A logger that writes every second command leaves rows between which the machine was told more. Held commands act later
than even changes do: of n from row to row by (T / n - h) / 2, with rows T and steps of the model h apart. That looks
like a delay, a lag or a mass that is not there. The force balance tells: what the declared model predicts of blocks
that it was not fitted to, with the input read one way and the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture_cli.estimate.balance.force_balance import ForceBalance
from capture_cli.estimate.balance.regression import Sums, predicted, with_prior
from capture_cli.estimate.balance.whitening import Whitening


@dataclass(frozen=True)
class InputTimingSettings:
    """blocks: that are left out in turn. sure: standard errors over blocks by which one reading has to be better, and
    least: of predictive log likelihood; otherwise inputs stay as they were read. else_missing: of the variance of the
    sensors' noise in rows, how much more the model may be wrong by: beyond it something else is missing, which may look
    like another timing. hopeless: by how much more with one effect in it two are not asked. most: commands from row to
    row that are told from an even change.
    """

    blocks: int = 12
    sure: float = 3.0
    least: float = 5.0
    else_missing: float = 3.0
    hopeless: float = 100.0
    most: int = 5


SETTINGS = InputTimingSettings()


@dataclass(frozen=True)
class InputTiming:
    """Of one input: how many commands it has from row to row, as of `Channel`, and the gain of that over being held in
    predictive log likelihood, or where it is held over changing evenly; with its standard error over blocks.
    """

    name: str
    commands: float
    gain: float
    error: float


def input_timings(
    balance: ForceBalance,
    whitening: Whitening,
    rows: Sequence[np.ndarray],
    names: Sequence[str],
    commands: np.ndarray,
    settings: InputTimingSettings = SETTINGS,
) -> tuple[list[InputTiming], bool]:
    """How each input acts, and whether that is all: what is missing may look like another timing, and one that is not
    surely better may still be right.

    balance, whitening: at values of the declared parameters; rows: of these; names, commands (input,): of the inputs,
    and how they are read in it.

    All inputs are first read the other way together, then each by itself beside the better of these; last those that
    change evenly are asked for commands between rows, together.
    """
    columns = [c * balance.smoothed.task.space.span for c in rows]
    blocks = whitening.blocks(settings.blocks)

    def likelihood(read: np.ndarray) -> np.ndarray:
        """(block,)"""
        target = whitening.rows([balance.read_as(read).null])
        _adapt(whitening, target, columns)
        white = np.concatenate(whitening.whitened(target))[:, 0]
        sums = Sums.of(-white, np.concatenate(whitening.whitened(columns)), whitening.block_of_row(blocks))
        return np.bincount(blocks, weights=whitening.log_determinants()) - 0.5 * predicted(sums)

    read, known = commands, likelihood(commands)
    if len(commands) > 1 and is_surely_better(known, other := likelihood(_turned(commands)), settings):
        read, known = _turned(commands), other
    gains = []
    for k in range(len(names)):
        turned = np.where(np.arange(len(names)) == k, _turned(read), read)
        other = likelihood(turned)
        if is_surely_better(known, other, settings):
            read, known, other = turned, other, known
        gains.append(sum_and_error(known - other))
    numbers = commands_told_apart(balance, settings) if (read > 1).any() else ()
    others = [(likelihood(own), own) for own in (np.where(read > 1, float(n), read) for n in numbers)]
    known, read = max([(known, read), *others], key=lambda own: own[0].sum())
    contradicted = any(gain < -settings.least for gain, _ in gains)
    likelihood(read)
    found = [InputTiming(name, float(n), *own) for name, n, own in zip(names, read, gains, strict=True)]
    return found, whitening.beyond_noise < settings.else_missing and not contradicted


def commands_told_apart(balance: ForceBalance, settings: InputTimingSettings = SETTINGS) -> range:
    """The numbers of commands from row to row, beyond one, that differ from an even change by a step of the model."""
    smoothed = balance.smoothed
    rows = float(np.median(np.concatenate([np.diff(smoothed.log.time[p]) for p in smoothed.parts])))
    finest = int(np.ceil(rows / smoothed.task.timestep - 1e-6))
    return range(2, min(settings.most + 1, finest))


def _turned(commands: np.ndarray) -> np.ndarray:
    """Held where they change evenly, and the other way round."""
    return np.where(commands == 1, np.inf, 1.0)


def is_surely_better(known: np.ndarray, other: np.ndarray, settings: InputTimingSettings = SETTINGS) -> bool:
    """Whether the likelihoods (block,) of another reading are surely higher."""
    gain, error = sum_and_error(other - known)
    return gain > max(settings.least, settings.sure * error)


def sum_and_error(gains: np.ndarray) -> tuple[float, float]:
    """Of gains (block,): their sum, and its standard error over blocks."""
    return float(gains.sum()), float(gains.std(ddof=1) * np.sqrt(len(gains)))


def _adapt(whitening: Whitening, target: Sequence[np.ndarray], columns: Sequence[np.ndarray]) -> None:
    """Let the model's own error be as large as makes what it leaves most likely."""
    slope = np.concatenate(whitening.whitened(columns))
    left = np.concatenate(whitening.whitened(target))[:, 0]
    step = np.linalg.solve(with_prior(slope.T @ slope), -slope.T @ left)
    left = [t[..., 0] + c @ step for t, c in zip(target, columns, strict=True)]
    whitening.adapt(left, whitening.slow_noise_of(left))
