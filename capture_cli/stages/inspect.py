"""`capture inspect`: what a store or a result directory is, and its health."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from capture_cli.common.documents import SETTINGS as DOCUMENTS
from capture_cli.common.documents import read_json
from capture_cli.errors import CaptureError, StoreError
from capture_cli.log.checks.base import Finding, finding, note, warning
from capture_cli.log.checks.equal_episodes import equal_episodes
from capture_cli.log.checks.even_times import jitter
from capture_cli.log.checks.held_outputs import rows_per_sample, sample_rate, slices_within
from capture_cli.log.checks.log_findings import log_findings, task_findings
from capture_cli.log.checks.log_health import channel, excitation, quantisation, sampling, spikes, timing
from capture_cli.log.checks.parameter_bounds import doubtful_bounds
from capture_cli.log.measured_log import SCHEMA as LOG_SCHEMA
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.windows import usual_interval
from capture_cli.model.tasks import load_task
from capture_cli.model.tasks.base import Task
from capture_cli.stages.inspection.result_inspection import OF_PROVENANCE, RESULTS, inspect_result
from capture_cli.stages.inspection.single_file import inspect_proposal, read_header
from capture_cli.stages.inspection.unfinished_inspection import inspect_unfinished, is_unfinished
from capture_cli.stages.recorded.recorded_task import find_task
from capture_cli.store.diagnosis import Diagnosis
from capture_cli.store.document_shape import OBJECT, check_shape
from capture_cli.store.estimate import Estimate
from capture_cli.store.evaluation import Evaluation
from capture_cli.store.histories import SCHEMA as HISTORIES_SCHEMA
from capture_cli.store.histories import Histories
from capture_cli.store.inspection import Inspection
from capture_cli.store.output import PROVENANCE, unfinished
from capture_cli.store.proposal import FORMAT as PROPOSAL
from capture_cli.store.zarr_store import ZarrStore

NOTHING_TO_DO = "nothing to do"


ROOTS = ("zarr.json", ".zgroup", ".zattrs")  # of Zarr, version 3 and 2
MAKE_STORES = ("import-log", "record", "gen-histories")
ARRAYS = {kind.SCHEMA.format: kind.SCHEMA for kind in (Estimate, Diagnosis, Evaluation)}


def inspect(path: Path, task: str | None = None, max_log_size: int | None = None) -> Inspection:
    """What is at `path`.

    Its kind is "measured-log", one of RESULTS, "proposal", "unfinished", "zarr", "directory" or "file". A measured log
    is checked against `task`, or against its own where that is built in or lies beside it. Damage is a finding rather
    than an exception. A JSON file of a directory stands for the directory, and an output that is not there yet for what
    an unfinished run keeps of it.

    max_log_size: bytes of a log in memory, see `ZarrStore.read`. Raises StoreError where there is nothing that can be
    recognised, TaskError or ModelError for a bad task.
    """
    path = Path(path)
    if not path.exists() and is_unfinished(unfinished(path)):
        path = unfinished(path)  # of an output that is not there yet
    machine = load_task(task) if task is not None else None
    written = read_header(path) if path.is_file() else None
    proposed = written is not None and written["format"] == PROPOSAL
    if written is not None and not proposed and (path.parent / PROVENANCE).is_file():
        path, written = path.parent, None  # estimate.json stands for the estimate
    kind = "proposal" if proposed else "file" if written is not None else _kind(path)
    seen = Inspection(
        path=str(path),
        kind=kind,
        store={"format": None, "version": None, "bytes": _bytes(path)},
        provenance=None,
        sizes={},
        checked=kind not in ("file", "directory"),
        findings=[],
    )
    try:
        if kind == "measured-log":
            _inspect_log(path, seen, machine, max_log_size)
        elif kind in RESULTS:
            inspect_result(path, seen)
        elif kind == "unfinished":
            inspect_unfinished(path, seen)
        elif kind == "proposal":
            seen.header(written)
            inspect_proposal(path, seen, written)
        elif kind == "zarr":
            _inspect_zarr(path, seen)
        elif kind == "file":
            seen.header(written)
            seen.task = written.get("task")
    except StoreError as error:
        seen.findings.append(finding("error", "store", error.message, error.cure))
    _inspect_provenance(path, seen)
    return seen


def _kind(path: Path) -> str:
    if not path.is_dir():
        ZarrStore(path)  # says what is there instead, and what reads it
    if is_unfinished(path):
        return "unfinished"
    for kind, folder in RESULTS.items():
        if (path / folder.document).is_file():
            return kind
    if _has_root(path):
        try:
            found = ZarrStore(path).attributes.get("format")
        except StoreError:
            return "zarr"
        return "measured-log" if found == LOG_SCHEMA.format else "zarr"
    if path.suffix == ".zarr" or _made_by(path) in MAKE_STORES:
        return "zarr"  # that has lost its root
    if (path / PROVENANCE).is_file():
        return "directory"
    raise StoreError(
        f"{path} is a folder without a Zarr store, {', '.join(f.document for f in RESULTS.values())} or {PROVENANCE}",
        cure="give a path that a `capture` command wrote as its --out",
    )


def _has_root(path: Path) -> bool:
    return any((path / name).is_file() for name in ROOTS)


def _made_by(path: Path) -> str | None:
    """The command that provenance.json in the folder `path` names; None where it cannot be read."""
    with suppress(StoreError):
        found = read_json(path / PROVENANCE, StoreError, cure="")
        return found.get("command") if isinstance(found, dict) else None
    return None


def _bytes(path: Path) -> int:
    files = [path] if path.is_file() else path.rglob("*")
    return sum(f.stat().st_size for f in files if f.is_file())


# --- measured log ---


def _inspect_log(path: Path, seen: Inspection, machine: Task | None, max_log_size: int | None) -> None:
    seen.header(ZarrStore(path).attributes)
    log = _without_huge(MeasuredLog.read_unchecked(path, max_log_size))
    seen.task = log.task
    seen.sizes = {
        "recordings": len(log.recordings),
        "episodes": len(log.episode_ends),
        "steps": len(log.time),
        "inputs": len(log.input_names),
        "outputs": len(log.output_names),
    }
    findings = seen.findings
    if not len(log.time) or not log.episodes_cover_steps:
        what = f"episode_ends do not divide its {len(log.time)} steps" if len(log.time) else "it is empty"
        findings.append(finding("error", "store", what, LOG_SCHEMA.cure_for_other_version))
        seen.recordings, seen.episodes, seen.channels = list(log.recordings), [], []
        seen.time_scatter = None
        return
    machine = machine or _own_task(log)
    episodes = _episodes(log)
    recordings = [_recording(log, number, episodes) for number in range(len(log.recordings))]
    seen.episodes, seen.recordings = episodes, recordings
    seen.channels = _channels(log, _smooth_ends(machine))
    uneven = jitter(log)
    seen.time_scatter = None if uneven is None else asdict(uneven)
    findings += [*_not_finite(log.time), *_import_findings(recordings), *_repeated(log)]
    findings += log_findings(seen, machine)
    if machine is not None:
        findings += [*task_findings(log, seen, machine), *doubtful_bounds(machine)]


def _without_huge(log: MeasuredLog) -> MeasuredLog:
    """The log with infinity for what is too large to be measured: its squares would overflow."""
    inputs, outputs = (
        np.where(np.abs(v) > DOCUMENTS.largest, np.copysign(np.inf, v), v) for v in (log.inputs, log.outputs)
    )
    return replace(log, inputs=inputs, outputs=outputs)


def _episodes(log: MeasuredLog) -> list[dict[str, Any]]:
    """The number of each episode, the recording that it is of, and the timing of its steps."""
    return [
        {"episode": i, "recording": log.recording_names[int(log.recording[i])], **found}
        for i, found in enumerate(_timing(log))
    ]


def _timing(log: MeasuredLog) -> list[dict[str, Any]]:
    """The timing of each episode; by the interval of the fastest sensor where every output is sparse."""
    if not log.is_sparse.all() or not np.isfinite(log.time).all():
        return [timing(log.time[e]) for e in log.episodes]
    sampled = log.sampled
    return [timing(log.time[e], usual_interval(log.time[e], sampled[e])) for e in log.episodes]


def _own_task(log: MeasuredLog) -> Task | None:
    """The task that `identify` would take without --task; None where there is none, or it cannot be read."""
    try:
        return find_task(None, log)
    except CaptureError:
        return None


def _recording(log: MeasuredLog, number: int, episodes: list[dict[str, Any]]) -> dict[str, Any]:
    own = [e for e, r in zip(episodes, log.recording, strict=True) if r == number]
    rates = [e["rate"] for e in own if e["rate"] is not None]
    return {
        **log.recordings[number],
        "episodes": len(own),
        "steps": sum(e["steps"] for e in own),
        "duration": sum(e["duration"] or 0.0 for e in own),
        "rate": float(np.median(rates)) if rates else None,
    }


def _not_finite(time: np.ndarray) -> Iterator[Finding]:
    """The finding that not all times (step,) are numbers; none where they are."""
    if count := int((~np.isfinite(time)).sum()):
        what, cure = f"{count} times are NaN or infinite", "import the files again with --drop-nan"
        yield finding("error", "time", what, cure)


def _import_findings(recordings: Sequence[Mapping[str, Any]]) -> list[Finding]:
    """What the import of these recordings saw, dropped or emptied."""
    return [
        *(_cut_off(r) for r in recordings if r.get("cut_off") is not None),
        *(_dropped(r) for r in recordings if r.get("dropped_rows")),
        *_noted(recordings, "comment_lines", "lines of comments before the header were passed over"),
        *_noted(recordings, "repeated_rows", "repeated rows were dropped on import"),
        *_noted(recordings, "held_repeats", "repeats of samples that are held were emptied on import"),
        *_evened({r["name"]: r["evened_times"] for r in recordings if r.get("evened_times")}),
    ]


def _evened(off: Mapping[str, float]) -> list[Finding]:
    """One note of all recordings whose stamps were `off` by so many s."""
    if not off:
        return []
    where = next(iter(off)) if len(off) == 1 else f"{len(off)} recordings"
    most = f"{'' if len(off) == 1 else 'at most '}{1e3 * max(off.values()):.3g} ms"
    what = f"samples were put at even times on import: stamps were off by {most}"
    return [note(where, what, NOTHING_TO_DO)]


def _noted(recordings: Sequence[Mapping[str, Any]], key: str, what: str) -> list[Finding]:
    """A note of how many rows the import counted under `key`, on each recording where it did."""
    return [note(r["name"], f"{r[key]} {what}", NOTHING_TO_DO) for r in recordings if r.get(key)]


def _repeated(log: MeasuredLog) -> Iterator[Finding]:
    """The finding that episodes hold the same as earlier ones; none where they do not."""
    if pairs := equal_episodes(log):
        earlier, later = pairs[0]
        names = [log.recording_names[int(log.recording[number])] for number in (later, earlier)]
        more = f", and {len(pairs) - 1} more do likewise" if len(pairs) > 1 else ""
        what = f"holds the same as episode {earlier} ({names[1]}){more}"
        cure = "import again and give each recording once: what is held out may be what was fitted, and no test of it"
        yield warning(f"{names[0]}, episode {later}", what, cure)


def _cut_off(recording: Mapping[str, Any]) -> Finding:
    """The finding that the recording's file seems to end in mid-number."""
    return warning(
        recording["name"],
        f"{recording['source']} ends in {recording['cut_off']!r}, without a line break and with fewer decimals than "
        "the values above it: was it cut off in mid-number?",
        "remove its last line and import again; if that is whole, end it with a line break",
    )


