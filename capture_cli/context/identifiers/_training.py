"""Training of a learned identifier: AdamW with warm-up and cosine decay, early stopping, and a state to go on from.

The weights returned are those of the best evaluation on pairs held out. Half of these choose them and set the factors
of the uncertainty; the other half report how it all turned out.
"""

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch

from capture_cli.common.frozen import frozen
from capture_cli.common.named_arrays import by_part
from capture_cli.common.quantities import NORMAL_QUANTILE
from capture_cli.context.identifiers._batches import Batches, Place, Read, windows
from capture_cli.context.identifiers._family import Family
from capture_cli.context.identifiers._learned import LearnedIdentifier, TrainedModel, covariances
from capture_cli.context.identifiers._normalisation import Normalisation
from capture_cli.context.identifiers._transformer import (
    Architecture,
    Inputs,
    Outputs,
    Transformer,
    negative_log_likelihood,
    squared_error,
)
from capture_cli.context.identifiers.base import Rounds, Signature
from capture_cli.errors import FitError


@frozen
class SETTINGS:
    clip: float = 1.0  # norm of the gradient
    spread_weight: float = 0.01  # of its likelihood beside the squared error
    betas: tuple[float, float] = (0.9, 0.95)
    last_rate: float = 0.01  # of the learning rate, at the last step
    fitted_pairs: int = 16384  # to fit the normalisation and the family to
    evaluated_pairs: int = 4096  # held out at most, so that an evaluation stays cheap
    evaluation_batch: int = 512
    covered: float = 0.95  # of the truths, by 1.96 standard deviations
    smallest_factor: float = 0.01  # a few pairs may be hit exactly, which promises nothing


