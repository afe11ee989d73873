"""A diagnosis in memory; and what diagnoses look among, where a search among all takes long."""

from __future__ import annotations

from typing import Any

import pytest

from capture_cli.common.progress import Progress
from capture_cli.estimate.prepare import prepare
from capture_cli.estimate.split import NewSplit
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks.base import Task
from capture_cli.select.candidates import all_candidates
from capture_cli.select.explain import Settings
from capture_cli.stages.diagnose import diagnose_prepared


def diagnose(log: MeasuredLog, task: Task, seed: int) -> dict[str, Any]:
    """diagnosis.json of `log` with the defaults of `capture diagnose`, on one thread."""
    prepared = prepare(log, task, split=NewSplit(seed=seed))
    progress = Progress("diagnose", "model", quiet=True)
    settings = Settings(seed=seed, threads=1)
    return diagnose_prepared(prepared, task.space.nominal, settings, progress).document


def look_among(patch: pytest.MonkeyPatch, *kinds: str) -> None:
    """Effects of these kinds are all that diagnoses look for from here on."""
    for module in ("select.search.attribution", "stages.diagnose"):
        patch.setattr(
            f"capture_cli.{module}.all_candidates",
            lambda log: [c for c in all_candidates(log) if c.placed.kind in kinds],
        )
