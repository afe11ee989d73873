"""Tasks that say that their inputs are held: without that a diagnosis first finds it out, with every effect."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

MACHINES = Path(__file__).parents[1] / "benchmarks" / "machines"


def held(text: str) -> str:
    """A task.toml with inputs that are held."""
    return re.sub(r"^\[inputs\..*\]$", r'\g<0>\ninterpolate = "hold"', text, flags=re.MULTILINE)


def held_machine(folder: Path, machine: str) -> Path:
    """The task.toml of a machine of the benchmarks, with inputs that are held, in a folder that is made for it."""
    shutil.copytree(MACHINES / machine, folder)
    task = folder / "task.toml"
    task.write_text(held(task.read_text()))
    return task
