"""COMPASS (Huang et al. 2023, CoRL, PMLR 229:734), with the full causal graph, as the paper compares it.

A network learns how the parameters cause the difference between simulated and measured trajectory, and the parameters
go down its gradient. With the full graph every parameter may act on every component, so that nothing is left of the
discovery of the graph but this network; no parameter here is one without effect. Ten simulations, spread around the
estimate, are compared with the one measured rollout of the round.
"""

import os
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.context.identifiers.base import RoundIdentifier


@frozen
class SETTINGS:
    width: int = 64
    # Of the network, each round: 1,000 is where it has converged. On 20 pairs of air hockey the error after ten rounds
    # is 0.068 of the range at 200, 0.026 at 1,000, 0.031 at 3,000; of scooping 0.010, 0.009 and, overfitted, 0.054.
    fit_steps: int = 1000
    fit_rate: float = 3e-3
    # of the parameters, in the unit cube
    descent_steps: int = 100
    descent_rate: float = 0.01
    remembered: int = 10  # rounds that the network is fitted to
    # standard deviation of the candidates, in the unit cube, by round
    first_spread: float = 0.2
    shrink: float = 0.9
    last_spread: float = 0.02


class Compass(RoundIdentifier):
    """One network for each pair, fitted anew to the last rounds; all pairs in one batch."""

    summary = "gradient search through a learned model of the differences, ten simulations a round"
    extra = "learn"
    candidates = 10
    settable = ("fit_steps",)

    def __init__(self, signature, start, *, fit_steps: int = SETTINGS.fit_steps, **options):
        super().__init__(signature, start, **options)
        self.settings = replace(SETTINGS, fit_steps=fit_steps)
        self.round = 0
        self._generator = np.random.default_rng(self.seed)
        self._candidates = self._spread_out()
        self._inputs: deque[np.ndarray] = deque(maxlen=SETTINGS.remembered)
        self._differences: deque[np.ndarray] = deque(maxlen=SETTINGS.remembered)

    def ask(self) -> np.ndarray:
        return self.space.from_unit(self._candidates)

    def tell(self, actions, simulated, measured) -> None:
        self.round += 1
        scale = np.array([f.scale for f in self.signature.features])
        difference = (simulated - measured[:, None]) / scale
        action = 2 * self.signature.actions.to_unit(actions) - 1
        action = np.repeat(action[:, None], self.candidates, axis=1)
        self._inputs.append(np.concatenate([2 * self._candidates - 1, action], axis=-1))
        self._differences.append(difference.reshape(*difference.shape[:2], -1))
        with _one_thread():
            self._best = self.space.from_unit(self._descend())
        self._candidates = self._spread_out()

    def _spread_out(self) -> np.ndarray:
        """The estimate, then draws around it (pair, candidate, parameter), in the unit cube."""
        s = self.settings
        sd = max(s.last_spread, s.first_spread * s.shrink**self.round)
        at = self.space.to_unit(self._best)[:, None]
        draws = self._generator.standard_normal((len(at), self.candidates - 1, len(self.space)))
        return np.clip(np.concatenate([at, at + sd * draws], axis=1), 0, 1)

    def _descend(self) -> np.ndarray:
        """The parameters (pair, parameter), in the unit cube, at which the network sees the least difference."""
        import torch

        inputs = torch.from_numpy(np.concatenate(self._inputs, axis=1)).float()
        differences = torch.from_numpy(np.concatenate(self._differences, axis=1)).float()
        spread = differences.square().mean(dim=(1, 2), keepdim=True).sqrt().clamp_min(1e-6)
        network = self._fitted(inputs, differences / spread)
        size = len(self.space)
        x = torch.from_numpy(2 * self.space.to_unit(self._best) - 1).float().requires_grad_()
        actions = inputs[:, :: self.candidates, size:]
        optimizer = torch.optim.Adam([x], lr=2 * self.settings.descent_rate)
        for _ in range(self.settings.descent_steps):
            asked = torch.cat([x[:, None].expand(-1, actions.shape[1], -1), actions], dim=-1)
            # a sum over pairs: each descends by itself
            loss = _forward(network, asked).square().mean(dim=(1, 2)).sum()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            with torch.no_grad():
                x.clamp_(-1, 1)
        return (x.detach().double().numpy() + 1) / 2

    def _fitted(self, inputs, differences):
        """Weights of a perceptron per pair, fitted to inputs (pair, sample, input) and their differences."""
        import torch

        generator = torch.Generator().manual_seed(self.seed)
        width = self.settings.width
        sizes = [inputs.shape[-1], width, width, differences.shape[-1]]
        network = []
        for before, after in pairwise(sizes):
            weight = torch.randn(before, after, generator=generator) * (2 / before) ** 0.5
            network.append(weight.repeat(len(inputs), 1, 1).requires_grad_())
            network.append(torch.zeros(len(inputs), 1, after, requires_grad=True))
        optimizer = torch.optim.Adam(network, lr=self.settings.fit_rate)
        for _ in range(self.settings.fit_steps):
            loss = (_forward(network, inputs) - differences).square().mean(dim=(1, 2)).sum()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        return [layer.detach() for layer in network]


@contextmanager
def _one_thread() -> Iterator[None]:
    """torch on one thread, whatever it had before: more of them gain nothing on such small batches, and take time from
    the simulations beside.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    import torch  # reads that setting

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _forward(network, x):
    """Perceptrons, one per pair, of x (pair, sample, input)."""
    import torch

    for i in range(0, len(network), 2):
        x = torch.baddbmm(network[i + 1], x, network[i])
        if i < len(network) - 2:
            x = torch.tanh(x)
    return x
