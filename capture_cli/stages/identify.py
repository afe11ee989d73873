"""`capture identify`: measured log in, parameters with intervals and a verdict out."""

from __future__ import annotations

import importlib
import shlex
import threading
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.identifiers.least_squares import LeastSquares
from capture_cli.protocol.log_checks import check_parameters_move_outputs
from capture_cli.protocol.misread_channels import misread_channels
from capture_cli.protocol.model_fits import ModelFits
from capture_cli.protocol.prepare import prepare
from capture_cli.protocol.prepared_log import PreparedLog
from capture_cli.protocol.repeated_noise import with_noise_of_repeats
from capture_cli.protocol.residual_noise import with_noise_of_residual
from capture_cli.reports.findings import STAMPS_ALONE, behind, is_fit_explained, suspicions
from capture_cli.stages.chosen_identifier import ChosenIdentifier, choose_identifier
from capture_cli.stages.earlier_estimate import EarlierEstimate
from capture_cli.stages.estimate_document import Report, unexplained
from capture_cli.stages.estimation import (
    ROUNDS,
    Found,
    by_physics,
    by_rounds,
    from_where_all_show,
    looked_about,
    unstuck,
    with_longer_differences,
)
from capture_cli.stages.progress import Progress
from capture_cli.stages.recorded_task import find_task, named, task_inputs
from capture_cli.stages.wide_bounds import warn_of_wide_bounds
from capture_cli.stores.estimate import Estimate
from capture_cli.stores.measured_log import MeasuredLog
from capture_cli.stores.output import new_directory, refuse_existing, refuse_inputs
from capture_cli.stores.provenance import Provenance
from capture_cli.tasks.base import ActionTask

NEEDED_LAST = ("scipy.special", "capture_cli.reports.figures")


def identify(
    *,
    real_log: Path,
    out: Path,
    task: str | None = None,
    identifier: str | None = None,
    test: str | None = None,
    window: float | None = None,
    starts: int = 3,
    rounds: int | None = None,
    seed: int | None = None,
    threads: int | None = None,
    resume: bool = False,
    force: bool = False,
    quiet: bool = False,
) -> Estimate:
    """Identify the parameters of `task` from the log at `real_log`; write an estimate directory at `out`.

    identifier: a name, or the directory of a learned one, which works in rounds over the episodes before physics
    refines it; None takes the one shipped for the task, or least squares. test: recordings to hold out, "none", or None
    for a share of the log. window: s, instead of the task's. rounds: at most so many, over the episodes or of
    simulations. resume: `out` is an estimate of the log's first episodes, and is taken up with the others; task,
    identifier, test, window and seed are then the estimate's where None. seed: 0 where None.
    Raises CaptureError for whatever the user can mend, before anything is written.
    """
    options = {k: v for k, v in locals().items() if k not in ("quiet", "force", "resume")}
    refuse_existing(out, force=force or resume)
    log = MeasuredLog.read(real_log)
    earlier = None
    if resume:
        earlier = EarlierEstimate.read(out)
        taken = earlier.options | {"task": earlier.task(real_log) if task is None else task}
        for name in ("task", "identifier", "test", "window", "seed"):
            options[name] = options[name] if options[name] is not None else taken[name]
    options["seed"] = options["seed"] or 0
    found = find_task(options["task"], log)
    if earlier is not None:
        earlier.check(found, log)
    options["task"] = options["task"] or named(found)
    chosen = choose_identifier(options["identifier"], found, log)
    inputs = {"real_log": real_log, **task_inputs(found), "identifier": chosen.path}
    refuse_inputs(out, inputs.values())
    provenance = Provenance("identify", options, inputs)
    warn_of_wide_bounds(found)
    given = {name: options[name] for name in ("window", "test", "seed")}
    prepared = prepare(log, found, **given, threads=threads)
    if earlier is not None:
        prepared = replace(prepared, split=earlier.split(prepared.windows, prepared.split))
    _import_meanwhile(NEEDED_LAST)
    with Progress("identify", "round", quiet=quiet) as progress:
        search = _Search(prepared, chosen, progress, starts, rounds, options["seed"], threads, earlier)
        result = search.run()
        estimate = Report(result, chosen.name, options["seed"], earlier, progress).estimate()
        document = estimate.document
        suspicious = bool(suspicions(estimate))
        if suspicious and not isinstance(found, ActionTask):
            document["misread"], more = _misread(search, options["window"])
            document["rollouts"]["simulated"] += more
        if document["misread"] and document["lack_of_fit"]["lacking"]:
            document["summary"] = unexplained(document["lack_of_fit"], "A channel seems to be misread.")
        elif suspicious and document["lack_of_fit"]["lacking"] and not document["diverged_windows"]:
            why = "A channel may be misread, or the model lacks much."
            document["summary"] = unexplained(document["lack_of_fit"], why)
    lacking = document["verdict"] == "unexplained" and not is_fit_explained(document)
    if lacking and not (document["cut_short"] or suspicious or behind(document) == STAMPS_ALONE):
        document["next_command"] = shlex.join(
            ["capture", "diagnose", "--real-log", str(real_log), "--estimate", str(out)]
        )
    with new_directory(out, force=force or resume) as folder:
        estimate.write(folder)
        _write_pages(estimate, folder, provenance)
        provenance.write(folder)
    return estimate


