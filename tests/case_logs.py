"""Logs of the planted-effect benchmark whose effects have a size that is known: it takes several refits to find one."""

from __future__ import annotations

from benchmarks._planted_logs.cases import Case, direction
from benchmarks._planted_logs.dresses import dressed
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks.base import Task


def log_of(case: Case, *sizes: float) -> tuple[Task, MeasuredLog]:
    """What case.build() makes, where its effects have these sizes."""
    generator = case.generator
    made = case.experiment(generator)
    effects = case.effects(made.task.model)
    planted = [(e, direction(e, generator)(size)) for e, size in zip(effects, sizes, strict=True)]
    return dressed(case.dress, made.task, made.log(made.outputs(planted)))
