"""Least squares on white rows, block by block: how much better are blocks predicted that were not fitted?

All is done with sums of products over blocks, so that thousands of additions to a model are compared at once.
Columns are in units of what is known of their coefficients beforehand (a standard deviation of 1, about 0), and rows in
units of the noise: the estimate is the maximum a posteriori of both. Without that prior, columns that are all but
collinear with others would be blown up until their rounding errors fit the noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from capture_cli.common.frozen import frozen


@frozen
class SETTINGS:
    tiny: float = 1e-300  # a sum of squares that is nothing
    rounding: float = 1e-12  # of a column's square: some times what double precision loses of it


@dataclass(frozen=True)
class Gain:
    """Of models over the one they are compared with, (model,): difference of the predictive log likelihood over blocks,
    the sum and its standard error over blocks; coefficients (model, column) of all columns, the added last.
    """

    mean: np.ndarray
    error: np.ndarray
    coefficients: np.ndarray


@dataclass(frozen=True)
class Sums:
    """Of blocks: target' target (block,), columns' columns (block, column, column), columns' target (block, column),
    and how many rows, (block,).
    """

    target: np.ndarray
    gram: np.ndarray
    pull: np.ndarray
    count: np.ndarray

    @classmethod
    def of(cls, target: np.ndarray, columns: np.ndarray, block: np.ndarray) -> Sums:
        """target (row,), columns (row, column), block (row,): 0 to the number of blocks less 1."""
        parts = [np.flatnonzero(block == b) for b in range(int(block.max()) + 1)]
        return cls(
            np.array([target[p] @ target[p] for p in parts]),
            np.array([columns[p].T @ columns[p] for p in parts]),
            np.array([columns[p].T @ target[p] for p in parts]),
            np.array([len(p) for p in parts]),
        )


def additions(
    base: Sums, across: np.ndarray, gram: np.ndarray, pull: np.ndarray, expected: np.ndarray
) -> Gain:
    """Gains of models with columns added to those of `base`.

    across (block, column, model, added): products of the base's columns with each model's added ones; gram (block,
    model, added, added) and pull (block, model, added): products of these with each other and with the target.
    expected (model, added): of the added coefficients, what they are about beforehand.
    """
    alone = predicted(base)
    errors = np.empty((len(base.count), pull.shape[1]))
    size = base.pull.shape[1]
    for b in range(len(base.count)):
        found = _coefficients(base, across, gram, pull, expected, leave=b)
        first, added = found[:, :size], found[:, size:]
        errors[b] = (
            base.target[b]
            - 2 * (first @ base.pull[b] + np.einsum("ma,ma->m", added, pull[b]))
            + np.einsum("mi,ij,mj->m", first, base.gram[b], first)
            + 2 * np.einsum("mi,ima,ma->m", first, across[b], added)
            + np.einsum("ma,mac,mc->m", added, gram[b], added)
        )
    gains = 0.5 * base.count[:, None] * np.log(alone[:, None] / np.maximum(errors, SETTINGS.tiny))
    error = gains.std(axis=0, ddof=1) * np.sqrt(len(base.count))
    return Gain(gains.sum(axis=0), error, _coefficients(base, across, gram, pull, expected, leave=None))


def sum_and_error(gains: np.ndarray) -> tuple[float, float]:
    """Of gains (block,): their sum, and its standard error over blocks."""
    return float(gains.sum()), float(gains.std(ddof=1) * np.sqrt(len(gains)))


def best_pairs(
    responses: np.ndarray, target: np.ndarray, sizes: np.ndarray, alike: float, count: int
) -> list[tuple[int, int]]:
    """Of all pairs of responses (effect, row) the `count` that take most of the target (row,) together, by BIC, best
    first; sizes (effect,): how many parameters each stands for. Of pairs whose responses are alike, beyond that cosine,
    the best.
    """
    gram, pull = responses @ responses.T, responses @ target
    own = 1 + np.diag(gram)
    determinant = np.outer(own, own) - np.square(gram)
    taken = (
        np.square(pull)[:, None] * own + np.square(pull) * own[:, None] - 2 * np.outer(pull, pull) * gram
    ) / determinant
    left = np.maximum(target @ target - taken, SETTINGS.tiny)
    score = -len(target) * np.log(left) - np.log(len(target)) * np.add.outer(sizes, sizes)
    first, second = np.triu_indices(len(pull), 1)
    same = np.abs(gram) > alike * np.sqrt(np.outer(np.diag(gram), np.diag(gram)))
    found: list[tuple[int, int]] = []
    for k in np.argsort(-score[first, second], kind="stable"):
        i, j = int(first[k]), int(second[k])
        if same[i, j] or any((same[i, a] and same[j, b]) or (same[i, b] and same[j, a]) for a, b in found):
            continue
        found.append((i, j))
        if len(found) == count:
            break
    return found


def predicted(base: Sums) -> np.ndarray:
    """Squared error of each block by the model that is fitted to the others, (block,)."""
    errors = np.empty(len(base.count))
    for b in range(len(base.count)):
        keep = np.arange(len(base.count)) != b
        gram = with_prior(base.gram[keep].sum(axis=0))
        own = np.linalg.solve(gram, base.pull[keep].sum(axis=0))
        errors[b] = base.target[b] - 2 * own @ base.pull[b] + own @ base.gram[b] @ own
    return np.maximum(errors, SETTINGS.tiny)


def with_prior(gram: np.ndarray) -> np.ndarray:
    """Products of columns (..., column, column) with the prior of their coefficients, 1 about 0; of columns that are so
    long that 1 is lost in rounding, with as much as is not.
    """
    own = np.arange(gram.shape[-1])
    found = np.array(gram, dtype=float)
    found[..., own, own] += 1 + SETTINGS.rounding * found[..., own, own]
    return found


def solved(columns: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Coefficients (column,) of least squares with a prior of 1 about 0."""
    return np.linalg.solve(with_prior(columns.T @ columns), columns.T @ target)


