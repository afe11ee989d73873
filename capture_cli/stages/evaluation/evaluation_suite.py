"""Every comparison of the paper that the checkpoints at hand allow.

A cell is one evaluation: the tables of Section IV-C, the same under noise and with the non-monotonic observation
(Appendix), and the ablations over the length L of histories and the window k.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from capture_cli.common.documents import read_json
from capture_cli.context.checkpoints.identifier_checkpoint import DOCUMENT, read_document
from capture_cli.context.checkpoints.policy_checkpoint import DOCUMENT as POLICY
from capture_cli.context.evaluation.evaluated_identifier import (
    PAPER,
    checkpoints_in,
    how_trained,
    require_extras,
    untrained,
)
from capture_cli.context.evaluation.evaluation_plan import EvaluationPlan, evaluation_plan
from capture_cli.context.evaluation.evaluation_time import Expected
from capture_cli.context.identifiers import REGISTRY
from capture_cli.errors import OptionError, StoreError, did_you_mean
from capture_cli.options.base import takes_options
from capture_cli.options.eval_sim2sim import EvalSim2SimOptions
from capture_cli.stages.evaluation.evaluation_run import carry_out, completed, kept_parts, time_left
from capture_cli.store.document_shape import OBJECT, check_shape
from capture_cli.store.evaluation import SuiteRecord
from capture_cli.store.output import is_complete, refuse_inputs, resumable_directory, unfinished
from capture_cli.store.provenance import Provenance, write_json
from capture_cli.store.result import DocumentKind, read_result
from capture_cli.store.trained import TrainedIdentifier

FORMAT, VERSION = "capture/evaluation-suite", 1
WITHOUT_CHECKPOINT = ("domain-randomization", "compass")  # the paper's; others are named by --identifier
# Rows in the order of the paper's Table II, and within `capture` those of its searches
ORDER = (
    "expert-distillation",
    "expert-distillation-all-rounds",
    "tunenet",
    "tunenet-all-rounds",
    "capture",
    "capture-trajectory",
)
DISTILLED = ("capture", "capture-trajectory")  # whose ablations there are
SEARCHES = ("linear-interpolation", "binary", "randomized-binary")
FACTS = {"history_rounds": "L", "window": "k"}  # what those of PAPER are called
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


@takes_options
def evaluate_suite(options: EvalSim2SimOptions) -> dict[str, Any]:
    """Run every cell of the suite that there is something for; write them below `out`; returns suite.json.

    The identifiers are names, checkpoint directories, and folders that hold some; with a task, cells of it alone. The
    policy may be a folder with one for each task; random where there is none for a task. With `resume` a run that was
    killed goes on within the cell it was at, and one that is complete is read. Raises CaptureError before any work.
    """
    suite, out = options.suite, options.out
    require_extras([*WITHOUT_CHECKPOINT, *options.identifiers])
    cells = _cells(suite, options.task, options.cells)
    names, checkpoints = _found(options.identifiers)
    complete = is_complete(out, force=options.force, resume=options.resume)
    asked = {
        c: replace(
            options,
            task=c.task,
            identifiers=own,
            policy=_policy(options.policy, c.task),
            noise=c.noise,
            out=out / c.name,
            force=False,
            resume=True,
        )
        for c in cells
        if (own := _members(c, names, checkpoints))
    }
    without = [c.name for c in cells if c not in asked]
    not_used = _not_used(suite, cells, asked, checkpoints)
    if not asked:
        spare = f" (not used: {'; '.join(not_used)})" if not_used else ""
        raise OptionError(
            f"--suite {suite}: no checkpoint for {', '.join(sorted({c.task for c in cells}))}{spare}",
            cure="give --identifier a folder with checkpoints that `capture train-sysid` wrote",
        )
    plans = {c: evaluation_plan(o, spelled_out=[c.varied] if c.varied else []) for c, o in asked.items()}
    if complete:
        return _completed(out, plans)
    refuse_inputs(out, [path for plan in plans.values() for path in plan.inputs])
    provenance = Provenance("eval-sim2sim", options.recorded(), {})

    def kept(folder: Path) -> str:
        whole = sum((folder / cell.name).is_dir() for cell in plans)
        parts = sum(kept_parts(unfinished(folder / cell.name)) for cell in plans)
        if not whole + parts:
            return ""
        return f"{whole} of {len(plans)} cells are kept" + f", and {parts} parts of another" * bool(parts)

    with resumable_directory(out, kept=kept, force=options.force, resume=options.resume) as folder:
        if not options.quiet:
            _announce(plans, without, not_used, folder)
        documents = _evaluate_all(plans, asked, folder, options.quiet)
        document = {
            "format": FORMAT,
            "version": VERSION,
            "suite": suite,
            "cells": documents,
            "without": without,
            "not_used": not_used,
        }
        write_json(folder / "suite.json", document)
        _write_tables(documents, folder)
        provenance.write(folder)
    return document


def _announce(
    plans: dict[Cell, EvaluationPlan], without: list[str], not_used: list[str], folder: Path
) -> None:
    """On stderr: what every cell is about, what is left out, and how long it will all take."""
    in_all = Expected()
    for cell, plan in plans.items():
        labels = ", ".join(e.label for e in plan.evaluated)
        print(f"{cell.name}: {labels}; policy {plan.attributes['policy']['name']}", file=sys.stderr)
        left = None if (folder / cell.name).exists() else time_left(plan, folder / cell.name, resume=True)
        if left:
            print(f"  {left}", file=sys.stderr, flush=True)
            in_all += left
    if without:
        print(f"nothing to run, for want of checkpoints: {', '.join(without)}", file=sys.stderr)
    for checkpoint in not_used:
        print(f"not used: {checkpoint}", file=sys.stderr)
    if in_all.rollouts:
        print(f"in all {in_all}", file=sys.stderr, flush=True)


def _evaluate_all(
    plans: dict[Cell, EvaluationPlan], asked: dict[Cell, EvalSim2SimOptions], folder: Path, quiet: bool
) -> dict[str, dict[str, Any]]:
    """evaluation.json of every cell, by its name; they are written into `folder`, which becomes the suite's."""
    documents = {}
    for number, (cell, plan) in enumerate(plans.items(), 1):
        if not quiet:
            print(f"[{number}/{len(plans)}] {cell.name}", file=sys.stderr, flush=True)
        place = folder / cell.name  # which an earlier run may have completed or begun
        made = completed(place, plan) if place.exists() else carry_out(plan, asked[cell], place)
        documents[cell.name] = made.document
    return documents


