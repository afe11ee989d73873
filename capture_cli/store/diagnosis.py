"""The diagnosis directory: diagnosis.json (what the model lacks), diagnosis.zarr (the curves), report and figures."""

from collections.abc import Sequence
from dataclasses import dataclass

from capture_cli.store.document_shape import BOUNDS, FLAG, NUMBER, OBJECT, POSITIVE, TEXT, WHOLE, or_none
from capture_cli.store.result import DocumentKind, Record, Result, Row, Rows
from capture_cli.store.schema import INITIAL_STATES, STEPS, WINDOWS, ArraySpec, Schema

FORMAT = "capture/diagnosis"
VERSION = 1
_CURE = "make it again with `capture diagnose`"

SCHEMA = Schema(
    format="capture/diagnosis-arrays",
    version=1,
    arrays=(
        *WINDOWS,
        ArraySpec("window/part", "window", "-", "0 fit, 1 select, 2 test", dtype="int64"),
        *INITIAL_STATES,
        ArraySpec(
            "window/start_hidden",
            "window hidden",
            "1",
            "with which `states` of the effects of diagnosis.json, one after the other; effects.md says what they are",
            optional=True,
        ),
        *STEPS,
        ArraySpec("step/before", "step output", "per output", "simulated by the declared model, refitted"),
        ArraySpec("step/after", "step output", "per output", "simulated with the accepted effects"),
        ArraySpec("bin/centre", "curve bin", "per curve", "covariate at the middle of each bin"),
        ArraySpec("bin/before", "curve bin", "per curve", "mean residual acceleration, declared model"),
        ArraySpec("bin/after", "curve bin", "per curve", "mean residual acceleration, with effects"),
        ArraySpec("bin/error", "curve bin", "per curve", "standard error of `before` in each bin"),
    ),
    attributes={
        "outputs": "list of {name, unit}",
        "recordings": "recording names",
        "curves": "list of {output, against, unit, share}: what each curve of residual acceleration is against, and "
        "the share of its variance that the covariate accounts for",
    },
    cure_for_other_version=_CURE,
)


SHAPE = {  # of what is read of diagnosis.json
    "task": TEXT,
    "log": {"path": TEXT, "first_time?": NUMBER},
    "verdict": TEXT,
    "summary?": TEXT,
    "parameters": {str: {"value": NUMBER, "low?": NUMBER, "high?": NUMBER}},
    "effects": [{"name": TEXT, "site": TEXT, "parameters": {str: {"value": NUMBER, "high": NUMBER}}}],
    "next_experiment?": or_none(OBJECT),
    "expression?": or_none({"terms": [{"site": TEXT, "coefficient": NUMBER}], "values?": {str: NUMBER}}),
}
# of its next experiment, by what proposes that
EXPERIMENT = {
    "text": TEXT,
    "band_hz": BOUNDS,
    "peaks": [NUMBER],
    "duration_s": POSITIVE,
    "seed?": WHOLE,
    "is_near?": FLAG,
    "predicted?": {str: {"log": or_none([NUMBER]), "near": [or_none(NUMBER)]}},
    "beyond_log?": or_none(OBJECT),
}


@dataclass(frozen=True, kw_only=True)
class DiagnosisRecord(Record):
    """diagnosis.json, as reports read it."""

    stages: Sequence[Row] | None = None
    before: Row | None = None
    after: Row | None = None
    absorbed: Rows | None = None
    candidates: Sequence[Row] | None = None
    localisation: Sequence[Row] | None = None
    next_experiment: Row | None = None
    out_of_time: str | None = None
    expression: Row | None = None


class Diagnosis(Result):
    """diagnosis.json and diagnosis.zarr."""

    NAME, SCHEMA, RECORD = "diagnosis", SCHEMA, DiagnosisRecord
    KIND = DocumentKind(FORMAT, VERSION, _CURE, SHAPE)
