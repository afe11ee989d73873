"""`capture diagnose`: what the model lacks, traced to an effect, added, and the error before and after."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.diagnosis.split import EarlierSplit
from capture_cli.errors import CaptureError, Interrupted, OptionError, StoreError
from capture_cli.protocol.attribution import MOST_EFFECTS
from capture_cli.protocol.explain import Settings, explain
from capture_cli.protocol.prepare import prepare
from capture_cli.protocol.prepared_log import PreparedLog
from capture_cli.stages.diagnosis_document import diagnosis_of
from capture_cli.stages.earlier_estimate import continues
from capture_cli.stages.kept_steps import ENDS, OPTIONS, recipe_of, unfinished_diagnosis
from capture_cli.stages.progress import Progress
from capture_cli.stages.recorded_task import find_task, load_recorded, named, task_inputs
from capture_cli.stages.training_state import check_recipe
from capture_cli.stages.wide_bounds import warn_of_wide_bounds
from capture_cli.stores.diagnosis import Diagnosis
from capture_cli.stores.estimate import Estimate
from capture_cli.stores.measured_log import MeasuredLog
from capture_cli.stores.output import is_complete, refuse_inputs, sha256
from capture_cli.stores.provenance import Provenance
from capture_cli.stores.result import read_provenance
from capture_cli.tasks.base import Task


def diagnose(
    *,
    real_log: Path,
    out: Path,
    estimate: Path | None = None,
    task: str | None = None,
    test: str | None = None,
    window: float | None = None,
    starts: int = 3,
    most_effects: int = MOST_EFFECTS,
    expression: bool = True,
    seed: int | None = None,
    threads: int | None = None,
    force: bool = False,
    resume: bool = False,
    quiet: bool = False,
) -> Diagnosis:
    """Diagnose the log at `real_log`; write a diagnosis directory at `out`.

    estimate: the estimate directory of the same log, whose task, windows, held-out part and seed are taken over where
    nothing else is said. Without it `task`, `test`, `window` and `seed` are as for identify. most_effects: to add.
    expression: where the catalogue leaves something, look for a formula of the missing force. With `resume` a run that
    was killed goes on after the last step that it made, to the same result, and one that is complete is read. Raises
    CaptureError for whatever the user can mend.
    """
    options = {k: v for k, v in locals().items() if k not in ("quiet", "force", "resume")}
    complete = is_complete(out, force=force, resume=resume)
    log = MeasuredLog.read(real_log)
    begin = None
    if estimate is not None:
        begin, made = _check_estimate(estimate, log, task)
        found = load_recorded(estimate, made, task, str(real_log))
        window = window if window is not None else made["options"]["window"]
        seed = seed if seed is not None else made["options"]["seed"]
    else:
        found = find_task(task, log)
    seed = seed or 0
    options |= {"task": task or named(found), "test": test, "window": window, "seed": seed}
    inputs = {"real_log": real_log, **task_inputs(found), "estimate": estimate}
    refuse_inputs(out, inputs.values())
    provenance = Provenance("diagnose", options, inputs)
    if complete:
        return _completed(out, provenance)
    warn_of_wide_bounds(found)
    held_out = None if begin is None or test is not None else _held_out(begin)
    nominal = _nominal(found, begin)
    made = provenance.document()
    with unfinished_diagnosis(out, made, force=force, resume=resume) as (folder, kept):
        prepared = prepare(
            log, found, window=window, test=test, held_out=held_out, seed=seed, threads=threads
        )
        settings = Settings(starts, most_effects, expression, seed, threads, kept)
        with Progress("diagnose", "model", quiet=quiet) as progress:
            diagnosis = diagnose_prepared(prepared, nominal, settings, progress)
        diagnosis.write(folder)
        _write_pages(diagnosis, folder, provenance)
        provenance.write(folder)
    return diagnosis


def diagnose_prepared(
    prepared: PreparedLog, nominal: np.ndarray, settings: Settings, progress: Progress
) -> Diagnosis:
    """What `diagnose` finds in a log that was made ready, from the values `nominal` (parameter,) of its task.

    Raises FitError; Interrupted, which names what was found until then, and how to go on.
    """
    last: list[str] = []

    def tell(what: str, number: int, total: int, found: Sequence[str]) -> None:
        last[:] = found
        so_far = f"; found {', '.join(found)}" if found else ""
        progress.step(progress.part(what, number, total) + so_far)

    try:
        return diagnosis_of(explain(prepared, nominal, settings, tell))
    except KeyboardInterrupt:
        raise _interrupted(last, settings) from None


def _interrupted(found: Sequence[str], settings: Settings) -> Interrupted:
    """Of a run with these settings that had `found` effects, called EFFECT@SITE."""
    state, cure = "nothing was written", "run the same command again"
    if settings.kept is not None and settings.kept.anything:
        state, cure = "what was worked out is kept", "go on with the same command and --resume"
    so_far = f"so far: {', '.join(found)}" if found else "so far no effect was found"
    sooner = len({name.partition("@")[0] for name in found})  # one at several places at once counts as one
    if 0 < sooner < settings.most_effects:
        cure += f"; with --most-effects {sooner} it ends sooner, when it has as many as now"
    return Interrupted(f"interrupted: {state}; {so_far}", cure=cure)


def _completed(out: Path, provenance: Provenance) -> Diagnosis:
    """The diagnosis at `out`, if it is what this run would make. Raises CaptureError otherwise."""
    diagnosis = Diagnosis.read(out)
    made, options = read_provenance(out, Diagnosis.CURE), (*OPTIONS, *ENDS)
    check_recipe(recipe_of(made, options), recipe_of(provenance.document(), options))
    return diagnosis


def _check_estimate(folder: Path, log: MeasuredLog, task: str | None) -> tuple[Estimate, dict[str, Any]]:
    """The estimate in `folder` and its provenance. Raises OptionError where it is not of the log as it is now."""
    found = Estimate.read(folder)
    made = read_provenance(folder, "make the estimate again with `capture identify`")
    if found.document["log"]["sha256"] != sha256(log.path):
        identify = ["capture", "identify", "--real-log", str(log.path)]
        new = _new_episodes(folder, found, made, log, task)
        if new:
            raise OptionError(
                f"{log.path} has {new} new episode{'s' * (new > 1)} since {folder} was made from it",
                cure=f"take the estimate up first: {shlex.join([*identify, '--out', str(folder), '--resume'])}",
            )
        raise OptionError(
            f"{folder} was made from {found.document['log']['path']}, and {log.path} is not that log as it was then",
            cure=f"identify it first: {shlex.join(identify)}",
        )
    return found, made


def _new_episodes(
    folder: Path, estimate: Estimate, made: Mapping[str, Any], log: MeasuredLog, task: str | None
) -> int:
    """How many episodes the log has after those of the estimate; 0 where it does not go on from them."""
    try:
        machine = load_recorded(folder, made, task, str(log.path))
    except CaptureError:
        return 0
    new = len(log.episode_ends) - estimate.document["rollouts"]["measured"]
    return max(new, 0) if continues(log, machine, estimate) else 0


def _held_out(estimate: Estimate) -> EarlierSplit:
    arrays = estimate.arrays
    return EarlierSplit(arrays["window/first"], arrays["window/is_test"], estimate.document["split"]["how"])


def _nominal(task: Task, estimate: Estimate | None) -> np.ndarray:
    if estimate is None:
        return task.space.nominal
    parameters = estimate.document["parameters"]
    if estimate.document["task"] != task.name or list(parameters) != list(task.space.names):
        raise StoreError(
            f"the estimate has task {estimate.document['task']!r} with ({', '.join(parameters)}); "
            f"the task is {task.name!r} with ({', '.join(task.space.names)})",
            cure="identify again with the task as it is now",
        )
    return task.space.to_vector({name: p["value"] for name, p in parameters.items()})


def _write_pages(diagnosis: Diagnosis, folder: Path, provenance: Provenance) -> None:
    from capture_cli.reports.diagnosis_figures import write_figures
    from capture_cli.reports.diagnosis_page import render

    (folder / "report.html").write_text(render(diagnosis, provenance.document()), encoding="utf-8")
    write_figures(diagnosis, folder)
