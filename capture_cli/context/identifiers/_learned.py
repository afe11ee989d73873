"""What the learned identifiers share: a trained transformer, and the loop that reads a history with it.

They differ in the examples they are trained on and in how they use the answer; each says so in its own file.
"""

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np

from capture_cli.common.named_arrays import by_part, check_shapes
from capture_cli.context.identifiers._architecture import Architecture
from capture_cli.context.identifiers._family import QUANTILES, Family
from capture_cli.context.identifiers._inference import answer
from capture_cli.context.identifiers._normalisation import Normalisation
from capture_cli.context.identifiers.base import RoundIdentifier, Rounds, Signature

# arrays that numbers are divided or multiplied by
ABOVE_ZERO = ("normalisation.spread", "normalisation.residual_spread", "calibration.factor")


@dataclass(frozen=True)
class Prediction:
    """Gaussian, of each pair: mean (pair, parameter), covariance (pair, parameter, parameter), in their units."""

    mean: np.ndarray
    covariance: np.ndarray

    @property
    def sd(self) -> np.ndarray:
        """(pair, parameter)."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))


class TrainedModel:
    """A transformer with what belongs to it. `state` and `from_state` are what a checkpoint directory holds.

    calibration (round, parameter): the factor by which the predicted standard deviation, after so many rounds of a
    window, is multiplied. family: what a log is compared with.
    """

    def __init__(
        self,
        signature: Signature,
        architecture: Architecture,
        network: Mapping[str, np.ndarray],
        normalisation: Normalisation,
        calibration: np.ndarray,
        family: Family,
    ):
        self.signature = signature
        self.architecture = architecture
        self.normalisation = normalisation
        self.calibration = calibration
        self.family = family
        self.network = {name: np.asarray(array) for name, array in network.items()}
        self._check()

    def _check(self) -> None:
        """Raise ValueError where its parts do not belong together, or are not finite."""
        _, arrays = self.state()
        _check_shapes(arrays, self.signature, self.architecture, len(self.family.usual))
        for name, array in arrays.items():
            if not np.isfinite(array).all():
                raise ValueError(f"{name} is not finite")
            if name in ABOVE_ZERO and array.min(initial=1) <= 0:
                raise ValueError(f"{name} holds {array.min():g}, expected numbers above 0")
        usual = self.family.usual
        if np.any(np.diff(usual, axis=1) < -1e-9 * np.abs(usual).max()):
            raise ValueError("family.usual, quantiles, do not rise")

    @property
    def window(self) -> int:
        """How many rounds it reads."""
        return self.architecture.window

    def predict(self, rounds: Rounds) -> Prediction:
        """What follows the last round of `rounds`, of which the last `window` are read."""
        rounds = rounds.last(self.window)
        mean, whitening = answer(self.architecture, self.network, self.normalisation.inputs(rounds))
        covariance = covariances(whitening)
        factor = self.calibration[rounds.rounds - 1] * self.signature.space.span
        return Prediction(
            self.signature.space.from_unit(np.clip(mean, 0, 1)), covariance * np.outer(factor, factor)
        )

    def state(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Settings (JSON) and arrays by name."""
        parts = {
            "network": self.network,
            "normalisation": self.normalisation.weights(),
            "calibration": {"factor": self.calibration},
            "family": self.family.weights(),
        }
        arrays = {f"{part}.{name}": a for part, named in parts.items() for name, a in named.items()}
        return {"signature": self.signature.document(), "architecture": asdict(self.architecture)}, arrays

    @classmethod
    def from_state(cls, settings: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> Self:
        """What `state` gave; settings["histories"] says how many rounds those had that it learned from."""
        signature = Signature.from_document(settings["signature"])
        architecture = Architecture(**settings["architecture"])
        _check_shapes(arrays, signature, architecture, settings["histories"]["rounds"])
        parts = by_part(arrays)
        normalisation = Normalisation(signature, **parts["normalisation"])
        family = Family(normalisation, **parts["family"])
        return cls(
            signature, architecture, parts["network"], normalisation, parts["calibration"]["factor"], family
        )


class LearnedIdentifier(RoundIdentifier):
    """An identifier that `capture train-sysid` makes: it reads the last rounds, and changes no weight while it does.

    residual: the transformer predicts a change of the last round's parameters. fixed_window: rounds it reads; None
    where that is an option, with default_window (None: whole histories). Without `likelihood` it is trained by the
    squared error of the mean, the uncertainty beside it. tokens: as `Architecture` has them; None where that is an
    option. any_order: the answer does not depend on the order of the rounds, so that training may shuffle them. rough:
    a fit of all rounds follows, so that simulations may be spared.
    """

    needs_checkpoint = True
    residual = False
    fixed_window: int | None = None
    default_window: int | None = 4
    tokens: str | None = None
    any_order = False

    def __init__(self, signature, start, *, model: TrainedModel, rough: bool = False, **options):
        super().__init__(signature, start, **options)
        self.model = model
        self.rough = rough
        self.history = Rounds.none(len(self.start), signature)
        self.prediction: Prediction | None = None

    @staticmethod
    @abstractmethod
    def examples(rounds: Rounds) -> tuple[Rounds, np.ndarray]:
        """What it learns from histories: rounds to read, and the answer after each (pair, round, parameter)."""

    @property
    def sd(self) -> np.ndarray | None:
        return None if self.prediction is None else self.prediction.sd

    def recall(self, earlier: Rounds) -> None:
        """Know the rounds that were made before, and go on from the start."""
        self.history = earlier

    def tell(self, actions, simulated, measured) -> None:
        self.history = self.history.then(self.ask()[:, 0], actions, simulated[:, 0], measured)
        self.prediction = self.model.predict(self.history)
        self._best = self.prediction.mean


def covariances(whitening: np.ndarray) -> np.ndarray:
    """(W'W)^-1 of lower triangular W (..., parameter, parameter)."""
    inverse = np.linalg.inv(whitening)
    return inverse @ np.swapaxes(inverse, -1, -2)


def _check_shapes(
    arrays: Mapping[str, np.ndarray], signature: Signature, architecture: Architecture, rounds: int
) -> None:
    """Raise ValueError where `arrays` are not those of a model, which learned from histories of so many rounds."""
    a, trajectory = architecture, signature.trajectory_shape
    size, actions = len(signature.space), len(signature.actions)
    found, expected = (a.parameters, a.actions, a.points, a.features), (size, actions, *trajectory)
    if found != expected:
        raise ValueError(
            f"its architecture is for {found} parameters, actions, points and features, expected {expected}"
        )
    if a.layers > len(arrays):  # of so many the shapes need not be listed
        raise ValueError(f"its architecture has {a.layers} layers, and there are {len(arrays)} arrays")
    vector = actions + math.prod(trajectory)
    shapes = {f"network.{name}": shape for name, shape in architecture.weight_shapes.items()}
    shapes |= {f"normalisation.{name}": trajectory for name in ("centre", "spread", "residual_spread")}
    shapes |= {"calibration.factor": (a.window, size)}
    shapes |= {"family.mean": (vector,), "family.whitening": (vector, vector)}
    shapes |= {"family.usual": (rounds, len(QUANTILES))}
    check_shapes(arrays, shapes)
