"""Identification in rounds (paper, Algorithm 2): what a round is, what proposes the next one, and the loop.

In a round of a pair the identifier asks for parameters, an action is chosen for them (by a policy, or it stands in a
log), one rollout under the action is measured and one per candidate is simulated, and the identifier is told both.
Methods are judged by the measured rollouts they spend: one a round. What they simulate is counted.
"""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import zip_longest
from operator import itemgetter
from typing import Any, Self

import numpy as np

from capture_cli.estimate.solve.base import AskTell
from capture_cli.model.parameters import Parameter, ParameterSpace
from capture_cli.model.tasks.base import ActionTask, Feature

# (parameters (simulation, parameter), actions (simulation, action)) -> trajectories (simulation, point, feature),
# diverged (simulation,): `Simulator.trajectories`
Simulate = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Signature:
    """What a round of a task is made of: names, units and ranges of its parameters, action and trajectory.

    point_times (point,): s after the start of an episode.
    """

    task: str
    space: ParameterSpace
    actions: ParameterSpace
    features: tuple[Feature, ...]
    point_times: np.ndarray

    @classmethod
    def of(cls, task: ActionTask) -> Self:
        """The signature of `task`."""
        return cls(task.name, task.space, task.actions, tuple(task.features), np.asarray(task.point_times))

    @property
    def trajectory_shape(self) -> tuple[int, int]:
        """(points, features) of a state trajectory."""
        return len(self.point_times), len(self.features)

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "task": self.task,
            "parameters": [asdict(p) for p in self.space],
            "actions": [asdict(p) for p in self.actions],
            "features": [asdict(f) for f in self.features],
            "point_times": [float(t) for t in self.point_times],
        }

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> Self:
        """What `document` wrote, or the attributes of histories: these have no nominal values."""
        keys = ("task", "parameters", "actions", "features", "point_times")
        task, parameters, actions, features, times = itemgetter(*keys)(document)
        spaces = (ParameterSpace([_parameter(**p) for p in rows]) for rows in (parameters, actions))
        return cls(task, *spaces, tuple(Feature(**f) for f in features), np.array(times, dtype=float))

    def differences(self, other: Self) -> list[str]:
        """How `other` differs, one line each: "the task 'a', and this is 'b'". Nominal values do not matter.

        Where the tasks differ nothing else needs to be said.
        """
        if self.task != other.task:
            return [f"the task {self.task!r}, and this is {other.task!r}"]
        lines = []
        for what in ("space", "actions"):
            mine, theirs = ([_range(p) for p in getattr(s, what)] for s in (self, other))
            lines += _unlike("parameters" if what == "space" else what, mine, theirs)
        mine, theirs = (
            [f"{f.name} ({f.unit}) of scale {f.scale:g}" for f in s.features] for s in (self, other)
        )
        lines += _unlike("features", mine, theirs)
        times = self.point_times, other.point_times
        if len(times[0]) != len(times[1]) or not np.allclose(*times, atol=1e-9):
            lines.append(f"points: {_times(times[0])}, and here {_times(times[1])}")
        return lines


def _unlike(what: str, mine: Sequence[str], theirs: Sequence[str]) -> list[str]:
    """The line that says in what two lists of names differ, the first `most_named`; none where they are the same."""
    pairs = [f"{a}, and here {b}" for a, b in zip_longest(mine, theirs, fillvalue="none") if a != b]
    most_named = 3  # differences of one kind
    more = f"; and {len(pairs) - most_named} more" if len(pairs) > most_named else ""
    return [f"{what}: {'; '.join(pairs[:most_named])}{more}"] if pairs else []


def _parameter(low: float, high: float, **others: Any) -> Parameter:
    return Parameter(**{"nominal": (low + high) / 2, **others}, low=low, high=high)


def _range(p: Parameter) -> str:
    return f"{p.name} [{p.low:g}, {p.high:g}] {p.unit}"


def _times(times: np.ndarray) -> str:
    return f"{len(times)} up to {times[-1]:g} s" if len(times) else "none"


ARRAYS = ("parameters", "actions", "simulated", "measured")  # of rounds, all (pair, round, ...)


@dataclass(frozen=True)
class Rounds:
    """The rounds of many pairs, in the units of the task.

    parameters (pair, round, parameter), actions (pair, round, action), simulated and measured (pair, round, point,
    feature), target (pair, parameter) where it is known.
    """

    parameters: np.ndarray
    actions: np.ndarray
    simulated: np.ndarray
    measured: np.ndarray
    target: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.parameters)

    @property
    def rounds(self) -> int:
        """How many rounds each pair has."""
        return self.parameters.shape[1]

    def pairs(self, keep: np.ndarray | slice) -> Self:
        """Those pairs."""
        target = None if self.target is None else self.target[keep]
        return replace(self.each(lambda a: a[keep]), target=target)

    def first(self, count: int) -> Self:
        """The first `count` rounds, or all if there are fewer."""
        return self.each(lambda a: a[:, :count])

    def last(self, count: int) -> Self:
        """The last `count` rounds, or all if there are fewer."""
        first = max(0, self.rounds - count)
        return self.each(lambda a: a[:, first:])

    def then(self, parameters, actions, simulated, measured) -> Self:
        """With one more round: each as above, without the round axis."""
        new = Rounds(parameters, actions, simulated, measured)
        return self.followed_by(new.each(lambda a: np.asarray(a, dtype=float)[:, None]))

    def followed_by(self, later: Self) -> Self:
        """With the rounds of `later` after its own."""
        both = {n: np.concatenate([getattr(self, n), getattr(later, n)], axis=1) for n in ARRAYS}
        return replace(self, **both)

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> Self:
        """With what `change` makes of each array of rounds, (pair, round, ...); the target stays."""
        return replace(self, **{name: change(getattr(self, name)) for name in ARRAYS})

    @classmethod
    def none(cls, pairs: int, signature: Signature) -> Self:
        """`pairs` pairs that have had no round yet."""
        trajectory = np.zeros((pairs, 0, *signature.trajectory_shape))
        return cls(
            np.zeros((pairs, 0, len(signature.space))),
            np.zeros((pairs, 0, len(signature.actions))),
            trajectory,
            trajectory,
        )


