"""What `identify` and `diagnose` begin with: a log, the task whose model is fitted to it, and the record of the run."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from capture_cli.common.progress import Progress
from capture_cli.estimate.prepare import prepare
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.split import EarlierSplit, NewSplit
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks.base import Task
from capture_cli.options.shared import FittingLog
from capture_cli.stages.recorded.recorded_task import named, task_inputs
from capture_cli.store.output import refuse_inputs
from capture_cli.store.provenance import Provenance


def read_log(command: str, options: FittingLog) -> MeasuredLog:
    """The measured log that is fitted; a long one is told of while it is read."""
    with Progress(command, "log", quiet=options.quiet) as progress:
        progress.doing("reading the log")
        return MeasuredLog.read(options.real_log, options.max_log_size)


@dataclass(frozen=True)
class LogToFit:
    """options: of the run, with defaults for those that were not given. provenance: has them, and hashes of inputs."""

    log: MeasuredLog
    task: Task
    options: FittingLog
    provenance: Provenance

    @classmethod
    def of(
        cls, command: str, log: MeasuredLog, task: Task, options: FittingLog, **others: Path | None
    ) -> Self:
        """Of a run of the command. others: what it reads beside the log and the task, by the names of their options.
        Raises OptionError where `out` is among what it reads.
        """
        resolved = replace(options, task=options.task or named(task), seed=options.seed or 0)
        inputs = {"real_log": log.path, **task_inputs(task), **others}
        refuse_inputs(options.out, inputs.values())
        return cls(log, task, resolved, Provenance(command, resolved.recorded(), inputs))

    def prepared(self, held_out: EarlierSplit | None = None, task: Task | None = None) -> PreparedLog:
        """As `prepare` makes it, with the options of the run. task: in the place of its own."""
        own = self.options
        split = held_out or NewSplit(own.test, own.seed)
        return prepare(self.log, task or self.task, window=own.window, split=split, threads=own.threads)
