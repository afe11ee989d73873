"""The machine that a proposal is for: the task of an estimate or of a diagnosis."""

from __future__ import annotations

from pathlib import Path

from capture_cli.model.tasks.base import Task
from capture_cli.select.recorded_effects import placed_effects, recorded_effects
from capture_cli.stages.recorded.recorded_task import load_recorded
from capture_cli.store.diagnosis import Diagnosis
from capture_cli.store.estimate import Estimate
from capture_cli.store.result import Result, read_provenance


def is_diagnosis(folder: Path) -> bool:
    """Whether the result in `folder` is one; otherwise it is an estimate."""
    return (folder / "diagnosis.json").is_file()


def proposed_machine(folder: Path, task: str | None) -> tuple[Task, str]:
    """The task of the result in `folder`, `task` where that is given, and where its log was. Raises CaptureError."""
    kind: type[Result] = Diagnosis if is_diagnosis(folder) else Estimate
    record = kind.RECORD.of(kind.read_document(folder))
    provenance, log = read_provenance(folder, kind.KIND.cure), record.log["path"]
    machine = load_recorded(folder, provenance, task, log)
    if kind is Estimate:  # that of a diagnosis is the declared one, beside which its effects are judged
        machine = machine.with_effects(placed_effects(recorded_effects(record.effects, machine, "identify")))
    return machine, log
