"""The estimate that `diagnose` begins at: one of the same log, whose task, options and held-out part it takes over."""

from __future__ import annotations

import shlex

from capture_cli.errors import CaptureError, OptionError
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.effects.placed import placed_name
from capture_cli.model.tasks.base import Task
from capture_cli.options.diagnose import DiagnoseOptions
from capture_cli.stages.recorded.recorded_estimate import RecordedEstimate
from capture_cli.stages.recorded.recorded_task import load_recorded
from capture_cli.store.output import sha256

TAKEN_OVER = ("window", "seed")  # options


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

    def taken_over(self, options: DiagnoseOptions) -> DiagnoseOptions:
        """The options of the diagnosis."""
        return self.completed(options, TAKEN_OVER)

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
