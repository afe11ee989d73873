"""Environment-conditioned Soft Actor-Critic (Haarnoja et al. 2018, arXiv:1801.01290; paper, Section III-B).

Trained by `capture_cli.policies._sac_training`; acting needs numpy only.
"""

from __future__ import annotations

import numpy as np

from capture_cli.policies.base import Policy, Trainer

BLOCK = 1024  # rows at once: bounds memory


class Sac(Policy):
    """The mean action of the trained actor: a network from the parameters' place in the unit cube to an action.

    Where the task has a mirror, half of the actions are those of a mirrored actor in a mirrored world. They are worth
    the same; but a Gaussian has one mode, so training settles for one side, and the other's parameters would never
    show.

    layers: (weights (out, in), biases (out,)) of each, with ReLU in between and tanh at the end, which makes it an
    action in [-1, 1] per component.
    """

    summary = "Soft Actor-Critic, which knows the parameters; its most likely action"
    trained = True

    def __init__(self, task, layers):
        super().__init__(task)
        self.layers = [(np.asarray(w, dtype=float), np.asarray(b, dtype=float)) for w, b in layers]

    def act(self, parameters, uniform):
        if not self.task.mirrored:
            return self._best(parameters)
        turned = np.asarray(uniform)[:, :1] < 0.5
        seen = np.where(turned, self.task.mirror_parameters(parameters), parameters)
        actions = self._best(seen)
        return np.where(turned, self.task.mirror_actions(actions), actions)

    def state(self):
        arrays = {}
        for k, (weights, biases) in enumerate(self.layers):
            arrays |= {f"{k}.weight": np.float32(weights), f"{k}.bias": np.float32(biases)}
        return {"layers": len(self.layers)}, arrays

    @classmethod
    def from_state(cls, task, settings, weights):
        layers = [(weights[f"{k}.weight"], weights[f"{k}.bias"]) for k in range(settings["layers"])]
        sizes = [len(task.space), *(len(b) for _, b in layers)]
        if sizes[-1] != len(task.actions) or any(
            w.shape != (len(b), size) for (w, b), size in zip(layers, sizes[:-1], strict=True)
        ):
            raise ValueError(f"layers of {[w.shape for w, _ in layers]} do not fit the task")
        return cls(task, layers)

    @classmethod
    def trainer(cls, simulator, settings) -> Trainer:
        from capture_cli.policies._sac_training import SacTrainer

        return SacTrainer(simulator, settings)

    def _best(self, parameters: np.ndarray) -> np.ndarray:
        """The actor's most likely actions (row, action)."""
        coordinates = self.task.space.to_unit(parameters)
        blocks = range(0, max(1, len(coordinates)), BLOCK)
        chosen = np.concatenate([self._forward(coordinates[i : i + BLOCK]) for i in blocks])
        return self.task.actions.from_unit((chosen + 1) / 2)

    def _forward(self, values: np.ndarray) -> np.ndarray:
        """Coordinates (row, parameter) to actions (row, action) in [-1, 1]."""
        for k, (weights, biases) in enumerate(self.layers):
            values = _affine(np.maximum(values, 0.0) if k else values, weights, biases)
        return np.tanh(values)


def _affine(values: np.ndarray, weights: np.ndarray, biases: np.ndarray) -> np.ndarray:
    """values (row, in) by weights (out, in), plus biases (out,); every row as if it were alone.

    Summed in a fixed order rather than by a matrix product, which rounds as the number of rows (and the processor)
    suggests: a history must not depend on the company it is made in.
    """
    total = np.repeat(biases[None], len(values), axis=0)
    for column, row in zip(values.T, weights.T, strict=True):
        total += column[:, None] * row
    return total
