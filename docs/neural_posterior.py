"""Neural posterior estimation on the histories and pairs of the others: `python -m docs.neural_posterior -h`.

The rival that a statistician would train. `sbi` (extra `benchmarks`) has the density: a neural spline flow (Durkan et
al. 2019) of the parameters, given rounds in any number and order, which one network reads each by itself and another
from their sum (Chan et al. 2018). A round is its action and what was measured; of a simulation whose parameters are
known nothing else can be learned. The estimate is the mean of the posterior, and asked for next.
"""

from __future__ import annotations

import argparse
import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from sbi.neural_nets import posterior_nn
from sbi.neural_nets.embedding_nets import FCEmbedding, PermutationInvariantEmbedding
from sbi.neural_nets.estimators import ConditionalDensityEstimator

from capture_cli.common.frozen import frozen
from capture_cli.context.evaluation.evaluated_identifier import Evaluated
from capture_cli.context.evaluation.evaluation_plan import evaluation_plan
from capture_cli.context.identifiers._normalisation import Normalisation
from capture_cli.context.identifiers.base import RoundIdentifier, Rounds, Signature
from capture_cli.options.eval_sim2sim import EvalSim2SimOptions
from capture_cli.stages.evaluation.evaluation_run import carry_out
from capture_cli.store.histories import Histories
from capture_cli.store.provenance import Provenance

NAME = "neural-posterior"


@frozen
class SETTINGS:
    hidden: int = 128  # of the networks that read rounds
    embedded: int = 64  # numbers that they hand the flow
    # On air hockey, training 1: after 500 steps 256 histories lose less held out than 64. By 64, 1,500 steps at 1e-3
    # lose less than at 3e-4, half as wide, with a decay of 0.3, or at 3e-3 and twice as wide; simulated trajectories
    # beside the measured change nothing (-6.88, -6.89). 3,000 by 64 end as near in rounds (0.058 of the range).
    batch: int = 256
    rate: float = 2e-3
    decay: float = 0.01
    steps: int = 4000
    evaluations: int = 50  # the weights are those of the best
    held_out: float = 0.1  # of the histories
    clip: float = 1.0  # norm of the gradient
    draws: int = 1000  # of a posterior, for its mean and spread


