"""Policies on disk: a checkpoint directory holds policy.json and policy.safetensors."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.common.named_arrays import check_shapes
from capture_cli.context.policies import REGISTRY
from capture_cli.context.policies.base import Policy
from capture_cli.errors import OptionError, StoreError, did_you_mean
from capture_cli.model.parameters import ParameterSpace
from capture_cli.model.tasks.aimed_task import with_reward
from capture_cli.model.tasks.base import ActionTask, Task
from capture_cli.store.document_shape import BOUNDS, COUNT, EFFECTS, NUMBER, OBJECT, TEXT, check_shape
from capture_cli.store.provenance import write_json
from capture_cli.store.result import DocumentKind, read_result
from capture_cli.store.tensors import read_weights, save_arrays
from capture_cli.store.trained import TrainedPolicy

FORMAT, VERSION = "capture/policy", 2
DOCUMENT, WEIGHTS = "policy.json", "policy.safetensors"
_JUDGED = {"reward": NUMBER, "success": NUMBER}
SHAPE = {
    "policy": TEXT,
    "task": TEXT,
    "parameters": [TEXT],
    "actions": [TEXT],
    "bounds": {"parameters": [BOUNDS], "actions": [BOUNDS]},
    "settings": OBJECT,
    "effects": EFFECTS,
    "training?": {"steps": COUNT},
    "result?": {"episodes": COUNT, **_JUDGED, "random": _JUDGED},
}
TRAINED = {"training": OBJECT, "result": OBJECT}  # of what `train-policy` wrote, too
AGAIN = "train the policy again with `train-policy`"
KIND = DocumentKind(FORMAT, VERSION, AGAIN, SHAPE, {1: lambda document: {**document, "effects": []}})


def save_policy(
    policy: Policy, name: str, folder: Path, more: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Write `policy`, of the kind `name`, into `folder` (one made by `new_directory`); returns policy.json.

    more: what else policy.json is to say, of how the policy was made.
    """
    settings, weights = policy.state()
    space, actions = policy.task.space, policy.task.actions
    document = {
        "format": FORMAT,
        "version": VERSION,
        "policy": name,
        "task": policy.task.name,
        "parameters": list(space.names),
        "actions": list(actions.names),
        "bounds": {"parameters": _bounds(space), "actions": _bounds(actions)},
        "settings": settings,
        "effects": [],
        **(more or {}),
    }
    write_json(folder / DOCUMENT, document)
    save_arrays(folder / WEIGHTS, weights)
    return document


def is_checkpoint(policy: str | Path) -> bool:
    """Whether that is the path of a policy that was trained."""
    return (Path(policy) / DOCUMENT).is_file()


def played(machine: Task, policy: str) -> Task:
    """The task that `policy` plays: of a machine with a [reward] one that was trained has actions of its own."""
    return with_reward(machine) if is_checkpoint(policy) else machine


def load_policy(name: str, task: ActionTask) -> Policy:
    """The policy called `name`, or that of the checkpoint at that path.

    Raises OptionError for what is neither, or a policy for another task; StoreError for a checkpoint that cannot be
    read.
    """
    path = Path(name)
    if is_checkpoint(path):
        return _from_checkpoint(path, task)
    untrained = [n for n, c in REGISTRY.items() if not c.trained]
    if name in untrained:
        return REGISTRY.get(name)(task)
    if path.exists():
        raise StoreError(
            f"--policy {name}: there is no {DOCUMENT} in it", cure="give a folder that `train-policy` wrote"
        )
    raise OptionError(
        f"--policy {name!r} is neither a policy nor a checkpoint directory",
        cure=f"give a directory that `train-policy` wrote; by name {did_you_mean(name, untrained)}",
    )


def _from_checkpoint(path: Path, task: ActionTask) -> Policy:
    document = read_policy(path)
    settings = TrainedPolicy.of(document)
    again = "train one for it with `train-policy`, or give the task it was made for"
    if settings.task != task.name:
        raise OptionError(
            f"--policy {path} is for the task {settings.task!r}, and this one is {task.name!r}", cure=again
        )
    each = (("parameters", task.space, settings.parameters), ("actions", task.actions, settings.actions))
    for kind, space, names in each:
        if list(space.names) != names:
            raise OptionError(
                f"--policy {path}: its {kind} are ({', '.join(names)}); "
                f"those of {task.name!r} are ({', '.join(space.names)})",
                cure=again,
            )
        for name, bounds, known in zip(space.names, _bounds(space), settings.bounds[kind], strict=True):
            if bounds != known:
                raise OptionError(
                    f"--policy {path} was made for {name} between {known[0]:g} and {known[1]:g}; "
                    f"that of {task.name!r} lies between {bounds[0]:g} and {bounds[1]:g}",
                    cure=again,
                )
    kind, weights = REGISTRY.get(settings.policy), read_policy_weights(path, document)
    try:
        return kind.from_state(task, settings.settings, weights)
    except (KeyError, TypeError, ValueError, AttributeError, RuntimeError) as error:
        raise _apart(path, error) from error


def read_policy_weights(path: Path, document: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The arrays in the directory `path` that belong to its policy.json, `document`.

    Raises StoreError where they are damaged, or not those of such a policy; of a kind that is unknown, where they are
    damaged.
    """
    weights, trained = read_weights(path / WEIGHTS, AGAIN), TrainedPolicy.of(document)
    if trained.policy not in REGISTRY.names():
        return weights
    kind, sizes = REGISTRY.get(trained.policy), (len(trained.parameters), len(trained.actions))
    try:
        shapes = kind.weight_shapes(trained.settings, weights, *sizes)
        if shapes is not None:
            check_shapes(weights, shapes)
    except ValueError as error:
        raise _apart(path, error) from error
    return weights


def _apart(path: Path, error: Exception) -> StoreError:
    return StoreError(f"{path}: {DOCUMENT} and {WEIGHTS} do not belong together: {error}", cure=AGAIN)


def _bounds(space: ParameterSpace) -> list[list[float]]:
    return [[p.low, p.high] for p in space]


def read_policy(path: Path, *, trained: bool = False) -> dict[str, Any]:
    """policy.json in the directory `path`. Raises StoreError where it is missing, damaged or of another version.

    trained: it has to say how it was trained and judged, too.
    """
    found = read_result(path, DOCUMENT, KIND)
    if trained:
        check_shape(found, TRAINED, path / DOCUMENT, AGAIN)
    for kind, bounds in found["bounds"].items():
        if kind in found and len(bounds) != len(found[kind]):
            raise StoreError(
                f"{path / DOCUMENT}: {len(bounds)} bounds of {len(found[kind])} {kind}", cure=AGAIN
            )
    return found
