"""Columns whose name ends in another unit than they are read in, with no scale; of times, with another one."""

import math
import re

from capture_cli.log.checks.base import Check, Finding, warning
from capture_cli.model.sensor_units import unit_in_name

_SECONDS = re.compile(r"[^a-zA-Z](s|secs?|seconds?)\W*$")


class UnitsInNames(Check):
    def findings(self, given):
        task = given.task
        channels = [(f"input {c.name}", c) for c in task.inputs] + [
            (f"output {c.name}", c) for c in task.outputs
        ]
        for where, c in channels:
            named = unit_in_name(c.column, c.unit) if c.scale == 1 else None
            if named:
                key = f'column_unit = "{named[0]}"'
                yield _other(where, c.column, f"read as {c.unit}", named[0], key)
        scale, column = task.log.time_scale, task.log.time
        seconds = ("s", 1.0) if _SECONDS.search(column) else None
        named = unit_in_name(column, "s") or seconds
        if named and not math.isclose(named[1], scale, rel_tol=1e-6):
            key = f"[log] time_scale = {named[1]:.8g}"
            read = "read as s" if scale == 1 else f"read with time_scale = {scale:.8g}"
            yield _other("time", column, read, named[0], key)


def _other(where: str, column: str, read: str, written: str, key: str) -> Finding:
    return warning(
        where,
        f"column {column!r} is {read}, and its name ends in {written}",
        f"write {key} if it is in {written}, and import again",
    )
