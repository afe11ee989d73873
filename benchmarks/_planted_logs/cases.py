"""Which logs there are: cases drawn from a seed, each of which builds its task, its log and its truth in memory.

    from itertools import islice
    from benchmarks._planted_logs.cases import PLANTED, NothingToFind, cases

    for case in islice(cases(PLANTED, seed=7, dress="half-rate", machines=("cart_pole", "arm")), 20):
        try:
            task, log, truth = case.build()  # Task, MeasuredLog, Truth: about a second
        except NothingToFind:  # the declared parameters take up all that the effect does
            continue

The same kind and seed give the same cases, in every dress: machine, drive, noise, effect and size are alike. Kinds are
PLANTED (one effect that raises the error to 2.2, 3 or 10 times the noise), PAIR (two), NOTHING, WEAK (one that shows in
a parameter rather than in the error), UNKNOWN (an effect of no catalogue) and LEFT (of a catalogue without it).
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import count

import numpy as np

from benchmarks._planted_logs.dresses import ELSEWHERE, PLAIN, dressed, rate_in
from benchmarks._planted_logs.machines import EPISODES, MACHINE, Experiment
from benchmarks._planted_logs.outside import LEFT_OUT, OUTSIDE
from benchmarks._planted_logs.sizes import Refit, Shown, size
from capture_cli.errors import CaptureError
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.effects import REGISTRY
from capture_cli.model.effects.base import Effect
from capture_cli.model.effects.placed import placed_name
from capture_cli.model.tasks.base import Task

PLANTED, PAIR, NOTHING, WEAK, UNKNOWN, LEFT = "planted", "pair", "nothing", "weak", "outside", "left-out"
KINDS = (PLANTED, PAIR, NOTHING, WEAK, UNKNOWN, LEFT)
MAGNITUDES = (2.2, 3.0, 10.0)  # error of the declared model, refitted, over the noise
PAIR_MAGNITUDE = 3.0  # of each of the two alone
WEAK_MAGNITUDES = (1.01, 1.1)
# Standard deviations of the whole log that a weak effect moves a declared parameter by: 5 of a fit to two thirds of it.
SHIFTED = 6.0
# Joints along which nothing can be seen.
UNSEEN = {"puck": ("z",)}
NO_SIZE = ("finer-time-step",)  # that could be fitted to a magnitude
NOISE = ("sensor-quantisation",)  # coarse steps raise the noise floor: nothing is missing (docs/method.md)
SHAPE_SHARE = (0.3, 0.7)  # of a shape's range: where it is drawn from


class NothingToFind(CaptureError):
    """An effect that does not show as it should at any size of its range."""


@dataclass(frozen=True)
class Truth:
    """parameters: NAME -> value of the task. effects: EFFECT@SITE -> NAME -> value. shown: what all of them together
    do to the declared model.
    """

    parameters: dict[str, float]
    effects: dict[str, dict[str, float]]
    shown: Shown


@dataclass(frozen=True)
class Case:
    """kind: one of KINDS. planted: EFFECT@SITE of each, as `diagnose` names them. magnitude: of each alone.

    number: of the drive, the noise and all else that is drawn.
    """

    kind: str
    machine: str
    planted: tuple[str, ...]
    magnitude: float
    number: int
    dress: str = PLAIN
    episodes: int = field(default=EPISODES, compare=False)

    @property
    def label(self) -> str:
        what = "&".join(self.planted) or "-"
        return f"{self.kind}/{self.machine}/{what}/{self.magnitude:.3g}/{self.number}/{self.dress}"

    @property
    def generator(self) -> np.random.Generator:
        """The same for every magnitude and dress: machine, drive and direction of the effect are alike."""
        text = f"{self.kind}/{self.machine}/{'&'.join(self.planted)}"
        return np.random.default_rng([self.number, zlib.crc32(text.encode())])

    def experiment(self, generator: np.random.Generator) -> Experiment:
        """What is recorded, but for the effects."""
        rate, elsewhere = rate_in(self.dress), self.dress == ELSEWHERE
        return Experiment(MACHINE[self.machine], generator, self.episodes, rate, elsewhere=elsewhere)

    def effects(self, model) -> list[Effect]:
        """What is planted, each at its site of `model`."""
        effects = []
        for planted in self.planted:
            name, _, site = planted.partition("@")
            cls = OUTSIDE[name] if self.kind == UNKNOWN else REGISTRY.get(name)
            effects.append(cls(model, site))
        return effects

    def build(self) -> tuple[Task, MeasuredLog, Truth]:
        """The task, the log in its dress, and what is true of it. Raises NothingToFind."""
        generator = self.generator
        made = self.experiment(generator)
        refit = Refit(made)
        planted = []
        for effect in self.effects(made.task.model):
            values = direction(effect, generator)
            planted.append((effect, values(self._size(made, refit, effect, values))))
        outputs = made.outputs(planted)
        if outputs is None:
            raise NothingToFind(
                f"{self.label}: together its effects cannot be simulated", cure="take another"
            )
        shown = refit.shown(outputs)
        if self.kind == WEAK and np.abs(shown.shift).max() < SHIFTED:
            raise NothingToFind(f"{self.label}: no parameter moves by {SHIFTED:g} sd", cure="take another")
        truth = Truth(
            dict(zip(made.task.space.names, made.parameters.tolist(), strict=True)),
            {
                name: dict(zip(effect.space.names, values.tolist(), strict=True))
                for name, (effect, values) in zip(self.planted, planted, strict=True)
            },
            shown,
        )
        return *dressed(self.dress, made.task, made.log(outputs)), truth

    def _size(self, made: Experiment, refit: Refit, effect: Effect, values: Callable) -> float:
        found = size(lambda s: refit.shown(made.outputs([(effect, values(s))])).left, self.magnitude)
        if found is None:
            raise NothingToFind(
                f"{self.label}: at most {refit.shown(made.outputs([(effect, values(1.0))])).error:.3g} times the noise",
                cure="take another",
            )
        return found


def cases(
    kind: str, seed: int, dress: str = PLAIN, machines: Sequence[str] = tuple(MACHINE)
) -> Iterator[Case]:
    """Cases of one kind without end, the machines in turns; every effect of a machine is as likely as another."""
    for index in count():
        machine = machines[index % len(machines)]
        generator = np.random.default_rng([seed, index, zlib.crc32(f"{kind}/{machine}".encode())])
        planted = _planted(kind, machine, generator)
        magnitude = _magnitude(kind, generator)
        yield Case(kind, machine, planted, magnitude, int(generator.integers(2**31)), dress)


def _planted(kind: str, machine: str, generator: np.random.Generator) -> tuple[str, ...]:
    if kind == NOTHING:
        return ()
    if kind == LEFT:
        return tuple(placed_name(name, site) for where, name, site in LEFT_OUT if where == machine)
    sites = _sites(machine, kind == UNKNOWN)
    names = generator.choice(sorted(sites), 2 if kind == PAIR else 1, replace=False)
    return tuple(sorted(placed_name(str(n), str(generator.choice(sites[n]))) for n in names))


def _magnitude(kind: str, generator: np.random.Generator) -> float:
    if kind == WEAK:
        low, high = WEAK_MAGNITUDES
        return float(1 + (low - 1) * ((high - 1) / (low - 1)) ** generator.uniform())
    return {NOTHING: 1.0, PAIR: PAIR_MAGNITUDE}.get(kind) or float(generator.choice(MAGNITUDES))


@cache
def _sites(machine: str, outside: bool) -> dict[str, list[str]]:
    """EFFECT -> its sites on `machine` where it can be seen."""
    model, unseen = MACHINE[machine].task.model, UNSEEN.get(machine, ())
    known = OUTSIDE.items() if outside else REGISTRY.items()
    every = {
        name: [site for site in cls.sites(model) if site not in unseen]
        for name, cls in known
        if name not in (*NOISE, *NO_SIZE)
    }
    return {name: sites for name, sites in every.items() if sites}


def direction(effect: Effect, generator: np.random.Generator) -> Callable[[float], np.ndarray]:
    """Size of the effect as a share of the amplitudes' ranges -> values (parameter,); shapes and signs are drawn."""
    space = effect.space
    amplitudes = [i for i, n in enumerate(space.names) if n not in effect.shapes]
    values, way = space.nominal.copy(), np.zeros(len(space))
    for i, name in enumerate(space.names):
        low, high, share = space.low[i], space.high[i], generator.uniform(*SHAPE_SHARE)
        if name in effect.shapes:
            values[i] = low * (high / low) ** share if low > 0 else low + share * (high - low)
    way[amplitudes] = generator.standard_normal(len(amplitudes))
    way[amplitudes] /= np.abs(way[amplitudes]).max()
    down, up = space.nominal - space.low, space.high - space.nominal
    way = np.where(up == 0, -np.abs(way), np.where(down == 0, np.abs(way), way))
    reach = np.where(way > 0, up, down) * way
    return lambda size: np.clip(values + size * reach, space.low, space.high)
