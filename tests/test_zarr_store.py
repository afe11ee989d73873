"""Stores of any writer: nothing is unpacked that could run, or that takes more than it says or is allowed."""

from __future__ import annotations

import json
import os
import pickle
import time
import tomllib
from pathlib import Path

import numcodecs
import numpy as np
import pytest
import zarr
from packaging.requirements import Requirement

from capture_cli.errors import OptionError, StoreError
from capture_cli.log.measured_log import SCHEMA, MeasuredLog
from capture_cli.options.texts import byte_count
from capture_cli.store.array_metadata import array_metadata
from capture_cli.store.zarr_store import SETTINGS as ZARR_STORE
from capture_cli.store.zarr_store import ZarrStore

STEPS = 40


def a_log(**changes) -> MeasuredLog:
    noise = np.random.default_rng(0)
    log = {
        "task": "slider",
        "time": 0.01 * np.arange(STEPS),
        "inputs": noise.standard_normal((STEPS, 1)),
        "outputs": noise.standard_normal((STEPS, 1)),
        "episode_ends": np.array([STEPS]),
        "recording": np.array([0]),
        "input_names": ("drive",),
        "input_units": ("N",),
        "output_names": ("q",),
        "output_units": ("m",),
        "recordings": ({"name": "run", "source": "run.csv", "sha256": ""},),
    }
    return MeasuredLog(**{**log, **changes})


@pytest.fixture
def stored(tmp_path) -> Path:
    a_log().write(tmp_path / "log.zarr")
    return tmp_path / "log.zarr"


@pytest.fixture
def old(tmp_path) -> Path:
    """The same as a store of version 2."""
    a_log().write(tmp_path / "new.zarr")
    new = zarr.open_group(str(tmp_path / "new.zarr"), mode="r")
    group = zarr.open_group(str(tmp_path / "old.zarr"), mode="w", zarr_format=2)
    group.attrs.update(dict(new.attrs))
    with zarr.config.set({"array.write_empty_chunks": True}):
        for name in ("data/time", "data/inputs", "data/outputs", "meta/episode_ends", "meta/recording"):
            group.create_array(name, data=new[name][...])
    return tmp_path / "old.zarr"


def edit(path: Path, **changes) -> None:
    """Change keys of a JSON file."""
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def refusal(path: Path, **options) -> str:
    began = time.monotonic()
    with pytest.raises(StoreError) as caught:
        MeasuredLog.read(path, **options)
    assert time.monotonic() - began < 5
    return str(caught.value)


# --- what could run ---


