"""`capture diagnose`: what the model lacks, traced to an effect, added, and the error before and after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.diagnosis.expression import expression_terms, formula
from capture_cli.diagnosis.lack_of_fit import NEAR_FLOOR, LackOfFit, holds, lack_of_fit
from capture_cli.diagnosis.localisation import accelerations, curve, largest_around
from capture_cli.diagnosis.split import HeldOut, select_folds
from capture_cli.errors import OptionError, StoreError
from capture_cli.identifiers.intervals import Intervals, intervals
from capture_cli.linearization import in_order, own_samples
from capture_cli.simulator import Motion, placed_name
from capture_cli.stages.attribution import MOST_EFFECTS, Attribution
from capture_cli.stages.candidates import Candidate
from capture_cli.stages.model_fits import EXACT, Fit, ModelFits, PartFit, by_output
from capture_cli.stages.next_experiment import next_experiment
from capture_cli.stages.prepared_log import (
    PreparedLog,
    all_diverged,
    as_acted,
    begins_as_acted,
    check_parameters_move_outputs,
    find_task,
    named,
    prepare,
)
from capture_cli.stages.progress import Progress
from capture_cli.stages.recorded_task import load_recorded, task_inputs
from capture_cli.stages.repeated_noise import with_noise_of_repeats
from capture_cli.stages.residual_noise import with_noise_of_residual
from capture_cli.stores.diagnosis import FORMAT, VERSION, Diagnosis
from capture_cli.stores.estimate import Estimate, read_result
from capture_cli.stores.measured_log import MeasuredLog
from capture_cli.stores.output import new_directory, refuse_existing, refuse_inputs, sha256
from capture_cli.stores.provenance import Provenance

FIT, SELECT, TEST = 0, 1, 2


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
    expression: bool = False,
    seed: int | None = None,
    threads: int | None = None,
    force: bool = False,
    quiet: bool = False,
) -> Diagnosis:
    """Diagnose the log at `real_log`; write a diagnosis directory at `out`.

    estimate: the estimate directory of the same log, whose task, windows, held-out part and seed are taken over where
    nothing else is said. Without it `task`, `test`, `window` and `seed` are as for identify. most_effects: to add.
    expression: where the catalogue leaves something, look for a formula of the missing force. Raises CaptureError for
    whatever the user can mend.
    """
    options = {k: v for k, v in locals().items() if k not in ("quiet", "force")}
    refuse_existing(out, force=force)
    log = MeasuredLog.read(real_log)
    begin = None
    if estimate is not None:
        begin, made = _check_estimate(estimate, real_log)
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
    held_out = None if begin is None or test is not None else _held_out(begin)
    prepared = prepare(log, found, window=window, test=test, held_out=held_out, seed=seed, threads=threads)
    nominal = _nominal(found, begin)
    with Progress("diagnose", "model", quiet=quiet) as progress:
        diagnosis = diagnose_prepared(
            prepared,
            nominal,
            progress,
            starts=starts,
            most_effects=most_effects,
            expression=expression,
            seed=seed,
            threads=threads,
        )
    with new_directory(out, force=force) as folder:
        diagnosis.write(folder)
        _write_pages(diagnosis, folder, provenance)
        provenance.write(folder)
    return diagnosis


def diagnose_prepared(
    prepared: PreparedLog,
    nominal: np.ndarray,
    progress: Progress,
    *,
    starts: int = 3,
    most_effects: int = MOST_EFFECTS,
    expression: bool = False,
    seed: int = 0,
    threads: int | None = None,
) -> Diagnosis:
    """What `diagnose` finds in a log that was made ready, from the values `nominal` (parameter,) of its task."""
    options = {k: v for k, v in locals().items() if k != "prepared"}
    checked = check_parameters_move_outputs(prepared, seed=seed, threads=threads)
    prepared, rollouts = with_noise_of_repeats(prepared, nominal, threads=threads, seed=seed)
    return _diagnose(prepared, rollouts=checked + rollouts, **options)


def _diagnose(
    prepared: PreparedLog,
    nominal: np.ndarray,
    progress: Progress,
    *,
    rollouts: int,
    starts: int,
    most_effects: int,
    expression: bool,
    seed: int,
    threads: int | None,
) -> Diagnosis:
    """With the starts that the actions say, where that explains what was fitted; else with free starts.

    Where contacts follow, free starts are worse: they make the error rough, and hide what moves them. Begun anew where
    what the declared model leaves shows less noise than the log. rollouts: how many were simulated before.
    """
    options = {k: v for k, v in locals().items() if k not in ("prepared", "rollouts")}
    for acted in (True, False) if begins_as_acted(prepared) else (False,):
        fits = ModelFits(as_acted(prepared) if acted else prepared, threads)
        fits.rollouts = rollouts
        work = _Work(fits.prepared, fits, progress, seed, most_effects)
        declared = work.declare(nominal, starts)
        quieter = with_noise_of_residual(prepared, work.fitted, declared, threads)
        if quieter is not prepared:
            return _diagnose(quieter, rollouts=fits.rollouts, **options)
        diagnosis = work.run(declared, with_expression=expression and not acted)
        if work.explains_what_was_fitted:
            break
        rollouts = fits.rollouts
    return diagnosis


def _check_estimate(folder: Path, real_log: Path) -> tuple[Estimate, dict[str, Any]]:
    found = Estimate.read(folder)
    if found.document["log"]["sha256"] != sha256(real_log):
        raise OptionError(
            f"{folder} was made from {found.document['log']['path']}, and {real_log} is not that log",
            cure=f"identify it first: capture identify --real-log {real_log}",
        )
    again = "make the estimate again with `capture identify`"
    return found, read_result(folder, "provenance.json", "capture/provenance", 1, again)


def _held_out(estimate: Estimate) -> HeldOut:
    arrays = estimate.arrays
    return HeldOut(arrays["window/first"], arrays["window/is_test"], estimate.document["split"]["how"])


def _nominal(task, estimate: Estimate | None) -> np.ndarray:
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


@dataclass(frozen=True)
class _Model:
    """A model with what judges it.

    fit: to the fit part. again: to all that is not test. minima: others of the same, nearly as good. judged: the fit on
    what it did not see; None where nothing judges. whole: the refit on every window.
    """

    name: str
    fit: Fit
    again: Fit
    minima: list[Fit]
    judged: PartFit | None
    whole: PartFit

    @property
    def intervals(self) -> Intervals:
        return intervals(self.again.at, [m.at for m in self.minima])


class _Work:
    """The protocol, step by step, on a prepared log."""

    def __init__(
        self,
        prepared: PreparedLog,
        fits: ModelFits,
        progress: Progress,
        seed: int,
        most_effects: int = MOST_EFFECTS,
    ):
        self.prepared = prepared
        self.fits = fits
        self.progress = progress
        self.seed = seed
        self.most_effects = most_effects
        is_test = prepared.split.is_test
        self.folds = select_folds(prepared.windows.episode, is_test)
        self.part = np.where(is_test, TEST, np.where(self.folds.fit, FIT, SELECT))
        self.explains_what_was_fitted = False

    @property
    def fitted(self) -> PreparedLog:
        """What models are fitted to."""
        return self._windows(FIT)

    def declare(self, start: np.ndarray, starts: int) -> Fit:
        """The declared model, from `start` (parameter,) and other places."""
        declared = self.fits.fit(self.fitted, [], start, starts=starts, tolerance=EXACT, seed=self.seed)
        if declared is None:
            raise all_diverged(self.prepared.task)
        return declared

    def run(self, declared: Fit, *, with_expression: bool = False) -> Diagnosis:
        attribution = self._attribution()
        last = attribution.run(declared)
        diagnosis = self._diagnosis(attribution, self._models(attribution, last))
        if with_expression and diagnosis.document["verdict"] == "unexplained":
            diagnosis.document["expression"] = self._expression(last)
        diagnosis.document["rollouts"]["simulated"] = (
            self.fits.rollouts
        )  # the document's own parts took some, too
        return diagnosis

    def _expression(self, last: Fit) -> dict[str, Any]:
        """A sparse expression for the force that is still missing; no terms where none holds."""
        task = self.prepared.task
        terms = expression_terms(task.model, [c.index for c in task.inputs])
        search = self._attribution([Candidate(term) for term in terms])
        found = search.run(last)
        chosen = found.effects[len(last.effects) :]
        if not chosen:
            return {"text": "no expression explains what is left", "terms": [], "select": None, "test": None}
        again = (
            self.fits.fit(self._windows(FIT, SELECT), found.effects, found.point, tolerance=EXACT) or found
        )
        values, sd = again.point[-len(chosen) :], intervals(again.at).sd[-len(chosen) :]
        windows, judged = self._windows(TEST), search.models.judge(found)
        return {
            "text": formula([e for _, e in chosen], values),
            "terms": [
                {"site": e.site, "coefficient": float(c), "sd": float(s), "unit": e.parameters[0].unit}
                for (_, e), c, s in zip(chosen, values, sd, strict=True)
            ],
            "select": None if judged is None else self._error(judged),
            "test": None if windows is None else self._error(self.fits.on(windows, again)),
        }

    def _attribution(self, candidates: Sequence[Candidate] | None = None) -> Attribution:
        return Attribution(
            self.fits,
            self.folds,
            seed=self.seed,
            is_explained=lambda fit: not lack_of_fit(fit.at).lacking,
            most_effects=self.most_effects,
            candidates=candidates,
            on_step=self._tell,
        )

    def _tell(self, what: str, number: int, total: int, found: Sequence[str] = ()) -> None:
        so_far = f"; found so far: {', '.join(found)}" if found else ""
        self.progress.step(self.progress.part(what, number, total) + so_far)

    def _windows(self, *parts: int) -> PreparedLog | None:
        keep = np.isin(self.part, parts)
        return self.prepared.part(keep) if keep.any() else None

    def _models(self, attribution: Attribution, last: Fit) -> list[_Model]:
        """The declared model and each with one more accepted effect."""
        models = []
        effects = last.effects
        for count in range(len(effects) + 1):
            own = effects[:count]
            name = "declared" if count == 0 else f"+ {placed_name(*own[-1])}"
            fit = last if count == len(effects) else attribution.models.nested(last, count)
            self._tell("refit", count, len(effects) + 1)
            judged = attribution.models.judge(fit)
            again = self.fits.fit(
                self._windows(FIT, SELECT),
                own,
                fit.point,
                offsets=self._starts_found(fit, judged),
                offsets_with=own,
                tolerance=EXACT,
            )
            minima = []
            if again is not None and count == len(effects):
                again, *minima = self.fits.minima(self._windows(FIT, SELECT), again, self.seed)
            models.append(_Model(name, fit, again or fit, minima, judged, self._whole(fit, again)))
        return models

    def _starts_found(self, fit: Fit, judged: PartFit | None) -> np.ndarray:
        """Offsets of the starts where a refit on all that is not test begins: there it is nearly done."""
        offsets = np.zeros((len(self.part), fit.offsets.shape[1]))
        offsets[self.part == FIT] = fit.offsets
        if judged is not None and len(self.folds.folds) == 1:
            offsets[self.part == SELECT] = judged.offsets
        return offsets[self.part != TEST]

    # --- what is written ---

    def _diagnosis(self, attribution: Attribution, models: list[_Model]) -> Diagnosis:
        before, after, found = models[0].again, models[-1].again, models[-1].intervals
        lacking_before, lacking = lack_of_fit(models[0].fit.at), lack_of_fit(models[-1].fit.at)
        stages = [self._stage(m) for m in models]
        log, task = self.prepared.log, self.prepared.task
        names = [c.name for c in task.outputs]
        whole = {"before": models[0].whole, "after": models[-1].whole}
        motion = self.fits.motion(self.prepared, after, whole["after"].offsets)
        curves, bins = self._localise(whole, motion)
        held_out = [whole[w].rows(self.part == TEST) for w in ("before", "after")]
        verdict = _verdict(lacking_before, lacking, *held_out, attribution)
        self.explains_what_was_fitted = not _leaves_something(lacking)
        last = "test" if stages[-1]["test"] else "fit"
        declared = found.rows(after.space, after.point, range(len(task.space)))
        document = {
            "format": FORMAT,
            "version": VERSION,
            "task": task.name,
            "log": {
                "path": str(log.path),
                "sha256": sha256(log.path),
                "first_time": float(log.time[0]),
            },
            "verdict": verdict,
            "summary": _summary(verdict, stages, attribution, lacking, last),
            "effects": self._effects(attribution, after, found),
            "parameters": dict(zip(task.space.names, declared, strict=True)),
            "stages": stages,
            "before": {"test": stages[0]["test"]},
            "after": {"test": stages[-1]["test"]},
            "noise_floor": dict(zip(names, self.prepared.noise.sd.tolist(), strict=True)),
            "noise_floor_source": dict(zip(names, self.prepared.noise.source, strict=True)),
            "lack_of_fit": {"before": vars(lacking_before), "after": vars(lacking)},
            "absorbed": _absorbed(before, after, found.sd),
            "candidates": [self._candidate(c) for c in _ranked(attribution)],
            "localisation": curves,
            "split": {
                "how": self.prepared.split.how,
                **{
                    f"{name}_windows": int((self.part == number).sum())
                    for name, number in (("fit", FIT), ("select", SELECT), ("test", TEST))
                },
            },
            "rollouts": {"measured": len(log.episode_ends), "simulated": self.fits.rollouts},
            "next_experiment": self._next_experiment(attribution, models[-1].fit),
            "expression": None,
        }
        return Diagnosis(document, self._arrays(whole, bins), self._attributes(curves))

    def _next_experiment(self, attribution: Attribution, last: Fit) -> dict[str, Any] | None:
        """What would separate the first tie; None where nothing is tied."""
        tied = next((a.tied for a in attribution.accepted if a.tied), [])
        return next_experiment(self.fits, last, [c.fit for c in tied], self.seed)

    def _stage(self, model: _Model) -> dict[str, Any]:
        """Errors of one model. fit and test are of the refit; select is of fits that did not see what they judge."""
        test = self.part == TEST
        return {
            "model": model.name,
            "fit": self._error(model.whole.rows(self.part == FIT)),
            "select": None if model.judged is None else self._error(model.judged),
            "test": self._error(model.whole.rows(test)),
        }

    def _error(self, on: PartFit) -> dict[str, Any] | None:
        """None where there is no sample; likewise of an output without any."""
        if not on.evidence.count:
            return None
        names = [c.name for c in self.prepared.task.outputs]
        return {
            "rmse": by_output(names, on.rmse),
            "mae": by_output(names, on.mae),
            "normalized": on.normalized,
        }

    def _effects(self, attribution: Attribution, after: Fit, found: Intervals) -> list[dict[str, Any]]:
        rows = []
        for accepted in attribution.accepted:
            own = after.columns(accepted.name)
            parameters = found.rows(after.space, after.point, range(own.start, own.stop))
            rows.append(
                {
                    "name": accepted.effect[0],
                    "site": accepted.effect[1].site,
                    "summary": accepted.effect[1].summary,
                    "parameters": dict(zip(accepted.effect[1].space.names, parameters, strict=True)),
                    "p_value": accepted.support.p_fit,
                    "p_select": accepted.support.p_select,
                    "tied_with": accepted.tied_with,
                }
            )
        return rows

    def _candidate(self, candidate) -> dict[str, Any]:
        select = candidate.select
        return {
            "effect": candidate.effect[0],
            "site": candidate.effect[1].site,
            "score": None if candidate.score is None else candidate.score.gain,
            "refit_select_error": None if select is None else select.normalized,
            "why_rejected": candidate.why_rejected,
        }

    def _whole(self, fit: Fit, again: Fit | None) -> PartFit:
        """The refit, or the fit where there is none, on every window; what was held out has no say in the others."""
        seen = self.part != TEST
        offsets = None if again is None else again.offsets
        parts = [self.fits.on(self.prepared.part(seen), again or fit, offsets=offsets)]
        if not seen.all():
            parts.append(self.fits.on(self.prepared.part(~seen), again or fit))
        order = np.argsort(np.concatenate([np.flatnonzero(seen), np.flatnonzero(~seen)]))
        return PartFit.concatenate(parts).rows(order)

    def _localise(self, whole: dict[str, PartFit], motion: Motion):
        """Curves of residual acceleration before and after, against everything it could depend on."""
        windows, task = self.prepared.windows, self.prepared.task
        steps = self._log_steps()
        time = np.take(self.prepared.log.time, steps)
        series = {k: _in_units(p) for k, p in whole.items()}
        inputs = np.take(self.prepared.log.inputs, steps, axis=0)
        contacts = np.take_along_axis(motion.contacts, windows.index, axis=1)
        contacts = largest_around(np.where(windows.mask, contacts, 0)).astype(float)
        names, bins = [], []
        for k, output in enumerate(task.outputs):
            order = own_samples(windows.sampled[..., k])
            own_time, own = in_order(time, order), in_order(windows.sampled[..., k], order)
            position = np.where(own, in_order(windows.measured[..., k], order), np.nan)
            velocity = np.gradient(position, axis=1) / np.gradient(own_time, axis=1)
            covariates = [("time", "s", own_time), (output.name, output.unit, position)]
            covariates.append((f"rate of {output.name}", f"{output.unit}/s", velocity))
            own_inputs = in_order(inputs, order)
            covariates += [(c.name, c.unit, own_inputs[..., i]) for i, c in enumerate(task.inputs)]
            if np.ptp(contacts[windows.mask]) > 0:
                covariates.append(("number of contacts", "1", in_order(contacts, order)))
            left = [in_order(series[w][..., k, None], order) for w in ("before", "after")]
            was_and_is = [accelerations(r, own_time, own) for r in left]
            for against, unit, covariate in covariates:
                flat = np.where(own, covariate, np.nan).ravel()
                was, now = (curve(flat, a.ravel()) for a in was_and_is)
                names.append({"output": output.name, "against": against, "unit": unit, "share": was.share})
                bins.append((was.centre, was.mean, now.mean, was.error))
        return names, np.array(bins)

    def _log_steps(self) -> np.ndarray:
        windows = self.prepared.windows
        steps = windows.first[:, None] + np.arange(windows.mask.shape[1])
        return np.minimum(steps, len(self.prepared.log.time) - 1)

    def _arrays(self, whole: dict[str, PartFit], bins: np.ndarray) -> dict[str, np.ndarray]:
        windows = self.prepared.windows
        mask = windows.mask
        measured = np.where(windows.sampled, windows.measured, np.nan)[mask]
        bins = np.nan_to_num(bins)
        return {
            "window/episode": windows.episode,
            "window/first": windows.first,
            "window/part": self.part,
            "step/window": np.repeat(np.arange(len(windows)), windows.samples),
            "step/time": self.prepared.log.time[self._log_steps()[mask]],
            "step/measured": measured,
            "step/before": measured - _in_units(whole["before"])[mask],
            "step/after": measured - _in_units(whole["after"])[mask],
            "bin/centre": bins[:, 0],
            "bin/before": bins[:, 1],
            "bin/after": bins[:, 2],
            "bin/error": bins[:, 3],
        }

    def _attributes(self, curves) -> dict[str, Any]:
        log = self.prepared.log
        return {
            "outputs": [
                {"name": n, "unit": u} for n, u in zip(log.output_names, log.output_units, strict=True)
            ],
            "recordings": list(log.recording_names),
            "curves": curves,
        }


def _in_units(part: PartFit) -> np.ndarray:
    """Residual (window, step, output) in the outputs' units."""
    return part.residual.reshape(part.evidence.measured.shape) * part.evidence.noise_sd


