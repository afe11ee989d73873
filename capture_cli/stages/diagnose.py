"""`capture diagnose`: what the model lacks, traced to an effect, added, and the error before and after."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from capture_cli.common.progress import Progress
from capture_cli.context.checkpoints.training_state import check_recipe
from capture_cli.errors import Interrupted
from capture_cli.estimate.balance.input_timing import SETTINGS as INPUT_TIMING
from capture_cli.estimate.log_balance import with_timings
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.split import EarlierSplit
from capture_cli.log.checks.parameter_bounds import warn_of_bounds
from capture_cli.options.base import takes_options
from capture_cli.options.diagnose import DiagnoseOptions
from capture_cli.select.candidates import all_candidates
from capture_cli.select.explain import Settings, explain
from capture_cli.select.input_readings import read_otherwise, timings_with_effects
from capture_cli.select.time_limit import TimeLimit
from capture_cli.stages.documents.diagnosis_document import diagnosis_of
from capture_cli.stages.log_to_fit import LogToFit, read_log
from capture_cli.stages.recorded.recorded_estimate import DiagnosedEstimate
from capture_cli.stages.recorded.recorded_task import find_task
from capture_cli.stages.search_checkpoint import ENDS, OPTIONS, recipe_of, unfinished_diagnosis
from capture_cli.store.diagnosis import Diagnosis
from capture_cli.store.output import is_complete
from capture_cli.store.provenance import Provenance
from capture_cli.store.result import read_provenance


@takes_options
def diagnose(options: DiagnoseOptions) -> Diagnosis:
    """Diagnose the log; write a diagnosis directory at `out`.

    With `resume` a run that was killed goes on after the last step that it made, to the same result, and one that is
    complete is read. Raises CaptureError for whatever the user can mend.
    """
    seconds = np.inf if options.time_limit is None else options.time_limit
    limit = TimeLimit(TimeLimit.now() + seconds)
    complete = is_complete(options.out, force=options.force, resume=options.resume)
    log = read_log("diagnose", options)
    begin = None
    if options.estimate is None:
        found = find_task(options.task, log)
    else:
        begin = DiagnosedEstimate.read(options.estimate)
        found = begin.task(options.task, log)
    held_out = None if begin is None or options.test is not None else begin.held_out
    if begin is not None:
        options = begin.taken_over(options)
    to_fit = LogToFit.of("diagnose", log, found, options, estimate=options.estimate)
    options, provenance = to_fit.options, to_fit.provenance
    if complete:
        return _completed(options.out, provenance)
    warn_of_bounds(found)
    if begin is not None:
        begin.warn_of_misread_channels()
        begin.check_task(found, "identify again with the task as it is now")
    nominal = found.space.nominal if begin is None else begin.values
    with unfinished_diagnosis(options, provenance.document()) as (folder, checkpoint):
        settings = Settings(
            starts=options.starts,
            most_effects=options.most_effects,
            expression=options.expression,
            seed=options.seed,
            threads=options.threads,
            checkpoint=checkpoint,
            limit=limit,
        )
        with Progress("diagnose", "model", quiet=options.quiet) as progress:
            progress.doing("making the log ready")
            prepared = _prepared(to_fit, held_out, limit, progress)
            other_reading = None
            if told := prepared.input_timings:
                other_reading = partial(read_otherwise, to_fit.task, told, partial(to_fit.prepared, held_out))
            diagnosis = diagnose_prepared(prepared, nominal, settings, progress, other_reading)
        diagnosis.write(folder)
        _write_pages(diagnosis, folder, provenance)
        provenance.write(folder)
    return diagnosis


def _prepared(
    to_fit: LogToFit, held_out: EarlierSplit | None, limit: TimeLimit, progress: Progress
) -> PreparedLog:
    """The log made ready; where something is missing, how inputs act is told by the best effect with each reading.

    What the declared model alone says of them is asked again with an effect in where it leaves more than noise: a
    missing effect may look like another reading.
    """
    prepared, task = to_fit.prepared(held_out), to_fit.task
    told = prepared.input_timings
    settled = told and told[0].beyond_noise < INPUT_TIMING.asked_again
    if settled or all(c.hold is not None for c in task.inputs):
        return prepared
    unread, candidates = replace(prepared, task=task), all_candidates(prepared)
    again, threads = partial(to_fit.prepared, held_out), to_fit.options.threads
    progress.of("how the inputs act", "making the log ready")
    found = limit.made(
        lambda: timings_with_effects(unread, candidates, again, threads, limit.check, progress.part),
        "how the inputs act between rows: they are taken to be held",
        keeping=limit.half,
    )
    if found is None:
        return prepared
    timings, screening = found
    if not timings:
        return prepared
    read = with_timings(task, timings)
    if read.holds != prepared.task.holds:
        prepared = to_fit.prepared(held_out, read)
    return replace(prepared, input_timings=timings, screening=screening)


def diagnose_prepared(
    prepared: PreparedLog,
    nominal: np.ndarray,
    settings: Settings,
    progress: Progress,
    other_reading: Callable[[], PreparedLog] | None = None,
) -> Diagnosis:
    """What `diagnose` finds in a log that was made ready, from the values `nominal` (parameter,) of its task.

    other_reading: makes it ready with inputs read otherwise than the log told. Raises FitError;
    Interrupted, which names what was found until then, and how to go on.
    """
    last: list[str] = []

    def tell(what: str, number: int, total: int, found: Sequence[str]) -> None:
        last[:] = found
        so_far = f"; found {', '.join(found)}" if found else ""
        next_ = _distinct(found) + 1
        progress.whole = (
            f"effect {next_} of at most {settings.most_effects}" if next_ <= settings.most_effects else ""
        )
        progress.part(what, number, total, so_far)

    progress.of("", "fitting the declared model")
    try:
        found = explain(prepared, nominal, settings, tell, other_reading)
        return diagnosis_of(found, settings.threads)
    except KeyboardInterrupt:
        raise _interrupted(last, settings) from None


def _interrupted(found: Sequence[str], settings: Settings) -> Interrupted:
    """Of a run with these settings that had `found` effects, called EFFECT@SITE."""
    state, cure = "nothing was written", "run the same command again"
    if settings.checkpoint is not None and settings.checkpoint.anything:
        state, cure = "what was worked out is kept", "go on with the same command and --resume"
    so_far = f"so far: {', '.join(found)}" if found else "so far no effect was found"
    sooner = _distinct(found)
    if 0 < sooner < settings.most_effects:
        cure += f"; with --most-effects {sooner} it ends sooner, when it has as many as now"
    return Interrupted(f"interrupted: {state}; {so_far}", cure=cure)


def _distinct(found: Sequence[str]) -> int:
    """How many effects are found, of those called EFFECT@SITE: one at several places at once counts as one."""
    return len({name.partition("@")[0] for name in found})


def _completed(out: Path, provenance: Provenance) -> Diagnosis:
    """The diagnosis at `out`, if it is what this run would make. Raises CaptureError otherwise."""
    diagnosis = Diagnosis.read(out)
    made, options = read_provenance(out, Diagnosis.KIND.cure), (*OPTIONS, *ENDS)
    check_recipe(recipe_of(made, options), recipe_of(provenance.document(), options))
    return diagnosis


def _write_pages(diagnosis: Diagnosis, folder: Path, provenance: Provenance) -> None:
    from capture_cli.report.diagnosis_figures import write_figures
    from capture_cli.report.diagnosis_page import render

    (folder / "report.html").write_text(render(diagnosis, provenance.document()), encoding="utf-8")
    write_figures(diagnosis, folder)
