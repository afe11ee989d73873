"""Inputs as they should be, one of each kind: what cases are made of."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from fuzz.forked_run import run

ROOT = Path(__file__).resolve().parents[2]
MACHINE = ROOT / "benchmarks" / "machines" / "slider"
PATIENCE = 300.0  # s
_RECORD = "record --rate 100 --noise 0.0005 --threads 1"
_LOG = "--real-log log.zarr --starts 1 --threads 1 --quiet"


def make_inputs(folder: Path) -> Path:
    """Make them in `folder`: a machine, logs of it, what `capture` found in one, checkpoints. Returns `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copytree(MACHINE, folder / "machine")
    shutil.copytree(ROOT / "runs" / "policies" / "scooping", folder / "policy")
    shutil.copytree(ROOT / "capture_cli" / "checkpoints" / "scooping", folder / "identifier")
    _capture(
        folder,
        f"{_RECORD} --task machine/task.toml --duration 0.6 --episodes 3 --seed 3 --out log.zarr "
        "--effect coulomb-friction@x=1",
    )
    _capture(folder, f"identify {_LOG} --task machine/task.toml --out estimate", _without_pages)
    _capture(folder, f"diagnose {_LOG} --estimate estimate --most-effects 1 --out diagnosis", _friction_alone)
    _capture(folder, "propose estimate --threads 1 --candidates 2 --out proposal.json")
    _capture(folder, f"{_RECORD} --task scooping --episodes 3 --seed 1 --out scoops.zarr")
    _capture(folder, "gen-histories --task scooping --pairs 4 --rounds 2 --threads 1 --out histories.zarr")
    _write_formula(folder)
    _write_old_store(folder)
    _write_tables(folder)
    return folder


def _capture(folder: Path, arguments: str, enter: Callable[[], None] | None = None) -> None:
    with tempfile.TemporaryDirectory() as temporary:
        ended = run(arguments.split(), folder, Path(temporary), enter=enter, seconds=PATIENCE)
    if ended.code:
        raise RuntimeError(f"{arguments} ends with {ended.code}: {ended.stderr}")


def _without_pages() -> None:
    """What a picture shows is not read again."""
    from capture_cli.stages import diagnose, identify

    for stage in (diagnose, identify):
        stage._write_pages = lambda *_: None


def _friction_alone() -> None:
    """To look for one effect takes a tenth of the time."""
    from capture_cli.select.search import attribution

    _without_pages()
    everything = attribution.all_candidates
    attribution.all_candidates = lambda *given: [
        c for c in everything(*given) if c.name == "coulomb-friction@x"
    ]


def _write_formula(folder: Path) -> None:
    """A diagnosis that has a formula."""
    shutil.copytree(folder / "diagnosis", folder / "formula")
    path = folder / "formula" / "diagnosis.json"
    document = json.loads(path.read_text())
    values = {name: p["value"] for name, p in document["parameters"].items()}
    for effect in document["effects"]:
        name = f"{effect['name']}@{effect['site']}"
        values |= {f"{name}.{n}": p["value"] for n, p in effect["parameters"].items()}
    term = {"site": "x: q^3", "coefficient": -30.0, "sd": 0.1, "unit": "SI"}
    document["expression"] = {
        "text": "-30 q^3",
        "terms": [term],
        "values": values,
        "select": None,
        "test": None,
    }
    path.write_text(json.dumps(document))


def _write_old_store(folder: Path) -> None:
    """The log as a store of version 2: what is in its chunks is the same, and they are named otherwise."""
    new, old = folder / "log.zarr", folder / "old.zarr"
    _write_json(old / ".zgroup", {"zarr_format": 2})
    _write_json(old / ".zattrs", json.loads((new / "zarr.json").read_text())["attributes"])
    for path in sorted(new.rglob("zarr.json")):
        metadata = json.loads(path.read_text())
        if metadata["node_type"] != "array":
            continue
        array = old / path.parent.relative_to(new)
        _write_json(array / ".zarray", _version_2(metadata))
        for chunk in sorted(p for p in (path.parent / "c").rglob("*") if p.is_file()):
            name = ".".join(chunk.relative_to(path.parent / "c").parts)
            shutil.copyfile(chunk, array / name)


def _version_2(metadata: dict) -> dict:
    _, packing = metadata["codecs"]
    return {
        "zarr_format": 2,
        "shape": metadata["shape"],
        "chunks": metadata["chunk_grid"]["configuration"]["chunk_shape"],
        "dtype": np.dtype(metadata["data_type"]).str,
        "compressor": {"id": packing["name"], **packing["configuration"]},
        "filters": None,
        "fill_value": 0,
        "order": "C",
    }


def _write_json(path: Path, document: dict) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document, indent=2))


def _write_tables(folder: Path) -> None:
    """An experiment as loggers write it: a CSV, and the same as Parquet."""
    import pyarrow as pa
    from pyarrow import parquet

    time = np.round(np.arange(64) * 0.01, 6)
    columns = {
        "t_s": time,
        "force_N": np.round(10 * np.sin(20 * time), 6),
        "q_m": np.round(0.1 * np.sin(7 * time + 1), 6),
        "episode": np.zeros(len(time), dtype=int),
    }
    rows = zip(*(c.tolist() for c in columns.values()), strict=True)
    (folder / "run.csv").write_text(
        "\n".join([",".join(columns), *(",".join(map(str, r)) for r in rows), ""])
    )
    parquet.write_table(pa.table(columns), folder / "run.parquet")