def _verdict(
    before: LackOfFit,
    after: LackOfFit,
    held_out_before: PartFit,
    held_out: PartFit,
    attribution: Attribution,
) -> str:
    """A model that does not hold on what was held out explains nothing, however well it fits the rest."""
    count = held_out.evidence.count
    if count and not holds(held_out.normalized, count):
        return "unexplained"
    if count and attribution.accepted and held_out.normalized >= held_out_before.normalized:
        return "unexplained"
    if not before.lacking:
        return "explained"
    if not attribution.accepted or _leaves_something(after):
        return "unexplained"
    return "tied" if any(a.tied_with for a in attribution.accepted) else "effect-found"


def _leaves_something(after: LackOfFit) -> bool:
    return after.lacking and after.normalized > NEAR_FLOOR


def _absorbed(before: Fit, after: Fit, sd: np.ndarray) -> dict[str, Any]:
    """How far each declared parameter moved when the effects came in, in sd (parameter,) of the later one."""
    if len(after.space) == len(before.space):
        return {}
    return {
        name: {
            "before": float(before.point[i]),
            "after": float(after.point[i]),
            "unit": before.space.parameters[i].unit,
            "shift_in_sd": float((after.point[i] - before.point[i]) / sd[i]) if sd[i] > 0 else 0.0,
        }
        for i, name in enumerate(before.space.names)
    }


