"""The checkpoint of `capture diagnose`, beside its output: a file for every long step, and of what run they are."""

import hashlib
import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.common.documents import parse_json, read_json
from capture_cli.common.frozen import frozen
from capture_cli.context.checkpoints.training_state import check_recipe
from capture_cli.errors import FitError, StoreError
from capture_cli.estimate.checkpoint import Checkpoint, Values
from capture_cli.options.diagnose import DiagnoseOptions
from capture_cli.store.document_shape import OBJECT, check_shape
from capture_cli.store.output import renewed, resumable_directory
from capture_cli.store.provenance import write_json
from capture_cli.store.tensors import read_arrays, save_arrays

STEPS, RECIPE = "steps", "steps.json"  # of a run that is not complete


@frozen
class SETTINGS:
    most: float = 2e9  # bytes, of all steps: of a log of a million rows one takes hundreds of megabytes
    short: int = 12  # characters of a hash in a message


OPTIONS = ("task", "test", "window", "starts", "seed")
# options that say how far to go: the steps until there are the same
ENDS = ("most_effects", "expression", "time_limit")


class StepFiles(Checkpoint):
    """Steps in the files of a folder, each called by its number and a hash of what it follows from.

    Those that would take the folder beyond `SETTINGS.most` bytes are not saved, and made again.
    """

    def __init__(self, folder: Path):
        self._folder = folder
        self._number = 0
        self._room = SETTINGS.most - sum(path.stat().st_size for path in folder.glob("*.safetensors"))

    @property
    def anything(self) -> bool:
        return any(self._folder.glob("*.safetensors"))

    def step(self, name: str, given: Sequence[Any], make: Callable[[], Values]) -> Values:
        self._number += 1
        path = self._folder / f"{self._number:05d}-{_hash(name, given)}.safetensors"
        with suppress(StoreError):  # not made yet, or damaged when the machine went down
            return _read(path)
        values = make()
        # as they are read, so that what comes next is the same in both cases, to the last bit
        arrays = {n: np.ascontiguousarray(v) for n, v in values.items() if isinstance(v, np.ndarray)}
        others = json.dumps({n: v for n, v in values.items() if n not in arrays})
        self._room -= sum(v.nbytes for v in arrays.values())
        if self._room >= 0:
            with renewed(path) as file:
                save_arrays(file, arrays, {"others": others})
        return {**arrays, **json.loads(others)}


def _read(path: Path) -> Values:
    arrays, metadata = read_arrays(path, "make it again")
    others = metadata.get("others", "null")
    found = parse_json(others, str(path), StoreError, cure="make it again", any_numbers=True)
    check_shape(found, OBJECT, path, "make it again")
    return {**arrays, **found}


def _hash(name: str, given: Sequence[Any]) -> str:
    digest = hashlib.sha256(name.encode())
    for value in given:
        array = isinstance(value, np.ndarray)
        digest.update(b"\0" + (np.ascontiguousarray(value).tobytes() if array else repr(value).encode()))
    return digest.hexdigest()[: SETTINGS.short]


@contextmanager
def unfinished_diagnosis(
    options: DiagnoseOptions, made: Mapping[str, Any]
) -> Iterator[tuple[Path, StepFiles]]:
    """A folder that becomes the diagnosis, and the checkpoint that is in it until then.

    made: the provenance of this run. Raises OptionError where the folder is of a run with another recipe, otherwise as
    `resumable_directory`.
    """
    with resumable_directory(
        options.out, kept=_kept, scaffold=(STEPS, RECIPE), force=options.force, resume=options.resume
    ) as folder:
        steps = StepFiles(folder / STEPS)
        _begin(
            folder, {**recipe_of(made), "code": made["code"][: SETTINGS.short], "packages": made["packages"]}
        )
        try:
            yield folder, steps
        except FitError:
            shutil.rmtree(folder)  # nowhere to go
            raise


def _kept(folder: Path) -> str:
    return "what was worked out is kept" if StepFiles(folder / STEPS).anything else ""


def recipe_of(made: Mapping[str, Any], options: Sequence[str] = OPTIONS) -> dict[str, Any]:
    """Of the provenance `made` what the result follows from: these options, and hashes of the inputs."""
    inputs = {name: i["sha256"][: SETTINGS.short] for name, i in made["inputs"].items()}
    return {"options": {name: made["options"].get(name) for name in options}, "inputs": inputs}


def _begin(folder: Path, recipe: Mapping[str, Any]) -> None:
    """Write the recipe of the run, or check that the recipe of an earlier run is the same."""
    path = folder / RECIPE
    (folder / STEPS).mkdir(exist_ok=True)
    if path.is_file():
        check_recipe(read_json(path, StoreError, cure="begin anew with --force"), recipe)
    else:
        with renewed(path) as file:
            write_json(file, recipe)
