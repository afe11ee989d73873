"""Parameters whose bounds are so wide that a fit may stand still where it begins."""

import sys
from collections.abc import Iterator

from capture_cli.common.quantities import bound, significant, with_unit
from capture_cli.log.checks.base import Finding, warning
from capture_cli.model.tasks.base import Task


def wide_bounds(task: Task) -> Iterator[Finding]:
    """Warnings of the parameters of `task` whose bounds span more than `wide` times their nominal value.

    Where bounds lie on both sides of 0, or the nominal value is 0, that is a place or a bias, and says no size: they
    are compared with `vast`.
    """
    # Times the nominal value: beyond it a finite difference, 1e-4 of the range, is longer than a tenth of the
    # value, and of the places drawn at random in the range, where other descents begin, hardly one is near
    # it.
    wide = 1000.0
    vast = 1e6  # in SI units: m, rad, N, N m
    for p in task.space:
        size, where = abs(p.nominal), f"parameter {p.name}"
        bounds = f"{bound(p.low)} to {with_unit(bound(p.high), p.unit)}"
        if size == 0 or p.low < 0 < p.high:
            if p.span > vast:
                what = f"its bounds, {bounds}, are wider than any place or bias of a machine"
                yield warning(where, what, f"give [parameters.{p.name}] bounds that the machine can have")
        elif p.span > wide * size:
            step = with_unit(significant(p.step * p.span, 2), p.unit)
            yield warning(
                where,
                f"its bounds, {bounds}, span {significant(p.span / size, 2)} times its nominal value, "
                f"{with_unit(significant(p.nominal, 3), p.unit)}: a fit sees slopes over {p.step:g} of the range, "
                f"{step}, and may stand still where it begins",
                f"give [parameters.{p.name}] bounds that the machine can have, say within a factor of 10 of nominal",
            )


def warn_of_wide_bounds(task: Task) -> None:
    """Warn on stderr of bounds so wide that a fit may take long, and be wrong."""
    for f in wide_bounds(task):
        print(f"warning: {f['where']}: {f['message']}\n  cure: {f['cure']}", file=sys.stderr)