def _completed(out: Path, plans: dict[Cell, EvaluationPlan]) -> dict[str, Any]:
    """The suite at `out`, if it is the one that is planned. Raises CaptureError otherwise."""
    again = "make it again with `capture eval-sim2sim --suite`"
    document = read_result(out, "suite.json", DocumentKind(FORMAT, VERSION, again))
    names = [cell.name for cell in plans]
    cells = SuiteRecord.of(document).cells
    if list(cells) != names:
        raise OptionError(
            f"--resume: {out} holds {', '.join(cells)}; asked for are {', '.join(names)}",
            cure="give the options it was begun with, or begin anew with --force",
        )
    for cell, plan in plans.items():
        completed(out / cell.name, plan)
    return document


def _cells(suite: str, task: str | None, only: Sequence[str]) -> list[Cell]:
    tasks = {c.task for c in SUITES[suite]}
    if task is not None and task not in tasks:
        raise OptionError(f"--suite {suite} has no task {task!r}", cure=did_you_mean(task, tasks))
    cells = {c.name: c for c in SUITES[suite] if task in (None, c.task)}
    for name in only:
        if name not in cells:
            raise OptionError(f"--cell {name!r}", cure=did_you_mean(name, cells))
    return [c for c in cells.values() if not only or c.name in only]


def _found(given: Sequence[str]) -> tuple[list[str], list[tuple[Path, TrainedIdentifier]]]:
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
            checkpoints += [(path, TrainedIdentifier.of(read_document(path))) for path in inside]
        else:
            REGISTRY.get(text, untrained)
            names += [] if text in names else [text]
    return names, checkpoints


