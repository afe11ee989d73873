"""One case from the first to the last: record the log, diagnose it in memory, judge, and put it on one line."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks._planted.cases import LEFT, Case, Plant, experiment, size
from benchmarks._planted.machines import EPISODES, Experiment
from benchmarks._planted.outcomes import judge
from capture_cli.protocol import attribution
from capture_cli.protocol.explain import Settings
from capture_cli.protocol.prepare import prepare
from capture_cli.reports.diagnosis_findings import placed
from capture_cli.stages.diagnose import diagnose_prepared
from capture_cli.stages.progress import Progress
from capture_cli.stores.measured_log import MeasuredLog
from capture_cli.tasks.base import Task

KEPT = 8  # candidates on a line
ABSORBED, OUT_OF_REACH, FAILED = "absorbed", "out of reach", "failed"


def line(case: Case, known_size: float | None = None, episodes: int = EPISODES) -> dict[str, Any]:
    """What came of `case`, as JSON has it. known_size: of the first effect, found before (0: none does)."""
    began = time.perf_counter()
    made, plants = experiment(case, episodes)
    row: dict[str, Any] = {}
    planted = []
    for prefix, plant in zip(("", "second_"), plants, strict=False):
        known = known_size if not planted else None
        found = known if known is not None else _size(made, plant, case.magnitude)
        row[f"{prefix}size"] = found
        if not found:
            return {**row, **_nothing_to_find(made, plant), "seconds_to_size": _since(began)}
        values = plant.values(found)
        row[f"{prefix}values"] = dict(zip(plant.effect.space.names, values.tolist(), strict=True))
        planted.append((plant.effect, values))
    log = made.log(planted)
    row["seconds_to_size"] = _since(began)
    if log is None:
        return {**row, "outcome": OUT_OF_REACH}  # two that each can be simulated alone
    began, cpu = time.perf_counter(), time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.zarr"
        log.write(path)
        with _catalogue_without(case):
            document = diagnose(MeasuredLog.read(path), made.task, case.seed)
    row |= {"seconds": _since(began), "cpu_seconds": round(time.process_time() - cpu, 3)}
    return {**row, **_told(case, document, made)}


def _size(made: Experiment, plant: Plant, magnitude: float) -> float:
    return size(lambda s: made.left(made.log([(plant.effect, plant.values(s))])), magnitude) or 0.0


def _nothing_to_find(made: Experiment, plant: Plant) -> dict[str, Any]:
    """An effect whose whole range leaves less than the magnitude asked for."""
    left = made.left(made.log([(plant.effect, plant.values(1.0))]))
    return {"outcome": ABSORBED if left < 0.5 else OUT_OF_REACH, "left_at_most": left}


def diagnose(log: MeasuredLog, task: Task, seed: int) -> dict[str, Any]:
    """diagnosis.json of `log` with the defaults of `capture diagnose`, on one thread."""
    prepared = prepare(log, task, window=None, test=None, seed=seed)
    progress = Progress("diagnose", "model", quiet=True)
    settings = Settings(seed=seed, threads=1)
    return diagnose_prepared(prepared, task.space.nominal, settings, progress).document


@contextmanager
def _catalogue_without(case: Case) -> Iterator[None]:
    """For effects that are to be left out of the catalogue."""
    whole = attribution.all_candidates

    def without(model):
        return [c for c in whole(model) if case.kind != LEFT or c.placed.kind != case.effect]

    with patch.object(attribution, "all_candidates", without):
        yield


def _told(case: Case, document: dict[str, Any], made: Experiment) -> dict[str, Any]:
    first, last = document["stages"][0], document["stages"][-1]
    floor = np.array(list(document["noise_floor"].values()))
    candidates = document["candidates"]
    own = [c for c in candidates if placed(c) in case.planted]
    return {
        "outcome": judge(case, document["verdict"], document["effects"], last["test"]["normalized"]),
        "verdict": document["verdict"],
        "found": [
            {
                "effect": placed(e),
                "tied_with": e["tied_with"],
                "values": {k: p["value"] for k, p in e["parameters"].items()},
                "p_value": e["p_value"],
                "p_select": e["p_select"],
            }
            for e in document["effects"]
        ],
        "before": {k: first[k]["normalized"] for k in ("fit", "select", "test")},
        "after": {k: last[k]["normalized"] for k in ("fit", "select", "test")},
        "floor_over_noise": (floor / made.noise_sd).tolist(),
        "planted_candidate": [{**c, "rank": candidates.index(c)} for c in own],
        "candidates": candidates[:KEPT],
        "rollouts": document["rollouts"]["simulated"],
    }


def _since(began: float) -> float:
    return round(time.perf_counter() - began, 3)
