"""Gauss-Newton through the simulator over all rounds so far, with a Gaussian as prior: a maximum a posteriori fit.

The prior is what a transformer says of the target. The noise is estimated from what the fit leaves, so the two are
weighed by their uncertainty: while the trajectories still disagree the prior holds the step back, and as they come to
agree it counts only in directions that no round has told anything about. A pair whose rounds still disagree when its
descent has ended is a noisy one: from then on it is not descended but regressed (`_cloud`).

Simulations are spared. Each round keeps the point it was linearised at and its sensitivities; whatever is simulated
later corrects them (Broyden's update), fresh finite differences are taken for the newest round, and for the round whose
prediction failed most. A pair whose newest round shows no residual is left alone.
"""

from dataclasses import dataclass

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.context.identifiers._cloud import SETTINGS as CLOUD
from capture_cli.context.identifiers._cloud import Cloud, improve
from capture_cli.context.identifiers._learned import Prediction
from capture_cli.context.identifiers.base import Rounds, Signature, Simulate, finite
from capture_cli.estimate.solve.linearization import box_step


@frozen
class SETTINGS:
    shortest_step: float = 1e-3  # of the range, a finite difference; longer where the task says so
    no_sensitivity: float = 1e-9  # of a feature's scale over the range: rounding
    floor: float = 3e-5  # of a feature's scale: residuals below this are no residuals
    noisy: float = 2e-3  # likewise: a descent that leaves more of most rounds ended in noise
    noisy_rounds: int = 3  # at least, for it to be noise
    trials: int = 8  # points at most that are tried in a round, of each pair
    rough_trials: int = 1  # where an exact fit follows the rounds
    surprise: float = 2.0  # times what is left of the rounds before, is more than they would lead to expect
    failures: int = 2  # of these that were no better, at most
    # points, where a direction is open by more than this share of the range
    screened: int = 8
    open: float = 0.05
    most_unknown: int = 3  # rounds of a pair whose sensitivities are taken at once
    longest_step: float = 0.35  # of the range
    small_step: float = 0.2  # of the posterior standard deviation: a shorter step is taken without a trial
    # of the residual, taken for noise while stepping
    first_easing: float = 0.2
    least_easing: float = 0.01
    most_easing: float = 3.0
    # of the decrease that was predicted
    poor_gain: float = 0.25
    good_gain: float = 0.75
    largest_sd: float = 0.5  # of the range, of a prior
    tails: float = 3.0  # degrees of freedom of a prior: sure of itself, it may still be wrong


@dataclass
class _Pair:
    """What is known of one pair. Parameters are in the unit cube, trajectories over the features' scales, flat (d,).

    x: the estimate. rounds: actions and measured (round, ...). points (round, p): where each round was last simulated,
    with the outputs there, and sensitivities (round, d, p), NaN where none were taken.
    noise (round,): standard deviation of each round's residual, as the last step took it; at least `easing` of it.
    covariance (p, p): of the estimate's error. cloud: what a noisy pair is fitted by.
    """

    x: np.ndarray
    actions: np.ndarray
    measured: np.ndarray
    points: np.ndarray
    outputs: np.ndarray
    sensitivities: np.ndarray
    easing: float = SETTINGS.first_easing
    noise: np.ndarray | None = None
    covariance: np.ndarray | None = None
    cloud: Cloud | None = None


