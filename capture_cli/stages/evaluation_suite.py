"""Every comparison of the paper that the checkpoints at hand allow. Shared by stages.

A cell is one evaluation: the tables of Section IV-C, the same under noise and with the non-monotonic observation
(Appendix), and the ablations over the length L of histories and the window k.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from capture_cli.errors import OptionError, StoreError, did_you_mean
from capture_cli.identifiers import REGISTRY
from capture_cli.stages.evaluated_identifier import PAPER, checkpoints_in
from capture_cli.stages.evaluation_run import evaluate
from capture_cli.stages.identifier_checkpoint import DOCUMENT
from capture_cli.stages.policy_checkpoint import SETTINGS
from capture_cli.stores.output import refuse_existing, resumable_directory
from capture_cli.stores.provenance import Provenance, write_json

FORMAT, VERSION = "capture/evaluation-suite", 1
WITHOUT_CHECKPOINT = ("domain-randomization", "compass")  # the paper's; others are named by --identifier
REFINED, UNREFINED = "capture-refined", "posterior"


@dataclass(frozen=True)
class Cell:
    """One evaluation. varied: the fact of a checkpoint that an ablation varies; None: everything as in the paper."""

    name: str
    task: str
    noise: str = "none"
    varied: str | None = None


SUITES = {
    "paper": (
        Cell("air-hockey", "air-hockey"),
        Cell("air-hockey-noise", "air-hockey", noise="scale"),
        Cell("air-hockey-L", "air-hockey", varied="history_rounds"),
        Cell("air-hockey-k", "air-hockey", varied="window"),
        Cell("scooping", "scooping"),
        Cell("scooping-noise", "scooping", noise="label"),
        Cell("scooping-distance", "scooping-distance"),
        Cell("scooping-L", "scooping", varied="history_rounds"),
        Cell("scooping-k", "scooping", varied="window"),
    )
}


def evaluate_suite(
    *,
    suite: str,
    identifiers: Sequence[str],
    out: Path,
    task: str | None = None,
    policy: str = "random",
    pairs: int = 100,
    seeds: int = 3,
    rounds: int = 30,
    seed: int = 0,
    threads: int | None = None,
    force: bool = False,
    resume: bool = False,
    quiet: bool = True,
) -> dict[str, Any]:
    """Run every cell of `suite` that there is something for; write them below `out`; returns suite.json.

    identifiers: names, checkpoint directories, and folders that hold some. task: cells of this task alone. policy: a
    name, a checkpoint directory, or a folder with one for each task; random where there is none for a task. With
    `resume` a run that was killed goes on within the cell it was at. Raises CaptureError.
    """
    options = {k: v for k, v in locals().items() if k not in ("force", "resume", "quiet")}
    cells = [c for c in _suite(suite) if task in (None, c.task)]
    names, checkpoints = _found(identifiers)
    if not resume:
        refuse_existing(out, force=force)
    plan = {c: _members(c, names, checkpoints) for c in cells}
    if not any(plan.values()):
        raise OptionError(
            f"--suite {suite}: no checkpoint for {', '.join(sorted({c.task for c in cells})) or task}",
            cure="give --identifier a folder with checkpoints that `capture train-sysid` wrote",
        )
    if resume and not force and (Path(out) / "suite.json").is_file():
        return _read(Path(out))
    provenance = Provenance("eval-sim2sim", options, {})
    documents = {}
    with resumable_directory(out, force=force, resume=resume) as folder:
        for number, (cell, members) in enumerate(plan.items(), 1):
            if not quiet:
                what = ", ".join(members) if members else "nothing to run: no checkpoint for it"
                print(f"[{number}/{len(plan)}] {cell.name}: {what}", file=sys.stderr, flush=True)
            if members:
                documents[cell.name] = evaluate(
                    task=cell.task,
                    identifiers=members,
                    out=folder / cell.name,
                    policy=_policy(policy, cell.task),
                    pairs=pairs,
                    seeds=seeds,
                    rounds=rounds,
                    noise=cell.noise,
                    seed=seed,
                    threads=threads,
                    resume=True,
                    quiet=quiet,
                ).document
        document = {
            "format": FORMAT,
            "version": VERSION,
            "suite": suite,
            "cells": documents,
            "without": [c.name for c, members in plan.items() if not members],
        }
        write_json(folder / "suite.json", document)
        _write_tables(documents, folder)
        provenance.write(folder)
    return document


def _suite(name: str) -> tuple[Cell, ...]:
    if name not in SUITES:
        raise OptionError(f"--suite {name!r}", cure=did_you_mean(name, SUITES))
    return SUITES[name]


def _found(given: Sequence[str]) -> tuple[list[str], list[tuple[Path, dict[str, Any]]]]:
    """Names, and checkpoint directories with their identifier.json."""
    names, checkpoints = list(WITHOUT_CHECKPOINT), []
    for text in given:
        if Path(text).is_dir():
            inside = checkpoints_in(text)
            if not inside:
                raise OptionError(
                    f"--identifier {text} holds no {DOCUMENT}",
                    cure="give a folder that `train-sysid` wrote to",
                )
            checkpoints += [
                (path, json.loads((path / DOCUMENT).read_text(encoding="utf-8"))) for path in inside
            ]
        else:
            REGISTRY.get(text)
            names += [] if text in names else [text]
    return names, checkpoints


def _members(cell: Cell, names: list[str], checkpoints: list[tuple[Path, dict[str, Any]]]) -> list[str]:
    """What to give to `--identifier` for the cell; nothing where no checkpoint is for it."""
    own = [(path, d) for path, d in checkpoints if d["task"] == cell.task]
    if cell.varied:
        chosen = [(p, d) for p, d in own if d["identifier"] == "capture" and not _others(d, cell.varied)]
        chosen.sort(key=lambda found: _facts(found[1])[cell.varied])
        return [str(p) for p, _ in chosen] if len(chosen) > 1 else []
    chosen = [(p, d) for p, d in own if _others(d, "search") <= _own_window(d)]
    refined = [str(p) for p, d in chosen if d["identifier"] == REFINED]
    trained_so = any(d["identifier"] == UNREFINED for _, d in chosen)
    without = [] if trained_so else [f"{UNREFINED}={path}" for path in refined[:1]]
    return [*names, *(str(p) for p, _ in chosen), *without] if chosen else []


def _facts(document: dict[str, Any]) -> dict[str, Any]:
    return {
        "search": document["histories"]["search"],
        "history_rounds": document["histories"]["rounds"],
        "window": document["architecture"]["window"],
        "tokens": document["architecture"]["tokens"],
    }


def _others(document: dict[str, Any], varied: str) -> set[str]:
    """In what a checkpoint differs from the paper's, besides `varied`."""
    facts = _facts(document)
    return {name for name, value in PAPER.items() if name != varied and facts[name] != value}


