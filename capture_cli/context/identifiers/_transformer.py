"""The SysID causal transformer (paper, Section III-D): GPT-2 blocks over the tokens of a window of rounds.

A round is the tokens (parameters, action, simulated trajectory, measured trajectory), in this order, so that what is
read off the last one has seen the whole round and those before it. `--tokens step` makes one token of every state of
a trajectory, 2 + 2 T a round, as in the paper; `--tokens trajectory` one of each trajectory, 4 a round. The second
also shows the residual to its measured token: the model need not learn to subtract.

Blocks are those of GPT-2 (Radford et al. 2019): layer norm first, causal attention, GELU, initialised at 0.02 with
the residual branches scaled down by sqrt(2 layers). Positions are embedded relative to the window: the round's number
in it, plus the token's place in the round.
"""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as functional
from torch import Tensor, nn

from capture_cli.context.identifiers._architecture import SETTINGS as ARCHITECTURE
from capture_cli.context.identifiers._architecture import Architecture


@dataclass(frozen=True)
class Inputs:
    """Normalised rounds: parameters and actions in [-1, 1], trajectories about 0 with spread 1.

    parameters (batch, round, parameter), actions (batch, round, action), simulated and measured (batch, round, point,
    feature), residual (batch, round, point, 2 feature): measured minus simulated, plain and companded.
    """

    parameters: Tensor
    actions: Tensor
    simulated: Tensor
    measured: Tensor
    residual: Tensor


@dataclass(frozen=True)
class Outputs:
    """mean (batch, round, parameter) in the unit cube; whitening (batch, round, parameter, parameter).

    whitening is lower triangular: whitening @ (truth - mean) has unit variance; (W'W)^-1 is the covariance.
    """

    mean: Tensor
    whitening: Tensor