def _ranked(attribution: Attribution):
    """Candidates, accepted ones first, then by score."""
    accepted = {a.name for a in attribution.accepted}
    return sorted(
        attribution.candidates,
        key=lambda c: (c.name not in accepted, -(c.score.gain if c.score else -1.0), c.name),
    )


def _summary(verdict: str, stages, attribution: Attribution, lacking: LackOfFit, part: str) -> str:
    from capture_cli.reports.diagnosis_findings import listed

    if verdict == "explained":
        return f"Nothing is missing: the error is {lacking.normalized:.3g} times the noise floor."
    first, last = (s[part]["normalized"] for s in (stages[0], stages[-1]))
    where = "held-out" if part == "test" else "fit"
    if not attribution.accepted and not lacking.lacking:
        return (
            f"The model fits what it was fitted to, but not what was held out: there the error is {last:.3g} times the "
            "noise floor. The two parts of the log are not alike."
        )
    if not attribution.accepted:
        return (
            f"None of these: the {where} error is {last:.3g} times the noise floor, and no effect of the catalogue "
            "explains it."
        )
    found = listed(
        [a.name + (f" (or {', '.join(a.tied_with)})" if a.tied_with else "") for a in attribution.accepted]
    )
    if part == "test" and last >= first:
        return (
            f"{found} would explain what was fitted, but not what was held out: there the error is {last:.3g} times "
            f"the noise floor, and {first:.3g} without."
        )
    them = "it" if len(attribution.accepted) == 1 else "them"
    text = (
        f"The model lacks {found}: with {them} the {where} error falls to {last / first:.2g} of what it was."
    )
    if verdict == "unexplained":
        left, on = (lacking.normalized, " on what was fitted") if lacking.normalized > last else (last, "")
        text += f" What is left{on} is still {left:.3g} times the noise floor: this is not all."
    return text
