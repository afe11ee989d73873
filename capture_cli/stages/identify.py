"""`capture identify`: measured log in, parameters with intervals and a verdict out."""

import importlib
import shlex
import threading
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.common.progress import Progress
from capture_cli.estimate.log_balance import balanced_point
from capture_cli.estimate.log_requirements import check_parameters_move_outputs
from capture_cli.estimate.misread_channels import misread_channels
from capture_cli.estimate.model_fits import ModelFits
from capture_cli.estimate.noise.repeated_noise import with_noise_of_repeats
from capture_cli.estimate.noise.residual_noise import with_noise_of_residual
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve.least_squares import LeastSquares
from capture_cli.log.checks.parameter_bounds import warn_of_bounds
from capture_cli.model.tasks.base import ActionTask
from capture_cli.options.base import takes_options
from capture_cli.options.identify import IdentifyOptions
from capture_cli.report.findings import THIS_ESTIMATE, is_fit_explained, jitter_share, suspicions
from capture_cli.stages.documents.estimate_document import Report, unexplained
from capture_cli.stages.identification.chosen_identifier import ChosenIdentifier, choose_identifier
from capture_cli.stages.identification.estimation import SETTINGS as ESTIMATION
from capture_cli.stages.identification.estimation import Descents, Found, Refinement, by_physics, by_rounds
from capture_cli.stages.log_to_fit import LogToFit, read_log
from capture_cli.stages.recorded.recorded_estimate import EarlierEstimate
from capture_cli.stages.recorded.recorded_task import find_task
from capture_cli.store.estimate import Estimate, EstimateRecord
from capture_cli.store.output import new_directory, refuse_existing
from capture_cli.store.provenance import Provenance

NEEDED_LAST = ("scipy.special", "capture_cli.report.figures")


@takes_options
def identify(options: IdentifyOptions) -> Estimate:
    """Identify the task's parameters from the log; write an estimate directory at `out`.

    An identifier that was learned works in rounds over the episodes before physics refines it.
    Raises CaptureError for whatever the user can mend, before anything is written.
    """
    out = options.out
    refuse_existing(out, force=options.force or options.resume)
    log = read_log("identify", options)
    earlier = None
    if options.resume:
        earlier = EarlierEstimate.read(out)
        options = earlier.taken_over(options)
    found = find_task(options.task, log)
    if earlier is not None:
        earlier.check(found, log)
    chosen = choose_identifier(options.identifier, found, log)
    if chosen.checkpoint is not None:
        found = chosen.checkpoint.machine(found)
    to_fit = LogToFit.of("identify", log, found, options, identifier=chosen.path)
    warn_of_bounds(found)
    options = to_fit.options
    with Progress("identify", "round", quiet=options.quiet) as progress:
        progress.of(_step(1), "making the log ready")
        prepared = to_fit.prepared()
        if earlier is not None:
            prepared = replace(prepared, split=earlier.split(prepared.windows, prepared.split))
        # slow to import and needed last: while the simulator steps, the interpreter is free
        threading.Thread(target=lambda: [*map(importlib.import_module, NEEDED_LAST)], daemon=True).start()
        search = _Search(prepared, chosen, progress, options, earlier)
        found = search.run()
        progress.of(_step(5), "errors and intervals")
        estimate = Report(found, chosen.name, options.seed, earlier, progress).estimate()
        if suspicions(estimate):
            estimate = _with_misread(estimate, search)
        elif _lacks(estimate.record):
            diagnose = ["capture", "diagnose", "--real-log", str(options.real_log)]
            if not estimate.record.effects:
                diagnose += ["--estimate", THIS_ESTIMATE]
            estimate = estimate.changed(next_command=shlex.join(diagnose))
    with new_directory(out, force=options.force or options.resume) as folder:
        estimate.write(folder)
        _write_pages(estimate, folder, to_fit.provenance)
        to_fit.provenance.write(folder)
    return estimate


