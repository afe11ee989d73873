"""The document and the arrays of a diagnosis, from what explains the log."""

from typing import Any

import numpy as np

from capture_cli.estimate.fit import Fit
from capture_cli.estimate.model_fits import ModelFits
from capture_cli.estimate.prediction import Predicted, PredictingModel, prediction_errors
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve.intervals import Intervals
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.report.diagnosis_findings import summary
from capture_cli.report.rejection_sentences import sentence
from capture_cli.select.candidates import Candidate
from capture_cli.select.explanation import Explanation, Expression, JudgedModel
from capture_cli.select.log_parts import FIT, SELECT, TEST, LogParts
from capture_cli.select.residual_curves import ResidualCurve, residual_curves
from capture_cli.select.search.answer import Accepted
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
from capture_cli.store.diagnosis import FORMAT, VERSION, Diagnosis, DiagnosisRecord

OUT_OF_TIME = (
    "The time limit ended the search: this is the best that was found until then, and more may be missing."
)
PARTS = {"fit": FIT, "select": SELECT, "test": TEST}


def diagnosis_of(found: Explanation, threads: int | None) -> Diagnosis:
    """The diagnosis to write: its document, its arrays and their attributes."""
    fits = ModelFits(found.parts.prepared, threads)
    predicted = prediction_errors(fits, _predicting(found))
    curves = residual_curves(
        found.parts.prepared, found.before.whole, found.after.whole, found.motion.contacts
    )
    rows = [{"output": c.output, "against": c.against, "unit": c.unit, "share": c.share} for c in curves]
    attributes = {**attributes_of(found.parts.prepared.log), "curves": rows}
    document = _document(found, rows, predicted, found.rollouts + fits.rollouts)
    return Diagnosis(document, _arrays(found, curves), attributes)


def _predicting(found: Explanation) -> list[PredictingModel]:
    """The models whose errors in open loop are shown: as it was declared, with the parameters that were identified, and
    with the effects that were accepted, where there are any.
    """
    before, after = found.before, found.after
    nominal = found.parts.prepared.task.space.nominal
    models = [
        PredictingModel("nominal", (), nominal, before.whole.corrections),
        PredictingModel("identified", (), before.again.point, before.whole.corrections),
    ]
    if after is not before:
        fit = after.again
        models.append(PredictingModel("diagnosed", fit.effects, fit.point, after.whole.corrections))
    return models


def _document(
    found: Explanation, curves: list[dict[str, Any]], predicted: Predicted, simulated: int
) -> dict[str, Any]:
    prepared, before, after = found.parts.prepared, found.before, found.after
    log, fit, sure = prepared.log, after.again, found.sure
    effects = [(a.placed.effect, fit.point[fit.columns(a.name)]) for a in found.accepted]
    common = common_part(
        prepared,
        FoundPoint(fit.space, fit.point, sure, effects),
        Judged(found.held_out, predicted, found.shorter_step, found.stamps),
        parts={name: found.parts.number == part for name, part in PARTS.items()},
        simulated=simulated,
    )
    stages = [_stage(found.parts, m) for m in found.models]
    document = {
        "format": FORMAT,
        "version": VERSION,
        **common,
        "log": {**common["log"], "first_time": float(log.time[0])},
        "verdict": found.verdict,
        "summary": None,  # of all the others
        "effects": [_effect(a, fit, sure, log) for a in found.accepted],
        "stages": stages,
        "before": {"test": stages[0]["test"]},
        "after": {"test": stages[-1]["test"]},
        "lack_of_fit": {
            "before": lack_of_fit_of(prepared, before.lacking),
            "after": lack_of_fit_of(prepared, after.lacking),
        },
        "absorbed": _absorbed(before.again, fit, sure.sd),
        "candidates": [_candidate(c) for c in _ranked(found)],
        "localisation": curves,
        "next_experiment": found.next_experiment,
        "out_of_time": _out_of_time(found),
        "expression": None if found.expression is None else _expression(prepared, found.expression),
    }
    return {**document, "summary": summary(DiagnosisRecord.of(document))}


def _arrays(found: Explanation, curves: list[ResidualCurve]) -> dict[str, np.ndarray]:
    mask, measured = found.parts.prepared.windows.mask, measured_arrays(found.parts.prepared)
    bins = {k: np.array([getattr(c, k) for c in curves]) for k in ("centre", "before", "after", "error")}
    return {
        **measured,
        **initial_state_arrays(found.parts.prepared, found.initial_conditions),
        "window/start_hidden": found.initial_conditions.hidden,
        "window/part": found.parts.number,
        "step/before": measured["step/measured"] - found.before.whole.in_units[mask],
        "step/after": measured["step/measured"] - found.after.whole.in_units[mask],
        **{f"bin/{name}": np.nan_to_num(values) for name, values in bins.items()},
    }


def _out_of_time(found: Explanation) -> str | None:
    """What the time limit ended or left out, in words."""
    left_out = f"For want of time this was left out: {'; '.join(found.left_out)}." if found.left_out else ""
    said = [OUT_OF_TIME if found.out_of_time else "", left_out]
    said = " ".join(s for s in said if s)
    return f"{said} Run it again with a longer --time-limit, or without." if said else None


def _stage(parts: LogParts, model: JudgedModel) -> dict[str, Any]:
    """Errors of one model. fit and test are of the refit; select is of fits that did not see what they judge."""
    prepared = parts.prepared
    return {
        "model": model.name,
        "refitted": model.is_refitted,
        "fit": error_of(prepared, model.whole.rows(parts.number == FIT)),
        "select": None if model.judged is None else error_of(prepared, model.judged),
        "test": error_of(prepared, model.whole.rows(parts.number == TEST)),
    }


def _effect(accepted: Accepted, after: Fit, sure: Intervals, log: MeasuredLog) -> dict[str, Any]:
    name, effect = accepted.placed
    own = after.columns(accepted.name)
    parameters = sure.rows(after.space, after.point, range(own.start, own.stop))
    return {
        "name": name,
        "site": effect.site,
        "summary": effect.summary,
        "law": effect.law(),
        "parameters": dict(zip(effect.space.names, parameters, strict=True)),
        "states": list(effect.states),
        "first_time": float(log.time[effect.first_step()]),
        "p_value": accepted.support.p_fit,
        "p_select": accepted.support.p_select,
        "tied_with": accepted.tied_with,
    }


def _candidate(candidate: Candidate) -> dict[str, Any]:
    select = candidate.select
    rejection = None if candidate.rejection is None else candidate.rejection.document()
    return {
        "effect": candidate.placed.kind,
        "site": candidate.placed.effect.site,
        "score": None if candidate.score is None else candidate.score.gain,
        "refit_select_error": None if select is None else select.normalized,
        "rejection": rejection,
        "why_rejected": sentence(rejection),
    }


def _ranked(found: Explanation) -> list[Candidate]:
    """Candidates, accepted ones first, then by score."""
    accepted = {a.name for a in found.accepted}
    return sorted(
        found.candidates, key=lambda c: (c.name not in accepted, -(c.score.gain if c.score else -1.0), c.name)
    )


def _expression(prepared: PreparedLog, found: Expression) -> dict[str, Any]:
    terms = zip(found.terms, found.coefficients, found.sd, strict=True)
    return {
        "text": found.text,
        "terms": [
            {"site": e.site, "coefficient": float(c), "sd": float(s), "unit": e.parameters[0].unit}
            for e, c, s in terms
        ],
        "values": dict(found.values),
        "select": None if found.judged is None else error_of(prepared, found.judged),
        "test": None if found.held_out is None else error_of(prepared, found.held_out),
    }


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
