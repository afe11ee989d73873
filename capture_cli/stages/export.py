"""`capture export`: an estimate in, an MJCF with the identified values out."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from capture_cli.errors import OptionError, StoreError
from capture_cli.sim.engine import ModelFields
from capture_cli.sim.mjcf import to_mjcf
from capture_cli.stores.estimate import Estimate, read_result
from capture_cli.stores.output import new_file
from capture_cli.tasks import load_task


def export(*, estimate: Path, out: Path, task: str | None = None, force: bool = False) -> Path:
    """Write the task's model with the values of the estimate directory `estimate` to the file `out`.

    task: where the task is now, if it was moved since. Raises CaptureError for whatever the user can mend.
    """
    found = Estimate.read(estimate)
    machine = load_task(task or _recorded_task(estimate))
    if machine.name != found.document["task"]:
        raise OptionError(
            f"{estimate} belongs to the task {found.document['task']!r}, and --task is {machine.name!r}",
            cure="give the task the estimate was made with",
        )
    names = set(found.document["parameters"])
    if names != set(machine.space.names):
        raise StoreError(
            f"{estimate} has the parameters ({', '.join(sorted(names))}); "
            f"the task now has ({', '.join(sorted(machine.space.names))})",
            cure="identify again with the task as it is now",
        )
    values = machine.space.to_vector({n: p["value"] for n, p in found.document["parameters"].items()})
    fields = ModelFields(machine.model, 1)
    machine.write(fields, values[None])
    with new_file(out, force=force) as partial:
        text = to_mjcf(machine.model_path, fields, out)
        partial.write_text(_header(found, values, machine) + text, encoding="utf-8")
    return out


def _recorded_task(estimate: Path) -> str:
    provenance = read_result(
        estimate,
        "provenance.json",
        "capture/provenance",
        1,
        "make the estimate again with `capture identify`",
    )
    recorded = provenance["inputs"].get("task")
    return recorded["path"] if recorded else provenance["options"]["task"]


def _header(found: Estimate, values: np.ndarray, machine) -> str:
    lines = [f"  {p.name} = {v:.9g} {p.unit}" for p, v in zip(machine.space, values, strict=True)]
    return "<!-- identified by `capture identify`\n" + "\n".join(lines).replace("--", "- -") + "\n-->\n"
