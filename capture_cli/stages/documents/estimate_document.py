"""The document and the arrays of an estimate, from what was found: errors, intervals, verdict, recordings."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from capture_cli.common.progress import Progress
from capture_cli.common.quantities import significant
from capture_cli.context.identifiers.base import Rounds
from capture_cli.estimate.fit import SETTINGS as FIT
from capture_cli.estimate.fit import Fit
from capture_cli.estimate.held_out import held_out
from capture_cli.estimate.model_fits import Effort
from capture_cli.estimate.noise.lack_of_fit import LackOfFit, lack_of_fit
from capture_cli.estimate.noise.time_stamp_jitter import time_stamp_jitter
from capture_cli.estimate.part_fit import PartFit
from capture_cli.estimate.prediction import Predicted, PredictingModel, prediction_errors
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve.base import Trial
from capture_cli.estimate.solve.intervals import Intervals, intervals
from capture_cli.estimate.solve.least_squares import SETTINGS as LEAST_SQUARES
from capture_cli.estimate.time_step import shorter_step
from capture_cli.model.coordinate_sources import unmeasured_joints
from capture_cli.model.effects.ranges import effect_rows
from capture_cli.model.tasks.base import ActionTask, Task
from capture_cli.report.findings import behind, beyond_chance, not_alike
from capture_cli.stages.documents.agreement import Agreement, agreement
from capture_cli.stages.documents.result_document import (
    FoundPoint,
    Judged,
    attributes_of,
    common_part,
    error_of,
    initial_state_arrays,
    lack_of_fit_of,
    measured_arrays,
)
from capture_cli.stages.documents.undetermined_document import with_limits
from capture_cli.stages.identification.estimation import Found
from capture_cli.stages.recorded.recorded_estimate import EarlierEstimate
from capture_cli.store.estimate import FORMAT, HISTORY, VERSION, Estimate, EstimateRecord


class Report:
    """Turns the best point into an Estimate: errors, intervals, verdict, recordings."""

    def __init__(
        self, result: Found, identifier: str, seed: int, earlier: EarlierEstimate | None, progress: Progress
    ):
        self.result = result
        self.fits = result.fits
        self.prepared = result.fits.prepared
        self.identifier = identifier
        self.best = result.best
        before = [] if earlier is None else earlier.history
        self.history = [b for b in (*before, *result.history) if np.isfinite(b.error)]
        self.seed = seed
        self.earlier = earlier
        self.progress = progress
        self.is_test = self.prepared.split.is_test
        self.space = self.prepared.task.space

    def estimate(self) -> Estimate:
        fit = self.result.at
        found, lacking = self.result.intervals, lack_of_fit(fit.at)
        # of the machine's own states, and of those that the task's effects hide
        corrections = np.zeros((len(self.is_test), fit.corrections.shape[1]))
        corrections[~self.is_test] = fit.corrections
        if self.is_test.any():
            test = self.prepared.part(self.is_test)
            tolerance = self._state_tolerance(lacking.lacking)
            on_test = self.fits.on(test, fit, tolerance, thorough=not lacking.lacking)
            corrections[self.is_test] = on_test.corrections
        simulated, nominal, diverged = self._curves(corrections)
        recordings = self._recordings(found)
        data = self.prepared.data(self.fits.simulator([]))
        whole = PartFit(data, corrections, data.residual(simulated), *np.zeros((2, len(corrections))))
        held = held_out(self.fits, fit, found.covariance, whole, self.is_test)
        shorter = shorter_step(self.fits, self.result.part, fit, found)
        stamps = time_stamp_jitter(self.prepared, whole, fit.at, ~self.is_test)
        judged = Judged(held, self._predicted(corrections), shorter, stamps)
        document = self._document(found, lacking, whole, judged, recordings, diverged)
        arrays = self._arrays(found, corrections, simulated, nominal, recordings)
        attributes = {"parameters": list(self.space.names), **attributes_of(self.prepared.log)}
        return Estimate(document, arrays, attributes)

    def _state_tolerance(self, lacking: bool) -> float:
        """Of the initial states of held-out windows, of the objective over k: they are as exact as the fit was."""
        if self.result.in_context is None:
            return LEAST_SQUARES.converged_gain
        rough = 1.0  # of the objective over k: a standard error
        return rough if lacking and not self.result.elsewhere else FIT.tolerance

    def _curves(self, corrections: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Simulated at the estimate and at the nominal values, (window, step, output); whether it diverged at the
        estimate, (window,).
        """
        points = np.stack([self.best.parameters, self.space.nominal])
        trial = Trial(points, np.repeat(corrections[None], 2, axis=0))
        outputs, diverged = self.prepared.evaluate(self.fits.simulator([]), trial)
        return outputs[0], outputs[1], diverged[0]

    def _predicted(self, corrections: np.ndarray) -> Predicted:
        """Errors in open loop of the model as it was declared, and with the estimate; corrections (window, state)."""
        points = {"nominal": self.space.nominal, "identified": self.best.parameters}
        models = [PredictingModel(name, (), point, corrections) for name, point in points.items()]
        return prediction_errors(self.fits, models)

    def _recordings(self, joint: Intervals) -> Agreement | None:
        """The estimate of each fitted recording alone, from the joint one on; None for a single recording."""
        fit = self.result.part
        fitted = np.unique(fit.recording)
        numbers = [n for n in fitted if (fit.recording == n).sum() >= 2]
        if len(numbers) < 2 or not len(self.space):
            return None
        names = self.prepared.log.recording_names
        alone, fits, gains = [], [], []
        for done, number in enumerate(numbers):
            self.progress.part("recording on its own,", done, len(numbers))
            which = fit.recording == number
            own = self.fits.fit(
                fit.part(which),
                [],
                self.best.parameters,
                corrections=self.result.at.corrections[which],
                effort=Effort(rounds=12, tolerance=LEAST_SQUARES.converged_gain, seed=self.seed),
            )
            if own is not None:
                alone.append(names[number])
                fits.append(own)
                gains.append(self._gain(fit.part(which), own))
        if len(alone) < 2:
            return None
        values, sds = np.array([f.point for f in fits]), np.array([intervals(f.at).sd for f in fits])
        found = agreement(alone, values, sds, sum(gains), self.space, joint.identifiable)
        left_out = [names[n] for n in fitted if names[n] not in alone]
        if left_out:
            found = replace(found, text=f"{found.text}; nothing is known of {', '.join(left_out)} alone")
        return found

    def _gain(self, part: PreparedLog, own: Fit) -> float:
        """By how much less of the objective over k the fit `own` to the part leaves than the estimate does, each with
        initial states of its own.
        """
        k, together = own.at.inflation, replace(own, point=self.best.parameters)
        there = self.fits.initial_states_at(part, together, LEAST_SQUARES.converged_gain, own.corrections)
        return float((there.objectives(k) - own.at.objectives(k)).sum() / k)

    # --- what is written ---

    def _document(
        self, found: Intervals, lacking: LackOfFit, whole: PartFit, judged: Judged, recordings, diverged
    ) -> dict:
        prepared, parts, held = self.prepared, {"fit": ~self.is_test, "test": self.is_test}, judged.held
        at = FoundPoint(self.space, self.best.parameters, found)
        common = common_part(prepared, at, judged, parts, self.fits.rollouts)
        lacks = [lack_of_fit_of(prepared, part) for part in (lacking, held.lack)]
        verdict = _verdict(found, diverged.any() or lacking.lacking or held.lacking)
        return {
            "format": FORMAT,
            "version": VERSION,
            **common,
            "effects": effect_rows(prepared.task.effects),
            "log": {**common["log"], "input_peaks": prepared.log.input_peaks},
            "identifier": self.identifier,
            "error": {name: error_of(prepared, whole.rows(part)) for name, part in parts.items()},
            "verdict": verdict,
            "summary": _summary(
                verdict,
                lacks,
                common["parameters"],
                diverged,
                self._why(common),
                not_alike(EstimateRecord.of(common)),
            ),
            "diverged_windows": int(diverged.sum()),
            "lack_of_fit": lacks[0],
            "unmeasured_joints": _unmeasured_joints(prepared.task),
            "open_loops": dict(prepared.initial.open_loops),
            "correlation": _correlation(found.covariance).tolist(),
            "recordings": None if recordings is None else recordings.document(self.space),
            "rounds": [
                {"parameters": self.space.to_dict(b.parameters), "error": float(b.error)}
                for b in self.history
            ],
            "misread": None,
            "cut_short": self.result.cut_short,
            "in_context": self._in_context(),
            "next_command": None,
        }

    def _why(self, common: dict[str, Any]) -> str:
        """Why there may be an error without a fault of the model, in words; "" where nothing tells."""
        if self.result.cut_short is not None:
            return "The search was not finished."
        return behind(EstimateRecord.of(common))

    def _in_context(self) -> dict | None:
        """What the rounds over the episodes gave; those of the earlier estimate where there were none now."""
        result = self.result
        if result.in_context is None:
            return None if self.earlier is None else self.earlier.estimate.record.in_context
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

    def _arrays(self, found: Intervals, corrections, simulated, nominal, recordings) -> dict[str, np.ndarray]:
        mask = self.prepared.windows.mask
        initial = self.prepared.initial_conditions(self.fits.simulator([]), self.best.parameters, corrections)
        arrays = {
            **measured_arrays(self.prepared),
            "window/is_test": self.is_test,
            "window/start_offset": corrections[:, : self.prepared.initial.sd.shape[1]],
            **initial_state_arrays(self.prepared, initial),
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
            arrays["parameter/recordings"] = recordings.values
            arrays["parameter/recordings_sd"] = recordings.sd
        return arrays


def _verdict(found: Intervals, leaves: bool) -> str:
    """The verdict on an estimate that leaves more than noise in the log, or not."""
    if leaves:
        return "unexplained"
    return "explained" if found.identifiable.all() else "not-identifiable"


def _unmeasured_joints(task: Task) -> list[str]:
    """Joints whose initial position in a window is a guess: no output, action or loop of the model says it."""
    if isinstance(task, ActionTask) or task.model.neq:
        return []
    return unmeasured_joints(task.model, [c.index for c in task.outputs])


def _summary(
    verdict: str,
    lacks: Sequence[dict[str, Any]],
    parameters: dict[str, dict],
    diverged: np.ndarray,
    why: str,
    unlike: str,
) -> str:
    """lacks: what is left of what was fitted, and of what was held out. why: what leaves an error, where it need not be
    the model. unlike: how what was held out may differ.
    """
    lacking, held_out = lacks
    if diverged.any():
        return (
            f"With these parameters the simulation runs away in {diverged.sum()} of {len(diverged)} windows. "
            "The model lacks something, or its time step is too long."
        )
    if verdict == "unexplained" and not lacking["lacking"]:
        return (
            "The parameters explain what they were fitted to, but not what was held out: there the "
            f"{beyond_chance(held_out)}. {why or unlike}"
        )
    if verdict == "unexplained":
        return unexplained(lacking, why or "The model lacks something.")
    if verdict == "not-identifiable":
        said = ", ".join(with_limits(name, p) for name, p in parameters.items() if not p["identifiable"])
        return f"The fit reaches the noise floor, but the log does not determine {said}."
    return f"The parameters explain the log: the error is {significant(lacking['normalized'])} times the noise floor."


def unexplained(lacking: dict[str, Any], why: str) -> str:
    """The summary where the fit leaves something, `lacking`."""
    return f"These parameters do not explain the log: the {beyond_chance(lacking)}. {why}"


def _correlation(covariance: np.ndarray) -> np.ndarray:
    sd = np.sqrt(np.diag(covariance))
    return covariance / np.where(sd > 0, np.outer(sd, sd), 1.0)