class RoundIdentifier(AskTell):
    """Proposes the parameters of the next round, for many pairs at once; pairs know nothing of each other.

    start (pair, parameter): what each pair begins with (the paper draws it at random). simulate: for identifiers
    that run simulations of their own; what they run is counted in `simulated_rollouts`. error_rate: how often the
    measured label of round n (0, 1, ...) is wrong, where that is known; for identifiers that read labels.

    The loop, which `run_rounds` is: `asked = ask()`; actions for `asked[:, 0]`; simulate every candidate, and
    measure, under these actions; `tell(actions, simulated, measured)`; `best` is the estimate after the round.

    candidates: how many simulations it asks for in a round. simulates: whether it runs others by itself.
    """

    candidates = 1
    simulates = False

    def __init__(
        self,
        signature: Signature,
        start: np.ndarray,
        *,
        simulate: Simulate | None = None,
        seed: int = 0,
        error_rate: Callable[[int], float] | None = None,
    ):
        self.error_rate = error_rate
        self.signature = signature
        self.space = signature.space
        self.start = np.clip(np.asarray(start, dtype=float), self.space.low, self.space.high)
        self._best = self.start
        self.simulate = simulate
        self.seed = seed
        self.simulated_rollouts = np.zeros(len(self.start), dtype=np.int64)

    def ask(self) -> np.ndarray:
        """Parameters of the next round (pair, candidate, parameter), within bounds; a second call gives the same.

        Candidate 0 is the round's own parameters, for which the action is chosen; others share its action. The
        estimate alone where a method has no others.
        """
        return self._best[:, None]

    @abstractmethod
    def tell(self, actions: np.ndarray, simulated: np.ndarray, measured: np.ndarray) -> None:
        """What the round that was asked for gave.

        actions (pair, action), simulated (pair, candidate, point, feature), measured (pair, point, feature).
        """

    @property
    def best(self) -> np.ndarray:
        """The estimate after the rounds so far (pair, parameter); the start before the first."""
        return self._best

    @property
    def sd(self) -> np.ndarray | None:
        """Standard deviation of the estimate's error (pair, parameter), in the parameters' units; None: not known."""
        return None


@dataclass(frozen=True)
class Walk:
    """What `run_rounds` did: the rounds, and after each the estimate and what it cost.

    estimates (pair, round, parameter); sd likewise, or None. simulated_rollouts (pair, round): summed up to there;
    one for each candidate, and those that the identifier ran by itself.
    """

    rounds: Rounds
    estimates: np.ndarray
    sd: np.ndarray | None
    simulated_rollouts: np.ndarray


def run_rounds(
    identifier: RoundIdentifier,
    rounds: int,
    *,
    act: Callable[[int, np.ndarray], np.ndarray],
    simulate: Simulate,
    measure: Callable[[int, np.ndarray], np.ndarray],
    on_round: Callable[[int], None] | None = None,
) -> Walk:
    """Identify for `rounds` rounds.

    act(round, parameters (pair, parameter)) -> actions (pair, action), for instance a policy, or those of a log.
    measure(round, actions (pair, action)) -> measured (pair, point, feature). The identifier is told zeros for a
    simulation that diverged.
    """
    history = Rounds.none(len(identifier.start), identifier.signature)
    estimates, sds, cost = [], [], []
    told = np.zeros(len(identifier.start), dtype=np.int64)
    for number in range(rounds):
        asked = identifier.ask()
        pairs, candidates = asked.shape[:2]
        actions = act(number, asked[:, 0])
        flat, diverged = simulate(
            asked.reshape(pairs * candidates, -1), np.repeat(actions, candidates, axis=0)
        )
        simulated = finite(flat, diverged).reshape(pairs, candidates, *flat.shape[1:])
        measured = measure(number, actions)
        identifier.tell(actions, simulated, measured)
        history = history.then(asked[:, 0], actions, simulated[:, 0], measured)
        told = told + candidates
        estimates.append(identifier.best.copy())
        sds.append(identifier.sd)
        cost.append(told + identifier.simulated_rollouts)
        if on_round:
            on_round(number)
    known = bool(sds) and all(sd is not None for sd in sds)
    return Walk(
        history, np.stack(estimates, axis=1), np.stack(sds, axis=1) if known else None, np.stack(cost, axis=1)
    )


def finite(trajectories: np.ndarray, diverged: np.ndarray) -> np.ndarray:
    """Trajectories (simulation, point, feature) with zeros where the simulation diverged (simulation,)."""
    bad = diverged | ~np.isfinite(trajectories).all(axis=(1, 2))
    return np.where(bad[:, None, None], 0.0, trajectories) if bad.any() else trajectories
