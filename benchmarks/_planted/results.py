"""The lines of finished cases, and the work of adding those that are missing."""

from __future__ import annotations

import os
import threading
import traceback
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, fields
from multiprocessing import active_children, get_context, parent_process
from pathlib import Path
from typing import Any

from benchmarks import ROOT, _lines
from benchmarks._code_hash import code_hash as hashed
from benchmarks._planted.cases import Case
from benchmarks._planted.diagnosing import FAILED, line

RESULTS = "results.jsonl"
ONE_THREAD = {name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")}

Row = dict[str, Any]


def add(cases: Sequence[Case], folder: Path, jobs: int) -> None:
    """Work on the cases that have no line yet, `jobs` at a time, in the order given."""
    from tqdm import tqdm

    code = code_hash()
    done = {_key(row) for row in rows(folder, code)}
    sizes = _sizes(folder)
    todo = [c for c in cases if _key(asdict(c)) not in done]
    os.environ.update(ONE_THREAD)  # before the processes start: read when numpy is loaded
    with workers(jobs) as pool:
        waiting = {pool.submit(_try, case, sizes.get(_key(asdict(case)))): case for case in todo}
        for future in tqdm(as_completed(waiting), total=len(waiting), desc="logs", unit="log"):
            row = {"code": code, **asdict(waiting[future]), **future.result()}
            _lines.append(folder / RESULTS, row)


@contextmanager
def workers(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that end with the block, and with this process, whatever ends it: a log takes minutes, and is begun
    again."""
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_end_with_parent)
    try:
        yield pool
        pool.shutdown()
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in active_children():
            process.terminate()
        raise


def _end_with_parent() -> None:
    threading.Thread(target=lambda: (parent_process().join(), os._exit(1)), daemon=True).start()


def _try(case: Case, size: float | None) -> Row:
    try:
        return line(case, size)
    except Exception as error:  # a case that fails is a result, and does not stop the others
        # a shipped file names no folder of a machine
        where = traceback.format_exc(limit=-4).replace(f"{ROOT}/", "")
        return {"outcome": FAILED, "error": repr(error), "where": where}


def rows(folder: Path, code: str | None) -> list[Row]:
    """Lines that `code` made (any code where None)."""
    return [row for row in _lines.read(folder / RESULTS) if code in (None, row["code"])]


def newest(folder: Path, versions: int = 1) -> list[Row]:
    """Of each log the newest line that the last `versions` of the code made."""
    every = rows(folder, None)
    codes = list(dict.fromkeys(row["code"] for row in reversed(every)))[:versions]
    return list({_key(row): row for row in every if row["code"] in codes}.values())


def newest_code(folder: Path) -> str:
    """The code that made the last line."""
    made = rows(folder, None)
    return made[-1]["code"] if made else code_hash()


def _sizes(folder: Path) -> dict[tuple, float]:
    """Sizes of effects found before, by whatever code: what they leave of the noise is measured again."""
    return {_key(row): row["size"] for row in rows(folder, None) if row.get("size") is not None}


def _key(row: Row) -> tuple:
    return tuple(row.get(f.name, f.default) for f in fields(Case))


def code_hash() -> str:
    """A hash of what the numbers depend on: lines of other code are not counted."""
    return hashed(["benchmarks._planted.diagnosing"], ["capture_cli/effects", "benchmarks/machines"])
