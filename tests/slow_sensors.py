"""Logs of the benchmarks' machines in which a sensor is slower than the others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from capture_cli.log.measured_log import MeasuredLog

MACHINES = Path(__file__).parents[1] / "benchmarks" / "machines"
EVERY = 4  # steps of the log, from one sample of the slow sensor to the next


def with_sparse(folder: Path, machine: str, *sensors: str, **replaced: str) -> Path:
    """The task.toml of a machine of the benchmarks, with outputs that are sparse and texts `replaced`."""
    text = (MACHINES / machine / "task.toml").read_text()
    for sensor in sensors:
        text = text.replace(f"[outputs.{sensor}]", f"[outputs.{sensor}]\nsparse = true")
    for old, new in replaced.items():
        text = text.replace(f"{old} =", f"{old} = {new} #")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.xml").write_text((MACHINES / machine / "model.xml").read_text())
    (folder / "task.toml").write_text(text)
    return folder / "task.toml"


def regular(steps: int, generator: np.random.Generator) -> np.ndarray:
    return np.arange(generator.integers(EVERY), steps, EVERY)


def jittered(steps: int, generator: np.random.Generator) -> np.ndarray:
    """Samples 2 to 6 steps apart."""
    at = np.cumsum(generator.integers(2, 7, steps // 2))
    return at[at < steps]


def thinned(log: MeasuredLog, output: str, choose, seed: int = 0) -> MeasuredLog:
    """The log with samples of an output at the steps of each episode that choose(steps, generator) gives."""
    generator = np.random.default_rng(seed)
    kept = np.concatenate([e.start + choose(e.stop - e.start, generator) for e in log.episodes])
    lost = np.setdiff1d(np.arange(len(log.time)), kept)
    outputs = log.outputs.copy()
    outputs[lost, log.output_names.index(output)] = np.nan
    return replace(log, outputs=outputs, sparse=log.sparse | {output})
