"""What `eval-sim2sim` is given to evaluate: identifiers by name, and checkpoints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from capture_cli.common.extras import require
from capture_cli.context.checkpoints.checkpoint_hash import checkpoint_hash
from capture_cli.context.checkpoints.identifier_checkpoint import DOCUMENT, load_identifier
from capture_cli.context.identifiers import REGISTRY, round_identifier
from capture_cli.context.identifiers._architecture import DEFAULT_TOKENS
from capture_cli.context.identifiers.base import RoundIdentifier, Signature
from capture_cli.errors import OptionError
from capture_cli.estimate.solve.base import AskTell
from capture_cli.model.effects.placed import Placed
from capture_cli.model.tasks.base import ActionTask
from capture_cli.store.trained import TrainedIdentifier

if TYPE_CHECKING:
    from capture_cli.context.identifiers._learned import TrainedModel

# What a label leaves out: the paper's search, L and k.
PAPER = {"search": "randomized-binary", "history_rounds": 7, "window": 4}


@dataclass(frozen=True)
class Evaluated:
    """An identifier to evaluate. label: what it is called in tables. facts: what the evaluation says of it.

    path: its checkpoint's, where it has one. effects: with values (parameter,), that it simulates with. numbers: of the
    identifier's, by name, that were set.
    """

    label: str
    kind: type[RoundIdentifier]
    model: TrainedModel | None
    facts: Mapping[str, Any]
    path: Path | None = None
    effects: Sequence[tuple[Placed, np.ndarray]] = ()
    numbers: Mapping[str, int] = field(default_factory=dict)

    def make(self, signature: Signature, start, **options) -> RoundIdentifier:
        """The identifier for pairs that begin at `start` (pair, parameter)."""
        kind = self.kind if self.model is None else partial(self.kind, model=self.model)
        return kind(signature, start, **self.numbers, **options)


def load_evaluated(
    given: Sequence[str], task: ActionTask, spelled_out: Sequence[str], numbers: Mapping[str, int]
) -> list[Evaluated]:
    """The identifiers of `--identifier`: each a name, a checkpoint directory, or NAME=DIRECTORY.

    NAME=DIRECTORY: the identifier NAME with what was trained for another (`posterior` with what `capture-refined` was
    trained to). Labels are made different. spelled_out: facts that labels give where they are the paper's, too.
    numbers: for identifiers that let them be set. Raises CaptureError.
    """
    if not given:
        raise OptionError("no --identifier", cure=f"give a checkpoint directory, or {', '.join(by_name())}")
    found = [_load(text, task, spelled_out, numbers) for text in given]
    for name in numbers:
        if not any(name in e.numbers for e in found):
            takes = ", ".join(n for n, c in REGISTRY.items() if name in c.settable)
            raise OptionError(
                f"--{name.replace('_', '-')} without an identifier that has such",
                cure=f"add --identifier {takes}, or leave it out",
            )
    return _distinct(found)


def require_extras(given: Sequence[str]) -> None:
    """Raise OptionError where an identifier of `--identifier` that is given by name needs an extra that is missing."""
    for text in given:
        if text in REGISTRY.names() and not Path(text).exists() and (extra := REGISTRY.get(text).extra):
            require(extra, f"the identifier {text}")


def checkpoints_in(folder: str | Path) -> list[Path]:
    """Directories at or below `folder` that hold a learned identifier, sorted."""
    return sorted(p.parent for p in Path(folder).rglob(DOCUMENT) if ".unfinished" not in str(p))


def how_trained(trained: TrainedIdentifier) -> dict[str, Any]:
    """What identifier.json says of the options that are the PAPER's or not, and of the tokens."""
    return {
        "search": trained.histories["search"],
        "history_rounds": trained.histories["rounds"],
        "window": trained.architecture["window"],
        "tokens": trained.architecture["tokens"],
    }


def by_name() -> list[str]:
    """Identifiers that need no checkpoint."""
    return [n for n, c in REGISTRY.items() if untrained(c)]


def untrained(kind: type[AskTell]) -> bool:
    """Whether it needs no checkpoint."""
    return not kind.needs_checkpoint


