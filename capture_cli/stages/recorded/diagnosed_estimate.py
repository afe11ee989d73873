"""The estimate that `diagnose` begins at: one of the same log, whose task, options and held-out part it takes over."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.errors import CaptureError, OptionError, StoreError
from capture_cli.estimate.split import EarlierSplit
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.effects.placed import placed_name
from capture_cli.model.tasks.base import Task
from capture_cli.options.diagnose import DiagnoseOptions
from capture_cli.stages.recorded.earlier_estimate import continues
from capture_cli.stages.recorded.recorded_task import load_recorded
from capture_cli.store.estimate import Estimate
from capture_cli.store.output import sha256
from capture_cli.store.result import read_provenance

TAKEN_OVER = ("window", "seed")  # options


@dataclass(frozen=True)
class DiagnosedEstimate:
    """provenance: of how it was made."""

    path: Path
    estimate: Estimate
    provenance: Mapping[str, Any]

    @classmethod
    def read(cls, path: Path) -> DiagnosedEstimate:
        """The estimate at `path`. Raises CaptureError."""
        estimate = Estimate.read(path)
        return cls(path, estimate, read_provenance(path, "make the estimate again with `capture identify`"))

    def task(self, given: str | None, log: MeasuredLog) -> Task:
        """The task of `--task`, or else its own. Raises OptionError where it is not of the log as it is now, or the
        task's model is not what it was.
        """
        self._check(log, given)
        if effects := self.estimate.record.effects:
            names = ", ".join(placed_name(row["name"], row["site"]) for row in effects)
            raise OptionError(
                f"{self.path} was fitted with {names} in the model, and a diagnosis begins with the model as declared",
                cure="leave --estimate out",
            )
        return load_recorded(self.path, self.provenance, given, str(log.path))

    def taken_over(self, options: DiagnoseOptions) -> DiagnoseOptions:
        """Those that nobody gave as it was made with."""
        own = self.provenance["options"]
        return replace(options, **{n: own[n] for n in TAKEN_OVER if getattr(options, n) is None})

    @property
    def held_out(self) -> EarlierSplit:
        """What it held out."""
        arrays = self.estimate.arrays
        return EarlierSplit(
            arrays["window/first"], arrays["window/is_test"], self.estimate.record.split["how"]
        )

    def values(self, task: Task) -> np.ndarray:
        """Those of the task's parameters, (parameter,). Raises StoreError where they are others than its own."""
        record = self.estimate.record
        parameters = record.parameters
        if record.task != task.name or list(parameters) != list(task.space.names):
            raise StoreError(
                f"the estimate has task {record.task!r} with ({', '.join(parameters)}); "
                f"the task is {task.name!r} with ({', '.join(task.space.names)})",
                cure="identify again with the task as it is now",
            )
        return task.space.to_vector({name: p["value"] for name, p in parameters.items()})

    def _check(self, log: MeasuredLog, task: str | None) -> None:
        """Raise OptionError where it is not of the log as it is now. task: the `--task` that was given."""
        recorded = self.estimate.record.log
        if recorded["sha256"] == sha256(log.path):
            return
        identify = ["capture", "identify", "--real-log", str(log.path)]
        if new := self._new_episodes(log, task):
            raise OptionError(
                f"{log.path} has {new} new episode{'s' * (new > 1)} since {self.path} was made from it",
                cure=f"take the estimate up first: {shlex.join([*identify, '--out', str(self.path), '--resume'])}",
            )
        raise OptionError(
            f"{self.path} was made from {recorded['path']}, and {log.path} is not that log as it was then",
            cure=f"identify it first: {shlex.join(identify)}",
        )

    def _new_episodes(self, log: MeasuredLog, task: str | None) -> int:
        """How many episodes the log has after those of the estimate; 0 where it does not go on from them."""
        try:
            machine = load_recorded(self.path, self.provenance, task, str(log.path))
        except CaptureError:
            return 0
        new = len(log.episode_ends) - self.estimate.record.rollouts["measured"]
        return max(new, 0) if continues(log, machine, self.estimate) else 0
