"""A diagnosis in memory."""

from __future__ import annotations

from typing import Any

from capture_cli.protocol.explain import Settings
from capture_cli.protocol.prepare import prepare
from capture_cli.stages.diagnose import diagnose_prepared
from capture_cli.stages.progress import Progress
from capture_cli.stores.measured_log import MeasuredLog
from capture_cli.tasks.base import Task


def diagnose(log: MeasuredLog, task: Task, seed: int) -> dict[str, Any]:
    """diagnosis.json of `log` with the defaults of `capture diagnose`, on one thread."""
    prepared = prepare(log, task, window=None, test=None, seed=seed)
    progress = Progress("diagnose", "model", quiet=True)
    settings = Settings(seed=seed, threads=1)
    return diagnose_prepared(prepared, task.space.nominal, settings, progress).document