class Block(nn.Module):
    """One GPT-2 block: attention, then a perceptron, each added to the stream (batch, token, width)."""

    def __init__(self, width: int, heads: int, dropout: float):
        super().__init__()
        self.heads = heads
        self.dropout = dropout
        self.before_attention = nn.LayerNorm(width)
        self.query_key_value = nn.Linear(width, 3 * width)
        self.attention_out = nn.Linear(width, width)
        self.before_perceptron = nn.LayerNorm(width)
        self.perceptron_in = nn.Linear(width, 4 * width)
        self.perceptron_out = nn.Linear(4 * width, width)

    def forward(self, stream: Tensor) -> Tensor:
        stream = stream + self._drop(self._attend(self.before_attention(stream)))
        hidden = functional.gelu(self.perceptron_in(self.before_perceptron(stream)), approximate="tanh")
        return stream + self._drop(self.perceptron_out(hidden))

    def _attend(self, x: Tensor) -> Tensor:
        batch, tokens, width = x.shape
        heads = self.query_key_value(x).view(batch, tokens, 3, self.heads, width // self.heads)
        query, key, value = heads.permute(2, 0, 3, 1, 4)
        attended = functional.scaled_dot_product_attention(
            query, key, value, is_causal=True, dropout_p=self.dropout if self.training else 0.0
        )
        return self.attention_out(attended.transpose(1, 2).reshape(batch, tokens, width))

    def _drop(self, x: Tensor) -> Tensor:
        return functional.dropout(x, self.dropout, self.training)


class Transformer(nn.Module):
    """Reads rounds, says for each what the parameters of the next one are, and how sure that is."""

    def __init__(self, architecture: Architecture):
        super().__init__()
        a = self.architecture = architecture
        self.embed_parameters = nn.Linear(a.parameters, a.width)
        self.embed_action = nn.Linear(a.actions, a.width)
        state = a.points * a.features // a.states
        self.embed_simulated = nn.Linear(state, a.width)
        self.embed_measured = nn.Linear(state if a.tokens == "step" else 3 * state, a.width)
        self.round_embedding = nn.Embedding(a.window, a.width)
        self.place_embedding = nn.Embedding(a.round_tokens, a.width)
        self.blocks = nn.ModuleList(Block(a.width, a.heads, a.dropout) for _ in range(a.layers))
        self.last_norm = nn.LayerNorm(a.width)
        self.mean_head = nn.Linear(a.width, a.parameters)
        self.spread_head = nn.Sequential(
            nn.Linear(a.width, a.width),
            nn.GELU(approximate="tanh"),
            nn.Linear(a.width, a.parameters * (a.parameters + 1) // 2),
        )
        self._initialise()

    def _initialise(self) -> None:
        initial_sd = 0.02
        for module in self.modules():
            if isinstance(module, nn.Linear | nn.Embedding):
                nn.init.normal_(module.weight, std=initial_sd)
            if isinstance(module, nn.Linear):
                nn.init.zeros_(module.bias)
        for block in self.blocks:
            for last in (block.attention_out, block.perceptron_out):
                nn.init.normal_(last.weight, std=initial_sd / math.sqrt(2 * len(self.blocks)))

    def forward(self, inputs: Inputs, *, own_spread: bool = True, low_precision: bool = False) -> Outputs:
        """What follows each round of `inputs`.

        own_spread: the uncertainty is read off without changing what the mean is read off (no gradient passes).
        low_precision: blocks compute in bfloat16. Rounds appended as padding do not change what precedes them.
        """
        stream = self._tokens(inputs)
        with torch.autocast(stream.device.type, dtype=torch.bfloat16, enabled=low_precision):
            for block in self.blocks:
                stream = block(stream)
        last = self.last_norm(stream.float())[
            :, self.architecture.round_tokens - 1 :: self.architecture.round_tokens
        ]
        return Outputs(self._mean(last, inputs), self._whitening(last.detach() if own_spread else last))

    def _tokens(self, inputs: Inputs) -> Tensor:
        """(batch, round * round_tokens, width)."""
        a = self.architecture
        batch, rounds = inputs.parameters.shape[:2]
        shape = (batch, rounds, a.states, -1)
        simulated, measured = inputs.simulated.reshape(shape), inputs.measured.reshape(shape)
        if a.tokens == "trajectory":
            measured = torch.cat([measured, inputs.residual.reshape(shape)], dim=-1)
        tokens = torch.cat(
            [
                self.embed_parameters(inputs.parameters)[:, :, None],
                self.embed_action(inputs.actions)[:, :, None],
                self.embed_simulated(simulated),
                self.embed_measured(measured),
            ],
            dim=2,
        )
        tokens = tokens + self.round_embedding.weight[:rounds, None] + self.place_embedding.weight
        return functional.dropout(tokens.flatten(1, 2), a.dropout, self.training)

    def _mean(self, last: Tensor, inputs: Inputs) -> Tensor:
        raw = ARCHITECTURE.overshoot * torch.tanh(self.mean_head(last))
        return (inputs.parameters + 1) / 2 + raw if self.architecture.residual else (1 + raw) / 2

    def _whitening(self, last: Tensor) -> Tensor:
        size = self.architecture.parameters
        raw = self.spread_head(last)
        # an sd is bounded smoothly, so that no gradient dies at a bound
        low, high, first = ARCHITECTURE.log_sds
        log_sd = low + (high - low) * torch.sigmoid(raw[..., :size] + first)
        diagonal = torch.diag_embed(torch.exp(-log_sd))
        rows, columns = torch.tril_indices(size, size, offset=-1, device=raw.device)
        below = torch.zeros_like(diagonal)
        # scaled by the row's own sd: correlations need not grow as the spread shrinks
        below[..., rows, columns] = raw[..., size:] / torch.exp(log_sd)[..., rows]
        return diagonal + below


def squared_error(outputs: Outputs, labels: Tensor) -> Tensor:
    """Mean squared error of the mean, per batch entry and round (batch, round); the paper's loss."""
    return (outputs.mean - labels).square().mean(dim=-1)


def negative_log_likelihood(outputs: Outputs, labels: Tensor, *, detach_mean: bool) -> Tensor:
    """Of labels under the Gaussian of mean and whitening, per parameter, without its constant (batch, round)."""
    mean = outputs.mean.detach() if detach_mean else outputs.mean
    scaled = (outputs.whitening @ (labels - mean)[..., None])[..., 0]
    log_diagonal = torch.diagonal(outputs.whitening, dim1=-2, dim2=-1).log()
    return (scaled.square() / 2 - log_diagonal).mean(dim=-1)
