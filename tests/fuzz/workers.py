"""Workers begun in processes of their own, and what they tell, as it comes."""

from __future__ import annotations

import json
import os
import selectors
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def rows(options: Sequence[str], count: int = 1) -> Iterator[dict]:
    """What `count` workers tell of each input, given these `options` and a share each.

    Raises RuntimeError where one fails.
    """
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")]),
        **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    }
    command = [sys.executable, "-W", "ignore", "-m", "fuzz.worker", *options]
    workers = [
        subprocess.Popen(
            [*command, "--share", str(n), str(count)], stdout=subprocess.PIPE, env=environment, cwd=ROOT
        )
        for n in range(count)
    ]
    try:
        yield from _lines(workers)
    finally:
        for worker in workers:
            worker.terminate()
            worker.wait()
            worker.stdout.close()


def _lines(workers: Sequence[subprocess.Popen]) -> Iterator[dict]:
    with selectors.DefaultSelector() as selector:
        for worker in workers:
            selector.register(worker.stdout, selectors.EVENT_READ, worker)
        while selector.get_map():
            for key, _ in selector.select():
                if line := key.fileobj.readline():
                    yield json.loads(line)
                    continue
                selector.unregister(key.fileobj)
                if code := key.data.wait():
                    raise RuntimeError(f"a worker ends with {code}")
