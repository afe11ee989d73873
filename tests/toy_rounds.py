"""A task without physics, for tests of learning: a closed-form trajectory, and histories of it by binary search."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from capture_cli.context.identifiers.base import Rounds, Signature
from capture_cli.model.parameters import Parameter, ParameterSpace
from capture_cli.model.tasks.base import Feature
from capture_cli.store.histories import HistoriesWriter

SIGNATURE = Signature(
    "toy",
    ParameterSpace(
        [Parameter("friction", "1", 0.03, 0.07, 0.05), Parameter("damping", "N s/m", -40, -3, -20)]
    ),
    ParameterSpace([Parameter("speed", "m/s", 0.3, 0.5, 0.4), Parameter("angle", "rad", -0.2, 0.2, 0.0)]),
    (Feature("x", "m", 0.5), Feature("y", "m", 0.5)),
    np.arange(1, 7) * 0.2,
)


def trajectories(parameters: np.ndarray, actions: np.ndarray) -> np.ndarray:
    """Parameters (n, parameter) and actions (n, action) to state trajectories (n, point, feature)."""
    friction, damping = SIGNATURE.space.to_unit(parameters).T[..., None]
    speed, angle = actions.T[..., None]
    t = SIGNATURE.point_times
    x = speed * t * (1 - 0.4 * friction * t)
    y = speed * np.sin(angle + 0.5) * (t + (0.5 - damping) * np.maximum(t - 0.6, 0)) + 0.05 * friction
    return np.stack([x, y], axis=-1)


def simulate(parameters: np.ndarray, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `Simulator.trajectories`."""
    return trajectories(parameters, actions), np.zeros(len(actions), dtype=bool)


def draw_actions(generator: np.random.Generator, count: int) -> np.ndarray:
    """(count, action), uniform."""
    return SIGNATURE.actions.from_unit(generator.random((count, len(SIGNATURE.actions))))


def histories(pairs: int, rounds: int = 5, seed: int = 0) -> Rounds:
    """Randomised binary search from random sources to random targets (paper, Algorithm 1)."""
    generator = np.random.default_rng(seed)
    size = len(SIGNATURE.space)
    low, high = np.zeros((pairs, size)), np.ones((pairs, size))
    now, target = generator.random((2, pairs, size))
    walk = []
    for _ in range(rounds - 1):
        walk.append(now)
        low, high = np.where(now < target, now, low), np.where(now < target, high, now)
        now = low + generator.beta(5, 5, (pairs, size)) * (high - low)
    parameters = SIGNATURE.space.from_unit(np.stack([*walk, target], axis=1))
    truth = SIGNATURE.space.from_unit(target)
    actions = draw_actions(generator, pairs * rounds)
    both = [parameters.reshape(pairs * rounds, size), np.repeat(truth, rounds, axis=0)]
    shape = (pairs, rounds, *SIGNATURE.trajectory_shape)
    simulated, measured = (trajectories(p, actions).reshape(shape) for p in both)
    return Rounds(parameters, actions.reshape(pairs, rounds, -1), simulated, measured, truth)


def write(rounds: Rounds, location: Path, **attributes) -> Path:
    """`rounds` as a store of histories at `location`; `attributes` replace those of the toy."""
    pairs, count = rounds.parameters.shape[:2]
    boxes = {
        name: [{"name": p.name, "unit": p.unit, "low": p.low, "high": p.high} for p in space]
        for name, space in (("parameters", SIGNATURE.space), ("actions", SIGNATURE.actions))
    }
    writer = HistoriesWriter(str(location))
    writer.create(
        {
            **{name: "" for name in ("model", "mujoco")},
            **{"library": None, "search": "randomized-binary", "alpha": 5.0, "seed": 0},
            **{"effects": [], "noise": "none", "noise_sd": {}, "policy": {"name": "random", "sha256": None}},
            "task": SIGNATURE.task,
            **boxes,
            "features": [vars(f) for f in SIGNATURE.features],
            "point_times": SIGNATURE.point_times.tolist(),
            "pairs": pairs,
            "shard_pairs": pairs,
            "rounds": count,
            **attributes,
        }
    )
    writer.write(0, vars(rounds))
    writer.finish()
    return location
