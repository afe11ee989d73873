"""The known world: one task = one file. A user's own machine is a task.toml beside an MJCF (`mjcf_file.py`)."""

from pathlib import Path

from capture_cli.common.registry import Registry
from capture_cli.errors import TaskError, did_you_mean
from capture_cli.model.tasks.base import Task

REGISTRY: Registry[Task] = Registry(
    "capture_cli.model.tasks",
    "Task",
    "task",
    not_listed=("aimed-task", "input-hold", "mjcf-file", "reward", "sequence-task"),
)


def load_task(name: str) -> Task:
    """The built-in task called `name`, or the one of the task.toml at that path (or in that folder)."""
    from capture_cli.model.mujoco_warnings import silence_mujoco

    silence_mujoco()  # before the first model, of which it may have something to say
    path = Path(name)
    if name in REGISTRY.names():
        return REGISTRY.get(name)()
    if path.is_dir() and (path / "task.toml").is_file():
        path = path / "task.toml"
    if not path.is_file():
        raise TaskError(
            f"--task {name!r} is neither a built-in task nor a file",
            cure=f"give the path of a task.toml, or the name of a task: {did_you_mean(name, REGISTRY.names())}",
        )
    from capture_cli.model.tasks.mjcf_file import MjcfFile

    return MjcfFile(path)
