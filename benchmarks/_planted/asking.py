"""What `capture diagnose` of some version says of a log, asked as a user asks: a process of its own, on one thread."""

from __future__ import annotations

import json
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks import ROOT
from capture_cli.errors import CaptureError
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks.base import Task

ONE_THREAD = {name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")}
LONGEST = 3600.0  # s: a diagnosis that takes longer has failed
# `capture`, with the effects hidden that the second argument names, in the registry of the module that the first names.
_CAPTURE = """
import importlib, sys
REGISTRY = importlib.import_module(sys.argv.pop(1)).REGISTRY
REGISTRY.not_listed += tuple(sys.argv.pop(1).split())
from capture_cli.cli import main
main()
"""


class NoAnswer(CaptureError):
    """`capture diagnose` ended without a diagnosis."""


@dataclass(frozen=True)
class Answer:
    """The JSON that was printed, and what it took: seconds of the clock, and of the CPU of the whole process."""

    document: dict[str, Any]
    seconds: float
    cpu_seconds: float


def _effects_of(root: Path) -> str:
    """The module of the effects of the version in the checkout `root`; earlier ones had it elsewhere."""
    here = (root / "capture_cli" / "model" / "effects").is_dir()
    return "capture_cli.model.effects" if here else "capture_cli.effects"


def ask(task: Task, log: MeasuredLog, root: Path, *, seed: int = 0, hidden: Sequence[str] = ()) -> Answer:
    """Ask the version in the checkout `root`. hidden: names of effects that its catalogue is to be without.

    Only one may be asked at a time in a process, whose children's CPU time is taken. Raises NoAnswer.
    """
    with tempfile.TemporaryDirectory() as folder:
        _write(task, log, Path(folder))
        command = [sys.executable, "-c", _CAPTURE, _effects_of(root), " ".join(hidden)]
        command += ["diagnose", "--real-log", "log.zarr"]
        command += ["--task", "task.toml", "--out", "out", "--seed", str(seed), "--threads", "1"]
        return answered(command, Path(folder), root)


def answered(command: Sequence[str], folder: Path, root: Path = ROOT) -> Answer:
    """What a command of the version in `root` answers in `folder`. Raises NoAnswer."""
    began, cpu = time.perf_counter(), _cpu_of_children()
    try:
        ended = subprocess.run(
            [*command, "--json", "--quiet"],
            cwd=folder,
            env={**os.environ, **ONE_THREAD, "PYTHONPATH": str(root)},
            capture_output=True,
            text=True,
            timeout=LONGEST,
        )
    except subprocess.TimeoutExpired as error:
        raise NoAnswer(f"no answer within {LONGEST:g} s", cure="look at the log of this case") from error
    if ended.returncode:
        raise NoAnswer(
            ended.stderr.strip().replace(str(folder), ".")[-500:], cure="look at the log of this case"
        )
    taken = time.perf_counter() - began, _cpu_of_children() - cpu
    return Answer(json.loads(ended.stdout), *(round(t, 3) for t in taken))


def _write(task: Task, log: MeasuredLog, folder: Path) -> None:
    """model.xml, task.toml and log.zarr, as a user has them."""
    text = task.path.read_text(encoding="utf-8")
    if task.log.window is None:
        text = re.sub(r"(?m)^window = .*\n", "", text)
    (folder / "task.toml").write_text(text, encoding="utf-8")
    shutil.copy(task.model_path, folder / task.model_path.name)
    log.write(folder / "log.zarr")


def _cpu_of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
