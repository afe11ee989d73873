"""One row for each case that was asked about, and the work of adding those that are missing."""

from __future__ import annotations

import os
import signal
import threading
import time
import traceback
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager, suppress
from itertools import islice
from multiprocessing import active_children, get_context, parent_process
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import ROOT, _lines
from benchmarks._planted.asking import ONE_THREAD, ask
from benchmarks._planted.outcomes import judge, placed, test_error
from benchmarks._planted_logs.cases import LEFT, Case, NothingToFind, cases

NOTHING_TO_FIND, FAILED = "nothing to find", "failed"

Row = dict[str, Any]
Key = tuple[Any, ...]


def key(row: Mapping[str, Any]) -> Key:
    """Of a case, whatever its dress."""
    return (row["kind"], row["machine"], tuple(row["planted"]), row["magnitude"], row["number"])


def read(path: Path) -> dict[Key, Row]:
    return {key(row): row for row in _lines.read(path)}


class Draw:
    """The first `wanted` of `stream` in which there is something to find."""

    def __init__(self, stream: Iterator[Case], wanted: int):
        self.stream, self.wanted = stream, wanted
        self.taken: list[Case] = []

    def more(self, rows: Mapping[Key, Row]) -> list[Case]:
        """Those to ask about next: as many as `rows` have too few of."""
        lacking = self.wanted - sum(rows[key(vars(c))]["outcome"] != NOTHING_TO_FIND for c in self.taken)
        new = list(islice(self.stream, lacking))
        self.taken += new
        return new


def draws(
    counts: Mapping[str, int], seed: int, dress: str, machines: Sequence[str], sample: int | None
) -> list[Draw]:
    """So many cases of each kind, or a random sample of those."""
    streams = {kind: cases(kind, seed, dress, machines) for kind in counts}
    if sample is None:
        return [Draw(streams[kind], wanted) for kind, wanted in counts.items()]
    every = [case for kind, wanted in counts.items() for case in islice(streams[kind], wanted)]
    mixed = np.random.default_rng(seed).permutation(len(every))
    return [Draw((every[i] for i in mixed), sample)]


def add(
    drawn: Sequence[Draw], path: Path, root: Path, jobs: int, frozen: Callable[[], object] = lambda: None
) -> None:
    """Ask the version in `root` about all that is drawn and has no row in `path` yet, `jobs` at a time.

    frozen: called before a row is added; raises where the code is no longer what it was.
    """
    from tqdm import tqdm

    rows = read(path)
    os.environ.update(ONE_THREAD)  # before the processes start: read when numpy is loaded
    total = sum(draw.wanted for draw in drawn)
    with workers(jobs) as pool, tqdm(total=total, desc=path.stem, unit="log") as bar:
        while batch := [case for draw in drawn for case in draw.more(rows)]:
            todo = {pool.submit(row_of, c, root): c for c in batch if key(vars(c)) not in rows}
            bar.update(sum(_counts(rows.get(key(vars(c)))) for c in batch))
            for future in as_completed(todo):
                row = future.result()
                frozen()
                rows[key(row)] = row
                _lines.append(path, row)
                bar.update(_counts(row))


def _counts(row: Row | None) -> int:
    return int(row is not None and row["outcome"] != NOTHING_TO_FIND)


def row_of(case: Case, root: Path) -> Row:
    """What came of `case`, as JSON has it."""
    row = {k: getattr(case, k) for k in ("kind", "machine", "planted", "magnitude", "number", "dress")}
    began = time.perf_counter()
    try:
        task, log, truth = case.build()
    except NothingToFind as error:
        return {**row, "outcome": NOTHING_TO_FIND, "why": str(error).splitlines()[0]}
    row |= {
        "log": f"{zlib.crc32(log.outputs.tobytes()):08x}",
        "parameters": truth.parameters,
        "effects": truth.effects,
        "error": round(truth.shown.error, 4),
        "shift": round(max(map(abs, truth.shown.shift)), 2),
        "seconds_to_build": round(time.perf_counter() - began, 3),
    }
    hidden = [p.partition("@")[0] for p in case.planted if case.kind == LEFT]
    try:
        answer = ask(task, log, root, seed=case.number, hidden=hidden)
        return {
            **row,
            "outcome": judge(case, answer.document),
            "verdict": answer.document["verdict"],
            "found": [_found(e) for e in answer.document["effects"]],
            "after": test_error(answer.document),
            "seconds": answer.seconds,
            "cpu_seconds": answer.cpu_seconds,
        }
    except Exception as error:  # a case that fails is a result, and does not stop the others
        # a shipped file names no folder of a machine
        where = traceback.format_exc(limit=-4).replace(f"{ROOT}/", "").replace(f"{root}/", "")
        return {**row, "outcome": FAILED, "why": str(error), "where": where}


def _found(effect: Mapping[str, Any]) -> Row:
    return {
        "effect": placed(effect),
        "tied_with": effect["tied_with"],
        "values": {name: p["value"] for name, p in effect["parameters"].items()},
    }


@contextmanager
def workers(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that end with the block, and with this process, whatever ends it, and what they started with them: a
    log may take minutes, and is begun again.
    """
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_end_with_parent)
    try:
        yield pool
        pool.shutdown()
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in active_children():
            _kill_group(process.pid)
        raise


def _end_with_parent() -> None:
    os.setsid()
    threading.Thread(target=lambda: (parent_process().join(), _kill_group(0)), daemon=True).start()


def _kill_group(leader: int) -> None:
    with suppress(ProcessLookupError):  # it has not begun, or has ended
        os.killpg(leader, signal.SIGKILL)
