"""Tasks of fast diagnoses: their inputs are held, which need not be found out first, and their models take few steps.

What a diagnosis takes is in proportion to the steps of a window, and hardly to how many windows there are.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path

MACHINES = Path(__file__).parents[1] / "benchmarks" / "machines"


def held_machine(folder: Path, machine: str, timestep: float) -> Path:
    """The task.toml of a machine of the benchmarks, in a folder that is made for it, as `hold` makes it."""
    shutil.copytree(MACHINES / machine, folder)
    return hold(folder / "task.toml", timestep)


def hold(task: Path, timestep: float) -> Path:
    """Change a task.toml to inputs that are held, and the model beside it to steps of so many s. Returns the task."""
    changes = {
        task: (r"^\[inputs\..*\]$", r'\g<0>\ninterpolate = "hold"'),
        task.with_name("model.xml"): (r'timestep="[^"]*"', f'timestep="{timestep}"'),
    }
    for path, (old, new) in changes.items():
        text, count = re.subn(old, new, path.read_text(), flags=re.MULTILINE)
        assert count, path
        path.write_text(text)
    return task
