"""What a diagnosis of a log with a known effect is worth."""

from __future__ import annotations

from typing import Any

from benchmarks._planted.cases import LEFT, NOTHING, UNKNOWN, Case

NEAR_FLOOR = 1.2
EXACT, AMONG, TIED, EQUIVALENT = "exact", "among others", "tied", "equivalent"
WRONG, MISSED, UNEXPLAINED = "wrong", "missed", "unexplained"
SILENT, FALSE_ALARM = "silent", "false alarm"
IMITATED, HONEST = "imitated", "honest"
RIGHT = (EXACT, AMONG, TIED, EQUIVALENT)

# Effects of one machine with the same outputs, whatever their sizes: no log can tell them apart. (machine, names, why)
# A bias of a control is not among them: it moves the limits of the actuator, which these logs reach.
EQUIVALENTS: tuple[tuple[str, frozenset[str], str], ...] = (
    (
        "slider",
        frozenset({"constant-force@x", "spring-preload@x", "gravity-tilt", "sensor-bias@q"}),
        "one joint with a linear spring: each is a constant added to its force",
    ),
    (
        "slider",
        frozenset({"control-delay@drive", "sensor-delay@q"}),
        "the machine does not change with time: late inputs give the same outputs, late",
    ),
    (
        "slider",
        frozenset({"control-lag@drive", "sensor-low-pass@q"}),
        "the machine is linear and does not change with time: a filter before it is a filter behind it",
    ),
    (
        "cart_pole",
        frozenset({"constant-force@x", "spring-preload@x", "sensor-bias@cart"}),
        "a constant force on the cart, whose spring is linear and which nothing else ties to its place",
    ),
    (
        "cart_pole",
        frozenset({"control-delay@drive", "sensor-delay"}),
        "the machine does not change with time: late inputs give the same outputs, late",
    ),
    (
        "arm",
        frozenset({"sensor-bias@q1", "gravity-tilt"}),
        "the arm turned in its plane and gravity turned the other way",
    ),
    (
        "puck",
        frozenset({"gravity-tilt", "constant-force@x", "constant-force@y"}),
        "one body on a plane: a tilt is a constant force, and its weight is in the friction that is declared",
    ),
    (
        "puck",
        frozenset({"sensor-bias@x", "geom-scale@wall"}),
        "where along x the wall's face is, as seen by the sensor",
    ),
)


def judge(case: Case, verdict: str, effects: list[dict[str, Any]], test_error: float) -> str:
    """The outcome of a diagnosis; effects: as in diagnosis.json. test_error over the noise floor."""
    accepted = [_placed(e) for e in effects]
    tied = {name for e in effects for name in e["tied_with"]}
    if case.kind == NOTHING:
        return FALSE_ALARM if accepted or verdict != "explained" else SILENT
    if case.kind in (UNKNOWN, LEFT):
        return _judge_unknown(verdict, test_error)
    if accepted == [case.planted]:
        return EXACT
    if case.planted in accepted:
        return AMONG
    if case.planted in tied:
        return TIED
    if _equivalent(case, {*accepted, *tied}):
        return EQUIVALENT
    if verdict == "explained":
        return MISSED
    return UNEXPLAINED if verdict == "unexplained" else WRONG


def _judge_unknown(verdict: str, test_error: float) -> str:
    if verdict == "unexplained":
        return HONEST
    if verdict == "explained":
        return MISSED
    return IMITATED if test_error <= NEAR_FLOOR else WRONG


def _placed(effect: dict[str, Any]) -> str:
    return effect["name"] + (f"@{effect['site']}" if effect["site"] else "")


def _equivalent(case: Case, found: set[str]) -> bool:
    return any(
        case.machine == machine and case.planted in names and found & names
        for machine, names, _ in EQUIVALENTS
    )
