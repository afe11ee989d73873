"""Which logs there are, and how large the effect in each is."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks._planted.machines import EPISODES, MACHINE, Experiment
from benchmarks._planted.outside import LEFT_OUT, OUTSIDE
from capture_cli.effects import REGISTRY
from capture_cli.effects.base import Effect
from capture_cli.reports.diagnosis_findings import placed

PLANTED, PAIR, NOTHING, UNKNOWN, LEFT = "planted", "pair", "nothing", "outside", "left-out"
MAGNITUDES = (1.5, 3.0, 10.0)  # error of the declared model, refitted, over the noise
PAIRS = 10  # of each machine and seed
PAIR_MAGNITUDE = 3.0  # of each of the two alone
# Joints along which nothing can be seen.
UNSEEN = {"puck": ("z",)}
NO_SIZE = ("finer-time-step",)  # that could be fitted to a magnitude
NOISE = ("sensor-quantisation",)  # coarse steps raise the noise floor: nothing is missing (docs/concepts.md)
SHAPE_SHARE = (0.3, 0.7)  # of a shape's range: where it is drawn from
CLOSE_ENOUGH = 0.15  # of what is to be left
MOST_TRIALS = 8
FIRST_TRIAL = 0.03  # of the range
LARGEST_STEP = 30.0
SMALLEST_LEFT = 0.1  # what is left of the noise: less cannot be told from nothing


@dataclass(frozen=True)
class Case:
    """kind: PLANTED, PAIR (two at once), NOTHING, UNKNOWN (an effect of OUTSIDE) or LEFT (of a catalogue without it).

    second: EFFECT@SITE of the other of a pair.
    """

    kind: str
    machine: str
    effect: str
    site: str
    magnitude: float
    seed: int
    second: str = ""

    @property
    def planted(self) -> tuple[str, ...]:
        """EFFECT@SITE of each, as `diagnose` names them."""
        first = placed({"effect": self.effect, "site": self.site})
        return (first, self.second) if self.second else (first,)

    @property
    def label(self) -> str:
        return f"{self.kind}/{self.machine}/{'&'.join(self.planted)}/{self.magnitude:g}/{self.seed}"

    @property
    def generator(self) -> np.random.Generator:
        """The same for every magnitude: machine, drive, noise and direction of the effect are alike."""
        text = f"{self.kind}/{self.machine}/{'&'.join(self.planted)}"
        return np.random.default_rng([self.seed, zlib.crc32(text.encode())])

    def effects(self, model) -> list[Effect]:
        """What is planted, each at its site of `model`."""
        if self.kind == NOTHING:
            return []
        effects = []
        for planted in self.planted:
            name, _, site = planted.partition("@")
            cls = OUTSIDE[name] if self.kind == UNKNOWN else REGISTRY.get(name)
            effects.append(cls(model, site))
        return effects


@dataclass(frozen=True)
class Plant:
    """An effect to plant, and its values (parameter,) by size, a share of the amplitudes' ranges."""

    effect: Effect
    values: Callable[[float], np.ndarray]


def cases(seeds: int, logs: int) -> Iterator[Case]:
    """All cases, seed by seed: `seeds` of every effect at every site and magnitude, and of pairs; `logs` with nothing
    missing.
    """
    names = list(MACHINE)
    for number in range(logs):
        yield Case(NOTHING, names[number % len(names)], "", "", 1.0, number // len(names))
    for seed in range(seeds):
        for machine in names:
            for kind, effect, site in _effects(machine):
                for magnitude in MAGNITUDES:
                    yield Case(kind, machine, effect, site, magnitude, seed)
            yield from _pairs(machine, seed)


def _pairs(machine: str, seed: int) -> Iterator[Case]:
    """Two effects at once, drawn at random."""
    single = [(effect, site) for kind, effect, site in _effects(machine) if kind == PLANTED]
    generator = np.random.default_rng([seed, zlib.crc32(f"pairs/{machine}".encode())])
    drawn: set[tuple[int, int]] = set()
    while len(drawn) < PAIRS:
        first, second = sorted(generator.choice(len(single), 2, replace=False))
        if single[first][0] != single[second][0] and (first, second) not in drawn:
            drawn.add((first, second))
            other = placed(dict(zip(("effect", "site"), single[second], strict=True)))
            yield Case(PAIR, machine, *single[first], PAIR_MAGNITUDE, seed, other)


def _effects(machine: str) -> Iterator[tuple[str, str, str]]:
    """(kind, effect, site) on `machine`."""
    model = MACHINE[machine].task.model
    unseen = UNSEEN.get(machine, ())
    for name, cls in REGISTRY.items():
        for site in cls.sites(model):
            if site not in unseen and name not in (*NOISE, *NO_SIZE):
                yield PLANTED, name, site
    for name, cls in OUTSIDE.items():
        for site in cls.sites(model):
            if site not in unseen:
                yield UNKNOWN, name, site
    for where, name, site in LEFT_OUT:
        if where == machine:
            yield LEFT, name, site


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


def size(left: Callable[[float], float], magnitude: float) -> float | None:
    """The size at which `left`(size) is what an error of `magnitude` leaves; None where the range does not reach it.

    Secant in logarithms, kept within a bracket.
    """
    wanted = np.sqrt(magnitude**2 - 1)
    below, above, tried, best = None, None, FIRST_TRIAL, (np.inf, FIRST_TRIAL)
    for _ in range(MOST_TRIALS):
        found = left(tried)
        best = min(best, (abs(np.log(max(found, 1e-9) / wanted)), tried))
        if abs(found / wanted - 1) < CLOSE_ENOUGH:
            return tried
        if found < wanted and tried >= 1.0:
            return None
        if found < wanted:
            below = (tried, max(found, SMALLEST_LEFT))
        else:
            above = (tried, found)
        tried = _next(below, above, wanted)
    return best[1]


def _next(below: tuple[float, float] | None, above: tuple[float, float] | None, wanted: float) -> float:
    """Where to try next, from the nearest (size, what it left) on either side of `wanted`."""
    if below is None or above is None:
        size, found = below or above
        return min(size * float(np.clip(wanted / found, 1 / LARGEST_STEP, LARGEST_STEP)), 1.0)
    (small, less), (large, more) = below, above
    share = np.log(wanted / less) / np.log(more / less) if np.isfinite(more) else 0.5
    return float(small * (large / small) ** np.clip(share, 0.1, 0.9))


def experiment(case: Case, episodes: int = EPISODES) -> tuple[Experiment, list[Plant]]:
    """The machine of `case`, and what is planted in it."""
    generator = case.generator
    made = Experiment(MACHINE[case.machine], generator, episodes)
    return made, [Plant(effect, direction(effect, generator)) for effect in case.effects(made.task.model)]
