"""Does a log look like what an identifier was trained on?

A round is a vector: action and measured trajectory. Over the training histories these vectors lie near a surface, and
the Mahalanobis distance weighs the directions off that surface most. What is usual is not taken from the chi-squared
law, which curved surfaces break, but from histories held out of training.

Under which parameters a round was simulated, and what that gave, says nothing of the log. In training the action was
chosen for them, too, which in a log it never was: with them in the vector no log is like the histories.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from capture_cli.context.identifiers._normalisation import Normalisation
from capture_cli.context.identifiers.base import Rounds

QUANTILES = np.concatenate([np.linspace(0, 0.98, 50), np.linspace(0.981, 1.0, 20)])


@dataclass(frozen=True)
class Family:
    """mean (d,), whitening (d, d) of a round's vector; usual (round, quantile): squared distances held out.

    usual[n - 1]: the squared distance over d, averaged over n rounds of a history, at QUANTILES of the histories.
    """

    normalisation: Normalisation
    mean: np.ndarray
    whitening: np.ndarray
    usual: np.ndarray

    @classmethod
    def fitted(cls, normalisation: Normalisation, trained: Rounds, held_out: Rounds) -> Self:
        """To the rounds trained on, judged by those held out."""
        vectors = _vectors(normalisation, trained)
        vectors = vectors.reshape(-1, vectors.shape[-1])
        mean = vectors.mean(axis=0)
        values, directions = np.linalg.eigh(np.cov(vectors, rowvar=False))
        # of the mean variance of a direction: what never varied in training weighs no more than this
        ridge = 1e-6
        values = np.maximum(values, 0) + ridge * max(values.mean(), 1e-300)
        family = cls(normalisation, mean, directions / np.sqrt(values), np.zeros((0, 0)))
        distances = family.distances(held_out)
        count = np.arange(1, held_out.rounds + 1)
        averages = np.cumsum(distances, axis=1) / count
        return cls(normalisation, mean, family.whitening, np.quantile(averages, QUANTILES, axis=0).T)

    def with_noise(self, noise_sd: np.ndarray) -> Self:
        """The same where what is measured has noise_sd (feature,) or (point, feature), in the features' units, which
        training had not.

        Directions in which training varied by less than the noise weigh no more than the noise allows, and what it adds
        to a distance on average is usual.
        """
        if not np.any(noise_sd):
            return self
        size = self.normalisation.spread.size
        variance = np.zeros(len(self.mean))
        variance[-size:] = np.square(noise_sd / self.normalisation.spread).ravel()
        covariance = np.linalg.inv(self.whitening @ self.whitening.T) + np.diag(variance)
        values, directions = np.linalg.eigh((covariance + covariance.T) / 2)
        whitening = directions / np.sqrt(values)
        added = float((variance @ np.square(whitening)).mean())
        return replace(self, whitening=whitening, usual=self.usual + added)

    def distances(self, rounds: Rounds) -> np.ndarray:
        """Squared Mahalanobis distance over d of every round (pair, round); about 1 for what is usual."""
        scaled = (_vectors(self.normalisation, rounds) - self.mean) @ self.whitening
        return np.square(scaled).mean(axis=-1)

    def share_beyond(self, rounds: Rounds) -> np.ndarray:
        """How many of the held-out histories lie as far out or further, as a share (pair,); 0: none does.

        Below 0.01 the pair is outside of what was trained on. Pairs of more rounds than a training history are
        judged by the law of the longest ones, which is the wider one.
        """
        usual = self.usual[min(rounds.rounds, len(self.usual)) - 1]
        average = self.distances(rounds).mean(axis=1)
        return 1 - np.interp(average, usual, QUANTILES, left=0.0, right=1.0)

    def weights(self) -> dict[str, np.ndarray]:
        """The arrays, by name."""
        return {"mean": self.mean, "whitening": self.whitening, "usual": self.usual}


def _vectors(normalisation: Normalisation, rounds: Rounds) -> np.ndarray:
    """Action and measured trajectory of every round (pair, round, d), of order 1."""
    inputs = normalisation.inputs(rounds)
    flat = [inputs[n].reshape(*inputs[n].shape[:2], -1) for n in ("actions", "measured")]
    return np.concatenate(flat, axis=-1).astype(float)
