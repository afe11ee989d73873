"""Rounds as numbers of order 1, by the ranges of the task and the spread of the histories trained on."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from capture_cli.context.identifiers.base import Rounds, Signature


@dataclass(frozen=True)
class Normalisation:
    """centre, spread, residual_spread (point, feature), in the units of the features."""

    signature: Signature
    centre: np.ndarray
    spread: np.ndarray
    residual_spread: np.ndarray

    @classmethod
    def fitted(cls, signature: Signature, rounds: Rounds) -> Self:
        """To the trajectories of `rounds`."""
        scale = np.array([f.scale for f in signature.features])
        trajectories = np.concatenate([rounds.simulated, rounds.measured])
        residual = rounds.measured - rounds.simulated
        spreads = (trajectories.std(axis=(0, 1)), np.sqrt(np.square(residual).mean(axis=(0, 1))))
        smallest_spread = 1e-3  # of a feature's declared scale: what hardly varies is not blown up
        return cls(
            signature,
            trajectories.mean(axis=(0, 1)),
            *(np.maximum(s, smallest_spread * scale) for s in spreads),
        )

    @property
    def sizes(self) -> np.ndarray:
        """Root mean square of the trajectories (point, feature), in the units of the features."""
        return np.hypot(self.centre, self.spread)

    def inputs(self, rounds: Rounds) -> dict[str, np.ndarray]:
        """float32 arrays by the names of `_transformer.Inputs`."""
        residual = (rounds.measured - rounds.simulated) / self.residual_spread
        knee = 0.01  # of its spread, where a companded residual turns from linear to logarithmic
        companded = np.arcsinh(residual / knee) / np.arcsinh(1 / knee)
        arrays = {
            "parameters": 2 * self.signature.space.to_unit(rounds.parameters) - 1,
            "actions": 2 * self.signature.actions.to_unit(rounds.actions) - 1,
            "simulated": (rounds.simulated - self.centre) / self.spread,
            "measured": (rounds.measured - self.centre) / self.spread,
            "residual": np.concatenate([residual, companded], axis=-1),
        }
        return {name: array.astype(np.float32) for name, array in arrays.items()}

    def weights(self) -> dict[str, np.ndarray]:
        """The arrays, by name."""
        return {"centre": self.centre, "spread": self.spread, "residual_spread": self.residual_spread}
