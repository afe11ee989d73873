"""What `capture propose` proposes as the columns of a log: what the robot's side runs, without undoing scales."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from capture_cli.errors import OptionError
from capture_cli.model.tasks.base import ActionTask
from capture_cli.stages.recorded.proposed_machine import proposed_machine
from capture_cli.store.proposal import ProposalRecord


def proposal_csv(document: Mapping[str, Any], result: Path, task: str | None = None) -> str:
    """The inputs of the proposal `document`, made of `result`, in the columns and units of the log; one row of actions.

    Raises CaptureError.
    """
    proposal = ProposalRecord.of(document)
    machine, _ = proposed_machine(Path(result), task)
    if isinstance(machine, ActionTask):
        values = {f"action.{name}": [action["value"]] for name, action in proposal.action.items()}
    else:
        values = {machine.log.time: [t / machine.log.time_scale for t in proposal.time_s]}
        for channel in machine.inputs:
            own = [(u - channel.offset) / channel.scale for u in proposal.inputs[channel.name]]
            if values.setdefault(channel.column, own) != own:
                raise OptionError(
                    f"--csv: column {channel.column!r} drives several inputs, and what is proposed for them differs",
                    cure="give each its own column in the task.toml, or take the JSON",
                )
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(values)
    writer.writerows([f"{v:.9g}" for v in row] for row in zip(*values.values(), strict=True))
    return text.getvalue()
