"""The machine that a command simulates: a task, with what `--estimate` and `--effect` say that its model lacks."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from capture_cli.errors import OptionError
from capture_cli.model.effects.ranges import EffectRanges
from capture_cli.model.tasks import load_task
from capture_cli.model.tasks.base import Task
from capture_cli.select.recorded_effects import placed_effects
from capture_cli.stages.effect_option import parse_effects, refuse_without_effect
from capture_cli.stages.recorded.found_model import FoundModel


@dataclass(frozen=True)
class SimulatedMachine:
    """values (parameter,): of the task's parameters, as the estimate has them; nominal where there is none."""

    task: Task
    values: np.ndarray
    effects: EffectRanges

    @classmethod
    def of(
        cls, task: str, estimate: Path | None, effects: Sequence[str], *, over_own_range: bool = False
    ) -> Self:
        """Of `--task`, `--estimate` and the texts of `--effect`, which go before what the estimate says.

        over_own_range: as `parse_effects` has it. Raises CaptureError, for an estimate of another task, too.
        """
        if estimate is None:
            machine = load_task(task)
            values, found = machine.space.nominal, []
        else:
            model = FoundModel.read(Path(estimate), task)
            machine, values, found = model.task, model.values, placed_effects(model.effects)
        ranges = parse_effects(effects, machine.model, found=found, over_own_range=over_own_range)
        return cls(machine, values, ranges)

    @classmethod
    def to_learn_in(cls, task: str, estimate: Path | None, effects: Sequence[str], *, why: str = "") -> Self:
        """The same for what is learned over all values of the parameters, where those of an estimate mean nothing;
        why: in words. An effect that is named alone goes over the whole range in which it is looked for.
        """
        machine = cls.of(task, estimate, effects, over_own_range=True)
        if estimate is not None and not machine.effects.placed:
            raise OptionError(
                f"--estimate {estimate} has no effects, and {why}",
                cure="leave it out, or give what `capture diagnose` found; or name an effect: --effect",
            )
        refuse_without_effect(machine.task, machine.values, machine.effects)
        return machine
