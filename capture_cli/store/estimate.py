"""The estimate directory: estimate.json (what was found), estimate.zarr (the curves), report.html and figures."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from capture_cli.store.document_shape import FLAG, NUMBER, OBJECT, TEXT, WHOLE, or_none
from capture_cli.store.result import DocumentKind, Record, Result, Row
from capture_cli.store.schema import INITIAL_STATES, STEPS, WINDOWS, ArraySpec, Schema

FORMAT = "capture/estimate"
VERSION = 2
_CURE = "make it again with `capture identify`"
# the rounds in context, as an identifier reads them
HISTORY = ("history/parameters", "history/actions", "history/simulated", "history/measured")
_POINTS = "entry point feature"

SCHEMA = Schema(
    format="capture/estimate-arrays",
    version=1,
    arrays=(
        *WINDOWS,
        ArraySpec(
            "window/is_test", "window", "-", "True: held out; only its initial state is fitted", dtype="bool"
        ),
        ArraySpec("window/start_offset", "window state", "SI", "correction of its initial state"),
        *INITIAL_STATES,
        *STEPS,
        ArraySpec("step/simulated", "step output", "per output", "simulated at the estimate"),
        ArraySpec("step/nominal", "step output", "per output", "simulated at the nominal values"),
        ArraySpec("parameter/estimate", "parameter", "per parameter", "the estimate"),
        ArraySpec("parameter/covariance", "parameter parameter", "per parameter", "its covariance"),
        ArraySpec(
            "parameter/recordings", "recording parameter", "per parameter", "from each alone", optional=True
        ),
        ArraySpec(
            "parameter/recordings_sd", "recording parameter", "per parameter", "their sd", optional=True
        ),
        ArraySpec("round/parameters", "round parameter", "per parameter", "best so far"),
        ArraySpec("round/error", "round", "1", "normalized fit error of the best so far"),
        ArraySpec(
            HISTORY[0], "entry parameter", "per parameter", "rounds in context: simulated with", optional=True
        ),
        ArraySpec(HISTORY[1], "entry action", "per action", "under this action", optional=True),
        ArraySpec(HISTORY[2], _POINTS, "per feature", "the trajectory simulated", optional=True),
        ArraySpec(HISTORY[3], _POINTS, "per feature", "the one measured", optional=True),
    ),
    attributes={
        "parameters": "parameter names",
        "outputs": "list of {name, unit}",
        "recordings": "recording names",
    },
    cure_for_other_version=_CURE,
)


SHAPE = {  # of what is read of estimate.json
    "task": TEXT,
    "effects": [{"name": TEXT, "site": TEXT, "parameters": {str: {"value": NUMBER, "high": NUMBER}}}],
    "log": {"path": TEXT, "sha256": TEXT, "input_peaks?": or_none({str: NUMBER})},
    "parameters": {str: {"value": NUMBER, "low?": NUMBER, "high?": NUMBER}},
    "noise_floor": {str: NUMBER},
    "lack_of_fit": {"normalized": NUMBER, "autocorrelation_time": NUMBER},
    "in_context?": or_none({"fallback": FLAG}),
    "rollouts": {"measured": WHOLE},
    "rounds": [OBJECT],
    "split": {"how": TEXT},
    "verdict": TEXT,
    "summary?": TEXT,
}


@dataclass(frozen=True, kw_only=True)
class EstimateRecord(Record):
    """estimate.json, as reports read it."""

    identifier: str | None = None
    error: Row | None = None
    diverged_windows: int | None = None
    unmeasured_joints: Sequence[str] | None = None
    open_loops: Mapping[str, float] | None = None
    correlation: Sequence[Sequence[float]] | None = None
    recordings: Row | None = None
    rounds: Sequence[Row] | None = None
    misread: Row | None = None
    cut_short: int | None = None
    in_context: Row | None = None
    next_command: str | None = None


class Estimate(Result):
    """estimate.json and estimate.zarr."""

    NAME, SCHEMA, RECORD = "estimate", SCHEMA, EstimateRecord
    KIND = DocumentKind(FORMAT, VERSION, _CURE, SHAPE, {1: lambda document: {**document, "effects": []}})
