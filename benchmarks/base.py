"""What a benchmark is: it measures, and says which figures it reached and which it was to reach."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from capture_cli.store.provenance import Provenance, write_json

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Figure:
    """One number. target: (low, high) that it should lie between, None for an open end or where there is no target."""

    name: str
    value: float
    unit: str = "1"
    target: tuple[float | None, float | None] | None = None

    @property
    def met(self) -> bool | None:
        """Whether the target was reached; None where there is none."""
        if self.target is None:
            return None
        low, high = self.target
        return (low is None or self.value >= low) and (high is None or self.value <= high)


@dataclass
class Result:
    """Figures for the table, and whatever else was measured (`details`, as JSON has it)."""

    figures: list[Figure] = field(default_factory=list)
    details: dict[str, Any] = field(default_factory=dict)


class Benchmark(ABC):
    """logs: how many logs per machine, where logs are recorded. pairs: how many histories at most.

    kills: how many runs are killed. minutes: how long inputs are drawn. folder: where results and unfinished work lie;
    `home` where none is named.
    """

    summary: str
    home = ROOT / "runs" / "benchmarks"

    def __init__(
        self, *, logs: int, folder: Path, pairs: int = 10_000, kills: int = 200, minutes: float = 20.0
    ):
        self.logs = logs
        self.pairs = pairs
        self.kills = kills
        self.minutes = minutes
        self.folder = folder

    @abstractmethod
    def run(self) -> Result:
        """Measure."""


def measure(name: str, benchmark: Benchmark) -> tuple[Result, Path]:
    """Run `benchmark` and write NAME.json into its folder; returns the result and the file."""
    options = {name: getattr(benchmark, name) for name in ("logs", "pairs", "kills", "minutes")}
    provenance = Provenance(f"benchmarks {name}", options, {})
    load = os.getloadavg()[0]
    result = benchmark.run()
    document = {
        "format": "capture/benchmark",
        "version": 1,
        "benchmark": name,
        "figures": [{**asdict(f), "met": f.met} for f in result.figures],
        "details": result.details,
        # the load tells how far the times may be believed: other work on the machine slows all of them
        "machine": {"cpus": os.cpu_count(), "load_before": round(load, 2)},
        "provenance": provenance.document(),
    }
    path = benchmark.folder / f"{name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, document)
    return result, path
