"""What a diagnosis of a log with a known answer is worth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks._planted_logs.cases import LEFT, NOTHING, UNKNOWN, Case
from benchmarks._planted_logs.dresses import FILTERED
from capture_cli.model.effects.placed import placed_name

NEAR_FLOOR = 1.2
EXACT, TIED, EQUIVALENT = "exact", "tied", "equivalent"
BESIDE, ONE_OF_TWO, WRONG, MISSED, UNEXPLAINED = (
    "beside others",
    "one of two",
    "wrong",
    "missed",
    "unexplained",
)
SILENT, FALSE_ALARM = "silent", "false alarm"
IMITATED, HONEST = "imitated", "honest"
RIGHT = (EXACT, TIED, EQUIVALENT)
GOOD = (*RIGHT, SILENT, IMITATED, HONEST)
# What the logger itself does to the sensors: neither right nor wrong beside what was planted.
OF_THE_LOGGER = {FILTERED: ("sensor-low-pass", "sensor-second-order-low-pass", "sensor-delay")}


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
_FILTERED = "the machine is linear and does not change with time: a filter before it is a filter behind it"
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
    _alike("slider", "control-lag@drive sensor-low-pass@q", _FILTERED),
    _alike("slider", "control-second-order-lag@drive sensor-second-order-low-pass@q", _FILTERED),
    _alike(
        "cart_pole",
        "constant-force@x spring-preload@x sensor-bias@cart",
        "a constant force on the cart, which nothing but a linear spring ties to its place",
    ),
    _alike("cart_pole", "control-delay@drive sensor-delay", _LATE),
    _covers(
        "cart_pole",
        "payload@pole",
        "com-shift@pole",
        "both masses are declared: what shows is their sum, the first moment about the hinge, and the inertia",
    ),
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
# An effect whose law is the sum of those of others at the same joint: -k (q - rest) is a spring and a constant force.
SUMS = {"preloaded-spring": ("constant-force", "linear-stiffness")}


def judge(case: Case, document: Mapping[str, Any]) -> str:
    """The outcome of a diagnosis.json of the case's log."""
    verdict = document["verdict"]
    effects = [e for e in document["effects"] if not _of_the_logger(case, e)]
    if case.kind == NOTHING:
        return FALSE_ALARM if effects or verdict == "unexplained" else SILENT
    if case.kind in (UNKNOWN, LEFT):
        return _judge_unknown(verdict, test_error(document))
    return _judge_known(case, verdict, effects)


def test_error(document: Mapping[str, Any]) -> float:
    """Of the last model, on what no fit saw, over the noise floor."""
    return document["after"]["test"]["normalized"]


def placed(effect: Mapping[str, Any]) -> str:
    """EFFECT@SITE of an effect in a diagnosis.json."""
    return placed_name(effect["name"], effect["site"])


def _of_the_logger(case: Case, effect: Mapping[str, Any]) -> bool:
    """Whether an effect that was not planted is what the logger did, or what no log can tell from that."""
    if any(_hit(case, planted, effect) for planted in case.planted):
        return False
    own = [e for e in EQUIVALENTS if e.machine == case.machine and placed(effect) in e.found]
    alike = {placed(effect), *effect["tied_with"]}.union(*(e.planted for e in own))
    return not {name.partition("@")[0] for name in alike}.isdisjoint(OF_THE_LOGGER.get(case.dress, ()))


def _judge_known(case: Case, verdict: str, effects: Sequence[Mapping[str, Any]]) -> str:
    """Right is who names every effect that is there, and none besides, and says that they explain the log."""
    if verdict == "unexplained":
        return UNEXPLAINED
    hits = {(p, placed(e)): _hit(case, p, e) for p in case.planted for e in effects}
    of_planted = [[hits[p, placed(e)] for e in effects if hits[p, placed(e)]] for p in case.planted]
    if not any(of_planted):
        return WRONG if effects else MISSED
    if not all(of_planted):
        return ONE_OF_TWO
    if not all(any(hits[p, placed(e)] for p in case.planted) for e in effects):
        return BESIDE
    return max((min(own, key=RIGHT.index) for own in of_planted), key=RIGHT.index)


def _hit(case: Case, planted: str, effect: Mapping[str, Any]) -> str | None:
    """How an effect that was found stands for one that was planted; None where it does not."""
    if placed(effect) == planted:
        return EXACT
    if planted in effect["tied_with"]:
        return TIED
    if planted in (parts := _sum(effect)) and parts <= set(case.planted):
        return EQUIVALENT
    return EQUIVALENT if _equivalent(case.machine, planted, {placed(effect), *effect["tied_with"]}) else None


def _sum(effect: Mapping[str, Any]) -> set[str]:
    """EFFECT@SITE of those that an effect is the sum of."""
    return {placed_name(name, effect["site"]) for name in SUMS.get(effect["name"], ())}


def _judge_unknown(verdict: str, error: float) -> str:
    if verdict == "unexplained":
        return HONEST
    if verdict == "explained":
        return MISSED
    return IMITATED if error <= NEAR_FLOOR else WRONG


def _equivalent(machine: str, planted: str, names: set[str]) -> bool:
    return any(machine == e.machine and planted in e.planted and names & e.found for e in EQUIVALENTS)
