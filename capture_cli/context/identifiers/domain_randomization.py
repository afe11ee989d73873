"""Domain randomization (Peng et al. 2018, arXiv:1710.06537): no identification, parameters drawn from their range."""

import numpy as np

from capture_cli.context.identifiers.base import RoundIdentifier


class DomainRandomization(RoundIdentifier):
    """The yardstick: new random parameters every round, which ignore what was measured."""

    summary = "no identification: random parameters every round"

    def __init__(self, signature, start, **options):
        super().__init__(signature, start, **options)
        self._generator = np.random.default_rng(self.seed)

    def tell(self, actions, simulated, measured) -> None:
        self._best = self.space.from_unit(self._generator.random(self.start.shape))