@dataclass(frozen=True)
class _Search:
    """Finds the point, as the identifier that was chosen does."""

    prepared: PreparedLog
    chosen: ChosenIdentifier
    progress: Progress
    options: IdentifyOptions
    earlier: EarlierEstimate | None

    def run(self) -> Found:
        """Fit with the noise floor that repeats show; then go on with that of the residual, where it is another."""
        prepared, progress, earlier = self.prepared, self.progress, self.earlier
        start = prepared.task.space.nominal if earlier is None else earlier.values
        seed, threads, refinement = self.options.seed, self.options.threads, self._refinement
        rollouts = prepared.rollouts
        progress.of(_step(2), "checking that each parameter moves an output")
        if self._must_show_all():
            rollouts += check_parameters_move_outputs(prepared, seed=seed, threads=threads)
        progress.doing("comparing repeated motions for their noise")
        prepared, more = with_noise_of_repeats(prepared, start, threads=threads, seed=seed)
        rollouts += more
        progress.of(_step(3), "fit")
        found = self._find(prepared, start)
        progress.doing("looking at the noise that the fit leaves")
        part = prepared.part(~prepared.split.is_test)
        quieter = with_noise_of_residual(prepared, part, found.at, threads)
        if quieter is not prepared:
            rollouts += found.fits.rollouts
            found = self._find(quieter, start, found)
        progress.of(_step(4), "looking about the estimate")
        found = refinement.with_profile(refinement.looked_about(found))
        found.fits.rollouts += rollouts
        return found

    @property
    def _refinement(self) -> Refinement:
        return Refinement(self.progress, self.options.seed, self.options.threads)

    def _must_show_all(self) -> bool:
        """Whether a log in which a parameter moves no output is an error.

        Not where rounds in context are made of actions: the first few need not reach every wall. The learned identifier
        proposes a value all the same, the verdict names what the log leaves open, and the next action depends on it.
        """
        return self.chosen.checkpoint is None or not isinstance(self.prepared.task, ActionTask)

    def _find(self, prepared: PreparedLog, start: np.ndarray, before: Found | None = None) -> Found:
        """before: found with another noise floor. A fit begins there; rounds in context are made anew."""
        new = None if self.earlier is None else self.earlier.new(prepared.windows)
        if self.chosen.checkpoint is not None and (new is None or (new & ~prepared.split.is_test).any()):
            return by_rounds(prepared, self.chosen, self.options, self.earlier, start, self.progress)
        return self._by_physics(prepared, start, before)

    def _by_physics(self, prepared: PreparedLog, start: np.ndarray, before: Found | None) -> Found:
        corrections = None
        if before is not None:
            start, fitted = before.best.parameters, prepared.part(~prepared.split.is_test)
            corrections = fitted.corrections_from(before.part, before.best.corrections)
        fits, starts = ModelFits(prepared, self.options.threads), self.options.starts
        if self.earlier is not None:
            starts = 1
        elif before is None and self.chosen.method is LeastSquares:
            start, starts = self._from_balance(fits, start)
        descents = Descents(
            self.options.seed,
            method=self.chosen.method,
            starts=starts,
            rounds=ESTIMATION.rounds if self.options.rounds is None else self.options.rounds,
        )
        found = by_physics(fits, start, self.progress, descents, corrections)
        if before is not None:
            found.history = [*before.history, *found.history]
        if self.options.rounds is not None or self.chosen.method is not LeastSquares:
            return found
        refinement = self._refinement
        return refinement.from_where_all_show(refinement.escaped(refinement.with_longer_differences(found)))

    def _from_balance(self, fits: ModelFits, start: np.ndarray) -> tuple[np.ndarray, int]:
        """Where the fit begins, and how many descents: one, where the log gives a force balance, from what fills it
        best or from `start` (parameter,), whichever is nearer to the log.
        """
        fitted = ~fits.prepared.split.is_test
        balanced = balanced_point(fits.prepared, np.flatnonzero(fitted), start, self.options.threads)
        if balanced is None or not len(start):
            return start, self.options.starts
        return fits.nearest(fits.prepared.part(fitted), np.stack([balanced, start])), 1


def _step(number: int) -> str:
    return f"step {number} of 5"  # the log, checks, the fit, what is left open about it, errors


def _with_misread(estimate: Estimate, search: _Search) -> Estimate:
    """The estimate, whose error is larger than physics leaves, with the channels that seem to be misread, of which its
    summary tells. Tasks of actions have no such channels.
    """
    if not isinstance(search.prepared.task, ActionTask):
        misread, simulated = _misread(search)
        rollouts = estimate.record.rollouts
        rollouts = {**rollouts, "simulated": rollouts["simulated"] + simulated}
        estimate = estimate.changed(misread=misread, rollouts=rollouts)
    record = estimate.record
    if not record.lack_of_fit["lacking"]:
        return estimate
    if record.misread:
        return estimate.changed(summary=unexplained(record.lack_of_fit, "A channel seems to be misread."))
    if not record.diverged_windows:
        why = "A channel may be misread, or the model lacks much."
        return estimate.changed(summary=unexplained(record.lack_of_fit, why))
    return estimate


def _misread(search: _Search) -> tuple[dict[str, Any] | None, int]:
    """Channels that seem to have another sign, unit or column, None where none does; and how many windows this took to
    simulate.
    """
    progress = search.progress

    def tell(done: int, total: int) -> None:
        progress.part("other signs, units and columns,", done, total)

    prepared = search.prepared
    found, rollouts = misread_channels(prepared, search.options.window, search.options.threads, tell)
    return None if found is None else {**asdict(found), "text": found.text(prepared.task)}, rollouts


def _lacks(record: EstimateRecord) -> bool:
    """Whether the model lacks something: not where the search was cut short, or time-stamp jitter explains it all."""
    lacking = record.verdict == "unexplained" and not is_fit_explained(record)
    return lacking and not (record.cut_short or jitter_share(record) == 1)


def _write_pages(estimate: Estimate, folder: Path, provenance: Provenance) -> None:
    from capture_cli.report.estimate_page import render
    from capture_cli.report.figures import write_figures

    (folder / "report.html").write_text(render(estimate, provenance.document()), encoding="utf-8")
    write_figures(estimate, folder)
