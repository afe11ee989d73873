"""What is read of what a training wrote: identifier.json and policy.json."""

from __future__ import annotations

from dataclasses import dataclass

from capture_cli.store.result import Keys, Row


@dataclass(frozen=True, kw_only=True)
class TrainedIdentifier(Keys):
    """identifier.json, as reports read it."""

    identifier: str
    task: str
    architecture: Row
    training: Row
    result: Row


@dataclass(frozen=True, kw_only=True)
class TrainedPolicy(Keys):
    """policy.json, as reports read it."""

    policy: str
    task: str
    result: Row