def _dropped(recording: Mapping[str, Any]) -> Finding:
    """The finding that rows were dropped: between those that are left, inputs are taken as held, or as straight."""
    name, dropped, steps = (recording[key] for key in ("name", "dropped_rows", "steps"))
    many_dropped = 0.1  # of a recording's rows
    if dropped < many_dropped * (dropped + steps):
        return note(name, f"{dropped} incomplete rows were dropped on import", NOTHING_TO_DO)
    return warning(
        name,
        f"{dropped} of {dropped + steps} rows were incomplete and dropped on import, with what drove the machine "
        "in them",
        "if a sensor that is slower than the others leaves them incomplete, write sparse = true under its output in "
        "the task.toml and import again; changes of the inputs that are lost look like a delay",
    )


def _smooth_ends(machine: Task | None) -> dict[str, tuple[str, ...]]:
    """At which ends of an episode each output goes on from one sample to the next: a velocity jumps where a machine
    is switched on, accelerations and forces may anywhere.
    """
    if machine is None:
        return {}
    ends = {int(mujoco.mjtStage.mjSTAGE_POS): ("first", "last"), int(mujoco.mjtStage.mjSTAGE_VEL): ("last",)}
    stages = machine.model.sensor_needstage
    return {c.name: ends.get(int(stages[c.sensor]), ()) for c in machine.outputs}


