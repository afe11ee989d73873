"""What labels can tell of scooping's balance point, whoever reads them: success of the best questions and answer.

The task without its physics: the balance point is uniform over the range, and the label of a scoop point is 0 where it
lies within TOLERANCE of it, otherwise the side on which it is. The first question is random, as the source of a pair
is; the others are chosen for success after the last. An answer is right within TOLERANCE. What is known of the noise
differs. Nobody who knows no more does better on average over what is left open; on one of its cases one may, at the
cost of others.

Computed exactly: the posterior after every sequence of labels, and success after the last two questions, the first of
them at PLACES. Questions before these are at the median of what is left, and a sequence less likely than RARE is
answered without further ones: so each figure is a lower bound of the best. After five rounds to plan three adds 0.008
at most.

Beside the best stands what `capture-refined` makes of such labels, of a balance point and under actions that are
exactly those asked for: PAIRS pairs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.base import Benchmark, Figure, Result
from capture_cli.context.identifiers._label_refinement import LabelRefinement
from capture_cli.context.identifiers.base import Signature
from capture_cli.model.parameters import Parameter, ParameterSpace
from capture_cli.model.tasks.base import Feature

CELLS, REACH = 101, 2  # of the range; of cells on either side of an answer that are as right
TOLERANCE = (2 * REACH + 1) / CELLS / 2  # of the range: 0.0495 half-lengths
ROUNDS = (3, 5, 8, 10)
FIRST_QUESTIONS, PLACES = 8, 21  # midpoints of as many parts of the range; quantiles of the posterior
RARE = 1e-5
LABELS = 3
PAIRS = 4000


@dataclass(frozen=True)
class Noise:
    """What is known beforehand, as a Markov chain over states that nobody sees.

    initial: how likely each is. right, random: (round, to, from) how likely, with the next state, a label is the right
    one or one of the three drawn at random.
    """

    initial: np.ndarray
    right: np.ndarray
    random: np.ndarray

    @classmethod
    def of_rates(cls, rates: list[list[float]]) -> Noise:
        """Hypotheses, equally likely, each of how likely the label of every round is random."""
        by_round = np.array(rates, dtype=float).T
        diagonal = np.eye(len(rates))
        return cls(
            np.full(len(rates), 1 / len(rates)),
            (1 - by_round)[:, None] * diagonal,
            by_round[:, None] * diagonal,
        )

    @classmethod
    def of_count(cls, rounds: int, count: int) -> Noise:
        """`count` of the labels are random, any as likely as any other; the state is how many were."""
        before, still = np.arange(rounds)[:, None], count - np.arange(count + 1)
        rate = np.clip(still / (rounds - before), 0, 1)
        shifted = np.eye(count + 1, k=-1)
        return cls(np.eye(count + 1)[0], (1 - rate)[:, None] * np.eye(count + 1), rate[:, None] * shifted)


def _every_third(rounds: int, first: int) -> list[float]:
    return [float(number % 3 == first) for number in range(rounds)]


KNOWN: dict[str, Callable[[int], Noise]] = {
    "no label is random": lambda rounds: Noise.of_rates([[0.0] * rounds]),
    "every third is random, which is known": lambda rounds: Noise.of_rates([_every_third(rounds, 2)]),
    "as many are random, not which": lambda rounds: Noise.of_count(rounds, rounds // 3),
    "every third is random, from which on is not known": lambda rounds: Noise.of_rates(
        [_every_third(rounds, first) for first in range(3)]
    ),
    "each is random with probability 1/3": lambda rounds: Noise.of_rates([[1 / 3] * rounds]),
}


def _any(generator: np.random.Generator, rounds: int) -> np.ndarray:
    """Of as many as every third label, which are random (pair, round): any as likely as any other."""
    return generator.random((PAIRS, rounds)).argsort(axis=1) < rounds // 3


def _thirds(_generator: np.random.Generator, rounds: int) -> np.ndarray:
    """Every third label is random, (pair, round)."""
    return np.tile([_every_third(rounds, 2)], (PAIRS, 1)) == 1


# what is random, of which it knows nothing
READ = {
    "as many, read by capture-refined": _any,
    "every third, read by capture-refined": _thirds,
}


class LabelInformation(Benchmark):
    summary = "what labels can tell of scooping's balance point, some of them random"

    def run(self) -> Result:
        figures = []
        at_best = {what: [success(known(n), n) for n in ROUNDS] for what, known in KNOWN.items()}
        generator = np.random.default_rng(0)
        read = {what: [read_labels(random(generator, n)) for n in ROUNDS] for what, random in READ.items()}
        for what, (first, *others) in (at_best | read).items():
            figures.append(Figure(f"success at {ROUNDS[0]}: {what}", first))
            # a name that begins with a space belongs to the one before
            figures += [Figure(f" at {n}", s) for n, s in zip(ROUNDS[1:], others, strict=True)]
        return Result(figures)


def success(noise: Noise, rounds: int) -> float:
    """Expected success after `rounds` questions, two at least. Of first ones, alike in the mirror, half are asked."""
    first = np.rint((np.arange(FIRST_QUESTIONS // 2) + 0.5) / FIRST_QUESTIONS * (CELLS - 1)).astype(int)
    joint = np.repeat(noise.initial[:, None] / CELLS, CELLS, axis=1)
    told = _told(joint, noise, 0, first).reshape(-1, *joint.shape)
    return sum(_asked_on(after, noise, 1, rounds) for after in told) / len(first)


def read_labels(random: np.ndarray, seed: int = 0) -> float:
    """The share of pairs in which `capture-refined` is right after as many labels as `random` (pair, round) has."""
    pairs, rounds = random.shape
    generator = np.random.default_rng(seed)
    asked, truth = generator.random((2, pairs, 1))
    drawn = generator.integers(-1, 2, (rounds, pairs, 1, 1))
    space = ParameterSpace([Parameter("balance_point", "1", 0.0, 1.0, 0.5)])
    signature = Signature("labels", space, space, (Feature("label", "1", 1.0),), np.zeros(1))
    refinement = LabelRefinement(signature, pairs, _label, None)
    for n in range(rounds):
        right, _ = _label(truth, asked)
        label = np.where(random[:, n, None, None], drawn[n], right)
        estimate = refinement.refine(None, asked, asked, right, label).mean
        asked = refinement.question(estimate)
    return float((np.abs(estimate - truth) <= TOLERANCE).mean())


def _label(points: np.ndarray, scooped: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The label of each scoop point (pair, 1), (pair, 1, 1); none diverges."""
    off = points - scooped
    return np.where(np.abs(off) <= TOLERANCE, 0.0, np.sign(off))[:, None], np.zeros(len(off), dtype=bool)


