"""Force balances of logs that are made here: a machine of the benchmarks with an effect at values that are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from benchmarks._planted_logs.machines import MACHINE, Experiment
from capture_cli.estimate.balance.force_balance import ForceBalance
from capture_cli.estimate.balance.motion import SmoothedLog
from capture_cli.estimate.balance.screening import Screening
from capture_cli.estimate.balance.whitening import Whitening
from capture_cli.estimate.log_balance import with_timings
from capture_cli.estimate.prepare import prepare
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.effects import REGISTRY
from capture_cli.model.effects.base import Effect
from capture_cli.model.effects.placed import Placed
from capture_cli.select.candidates import all_candidates

COVERED = tuple(MACHINE)


@dataclass(frozen=True)
class Made:
    """A log of `machine`, episodes of 3 s at 250 Hz with noise, in which effects act at values (parameter,)."""

    experiment: Experiment
    planted: Sequence[tuple[Effect, np.ndarray]]

    @classmethod
    def of(cls, machine: str, *planted: tuple[str, str, float], seed: int = 0, episodes: int = 3) -> Made:
        """planted: EFFECT, SITE and how far from null its amplitudes are, of their ranges as of no log."""
        made = Experiment(MACHINE[machine], np.random.default_rng(seed), episodes)
        effects = [(REGISTRY.get(n)(made.task.model, site), share) for n, site, share in planted]
        return cls(made, [(effect, away(effect, share)) for effect, share in effects])

    @property
    def truth(self) -> np.ndarray:
        """The parameters, (parameter,)."""
        return self.experiment.parameters

    @cached_property
    def log(self) -> MeasuredLog:
        return self.experiment.log(self.experiment.outputs(self.planted))

    @cached_property
    def prepared(self) -> PreparedLog:
        held = with_timings(self.experiment.task, ())  # as they are: nobody has to find out
        return prepare(self.log, held)

    @cached_property
    def smoothed(self) -> SmoothedLog:
        return SmoothedLog.of(self.log.arrays, self.experiment.task)

    @cached_property
    def balance(self) -> ForceBalance:
        """At the true parameters."""
        return ForceBalance(self.smoothed, self.truth, 1)

    @cached_property
    def whitening(self) -> Whitening:
        return Whitening(self.balance)

    @cached_property
    def placed(self) -> list[Placed]:
        """Everything that could show in the log, as the log makes it."""
        return [c.placed for c in all_candidates(self.prepared)]

    def screening(self, placed: Sequence[Placed] | None = None, threads: int = 1) -> Screening:
        """From the middle of the parameters' ranges."""
        nominal = self.experiment.task.space.nominal
        return Screening.of(self.smoothed, self.placed if placed is None else placed, nominal, threads)

    def white(self, columns: Sequence) -> np.ndarray:
        """White rows (row, column) of accelerations."""
        return np.concatenate(self.whitening.whitened(self.whitening.rows(columns)))


def away(effect: Effect, share: float) -> np.ndarray:
    """Amplitudes at a share of the way from null to the farther bound, the nearer where below 0; shapes as they are."""
    space = effect.space
    up, down = space.high - space.nominal, space.low - space.nominal
    farther, nearer = np.where(up >= -down, (up, down), (down, up))
    moved = space.nominal + abs(share) * (farther if share > 0 else nearer)
    return np.where([n in effect.shapes for n in space.names], space.nominal, moved)