@dataclass(frozen=True)
class Settings:
    """How to train. validation: share of the pairs held out. patience: evaluations without a gain before it stops."""

    steps: int = 20_000
    batch: int = 256
    learning_rate: float = 1e-3
    warmup: int = 200
    weight_decay: float = 0.01
    validation: float = 0.1
    evaluations: int = 50
    patience: int = 10
    seed: int = 0

    @property
    def every(self) -> int:
        """Steps between evaluations."""
        return max(1, self.steps // self.evaluations)

    def rate(self, step: int) -> float:
        """The learning rate of the step (from 0): linear warm-up, then half a cosine down to `last_rate`."""
        if step < self.warmup:
            return self.learning_rate * (step + 1) / self.warmup
        share = (step - self.warmup) / max(1, self.steps - self.warmup)
        return self.learning_rate * (
            SETTINGS.last_rate + (1 - SETTINGS.last_rate) * (1 + math.cos(math.pi * min(share, 1))) / 2
        )


@dataclass(frozen=True)
class Device:
    """Where to compute, and whether the blocks compute in bfloat16."""

    name: str = "cpu"
    low_precision: bool = False


@dataclass(frozen=True)
class Judged:
    """Truth minus mean in the unit cube, and the same over the predicted sd, both (pair, round, parameter).

    likelihood: negative log likelihood per parameter.
    """

    error: np.ndarray
    scaled: np.ndarray
    likelihood: float


@dataclass(frozen=True)
class TrainingHistories:
    """As many `pairs` as `read` gives, of the signature's task."""

    signature: Signature
    read: Read
    pairs: int


class Trainer:
    """Trains an identifier of class `kind` on histories."""

    def __init__(
        self,
        kind: type[LearnedIdentifier],
        histories: TrainingHistories,
        architecture: Architecture,
        settings: Settings,
        device: Device,
    ):
        signature, read, pairs = histories.signature, histories.read, histories.pairs
        self.kind = kind
        self.signature = signature
        self.architecture = architecture
        self.settings = settings
        self.device = device
        held_out = min(max(2, round(settings.validation * pairs)), SETTINGS.evaluated_pairs, pairs // 2)
        self.trained_pairs = pairs - held_out
        fitted = read(0, min(SETTINGS.fitted_pairs, self.trained_pairs))
        self.held_out = read(self.trained_pairs, pairs)
        self._fitted = fitted
        self.normalisation = Normalisation.fitted(signature, fitted)
        self.batches = Batches(
            read,
            kind.examples,
            self.trained_pairs,
            settings.batch,
            architecture.window,
            settings.seed,
            kind.any_order,
        )
        torch.manual_seed(settings.seed)
        self.transformer = Transformer(architecture).to(device.name)
        self.optimizer = self._optimizer()
        self.step = 0
        self.place = Place()
        self.best: dict[str, Any] = {"step": 0, "loss": math.inf}
        self.best_network = self._network()
        self.metrics: list[dict[str, Any]] = []
        self._summed = torch.zeros((), device=device.name)
        self._counted = 0

    @property
    def done(self) -> bool:
        """Whether all steps are made, or nothing has been gained for `patience` evaluations since the warm-up."""
        since = max(self.best["step"], self.settings.warmup)
        stalled = self.step - since >= self.settings.patience * self.settings.every
        return self.step >= self.settings.steps or (bool(self.metrics) and stalled)

    def run(self) -> Iterator[dict[str, Any]]:
        """Train until done; yields the metrics of each evaluation, when `state` may be taken."""
        for rounds, answers, after in self.batches.since(self.place):
            if self.done:
                return
            self._train(rounds, answers)
            self.place = after
            self.step += 1
            if self.step % self.settings.every == 0 or self.step == self.settings.steps:
                self.metrics.append(self._evaluate())
                yield self.metrics[-1]

    # --- one step ---

    def _train(self, rounds: Rounds, answers: np.ndarray) -> None:
        for group in self.optimizer.param_groups:
            group["lr"] = self.settings.rate(self.step)
        self.transformer.train()
        outputs = self._forward(rounds)
        labels = self._labels(answers)
        self.optimizer.zero_grad(set_to_none=True)
        self._objective(outputs, labels).mean().backward()
        torch.nn.utils.clip_grad_norm_(self.transformer.parameters(), SETTINGS.clip)
        self.optimizer.step()
        self._summed += self._loss(outputs, labels)
        self._counted += 1

    def _forward(self, rounds: Rounds) -> Outputs:
        arrays = self.normalisation.inputs(rounds)
        inputs = Inputs(**{k: torch.from_numpy(v).to(self.device.name) for k, v in arrays.items()})
        return self.transformer(
            inputs, own_spread=not self.kind.likelihood, low_precision=self.device.low_precision
        )

    def _labels(self, answers: np.ndarray) -> torch.Tensor:
        labels = self.signature.space.to_unit(answers).astype(np.float32)
        return torch.from_numpy(labels).to(self.device.name)

    @torch.no_grad()
    def _loss(self, outputs: Outputs, labels: torch.Tensor) -> torch.Tensor:
        """What evaluations judge by: the likelihood, or the squared error of the proposal, which is in the ranges."""
        if self.kind.likelihood:
            return negative_log_likelihood(outputs, labels, detach_mean=False).mean()
        return (outputs.mean.clamp(0, 1) - labels).square().mean()

    def _objective(self, outputs: Outputs, labels: torch.Tensor) -> torch.Tensor:
        """What is descended (batch, round): the likelihood; or the squared error, and the likelihood of the spread
        about that mean.
        """
        if self.kind.likelihood:
            return negative_log_likelihood(outputs, labels, detach_mean=False)
        spread = negative_log_likelihood(outputs, labels, detach_mean=True)
        # the two share no weights; but the norm that gradients are clipped to, of which the spread may not take much
        return squared_error(outputs, labels) + SETTINGS.spread_weight * spread

    def _optimizer(self) -> torch.optim.AdamW:
        decayed = [p for p in self.transformer.parameters() if p.ndim >= 2]
        others = [p for p in self.transformer.parameters() if p.ndim < 2]
        groups = [
            {"params": decayed, "weight_decay": self.settings.weight_decay},
            {"params": others, "weight_decay": 0.0},
        ]
        return torch.optim.AdamW(groups, lr=self.settings.learning_rate, betas=SETTINGS.betas)

    # --- evaluation ---

    def _evaluate(self) -> dict[str, Any]:
        chosen, _ = self._halves()
        held_out = self._judge(chosen)
        loss = held_out.likelihood if self.kind.likelihood else float(np.square(held_out.error).mean())
        if loss < self.best["loss"]:
            self.best = {"step": self.step, "loss": loss}
            self.best_network = self._network()
        trained = float(self._summed) / max(1, self._counted)
        self._summed.zero_()
        self._counted = 0
        metrics = {
            "step": self.step,
            "epoch": self.place.epoch,
            "learning_rate": self.settings.rate(self.step - 1),
            "training_loss": trained,
            "validation_loss": loss,
            "mean_absolute_error": float(np.abs(held_out.error).mean()),
            "last_round_error": float(np.abs(held_out.error[:, -1]).mean()),
            "negative_log_likelihood": held_out.likelihood,
        }
        if not all(math.isfinite(value) for value in metrics.values()):
            raise FitError(
                f"the training diverged: after step {self.step} its loss is {trained:g}, on pairs held out {loss:g}",
                cure=f"begin anew (--force) with an --lr below {self.settings.learning_rate:g}, or a longer --warmup",
            )
        return metrics

    def _halves(self) -> tuple[Rounds, Rounds]:
        half = len(self.held_out) // 2
        return self.held_out.pairs(slice(None, half)), self.held_out.pairs(slice(half, None))

    def _judge(self, held_out: Rounds) -> Judged:
        """How the weights as they are do on a window of each of these pairs."""
        rounds, answers = self.kind.examples(held_out)
        generator = np.random.default_rng([self.settings.seed, 3])
        rounds, answers = windows(
            rounds, answers, self.architecture.window, generator, any_order=self.kind.any_order
        )
        self.transformer.eval()
        errors, sds, likelihoods = [], [], []
        with torch.inference_mode():
            for i in range(0, len(rounds), SETTINGS.evaluation_batch):
                part = slice(i, i + SETTINGS.evaluation_batch)
                outputs, labels = self._forward(rounds.pairs(part)), self._labels(answers[part])
                errors.append(_array(labels - outputs.mean.clamp(0, 1)))
                covariance = covariances(_array(outputs.whitening))
                sds.append(np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1)))
                likelihoods.append(_array(negative_log_likelihood(outputs, labels, detach_mean=False)))
        error = np.concatenate(errors)
        return Judged(error, error / np.concatenate(sds), float(np.concatenate(likelihoods).mean()))

    # --- the result ---

    def finish(self) -> tuple[TrainedModel, dict[str, Any]]:
        """The best weights as a model, and how it did on the pairs that chose nothing."""
        self._load(self.best_network)
        chosen, reported = self._halves()
        factor = np.quantile(np.abs(self._judge(chosen).scaled), SETTINGS.covered, axis=0) / NORMAL_QUANTILE
        factor = np.maximum(factor, SETTINGS.smallest_factor)
        judged = self._judge(reported)
        error, covered = judged.error, np.abs(judged.scaled / factor) <= NORMAL_QUANTILE
        names = self.signature.space.names
        report = {
            "steps": self.step,
            "best_step": self.best["step"],
            "validation_loss": self.best["loss"],
            "pairs": {"trained": self.trained_pairs, "held_out": len(self.held_out)},
            "mean_absolute_error": dict(zip(names, np.abs(error).mean(axis=(0, 1)).tolist(), strict=True)),
            "error_by_round": np.abs(error).mean(axis=(0, 2)).tolist(),
            "coverage": dict(zip(names, covered.mean(axis=(0, 1)).tolist(), strict=True)),
        }
        family = Family.fitted(self.normalisation, self._fitted, self.held_out)
        model = TrainedModel(
            self.signature, self.architecture, self._network(), self.normalisation, factor, family
        )
        return model, report

    # --- state ---

    def state(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Counters (JSON) and arrays, from which `restore` goes on as if nothing had happened."""
        arrays = {f"network.{k}": v for k, v in self._network().items()}
        arrays |= {f"best.{k}": v for k, v in self.best_network.items()}
        for name, parameter in self.transformer.named_parameters():
            for key, value in self.optimizer.state[parameter].items():
                arrays[f"optimizer.{key}.{name}"] = value.detach().cpu().numpy()
        arrays["random.cpu"] = torch.get_rng_state().numpy()
        if self.device.name != "cpu":
            arrays["random.device"] = torch.cuda.get_rng_state(self.device.name).numpy()
        counters = {
            "step": self.step,
            "place": asdict(self.place),
            "best": self.best,
            "metrics": self.metrics,
        }
        return counters, arrays

    def restore(self, counters: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
        """Go on from a `state`."""
        parts = by_part(arrays)
        self._load(parts["network"])
        self.best_network = parts["best"]
        for name, parameter in self.transformer.named_parameters():
            self.optimizer.state[parameter] = {
                key: torch.from_numpy(parts["optimizer"][f"{key}.{name}"].copy()).to(
                    "cpu" if key == "step" else self.device.name
                )
                for key in ("step", "exp_avg", "exp_avg_sq")
            }
        torch.set_rng_state(torch.from_numpy(parts["random"]["cpu"].copy()))
        if self.device.name != "cpu" and "device" in parts["random"]:
            torch.cuda.set_rng_state(torch.from_numpy(parts["random"]["device"].copy()), self.device.name)
        self.step, self.place = counters["step"], Place(**counters["place"])
        self.best, self.metrics = counters["best"], counters["metrics"]

    def _network(self) -> dict[str, np.ndarray]:
        return {k: v.detach().cpu().numpy().copy() for k, v in self.transformer.state_dict().items()}

    def _load(self, network: dict[str, np.ndarray]) -> None:
        self.transformer.load_state_dict({k: torch.from_numpy(np.array(v)) for k, v in network.items()})


def _array(tensor: torch.Tensor) -> np.ndarray:
    return tensor.double().cpu().numpy()
