"""An estimate that is taken up again with more episodes in its log (`identify --resume`)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.diagnosis.split import TEST_SHARE, Split
from capture_cli.errors import OptionError
from capture_cli.identifiers.base import Best
from capture_cli.identifiers.rounds import Rounds
from capture_cli.protocol.log_checks import check_fits
from capture_cli.protocol.prepared_log import attitudes
from capture_cli.sim.quaternion_signs import continuous
from capture_cli.sim.windows import Windows
from capture_cli.stores.estimate import HISTORY, Estimate, read_result
from capture_cli.stores.measured_log import MeasuredLog
from capture_cli.tasks.base import Task


@dataclass(frozen=True)
class EarlierEstimate:
    """options: those that it was made with. episodes: how many the log had then."""

    path: Path
    estimate: Estimate
    options: dict[str, Any]
    episodes: int

    @classmethod
    def read(cls, path: Path) -> EarlierEstimate:
        """The estimate at `path`. Raises CaptureError."""
        estimate = Estimate.read(path)
        again = "make the estimate again with `capture identify`"
        options = read_result(path, "provenance.json", "capture/provenance", 1, again)["options"]
        return cls(path, estimate, options, estimate.document["rollouts"]["measured"])

    def check(self, task: Task, log: MeasuredLog) -> None:
        """Raise CaptureError where it is of another task, other parameters, or not of the first episodes of `log`."""
        names = list(self.estimate.document["parameters"])
        if self.estimate.document["task"] != task.name or names != list(task.space.names):
            raise OptionError(
                f"--resume: {self.path} is of the task {self.estimate.document['task']!r} with ({', '.join(names)}); "
                f"this one is {task.name!r} with ({', '.join(task.space.names)})",
                cure="identify anew: --force, or another --out",
            )
        check_fits(log, task)
        if not _continues(log, task, self.estimate):
            raise OptionError(
                f"--resume: {self.path} was made from other episodes than those {log.path} begins with",
                cure="identify anew: --force, or another --out; "
                f"{self.path} is of {self.estimate.document['log']['path']}",
            )
        if self.episodes == len(log.episode_ends):
            raise OptionError(
                f"--resume: {log.path} has no episode that {self.path} has not seen",
                cure="add episodes with `capture import-log --append`, or identify anew with --force",
            )

    @property
    def parameters(self) -> np.ndarray:
        """(parameter,)."""
        return np.asarray(self.estimate.arrays["parameter/estimate"], dtype=float)

    @property
    def history(self) -> list[Best]:
        """The rounds before."""
        arrays, none = self.estimate.arrays, np.zeros((0, 0))
        rounds = zip(arrays["round/parameters"], arrays["round/error"], strict=True)
        return [Best(p, none, float(e)) for p, e in rounds]

    @property
    def rounds(self) -> Rounds | None:
        """The rounds in context before, as one pair; None where there were none."""
        arrays = self.estimate.arrays
        if HISTORY[0] not in arrays:
            return None
        return Rounds(*(np.asarray(arrays[name])[None] for name in HISTORY))

    def new(self, windows: Windows) -> np.ndarray:
        """Which windows are of new episodes, (window,)."""
        return windows.episode >= self.episodes

    def split(self, windows: Windows, chosen: Split) -> Split:
        """What was held out stays so; of new episodes one is held out whenever the share has fallen by one.

        chosen: what would be held out without an earlier estimate, which stands where `--test` says what to hold out.
        """
        if self.options["test"] is not None:
            return chosen
        arrays = self.estimate.arrays
        held = set(np.unique(arrays["window/episode"][arrays["window/is_test"]]).tolist())
        blocks = held & set(np.unique(arrays["window/episode"][~arrays["window/is_test"]]).tolist())
        held -= blocks  # of a single episode, its end was held out: now there are others to hold out
        for episode in range(self.episodes, int(windows.episode.max()) + 1):
            if len(held) + 1 <= TEST_SHARE * (episode + 1):
                held.add(episode)
        is_test = np.isin(windows.episode, sorted(held))
        return Split(is_test, f"{len(held)} of {len(np.unique(windows.episode))} episodes held out")


def _continues(log: MeasuredLog, task: Task, estimate: Estimate) -> bool:
    """Whether the windows of the estimate are in the log, number for number."""
    arrays = estimate.arrays
    window, measured = arrays["step/window"], arrays["step/measured"]
    begins = np.searchsorted(window, np.arange(len(arrays["window/first"])))
    steps = arrays["window/first"][window] + np.arange(len(window)) - begins[window]
    if measured.shape[1] != log.outputs.shape[1] or steps.max() >= len(log.outputs):
        return False
    # the estimate has the signs of quaternions that its log was prepared with
    outputs = continuous(log.outputs, log.episodes, attitudes(task), log.sampled)
    return bool(np.array_equal(outputs[steps], measured, equal_nan=True))
