"""`capture identify`: measured log in, parameters with intervals and a verdict out."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from capture_cli.diagnosis.lack_of_fit import LackOfFit, lack_of_fit
from capture_cli.errors import FitError
from capture_cli.identifiers import log_identifier
from capture_cli.identifiers.base import Best, Trial, run
from capture_cli.identifiers.intervals import Intervals, intervals
from capture_cli.identifiers.least_squares import CONVERGED_GAIN
from capture_cli.stages.model_fits import ModelFits
from capture_cli.stages.prepared_log import check_parameters_move_outputs, find_task, prepare
from capture_cli.stages.progress import Progress
from capture_cli.stores.estimate import FORMAT, VERSION, Estimate
from capture_cli.stores.measured_log import MeasuredLog
from capture_cli.stores.output import new_directory, refuse_existing, sha256
from capture_cli.stores.provenance import Provenance

AT_BOUND = 1e-4  # of the range
DISAGREE_P = 0.01  # of all parameters together, Bonferroni


def identify(
    *,
    real_log: Path,
    out: Path,
    task: str | None = None,
    identifier: str = "least-squares",
    test: str | None = None,
    window: float | None = None,
    starts: int = 3,
    rounds: int = 100,
    seed: int = 0,
    threads: int | None = None,
    force: bool = False,
    quiet: bool = False,
) -> Estimate:
    """Identify the parameters of `task` from the log at `real_log`; write an estimate directory at `out`.

    test: recordings to hold out, "none", or None for a share of the log. window: s, instead of the task's.
    Raises CaptureError for whatever the user can mend, before anything is written.
    """
    options = {k: v for k, v in locals().items() if k not in ("quiet", "force")}
    refuse_existing(out, force=force)
    method = log_identifier(identifier)
    log = MeasuredLog.read(real_log)
    found = find_task(task, log)
    provenance = Provenance("identify", options, {"real_log": real_log, "task": getattr(found, "path", None)})
    prepared = prepare(log, found, window=window, test=test, seed=seed)
    fits = ModelFits(prepared, threads)
    simulator = fits.simulator([])
    check_parameters_move_outputs(prepared, simulator, seed)
    fit = prepared.part(~prepared.split.is_test)
    history: list[Best] = []
    with Progress("identify", "round", quiet=quiet) as progress:

        def on_round(best: Best) -> None:
            history.append(best)
            progress.step(f"error {best.error:.3g} x noise floor")

        solver = method(
            fit.evidence(simulator), start=found.space.nominal, seed=seed, rounds=rounds, starts=starts
        )
        best = run(solver, lambda t: fit.evaluate(simulator, t), on_round)
    if not np.isfinite(best.error):
        raise FitError(
            "every simulation tried diverged",
            cure="tighten the parameters' bounds, shorten the window, or reduce the model's timestep",
        )
    fits.rollouts += simulator.rollouts
    estimate = _Report(fits, identifier, best, history, seed).estimate()
    if estimate.document["verdict"] == "unexplained":
        estimate.document["next_command"] = f"capture diagnose --real-log {real_log} --estimate {out}"
    with new_directory(out, force=force) as folder:
        estimate.write(folder)
        _write_pages(estimate, folder, provenance)
        provenance.write(folder)
    return estimate


def _write_pages(estimate: Estimate, folder: Path, provenance: Provenance) -> None:
    from capture_cli.reports.estimate_page import render
    from capture_cli.reports.figures import write_figures

    (folder / "report.html").write_text(render(estimate, provenance.document()), encoding="utf-8")
    write_figures(estimate, folder)


class _Report:
    """Turns the best point into an Estimate: errors, intervals, verdict, recordings."""

    def __init__(self, fits: ModelFits, identifier: str, best: Best, history: list[Best], seed: int):
        self.fits = fits
        self.prepared = fits.prepared
        self.identifier = identifier
        self.best = best
        self.history = history
        self.seed = seed
        self.is_test = self.prepared.split.is_test
        self.space = self.prepared.task.space

    def estimate(self) -> Estimate:
        fit = self.fits.at(self.prepared.part(~self.is_test), [], self.best)
        found = intervals(fit.at)
        offsets = np.zeros_like(self.prepared.starts.sd)
        offsets[~self.is_test] = fit.offsets
        if self.is_test.any():
            test = self.prepared.part(self.is_test)
            offsets[self.is_test] = self.fits.on(test, fit, CONVERGED_GAIN).offsets
        simulated, nominal = self._curves(offsets)
        recordings = self._recordings(found)
        lacking = lack_of_fit(fit.at)
        document = self._document(found, lacking, simulated, recordings)
        return Estimate(
            document, self._arrays(found, offsets, simulated, nominal, recordings), self._attributes()
        )

    def _curves(self, offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Simulated at the estimate and at the nominal values, (window, step, output)."""
        points = np.stack([self.best.parameters, self.space.nominal])
        simulator = self.fits.simulator([])
        outputs, _ = self.prepared.evaluate(simulator, Trial(points, np.repeat(offsets[None], 2, axis=0)))
        self.fits.rollouts += simulator.rollouts
        return outputs[0], outputs[1]

    def _recordings(self, joint: Intervals):
        """The estimate of each fitted recording alone, from the joint one on; None for a single recording."""
        fit = self.prepared.part(~self.is_test)
        numbers = [n for n in np.unique(fit.recording) if (fit.recording == n).sum() >= 2]
        if len(numbers) < 2 or not len(self.space):
            return None
        values, sds = [], []
        for number in numbers:
            part = fit.part(fit.recording == number)
            own = self.fits.fit(
                part, [], self.best.parameters, rounds=12, tolerance=CONVERGED_GAIN, seed=self.seed
            )
            values.append(own.point)
            sds.append(intervals(own.at).sd)
        names = [self.prepared.log.recording_names[n] for n in numbers]
        return _agreement(names, np.array(values), np.array(sds), self.space.names, joint)

    # --- what is written ---

    def _document(self, found: Intervals, lacking: LackOfFit, simulated, recordings) -> dict:
        prepared, log = self.prepared, self.prepared.log
        names = [c.name for c in prepared.task.outputs]
        undetermined = _undetermined(found, self.space.names)
        verdict = (
            "unexplained"
            if lacking.lacking
            else ("explained" if found.identifiable.all() else "not-identifiable")
        )
        document = {
            "format": FORMAT,
            "version": VERSION,
            "task": prepared.task.name,
            "log": {"path": str(log.path), "sha256": sha256(log.path)},
            "identifier": self.identifier,
            "parameters": self._parameters(found),
            "error": {
                "fit": self._error(simulated, ~self.is_test),
                "test": self._error(simulated, self.is_test),
            },
            "noise_floor": dict(zip(names, prepared.noise.sd.tolist(), strict=True)),
            "noise_floor_source": dict(zip(names, prepared.noise.source, strict=True)),
            "verdict": verdict,
            "summary": _summary(verdict, lacking, undetermined),
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
                if np.isfinite(b.error)
            ],
            "next_command": None,
        }
        return document

    def _parameters(self, found: Intervals) -> dict:
        x = self.space.to_unit(self.best.parameters)
        return {
            p.name: {
                "value": float(self.best.parameters[i]),
                "unit": p.unit,
                "low": p.low,
                "high": p.high,
                "sd": float(found.sd[i]),
                "ci95": [float(found.low[i]), float(found.high[i])],
                "at_bound": bool(min(x[i], 1 - x[i]) < AT_BOUND),
                "identifiable": bool(found.identifiable[i]),
            }
            for i, p in enumerate(self.space)
        }

    def _error(self, simulated: np.ndarray, which: np.ndarray) -> dict | None:
        """RMSE and mean absolute error per output, and RMSE over the noise floor; None where nothing was held out."""
        if not which.any():
            return None
        windows, noise = self.prepared.windows, self.prepared.noise.sd
        mask = windows.mask[which]
        residual = (windows.measured - simulated)[which][mask]
        rmse = np.sqrt(np.square(residual).mean(axis=0))
        names = [c.name for c in self.prepared.task.outputs]
        return {
            "rmse": dict(zip(names, rmse.tolist(), strict=True)),
            "mae": dict(zip(names, np.abs(residual).mean(axis=0).tolist(), strict=True)),
            "normalized": float(np.sqrt(np.mean(np.square(rmse / noise)))),
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
            "step/measured": windows.measured[mask],
            "step/simulated": simulated[mask],
            "step/nominal": nominal[mask],
            "parameter/estimate": self.best.parameters,
            "parameter/covariance": found.covariance,
            "round/parameters": np.array([b.parameters for b in self.history]).reshape(len(self.history), -1),
            "round/error": np.array([b.error for b in self.history]),
        }
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
            f"{names[main[0]]} alone"
            if len(main) == 1
            else "only a combination of " + ", ".join(names[i] for i in main) + " shows in the outputs"
        )
        result.append({"combination": combination, "sd_over_range": float(min(sd, 1e6)), "text": text})
    return result


def _summary(verdict: str, lacking: LackOfFit, undetermined: list[dict]) -> str:
    if verdict == "unexplained":
        return (
            f"These parameters do not explain the log: the error is {lacking.normalized:.3g} times the noise floor "
            f"(chance allows {lacking.threshold:.3g}). The model lacks something."
        )
    if verdict == "not-identifiable":
        return "The fit reaches the noise floor, but the log does not determine: " + "; ".join(
            u["text"] for u in undetermined
        )
    return f"The parameters explain the log: the error is {lacking.normalized:.3g} times the noise floor."


def _correlation(covariance: np.ndarray) -> np.ndarray:
    sd = np.sqrt(np.diag(covariance))
    return covariance / np.where(sd > 0, np.outer(sd, sd), 1.0)
