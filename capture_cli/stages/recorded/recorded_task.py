"""The task that a log, an estimate or a diagnosis belongs to, found again, and whether its model is what it was."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from capture_cli.common.documents import read_toml
from capture_cli.errors import ModelError, OptionError, TaskError
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.mjcf.model_file import files_of
from capture_cli.model.tasks import REGISTRY, load_task
from capture_cli.model.tasks.base import Task
from capture_cli.store.output import sha256

MODEL = "model"  # what the inputs of provenance.json call it


def task_inputs(task: Task) -> dict[str, Path | None]:
    """What provenance.json records of a task of the user's own: its file, its model, and the files that one is made of.

    Built-in ones have a name.
    """
    path = task.path
    return {"task": path, **_model_files(task.model_path)} if path else {"task": None}


def recorded_task(result: Path, provenance: Mapping[str, Any], log: str | None = None) -> str:
    """The `--task` that `result` was made with: a name, or where the file is now.

    A path that was recorded is looked for from here, from the result's folder and beside the log (its path), where it
    was made; the one that is as it was then is taken before others. Raises OptionError where there is none.
    """
    recorded = provenance["inputs"].get("task")
    if recorded is None:
        if (name := provenance["options"].get("task")) is None:
            raise OptionError(
                f"{result} does not say which task it was made with",
                cure="say it: --task NAME, or --task PATH/TO/task.toml",
            )
        return name
    path = Path(recorded["path"])
    places = [path, Path(result).resolve().parent / path]
    if log is not None:
        places += [Path(log).parent / path.name, Path(result).resolve().parent / Path(log).parent / path.name]
    there = [p for p in places if p.is_file()]
    if not there:
        raise OptionError(
            f"{result} was made with the task {path}, which is neither here nor beside it",
            cure="say where it is now: --task PATH/TO/task.toml",
        )
    unchanged = [p for p in there if sha256(p) == recorded["sha256"] and _has_model(p, provenance)]
    return str((unchanged or there)[0])


def load_recorded(result: Path, provenance: Mapping[str, Any], task: str | None, log: str | None) -> Task:
    """The task of `--task`, or else the recorded one. Raises OptionError where its model is not what it was then."""
    found = load_task(task or recorded_task(result, provenance, log))
    if changed := _changed(found.model_path, provenance):
        raise OptionError(
            f"{changed} is not the model that {result} was made with: it has changed since, or is another",
            cure="give the task it was made with (--task), or make it again with the model as it is now",
        )
    return found


def find_task(task: str | None, log: MeasuredLog) -> Task:
    """The task of `--task`; without it the built-in one that the log names, or a task.toml of that name beside it."""
    if task is not None:
        return load_task(task)
    if log.task in REGISTRY.names():
        return load_task(log.task)
    beside = Path(log.path).parent / "task.toml" if log.path else None
    if beside is not None and beside.is_file():
        found = load_task(str(beside))
        if found.name == log.task:
            return found
    raise OptionError(
        f"the log belongs to the task {log.task!r}, which is not built in, and no task.toml of that name "
        "lies beside it",
        cure="add --task PATH/TO/task.toml",
    )


def named(task: Task) -> str | None:
    """The value of `--task` for a built-in task, whatever log it is for; None for a task.toml, which has a path."""
    return task.name if task.name in REGISTRY.names() and task.path is None else None


def _has_model(path: Path, provenance: Mapping[str, Any]) -> bool:
    """Whether the model of the task at `path` is as recorded."""
    model = path.parent / str(read_toml(path, TaskError).get("model"))
    return _changed(model, provenance) is None


def _changed(model: Path, provenance: Mapping[str, Any]) -> Path | None:
    """The first of the model's files that is not as recorded, the model itself where it is no model any more."""
    recorded = {name: source for name, source in provenance["inputs"].items() if name.startswith(MODEL)}
    if not recorded:
        return None
    try:
        files = _model_files(model)
    except ModelError:
        return model
    for name, source in recorded.items():
        path = files.get(name, model)
        if name not in files or sha256(path) != source["sha256"]:
            return path
    return None


def _model_files(model: Path) -> dict[str, Path]:
    """The model and the files that it includes (MJCFs, meshes, textures), by their names in provenance.json."""
    others = {os.path.relpath(file, model.parent): file for file in files_of(model)}
    return {MODEL: model} | {
        f"{MODEL}: {name}": f for name, f in sorted(others.items()) if name != model.name
    }
