"""Inference in numpy: the answer of the torch network that was trained, for every shape of one; and no torch."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the extra learn")

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_cli.context.identifiers._architecture import TOKENS, Architecture
from capture_cli.context.identifiers._inference import answer
from capture_cli.context.identifiers._transformer import Inputs, Transformer


def _network(architecture: Architecture, seed: int) -> Transformer:
    """Random weights of a size at which every part of the network matters."""
    torch.manual_seed(seed)
    transformer = Transformer(architecture).eval()
    with torch.no_grad():
        for weight in transformer.parameters():
            weight.add_(0.15 * torch.randn_like(weight))
    return transformer


def _inputs(a: Architecture, batch: int, rounds: int, seed: int) -> dict[str, np.ndarray]:
    generator = np.random.default_rng(seed)
    sizes = {
        "parameters": (a.parameters,),
        "actions": (a.actions,),
        "simulated": (a.points, a.features),
        "measured": (a.points, a.features),
        "residual": (a.points, 2 * a.features),
    }
    return {n: generator.normal(size=(batch, rounds, *s)).astype(np.float32) for n, s in sizes.items()}


@settings(max_examples=25, deadline=None)
@given(
    tokens=st.sampled_from(TOKENS),
    residual=st.booleans(),
    parameters=st.integers(1, 5),
    features=st.integers(1, 2),
    layers=st.integers(1, 3),
    heads=st.sampled_from([1, 2, 4]),
    rounds=st.integers(1, 4),
    seed=st.integers(0, 1000),
)
def test_numpy_and_torch_agree(tokens, residual, parameters, features, layers, heads, rounds, seed):
    architecture = Architecture(
        parameters=parameters,
        actions=3,
        points=4,
        features=features,
        tokens=tokens,
        width=16,
        layers=layers,
        heads=heads,
        residual=residual,
    )
    transformer = _network(architecture, seed)
    weights = {name: weight.numpy() for name, weight in transformer.state_dict().items()}
    assert {name: w.shape for name, w in weights.items()} == architecture.weight_shapes
    inputs = _inputs(architecture, 3, rounds, seed)
    with torch.inference_mode():
        expected = transformer(Inputs(**{k: torch.from_numpy(v) for k, v in inputs.items()}))
    mean, whitening = answer(architecture, weights, inputs)
    assert mean == pytest.approx(expected.mean[:, -1].numpy(), abs=1e-5)
    theirs = expected.whitening[:, -1].numpy()
    # a whitening holds the inverses of standard deviations: large ones differ by as many digits
    assert whitening == pytest.approx(theirs, rel=1e-4, abs=1e-5 * np.abs(theirs).max())


def test_a_checkpoint_is_read_without_torch():
    code = (
        "import sys; import capture_cli.context.checkpoints.identifier_checkpoint; "
        "import capture_cli.context.identifiers._learned; "
        "import capture_cli.context.identifiers.capture, capture_cli.context.identifiers.posterior; "
        "sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