@dataclass(frozen=True)
class _Search:
    """Finds the point, as the identifier that was chosen does."""

    prepared: PreparedLog
    chosen: ChosenIdentifier
    progress: Progress
    starts: int
    rounds: int | None
    seed: int
    threads: int | None
    earlier: EarlierEstimate | None

    def run(self) -> Found:
        """With the noise floor that repeats show, and then on with that of the residual, where that is another."""
        prepared, start = self.prepared, self._start()
        rollouts = prepared.rollouts
        if self._must_show_all():
            rollouts += check_parameters_move_outputs(prepared, seed=self.seed, threads=self.threads)
        prepared, more = with_noise_of_repeats(prepared, start, threads=self.threads, seed=self.seed)
        rollouts += more
        found = self._find(prepared, start)
        part = prepared.part(~prepared.split.is_test)
        quieter = with_noise_of_residual(prepared, part, found.at, self.threads)
        if quieter is not prepared:
            rollouts += found.fits.rollouts
            found = self._find(quieter, start, found)
        found = looked_about(found, self.progress, seed=self.seed)
        found.fits.rollouts += rollouts
        return found

    def _must_show_all(self) -> bool:
        """Whether a log in which a parameter moves no output is an error.

        Not where rounds in context are made of actions: the first few need not reach every wall. What was learned
        proposes a value all the same, the verdict names what the log leaves open, and the next action is chosen by it.
        """
        return self.chosen.checkpoint is None or not isinstance(self.prepared.task, ActionTask)

    def _start(self) -> np.ndarray:
        return self.prepared.task.space.nominal if self.earlier is None else self.earlier.parameters

    def _find(self, prepared: PreparedLog, start: np.ndarray, before: Found | None = None) -> Found:
        """before: found with another noise floor; physics goes on from there, rounds in context are made anew."""
        earlier = self.earlier
        fitted = ~prepared.split.is_test
        new = None if earlier is None else earlier.new(prepared.windows)
        if self.chosen.checkpoint is not None and (new is None or (new & fitted).any()):
            return by_rounds(
                prepared,
                self.chosen.checkpoint,
                self.chosen.path,
                self.progress,
                start=start,
                rounds=self.rounds,
                starts=self.starts,
                threads=self.threads,
                seed=self.seed,
                new=new,
                earlier=None if earlier is None else earlier.rounds,
            )
        offsets = None
        if before is not None:
            start = before.best.parameters
            offsets = prepared.part(fitted).offsets_from(before.part, before.best.offsets)
        found = by_physics(
            ModelFits(prepared, self.threads),
            start,
            self.progress,
            offsets=offsets,
            method=self.chosen.method,
            starts=self.starts if earlier is None else 1,
            rounds=ROUNDS if self.rounds is None else self.rounds,
            seed=self.seed,
        )
        if before is not None:
            found.history = [*before.history, *found.history]
        if self.rounds is not None or self.chosen.method is not LeastSquares:
            return found
        found = with_longer_differences(found, self.progress, seed=self.seed, threads=self.threads)
        found = unstuck(found, self.progress, seed=self.seed)
        return from_where_all_show(found, self.progress, seed=self.seed)


def _misread(search: _Search, window: float | None) -> tuple[dict[str, Any] | None, int]:
    """Channels whose sign, unit or column leaves what no physics would, None where none is found; and how many windows
    were simulated to see it.
    """
    progress = search.progress

    def tell(done: int, total: int) -> None:
        progress.step(progress.part("other signs, units and columns,", done, total))

    found, rollouts = misread_channels(search.prepared, window, search.threads, tell)
    return None if found is None else {**asdict(found), "text": found.text}, rollouts


def _import_meanwhile(modules: Sequence[str]) -> None:
    """Import in a thread what is slow to import and needed last: while the simulator steps, the interpreter is free."""
    threading.Thread(target=lambda: [importlib.import_module(m) for m in modules], daemon=True).start()


def _write_pages(estimate: Estimate, folder: Path, provenance: Provenance) -> None:
    from capture_cli.reports.estimate_page import render
    from capture_cli.reports.figures import write_figures

    (folder / "report.html").write_text(render(estimate, provenance.document()), encoding="utf-8")
    write_figures(estimate, folder)
