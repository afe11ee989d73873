"""Which identifier `identify` uses: one by name, one of a checkpoint directory, or the one shipped for the task."""

from dataclasses import dataclass
from pathlib import Path

import capture_cli
from capture_cli.context.checkpoints.identifier_checkpoint import (
    DOCUMENT,
    IdentifierCheckpoint,
    load_identifier,
)
from capture_cli.context.identifiers import REGISTRY, log_identifier, log_identifiers
from capture_cli.errors import OptionError, did_you_mean
from capture_cli.estimate.solve.base import Identifier
from capture_cli.estimate.solve.least_squares import LeastSquares
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks.base import Task

# data of the package, so that an installed program has them too; runs/ says how they were made
SHIPPED = Path(capture_cli.__file__).parent / "checkpoints"


@dataclass(frozen=True)
class ChosenIdentifier:
    """A method that fits whole logs, and where the identifier was learned, its checkpoint, which goes before."""

    name: str
    method: type[Identifier]
    checkpoint: IdentifierCheckpoint | None = None
    path: Path | None = None


def choose_identifier(given: str | None, task: Task, log: MeasuredLog) -> ChosenIdentifier:
    """The identifier of `--identifier`; where that is None, the one shipped for the task, or least squares.

    Raises CaptureError.
    """
    if given is None:
        shipped = shipped_for(task.name)
        if shipped is None or log.actions is None:
            return ChosenIdentifier("least-squares", LeastSquares)
        return _learned(shipped)
    path = Path(given)
    if (path / DOCUMENT).is_file():
        return _learned(path)
    if path.is_dir():
        raise OptionError(
            f"--identifier {given}: there is no {DOCUMENT} in it",
            cure="give a directory that `capture train-sysid` wrote",
        )
    if len(path.parts) > 1:
        raise OptionError(
            f"--identifier {given}: there is no such directory",
            cure="give a directory that `capture train-sysid` wrote, or the name of an identifier",
        )
    if given not in REGISTRY.names():
        raise OptionError(
            f"unknown identifier {given!r}",
            cure=f"{did_you_mean(given, log_identifiers())}; or give a directory that `capture train-sysid` wrote",
        )
    if REGISTRY.get(given).needs_checkpoint:
        raise OptionError(
            f"--identifier {given} must be trained",
            cure=f"give the directory that `capture train-sysid --identifier {given}` wrote",
        )
    return ChosenIdentifier(given, log_identifier(given))


def shipped_for(task: str) -> Path | None:
    """The checkpoint directory that is shipped for the built-in task called so; None where there is none."""
    path = SHIPPED / task
    return path if (path / DOCUMENT).is_file() else None


def _learned(path: Path) -> ChosenIdentifier:
    checkpoint = load_identifier(path)
    return ChosenIdentifier(checkpoint.name, LeastSquares, checkpoint, path)
