"""Sizes of the SysID transformer, and the constants that its answer is read off with. Needs no torch."""

import math
from dataclasses import dataclass

from capture_cli.errors import OptionError, did_you_mean

TOKENS = ("trajectory", "step")
DEFAULT_TOKENS = TOKENS[0]  # of identifiers that may have either


@dataclass(frozen=True)
class ArchitectureSettings:
    overshoot: float = 1.1  # of tanh, cut off afterwards: a bound can be reached without saturating
    # bounds of the predicted standard deviations, in the unit cube
    smallest_sd: float = 1e-4
    largest_sd: float = 1.0
    first_sd: float = 0.3  # about that of a uniform draw, where training begins

    @property
    def log_sds(self) -> tuple[float, float, float]:
        """The logarithms of the bounds, and what a sigmoid between them is given for the first one."""
        low, high, first = (math.log(sd) for sd in (self.smallest_sd, self.largest_sd, self.first_sd))
        return low, high, math.log((first - low) / (high - first))


SETTINGS = ArchitectureSettings()


@dataclass(frozen=True)
class Architecture:
    """Sizes. window: rounds that it sees. residual: predicts what to add to the last round's parameters."""

    parameters: int
    actions: int
    points: int
    features: int
    tokens: str = DEFAULT_TOKENS
    window: int = 4
    width: int = 128
    layers: int = 3
    heads: int = 4
    dropout: float = 0.0
    residual: bool = False

    def __post_init__(self):
        if self.tokens not in TOKENS:
            raise OptionError(f"--tokens {self.tokens!r}", cure=did_you_mean(self.tokens, TOKENS))
        if self.heads < 1 or self.width % self.heads:
            raise OptionError(
                f"--width {self.width} is not a multiple of --heads {self.heads}",
                cure="the heads share the width evenly: choose, say, 128 and 4",
            )

    @property
    def states(self) -> int:
        """Tokens of one trajectory."""
        return self.points if self.tokens == "step" else 1

    @property
    def round_tokens(self) -> int:
        """Tokens of one round."""
        return 2 + 2 * self.states

    @property
    def weight_shapes(self) -> dict[str, tuple[int, ...]]:
        """Of every weight of the network, by name."""
        state = self.points * self.features // self.states
        width, size = self.width, self.parameters
        linear = {
            "embed_parameters": (size, width),
            "embed_action": (self.actions, width),
            "embed_simulated": (state, width),
            "embed_measured": (state if self.tokens == "step" else 3 * state, width),
            "mean_head": (width, size),
            "spread_head.0": (width, width),
            "spread_head.2": (width, size * (size + 1) // 2),
        }
        norms = ["last_norm"]
        for block in (f"blocks.{k}." for k in range(self.layers)):
            linear[f"{block}query_key_value"] = (width, 3 * width)
            linear[f"{block}attention_out"] = (width, width)
            linear[f"{block}perceptron_in"] = (width, 4 * width)
            linear[f"{block}perceptron_out"] = (4 * width, width)
            norms += [f"{block}before_attention", f"{block}before_perceptron"]
        shapes: dict[str, tuple[int, ...]] = {
            "round_embedding.weight": (self.window, width),
            "place_embedding.weight": (self.round_tokens, width),
        }
        for name, (into, out) in linear.items():
            shapes |= {f"{name}.weight": (out, into), f"{name}.bias": (out,)}
        for name in norms:
            shapes |= {f"{name}.weight": (width,), f"{name}.bias": (width,)}
        return shapes
