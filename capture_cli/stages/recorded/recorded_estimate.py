"""An estimate that a command goes on from: what it was made with, and whether it is of the task and the log at hand."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np

from capture_cli.errors import OptionError
from capture_cli.estimate.prepared_log import attitudes
from capture_cli.estimate.split import EarlierSplit
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.quaternion_signs import continuous
from capture_cli.model.tasks.base import Task
from capture_cli.options.base import Options
from capture_cli.store.estimate import Estimate
from capture_cli.store.result import read_provenance

AGAIN = "make the estimate again with `capture identify`"
Asked = TypeVar("Asked", bound=Options)


@dataclass(frozen=True)
class RecordedEstimate:
    """provenance: of how it was made."""

    path: Path
    estimate: Estimate
    provenance: Mapping[str, Any]

    @classmethod
    def read(cls, path: Path) -> Self:
        """The estimate at `path`. Raises CaptureError."""
        return cls(path, Estimate.read(path), read_provenance(path, AGAIN))

    @property
    def options(self) -> Mapping[str, Any]:
        """With which it was made."""
        return self.provenance["options"]

    @property
    def episodes(self) -> int:
        """How many its log had."""
        return self.estimate.record.rollouts["measured"]

    @property
    def values(self) -> np.ndarray:
        """Of its parameters, (parameter,)."""
        return np.array([p["value"] for p in self.estimate.record.parameters.values()])

    @property
    def held_out(self) -> EarlierSplit:
        """What it held out."""
        arrays = self.estimate.arrays
        return EarlierSplit(
            arrays["window/first"], arrays["window/is_test"], self.estimate.record.split["how"]
        )

    def completed(self, options: Asked, names: Iterable[str]) -> Asked:
        """The options of a run that goes on from it: those of `names` that are None are as it was made with."""
        return replace(options, **{n: self.options[n] for n in names if getattr(options, n) is None})

    def check_task(self, task: Task, cure: str) -> None:
        """Raise OptionError where it is of another task, or of other parameters."""
        record = self.estimate.record
        if record.task != task.name or list(record.parameters) != list(task.space.names):
            raise OptionError(
                f"{self.path} is of the task {record.task!r} with ({', '.join(record.parameters)}); this one is "
                f"{task.name!r} with ({', '.join(task.space.names)})",
                cure=cure,
            )

    def begins(self, log: MeasuredLog, task: Task) -> bool:
        """Whether its windows are in the log, number for number."""
        arrays = self.estimate.arrays
        window, measured = arrays["step/window"], arrays["step/measured"]
        begins = np.searchsorted(window, np.arange(len(arrays["window/first"])))
        steps = arrays["window/first"][window] + np.arange(len(window)) - begins[window]
        if measured.shape[1] != log.outputs.shape[1] or steps.max() >= len(log.outputs):
            return False
        # the estimate has the signs of quaternions that its log was prepared with
        outputs = continuous(log.outputs, log.episodes, attitudes(task), log.sampled)
        return bool(np.array_equal(outputs[steps], measured, equal_nan=True))
