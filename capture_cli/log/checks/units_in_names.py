"""Columns whose name ends in another unit than they are read in, with no scale."""

from capture_cli.log.checks.base import Check, warning
from capture_cli.model.sensor_units import unit_in_name


class UnitsInNames(Check):
    def findings(self, given):
        task = given.task
        columns = [
            *((f"input {c.name}", c.column, c.unit, c.scale) for c in task.inputs),
            *((f"output {c.name}", c.column, c.unit, c.scale) for c in task.outputs),
            ("time", task.log.time, "s", task.log.time_scale),
        ]
        for where, column, unit, scale in columns:
            named = unit_in_name(column, unit) if scale == 1 else None
            if named:
                written, factor = named
                key = f"[log] time_scale = {factor:.8g}" if where == "time" else f'column_unit = "{written}"'
                yield warning(
                    where,
                    f"column {column!r} is read as {unit}, and its name ends in {written}",
                    f"write {key} if it is in {written}, and import again",
                )
