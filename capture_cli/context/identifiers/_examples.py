"""What identifiers learn from histories: rounds to read, and the answer after each (pair, round, parameter)."""

import numpy as np

from capture_cli.context.identifiers.base import Rounds

Examples = tuple[Rounds, np.ndarray]


def next_parameters(rounds: Rounds) -> Examples:
    """After each round its successor's parameters; after the last, which is at the target, the target."""
    return rounds, np.concatenate([rounds.parameters[:, 1:], rounds.target[:, None]], axis=1)


def target_after_the_first(rounds: Rounds) -> Examples:
    """The first round alone, and the target: one iteration, from a random source (the paper's Section IV-B)."""
    return rounds.first(1), rounds.target[:, None]


def target_after_each(rounds: Rounds) -> Examples:
    """The target after every round."""
    return rounds, np.repeat(rounds.target[:, None], rounds.rounds, axis=1)
