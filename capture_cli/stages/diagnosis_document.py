"""The document and the arrays of a diagnosis, from what explains the log."""

from __future__ import annotations

from typing import Any

import numpy as np

from capture_cli.identifiers.intervals import Intervals
from capture_cli.protocol.attribution import Accepted
from capture_cli.protocol.candidates import Candidate
from capture_cli.protocol.explanation import Explanation, Expression, JudgedModel
from capture_cli.protocol.fit import Fit
from capture_cli.protocol.log_parts import FIT, SELECT, TEST, LogParts
from capture_cli.protocol.prepared_log import PreparedLog
from capture_cli.protocol.residual_curves import ResidualCurve, residual_curves
from capture_cli.reports.diagnosis_findings import summary
from capture_cli.stages.result_document import (
    attributes_of,
    error_of,
    held_out_of,
    impossible_inertia_of,
    lack_of_fit_of,
    measured_arrays,
    noise_floor_of,
    start_arrays,
    time_step_of,
)
from capture_cli.stores.diagnosis import FORMAT, VERSION, Diagnosis
from capture_cli.stores.measured_log import MeasuredLog
from capture_cli.stores.output import sha256


def diagnosis_of(found: Explanation) -> Diagnosis:
    """What is written of it."""
    curves = residual_curves(
        found.parts.prepared, found.before.whole, found.after.whole, found.motion.contacts
    )
    rows = [{"output": c.output, "against": c.against, "unit": c.unit, "share": c.share} for c in curves]
    attributes = {**attributes_of(found.parts.prepared.log), "curves": rows}
    return Diagnosis(_document(found, rows), _arrays(found, curves), attributes)


def _document(found: Explanation, curves: list[dict[str, Any]]) -> dict[str, Any]:
    prepared, before, after = found.parts.prepared, found.before, found.after
    log, task = prepared.log, prepared.task
    sure = after.intervals
    stages = [_stage(found.parts, m) for m in found.models]
    declared = sure.rows(after.again.space, after.again.point, range(len(task.space)))
    document = {
        "format": FORMAT,
        "version": VERSION,
        "task": task.name,
        "log": {
            "path": str(log.path),
            "sha256": sha256(log.path),
            "first_time": float(log.time[0]),
        },
        "verdict": found.verdict,
        "summary": None,  # of what follows
        "effects": [_effect(a, after.again, sure, log) for a in found.accepted],
        "parameters": dict(zip(task.space.names, declared, strict=True)),
        "stages": stages,
        "before": {"test": stages[0]["test"]},
        "after": {"test": stages[-1]["test"]},
        **noise_floor_of(prepared),
        "lack_of_fit": {
            "before": lack_of_fit_of(prepared, before.lacking),
            "after": lack_of_fit_of(prepared, after.lacking),
        },
        "held_out": held_out_of(
            prepared, after.again.space, after.again.point, found.held_out, found.parts.number == TEST
        ),
        "impossible_inertia": impossible_inertia_of(
            task,
            after.again.point[: len(task.space)],
            [(a.placed.effect, after.again.point[after.again.columns(a.name)]) for a in found.accepted],
        ),
        "time_step": time_step_of(found.shorter_step, after.again.space, after.again.point),
        "absorbed": _absorbed(before.again, after.again, sure.sd),
        "candidates": [_candidate(c) for c in _ranked(found)],
        "localisation": curves,
        "split": {
            "how": prepared.split.how,
            **{
                f"{name}_windows": int((found.parts.number == number).sum())
                for name, number in (("fit", FIT), ("select", SELECT), ("test", TEST))
            },
        },
        "rollouts": {"measured": len(log.episode_ends), "simulated": found.rollouts},
        "next_experiment": found.next_experiment,
        "expression": None if found.expression is None else _expression(prepared, found.expression),
    }
    document["summary"] = summary(document)
    return document


def _arrays(found: Explanation, curves: list[ResidualCurve]) -> dict[str, np.ndarray]:
    mask, measured = found.parts.prepared.windows.mask, measured_arrays(found.parts.prepared)
    bins = {k: np.array([getattr(c, k) for c in curves]) for k in ("centre", "before", "after", "error")}
    return {
        **measured,
        **start_arrays(found.parts.prepared, found.begun),
        "window/start_hidden": found.begun.hidden,
        "window/part": found.parts.number,
        "step/before": measured["step/measured"] - found.before.whole.in_units[mask],
        "step/after": measured["step/measured"] - found.after.whole.in_units[mask],
        **{f"bin/{name}": np.nan_to_num(values) for name, values in bins.items()},
    }


def _stage(parts: LogParts, model: JudgedModel) -> dict[str, Any]:
    """Errors of one model. fit and test are of the refit; select is of fits that did not see what they judge."""
    prepared = parts.prepared
    return {
        "model": model.name,
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
    return {
        "effect": candidate.placed.kind,
        "site": candidate.placed.effect.site,
        "score": None if candidate.score is None else candidate.score.gain,
        "refit_select_error": None if select is None else select.normalized,
        "why_rejected": candidate.why_rejected,
    }


def _ranked(found: Explanation) -> list[Candidate]:
    """Candidates, accepted ones first, then by score."""
    accepted = {a.name for a in found.accepted}
    return sorted(
        found.candidates,
        key=lambda c: (c.name not in accepted, -(c.score.gain if c.score else -1.0), c.name),
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