def _members(cell: Cell, names: list[str], checkpoints: list[tuple[Path, TrainedIdentifier]]) -> list[str]:
    """What to give to `--identifier` for the cell; nothing where no checkpoint is for it."""
    own = [(path, d) for path, d in checkpoints if d.task == cell.task]
    if cell.varied:
        return [path for name in DISTILLED for path in _ablated(cell.varied, name, own)]
    chosen = [(p, d) for p, d in own if _others(d, "search") <= _own_window(d)]
    chosen.sort(key=lambda found: _place(found[1]))
    refined = [str(p) for p, d in chosen if d.identifier == REFINED]
    trained_so = any(d.identifier == UNREFINED for _, d in chosen)
    unrefined = [] if trained_so else [f"{UNREFINED}={path}" for path in refined[:1]]
    others = [str(p) for p, _ in chosen if str(p) not in refined]
    return [*names, *others, *unrefined, *refined] if chosen else []


def _ablated(varied: str, name: str, own: list[tuple[Path, TrainedIdentifier]]) -> list[str]:
    """The checkpoints of the identifier `name` that differ in `varied` alone, where there are several."""
    chosen = [(p, d) for p, d in own if d.identifier == name and not _others(d, varied)]
    chosen.sort(key=lambda found: how_trained(found[1])[varied])
    return [str(p) for p, _ in chosen] if len(chosen) > 1 else []


def _not_used(
    suite: str,
    cells: Sequence[Cell],
    asked: Mapping[Cell, EvalSim2SimOptions],
    checkpoints: list[tuple[Path, TrainedIdentifier]],
) -> list[str]:
    """Checkpoints that no cell takes, and why; not those of tasks of the suite that were not asked for."""
    taken = {text for options in asked.values() for text in options.identifiers}
    left_alone = {c.task for c in SUITES[suite]} - {c.task for c in cells}
    return [
        f"{path} ({_why_not(trained, cells)})"
        for path, trained in checkpoints
        if str(path) not in taken and trained.task not in left_alone
    ]


def _why_not(trained: TrainedIdentifier, cells: Sequence[Cell]) -> str:
    """Why a checkpoint is in no cell."""
    if trained.task not in {c.task for c in cells}:
        return f"of the task {trained.task!r}"
    facts, unlike = how_trained(trained), _others(trained, "search") - _own_window(trained)
    if not unlike:
        return f"the ablations asked for compare several of {' or of '.join(DISTILLED)}"
    said = [f"{FACTS[name]} {facts[name]}, in the paper {PAPER[name]}" for name in PAPER if name in unlike]
    return f"{'; '.join(said)}; an ablation takes several of {' or of '.join(DISTILLED)} that differ in one such alone"


def _place(trained: TrainedIdentifier) -> tuple[int, int]:
    """Where in a table: as in the paper's, what is ours below."""
    name, search = trained.identifier, trained.histories["search"]
    return (
        ORDER.index(name) if name in ORDER else len(ORDER),
        SEARCHES.index(search) if search in SEARCHES else len(SEARCHES),
    )


def _others(trained: TrainedIdentifier, varied: str) -> set[str]:
    """In what a checkpoint differs from the paper's, besides `varied`."""
    facts = how_trained(trained)
    return {name for name, value in PAPER.items() if name != varied and facts[name] != value}


def _own_window(trained: TrainedIdentifier) -> set[str]:
    """The window is no difference where the identifier has one of its own."""
    kind = REGISTRY.get(trained.identifier)
    return {"window"} if kind.fixed_window is not None or kind.default_window is None else set()


def _policy(given: str, task: str) -> str:
    """The policy for `task`: `given` itself, or the one below it that was trained for the task; else random."""
    folder = Path(given)
    if not folder.is_dir():
        return given
    for path in sorted(folder.rglob(POLICY)):
        found = read_json(path, StoreError, cure="train the policy again")
        check_shape(found, OBJECT, path, "train the policy again")
        if found.get("task") == task:
            return str(path.parent)
    return "random"


def _write_tables(documents: dict[str, dict[str, Any]], folder: Path) -> None:
    from capture_cli.report.evaluation_tables import markdown

    pages = [f"<!-- {name} -->\n\n{markdown(document, title=name)}" for name, document in documents.items()]
    (folder / "tables.md").write_text("\n".join(pages), encoding="utf-8")
