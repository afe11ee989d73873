"""Identifiers of whole logs, judged round by round: after every round they fit all that was measured so far."""

from collections import deque

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.context.identifiers.base import RoundIdentifier, finite
from capture_cli.estimate.solve.base import Identifier
from capture_cli.estimate.solve.linearization import Data, Trial


@frozen
class SETTINGS:
    weight_sd: float = 1e-3  # of a feature's scale: what weighs features against each other
    effort: int = 20  # ask / tell of the fit in a round, at most
    remembered: int = 10  # rounds that are fitted: more cost more, and ten actions tell what can be told
    screened_rounds: int = 2  # first rounds, in which a fit begins at several places


class Refitted(RoundIdentifier):
    """Drives `method` in rounds: each pair has its own fit, resumed where it stood, or from the last best.

    The simulations of all pairs are run together.
    """

    method: type[Identifier]
    simulates = True

    def __init__(self, signature, start, **options):
        super().__init__(signature, start, **options)
        if self.simulate is None:
            raise ValueError(f"{type(self).__name__} runs simulations of its own: give it `simulate`")
        self.round = 0
        self.noise_sd = SETTINGS.weight_sd * np.array([f.scale for f in signature.features])
        self._actions: deque[np.ndarray] = deque(maxlen=SETTINGS.remembered)
        self._measured: deque[np.ndarray] = deque(maxlen=SETTINGS.remembered)
        self._fits: list[Identifier | None] = [None] * len(self.start)

    def tell(self, actions, simulated, measured) -> None:
        self.round += 1
        self._actions.append(actions)
        self._measured.append(measured)
        actions, measured = np.stack(self._actions, axis=1), np.stack(self._measured, axis=1)
        fits = self._fits = [self._fit(pair, measured[pair]) for pair in range(len(measured))]
        while going := [pair for pair, fit in enumerate(fits) if not fit.done]:
            trials = [fits[pair].ask() for pair in going]
            answers = self._evaluate(trials, actions[going], going)
            for pair, answer in zip(going, answers, strict=True):
                fits[pair].tell(*answer)
                fits[pair].rounds_left -= 1
        self._best = self._best.copy()
        for pair, fit in enumerate(fits):
            if np.isfinite(fit.best.error):
                self._best[pair] = fit.best.parameters

    def _fit(self, pair: int, measured: np.ndarray) -> Identifier:
        """A fit to measured (episode, point, feature); there are no initial states to refine: an action fixes its
        own.
        """
        data = Data(
            self.space,
            measured,
            np.ones(measured.shape, dtype=bool),
            self.noise_sd,
            np.zeros((len(measured), 0)),
        )
        before = self._fits[pair]
        carried_on = None if before is None else before.carried_on(data, SETTINGS.effort)
        return carried_on or self.method(
            data,
            start=self._best[pair],
            seed=self.seed + pair,
            rounds=SETTINGS.effort,
            starts=3 if self.round <= SETTINGS.screened_rounds else 1,
        )

    def _evaluate(self, trials: list[Trial], actions: np.ndarray, pairs: list[int]):
        """What each pair's trial gives over its episodes, actions (pair, episode, action): all in one batch."""
        episodes = actions.shape[1]
        parameters = np.concatenate([np.repeat(t.parameters, episodes, axis=0) for t in trials])
        driven = np.concatenate([np.tile(a, (len(t), 1)) for t, a in zip(trials, actions, strict=True)])
        trajectories, diverged = self.simulate(parameters, driven)
        trajectories = finite(trajectories, diverged)
        first = 0
        for pair, trial in zip(pairs, trials, strict=True):
            rows = slice(first, first + len(trial) * episodes)
            first = rows.stop
            self.simulated_rollouts[pair] += len(trial) * episodes
            shape = (len(trial), episodes)
            yield trajectories[rows].reshape(*shape, *trajectories.shape[1:]), diverged[rows].reshape(shape)


def refitted(method: type[Identifier]) -> type[Refitted]:
    """The identifier `method`, which fits a whole log, as one that works in rounds."""
    return type(f"Refitted{method.__name__}", (Refitted,), {"method": method, "summary": method.summary})
