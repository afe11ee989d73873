"""The tables of `capture inspect` for what other commands made: fits, checkpoints, evaluations, proposals."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from capture_cli.common.quantities import MISSING, bound, estimated, percent, significant, with_unit
from capture_cli.model.effects.placed import placed_name
from capture_cli.store.inspection import Inspection

Rows = tuple[list[str], list[list[str]]]  # a head, and rows of as many cells


def result_tables(seen: Inspection) -> Iterator[Rows]:
    """Tables of an inspection; none where it has no result, or that is of a kind that is told in words."""
    if seen.result and seen.kind in _TABLES:
        yield from _TABLES[seen.kind](seen.result)


# --- fits ---


def _fit(result: Mapping[str, Any]) -> Iterator[Rows]:
    yield ["parameter", "value", "sd"], [[name, *_value(p)] for name, p in result["parameters"].items()]
    yield ["effect", "parameter", "value", "sd"], [row for e in result["effects"] for row in _effect(e)]
    yield ["verdict"], [[result["verdict"]]]


def _effect(effect: Mapping[str, Any]) -> list[list[str]]:
    placed = placed_name(effect["name"], effect["site"])
    if not effect["parameters"]:
        return [[placed, MISSING, MISSING, MISSING]]
    return [[placed, name, *_value(p)] for name, p in effect["parameters"].items()]


def _value(parameter: Mapping[str, Any]) -> list[str]:
    sd, unit = parameter.get("sd"), parameter.get("unit", "")
    return [estimated(parameter), with_unit(significant(sd, 2), unit)]


# --- checkpoints ---


def _identifier(result: Mapping[str, Any]) -> Iterator[Rows]:
    learned, training, histories = result["result"], result.get("training", {}), result["histories"]
    read = result["architecture"]
    facts = [
        ["identifier", result["identifier"]],
        ["reads", f"{read['tokens']} tokens, a window of {read['window']} rounds"],
        ["learned from", f"{learned['pairs']['trained']} histories of {histories['rounds']} rounds"],
        ["their search, noise", f"{histories['search']}, {histories['noise']}"],
        [
            "training",
            f"step {learned.get('best_step')} of {learned.get('steps')}, asked {training.get('steps')}",
        ],
        ["held-out loss", significant(learned.get("validation_loss"), 4)],
    ]
    yield ["learned", ""], facts
    errors, covered = (learned.get(key) or {} for key in ("mean_absolute_error", "coverage"))
    yield (
        ["parameter", "bounds", "mean error / range", "95 % intervals cover"],
        [
            [
                p["name"],
                with_unit(f"{bound(p['low'])} to {bound(p['high'])}", p["unit"]),
                significant(errors.get(p["name"]), 2),
                _share(covered.get(p["name"])),
            ]
            for p in result["parameters"]
        ],
    )


def _policy(result: Mapping[str, Any]) -> Iterator[Rows]:
    judged, training = result.get("result", {}), result.get("training", {})
    rows = [(result["policy"], judged), ("random", judged.get("random", {}))]
    head = ["policy", "episodes of training", "success", "reward"]
    yield (
        head,
        [
            [
                name,
                str(training.get("steps", MISSING)) if of is judged else MISSING,
                _share(of.get("success")),
                significant(of.get("reward")),
            ]
            for name, of in rows
        ],
    )
    for kind in ("parameters", "actions"):
        bounds = zip(result[kind], result["bounds"][kind], strict=True)
        yield [kind.removesuffix("s"), "bounds"], [[n, f"{bound(a)} to {bound(b)}"] for n, (a, b) in bounds]


# --- evaluations and proposals ---


def _evaluation(result: Mapping[str, Any]) -> Iterator[Rows]:
    """How each identifier does after the last round."""
    head = ["identifier", "mean error / range", "trajectory difference", "success", "95 % intervals cover"]
    cells = []
    for label, e in result["identifiers"].items():
        error, difference = e["parameter_difference"]["mean"], e["trajectory_difference"]
        shares = (_share(values[-1] if values else None) for values in (e["success"], e.get("coverage")))
        cells.append([label, significant(error[-1], 2), significant(difference[-1]), *shares])
    yield head, cells


def _proposal(result: Mapping[str, Any]) -> Iterator[Rows]:
    facts = [["proposed", str(result.get("text", MISSING))]]
    if "duration_s" in result:
        facts.append(["duration", with_unit(significant(result["duration_s"]), "s")])
    if "band_hz" in result:
        facts.append(["band", with_unit(" to ".join(map(bound, result["band_hz"])), "Hz")])
    yield ["proposal", ""], facts
    yield ["input", "peak"], [[name, significant(peak)] for name, peak in result.get("peaks", {}).items()]
    action = result.get("action")
    values = action.items() if isinstance(action, dict) else ()
    yield (
        ["action", "value"],
        [[name, with_unit(significant(v["value"], 4), v["unit"])] for name, v in values],
    )
    expected = result.get("expected_sd", {})
    yield ["parameter", "sd then"], [[name, significant(sd, 2)] for name, sd in expected.items()]


def _unfinished(result: Mapping[str, Any]) -> Iterator[Rows]:
    last: Mapping[str, Any] = result.get("last_evaluation", {})
    told = {name: str(v) if isinstance(v, int) else significant(v, 4) for name, v in last.items()}
    yield ["last evaluation", ""], [[name.replace("_", " "), value] for name, value in told.items()]


def _share(share: float | None) -> str:
    return MISSING if share is None else percent(share, 1)


_TABLES: Mapping[str, Callable[[Mapping[str, Any]], Iterator[Rows]]] = {
    "estimate": _fit,
    "diagnosis": _fit,
    "identifier": _identifier,
    "policy": _policy,
    "evaluation": _evaluation,
    "proposal": _proposal,
    "unfinished": _unfinished,
}