def _channels(log: MeasuredLog, smooth: Mapping[str, Collection[str]]) -> list[dict[str, Any]]:
    """Each channel's values. smooth: at which ends of an episode outputs are known to go on, by name."""
    channels = []
    for name, unit, values in zip(log.input_names, log.input_units, log.inputs.T, strict=True):
        described = {"name": name, "kind": "input", "unit": unit, **channel(values, log.episodes)}
        channels.append({**described, "excitation": excitation(values, log.time, log.episodes)})
    sampled = log.sampled
    for k, (name, unit) in enumerate(zip(log.output_names, log.output_units, strict=True)):
        values, time, episodes = log.outputs[:, k], log.time, log.episodes
        described = {"name": name, "kind": "output", "unit": unit}
        steps = np.flatnonzero(sampled[:, k])
        if log.is_sparse[k]:
            values, time, episodes = values[steps], time[steps], slices_within(steps, episodes)
            described["sampling"] = sampling(time, episodes)
        described |= channel(values, episodes)
        rows = rows_per_sample(values, episodes)
        own = {
            "quantisation": quantisation(values),
            "spikes": spikes(values, time, episodes, smooth.get(name, ())),
            "held": None if rows is None else {"rows": rows, "rate": sample_rate(time, episodes, rows)},
        }
        for places in (described["bad_steps"], own["spikes"]["first"]):
            places[:] = steps[places].tolist()  # of the log
        channels.append({**described, **own})
    return channels


