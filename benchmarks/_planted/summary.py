"""What the lines say together: shares with their intervals, power, and what was found for what was planted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from benchmarks._planted.cases import LEFT, MAGNITUDES, NOTHING, PAIR, PLANTED, UNKNOWN
from benchmarks._planted.diagnosing import ABSORBED, FAILED, OUT_OF_REACH
from benchmarks._planted.outcomes import EQUIVALENTS, FALSE_ALARM, HONEST, IMITATED, NEAR_FLOOR, RIGHT
from benchmarks._share import share
from benchmarks.base import Figure

VISIBLE = np.sqrt(1 + 2.0**2)  # an error that the effect has raised by more than twice the floor
NOTHING_FOUND, NONE_OF_THESE = "(nothing)", "(none of these)"

Row = dict[str, Any]


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """summary.json, less its provenance."""
    planted = diagnosed(rows, PLANTED)
    visible = [r for r in planted if before(r) > VISIBLE]
    pairs = diagnosed(rows, PAIR)
    null = diagnosed(rows, NOTHING)
    unknown = diagnosed(rows, UNKNOWN, LEFT)
    return {
        "logs": len(rows),
        "kinds": Counter(r["kind"] for r in rows),
        "outcomes": {kind: Counter(r["outcome"] for r in _of(rows, kind)) for kind in _kinds(rows)},
        "false_alarms": _share(null, lambda r: r["outcome"] == FALSE_ALARM),
        "right_where_visible": _share(visible, _is_right),
        "near_floor_where_visible": _share(visible, _is_near_floor),
        "power": {
            f"{m:g}": _share([r for r in planted if r["magnitude"] == m], _is_right) for m in MAGNITUDES
        },
        "pairs": {
            "both_right": _share(pairs, _is_right),
            "near_floor": _share(pairs, _is_near_floor),
            "outcomes": Counter(r["outcome"] for r in pairs),
        },
        "by_machine": _by(visible, "machine", _is_right),
        "by_effect": _by(visible, "effect", _is_right),
        "outside": {
            "never_said_to_be_explained": _share(
                [r for r in unknown if before(r) > VISIBLE], lambda r: r["outcome"] in (HONEST, IMITATED)
            ),
            "outcomes": {
                e: Counter(r["outcome"] for r in unknown if r["effect"] == e) for e in _names(unknown)
            },
        },
        "nothing_to_find": sorted(
            {_place(r) for r in rows if r["outcome"] == ABSORBED and r["kind"] == PLANTED}
        ),
        "seconds": _spread(r["seconds"] for r in rows if "seconds" in r),
        "cpu_seconds": _spread(r["cpu_seconds"] for r in rows if "cpu_seconds" in r),
        "rollouts": _spread(r["rollouts"] for r in rows if "rollouts" in r),
        "equivalents": [
            {"machine": e.machine, "planted": sorted(e.planted), "found": sorted(e.found), "why": e.why}
            for e in EQUIVALENTS
        ],
    }


def figures(found: dict[str, Any]) -> list[Figure]:
    """The numbers with their targets. found: `summary`."""
    targets = (
        ("right effect where it more than doubles the floor", found["right_where_visible"], (0.95, None)),
        ("  test error within 1.2 x the floor", found["near_floor_where_visible"], (0.95, None)),
        ("false alarms", found["false_alarms"], (None, 0.02)),
        (
            "outside the catalogue: not explained away",
            found["outside"]["never_said_to_be_explained"],
            (1.0, None),
        ),
        ("both of two effects at once", found["pairs"]["both_right"], None),
        ("  test error within 1.2 x the floor", found["pairs"]["near_floor"], None),
        *((f"right effect, error {m} x the noise", s, None) for m, s in found["power"].items()),
    )
    rows = []
    for name, one, target in targets:
        if one is not None:
            rows.append(Figure(f"{name} ({one['hits']} of {one['of']})", one["share"], target=target))
    return rows


def before(row: Row) -> float:
    """Test error of the declared model, refitted, over the true noise."""
    return row["before"]["test"] * float(np.sqrt(np.mean(np.square(row["floor_over_noise"]))))


def diagnosed(rows: Iterable[Row], *kinds: str) -> list[Row]:
    """Rows of these kinds in which there was something to diagnose, and it did not break down."""
    left_out = (ABSORBED, OUT_OF_REACH, FAILED)
    return [r for r in rows if r["kind"] in kinds and r["outcome"] not in left_out]


def found_for(row: Row) -> str:
    """The name of the effect that was accepted first, without its site."""
    if row["found"]:
        return row["found"][0]["effect"].split("@")[0]
    return NOTHING_FOUND if row["verdict"] == "explained" else NONE_OF_THESE


def confusion(rows: Sequence[Row]) -> tuple[list[str], list[str], np.ndarray]:
    """What was planted, what was found, and how often (planted, found)."""
    planted = sorted({r["effect"] for r in rows})
    others = sorted({found_for(r) for r in rows} - set(planted))
    found = [*planted, *others]
    counts = np.zeros((len(planted), len(found)), dtype=int)
    for row in rows:
        counts[planted.index(row["effect"]), found.index(found_for(row))] += 1
    return planted, found, counts


def _is_right(row: Row) -> bool:
    return row["outcome"] in RIGHT


def _is_near_floor(row: Row) -> bool:
    return row["after"]["test"] <= NEAR_FLOOR


def _share(rows: Sequence[Row], is_hit) -> dict[str, Any] | None:
    return share(sum(is_hit(r) for r in rows), len(rows))


def _by(rows: Sequence[Row], name: str, is_hit) -> dict[str, Any]:
    return {k: _share([r for r in rows if r[name] == k], is_hit) for k in sorted({r[name] for r in rows})}


def _of(rows: Sequence[Row], kind: str) -> list[Row]:
    return [r for r in rows if r["kind"] == kind]


def _kinds(rows: Sequence[Row]) -> list[str]:
    return sorted({r["kind"] for r in rows})


def _names(rows: Sequence[Row]) -> list[str]:
    return sorted({r["effect"] for r in rows})


def _place(row: Row) -> str:
    return f"{row['machine']}: {row['effect']}" + (f"@{row['site']}" if row["site"] else "")


def _spread(values: Iterable[float]) -> dict[str, float] | None:
    found = list(values)
    if not found:
        return None
    return {
        "median": float(np.median(found)),
        "p90": float(np.quantile(found, 0.9)),
        "sum": float(np.sum(found)),
    }
