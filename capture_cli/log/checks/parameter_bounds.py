"""Bounds of parameters that are so wide that a fit may stand still, or far from what the model itself says."""

from collections.abc import Iterator

from capture_cli.common.quantities import bound, significant, with_unit
from capture_cli.common.warn import warn
from capture_cli.log.checks.base import Finding, warning
from capture_cli.model.parameters import Parameter
from capture_cli.model.target_names import attribute_of
from capture_cli.model.tasks.base import Task


def doubtful_bounds(task: Task) -> Iterator[Finding]:
    """Warnings of bounds that are too wide, or in another unit than the model, by its own value."""
    yield from _wide(task)
    yield from _far(task)


def _far(task: Task) -> Iterator[Finding]:
    # times: the model may be wrong by so much; of other units, as g, mm and degrees are, values are farther off
    far = 5.0
    for p in task.space:
        value, target = task.model_values.get(p.name, (0.0, ""))
        ends = sorted(abs(end) for end in (p.low, p.high))
        if value == 0 or p.low <= value <= p.high or ends[0] / far <= abs(value) <= ends[1] * far:
            continue
        yield warning(
            f"parameter {p.name}",
            f"the model's own value, {significant(value, 3)}, is far outside its bounds, {_bounds(p)}",
            f"give bounds of {target}, whose unit is {attribute_of(target).unit}, or, if they are, a nominal value "
            "inside them",
        )


def _wide(task: Task) -> Iterator[Finding]:
    """Of those that span more than `wide` times the nominal value.

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
        bounds = _bounds(p)
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


def _bounds(parameter: Parameter) -> str:
    return f"{bound(parameter.low)} to {with_unit(bound(parameter.high), parameter.unit)}"


def warn_of_bounds(task: Task) -> None:
    """Warn on stderr of bounds by which a fit may take long, and be wrong."""
    for f in doubtful_bounds(task):
        warn(f"{f['where']}: {f['message']}", f["cure"])