@dataclass(frozen=True)
class Trained:
    """The density, and how rounds are normalised for it. window: rounds that it reads at most. pairs: histories that
    it learned from.
    """

    density: ConditionalDensityEstimator
    normalisation: Normalisation
    window: int
    pairs: int

    @torch.no_grad()
    def posterior(self, rounds: Rounds, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation (pair, parameter) of what it draws within the ranges, in the unit cube."""
        read = _read(self.normalisation, rounds.last(self.window), self.window)
        with torch.random.fork_rng(devices=()):
            torch.manual_seed(seed)
            drawn = self.density.sample((SETTINGS.draws,), read).double().numpy()
        outside = ((drawn < 0) | (drawn > 1)).any(axis=-1)
        outside[:, outside.all(axis=0)] = False
        inside = np.where(outside[..., None], np.nan, np.clip(drawn, 0, 1))
        return np.nanmean(inside, axis=0), np.nanstd(inside, axis=0)


class NeuralPosterior(RoundIdentifier):
    """Asks for the mean of the posterior, given the last rounds."""

    def __init__(self, signature, start, *, trained: Trained, **options):
        super().__init__(signature, start, **options)
        self.trained = trained
        self.history = Rounds.none(len(self.start), signature)
        self._sd: np.ndarray | None = None

    @property
    def sd(self) -> np.ndarray | None:
        return self._sd

    def tell(self, actions, simulated, measured) -> None:
        self.history = self.history.then(self.best, actions, simulated[:, 0], measured)
        mean, sd = self.trained.posterior(self.history, self.seed)
        self._best, self._sd = self.space.from_unit(mean), sd * self.space.span


def train(store: Histories, seed: int) -> Trained:
    """The density that is likeliest of the held-out histories, after any number of their rounds."""
    signature = Signature.from_document(store.attributes)
    held_out = round(SETTINGS.held_out * len(store))
    trained_on, judged_on = (
        Rounds(**store.read(*ends))
        for ends in ((0, len(store) - held_out), (len(store) - held_out, len(store)))
    )
    torch.manual_seed(seed)
    generator = np.random.default_rng(seed)
    normalisation, window = Normalisation.fitted(signature, trained_on), trained_on.rounds
    read = partial(_read, normalisation, window=window)
    answers = partial(_answers, signature)
    density = _density(answers(trained_on), read(trained_on))
    optimizer = torch.optim.AdamW(density.parameters(), lr=SETTINGS.rate, weight_decay=SETTINGS.decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, SETTINGS.steps)
    best, weights = math.inf, density.state_dict()
    for step in range(1, SETTINGS.steps + 1):
        batch = trained_on.pairs(generator.choice(len(trained_on), SETTINGS.batch, replace=False))
        optimizer.zero_grad()
        density.loss(answers(batch), _some(read(batch), generator)).mean().backward()
        torch.nn.utils.clip_grad_norm_(density.parameters(), SETTINGS.clip)
        optimizer.step()
        schedule.step()
        if step % (SETTINGS.steps // SETTINGS.evaluations) == 0:
            loss = np.mean(
                [_loss(density, answers(judged_on), read(judged_on.first(n))) for n in range(1, window + 1)]
            )
            if loss < best:
                best, weights = loss, copy.deepcopy(density.state_dict())
    density.load_state_dict(weights)
    return Trained(density.eval(), normalisation, window, len(trained_on))


def _density(answers: torch.Tensor, read: torch.Tensor) -> ConditionalDensityEstimator:
    """Not trained: of answers (pair, parameter), given rounds (pair, round, number)."""
    width = SETTINGS.hidden
    of_round = FCEmbedding(read.shape[-1], output_dim=width, num_layers=3, num_hiddens=width)
    of_rounds = PermutationInvariantEmbedding(
        of_round, width, num_hiddens=width, output_dim=SETTINGS.embedded
    )
    return posterior_nn("nsf", z_score_x="none", embedding_net=of_rounds)(answers, read)


@torch.no_grad()
def _loss(density: ConditionalDensityEstimator, answers: torch.Tensor, read: torch.Tensor) -> float:
    return float(density.loss(answers, read).mean())


def _answers(signature: Signature, rounds: Rounds) -> torch.Tensor:
    """The targets (pair, parameter), in the unit cube."""
    return torch.from_numpy(signature.space.to_unit(rounds.target)).float()


def _read(normalisation: Normalisation, rounds: Rounds, window: int) -> torch.Tensor:
    """Actions and what was measured (pair, window, number), of order 1; NaN after the last round."""
    arrays = normalisation.inputs(rounds)
    numbers = np.concatenate(
        [arrays["actions"], arrays["measured"].reshape(*arrays["actions"].shape[:2], -1)], axis=-1
    )
    return torch.from_numpy(
        np.pad(numbers, ((0, 0), (0, window - rounds.rounds), (0, 0)), constant_values=np.nan)
    )


def _some(read: torch.Tensor, generator: np.random.Generator) -> torch.Tensor:
    """As many of the rounds of each pair as are drawn, one at least, at random; NaN elsewhere."""
    pairs, window = read.shape[:2]
    place = generator.random((pairs, window)).argsort(axis=1).argsort(axis=1)
    left_out = place >= generator.integers(1, window + 1, (pairs, 1))
    return read.masked_fill(torch.from_numpy(left_out)[..., None], math.nan)


def main(given: Sequence[str] | None = None) -> None:
    """Train, and write an evaluation with `domain-randomization` beside."""
    parser = argparse.ArgumentParser(prog="python -m docs.neural_posterior", description=__doc__)
    parser.add_argument("--task", required=True)
    parser.add_argument("--policy", required=True, help="that chooses actions")
    parser.add_argument("--histories", required=True, help="to learn from")
    parser.add_argument("--seed", type=int, default=0, help="of the training")
    parser.add_argument("--pairs", type=int, default=100)
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--out", type=Path, required=True, help="evaluation directory to write")
    asked = parser.parse_args(given)
    provenance = Provenance("docs.neural_posterior", vars(asked), {"histories": Path(asked.histories)})
    torch.set_num_threads(1)
    options = EvalSim2SimOptions(
        out=asked.out,
        identifiers=["domain-randomization"],
        task=asked.task,
        policy=asked.policy,
        pairs=asked.pairs,
        seeds=1,
        rounds=asked.rounds,
    )
    plan = evaluation_plan(options)
    trained = train(Histories(asked.histories), asked.seed)
    facts = {
        "identifier": NAME,
        "checkpoint": None,
        "sha256": None,
        "pairs_trained": trained.pairs,
    }
    made = Evaluated(NAME, partial(NeuralPosterior, trained=trained), None, facts)
    rows = [*plan.attributes["identifiers"], {"label": NAME, **facts}]
    attributes = {**plan.attributes, "identifiers": rows}
    carry_out(replace(plan, evaluated=[*plan.evaluated, made], attributes=attributes), options)
    provenance.write(asked.out)


if __name__ == "__main__":
    main()
