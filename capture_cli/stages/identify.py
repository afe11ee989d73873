"""`capture identify`: measured log in, parameters with intervals and a verdict out."""

from __future__ import annotations

import importlib
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from capture_cli.diagnosis.lack_of_fit import LackOfFit, holds, lack_of_fit
from capture_cli.identifiers.base import Trial
from capture_cli.identifiers.intervals import Intervals, intervals
from capture_cli.identifiers.least_squares import CONVERGED_GAIN
from capture_cli.identifiers.rounds import Rounds
from capture_cli.stages.chosen_identifier import ChosenIdentifier, choose_identifier
from capture_cli.stages.earlier_estimate import EarlierEstimate
from capture_cli.stages.estimation import Found, by_physics, by_rounds
from capture_cli.stages.model_fits import TOLERANCE, ModelFits, by_output
from capture_cli.stages.prepared_log import (
    PreparedLog,
    check_parameters_move_outputs,
    find_task,
    named,
    prepare,
)
from capture_cli.stages.progress import Progress
from capture_cli.stages.recorded_task import task_inputs
from capture_cli.stages.repeated_noise import with_noise_of_repeats
from capture_cli.stages.residual_noise import with_noise_of_residual
from capture_cli.stores.estimate import FORMAT, HISTORY, VERSION, Estimate
from capture_cli.stores.measured_log import MeasuredLog
from capture_cli.stores.output import new_directory, refuse_existing, refuse_inputs, sha256
from capture_cli.stores.provenance import Provenance
from capture_cli.tasks.base import ActionTask, Task

ROUNDS = 100  # of simulations, at most, unless told otherwise
ROUGH = 1.0  # of the objective over k: a standard error
NEEDED_LAST = ("scipy.special", "capture_cli.reports.figures")
DISAGREE_P = 0.01  # of all parameters together, Bonferroni


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
    seed: int = 0,
    threads: int | None = None,
    resume: bool = False,
    force: bool = False,
    quiet: bool = False,
) -> Estimate:
    """Identify the parameters of `task` from the log at `real_log`; write an estimate directory at `out`.

    identifier: a name, or the directory of a learned one, which works in rounds over the episodes before physics
    refines it; None takes the one shipped for the task, or least squares. test: recordings to hold out, "none", or None
    for a share of the log. window: s, instead of the task's. rounds: at most so many, over the episodes or of
    simulations. resume: `out` is an estimate of the log's first episodes, and is taken up with the others.
    Raises CaptureError for whatever the user can mend, before anything is written.
    """
    options = {k: v for k, v in locals().items() if k not in ("quiet", "force", "resume")}
    refuse_existing(out, force=force or resume)
    log = MeasuredLog.read(real_log)
    earlier = None
    if resume:
        earlier = EarlierEstimate.read(out)
        for name in ("task", "identifier", "test", "window"):
            options[name] = options[name] if options[name] is not None else earlier.options[name]
        options["seed"] = earlier.options["seed"]
    found = find_task(options["task"], log)
    if earlier is not None:
        earlier.check(found, log)
    options["task"] = options["task"] or named(found)
    chosen = choose_identifier(options["identifier"], found, log)
    inputs = {"real_log": real_log, **task_inputs(found), "identifier": chosen.path}
    refuse_inputs(out, inputs.values())
    provenance = Provenance("identify", options, inputs)
    given = {name: options[name] for name in ("window", "test", "seed")}
    prepared = prepare(log, found, **given, threads=threads)
    if earlier is not None:
        prepared = replace(prepared, split=earlier.split(prepared.windows, prepared.split))
    _import_meanwhile(NEEDED_LAST)
    checked = 0
    if _must_show_all(found, chosen):
        checked = check_parameters_move_outputs(prepared, seed=options["seed"], threads=threads)
    with Progress("identify", "round", quiet=quiet) as progress:
        start = found.space.nominal if earlier is None else earlier.parameters
        prepared, rollouts = with_noise_of_repeats(prepared, start, threads=threads, seed=options["seed"])
        search = _Search(prepared, chosen, progress, starts, rounds, options["seed"], threads, earlier)
        result = search.run()
        quieter = with_noise_of_residual(prepared, prepared.part(~prepared.split.is_test), result.at, threads)
        if quieter is not prepared:
            rollouts += result.fits.rollouts
            result = replace(search, prepared=quieter).run()
        result.fits.rollouts += checked + rollouts
    estimate = _Report(result, chosen.name, options["seed"], earlier).estimate()
    if estimate.document["verdict"] == "unexplained":
        estimate.document["next_command"] = f"capture diagnose --real-log {real_log} --estimate {out}"
    with new_directory(out, force=force or resume) as folder:
        estimate.write(folder)
        _write_pages(estimate, folder, provenance)
        provenance.write(folder)
    return estimate


