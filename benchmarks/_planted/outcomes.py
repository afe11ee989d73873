"""What a diagnosis of a log with a known effect is worth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from benchmarks._planted.cases import LEFT, NOTHING, UNKNOWN, Case
from capture_cli.reports.diagnosis_findings import placed

NEAR_FLOOR = 1.2
EXACT, AMONG, TIED, EQUIVALENT = "exact", "among others", "tied", "equivalent"
WRONG, ONE_OF_TWO, MISSED, UNEXPLAINED = "wrong", "one of two", "missed", "unexplained"
SILENT, FALSE_ALARM = "silent", "false alarm"
IMITATED, HONEST = "imitated", "honest"
RIGHT = (EXACT, AMONG, TIED, EQUIVALENT)


@dataclass(frozen=True)
class Equivalent:
    """On `machine`, any of `found` gives, at some size, the outputs of any of `planted`: no log can tell."""

    machine: str
    planted: frozenset[str]
    found: frozenset[str]
    why: str


def _alike(machine: str, names: str, why: str) -> Equivalent:
    return Equivalent(machine, frozenset(names.split()), frozenset(names.split()), why)


def _covers(machine: str, planted: str, found: str, why: str) -> Equivalent:
    return Equivalent(machine, frozenset(planted.split()), frozenset(found.split()), why)


_LATE = "the machine does not change with time: late inputs give the same outputs, late"
_TURNED = "a link turned on the last joint: its centre of mass is elsewhere, as far from the joint"
# A bias of a control is not a constant force: it moves the limits of the actuator, which these logs reach.
EQUIVALENTS = (
    _alike(
        "slider",
        "constant-force@x spring-preload@x gravity-tilt sensor-bias@q",
        "one joint with a linear spring: each is a constant added to its force",
    ),
    _covers(
        "slider",
        "preloaded-spring@x",
        "constant-force@x spring-preload@x gravity-tilt sensor-bias@q",
        "the stiffness is declared, and takes that of another spring: a constant force is left",
    ),
    _alike("slider", "control-delay@drive sensor-delay@q", _LATE),
    _alike(
        "slider",
        "control-lag@drive sensor-low-pass@q",
        "the machine is linear and does not change with time: a filter before it is a filter behind it",
    ),
    _alike(
        "cart_pole",
        "constant-force@x spring-preload@x sensor-bias@cart",
        "a constant force on the cart, which nothing but a linear spring ties to its place",
    ),
    _alike("cart_pole", "control-delay@drive sensor-delay", _LATE),
    _alike("arm", "control-delay sensor-delay", _LATE),
    _alike("pan_tilt", "control-delay sensor-delay", _LATE),
    _alike(
        "pan_tilt",
        "control-lag sensor-low-pass",
        "a filter before a servo is one behind it, where gravity is weak",
    ),
    _alike(
        "pan_tilt",
        "constant-force@pan sensor-bias@pan",
        "a servo that holds against a constant force stands so much off, whichever way it points",
    ),
    _covers(
        "pan_tilt", "com-shift@yoke", "reflected-inertia@pan", "a body that only turns about an upright axis"
    ),
    _covers(
        "pan_tilt",
        "payload@camera com-shift@camera",
        "gravity-magnitude",
        "the mass is declared: inertia and weight about the axis are as with another gravity",
    ),
    _covers("cart_pole", "sensor-bias@pole", "com-shift@pole", _TURNED),
    _covers("arm", "sensor-bias@q2", "com-shift@fore", _TURNED),
    _alike("arm", "sensor-bias@q1 gravity-tilt", "the arm turned in its plane, or gravity the other way"),
    _covers(
        "puck",
        "constant-force@x constant-force@y",
        "gravity-tilt",
        "one body on a plane: a tilt is a force, and what it takes of the weight is in the declared friction",
    ),
    _alike("puck", "sensor-bias@x geom-scale@wall", "where along x the sensor sees the wall's face"),
)


def judge(case: Case, verdict: str, effects: list[dict[str, Any]], test_error: float) -> str:
    """The outcome of a diagnosis; effects: as in diagnosis.json. test_error over the noise floor."""
    accepted = [placed(e) for e in effects]
    tied = {name for e in effects for name in e["tied_with"]}
    if case.kind == NOTHING:
        return FALSE_ALARM if accepted or verdict != "explained" else SILENT
    if case.kind in (UNKNOWN, LEFT):
        return _judge_unknown(verdict, test_error)
    if sorted(accepted) == sorted(case.planted):
        return EXACT
    if verdict == "unexplained":
        return UNEXPLAINED
    hits = [_hit(case.machine, planted, accepted, tied) for planted in case.planted]
    if all(hits):
        return max(hits, key=RIGHT.index)
    if any(hits):
        return ONE_OF_TWO
    return MISSED if verdict == "explained" else WRONG


def _hit(machine: str, planted: str, accepted: list[str], tied: set[str]) -> str | None:
    """How an effect was found, or None."""
    if planted in accepted:
        return AMONG
    if planted in tied:
        return TIED
    return EQUIVALENT if _equivalent(machine, planted, {*accepted, *tied}) else None


def _judge_unknown(verdict: str, test_error: float) -> str:
    if verdict == "unexplained":
        return HONEST
    if verdict == "explained":
        return MISSED
    return IMITATED if test_error <= NEAR_FLOOR else WRONG


def _equivalent(machine: str, planted: str, names: set[str]) -> bool:
    return any(machine == e.machine and planted in e.planted and names & e.found for e in EQUIVALENTS)
