"""CMA-ES: a search that needs no derivatives, for models whose outputs jump (Hansen 2016, arXiv:1604.00772).

The evolution itself is the `cmaes` package. Initial states are eliminated to first order: their sensitivities are
measured at the best point every few generations and each candidate is judged by what is left of its residual.
"""

from dataclasses import replace

import numpy as np

from capture_cli.estimate.solve.base import Best, Identifier, Trial
from capture_cli.estimate.solve.linearization import Linearization, columns, inflation


class CmaEs(Identifier):
    """CMA-ES in the unit cube. `rounds` counts generations; `starts` is not used."""

    summary = "an evolution strategy, which needs no derivatives"

    def __init__(self, data, **options):
        super().__init__(data, **options)
        from cmaes import CMA

        size = len(self.space)
        # one dimension is beyond the package: a dummy coordinate is carried along
        self._dummy = size == 1
        bounds = np.tile([0.0, 1.0], (size + self._dummy, 1))
        mean = np.clip(self.space.to_unit(self.start), 0.02, 0.98)
        mean = np.append(mean, 0.5) if self._dummy else mean
        spread = 0.25  # of the unit cube, the first step size
        self._search = CMA(mean=mean, sigma=spread, bounds=bounds, seed=self.seed) if size else None
        self._best_x = np.clip(self.space.to_unit(self.start), 0, 1)
        self._best = Best(self.start, self.corrections, np.inf)
        self._lowest = np.inf  # objective of the best, which the prior of its initial states is part of
        self._at: Linearization | None = None
        self._generation = 0
        self._stalled = 0
        self._milestone = np.inf
        self._linearizing = True
        self._asked: list[np.ndarray] = []

    def carried_on(self, data, rounds):
        """With its mean, step size and covariance. What has converged begins anew: it would not move again."""
        if self._search is None or self._search.should_stop():
            return None
        self.data = data
        self.rounds_left = rounds
        self.corrections = np.zeros_like(data.initial_sd)
        # errors were of other data: the best point is looked at again first
        self._best = Best(self._best.parameters, self.corrections, np.inf)
        self._lowest = self._milestone = np.inf
        self._at = None
        self._generation = self._stalled = 0
        self._linearizing = True
        return self

    @property
    def best(self) -> Best:
        return self._best

    @property
    def at_rest(self) -> bool:
        if self._search is None:
            return self._at is not None
        stalled = 25  # generations in which the error fell by less than a thousandth
        return not self._linearizing and (self._search.should_stop() or self._stalled >= stalled)

    def ask(self) -> Trial:
        if self._linearizing:
            return columns(self.data, self._best_x, self._best.corrections, parameters=False)
        self._asked = [self._search.ask() for _ in range(self._search.population_size)]
        points = np.array(self._asked)[:, : len(self.space)]
        corrections = np.repeat(self._best.corrections[None], len(points), axis=0)
        return Trial(self.space.from_unit(points), corrections)

    def tell(self, outputs, diverged):
        if self._linearizing:
            self._relinearize(outputs, diverged)
            return
        residuals = self.data.residual(outputs)
        values = np.array([self._value(r) for r in residuals])
        values[diverged.any(axis=1)] = np.inf
        finite = values[np.isfinite(values)]
        worst = 10 * finite.max() if finite.size else 1e300
        self._search.tell(
            [(x, v if np.isfinite(v) else worst) for x, v in zip(self._asked, values, strict=True)]
        )
        chosen = int(np.argmin(values))
        if values[chosen] < self._lowest:
            self._lowest = values[chosen]
            self._best_x = self._asked[chosen][: len(self.space)]
            _, left = self._step(residuals[chosen])
            self._best = Best(
                self.space.from_unit(self._best_x), self._corrections(residuals[chosen]), self._error(left)
            )
            # where the next candidates begin
            self._at = replace(self._at, corrections=self._best.corrections)
        self._generation += 1
        self._stalled += 1
        if self._lowest < 0.999**2 * self._milestone:
            self._stalled, self._milestone = 0, self._lowest
        relinearize = 10  # generations
        self._linearizing = self._generation % relinearize == 0

    def _relinearize(self, outputs, diverged) -> None:
        self._at = Linearization.from_columns(
            self.data, self._best_x, self._best.corrections, outputs, diverged, parameters=False
        )
        if not diverged[0].any():
            # what was known before was to first order about another point: this is exact
            self._lowest = float(self._at.objectives(self._at.inflation).sum())
            self._best = replace(self._best, error=self._error(self._at.residual))
        self._linearizing = False

    def _error(self, residual: np.ndarray) -> float:
        return float(np.sqrt(np.square(residual).sum() / self.data.count))

    def _step(self, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The initial states' step dz (window, state) that fits `residual` (window, row) best, and what it leaves."""
        k = inflation(self.data, residual)
        b = self._at.by_initial
        right = (b.swapaxes(1, 2) @ residual[..., None])[..., 0] - k * self._at.z
        dz = (self._at.initial_gain(k) @ right[..., None])[..., 0]
        return dz, residual - (b @ dz[..., None])[..., 0]

    def _value(self, residual: np.ndarray) -> float:
        dz, left = self._step(residual)
        k = inflation(self.data, left)
        return float(np.square(left).sum() + k * np.square(self._at.z + dz).sum())

    def _corrections(self, residual: np.ndarray) -> np.ndarray:
        """Corrections (window, state), SI, of the initial states that fit `residual` best."""
        at = replace(self._at, residual=residual)
        return at.corrections_after(np.zeros(0), at.inflation)
