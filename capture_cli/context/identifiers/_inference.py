"""The SysID transformer's answer in numpy: identification needs no torch, whose import takes longer than ten rounds.

The same network as `_transformer`, which has the architecture in words; only inference, in single precision.
"""

import math
from collections.abc import Mapping

import numpy as np

from capture_cli.context.identifiers._architecture import SETTINGS as ARCHITECTURE
from capture_cli.context.identifiers._architecture import Architecture

Arrays = Mapping[str, np.ndarray]


def answer(architecture: Architecture, network: Arrays, inputs: Arrays) -> tuple[np.ndarray, np.ndarray]:
    """What follows the last round of `inputs`: mean (batch, parameter), whitening (batch, parameter, parameter).

    network: the transformer's weights by name. inputs: arrays by the names of `_transformer.Inputs`.
    """
    stream = _tokens(architecture, network, inputs)
    for number in range(architecture.layers):
        stream = _block(network, f"blocks.{number}.", stream, architecture.heads)
    last = _norm(network, "last_norm", stream[:, -1])
    raw = ARCHITECTURE.overshoot * np.tanh(_linear(network, "mean_head", last))
    before = inputs["parameters"][:, -1]
    mean = (before + 1) / 2 + raw if architecture.residual else (1 + raw) / 2
    return mean.astype(float), _whitening(architecture.parameters, network, last).astype(float)


def _tokens(a: Architecture, network: Arrays, inputs: Arrays) -> np.ndarray:
    """(batch, round * round_tokens, width)."""
    batch, rounds = inputs["parameters"].shape[:2]
    shape = (batch, rounds, a.states, -1)
    measured = inputs["measured"].reshape(shape)
    if a.tokens == "trajectory":
        measured = np.concatenate([measured, inputs["residual"].reshape(shape)], axis=-1)
    tokens = np.concatenate(
        [
            _linear(network, "embed_parameters", inputs["parameters"])[:, :, None],
            _linear(network, "embed_action", inputs["actions"])[:, :, None],
            _linear(network, "embed_simulated", inputs["simulated"].reshape(shape)),
            _linear(network, "embed_measured", measured),
        ],
        axis=2,
    )
    tokens = tokens + network["round_embedding.weight"][:rounds, None] + network["place_embedding.weight"]
    return tokens.reshape(batch, rounds * a.round_tokens, a.width)


def _block(network: Arrays, name: str, stream: np.ndarray, heads: int) -> np.ndarray:
    stream = stream + _attend(network, name, _norm(network, f"{name}before_attention", stream), heads)
    hidden = _linear(network, f"{name}perceptron_in", _norm(network, f"{name}before_perceptron", stream))
    return stream + _linear(network, f"{name}perceptron_out", _gelu(hidden))


def _attend(network: Arrays, name: str, x: np.ndarray, heads: int) -> np.ndarray:
    batch, tokens, width = x.shape
    parts = _linear(network, f"{name}query_key_value", x).reshape(batch, tokens, 3, heads, width // heads)
    query, key, value = parts.transpose(2, 0, 3, 1, 4)
    scores = query @ key.swapaxes(-1, -2) / np.float32(math.sqrt(width // heads))
    scores = np.where(np.tri(tokens, dtype=bool), scores, np.float32(-np.inf))
    weights = np.exp(scores - scores.max(axis=-1, keepdims=True))
    weights /= weights.sum(axis=-1, keepdims=True)
    attended = (weights @ value).swapaxes(1, 2).reshape(batch, tokens, width)
    return _linear(network, f"{name}attention_out", attended)


def _whitening(size: int, network: Arrays, last: np.ndarray) -> np.ndarray:
    raw = _linear(network, "spread_head.2", _gelu(_linear(network, "spread_head.0", last)))
    low, high, first = ARCHITECTURE.log_sds
    log_sd = low + (high - low) / (1 + np.exp(-(raw[:, :size] + first)))
    whitening = np.zeros((len(raw), size, size), dtype=raw.dtype)
    whitening[:, np.arange(size), np.arange(size)] = np.exp(-log_sd)
    rows, columns = np.tril_indices(size, -1)
    whitening[:, rows, columns] = raw[:, size:] / np.exp(log_sd)[:, rows]
    return whitening


def _linear(network: Arrays, name: str, x: np.ndarray) -> np.ndarray:
    return x @ network[f"{name}.weight"].T + network[f"{name}.bias"]


def _norm(network: Arrays, name: str, x: np.ndarray) -> np.ndarray:
    centred = x - x.mean(axis=-1, keepdims=True)
    variance = np.square(centred).mean(axis=-1, keepdims=True)
    epsilon = 1e-5  # of a layer norm, as torch has it
    scaled = centred / np.sqrt(variance + np.float32(epsilon))
    return scaled * network[f"{name}.weight"] + network[f"{name}.bias"]


def _gelu(x: np.ndarray) -> np.ndarray:
    """Its tanh form (Hendrycks & Gimpel 2016)."""
    return x / 2 * (1 + np.tanh(np.float32(math.sqrt(2 / math.pi)) * (x + np.float32(0.044715) * x * x * x)))
