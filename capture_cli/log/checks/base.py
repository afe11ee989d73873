"""What a check is: one thing that may be wrong with a log of a task. One check = one file."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from capture_cli.errors import LONGEST, LONGEST_CURE, cut
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks.base import Task

Finding = dict[str, str]


def finding(severity: str, where: str, message: str, cure: str) -> Finding:
    """severity: "error", "warning" or "note". where: the channel, recording or file. cure: what to do."""
    shown = (cut(message, LONGEST - LONGEST_CURE), cut(cure, LONGEST_CURE))
    return {"severity": severity, "where": where, "message": shown[0], "cure": shown[1]}


error, warning, note = (partial(finding, severity) for severity in ("error", "warning", "note"))


@dataclass(frozen=True)
class Inspected:
    """A log whose channels are those of its task. episodes: the timing of each (`log_health.timing`)."""

    log: MeasuredLog
    task: Task
    episodes: Sequence[Mapping[str, Any]]


class Check(ABC):
    """Asked of every log that is inspected with its task."""

    @abstractmethod
    def findings(self, given: Inspected) -> Iterable[Finding]:
        """What is wrong with it, each with its cure; nothing where nothing is."""