class Refinement:
    """Refines the estimates of `pairs` pairs, round by round. rollouts (pair,): what it has simulated for each.

    rough: a fit of all rounds follows, so that fewer points are tried, and a round that is no surprise is not looked
    around from, nor is noise told from what is missing.
    """

    def __init__(self, signature: Signature, pairs: int, simulate: Simulate, *, rough: bool = False):
        self.signature = signature
        self.simulate = simulate
        self.rough = rough
        self.rollouts = np.zeros(pairs, dtype=np.int64)
        points, features = signature.trajectory_shape
        self._steps = np.maximum(SETTINGS.shortest_step, signature.space.steps)
        self._scale = np.tile([f.scale for f in signature.features], points)
        size, d = len(signature.space), points * features
        self._pairs = [
            _Pair(
                x=np.full(size, np.nan),
                actions=np.zeros((0, len(signature.actions))),
                measured=np.zeros((0, d)),
                points=np.zeros((0, size)),
                outputs=np.zeros((0, d)),
                sensitivities=np.zeros((0, d, size)),
            )
            for _ in range(pairs)
        ]

    def refine(self, prior: Prediction, asked, actions, simulated, measured) -> Prediction:
        """The estimate after one more round, and its covariance; each (pair, ...), in the task's units."""
        space = self.signature.space
        means = space.to_unit(prior.mean)
        precisions = [_precision(c / np.outer(space.span, space.span)) for c in prior.covariance]
        self._append(space.to_unit(asked), actions, self._flat(simulated), self._flat(measured))
        opened = self._open()
        self._begin(means, precisions)
        self._differentiate([(k, i) for k, p in opened for i in _unknown(p)])
        self._descend(means, precisions)
        for k, p in opened:
            self._settle(p, means[k], precisions[k])
        for k, p in enumerate(self._pairs):
            if p.cloud is None:
                p.covariance = self._covariance(p, _at_distance(precisions[k], p.x - means[k]))
        if not self.rough:
            self._regress()
        x, covariance = (np.stack([getattr(p, name) for p in self._pairs]) for name in ("x", "covariance"))
        return Prediction(space.from_unit(x), covariance * np.outer(space.span, space.span))

    def question(self, estimate: np.ndarray) -> np.ndarray:
        """What to ask for next (pair, parameter): the estimate, where the next step begins."""
        return estimate

    def recall(self, earlier: Rounds) -> None:
        """Take up the rounds that were made before, with sensitivities at the last of their points."""
        for n in range(earlier.rounds):
            asked = self.signature.space.to_unit(earlier.parameters[:, n])
            simulated, measured = self._flat(earlier.simulated[:, n]), self._flat(earlier.measured[:, n])
            self._append(asked, earlier.actions[:, n], simulated, measured)
        self._differentiate([(k, n) for k in range(len(self._pairs)) for n in range(earlier.rounds)])

    # --- a new round ---

    def _append(self, asked, actions, simulated, measured) -> None:
        for k, p in enumerate(self._pairs):
            p.x = asked[k]
            p.actions = np.concatenate([p.actions, actions[k, None]])
            p.measured = np.concatenate([p.measured, measured[k, None]])
            p.points = np.concatenate([p.points, asked[k, None]])
            p.outputs = np.concatenate([p.outputs, simulated[k, None]])
            unknown = np.full((1, *p.sensitivities.shape[1:]), np.nan)
            p.sensitivities = np.concatenate([p.sensitivities, unknown])

    def _open(self) -> list[tuple[int, _Pair]]:
        """Pairs whose newest round leaves a residual, but those known to be noisy."""
        descended = [(k, p) for k, p in enumerate(self._pairs) if p.cloud is None]
        return [(k, p) for k, p in descended if _rms(p.measured[-1] - p.outputs[-1]) > SETTINGS.floor]

    def _begin(self, means: np.ndarray, precisions: list[np.ndarray]) -> None:
        """Open pairs begin where the newest round is explained best: at what they had, at the prior's mean, or at one
        of a few points that the rounds before have left open.

        A contact that no round had shown may turn up far from what the prior believed of it: further than a descent
        from there would find.
        """
        tried = []
        for k, p in self._open():
            if self.rough and not self._is_surprise(p):
                continue
            newest = len(p.points) - 1
            open_to = self._left_open(p) if newest else _spread_out(means[k], precisions[k], seed=0)
            points = [means[k], *open_to]
            tried += [(k, [newest], x) for x in points]
        best: dict[int, tuple[float, np.ndarray, np.ndarray]] = {}
        for (k, _, x), outputs in zip(tried, self._outputs(tried), strict=True):
            p = self._pairs[k]
            at_hand = _cost(p.measured[-1] - p.outputs[-1]) if len(p.points) > 1 else np.inf
            cost = _cost(p.measured[-1] - outputs[0])
            if cost < best.get(k, (at_hand,))[0]:
                best[k] = (cost, x, outputs[0])
        for k, (_, x, outputs) in best.items():
            p = self._pairs[k]
            if len(p.points) == 1:
                p.x, p.points[0], p.outputs[0] = x, x, outputs
        again = [(k, list(range(len(self._pairs[k].points))), x) for k, (_, x, _) in best.items()]
        again = [(k, rows, x) for k, rows, x in again if len(rows) > 1]
        for (k, _, x), outputs in zip(again, self._outputs(again), strict=True):
            p = self._pairs[k]
            if _cost(p.measured - outputs) < _cost(self._linearised(p)[0]):
                p.x, p.outputs = x, outputs
                p.points = np.repeat(x[None], len(outputs), axis=0)
                p.easing = SETTINGS.first_easing

    def _is_surprise(self, p: _Pair) -> bool:
        """Whether the newest round leaves more than the rounds before it do."""
        residual, _ = self._linearised(p)
        return len(residual) == 1 or _rms(residual[-1]) > SETTINGS.surprise * _rms(residual[:-1])

    def _left_open(self, p: _Pair) -> list[np.ndarray]:
        """Points (p,) about the estimate, as far off in each direction as the rounds before the newest let them."""
        residual, j = self._linearised(p)
        information = _information(j[:-1], np.maximum(SETTINGS.floor, self._spread(residual[:-1])))
        return _spread_out(p.x, information, seed=len(p.points))

    # --- the descent ---

    def _descend(self, means: np.ndarray, precisions: list[np.ndarray]) -> None:
        """Try Gauss-Newton steps of all open pairs at once, until each is done or has had its trials."""
        running = {k: SETTINGS.failures for k, _ in self._open()}
        for _ in range(SETTINGS.rough_trials if self.rough else SETTINGS.trials):
            trials = []
            for k in running:
                p = self._pairs[k]
                precision = _at_distance(precisions[k], p.x - means[k])
                x, worth = self._step(p, means[k], precision)
                if worth:
                    trials.append((k, list(range(len(p.points))), x))
                else:
                    p.x = x
            failed = []
            running = {k: running[k] for k, _, _ in trials}
            for (k, _, x), outputs in zip(trials, self._outputs(trials), strict=True):
                p = self._pairs[k]
                precision = _at_distance(precisions[k], p.x - means[k])
                worst = self._judge(p, x, outputs, means[k], precision)
                if worst is not None:
                    running[k] -= 1
                    failed.append((k, worst))
                if not running[k] or _rms(p.measured - p.outputs) <= SETTINGS.floor:
                    del running[k]
            self._differentiate([(k, worst) for k, worst in failed if k in running])

    def _step(
        self, p: _Pair, mean: np.ndarray, precision: np.ndarray, longest: float = SETTINGS.longest_step
    ) -> tuple[np.ndarray, bool]:
        """Where the linearised rounds and the prior want to go, and whether to try it before believing it."""
        residual, j = self._linearised(p)
        low, high = np.maximum(-p.x, -longest), np.minimum(1 - p.x, longest)
        p.noise = np.maximum(SETTINGS.floor, p.easing * self._spread(residual))
        for _ in range(2):  # what the first step would leave is noise to the second
            hessian = _information(j, p.noise) + precision
            pull = np.einsum("n,ndp,nd->p", p.noise**-2.0, j, residual) + precision @ (mean - p.x)
            step = box_step(hessian, pull, low, high)
            p.noise = np.maximum(p.noise, self._spread(residual - j @ step))
        curvature = _information(j, np.maximum(SETTINGS.floor, self._spread(residual))) + precision
        return np.clip(p.x + step, 0, 1), float(np.sqrt(step @ curvature @ step)) > SETTINGS.small_step

    def _judge(self, p: _Pair, x, outputs, mean, precision) -> int | None:
        """Take the trial at x if it is better, learn from it in any case; returns the round that needs fresh
        sensitivities, if one does.
        """
        residual, j = self._linearised(p)
        predicted, left = residual - j @ (x - p.x), p.measured - outputs

        def cost(residual: np.ndarray, at: np.ndarray) -> float:
            return float(
                (np.square(residual).sum(axis=1) / p.noise**2).sum() + (at - mean) @ precision @ (at - mean)
            )

        before = cost(residual, p.x)
        gained = before - cost(left, x)
        gain = gained / max(before - cost(predicted, x), 1e-300)
        missed = np.square(left - predicted).sum(axis=1) / p.noise**2
        known = ~np.isnan(p.sensitivities[:, 0, 0])
        for i in np.flatnonzero(known):
            p.sensitivities[i] = _corrected(p.sensitivities[i], x - p.points[i], outputs[i] - p.outputs[i])
        if gained > 0:
            p.x, p.outputs = x, outputs
            p.points = np.repeat(x[None], len(outputs), axis=0)
        if gain < SETTINGS.poor_gain:
            p.easing = min(SETTINGS.most_easing, 3 * p.easing)
        elif gain > SETTINGS.good_gain:
            p.easing = max(SETTINGS.least_easing, p.easing / 3)
        return int(np.argmax(missed)) if gain < SETTINGS.poor_gain else None

    def _settle(self, p: _Pair, mean: np.ndarray, precision: np.ndarray) -> None:
        """Where nothing is left to explain, directions that no round shows go to the prior."""
        x, _ = self._step(p, mean, precision, longest=1.0)
        residual, j = self._linearised(p)
        if _rms(residual - j @ (x - p.x)) <= max(SETTINGS.floor, _rms(residual)):
            p.x = x

    def _linearised(self, p: _Pair) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (round, d) at the estimate, as far as known, and sensitivities, 0 where there are none."""
        j = np.nan_to_num(p.sensitivities, nan=0.0)
        return p.measured - p.outputs - np.einsum("ndp,np->nd", j, p.x - p.points), j

    def _spread(self, residual: np.ndarray) -> np.ndarray:
        """Standard deviation of what a fit leaves of each round, (round,), from residuals (round, d)."""
        free = max(1, residual.size - len(self.signature.space))
        return np.sqrt(np.square(residual).mean(axis=1) * residual.size / free)

    def _covariance(self, p: _Pair, precision: np.ndarray) -> np.ndarray:
        """Of the estimate's error (p, p): widened where rounds disagree by more than independent noise would let them.

        What is left of a trajectory is alike along it, so that a round counts for less than its number of values: the
        spread of the rounds' gradients tells (Liang and Zeger 1986).
        """
        residual, j = self._linearised(p)
        noise = np.maximum(CLOUD.roughness, self._spread(residual))
        inverse = np.linalg.inv(_information(j, noise) + precision)
        rounds = len(residual)
        if rounds == 1:
            return inverse
        gradients = np.einsum("ndp,nd->np", j, residual) / noise[:, None] ** 2
        meat = rounds / (rounds - 1) * gradients.T @ gradients + precision
        wider = np.sqrt(np.maximum(1.0, np.diag(inverse @ meat @ inverse) / np.diag(inverse)))
        return inverse * np.outer(wider, wider)

    # --- noisy pairs ---

    def _regress(self) -> None:
        """Pairs whose descent left more than roughness of most rounds get a cloud, about where it ended; those that
        have one are fitted by it.
        """
        for _, p in self._open():
            residual, _ = self._linearised(p)
            if len(residual) >= SETTINGS.noisy_rounds and np.median(_rms(residual, axis=1)) > SETTINGS.noisy:
                p.cloud = Cloud.about(p.x, p.covariance, residual.shape[1])
        clouds = {k: p.cloud for k, p in enumerate(self._pairs) if p.cloud}
        measured = {k: self._pairs[k].measured for k in clouds}
        improve(clouds, measured, self._outputs, len(self.signature.features))
        for k, cloud in clouds.items():
            self._pairs[k].x, self._pairs[k].covariance = cloud.mean, cloud.covariance

    # --- simulations ---

    def _differentiate(self, wanted: list[tuple[int, int]]) -> None:
        """Fresh sensitivities of (pair, round), at the estimate of the pair."""
        size = len(self.signature.space)
        tried = []
        for k, i in wanted:
            x = self._pairs[k].x
            inward = np.where(x > 0.5, -self._steps, self._steps)
            known = np.array_equal(self._pairs[k].points[i], x)
            tried += [(k, [i], x + inward * np.eye(size)[c]) for c in range(size)]
            tried += [] if known else [(k, [i], x)]
        results = iter(self._outputs(tried))
        for k, i in wanted:
            p = self._pairs[k]
            moved = np.stack([next(results)[0] for _ in range(size)], axis=-1)
            if not np.array_equal(p.points[i], p.x):
                p.points[i], p.outputs[i] = p.x, next(results)[0]
            p.sensitivities[i] = (moved - p.outputs[i][:, None]) / np.where(
                p.x > 0.5, -self._steps, self._steps
            )

    def _outputs(self, wanted: list[tuple[int, list[int], np.ndarray]]) -> list[np.ndarray]:
        """What (pair, rounds, x) would show, each (round, d); in one batch."""
        if not wanted:
            return []
        counts = [len(rows) for _, rows, _ in wanted]
        parameters = np.concatenate([np.repeat(x[None], len(rows), axis=0) for _, rows, x in wanted])
        actions = np.concatenate([self._pairs[k].actions[rows] for k, rows, _ in wanted])
        outputs = self._flat(finite(*self.simulate(self.signature.space.from_unit(parameters), actions)))
        np.add.at(self.rollouts, [k for k, _, _ in wanted], counts)
        return np.split(outputs, np.cumsum(counts)[:-1])

    def _flat(self, trajectories: np.ndarray) -> np.ndarray:
        """(n, point, feature) over the scales, (n, d)."""
        return trajectories.reshape(len(trajectories), -1) / self._scale


def _corrected(j: np.ndarray, move: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Sensitivities (d, p) that give the change (d,) of the outputs over the move (p,): Broyden's update.

    What an output did not depend on at all it is not said to depend on now (Schubert 1970): a wall that was not hit
    would else seem to be known.
    """
    moved = np.where(np.abs(j) > SETTINGS.no_sensitivity, move, 0.0)
    length = np.square(moved).sum(axis=1)
    off = np.where(length > SETTINGS.shortest_step**2, change - j @ move, 0.0)
    return j + off[:, None] * moved / np.maximum(length, SETTINGS.shortest_step**2)[:, None]


