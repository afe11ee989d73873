"""Do 95 % intervals hold the truth 95 times in 100? Are false alarms rare? Is nothing lost without noise?

Logs are recorded from three machines and the two built-in tasks with parameters drawn at random within their ranges,
and identified with the defaults of `capture identify`: 12 episodes of 3 s at 250 Hz, or 10 strokes, white noise. One
JSON line is kept per log, so that the work can be stopped and taken up again; a line counts as long as the code that
made it is unchanged.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks import MACHINES, _lines
from benchmarks._code_hash import code_hash
from benchmarks._share import share
from benchmarks.base import Benchmark, Figure, Result
from capture_cli.stages import identify as stage
from capture_cli.stages.record import record

FREE = {"episodes": 12, "duration": 3.0, "rate": 250.0}
STROKES = {"episodes": 10}
NOISE = {
    "slider": {"q": 5e-4},
    "cart_pole": {"cart": 5e-4, "pole": 1e-3},
    "arm": {"q1": 1e-3, "q2": 1e-3},
    "air-hockey": 1e-3,
    "scooping": 2e-3,
}
WITH_CONTACTS = ("air-hockey", "scooping")  # a few of their errors without noise are those of a bump
WITHOUT_NOISE = 4  # one log in so many is recorded again without noise
COVERED = (0.92, 0.98)
LOST = 1e-3  # of the range


@dataclass(frozen=True)
class _Case:
    machine: str
    seed: int
    noisy: bool


class Coverage(Benchmark):
    summary = "coverage of 95 % intervals, false alarms, and recovery without noise"

    def run(self) -> Result:
        from tqdm import tqdm

        cases = list(self._cases())
        code = _code()
        lines = {machine: self._kept(machine, code) for machine in NOISE}
        for case in tqdm(cases, desc="logs", unit="log"):
            known = lines[case.machine]
            if case not in known:
                known[case] = _identify(case)
                self._keep(case, code, known[case])
        found = [(c, lines[c.machine][c]) for c in cases]
        noisy = {m: [d for c, d in found if c.noisy and c.machine == m] for m in NOISE}
        clean = [d for c, d in found if not c.noisy]
        return Result(_figures(noisy, clean), {"noise_sd": NOISE, "machines": _details(noisy)})

    def _cases(self) -> Iterator[_Case]:
        for seed in range(self.logs):
            for machine in NOISE:
                yield _Case(machine, seed, True)
                if seed % WITHOUT_NOISE == 0 and machine not in WITH_CONTACTS:
                    yield _Case(machine, seed, False)

    # --- one line per log ---

    def _path(self, machine: str) -> Path:
        return self.folder / "coverage" / f"{machine}.jsonl"

    def _kept(self, machine: str, code: str) -> dict[_Case, dict]:
        return {
            _Case(machine, line["seed"], line["noisy"]): line["found"]
            for line in _lines.read(self._path(machine))
            if line["code"] == code
        }

    def _keep(self, case: _Case, code: str, found: dict) -> None:
        line = {"code": code, "seed": case.seed, "noisy": case.noisy, "found": found}
        _lines.append(self._path(case.machine), line)


def _code() -> str:
    """A hash of what the numbers depend on."""
    return code_hash(["capture_cli.stages.identify", "capture_cli.stages.record"], ["benchmarks/machines"])


def _identify(case: _Case) -> dict:
    """Record a log and identify it: truth, estimate, sd and interval of each parameter, and the verdict."""
    strokes = case.machine in WITH_CONTACTS
    task = case.machine if strokes else str(MACHINES / case.machine / "task.toml")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recording = record(
            task=task,
            out=folder / "log.zarr",
            random_parameters=True,
            noise=NOISE[case.machine] if case.noisy else 0.0,
            seed=case.seed,
            **(STROKES if strokes else FREE),
        )
        document = stage.identify(
            real_log=folder / "log.zarr", out=folder / "estimate", task=task, seed=case.seed, quiet=True
        ).document
    return {
        "verdict": document["verdict"],
        "normalized": {k: document["error"][k]["normalized"] for k in ("fit", "test")},
        "parameters": {
            name: {
                "truth": recording.truth["parameters"][name],
                **{k: p[k] for k in ("value", "sd", "ci95", "low", "high")},
            }
            for name, p in document["parameters"].items()
        },
    }


# --- figures ---


def _figures(noisy: dict[str, list[dict]], clean: list[dict]) -> list[Figure]:
    """Parameters of one log are estimated from the same noise: the interval of the share is a little too narrow."""
    everything = [d for documents in noisy.values() for d in documents]
    inside = _inside(everything)
    covered = share(sum(inside), len(inside))
    alarms = share(sum(d["verdict"] == "unexplained" for d in everything), len(everything))
    figures = [
        Figure(
            f"share of all {len(inside)} 95 % intervals that hold the truth",
            covered["share"],
            target=COVERED,
        ),
        Figure("  its own 95 % interval, low", covered["low"]),
        Figure("  its own 95 % interval, high", covered["high"]),
        *(
            Figure(f"  {machine} alone", float(np.mean(_inside(documents))))
            for machine, documents in noisy.items()
        ),
        Figure(f'share of {alarms["of"]} logs falsely called "unexplained"', alarms["share"]),
        Figure("  its own 95 % interval, high", alarms["high"]),
    ]
    if clean:
        lost = max(_errors_over_range(clean))
        figures.append(
            Figure(
                f"largest error over the range, {len(clean)} logs without noise", lost, target=(None, LOST)
            )
        )
    return figures


def _details(noisy: dict[str, list[dict]]) -> dict:
    return {
        machine: {
            "logs": len(documents),
            "intervals": len(_inside(documents)),
            "covered": sum(_inside(documents)),
            "rms_of_error_over_sd": float(np.sqrt(np.mean(np.square(_scaled_errors(documents))))),
            "verdicts": {
                v: sum(d["verdict"] == v for d in documents) for v in {d["verdict"] for d in documents}
            },
            "normalized_test": float(np.mean([d["normalized"]["test"] for d in documents])),
        }
        for machine, documents in noisy.items()
    }


def _parameters(documents: list[dict]) -> list[dict]:
    return [p for d in documents for p in d["parameters"].values()]


def _inside(documents: list[dict]) -> list[bool]:
    return [p["ci95"][0] <= p["truth"] <= p["ci95"][1] for p in _parameters(documents)]


def _scaled_errors(documents: list[dict]) -> list[float]:
    return [(p["value"] - p["truth"]) / p["sd"] for p in _parameters(documents)]


def _errors_over_range(documents: list[dict]) -> list[float]:
    return [abs(p["value"] - p["truth"]) / (p["high"] - p["low"]) for p in _parameters(documents)]
