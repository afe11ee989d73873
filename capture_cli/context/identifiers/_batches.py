"""Training batches from histories that need not fit in memory, in an order that depends on the seed alone."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.context.identifiers.base import ARRAYS, Rounds


@frozen
class SETTINGS:
    block_pairs: int = 2048  # read at once
    pool_blocks: int = 8  # in memory at once: shuffled together


# the pairs [first, last) of the histories
Read = Callable[[int, int], Rounds]
# histories -> rounds to read, and the answer after each (pair, round, parameter)
Examples = Callable[[Rounds], tuple[Rounds, np.ndarray]]


@dataclass(frozen=True)
class Place:
    """Where in the endless sequence of batches one stands."""

    epoch: int = 0
    pool: int = 0
    batch: int = 0


@dataclass(frozen=True)
class Batches:
    """Batches of `size` windows of `window` rounds, drawn from the pairs [0, pairs).

    any_order: some of them in random order, where the answer is the same after each round.
    """

    read: Read
    examples: Examples
    pairs: int
    size: int
    window: int
    seed: int
    any_order: bool = False

    def since(self, place: Place) -> Iterator[tuple[Rounds, np.ndarray, Place]]:
        """Rounds, answers (pair, round, parameter) and the place after, from `place` on without end.

        A pool is cut into whole batches, and the pairs left over wait for the next epoch; a pool smaller than a
        batch is one batch.
        """
        while True:
            pools = self._pools(place.epoch)
            for pool in range(place.pool, len(pools)):
                place = replace(place, pool=pool)
                for chosen, after in self._of_pool(pools[pool], place):
                    rounds, answers = self.examples(chosen)
                    yield *self._windows(rounds, answers, after), after
                place = Place(place.epoch, pool + 1)
            place = Place(place.epoch + 1)

    def _pools(self, epoch: int) -> list[np.ndarray]:
        """The first pairs of the blocks of each pool."""
        blocks = np.arange(0, self.pairs, SETTINGS.block_pairs)
        order = np.random.default_rng([self.seed, 0, epoch]).permutation(blocks)
        return [order[i : i + SETTINGS.pool_blocks] for i in range(0, len(order), SETTINGS.pool_blocks)]

    def _of_pool(self, blocks: np.ndarray, place: Place) -> Iterator[tuple[Rounds, Place]]:
        parts = [self.read(b, min(b + SETTINGS.block_pairs, self.pairs)) for b in blocks.tolist()]
        order = np.random.default_rng([self.seed, 1, place.epoch, place.pool]).permutation(
            sum(len(p) for p in parts)
        )
        held = joined(parts)
        for batch in range(place.batch, max(1, len(order) // self.size)):
            rows = order[batch * self.size : (batch + 1) * self.size]
            yield held.pairs(rows), replace(place, batch=batch + 1)

    def _windows(self, rounds: Rounds, answers: np.ndarray, place: Place) -> tuple[Rounds, np.ndarray]:
        """A random window of each pair's rounds."""
        generator = np.random.default_rng([self.seed, 2, place.epoch, place.pool, place.batch])
        return windows(rounds, answers, self.window, generator, any_order=self.any_order)


def windows(
    rounds: Rounds, answers: np.ndarray, window: int, generator: np.random.Generator, *, any_order: bool
) -> tuple[Rounds, np.ndarray]:
    """`window` rounds of each pair and their answers: neighbours, from a random first one on.

    any_order: of every other pair, any rounds in random order.
    """
    count, pairs = rounds.rounds, len(rounds)
    window = min(window, count)
    index = generator.integers(0, count - window + 1, (pairs, 1)) + np.arange(window)
    if any_order:
        shuffled = generator.permuted(np.tile(np.arange(count), (pairs, 1)), axis=1)[:, :window]
        index[::2] = shuffled[::2]
    pair = np.arange(pairs)[:, None]
    return rounds.each(lambda a: a[pair, index]), answers[pair, index]


def joined(parts: list[Rounds]) -> Rounds:
    """All pairs of `parts`, in order."""
    if len(parts) == 1:
        return parts[0]
    return Rounds(*(np.concatenate([getattr(p, n) for p in parts]) for n in (*ARRAYS, "target")))