def _must_show_all(task: Task, chosen: ChosenIdentifier) -> bool:
    """Whether a log in which a parameter moves no output is an error.

    Not where rounds in context are made of actions: the first few need not reach every wall. What was learned proposes
    a value all the same, the verdict names what the log leaves open, and the next action is chosen by it.
    """
    return chosen.checkpoint is None or not isinstance(task, ActionTask)


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
        prepared, earlier = self.prepared, self.earlier
        start = prepared.task.space.nominal if earlier is None else earlier.parameters
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
        return by_physics(
            ModelFits(prepared, self.threads),
            self.chosen.method,
            start,
            self.progress,
            starts=self.starts if earlier is None else 1,
            rounds=ROUNDS if self.rounds is None else self.rounds,
            seed=self.seed,
        )


def _import_meanwhile(modules: Sequence[str]) -> None:
    """Import in a thread what is slow to import and needed last: while the simulator steps, the interpreter is free."""
    threading.Thread(target=lambda: [importlib.import_module(m) for m in modules], daemon=True).start()


def _write_pages(estimate: Estimate, folder: Path, provenance: Provenance) -> None:
    from capture_cli.reports.estimate_page import render
    from capture_cli.reports.figures import write_figures

    (folder / "report.html").write_text(render(estimate, provenance.document()), encoding="utf-8")
    write_figures(estimate, folder)