def without(apart: np.ndarray, *rows: np.ndarray) -> list[np.ndarray]:
    """Each of `rows` (row, ...) less what the columns `apart` (row, column) fit of it."""
    return [r - apart @ solved(apart, r) for r in rows]


def step_within(
    slope: np.ndarray, target: np.ndarray, here: np.ndarray, low: np.ndarray, high: np.ndarray, far: float
) -> np.ndarray:
    """The step (column,), in ranges, that takes most from `target` (row,), within the bounds and a distance."""
    if not len(here):
        return np.zeros(0)
    span = high - low
    bottom, top = np.maximum((low - here) / span, -far), np.minimum((high - here) / span, far)
    whole = np.vstack([slope, np.eye(len(here))]), np.append(-target, np.zeros(len(here)))
    return lsq_linear(*whole, bounds=(bottom - 1e-12, top + 1e-12)).x


def _coefficients(
    base: Sums,
    across: np.ndarray,
    gram: np.ndarray,
    pull: np.ndarray,
    expected: np.ndarray,
    leave: int | None,
) -> np.ndarray:
    """Coefficients (model, column) fitted to all blocks but `leave`, those of added columns last."""
    keep = np.arange(len(base.count)) != leave if leave is not None else slice(None)
    own_gram, own_pull = base.gram[keep].sum(axis=0), base.pull[keep].sum(axis=0)
    across, gram, pull = across[keep].sum(axis=0), gram[keep].sum(axis=0), pull[keep].sum(axis=0)
    size, (models, added) = len(own_pull), pull.shape
    inverse = np.linalg.inv(with_prior(own_gram))
    through = (inverse @ across.reshape(size, models * added)).reshape(size, models, added)
    left = with_prior(gram) - np.einsum("ima,imc->mac", across, through)
    pulled = pull + expected - np.einsum("ima,i->ma", through, own_pull)
    coefficients = np.linalg.solve(left, pulled[..., None])[..., 0]
    first = (inverse @ own_pull)[None] - np.einsum("ima,ma->mi", through, coefficients)
    return np.concatenate([first, coefficients], axis=1)
