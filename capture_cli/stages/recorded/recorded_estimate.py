"""An estimate that a command goes on from: what it was made with, and whether it is of the task and the log at hand."""

import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np

from capture_cli.common.warn import warn
from capture_cli.context.identifiers.base import Rounds
from capture_cli.errors import CaptureError, OptionError
from capture_cli.estimate.log_requirements import check_fits
from capture_cli.estimate.prepared_log import attitudes
from capture_cli.estimate.solve.base import Best
from capture_cli.estimate.split import SETTINGS as SPLIT
from capture_cli.estimate.split import EarlierSplit, Split, episodes_held_out
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.windows import Windows
from capture_cli.model.effects.placed import placed_name
from capture_cli.model.quaternion_signs import continuous
from capture_cli.model.tasks.base import Task
from capture_cli.options.base import Options
from capture_cli.options.diagnose import DiagnoseOptions
from capture_cli.options.identify import IdentifyOptions
from capture_cli.stages.recorded.recorded_task import load_recorded, recorded_task
from capture_cli.store.document_shape import NUMBER, TEXT, WHOLE, check_shape, or_none
from capture_cli.store.estimate import HISTORY, Estimate
from capture_cli.store.output import PROVENANCE, sha256
from capture_cli.store.result import read_provenance

AGAIN = "make the estimate again with `capture identify`"
TAKEN_UP = {  # options that `identify --resume` takes over
    "task": or_none(TEXT),
    "identifier": or_none(TEXT),
    "test": or_none(TEXT),
    "window": or_none(NUMBER),
    "seed": WHOLE,
}
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


class DiagnosedEstimate(RecordedEstimate):
    """The estimate of `--estimate`, whose log is diagnosed."""

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

    def warn_of_misread_channels(self) -> None:
        """Say what it says of them: an effect would stand in for a sign or a unit."""
        if misread := self.estimate.record.misread:
            warn(f"{self.path}: {misread['text']}")

    def taken_over(self, options: DiagnoseOptions) -> DiagnoseOptions:
        """The options of the diagnosis."""
        return self.completed(options, ("window", "seed"))

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
        return max(len(log.episode_ends) - self.episodes, 0) if self.begins(log, machine) else 0


class EarlierEstimate(RecordedEstimate):
    """The estimate at `--out`, which a run with `--resume` takes up."""

    @classmethod
    def read(cls, path: Path) -> Self:
        earlier = super().read(path)
        check_shape(earlier.options, TAKEN_UP, f"{path / PROVENANCE}: options", AGAIN)
        return earlier

    def taken_over(self, options: IdentifyOptions) -> IdentifyOptions:
        """The options of the run that takes it up; its task is looked for. Raises OptionError where that is gone."""
        taken = self.completed(options, TAKEN_UP)
        if options.task is not None:
            return taken
        return replace(taken, task=recorded_task(self.path, self.provenance, str(options.real_log)))

    def check(self, task: Task, log: MeasuredLog) -> None:
        """Raise CaptureError where it is of another task, other parameters, or not of the first episodes of `log`."""
        self.check_task(task, "identify anew: --force, or another --out")
        check_fits(log, task)
        if not self.begins(log, task):
            raise OptionError(
                f"--resume: {self.path} was made from other episodes than those {log.path} begins with",
                cure="identify anew: --force, or another --out; "
                f"{self.path} is of {self.estimate.record.log['path']}",
            )
        if self.episodes == len(log.episode_ends):
            raise OptionError(
                f"--resume: {log.path} has no episode that is not in {self.path}",
                cure="add episodes with `capture import-log --append`, or identify anew with --force",
            )

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
        new = self.new(windows)
        is_test = self.held_out.held_in(windows.first, windows.samples) & ~new
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
