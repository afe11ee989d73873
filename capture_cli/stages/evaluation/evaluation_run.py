"""One evaluation: identifiers against each other on the same pairs (paper, Section IV-C)."""

import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.common.documents import read_json
from capture_cli.common.progress import Progress
from capture_cli.context.checkpoints.checkpoint_hash import with_new_hashes
from capture_cli.context.checkpoints.training_state import check_made
from capture_cli.context.evaluation.evaluated_identifier import Evaluated
from capture_cli.context.evaluation.evaluation_plan import EvaluationPlan, evaluation_plan
from capture_cli.context.evaluation.evaluation_summary import summary
from capture_cli.context.evaluation.evaluation_time import Expected, expected
from capture_cli.context.evaluation.sim2sim import Sim2Sim
from capture_cli.errors import OptionError, StoreError
from capture_cli.model.effects.ranges import NO_EFFECTS
from capture_cli.options.base import takes_options
from capture_cli.options.eval_sim2sim import EvalSim2SimOptions
from capture_cli.stages.simulated_machine import SimulatedMachine
from capture_cli.store.evaluation import FORMAT, SCHEMA, VERSION, Evaluation, joined
from capture_cli.store.output import NEW, is_complete, refuse_inputs, renewed, resumable_directory, unfinished
from capture_cli.store.provenance import Provenance, code_hash, write_json

PARTS, RECIPE = "parts", "recipe.json"  # of a run that is not complete


@takes_options
def evaluate(options: EvalSim2SimOptions) -> Evaluation:
    """Evaluate the identifiers on `pairs` pairs of the task, `seeds` times; write the evaluation directory at `out`.

    Identifiers simulate with the effects that their histories had; machines have those of the options, or are played
    in its world. With `resume` a run that was killed goes on after the identifier and seed it last completed, and one
    that is complete is read. The arrays do not depend on `threads`. Raises CaptureError before any work.
    """
    machines = NO_EFFECTS
    if options.effects and options.task is not None:
        machines = SimulatedMachine.to_learn_in(options.task, None, options.effects).effects
    plan = evaluation_plan(options, machines)
    if is_complete(options.out, force=options.force, resume=options.resume):
        return completed(options.out, plan)
    refuse_inputs(options.out, plan.inputs)
    if not options.quiet and (left := time_left(plan, options.out, resume=options.resume)):
        print(left, file=sys.stderr, flush=True)
    return carry_out(plan, options)


def completed(out: Path, plan: EvaluationPlan) -> Evaluation:
    """The evaluation at `out`, if it is the one that is planned. Raises CaptureError otherwise."""
    evaluation = Evaluation.read(out)
    _, seeds, pairs, entries = evaluation.arrays["trajectory_difference"].shape
    found = {"pairs": pairs, "seeds": seeds, "rounds": entries - 1, **evaluation.attributes}
    _check_same(found, plan, out)
    return evaluation


def time_left(plan: EvaluationPlan, out: Path, *, resume: bool) -> Expected | None:
    """About how long `carry_out` will take; None where that is not worth saying."""
    parts = _todo(plan, unfinished(out)) if resume else plan.parts()
    return expected([(e, draw) for _, e, draw in parts])


def carry_out(plan: EvaluationPlan, options: EvalSim2SimOptions, place: Path | None = None) -> Evaluation:
    """Do what `plan` says and write the evaluation directory; place: where it is written until all of a suite is, at
    `out` itself where None.
    """
    provenance = Provenance("eval-sim2sim", options.recorded(), {})

    def kept(folder: Path) -> str:
        count = kept_parts(folder)
        return f"{count} of {len(plan.parts())} parts are kept" if count else ""

    with resumable_directory(
        place or options.out, kept=kept, scaffold=(PARTS, RECIPE), force=options.force, resume=options.resume
    ) as folder:
        _begin(folder, plan)
        _run(plan, folder, options.quiet)
        arrays = _joined(plan, folder)
        tables = summary(arrays, plan.attributes, plan.task.trainable)
        evaluation = Evaluation({"format": FORMAT, "version": VERSION, **tables}, arrays, plan.attributes)
        evaluation.write(folder)
        _write_reports(evaluation, folder)
        provenance.write(folder)
    return evaluation


def kept_parts(folder: Path) -> int:
    """How many parts of an evaluation an earlier run has completed in `folder`."""
    return sum(path.suffix != NEW for path in (folder / PARTS).glob("*"))


def _begin(folder: Path, plan: EvaluationPlan) -> None:
    """Take note of what is run and by which code, or see that it is what an earlier run took note of.

    All rows of an evaluation are of one code: those of another would be compared with what has changed since.
    """
    path = folder / RECIPE
    (folder / PARTS).mkdir(exist_ok=True)
    if path.is_file():
        noted = read_json(path, StoreError, cure="begin anew with --force")
        _check_same(noted, plan, folder)
        if noted.get("code") == code_hash():
            return
        if count := kept_parts(folder):
            raise OptionError(
                f"--resume: {count} of {len(plan.parts())} parts in {folder} are of another version of the program",
                cure="begin anew with --force, so that all rows are of one, or go on with that version",
            )
    with renewed(path) as file:
        write_json(file, {**plan.recipe, "code": code_hash()})


def _check_same(found: dict[str, Any], plan: EvaluationPlan, where: Path) -> None:
    known = with_new_hashes({"effects": [], "world": "plant", "robot": None, **found}, plan.inputs)
    check_made(known, plan.recipe, f"the run at {where}")


def _todo(plan: EvaluationPlan, folder: Path) -> list[tuple[str, Evaluated, Sim2Sim]]:
    """The parts of which `folder` has no result yet."""
    return [part for part in plan.parts() if not (folder / PARTS / part[0]).is_dir()]


def _run(plan: EvaluationPlan, folder: Path, quiet: bool) -> None:
    parts, todo = folder / PARTS, _todo(plan, folder)
    seeds, rounds = len(plan.draws), plan.draws[0].rounds
    with Progress("eval-sim2sim", "round", quiet=quiet, total=len(todo) * rounds) as progress:
        for name, e, draw in todo:
            label = f"{e.label}, seed {draw.number + 1} of {seeds}"
            arrays = draw.run(
                e.make, lambda n, label=label: progress.step(f"{label}, round {n + 1}"), e.effects
            )
            _keep(parts / name, arrays, draw, plan.attributes)


def _keep(path: Path, arrays: dict[str, np.ndarray], draw: Sim2Sim, attributes: dict) -> None:
    source, target = draw.ends()
    arrays = {name: a[None, None] for name, a in arrays.items()}
    arrays |= {"source": source[None], "target": target[None]}
    with renewed(path) as beside:
        shutil.rmtree(beside, ignore_errors=True)
        SCHEMA.write(beside, arrays, attributes)


def _joined(plan: EvaluationPlan, folder: Path) -> dict[str, np.ndarray]:
    read = [SCHEMA.read(folder / PARTS / name)[0] for name, _, _ in plan.parts()]
    seeds = len(plan.draws)
    of_identifiers = [joined(read[i : i + seeds], "seed") for i in range(0, len(read), seeds)]
    return joined(of_identifiers, "identifier")


def _write_reports(evaluation: Evaluation, folder: Path) -> None:
    from capture_cli.report.evaluation_figures import write_figures
    from capture_cli.report.evaluation_tables import markdown

    (folder / "tables.md").write_text(markdown(evaluation.document), encoding="utf-8")
    write_figures(evaluation.document, folder)
