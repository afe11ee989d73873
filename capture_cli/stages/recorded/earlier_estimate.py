"""An estimate that is taken up again with more episodes in its log (`identify --resume`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.context.identifiers.base import Rounds
from capture_cli.errors import OptionError
from capture_cli.estimate.log_requirements import check_fits
from capture_cli.estimate.prepared_log import attitudes
from capture_cli.estimate.solve.base import Best
from capture_cli.estimate.split import SETTINGS as SPLIT
from capture_cli.estimate.split import EarlierSplit, Split, episodes_held_out
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.windows import Windows
from capture_cli.model.quaternion_signs import continuous
from capture_cli.model.tasks.base import Task
from capture_cli.options.identify import IdentifyOptions
from capture_cli.stages.recorded.recorded_task import recorded_task
from capture_cli.store.document_shape import NUMBER, TEXT, WHOLE, check_shape, or_none
from capture_cli.store.estimate import HISTORY, Estimate
from capture_cli.store.output import PROVENANCE
from capture_cli.store.result import read_provenance

OPTIONS = {  # that are taken over
    "task": or_none(TEXT),
    "identifier": or_none(TEXT),
    "test": or_none(TEXT),
    "window": or_none(NUMBER),
    "seed": WHOLE,
}


@dataclass(frozen=True)
class EarlierEstimate:
    """provenance: of how it was made. episodes: how many the log had then."""

    path: Path
    estimate: Estimate
    provenance: Mapping[str, Any]
    episodes: int

    @classmethod
    def read(cls, path: Path) -> EarlierEstimate:
        """The estimate at `path`. Raises CaptureError."""
        estimate = Estimate.read(path)
        again = "make the estimate again with `capture identify`"
        provenance = read_provenance(path, again)
        check_shape(provenance["options"], OPTIONS, f"{path / PROVENANCE}: options", again)
        return cls(path, estimate, provenance, estimate.record.rollouts["measured"])

    @property
    def options(self) -> dict[str, Any]:
        """With which it was made."""
        return self.provenance["options"]

    def taken_over(self, options: IdentifyOptions) -> IdentifyOptions:
        """Of a run that goes on from it, those that nobody gave as it was made with; its task where the file is now.
        Raises OptionError where it is gone.
        """
        taken = {n: self.options[n] for n in OPTIONS if getattr(options, n) is None}
        if options.task is None:
            taken["task"] = recorded_task(self.path, self.provenance, str(options.real_log))
        return replace(options, **taken)

    def check(self, task: Task, log: MeasuredLog) -> None:
        """Raise CaptureError where it is of another task, other parameters, or not of the first episodes of `log`."""
        names = list(self.estimate.record.parameters)
        if self.estimate.record.task != task.name or names != list(task.space.names):
            raise OptionError(
                f"--resume: {self.path} is of the task {self.estimate.record.task!r} with ({', '.join(names)}); "
                f"this one is {task.name!r} with ({', '.join(task.space.names)})",
                cure="identify anew: --force, or another --out",
            )
        check_fits(log, task)
        if not continues(log, task, self.estimate):
            raise OptionError(
                f"--resume: {self.path} was made from other episodes than those {log.path} begins with",
                cure="identify anew: --force, or another --out; "
                f"{self.path} is of {self.estimate.record.log['path']}",
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
        arrays, new = self.estimate.arrays, self.new(windows)
        before = EarlierSplit(arrays["window/first"], arrays["window/is_test"], "")
        is_test = before.held_in(windows.first, windows.samples) & ~new
        # of a single episode its end was held out: it counts as the part of an episode that it is
        held = sum(is_test[windows.episode == episode].mean() for episode in np.unique(windows.episode[~new]))
        for episode in np.unique(windows.episode[new]):
            if held + 1 <= SPLIT.test_share * (episode + 1):
                is_test |= windows.episode == episode
                held += 1
        return Split(is_test, _how(windows.episode, is_test))


def _how(episode: np.ndarray, is_test: np.ndarray) -> str:
    """What is held out of the windows of so many episodes, (window,), in words."""
    count = len(np.unique(episode))
    held = set(episode[is_test])
    whole = held - set(episode[~is_test])
    if held == whole:
        return episodes_held_out(whole, count)
    more = f" and {len(whole)} more" if whole else ""
    return f"end of the first{more} of {count} episodes held out"


def continues(log: MeasuredLog, task: Task, estimate: Estimate) -> bool:
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