# --- other stores ---


def _inspect_zarr(path: Path, seen: Inspection) -> None:
    if not _has_root(path):
        command = _made_by(path)
        raise StoreError(
            f"{path} has no zarr.json, which every Zarr store has at its root: no command can read it",
            cure="take zarr.json from a copy that is whole, or make the store again"
            + (f" with `capture {command}`" if command in MAKE_STORES else ""),
        )
    store = ZarrStore(path)
    seen.header(store.attributes)
    arrays = {name: store.metadata(name) for name in store.names()}
    seen.arrays = [
        {"path": name, "shape": list(a.shape), "dtype": a.kind, "unit": a.attributes.get("unit")}
        for name, a in sorted(arrays.items())
    ]
    seen.sizes = {"arrays": len(arrays)}
    found = seen.store["format"]
    schema = ARRAYS.get(found) if isinstance(found, str) else None
    seen.checked = found == HISTORIES_SCHEMA.format or schema is not None
    if found == HISTORIES_SCHEMA.format:
        _inspect_histories(path, seen)
    elif schema is not None:
        schema.read(path)
    if not str(found).startswith("capture/"):
        cure = "convert its columns to CSV or Parquet, then `capture import-log`"
        seen.findings.append(note("store", "this store was not written by `capture`", cure))


def _inspect_histories(path: Path, seen: Inspection) -> None:
    histories = Histories(path)
    seen.sizes |= {"pairs": len(histories), "rounds": histories.attributes["rounds"]}
    checked_at_once = 4096  # histories
    for first in range(0, len(histories), checked_at_once):
        histories.read(first, first + checked_at_once)  # raises where a shard is missing or damaged


def _inspect_provenance(path: Path, seen: Inspection) -> None:
    file = path / PROVENANCE
    if not file.is_file():
        return
    lost = "nothing depends on it: how it was made is lost"
    cure = OF_PROVENANCE if seen.kind in RESULTS else lost
    try:
        found = read_json(file, StoreError, cure=cure)
        check_shape(found, OBJECT, file, cure)
        seen.provenance = {k: found.get(k) for k in ("command", "capture", "began", "seconds", "inputs")}
    except StoreError as error:
        seen.findings.append(warning(PROVENANCE, error.message, error.cure))
    if seen.kind == "directory" and seen.provenance:
        seen.sizes = {"files": sum(1 for f in path.rglob("*") if f.is_file())}