class _Report:
    """Turns the best point into an Estimate: errors, intervals, verdict, recordings."""

    def __init__(self, result: Found, identifier: str, seed: int, earlier: EarlierEstimate | None):
        self.result = result
        self.fits = result.fits
        self.prepared = result.fits.prepared
        self.identifier = identifier
        self.best = result.best
        before = [] if earlier is None else earlier.history
        self.history = [b for b in (*before, *result.history) if np.isfinite(b.error)]
        self.seed = seed
        self.earlier = earlier
        self.is_test = self.prepared.split.is_test
        self.space = self.prepared.task.space

    def estimate(self) -> Estimate:
        fit = self.result.at
        found, lacking = intervals(fit.at), lack_of_fit(fit.at)
        offsets = np.zeros_like(self.prepared.starts.sd)
        offsets[~self.is_test] = fit.offsets
        if self.is_test.any():
            test = self.prepared.part(self.is_test)
            offsets[self.is_test] = self.fits.on(test, fit, self._start_tolerance(lacking.lacking)).offsets
        simulated, nominal, diverged = self._curves(offsets)
        recordings = self._recordings(found)
        document = self._document(found, lacking, simulated, recordings, diverged)
        return Estimate(
            document, self._arrays(found, offsets, simulated, nominal, recordings), self._attributes()
        )

    def _start_tolerance(self, lacking: bool) -> float:
        """Of held-out starts, over k: as exact as the fit was."""
        if self.result.in_context is None:
            return CONVERGED_GAIN
        return ROUGH if lacking and not self.result.elsewhere else TOLERANCE

    def _curves(self, offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Simulated at the estimate and at the nominal values, (window, step, output); whether it diverged at the
        estimate, (window,).
        """
        points = np.stack([self.best.parameters, self.space.nominal])
        simulator = self.fits.simulator([])
        trial = Trial(points, np.repeat(offsets[None], 2, axis=0))
        outputs, diverged = self.prepared.evaluate(simulator, trial)
        self.fits.rollouts += simulator.rollouts
        return outputs[0], outputs[1], diverged[0]

    def _recordings(self, joint: Intervals):
        """The estimate of each fitted recording alone, from the joint one on; None for a single recording."""
        fit = self.prepared.part(~self.is_test)
        numbers = [n for n in np.unique(fit.recording) if (fit.recording == n).sum() >= 2]
        if len(numbers) < 2 or not len(self.space):
            return None
        values, sds, names = [], [], []
        for number in numbers:
            which = fit.recording == number
            own = self.fits.fit(
                fit.part(which),
                [],
                self.best.parameters,
                offsets=self.result.at.offsets[which],
                rounds=12,
                tolerance=CONVERGED_GAIN,
                seed=self.seed,
            )
            if own is None:
                return None
            values.append(own.point)
            sds.append(intervals(own.at).sd)
            names.append(self.prepared.log.recording_names[number])
        return _agreement(names, np.array(values), np.array(sds), self.space.names, joint)

    # --- what is written ---

    def _document(self, found: Intervals, lacking: LackOfFit, simulated, recordings, diverged) -> dict:
        prepared, log = self.prepared, self.prepared.log
        names = [c.name for c in prepared.task.outputs]
        undetermined = _undetermined(found, self.space.names)
        error = {
            "fit": self._error(simulated, ~self.is_test),
            "test": self._error(simulated, self.is_test),
        }
        held_out = error["test"] and error["test"]["normalized"]
        numbers = int(prepared.windows.sampled[self.is_test].sum())
        if diverged.any() or lacking.lacking or (held_out is not None and not holds(held_out, numbers)):
            verdict = "unexplained"
        else:
            verdict = "explained" if found.identifiable.all() else "not-identifiable"
        rows = found.rows(self.space, self.best.parameters, range(len(self.space)))
        document = {
            "format": FORMAT,
            "version": VERSION,
            "task": prepared.task.name,
            "log": {"path": str(log.path), "sha256": sha256(log.path)},
            "identifier": self.identifier,
            "parameters": dict(zip(self.space.names, rows, strict=True)),
            "error": error,
            "noise_floor": dict(zip(names, prepared.noise.sd.tolist(), strict=True)),
            "noise_floor_source": dict(zip(names, prepared.noise.source, strict=True)),
            "verdict": verdict,
            "summary": _summary(verdict, lacking, held_out, undetermined, diverged),
            "diverged_windows": int(diverged.sum()),
            "lack_of_fit": {
                "normalized": lacking.normalized,
                "threshold": lacking.threshold,
                "autocorrelation_time": lacking.autocorrelation_time,
            },
            "undetermined": undetermined,
            "correlation": _correlation(found.covariance).tolist(),
            "recordings": None if recordings is None else recordings["document"],
            "split": {
                "how": prepared.split.how,
                "fit_windows": int((~self.is_test).sum()),
                "test_windows": int(self.is_test.sum()),
            },
            "rollouts": {"measured": len(log.episode_ends), "simulated": self.fits.rollouts},
            "rounds": [
                {"parameters": self.space.to_dict(b.parameters), "error": float(b.error)}
                for b in self.history
            ],
            "in_context": self._in_context(),
            "next_command": None,
        }
        return document

    def _in_context(self) -> dict | None:
        """What the rounds over the episodes gave; those of the earlier estimate where there were none now."""
        result = self.result
        if result.in_context is None:
            return None if self.earlier is None else self.earlier.estimate.document["in_context"]
        return result.in_context.document(
            contradicted=result.contradicted, fallback=result.fallback, elsewhere=result.elsewhere
        )

    def _rounds(self) -> Rounds | None:
        """All rounds in context so far."""
        before = None if self.earlier is None else self.earlier.rounds
        if self.result.in_context is None:
            return before
        now = self.result.in_context.walk.rounds
        return now if before is None else before.followed_by(now)

    def _error(self, simulated: np.ndarray, which: np.ndarray) -> dict | None:
        """RMSE and mean absolute error per output, and RMSE over the noise floor; None where nothing was held out.

        Of an output without a sample there both are None.
        """
        windows, noise = self.prepared.windows, self.prepared.noise.sd
        sampled = windows.sampled[which][windows.mask[which]]
        samples = sampled.sum(axis=0)
        if not samples.any():
            return None
        residual = (windows.measured - simulated)[which][windows.mask[which]]
        residual = np.where(sampled, residual, 0.0)
        rmse = np.sqrt(np.square(residual).sum(axis=0) / np.maximum(samples, 1))
        mae = np.abs(residual).sum(axis=0) / np.maximum(samples, 1)
        parts = samples / samples.max()
        names = [c.name for c in self.prepared.task.outputs]
        return {
            "rmse": by_output(names, np.where(samples > 0, rmse, np.nan)),
            "mae": by_output(names, np.where(samples > 0, mae, np.nan)),
            "normalized": float(np.sqrt((parts * np.square(rmse / noise)).sum() / parts.sum())),
        }

    def _arrays(self, found: Intervals, offsets, simulated, nominal, recordings) -> dict[str, np.ndarray]:
        windows = self.prepared.windows
        mask = windows.mask
        steps = np.concatenate(
            [np.arange(f, f + n) for f, n in zip(windows.first, windows.samples, strict=True)]
        )
        arrays = {
            "window/episode": windows.episode,
            "window/first": windows.first,
            "window/is_test": self.is_test,
            "window/start_offset": offsets,
            "step/window": np.repeat(np.arange(len(windows)), windows.samples),
            "step/time": self.prepared.log.time[steps],
            "step/measured": np.where(windows.sampled, windows.measured, np.nan)[mask],
            "step/simulated": simulated[mask],
            "step/nominal": nominal[mask],
            "parameter/estimate": self.best.parameters,
            "parameter/covariance": found.covariance,
            "round/parameters": np.array([b.parameters for b in self.history]).reshape(len(self.history), -1),
            "round/error": np.array([b.error for b in self.history]),
        }
        rounds = self._rounds()
        if rounds is not None:
            values = (rounds.parameters, rounds.actions, rounds.simulated, rounds.measured)
            arrays |= {name: a[0] for name, a in zip(HISTORY, values, strict=True)}
        if recordings is not None:
            arrays["parameter/recordings"] = recordings["values"]
            arrays["parameter/recordings_sd"] = recordings["sd"]
        return arrays

    def _attributes(self) -> dict:
        log = self.prepared.log
        return {
            "parameters": list(self.space.names),
            "outputs": [
                {"name": n, "unit": u} for n, u in zip(log.output_names, log.output_units, strict=True)
            ],
            "recordings": list(log.recording_names),
        }


def _agreement(names, values: np.ndarray, sd: np.ndarray, parameters, joint: Intervals) -> dict:
    """Do the recordings agree? Cochran's Q per parameter, over the estimates that a recording determines."""
    from scipy.special import chdtrc

    document, p_values = {}, []
    for i, name in enumerate(parameters):
        weight = 1 / np.square(sd[:, i])
        mean = (weight * values[:, i]).sum() / weight.sum()
        p = float(chdtrc(len(values) - 1, (weight * np.square(values[:, i] - mean)).sum()))
        p_values.append(p if joint.identifiable[i] else 1.0)
        document[name] = {"values": values[:, i].tolist(), "sd": sd[:, i].tolist(), "p_value": p}
    agree = min(p_values) * len(p_values) > DISAGREE_P
    worst = parameters[int(np.argmin(p_values))]
    spread = np.ptp([document[worst]["values"]])
    text = (
        f"the {len(names)} recordings agree"
        if agree
        else f"the {len(names)} recordings disagree, most about {worst} "
        f"(spread {spread:.3g}, p = {min(p_values):.1g}): something changed between them, or the model lacks something"
    )
    return {
        "values": values,
        "sd": sd,
        "document": {"names": names, "agree": bool(agree), "parameters": document, "text": text},
    }


def _undetermined(found: Intervals, names) -> list[dict]:
    """Combinations of parameters that the log leaves open, largest weights first."""
    result = []
    for direction, sd in zip(found.undetermined, found.undetermined_sd, strict=True):
        order = np.argsort(-np.abs(direction))
        main = [i for i in order if abs(direction[i]) > 0.1]
        combination = {names[i]: round(float(direction[i] / direction[main[0]]), 4) for i in main}
        text = (
            f"this log does not determine {names[main[0]]}"
            if len(main) == 1
            else "only a combination of " + ", ".join(names[i] for i in main) + " shows in the outputs"
        )
        result.append({"combination": combination, "sd_over_range": float(min(sd, 1e6)), "text": text})
    return result


def _summary(
    verdict: str, lacking: LackOfFit, held_out: float | None, undetermined: list[dict], diverged: np.ndarray
) -> str:
    if diverged.any():
        return (
            f"With these parameters the simulation runs away in {diverged.sum()} of {len(diverged)} windows. "
            "The model lacks something, or its time step is too long."
        )
    if verdict == "unexplained" and not lacking.lacking:
        return (
            "The parameters explain what they were fitted to, but not what was held out: there the error is "
            f"{held_out:.3g} times the noise floor. The two parts of the log are not alike."
        )
    if verdict == "unexplained":
        return (
            f"These parameters do not explain the log: the error is {lacking.normalized:.3g} times the noise floor "
            f"(chance allows {lacking.threshold:.3g}). The model lacks something."
        )
    if verdict == "not-identifiable":
        names = dict.fromkeys(name for u in undetermined for name in u["combination"])
        return f"The fit reaches the noise floor, but the log does not determine {', '.join(names)}."
    return f"The parameters explain the log: the error is {lacking.normalized:.3g} times the noise floor."


def _correlation(covariance: np.ndarray) -> np.ndarray:
    sd = np.sqrt(np.diag(covariance))
    return covariance / np.where(sd > 0, np.outer(sd, sd), 1.0)
