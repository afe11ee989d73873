"""Records of the documents that a training writes: identifier.json and policy.json."""

from collections.abc import Sequence
from dataclasses import dataclass

from capture_cli.store.result import Keys, Row


@dataclass(frozen=True, kw_only=True)
class TrainedIdentifier(Keys):
    """identifier.json."""

    identifier: str
    task: str
    architecture: Row
    training: Row
    histories: Row
    result: Row


@dataclass(frozen=True, kw_only=True)
class TrainedPolicy(Keys):
    """policy.json."""

    policy: str
    task: str
    parameters: Sequence[str]
    actions: Sequence[str]
    bounds: Row
    settings: Row
    result: Row | None = None  # of one that `train-policy` wrote
