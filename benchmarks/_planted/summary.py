"""What rows say together: shares with their intervals, what was not right, and two versions side by side."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks._planted.outcomes import (
    EQUIVALENTS,
    FALSE_ALARM,
    GOOD,
    HONEST,
    IMITATED,
    NEAR_FLOOR,
    RIGHT,
    SUMS,
)
from benchmarks._planted.rows import NOTHING_TO_FIND, Key, Row
from benchmarks._planted_logs.cases import LEFT, NOTHING, PAIR, PLANTED, UNKNOWN, WEAK
from benchmarks._planted_logs.dresses import PLAIN
from benchmarks._share import share
from benchmarks.base import Figure

Target = tuple[float | None, float | None] | None


def summary(rows: Iterable[Row]) -> dict[str, Any]:
    """Of one dress, as JSON has it."""
    asked = [r for r in rows if r["outcome"] != NOTHING_TO_FIND]
    kind = {k: [r for r in asked if r["kind"] == k] for k in (PLANTED, PAIR, NOTHING, WEAK)}
    unknown = [r for r in asked if r["kind"] in (UNKNOWN, LEFT)]
    return {
        "logs": len(asked),
        "outcomes": {
            k: Counter(r["outcome"] for r in asked if r["kind"] == k) for k in _values(asked, "kind")
        },
        "right": _share(kind[PLANTED], is_right),
        "near_floor": _share(kind[PLANTED], lambda r: r.get("after", np.inf) <= NEAR_FLOOR),
        "false_alarms": _share(kind[NOTHING], lambda r: r["outcome"] == FALSE_ALARM),
        "pairs": _share(kind[PAIR], is_right),
        "weak": _share(kind[WEAK], is_right),
        "not_explained_away": _share(unknown, lambda r: r["outcome"] in (HONEST, IMITATED)),
        "right_by_machine": _by(kind[PLANTED], "machine"),
        "right_by_magnitude": _by(kind[PLANTED], "magnitude"),
        "seconds": _median(asked, "seconds"),
        "cpu_seconds": _median(asked, "cpu_seconds"),
    }


def figures(found: Mapping[str, Any], dress: str) -> list[Figure]:
    """The numbers of a `summary` with their targets."""
    plain = dress == PLAIN
    shares: tuple[tuple[str, str, Target], ...] = (
        ("right, of one effect that doubles the floor", "right", (0.97, None) if plain else None),
        ("  error on unseen data within 1.2 floors, of these", "near_floor", (0.97, None) if plain else None),
        ("false alarms, of nothing missing", "false_alarms", (None, 0.01 if plain else 0.02)),
        ("both right, of two effects", "pairs", (0.85, None) if plain else None),
        ("found, of effects that only a parameter shows", "weak", (0.8, None)),
        ("not explained away, of effects outside the catalogue", "not_explained_away", (1.0, None)),
    )
    told = [
        Figure(f"{dress}: {name} ({_counted(found[k])})", found[k]["share"], target=target)
        for name, k, target in shares
        if found[k] is not None
    ]
    if found["cpu_seconds"] is not None:
        told.append(Figure(f"{dress}: median CPU of a log", found["cpu_seconds"], "s"))
    return told


def page(dresses: Mapping[str, Sequence[Row]]) -> str:
    """summary.md: every log that was not right, and what counts as right because no log can tell."""
    lines = ["# Planted effects", "", "`python -m benchmarks.planted` makes this page.", ""]
    lines += ["| dress | planted | machine | error | found | outcome |", "|---|---|---|---:|---|---|"]
    for dress, rows in dresses.items():
        for row in rows:
            if row["outcome"] not in (*GOOD, NOTHING_TO_FIND):
                planted, found = row["planted"], [e["effect"] for e in row.get("found", ())]
                lines.append(
                    f"| {dress} | {_names(planted)} | {row['machine']} | {row['error']:.3g} | {_names(found)} "
                    f"| {row['outcome']} |"
                )
    lines += ["", "Counted as right, because no log can tell them apart:", ""]
    lines += [
        f"- {e.machine}: {_names(sorted(e.planted))} found as {_names(sorted(e.found))}: {e.why}"
        for e in EQUIVALENTS
    ]
    lines += [
        f"- any: {_names(parts)} at a joint found as `{name}`: its law is their sum"
        for name, parts in SUMS.items()
    ]
    return "\n".join(lines) + "\n"


def compare(a: Mapping[Key, Row], b: Mapping[Key, Row]) -> dict[str, Any]:
    """Two versions, or two dresses, on the cases that both were asked about, by kind.

    Rows of one dress whose logs are not the same numbers are left out and counted (`other_logs`). p_value: McNemar's
    exact test (McNemar 1947) of whether either is right more often. cpu_ratio: median of b over a.
    """
    from scipy.stats import binomtest

    both = [(a[k], b[k]) for k in a if k in b and NOTHING_TO_FIND not in (a[k]["outcome"], b[k]["outcome"])]
    alike = [(p, q) for p, q in both if p["dress"] != q["dress"] or p["log"] == q["log"]]
    kinds = {}
    for kind in [*_values((p for p, _ in alike), "kind"), "all"]:
        own = [(is_good(p), is_good(q)) for p, q in alike if kind in (p["kind"], "all")]
        counts = Counter(own)
        only_a, only_b = counts[True, False], counts[False, True]
        kinds[kind] = {
            "both": counts[True, True],
            "only_a": only_a,
            "only_b": only_b,
            "neither": counts[False, False],
            "p_value": float(binomtest(only_a, only_a + only_b).pvalue) if only_a + only_b else 1.0,
        }
    ratios = [
        q["cpu_seconds"] / p["cpu_seconds"] for p, q in alike if "cpu_seconds" in p and "cpu_seconds" in q
    ]
    return {
        "kinds": kinds,
        "other_logs": len(both) - len(alike),
        "cpu_ratio": float(np.median(ratios)) if ratios else None,
        "differ": [(p, q) for p, q in alike if is_good(p) != is_good(q)],
    }


def is_right(row: Row) -> bool:
    return row["outcome"] in RIGHT


def is_good(row: Row) -> bool:
    """Whether the answer is what it should be, of any kind of case."""
    return row["outcome"] in GOOD


def _share(rows: Sequence[Row], is_hit: Callable[[Row], bool]) -> dict[str, Any] | None:
    return share(sum(is_hit(r) for r in rows), len(rows))


def _counted(found: Mapping[str, Any]) -> str:
    return f"{found['hits']} of {found['of']}; {100 * found['low']:.1f} to {100 * found['high']:.1f} %"


def _by(rows: Sequence[Row], name: str) -> dict[str, Any]:
    return {f"{v}": _share([r for r in rows if r[name] == v], is_right) for v in _values(rows, name)}


def _values(rows: Iterable[Row], name: str) -> list[Any]:
    return sorted({r[name] for r in rows})


def _median(rows: Iterable[Row], name: str) -> float | None:
    found = [r[name] for r in rows if name in r]
    return float(np.median(found)) if found else None


def _names(effects: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in effects) or "nothing"