class Payload:
    def __init__(self, path: Path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


@pytest.mark.parametrize("where", ["compressor", "filters"])
def test_no_pickle_is_opened_whatever_numcodecs_allows(old, tmp_path, monkeypatch, where):
    monkeypatch.setattr(numcodecs.pickles, "ALLOW_UNSAFE_PICKLE_DECODE", True, raising=False)
    codec = {"id": "pickle"}
    edit(
        old / "data" / "time" / ".zarray",
        compressor=codec if where == "compressor" else None,
        filters=[codec] if where == "filters" else None,
    )
    (old / "data" / "time" / "0").write_bytes(pickle.dumps(Payload(tmp_path / "it-ran")))
    said = refusal(old)
    assert "data/time is packed by 'pickle', which is not unpacked" in said
    assert "ALLOW" not in said
    assert not (tmp_path / "it-ran").exists()


def test_no_numcodecs_is_installed_that_unpickles():
    project = tomllib.loads((Path(__file__).resolve().parents[1] / "pyproject.toml").read_text())
    (bound,) = [d for d in project["project"]["dependencies"] if d.startswith("numcodecs")]
    versions = Requirement(bound).specifier
    assert not [v for v in ("0.14.0", "0.15.1", "0.16.5", "0.17.0") if v in versions]
    assert numcodecs.__version__ in versions


@pytest.mark.parametrize("dtype", ["|O", "<U8", "<M8[ns]", "<c16", [["a", "<f8"]]])
def test_only_numbers_are_read(old, tmp_path, monkeypatch, dtype):
    monkeypatch.setattr(numcodecs.pickles, "ALLOW_UNSAFE_PICKLE_DECODE", True, raising=False)
    edit(old / "data" / "time" / ".zarray", dtype=dtype, filters=[{"id": "pickle"}], fill_value=None)
    (old / "data" / "time" / "0").write_bytes(pickle.dumps(Payload(tmp_path / "it-ran")))
    said = refusal(old)
    assert "only numbers are read" in said or "is packed by 'pickle'" in said
    assert not (tmp_path / "it-ran").exists()


def test_codecs_of_version_3_are_those_known(stored):
    path = stored / "data" / "time" / "zarr.json"
    codecs = json.loads(path.read_text())["codecs"]
    edit(path, codecs=[*codecs, {"name": "numcodecs.pickle"}])
    assert "packed by 'numcodecs.pickle'" in refusal(stored)
    sharded = {"chunk_shape": [1], "codecs": [{"name": "numcodecs.pickle"}]}
    edit(path, codecs=[{"name": "sharding_indexed", "configuration": sharded}])
    assert "packed by 'numcodecs.pickle'" in refusal(stored)
    edit(path, codecs=codecs, data_type={"name": "null_terminated_bytes"})
    assert "only numbers are read" in refusal(stored)


def test_a_foreign_store_is_described_without_its_codecs_being_made(capture, old):
    edit(old / "data" / "time" / ".zarray", dtype="|O", compressor={"id": "pickle"})
    (old / ".zattrs").write_text("{}")
    code, out, _ = capture("inspect", old, "--json")
    assert code == 0
    shown = {a["path"]: a["dtype"] for a in json.loads(out)["arrays"]}
    assert shown["data/time"] == "|O" and shown["data/outputs"] == "float64"


def test_a_store_of_version_2_is_read_as_before(old):
    assert np.array_equal(MeasuredLog.read(old).outputs, a_log().outputs)


# --- what takes more than it says ---


def bomb(path: Path, chunks: int, numbers: int) -> None:
    """Make the outputs of a log `chunks` files of as many zeros, a few bytes each."""
    array = path / "data" / "outputs"
    for file in (array / "c").rglob("*"):
        if file.is_file():
            file.unlink()
    packed = bytes(numcodecs.Zstd().encode(np.zeros(numbers)))
    for k in range(chunks):
        (array / "c" / str(k)).mkdir(exist_ok=True)
        (array / "c" / str(k) / "0").write_bytes(packed)
    grid = {"name": "regular", "configuration": {"chunk_shape": [numbers, 1]}}
    codecs = [{"name": "bytes", "configuration": {"endian": "little"}}, {"name": "zstd", "configuration": {}}]
    edit(array / "zarr.json", shape=[chunks * numbers, 1], chunk_grid=grid, codecs=codecs)


def test_ten_million_chunks_are_refused_before_they_are_looked_for(stored):
    path = stored / "data" / "time" / "zarr.json"
    edit(path, shape=[10**7], chunk_grid={"name": "regular", "configuration": {"chunk_shape": [1]}})
    said = refusal(stored)
    assert "axis 'step' has 10000000 entries in data/time and 40" in said
    for name in ("inputs", "outputs"):
        edit(stored / "data" / name / "zarr.json", shape=[10**7, 1])
    assert "data/time is in 10000000 chunks, and 100000 are the most" in refusal(stored)
    edit(path, shape=[10**5])
    for name in ("inputs", "outputs"):
        edit(stored / "data" / name / "zarr.json", shape=[10**5, 1])
    assert "data/time has 1 of its 100000 chunks: it is truncated" in refusal(stored)


def test_gigabytes_of_zeros_are_refused_before_they_are_unpacked(stored):
    bomb(stored, chunks=200, numbers=10**6)  # 1.6 GB, in 20 kB
    assert "axis 'step' has 40 entries in data/time and 200000000 in data/outputs" in refusal(stored)
    metadata = {"data/outputs": ZarrStore(stored).metadata("data/outputs")}
    with pytest.raises(
        StoreError, match=r"takes 1.6 GB in memory, .* kB on disk; the most that is read is 100 MB"
    ):
        ZarrStore(stored).read(metadata)


def test_a_limit_is_an_option_and_the_message_says_it(capture, stored):
    assert len(MeasuredLog.read(stored, most=10**6).time) == STEPS
    said = refusal(stored, most=500)
    assert "--max-log-size 2GB" in said
    for command in (
        ("inspect", stored, "--max-log-size", "500B"),
        ("identify", "--real-log", stored, "--max-log-size", "500B"),
        ("diagnose", "--real-log", stored, "--max-log-size", "500B"),
        ("import-log", stored, "--task", "air-hockey", "--out", "x.zarr", "--max-log-size", "500B"),
    ):
        code, out, err = capture(*command)
        assert code == 2
        assert "the most that is read is 500 B" in " ".join((out + err).split())


def test_a_log_that_is_large_on_disk_is_read_without_an_option(tmp_path):
    """What is not packed a hundredfold is no bomb, however large."""
    metadata = array_metadata(
        {
            "zarr_format": 2,
            "shape": [ZARR_STORE.most],
            "chunks": [ZARR_STORE.most // 1000],
            "dtype": "<f8",
            "compressor": None,
            "filters": None,
        },
        {},
        "here",
        "none",
    )
    assert metadata.nbytes == 8 * ZARR_STORE.most and metadata.chunk_count == 1000
    (tmp_path / ".zgroup").write_text('{"zarr_format": 2}')
    (tmp_path / "x").mkdir()
    for k in range(1000):
        with (tmp_path / "x" / str(k)).open("wb") as file:
            file.truncate(ZARR_STORE.most // 1000 * 8)  # takes nothing
    with pytest.raises(StoreError, match="metadata of x cannot be read"):  # there is none: it came as far
        ZarrStore(tmp_path).read({"x": metadata})


@pytest.mark.parametrize("codec", ["blosc", "zstd", "gzip"])
def test_a_chunk_that_unpacks_to_more_than_its_metadata_say_is_stopped(old, codec):
    packing = {"blosc": numcodecs.Blosc(), "zstd": numcodecs.Zstd(), "gzip": numcodecs.GZip()}[codec]
    edit(old / "data" / "time" / ".zarray", compressor=packing.get_config())
    (old / "data" / "time" / "0").write_bytes(bytes(packing.encode(np.zeros(10**8))))  # 800 MB
    before = Path("/proc/self/statm").read_text()
    assert "data/time" in refusal(old)
    assert before


def test_chunks_whose_size_is_not_that_of_their_numbers(stored):
    (chunk,) = [p for p in (stored / "data" / "time" / "c").rglob("*") if p.is_file()]
    with chunk.open("ab") as file:
        file.truncate(10**9)  # takes nothing on disk, and would be read
    assert "has 1 GB, and its numbers take 320 B" in refusal(stored)
    grid = {"name": "regular", "configuration": {"chunk_shape": [10**12]}}
    edit(stored / "data" / "time" / "zarr.json", chunk_grid=grid)
    assert "8 TB in memory" in refusal(stored)


def test_a_shard_needs_an_index_of_its_parts(stored):
    sharded = {"chunk_shape": [1], "codecs": [{"name": "bytes"}], "index_codecs": [{"name": "bytes"}]}
    path = stored / "data" / "time" / "zarr.json"
    grid = {"name": "regular", "configuration": {"chunk_shape": [10**7]}}
    edit(path, codecs=[{"name": "sharding_indexed", "configuration": sharded}], chunk_grid=grid)
    assert "too few for the index of its 10000000 parts" in refusal(stored)


def test_a_pipe_in_a_store_is_not_waited_for(stored):
    (chunk,) = [p for p in (stored / "data" / "time" / "c").rglob("*") if p.is_file()]
    chunk.unlink()
    os.mkfifo(chunk)
    assert "is neither a file nor a folder" in refusal(stored)
    (stored / "zarr.json").unlink()
    os.mkfifo(stored / "zarr.json")
    assert "is a device or a pipe" in refusal(stored)


# --- what its attributes say ---


@pytest.mark.parametrize("fault", ["[" * 100_000, "9" * 400, "9" * 5000, '"a\\u0000b"', "1e999"])
def test_attributes_are_read_as_every_document(capture, stored, fault):
    text = (stored / "zarr.json").read_text()
    (stored / "zarr.json").write_text(text.replace('"slider"', fault))
    refusal(stored)
    code, _, err = capture("inspect", stored)
    assert code == 2 and "Traceback" not in err


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"task": None}, "task is None; expected a name"),
        ({"task": {}}, "task is {}; expected a name"),
        ({"task": ""}, "task is ''; expected a name"),
        ({"inputs": [{"name": 1, "unit": "N"}]}, "inputs[0].name is 1; expected a name"),
        ({"outputs": {"name": "q"}}, "outputs is {'name': 'q'}; expected a list"),
        ({"recordings": [{"name": "run", "source": 5}]}, "recordings[0].source is 5; expected a text"),
        (
            {"recordings": [{"name": "run", "channels": "x"}]},
            "recordings[0].channels is 'x'; expected an object",
        ),
        (
            {"recordings": [{"name": "run", "channels": {"inputs": {"drive": ["u", "a", 0]}}}]},
            "recordings[0].channels.inputs.drive",
        ),
        ({"recordings": [{"name": "run", "dropped_rows": "many"}]}, "recordings[0].dropped_rows is 'many'"),
        ({"recordings": [{"name": ["run"]}]}, "recordings[0].name is ['run']; expected a name"),
    ],
)
def test_attributes_of_another_kind_are_named(stored, change, said):
    document = json.loads((stored / "zarr.json").read_text())
    document["attributes"] |= change
    (stored / "zarr.json").write_text(json.dumps(document))
    assert said in refusal(stored)


def test_counts_are_whole_numbers(tmp_path):
    a_log().write(tmp_path / "log.zarr")
    group = zarr.open_group(str(tmp_path / "log.zarr"), mode="r+")
    del group["meta/episode_ends"]
    group.create_array("meta/episode_ends", data=np.array([float("nan")]))
    assert "meta/episode_ends is of type float64; expected int64" in refusal(tmp_path / "log.zarr")
    assert SCHEMA.arrays[3].path == "meta/episode_ends"


# --- how a size is written ---


def test_sizes_are_read_with_their_unit():
    assert [byte_count(text) for text in ("500MB", "2 GB", "1.5kb", "7")] == [500_000_000, 2 * 10**9, 1500, 7]
    for text in ("", "x", "-1", "0", "1e9", "9" * 400, "2 PB"):
        with pytest.raises(OptionError, match="is no size"):
            byte_count(text)
