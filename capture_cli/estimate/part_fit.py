"""What a fitted model leaves of a part of the log: errors, in units of the noise and in the outputs' own."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from capture_cli.estimate.noise.autocorrelation import block_squares, correlation_steps
from capture_cli.estimate.solve.base import Data
from capture_cli.estimate.solve.linearization import Linearization


@dataclass(frozen=True)
class PartFit:
    """One part of the log at a fit's parameters, its initial states refined.

    corrections (window, state): of the initial states. residual (window, row): in units of the noise. taken,
    taken_by_hidden (window,): see `Linearization`.
    """

    data: Data
    corrections: np.ndarray
    residual: np.ndarray
    taken: np.ndarray
    taken_by_hidden: np.ndarray

    @classmethod
    def of(cls, at: Linearization) -> Self:
        """The part that `at` is a linearization on."""
        return cls(at.data, at.corrections, at.residual, at.taken, at.taken_by_hidden)

    @classmethod
    def concatenate(cls, parts: Sequence[Self]) -> Self:
        """Several parts as one, padded to one shape."""
        first = parts[0].data
        steps = max(p.data.measured.shape[1] for p in parts)
        outputs = first.measured.shape[2]

        def padded(values: np.ndarray) -> np.ndarray:
            return np.pad(values, [(0, 0), (0, steps - values.shape[1])] + [(0, 0)] * (values.ndim - 2))

        data = Data(
            first.space,
            np.concatenate([padded(p.data.measured) for p in parts]),
            np.concatenate([padded(p.data.mask) for p in parts]),
            first.noise_sd,
            np.concatenate([p.data.initial_sd for p in parts]),
            attitudes=first.attitudes,
        )
        residual = [padded(p.residual.reshape(p.data.measured.shape)) for p in parts]
        residual = np.concatenate(residual).reshape(len(data.measured), steps * outputs)
        corrections, *taken = (
            np.concatenate([getattr(p, n) for p in parts])
            for n in ("corrections", "taken", "taken_by_hidden")
        )
        return cls(data, corrections, residual, *taken)

    def rows(self, keep: np.ndarray) -> Self:
        """The windows at `keep` alone: their numbers, or a mask (window,)."""
        own = (v[keep] for v in (self.corrections, self.residual, self.taken, self.taken_by_hidden))
        return PartFit(self.data.rows(keep), *own)

    @property
    def penalised_squares(self) -> np.ndarray:
        """Sum of squared residuals of each window, (window,), and what hidden states took of it by chance alone."""
        return np.square(self.residual).sum(axis=1) * self._penalty

    @property
    def _penalty(self) -> np.ndarray:
        """Factor on the squares of each window, (window,), for the free numbers that its hidden states are: each took a
        square of the noise, as large as those that are left.
        """
        left = self.data.mask.sum(axis=(1, 2)) - self.taken
        return 1 + self.taken_by_hidden / np.maximum(left, 1)

    @property
    def correlation_steps(self) -> float:
        """How many steps of the residual are worth one that is independent."""
        return correlation_steps(self.residual.reshape(self.data.measured.shape), self.data.mask)

    @property
    def measured_steps(self) -> int:
        """In how many steps anything was measured."""
        return int(self.data.mask.any(axis=2).sum())

    def blocks(self, length: int) -> np.ndarray:
        """Penalised squares summed over blocks of about `length` steps, (block,)."""
        by_step = np.square(self.residual.reshape(self.data.measured.shape)).sum(axis=2)
        by_step *= self._penalty[:, None]
        return block_squares(by_step, self.data.mask.any(axis=2), length)

    @property
    def rmse(self) -> np.ndarray:
        """Root mean square error per output, in its unit, (output,); nan of one that has no sample here."""
        return np.sqrt(self._mean(np.square(self.in_units)))

    @property
    def mae(self) -> np.ndarray:
        """Mean absolute error per output, in its unit, (output,); nan of one that has no sample here."""
        return self._mean(np.abs(self.in_units))

    @property
    def normalized(self) -> float:
        """RMSE over the noise floor, over all outputs."""
        return float(np.sqrt(np.square(self.residual).sum() / max(self.data.count, 1)))

    @property
    def in_units(self) -> np.ndarray:
        """Residual (window, step, output) in the outputs' units."""
        return self.residual.reshape(self.data.measured.shape) * self.data.noise_sd

    def _mean(self, values: np.ndarray) -> np.ndarray:
        samples = self.data.mask.sum(axis=(0, 1))
        return np.where(samples > 0, values.sum(axis=(0, 1)) / np.maximum(samples, 1), np.nan)
