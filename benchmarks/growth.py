"""Time and memory of `capture gen-histories` as the number of histories grows to 100,000.

Each run is a process of its own, on one thread, of the cheaper task and of short histories: of ten times as many, ten
times the CPU time and the same peak memory are to be expected.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks import ROOT
from benchmarks.base import Benchmark, Figure, Result

TASK, ROUNDS = "scooping", 3
SIZES = (1_000, 10_000, 100_000)
# Of ten times the pairs. The allocator keeps a block or two that it had freed, of the size of what is simulated at
# once, and takes some shards to settle; a run that held its pairs would stand at several times this.
FLAT = 1.25

# Generates histories; prints CPU seconds, peak memory in bytes and bytes on disk.
_MEASURED = """
import json, re, sys, time
from pathlib import Path
from capture_cli.stages.gen_histories import gen_histories
task, pairs, rounds, out = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4])
gen_histories(task=task, pairs=pairs, rounds=rounds, out=out, threads=1, quiet=True)
# not ru_maxrss, which begins with the peak of the process that started this one
peak = re.search(r"VmHWM:\\s+(\\d+) kB", Path("/proc/self/status").read_text()).group(1)
size = sum(f.stat().st_size for f in out.rglob("*") if f.is_file())
print(json.dumps([time.process_time(), 1024 * int(peak), size]))
"""


class Growth(Benchmark):
    summary = (
        "time and memory of gen-histories as the number of histories grows (--pairs 100000: to that many)"
    )

    def run(self) -> Result:
        sizes = [n for n in SIZES if n <= self.pairs] or [self.pairs]
        with tempfile.TemporaryDirectory() as folder:
            runs = {n: _measured(n, Path(folder) / f"{n}.zarr") for n in sizes}
        result = Result(details={str(n): run for n, run in runs.items()})
        for n, (cpu, peak, size) in runs.items():
            result.figures += [
                Figure(f"  CPU, {n} histories of {ROUNDS} rounds, {TASK}", cpu, "s"),
                Figure(f"  peak memory, {n} histories", peak / 2**20, "MiB"),
                Figure(f"  a history on disk, of {n}", size / n, "bytes"),
            ]
        if len(sizes) > 1:
            (few, *_, many) = sizes
            memory = runs[many][1] / runs[few][1]
            time = runs[many][0] / many / (runs[few][0] / few)
            result.figures += [
                Figure(f"peak memory, {many} / {few} histories", memory, target=(None, FLAT)),
                Figure(f"CPU time of a history, of {many} / of {few}", time),
            ]
        return result


def _measured(pairs: int, out: Path) -> list[float]:
    done = subprocess.run(
        [sys.executable, "-c", _MEASURED, TASK, str(pairs), str(ROUNDS), str(out)],
        check=True,
        capture_output=True,
        text=True,
        cwd=ROOT,
    )
    return json.loads(done.stdout)
