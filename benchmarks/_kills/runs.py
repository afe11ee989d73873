"""The runs that are killed: every command once, so small that it takes seconds."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks import MACHINES
from capture_cli.context.checkpoints.training_state import STATE
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.stages.evaluation.evaluation_run import PARTS
from capture_cli.stages.search_checkpoint import STEPS
from capture_cli.store.histories import HistoriesWriter, shard_rows

SLIDER = MACHINES / "slider"
INPUTS = "../inputs"  # from the folder that a run is made in
TASK = f"{INPUTS}/machine/task.toml"
PAIRS = 300  # two shards
TINY = "--width 8 --layers 1 --batch 16"


@dataclass(frozen=True)
class Run:
    """text: what is given to `capture`, in a folder beside the inputs. outputs: names in it of what it writes; none: it
    writes to stdout.

    kept: of a command that goes on with --resume, from the folder of what is unfinished what is to be said of it; ""
    where nothing can be gone on with. replaced: of the inputs, what lies at the first output before.
    """

    text: str
    outputs: Sequence[str] = ()
    kept: Callable[[Path], str] | None = None
    replaced: str | None = None

    @property
    def arguments(self) -> list[str]:
        return self.text.split()

    @property
    def name(self) -> str:
        return self.arguments[0] + " --append" * ("--append" in self.arguments)

    def set_up(self, folder: Path) -> None:
        """Make the folder that it runs in."""
        folder.mkdir(parents=True)
        if self.replaced:
            shutil.copytree(folder / INPUTS / self.replaced, folder / self.outputs[0])


def _histories(unfinished: Path) -> str:
    writer = HistoriesWriter(str(unfinished))
    attributes = writer.attributes()
    if attributes is None:
        return ""
    size, pairs = attributes["shard_pairs"], attributes["pairs"]
    rows = [shard_rows(int(s), size, pairs) for s in np.flatnonzero(writer.is_written())]
    count = sum(r.stop - r.start for r in rows)
    return f"{count} of {pairs} histories are kept" if count else ""


def _training(unfinished: Path) -> str:
    return "what was learned up to the last evaluation is kept" if (unfinished / STATE).is_file() else ""


def _parts(unfinished: Path) -> str:
    count = sum(path.suffix != ".new" for path in (unfinished / PARTS).glob("*"))
    return f"{count} of 4 parts are kept" if count else ""


def _steps(unfinished: Path) -> str:
    return "what was worked out is kept" if any((unfinished / STEPS).glob("*.safetensors")) else ""


_RECORD = f"record --task {TASK} --rate 100 --noise 0.0005 --effect coulomb-friction@x=1"
_IMPORT = f"import-log --task {TASK}"
_LOG = f"--real-log {INPUTS}/log.zarr --task {TASK} --starts 1 --threads 1"
_HISTORIES = f"gen-histories --task scooping --pairs {PAIRS} --rounds 2 --threads 1"
RUNS = {
    run.name: run
    for run in (
        Run(f"{_RECORD} --duration 1 --out log.zarr", ["log.zarr", "log.truth.json"]),
        Run(f"draft-task {INPUTS}/machine/model.xml --out task.toml", ["task.toml"]),
        Run(f"{_IMPORT} {INPUTS}/one.csv --out log.zarr", ["log.zarr"]),
        Run(f"{_IMPORT} {INPUTS}/two.csv --out log.zarr --append", ["log.zarr"], replaced="first.zarr"),
        Run(f"identify {_LOG} --out estimate", ["estimate"]),
        Run(
            f"diagnose {_LOG} --most-effects 1 --no-expression --out diagnosis",
            ["diagnosis"],
            kept=_steps,
        ),
        Run(f"{_HISTORIES} --out histories.zarr", ["histories.zarr"], kept=_histories),
        Run(
            f"train-policy --task scooping --steps 96 --evaluations 4 {TINY} --out policy",
            ["policy"],
            kept=_training,
        ),
        Run(
            f"train-sysid --histories {INPUTS}/histories.zarr --identifier posterior --heads 2 --steps 50 {TINY} "
            "--out identifier",
            ["identifier"],
            kept=_training,
        ),
        Run(
            "eval-sim2sim --task scooping --identifier domain-randomization --identifier compass --pairs 2 --seeds 2 "
            "--rounds 2 --threads 1 --out evaluation",
            ["evaluation"],
            kept=_parts,
        ),
        Run(
            f"propose {INPUTS}/estimate --threads 1 --out proposal.json --csv proposal.csv",
            ["proposal.csv", "proposal.json"],
        ),
        Run(f"export {INPUTS}/estimate --out model.xml", ["model.xml"]),
        Run(f"inspect {INPUTS}/log.zarr --json"),
        Run("tasks --json"),
        Run("effects --json"),
    )
}


def make_inputs(folder: Path, capture: Sequence[str], names: Sequence[str]) -> None:
    """What the runs called `names` read, into `folder`/inputs: a machine, logs, an estimate, histories."""
    inputs, elsewhere = folder / "inputs", folder / "elsewhere"
    shutil.copytree(SLIDER, inputs / "machine")
    elsewhere.mkdir()

    def run(arguments: str) -> None:
        done = subprocess.run([*capture, *arguments.split()], cwd=elsewhere, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"{arguments} fails: {done.stderr}")

    run(f"{_RECORD} --duration 0.6 --episodes 3 --seed 3 --out {INPUTS}/log.zarr")
    for name, episode in (("one", 0), ("two", 1)):
        _write_csv(MeasuredLog.read(inputs / "log.zarr"), episode, inputs / f"{name}.csv")
    if "import-log --append" in names:
        run(f"{_IMPORT} {INPUTS}/one.csv --out {INPUTS}/first.zarr")
    if {"propose", "export"} & set(names):
        run(f"identify {_LOG} --out {INPUTS}/estimate")
    if "train-sysid" in names:
        run(f"{_HISTORIES} --out {INPUTS}/histories.zarr")


def _write_csv(log: MeasuredLog, episode: int, path: Path) -> None:
    """One episode of the log as a logger writes it."""
    ends = [0, *log.episode_ends]
    steps = slice(ends[episode], ends[episode + 1])
    columns = [log.time[steps], log.inputs[steps, 0], log.outputs[steps, 0]]
    rows = [f"{t!r},{u!r},{q!r},{episode}" for t, u, q in zip(*(c.tolist() for c in columns), strict=True)]
    path.write_text("\n".join(["t_s,force_N,q_m,episode", *rows, ""]))
