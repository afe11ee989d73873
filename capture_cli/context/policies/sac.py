"""Environment-conditioned Soft Actor-Critic (Haarnoja et al. 2018, arXiv:1801.01290; paper, Section III-B).

Trained by `capture_cli.context.policies._sac_training`; acting needs numpy only.
"""

from collections.abc import Mapping
from itertools import pairwise
from statistics import mode

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.common.named_arrays import check_shapes
from capture_cli.context.policies.base import Policy, Trainer
from capture_cli.model.effects.ranges import NO_EFFECTS


@frozen
class SETTINGS:
    block: int = 1024  # rows at once: bounds memory


class Sac(Policy):
    """The mean action of the trained actor: a network from the parameters' place in the unit cube to an action.

    Where the task has a mirror, half of the actions are those of a mirrored actor in a mirrored world. They are worth
    the same; but a Gaussian has one mode, so training settles for one side, and the other's parameters would never
    show. Effects may make the two sides differ: a policy that was trained with such does not do so.

    layers: (weights (out, in), biases (out,)) of each, with ReLU in between and tanh at the end, which makes it an
    action in [-1, 1] per component. mirrored: whether half of the actions are so; as the task has it where None.
    """

    summary = "Soft Actor-Critic, which knows the parameters; its most likely action"
    trained = True

    def __init__(self, task, layers, mirrored=None):
        super().__init__(task)
        self.mirrored = task.mirrored if mirrored is None else mirrored
        self.layers = [(np.asarray(w, dtype=float), np.asarray(b, dtype=float)) for w, b in layers]

    def act(self, parameters, uniform):
        if not self.mirrored:
            return self._best(parameters)
        turned = np.asarray(uniform)[:, :1] < 0.5
        seen = np.where(turned, self.task.mirror_parameters(parameters), parameters)
        actions = self._best(seen)
        return np.where(turned, self.task.mirror_actions(actions), actions)

    def state(self):
        arrays = {}
        for k, (weights, biases) in enumerate(self.layers):
            arrays |= {f"{k}.weight": np.float32(weights), f"{k}.bias": np.float32(biases)}
        return {"layers": len(self.layers), "mirrored": self.mirrored}, arrays

    @classmethod
    def weight_shapes(cls, settings, weights, parameters, actions):
        layers = settings.get("layers")
        if not isinstance(layers, int) or isinstance(layers, bool) or not 1 <= layers <= len(weights):
            raise ValueError(
                f"settings.layers is {layers!r:.40}, expected a whole number above 0, for {len(weights)} arrays"
            )
        sizes = [parameters, *(_width(k, weights) for k in range(layers - 1)), actions]
        shapes: dict[str, tuple[int, ...]] = {}
        for k, (into, out) in enumerate(pairwise(sizes)):
            shapes |= {f"{k}.bias": (out,), f"{k}.weight": (out, into)}
        return shapes

    @classmethod
    def from_state(cls, task, settings, weights):
        check_shapes(weights, cls.weight_shapes(settings, weights, len(task.space), len(task.actions)))
        layers = [(weights[f"{k}.weight"], weights[f"{k}.bias"]) for k in range(settings["layers"])]
        return cls(task, layers, task.mirrored and settings.get("mirrored", True))

    @classmethod
    def trainer(cls, simulator, settings, effects=NO_EFFECTS) -> Trainer:
        from capture_cli.context.policies._sac_training import SacTrainer

        return SacTrainer(simulator, settings, effects)

    def _best(self, parameters: np.ndarray) -> np.ndarray:
        """The actor's most likely actions (row, action)."""
        coordinates = self.task.space.to_unit(parameters)
        blocks = range(0, max(1, len(coordinates)), SETTINGS.block)
        chosen = np.concatenate([self._forward(coordinates[i : i + SETTINGS.block]) for i in blocks])
        return self.task.actions.from_unit((chosen + 1) / 2)

    def _forward(self, values: np.ndarray) -> np.ndarray:
        """Coordinates (row, parameter) to actions (row, action) in [-1, 1]."""
        for k, (weights, biases) in enumerate(self.layers):
            values = _affine(np.maximum(values, 0.0) if k else values, weights, biases)
        return np.tanh(values)


def _width(k: int, weights: Mapping[str, np.ndarray]) -> int:
    """Of layer k, by what most of the three arrays say that have it: that one of them is wrong is seen then."""
    own, biases, following = (
        np.shape(weights.get(n)) for n in (f"{k}.weight", f"{k}.bias", f"{k + 1}.weight")
    )
    said = (*own[:1], *biases[:1], *following[-1:])
    return mode(said) if said else 0


def _affine(values: np.ndarray, weights: np.ndarray, biases: np.ndarray) -> np.ndarray:
    """values (row, in) by weights (out, in), plus biases (out,); every row as if it were alone.

    Summed in a fixed order rather than by a matrix product, which rounds as the number of rows (and the processor)
    suggests: a history must not depend on the company it is made in.
    """
    total = np.repeat(biases[None], len(values), axis=0)
    for column, row in zip(values.T, weights.T, strict=True):
        total += column[:, None] * row
    return total
