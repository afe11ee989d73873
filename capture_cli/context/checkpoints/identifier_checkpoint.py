"""A learned identifier on disk: identifier.json and identifier.safetensors in a directory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from capture_cli.context import observation_noise
from capture_cli.context.identifiers import round_identifier
from capture_cli.context.identifiers.base import RoundIdentifier, Signature
from capture_cli.errors import OptionError, StoreError
from capture_cli.model.tasks.base import Task
from capture_cli.select.recorded_effects import placed_effects, recorded_effects
from capture_cli.store.document_shape import COUNT, EFFECTS, FEATURES, FLAG, NUMBER, PARAMETERS, TEXT, WHOLE
from capture_cli.store.provenance import write_json
from capture_cli.store.result import DocumentKind, read_result
from capture_cli.store.tensors import read_weights, save_arrays
from capture_cli.store.trained import TrainedIdentifier

if TYPE_CHECKING:
    from capture_cli.context.identifiers._learned import TrainedModel

FORMAT, VERSION = "capture/identifier", 3
DOCUMENT, WEIGHTS = "identifier.json", "identifier.safetensors"
_AGAIN = "train it again with `capture train-sysid`"
SHAPE = {
    "identifier": TEXT,
    "task": TEXT,
    "architecture": {
        "parameters": COUNT,
        "actions": COUNT,
        "points": COUNT,
        "features": COUNT,
        "tokens": TEXT,
        "window": COUNT,
        "width": COUNT,
        "layers": WHOLE,
        "heads": COUNT,
        "dropout": NUMBER,
        "residual": FLAG,
    },
    "training": {"steps": COUNT, "patience": WHOLE},
    "histories": {
        "model": TEXT,
        "rounds": COUNT,
        "search": TEXT,
        "effects": EFFECTS,
        "noise": TEXT,
        "noise_sd": {str: NUMBER},
        "mujoco": TEXT,
    },
    "result": {
        "steps": WHOLE,
        "best_step": WHOLE,
        "validation_loss": NUMBER,
        "pairs": {"trained": WHOLE, "held_out": WHOLE},
        "mean_absolute_error": {str: NUMBER},
        "error_by_round": [NUMBER],
        "coverage": {str: NUMBER},
    },
    "signature": {
        "task": TEXT,
        "parameters": PARAMETERS,
        "actions": PARAMETERS,
        "features": FEATURES,
        "point_times": [NUMBER],
    },
}
OF_PARAMETERS = ("mean_absolute_error", "coverage")  # of its result, one number for each


def _of_no_effects(document: Mapping[str, Any]) -> Mapping[str, Any]:
    """identifier.json as of version 2: the histories of the first knew no effects."""
    histories = document.get("histories")
    return (
        {**document, "histories": {**histories, "effects": []}} if isinstance(histories, dict) else document
    )


def _named_by_its_tokens(document: Mapping[str, Any]) -> Mapping[str, Any]:
    """identifier.json as of version 3: before, `capture` was the name of both networks."""
    architecture = document.get("architecture")
    tokens = architecture.get("tokens") if isinstance(architecture, dict) else None
    if (document.get("identifier"), tokens) == ("capture", "trajectory"):
        return {**document, "identifier": "capture-trajectory"}
    return document


KIND = DocumentKind(FORMAT, VERSION, _AGAIN, SHAPE, {1: _of_no_effects, 2: _named_by_its_tokens})


@dataclass(frozen=True)
class IdentifierCheckpoint:
    """What identifier.json says, the class it names, and the trained model: `kind(signature, start, model=model)`."""

    record: TrainedIdentifier
    kind: type[RoundIdentifier]
    model: TrainedModel

    @property
    def name(self) -> str:
        """The identifier's public name."""
        return self.record.identifier

    def noise_beyond(self, noise_sd: np.ndarray) -> np.ndarray:
        """What noise_sd (feature,) adds to the noise that the histories had: (feature,) or (point, feature).

        Variances add up; noise below that of the histories adds nothing.
        """
        histories = self.record.histories
        known = histories["noise_sd"]
        white = np.array([known.get(f.name, 0.0) for f in self.model.signature.features])
        scaled = observation_noise.white_sd(histories["noise"], self.model.normalisation.sizes)
        had = np.hypot(white, scaled)
        return np.sqrt(np.maximum(np.square(noise_sd) - np.square(had), 0)) if had.any() else noise_sd

    def machine(self, task: Task) -> Task:
        """`task` with the effects that its simulated trajectories were made with; of another task, which `check` tells,
        as it is. Raises CaptureError where the model has no place for one any more.
        """
        rows = self.record.histories["effects"] if task.name == self.record.task else []
        return task.with_effects(placed_effects(recorded_effects(rows, task, "gen-histories")))

    def check(self, signature: Signature, where: str | Path) -> None:
        """Raise OptionError where it was trained for another task, or for other parameters, actions or points."""
        differences = self.model.signature.differences(signature)
        if differences:
            raise OptionError(
                f"{where} was trained for something else, {'; '.join(differences)}",
                cure=f"choose a checkpoint of the task {signature.task!r}, or {_AGAIN}",
            )


def save_identifier(model: TrainedModel, document: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Write `model` into `folder`; returns identifier.json, which is `document` with the model's settings."""
    settings, arrays = model.state()
    document = {"format": FORMAT, "version": VERSION, **document, **settings}
    write_json(folder / DOCUMENT, document)
    save_arrays(folder / WEIGHTS, arrays)
    return document


def read_document(path: Path) -> Mapping[str, Any]:
    """identifier.json in the directory `path`. Raises StoreError where it is missing, damaged or of another version."""
    found = read_result(path, DOCUMENT, KIND)
    names = [p["name"] for p in found["signature"]["parameters"]]
    for key in OF_PARAMETERS:
        if sorted(found["result"][key]) != sorted(names):
            raise StoreError(
                f"{path / DOCUMENT}: result.{key} is of ({', '.join(found['result'][key])}); "
                f"expected ({', '.join(names)}), as in its signature",
                cure=_AGAIN,
            )
    return found


def load_identifier(path: str | Path, signature: Signature | None = None) -> IdentifierCheckpoint:
    """The identifier in the directory `path`, for the task of `signature` where that is given.

    Raises StoreError for a checkpoint that is missing, damaged or of another version; OptionError for one of another
    task, parameter list, action or trajectory.
    """
    from capture_cli.context.identifiers._learned import TrainedModel

    path = Path(path)
    document = read_document(path)
    record = TrainedIdentifier.of(document)
    arrays = read_weights(path / WEIGHTS, _AGAIN, network="network.")
    try:
        kind = round_identifier(record.identifier)
        if not kind.needs_checkpoint:
            raise ValueError(f"identifier {record.identifier!r} learns nothing")
        if kind.tokens not in (None, record.architecture["tokens"]):
            raise ValueError(f"identifier {record.identifier!r} has one token a {kind.tokens}")
        model = TrainedModel.from_state(document, arrays)
        observation_noise.check(record.histories["noise"], [f.name for f in model.signature.features])
    except (KeyError, TypeError, ValueError, OptionError) as error:
        raise StoreError(f"{path} cannot be read: {type(error).__name__}: {error}", cure=_AGAIN) from error
    found = IdentifierCheckpoint(record, kind, model)
    if signature is not None:
        found.check(signature, path)
    return found