def _asked_on(joint: np.ndarray, noise: Noise, asked: int, rounds: int) -> float:
    """Expected success from joint (state, cell), unnormalised, after `asked` questions."""
    if joint.sum() < RARE:
        return float(_held(joint.sum(axis=0)).max())
    if asked == rounds - 1:
        return float(_best_of_one(joint, noise, asked))
    if not noise.right[asked].any():  # nothing to learn, and nothing to branch for
        return _asked_on(noise.random[asked] @ joint, noise, asked + 1, rounds)
    if asked == rounds - 2:
        told = _told(joint, noise, asked, _quantiles(joint, np.linspace(0, 1, PLACES + 2)[1:-1]))
        return float(_best_of_one(told, noise, asked + 1).sum(axis=1).max())
    (told,) = _told(joint, noise, asked, _quantiles(joint, np.array([0.5])))
    return sum(_asked_on(after, noise, asked + 1, rounds) for after in told)


def _told(joint: np.ndarray, noise: Noise, asked: int, questions: np.ndarray) -> np.ndarray:
    """`joint` with each label of each question, (question, label, state, cell)."""
    right, random = noise.right[asked] @ joint, noise.random[asked] @ joint
    off = np.arange(CELLS) - questions[:, None]
    is_right = np.stack([off < -REACH, np.abs(off) <= REACH, off > REACH], axis=1)
    return is_right[:, :, None] * right + random / LABELS


def _quantiles(joint: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Cells, each once."""
    cumulative = np.cumsum(joint.sum(axis=0))
    return np.unique(np.searchsorted(cumulative, shares * cumulative[-1]).clip(0, CELLS - 1))


def _best_of_one(joint: np.ndarray, noise: Noise, asked: int) -> np.ndarray:
    """The most that answers to the three labels of one last question hold of joint (..., state, cell).

    A label that is right puts the answer where it says, whole; one that is random leaves it anywhere.
    """
    right = np.einsum("s,...sc->...c", noise.right[asked].sum(axis=0), joint)
    random = _held(np.einsum("s,...sc->...c", noise.random[asked].sum(axis=0), joint) / LABELS)
    held = np.maximum(_held(right) + random, random.max(axis=-1, keepdims=True))
    below = np.maximum.accumulate(held, axis=-1)
    above = np.maximum.accumulate(held[..., ::-1], axis=-1)[..., ::-1]
    apart = 2 * REACH + 1
    return (below[..., : -2 * apart] + held[..., apart:-apart] + above[..., 2 * apart :]).max(axis=-1)


def _held(mass: np.ndarray) -> np.ndarray:
    """What of `mass` (..., cell) is right for the answer at each cell."""
    cumulative = np.pad(np.cumsum(mass, axis=-1), [(0, 0)] * (mass.ndim - 1) + [(1, 0)])
    cell = np.arange(CELLS)
    return cumulative[..., np.minimum(cell + REACH + 1, CELLS)] - cumulative[..., np.maximum(cell - REACH, 0)]
