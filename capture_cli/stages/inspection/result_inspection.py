"""What a folder holds that a command wrote as its result (an estimate, a checkpoint, an evaluation), and its health."""

import shlex
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from capture_cli.common.quantities import told
from capture_cli.context.checkpoints import identifier_checkpoint, policy_checkpoint
from capture_cli.context.checkpoints.training_state import METRICS
from capture_cli.errors import CaptureError
from capture_cli.log.checks.base import Finding, finding, note, warning
from capture_cli.model.tasks import REGISTRY as TASKS
from capture_cli.model.tasks import load_task
from capture_cli.report.findings import cut_short, is_fit_explained, jitter_share, not_alike
from capture_cli.store.diagnosis import Diagnosis
from capture_cli.store.estimate import Estimate, EstimateRecord
from capture_cli.store.evaluation import Evaluation
from capture_cli.store.inspection import Inspection
from capture_cli.store.output import PROVENANCE, sha256
from capture_cli.store.result import Result

COPY_AGAIN = "copy the folder again from where it is whole"
OF_PROVENANCE = f"{COPY_AGAIN}: what task it was made with is said there, and commands look for it"
OF_RESULTS = (  # what is taken over of the JSON of an estimate or a diagnosis
    "task",
    "log",
    "identifier",
    "verdict",
    "parameters",
    "effects",
    "error",
    "before",
    "after",
    "rollouts",
)


@dataclass(frozen=True)
class ResultFolder:
    """document: the file that says what the folder is. describe: fills an inspection in, and raises StoreError
    where a file that commands read is missing or damaged. beside: other files that every folder of the kind has.
    """

    document: str
    describe: Callable[[Path, Inspection], None]
    beside: tuple[str, ...]


def inspect_result(path: Path, seen: Inspection) -> None:
    """Fill the inspection of the folder at `path`, of a kind of RESULTS, in. Raises StoreError."""
    kind = RESULTS[seen.kind]
    for name in kind.beside:
        file = path / name
        if not (file.is_file() and file.stat().st_size):
            seen.findings.append(_missing(name, "is empty" if file.is_file() else "is missing"))
    kind.describe(path, seen)


def _missing(name: str, how: str) -> Finding:
    if name == PROVENANCE:
        return warning(name, how, OF_PROVENANCE)
    return note(name, how, f"{COPY_AGAIN}, or do without: no command reads it")


def _header(seen: Inspection, found: Mapping[str, Any], *without: str) -> None:
    """The format of the JSON `found`, its task, and as the result all of it but the keys `without`."""
    seen.header(found)
    seen.task = found["task"]
    seen.result = {k: v for k, v in found.items() if k not in ("format", "version", *without)}


# --- estimates and diagnoses ---


def _fitted(kind: type[Result], path: Path, seen: Inspection) -> None:
    found = kind.read_document(path)
    _header(seen, found, *(found.keys() - OF_RESULTS))
    seen.sizes = {"parameters": len(found["parameters"]), "effects": len(found["effects"])}
    seen.findings += _verdict(found, path)
    seen.findings += _log_changed(found["log"])
    kind.read(path)  # its arrays too


def _verdict(result: Mapping[str, Any], path: Path) -> Iterator[Finding]:
    if result["verdict"] == "unexplained":
        cure = _cure_of_unexplained(result, path)
        yield warning("verdict", "the residual is above the noise floor: unexplained", cure)
    for name, parameter in result["parameters"].items():
        if not parameter.get("identifiable", True):
            cure = "record a motion in which it matters, or leave it out of the task.toml"
            only = f": it is {told(parameter)}" if parameter.get("limits") else ""
            yield warning(f"parameter {name}", f"the log does not determine it{only}", cure)
        elif parameter.get("at_bound"):
            cure = (
                "widen its bounds if the value is physical; otherwise something else is missing in the model"
            )
            yield warning(f"parameter {name}", "is at a bound", cure)


def _cure_of_unexplained(result: Mapping[str, Any], path: Path) -> str:
    """The cure for an estimate or a diagnosis at `path` that is unexplained, as `identify` gave it."""
    where = "report.html beside it shows where and when the residual is"
    if result["format"] != "capture/estimate":
        formula = result.get("expression") or {}
        return f"a formula describes what is left: {formula['text']}" if formula.get("terms") else where
    record = EstimateRecord.of(result)
    if jitter_share(record) == 1:
        return record.time_stamps["text"]
    if is_fit_explained(record):
        return not_alike(record)
    if record.misread:
        return record.misread["text"]
    if cut_short(record):
        return cut_short(record)[0]
    if result.get("next_command", "") is None:
        return f"check columns, units and signs before anything else: {where}"
    diagnose = ["capture", "diagnose", "--real-log", result["log"]["path"], "--estimate", str(path)]
    return f"`{shlex.join(diagnose)}` looks for what the model lacks"


def _log_changed(log: Mapping[str, Any]) -> Iterator[Finding]:
    path = Path(log["path"])
    if path.exists() and sha256(path) != log.get("sha256"):
        cure = "make the result again from the log as it is now"
        yield warning("log", f"{path} has changed since", cure)


# --- what was trained, and how it does ---


def _identifier(path: Path, seen: Inspection) -> None:
    found = identifier_checkpoint.read_document(path)
    signature = found["signature"]
    _header(seen, found, "signature", "normalisation")
    seen.result |= {key: signature[key] for key in ("parameters", "features")}
    seen.sizes = {
        "parameters": len(signature["parameters"]),
        "actions": len(signature["actions"]),
        "points": len(signature["point_times"]),
    }
    identifier_checkpoint.load_identifier(path)  # its weights too


def _policy(path: Path, seen: Inspection) -> None:
    found = policy_checkpoint.read_policy(path)
    _header(seen, found)
    seen.sizes = {"parameters": len(found["parameters"]), "actions": len(found["actions"])}
    if found["task"] not in TASKS.names():
        policy_checkpoint.read_policy_weights(path, found)
        return
    try:
        policy_checkpoint.load_policy(str(path), load_task(found["task"]))
    except CaptureError as error:
        seen.findings.append(finding("error", "store", error.message, error.cure))


def _evaluation(path: Path, seen: Inspection) -> None:
    _header(seen, Evaluation.read(path).document)
    result = seen.result
    seen.sizes = {key: result[key] for key in ("pairs", "seeds", "rounds")}
    seen.sizes["identifiers"] = len(result["identifiers"])


RESULTS = {
    "diagnosis": ResultFolder(
        "diagnosis.json",
        partial(_fitted, Diagnosis),
        ("report.html", "before_after.png", "stages.png", PROVENANCE),
    ),
    "estimate": ResultFolder(
        "estimate.json",
        partial(_fitted, Estimate),
        ("report.html", "overlay.png", "residual.png", PROVENANCE),
    ),
    "identifier": ResultFolder(
        identifier_checkpoint.DOCUMENT, _identifier, (METRICS, "loss.png", PROVENANCE)
    ),
    "policy": ResultFolder(policy_checkpoint.DOCUMENT, _policy, (METRICS, "training.png", PROVENANCE)),
    "evaluation": ResultFolder(
        "evaluation.json",
        _evaluation,
        ("tables.md", "parameter_difference.png", "trajectory_difference.png", "cost.png", PROVENANCE),
    ),
}
