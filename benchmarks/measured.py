"""Measured logs of real machines through whole processes: what is found, the error on data never fitted, the time.

The logs are in $CAPTURE_REAL_DATA or ../shared/data, each with a README that says where it is from.
"""

from __future__ import annotations

import math
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks import REAL_DATA, ROOT
from benchmarks._planted.asking import answered
from benchmarks._planted.outcomes import placed
from benchmarks.base import Benchmark, Figure, Result
from capture_cli.errors import OptionError
from capture_cli.stages.import_log import import_log

EXAMPLES = ROOT / "docs" / "examples"


@dataclass(frozen=True)
class Measured:
    """Files of a folder of the real logs, and how they are asked about. task: a file there, or one of the examples.

    effects: what is missing, as far as that is known. error, output: which error of which output is looked at on the
    held-out part; scale: to `unit`. limits: of that error, and of the seconds that the process takes. test: recordings
    that are held out; the last windows where None. options: of `diagnose`, besides.
    """

    name: str
    folder: str
    files: Sequence[str]
    task: str
    test: str | None
    effects: frozenset[str]
    error: str
    output: str
    unit: str
    scale: float
    limits: tuple[float | None, float]
    options: Sequence[str] = ()


SO101 = ("friction_gravity_20_50", "multisine_20_50", "step_response_20_50", "prbs_excitation_20_50")
SO101_TEST = ("backlash_detection", "trapezoidal_profile", "inertia_coupling")
MACHINES = (
    Measured(
        "EMPS",
        "emps",
        ["*.csv"],
        "emps/mass_and_damping.toml",
        "emps_test*",
        frozenset({"coulomb-friction@x", "direction-dependent-viscous@x"}),
        "rmse",
        "q",
        "mm",
        1e3,
        (0.52, 8.0),
    ),
    Measured(
        "XL330",
        "bam_xl330",
        ["*_sin_sin.csv", "*_sin_time_square.csv", "*_up_and_down.csv"],
        "xl330/task.toml",
        "*kp400*",
        frozenset({"load-dependent-friction@q"}),
        "mae",
        "q",
        "rad",
        1.0,
        (0.0098, 60.0),
    ),
    Measured(
        "SO-101",
        "so101",
        [f"{name}.csv" for name in (*SO101, *SO101_TEST)],
        "task_arm.toml",
        ",".join(SO101_TEST),
        frozenset(),
        "rmse",
        "elbow_flex_pos",
        "deg",
        math.degrees(1),
        (0.4, 180.0),
    ),
    Measured(
        "Go2",
        "go2",
        ["log.csv"],
        "task.toml",
        None,
        frozenset(),
        "rmse",
        "FL_hip",
        "deg",
        math.degrees(1),
        (None, 300.0),
        ("--time-limit", "280"),
    ),
)


class RealMachines(Benchmark):
    summary = "measured logs of real machines: what diagnose finds, the error on data never fitted, the time"

    def run(self) -> Result:
        if not REAL_DATA.is_dir():
            raise OptionError(
                f"no real logs at {REAL_DATA}", cure="set CAPTURE_REAL_DATA to the folder that holds them"
            )
        result = Result()
        for machine in MACHINES:
            self._add(machine, REAL_DATA.resolve() / machine.folder, result)
        return result

    def _add(self, machine: Measured, data: Path, result: Result) -> None:
        task = data / machine.task if (data / machine.task).is_file() else EXAMPLES / machine.task
        with tempfile.TemporaryDirectory() as folder:
            files = sorted(f for pattern in machine.files for f in data.glob(pattern))
            import_log(files=files, task=str(task), out=Path(folder) / "log.zarr")
            command = [
                sys.executable,
                "-m",
                "capture_cli",
                "diagnose",
                "--real-log",
                "log.zarr",
                "--out",
                "out",
            ]
            test = () if machine.test is None else ("--test", machine.test)
            answer = answered([*command, "--task", str(task), *test, *machine.options], Path(folder))
        found = [placed(e) for e in answer.document["effects"]]
        before, after = (
            answer.document[stage]["test"][machine.error][machine.output] * machine.scale
            for stage in ("before", "after")
        )
        result.details[machine.name] = {"found": found, "verdict": answer.document["verdict"]}
        limit, longest = machine.limits
        known, others = machine.effects & set(found), set(found) - machine.effects
        if machine.effects:
            result.figures.append(
                Figure(
                    f"{machine.name}: named of what is missing",
                    len(known),
                    target=(len(machine.effects), None),
                )
            )
        result.figures += [
            Figure(f"{machine.name}: others named", len(others)),
            Figure(f"  {machine.error} of {machine.output}, held out, declared", before, machine.unit),
            Figure("  with what was found", after, machine.unit, None if limit is None else (None, limit)),
            Figure("  whole process", answer.seconds, "s", target=(None, longest)),
            Figure("  CPU", answer.cpu_seconds, "s"),
        ]
