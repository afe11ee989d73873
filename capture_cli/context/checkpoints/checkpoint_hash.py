"""What tells one checkpoint, of a policy or an identifier, from another: its document and its weights, and no more.

Figures, metrics and what a file manager leaves beside them change nothing. Until these were left out all files of the
folder counted; what recorded such a hash still belongs to the checkpoint.
"""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from capture_cli.context.checkpoints import identifier_checkpoint, policy_checkpoint
from capture_cli.store.output import sha256

PARTS = {
    policy_checkpoint.DOCUMENT,
    policy_checkpoint.WEIGHTS,
    identifier_checkpoint.DOCUMENT,
    identifier_checkpoint.WEIGHTS,
}


def checkpoint_hash(folder: str | Path) -> str:
    """sha256 of the parts of the checkpoint in `folder`."""
    return sha256(Path(folder), only=PARTS)


def with_new_hashes(recorded: Any, checkpoints: Iterable[str | Path]) -> Any:
    """What was recorded (JSON) with the hashes of all files of these checkpoints replaced by those of their parts."""
    text = json.dumps(recorded)
    for folder in checkpoints:
        text = text.replace(sha256(Path(folder)), checkpoint_hash(folder))
    return json.loads(text)


def recorded_policy(policy: str) -> dict[str, str | None]:
    """What outputs say of who chose actions."""
    if policy_checkpoint.is_checkpoint(policy):
        return {"name": Path(policy).name, "sha256": checkpoint_hash(policy)}
    return {"name": policy, "sha256": None}