def _information(j: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Of sensitivities (round, d, p) to outputs with that noise (round,): (p, p)."""
    return np.einsum("n,ndp,ndq->pq", noise**-2.0, j, j)


def _precision(covariance: np.ndarray) -> np.ndarray:
    """Inverse of a covariance (p, p) in the unit cube, its spread in any direction at most `largest_sd`."""
    values, vectors = np.linalg.eigh(covariance)
    return (vectors / np.clip(values, SETTINGS.floor**2, SETTINGS.largest_sd**2)) @ vectors.T


def _spread_out(x: np.ndarray, information: np.ndarray, seed: int) -> list[np.ndarray]:
    """`screened` points of the unit cube about x (p,), two standard deviations off at most; none where that is near."""
    values, directions = np.linalg.eigh(information)
    reach = np.minimum(2 / np.sqrt(np.maximum(values, 1e-12)), 1.0)
    if reach.max() < SETTINGS.open:
        return []
    generator = np.random.default_rng(seed)
    strata = np.array([generator.permutation(SETTINGS.screened) for _ in reach]) + 0.5
    off = directions @ (reach[:, None] * (2 * strata / SETTINGS.screened - 1))
    return list(np.clip(x + off.T, 0, 1))


def _at_distance(precision: np.ndarray, off: np.ndarray) -> np.ndarray:
    """The precision (p, p) of a Student t where one is `off` its mean (p,): it gives way to what is far from it."""
    return precision * min(1.0, (SETTINGS.tails + len(off)) / (SETTINGS.tails + off @ precision @ off))


def _unknown(p: _Pair) -> np.ndarray:
    """The newest rounds without sensitivities: this one, and those that showed no residual when they were new."""
    return np.flatnonzero(np.isnan(p.sensitivities[:, 0, 0]))[-SETTINGS.most_unknown :]


def _cost(residual: np.ndarray) -> float:
    return float(np.square(residual).sum())


def _rms(residual: np.ndarray, axis: int | None = None) -> np.ndarray:
    return np.sqrt(np.square(residual).mean(axis=axis))
