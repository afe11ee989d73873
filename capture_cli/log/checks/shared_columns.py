"""Channels that read the same column as another."""

from capture_cli.log.checks.base import Check, warning
from capture_cli.model.tasks.base import Channel


class SharedColumns(Check):
    def findings(self, given):
        task = given.task
        driving: dict[str, Channel] = {}
        for channel in task.inputs:
            if driving.setdefault(channel.column, channel) is not channel:
                yield warning(
                    f"input {channel.name}",
                    f"reads column {channel.column!r}, as input {driving[channel.column].name} does",
                    "nothing to do if one command drives both; otherwise give each its column, and import the files "
                    "again",
                )
        readers = {c.column: ("input", c) for c in reversed(task.inputs)}
        for output in task.outputs:
            kind, first = readers.setdefault(output.column, ("output", output))
            if first is not output:
                driven = "what drives the machine is no measurement of it"
                why = driven if kind == "input" else "it counts twice"
                yield warning(
                    f"output {output.name}",
                    f"reads column {output.column!r}, as {kind} {first.name} does: {why}",
                    "give the column that this output is measured by, or remove it, and import the files again",
                )