def _own_window(document: dict[str, Any]) -> set[str]:
    """The window is no difference where the identifier has one of its own."""
    kind = REGISTRY.get(document["identifier"])
    return {"window"} if kind.fixed_window is not None or kind.default_window is None else set()


def _policy(given: str, task: str) -> str:
    """The policy for `task`: `given` itself, or the one below it that was trained for the task; else random."""
    folder = Path(given)
    if not folder.is_dir():
        return given
    for path in sorted(folder.rglob(SETTINGS)):
        try:
            if json.loads(path.read_text(encoding="utf-8")).get("task") == task:
                return str(path.parent)
        except (json.JSONDecodeError, AttributeError) as error:
            raise StoreError(f"{path} cannot be read: {error}", cure="train the policy again") from error
    return "random"


def _read(out: Path) -> dict[str, Any]:
    from capture_cli.stores.estimate import read_result

    return dict(
        read_result(out, "suite.json", FORMAT, VERSION, "make it again with `capture eval-sim2sim --suite`")
    )


def _write_tables(documents: dict[str, dict[str, Any]], folder: Path) -> None:
    from capture_cli.reports.evaluation_tables import markdown

    pages = [f"<!-- {name} -->\n\n{markdown(document, title=name)}" for name, document in documents.items()]
    (folder / "tables.md").write_text("\n".join(pages), encoding="utf-8")
