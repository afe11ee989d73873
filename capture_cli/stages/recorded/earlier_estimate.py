"""An estimate that is taken up again with more episodes in its log (`identify --resume`)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Self

import numpy as np

from capture_cli.context.identifiers.base import Rounds
from capture_cli.errors import OptionError
from capture_cli.estimate.log_requirements import check_fits
from capture_cli.estimate.solve.base import Best
from capture_cli.estimate.split import SETTINGS as SPLIT
from capture_cli.estimate.split import Split, episodes_held_out
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.windows import Windows
from capture_cli.model.tasks.base import Task
from capture_cli.options.identify import IdentifyOptions
from capture_cli.stages.recorded.recorded_estimate import AGAIN, RecordedEstimate
from capture_cli.stages.recorded.recorded_task import recorded_task
from capture_cli.store.document_shape import NUMBER, TEXT, WHOLE, check_shape, or_none
from capture_cli.store.estimate import HISTORY
from capture_cli.store.output import PROVENANCE

OPTIONS = {  # that are taken over
    "task": or_none(TEXT),
    "identifier": or_none(TEXT),
    "test": or_none(TEXT),
    "window": or_none(NUMBER),
    "seed": WHOLE,
}


class EarlierEstimate(RecordedEstimate):
    """The estimate at `--out`, which a run with `--resume` takes up."""

    @classmethod
    def read(cls, path: Path) -> Self:
        earlier = super().read(path)
        check_shape(earlier.options, OPTIONS, f"{path / PROVENANCE}: options", AGAIN)
        return earlier

    def taken_over(self, options: IdentifyOptions) -> IdentifyOptions:
        """The options of the run that takes it up; its task is looked for. Raises OptionError where that is gone."""
        taken = self.completed(options, OPTIONS)
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
