"""How long the command line takes: `capture --help`, and where the time of `capture identify` goes."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks import ROOT
from benchmarks.base import Benchmark, Figure, Result

REPEATS = 10
TARGET = 0.3  # s
ROUNDS, ROUNDS_TARGET = 10, 5.0  # s
HOCKEY = ROOT / "datasets" / "air_hockey.zarr"
CART = ROOT / "datasets" / "cart"

# Runs `capture identify` in a process of its own, with a clock around its parts, and prints them as JSON.
_TIMED = """
import json, sys, time
began = time.perf_counter()
from pathlib import Path
import capture_cli.stages.identify as stage
import capture_cli.stages.log_to_fit as log_to_fit
parts = {"import": time.perf_counter() - began}

def timed(owner, name, part):
    inner = getattr(owner, name)
    def outer(*args, **kwargs):
        began = time.perf_counter()
        try:
            return inner(*args, **kwargs)
        finally:
            parts[part] = parts.get(part, 0.0) + time.perf_counter() - began
    setattr(owner, name, outer)

timed(log_to_fit, "prepare", "prepare the log")
timed(stage, "check_parameters_move_outputs", "check the parameters")
timed(stage.Report, "estimate", "intervals, curves, verdict")
timed(stage, "_write_pages", "report and figures")
log, task, out = map(Path, sys.argv[1:])
began = time.perf_counter()
stage.identify(real_log=log, out=out, task=str(task), quiet=True)
parts["all"] = time.perf_counter() - began
print(json.dumps(parts))
"""


class StartUp(Benchmark):
    summary = "start-up of the command line, and the parts of `capture identify`"

    def run(self) -> Result:
        helps = [_seconds([*_capture(), "--help"]) for _ in range(REPEATS)]
        with tempfile.TemporaryDirectory() as folder:
            hockey = ["identify", "--real-log", str(HOCKEY), "--rounds", str(ROUNDS), "--quiet"]
            before = _cpu_seconds()
            rounds = _seconds([*_capture(), *hockey, "--out", f"{folder}/rounds"])
            rounds_cpu = _cpu_seconds() - before
            paths = ["--real-log", str(CART / "cart.zarr"), "--task", str(CART / "task.toml")]
            whole = _seconds([*_capture(), "identify", *paths, "--out", f"{folder}/whole", "--quiet"])
            timed = subprocess.run(
                [sys.executable, "-c", _TIMED, paths[1], paths[3], f"{folder}/parts"],
                check=True,
                capture_output=True,
                text=True,
                cwd=ROOT,
            )
        parts = json.loads(timed.stdout)
        importing, all_ = parts.pop("import"), parts.pop("all")
        parts = {"import": importing, **parts, "fit and the rest": all_ - sum(parts.values())}
        return Result(
            [
                Figure("capture --help, median of 10", float(np.median(helps)), "s", (None, TARGET)),
                Figure(
                    f"capture identify on datasets/air_hockey, {ROUNDS} rounds, whole process",
                    rounds,
                    "s",
                    (None, ROUNDS_TARGET),
                ),
                Figure("  CPU time of all its threads", rounds_cpu, "s"),
                Figure("capture identify on datasets/cart, whole process", whole, "s"),
                *(Figure(f"  {name}", seconds, "s") for name, seconds in parts.items()),
            ],
            {
                "help_seconds": helps,
                "rounds_seconds": rounds,
                "identify_seconds": whole,
                "identify_parts": parts,
            },
        )


def _capture() -> list[str]:
    """The installed command, or the module where it is not installed beside this Python."""
    command = Path(sys.executable).with_name("capture")
    return [str(command)] if command.is_file() else [sys.executable, "-m", "capture_cli"]


def _cpu_seconds() -> float:
    """Of all processes that were waited for so far."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _seconds(command: list[str]) -> float:
    began = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=ROOT)
    return time.perf_counter() - began
