"""What five labels can tell of scooping's balance point, whoever reads them: success of the best question and answer.

The task without its physics: the balance point is uniform over the range, and the label of a scoop point is 0 where it
lies within TOLERANCE of it, otherwise the side on which it is. The first of five questions is random, as the source of
a pair is; the second and third are asked at the median of what is left, the last two where the expected success is
highest, which is computed exactly. An answer is right within TOLERANCE. What is known of the noise differs. Nobody who
knows no more does better on average over what is left open; on one of its cases one may, at the cost of others.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from benchmarks.base import Benchmark, Figure, Result

CELLS, REACH = 101, 2  # of the range; of cells on either side of an answer that are as right
TOLERANCE = (2 * REACH + 1) / CELLS / 2  # of the range: 0.0495 half-lengths
ROUNDS, FIRST_QUESTIONS, ASKED = 5, 8, 21  # ASKED: places at which the last question but one is tried
LABELS = 3

# hypotheses, equally likely beforehand: how likely a label of each round is random
KNOWN = {
    "no label is random": [[0, 0, 0, 0, 0]],
    "every third is random, which is known": [[0, 0, 1, 0, 0]],
    "one of five is random, not which": np.eye(ROUNDS).tolist(),
    "every third is random, from which on is not known": [[1, 0, 0, 1, 0], [0, 1, 0, 0, 1], [0, 0, 1, 0, 0]],
    "each is random with probability 1/3": [[1 / 3] * ROUNDS],
}


class LabelInformation(Benchmark):
    summary = "what five labels can tell of scooping's balance point, some of them random"

    def run(self) -> Result:
        reached = {what: success(np.array(noise)) for what, noise in KNOWN.items()}
        return Result([Figure(f"success at best: {what}", s) for what, s in reached.items()])


def success(noise: np.ndarray) -> float:
    """Expected success after ROUNDS questions, where labels are random with the probabilities (hypothesis, round)."""
    first = np.linspace(REACH, CELLS - 1 - REACH, FIRST_QUESTIONS).astype(int)
    total = 0.0
    for question in first:
        joint = np.full((len(noise), CELLS), 1 / (len(noise) * CELLS))
        for label in range(LABELS):
            total += _asked_at_medians(joint * _likelihood(noise, 0)[:, label, question], noise, 1)
    return total / len(first)


def _asked_at_medians(joint: np.ndarray, noise: np.ndarray, asked: int) -> float:
    """Expected success from joint (hypothesis, cell), unnormalised: questions at the median, the last two best."""
    if joint.sum() <= 0:
        return 0.0
    if asked == ROUNDS - 2:
        return _best_of_two(joint, noise)
    cumulative = np.cumsum(joint.sum(axis=0))
    median = int(np.argmax(cumulative >= cumulative[-1] / 2))
    likelihood = _likelihood(noise, asked)[:, :, median]
    return sum(_asked_at_medians(joint * likelihood[:, k], noise, asked + 1) for k in range(LABELS))


def _best_of_two(joint: np.ndarray, noise: np.ndarray) -> float:
    possible = np.flatnonzero(joint.sum(axis=0))
    ends = max(possible[0] - REACH, 0), min(possible[-1] + REACH, CELLS - 1)
    questions = np.unique(np.linspace(*ends, ASKED).astype(int))
    likelihood = _likelihood(noise, ROUNDS - 2)
    value = np.zeros(len(questions))
    for (i, question), label in product(enumerate(questions), range(LABELS)):
        value[i] += _best_of_one(joint * likelihood[:, label, question], noise)
    return float(value.max())


def _best_of_one(joint: np.ndarray, noise: np.ndarray) -> float:
    after = np.einsum("hlqc,hc->lqc", _likelihood(noise, ROUNDS - 1), joint)
    return float(_held(after).sum(axis=0).max())


def _held(mass: np.ndarray) -> np.ndarray:
    """The most of `mass` (..., cell) that is right for one answer."""
    cumulative = np.pad(np.cumsum(mass, axis=-1), [(0, 0)] * (mass.ndim - 1) + [(1, 0)])
    cell = np.arange(CELLS)
    last, first = np.minimum(cell + REACH + 1, CELLS), np.maximum(cell - REACH, 0)
    return (cumulative[..., last] - cumulative[..., first]).max(axis=-1)


def _likelihood(noise: np.ndarray, asked: int) -> np.ndarray:
    """Of a label, (hypothesis, label, question, cell)."""
    random = noise[:, asked, None, None, None]
    return (1 - random) * _RIGHT + random / LABELS


def _right() -> np.ndarray:
    """Whether a label is the right one, (label, question, cell)."""
    cell = np.arange(CELLS)
    off = cell - cell[:, None]
    return np.stack([off < -REACH, np.abs(off) <= REACH, off > REACH]).astype(float)


_RIGHT = _right()