def _load(text: str, task: ActionTask, spelled_out: Sequence[str], numbers: Mapping[str, int]) -> Evaluated:
    name, _, folder = text.rpartition("=") if not Path(text).exists() else ("", "", text)
    path = Path(folder)
    if not name and not path.is_dir():
        return _named(text, numbers)
    if not (path / DOCUMENT).is_file():
        inside = [str(p) for p in checkpoints_in(path)] if path.is_dir() else []
        below = f"; below it there are {', '.join(inside)}" if inside else ""
        raise OptionError(
            f"--identifier {text}: there is no {DOCUMENT} in {path}{below}",
            cure=f"give a directory that `train-sysid` wrote, or {', '.join(by_name())}",
        )
    found = load_identifier(path, Signature.of(task))
    kind = round_identifier(name) if name else found.kind
    if kind is not found.kind and not (kind.needs_checkpoint and kind.likelihood and found.kind.likelihood):
        raise OptionError(
            f"--identifier {text}: what was trained for {found.name!r} is of no use to {name!r}",
            cure=f"leave `{name}=` out, or train one with `capture train-sysid --identifier {name}`",
        )
    trained, name = found.record, name or found.name
    facts = {
        "identifier": name,
        "checkpoint": path.name,
        "sha256": checkpoint_hash(path),
        **how_trained(trained),
        "history_noise": trained.histories["noise"],
        "pairs_trained": trained.result["pairs"]["trained"],
    }
    effects = found.machine(task).effects
    if effects:
        facts["effects"] = [placed.name for placed, _ in effects]
    return Evaluated(_label(name, kind, facts, spelled_out), kind, found.model, facts, path, effects)


def _named(name: str, numbers: Mapping[str, int]) -> Evaluated:
    kind = round_identifier(name, untrained)
    if kind.needs_checkpoint:
        raise OptionError(
            f"--identifier {name} must be trained",
            cure=f"give the directory that `capture train-sysid --identifier {name}` wrote",
        )
    own = {n: value for n, value in numbers.items() if n in kind.settable}
    said = ", ".join(f"{n}={value}" for n, value in own.items())
    label = f"{name} ({said})" if own else name
    facts = {"identifier": name, "checkpoint": None, "sha256": None}
    return Evaluated(label, kind, None, facts, numbers=own)


def _label(
    name: str, kind: type[RoundIdentifier], facts: Mapping[str, Any], spelled_out: Sequence[str]
) -> str:
    """The name, and in what it is not the paper's; and what is to be spelled out."""
    said = {name for name, value in PAPER.items() if facts[name] != value or name in spelled_out}
    # who learns the target, and not the search, has histories of any kind
    others = [facts["search"]] if "search" in said and not kind.any_order else []
    if "history_rounds" in said:
        others.append(f"L={facts['history_rounds']}")
    if "window" in said and kind.fixed_window is None and kind.default_window:
        others.append(f"k={facts['window']}")
    if kind.tokens is None and facts["tokens"] != DEFAULT_TOKENS:
        others.append(f"token per {facts['tokens']}")
    if "effects" in facts:
        others.append(f"with {', '.join(facts['effects'])}")
    if facts["history_noise"] != "none":
        others.append(f"trained with noise: {facts['history_noise']}")
    return f"{name} ({', '.join(others)})" if others else name


def _distinct(found: list[Evaluated]) -> list[Evaluated]:
    """Those that share a label are told apart by their directories, by name or else by path.

    Raises OptionError where one is given twice.
    """
    result = found
    for told_by in (attrgetter("name"), str):
        labels = [e.label for e in result]
        result = [
            replace(e, label=f"{first.label} [{told_by(e.path)}]")
            if e.path and labels.count(e.label) > 1
            else e
            for e, first in zip(result, found, strict=True)
        ]
    labels = [e.label for e in result]
    twice = {label for label in labels if labels.count(label) > 1}
    if twice:
        raise OptionError(f"--identifier: {', '.join(sorted(twice))} is given twice", cure="give each once")
    return result
