"""Zarr stores of version 2 and 3: metadata that promise too much, codecs that run something, chunks that are none."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

from hypothesis import strategies as st

from fuzz.cases import Case, Expected, refused, taken
from fuzz.mutations import DEEP, Raw, json_text, json_values, mutated, mutated_bytes, part_at

NEW, OLD, HISTORIES = "log.zarr", "old.zarr", "histories.zarr"
STEPS = 183  # of the log
IDENTIFY = "identify --real-log {} --task machine --starts 1 --threads 1 --quiet --out new"
COMMANDS = (
    *["inspect {} --json"] * 6,
    "inspect {}",
    *["record --task machine --inputs-from {} --threads 1 --out new"] * 2,
    *["import-log {} --task machine --out new"] * 2,
    "import-log run.csv --task machine --append --out {}",
    IDENTIFY,
    "inspect {} --task machine --max-log-size 2kB",
)
OF_HISTORIES = (
    "inspect {} --json",
    "inspect {}",
    "train-sysid --histories {} --steps 1 --width 8 --heads 1 --layers 1 --out new",
)
# What metadata can say that others do not.
CODECS = (
    {"name": "numcodecs.pickle"},
    {"name": "gzip", "configuration": {"level": 9}},
    {
        "name": "blosc",
        "configuration": {"cname": "lz4", "clevel": 5, "shuffle": "shuffle", "typesize": 8, "blocksize": 0},
    },
    {"name": "transpose", "configuration": {"order": [0]}},
    {"name": "crc32c"},
    {"name": "bytes", "configuration": {"endian": "big"}},
    {"name": "vlen-utf8"},
    {
        "name": "sharding_indexed",
        "configuration": {
            "chunk_shape": [1],
            "codecs": [{"name": "bytes"}],
            "index_codecs": [{"name": "bytes"}, {"name": "crc32c"}],
        },
    },
    {"id": "pickle"},
    {"id": "json2"},
    {"id": "zlib", "level": 1},
    {"id": "delta", "dtype": "<f8"},
    {"id": "quantize", "digits": 3, "dtype": "<f8"},
    {"id": "lzma"},
    {"id": "bz2"},
    {"id": "vlen-bytes"},
    None,
)
TYPES = (
    "float32",
    "float64",
    "int64",
    "int8",
    "uint64",
    "bool",
    "complex128",
    "string",
    "bytes",
    "r64",
    "null_terminated_bytes",
    "|O",
    "<f8",
    ">f8",
    "<M8[ns]",
    "<U8",
    "|S5",
    "|V16",
    {"name": "numpy.datetime64"},
    [["a", "<f8"]],
)
SHAPES = (
    [],
    [0],
    [1],
    [10**5],
    [10**7],
    [10**12],
    [2**62, 2**62],
    [-1],
    [1.5],
    ["9"],
    [STEPS, 2],
    [STEPS, 0],
    [1] * 40,
)
OTHERS = (
    "NaN",
    "Infinity",
    "0x7ff8000000000000",
    "",
    "default",
    "v2",
    ".",
    "/",
    "F",
    "C",
    "regular",
    "rectilinear",
)
METADATA = st.one_of(json_values, *(st.sampled_from(some) for some in (CODECS, TYPES, SHAPES, OTHERS)))


def seeds(inputs: Path) -> list[Case]:
    def seed(
        name: str,
        files: dict,
        *words: str,
        store: str = NEW,
        of: str = "inspect {} --json",
        end: Expected | None = None,
    ) -> Case:
        return case(of, store, files, end or refused(*words), name)

    def metadata(array: str, **changes: object) -> dict[str, bytes]:
        """Of an array of the log, with keys changed."""
        path = f"{NEW}/{array}/zarr.json"
        return {path: json_text({**json.loads((inputs / path).read_text()), **changes}).encode()}

    def old(array: str, **changes: object) -> dict[str, bytes]:
        path = f"{OLD}/{array}/.zarray"
        return {path: json_text({**json.loads((inputs / path).read_text()), **changes}).encode()}

    def attributes(**changes: object) -> dict[str, bytes]:
        path = f"{NEW}/zarr.json"
        document = json.loads((inputs / path).read_text())
        return {path: json_text({**document, "attributes": {**document["attributes"], **changes}}).encode()}

    def grid(*shape: int) -> dict:
        return {"name": "regular", "configuration": {"chunk_shape": list(shape)}}

    (recording,) = json.loads((inputs / NEW / "zarr.json").read_text())["attributes"]["recordings"]
    ten_million = {
        **metadata("data/time", shape=[10**7], chunk_grid=grid(1)),
        **metadata("data/inputs", shape=[10**7, 1]),
        **metadata("data/outputs", shape=[10**7, 1]),
    }
    payload = {f"{OLD}/data/time/0": pickle.dumps(Path("it-ran").touch)}
    seeded = [
        seed("as it is", {}, end=taken()),
        seed("as it is, version 2", {}, store=OLD, end=taken()),
        seed(
            "dtype |O",
            {**old("data/time", dtype="|O", compressor=None, filters=[{"id": "pickle"}]), **payload},
            store=OLD,
        ),
        seed(
            "codec pickle", {**old("data/time", compressor={"id": "pickle"}), **payload}, "pickle", store=OLD
        ),
        seed(
            "filter pickle", {**old("data/time", filters=[{"id": "pickle"}]), **payload}, "pickle", store=OLD
        ),
        seed(
            "codec numcodecs.pickle",
            metadata("data/time", codecs=[{"name": "numcodecs.pickle"}]),
            "numcodecs.pickle",
        ),
        seed("10^7 chunks", ten_million, "chunks"),
        seed(
            "10^7 chunks of one array",
            metadata("data/time", shape=[10**7], chunk_grid=grid(1)),
            "axis 'step'",
        ),
        seed("1.6 GB of zeros", zeros(inputs, ("outputs",)), "axis 'step'"),
        seed("1.6 GB of zeros in every array", zeros(inputs, ("time", "inputs", "outputs"))),
        seed("a shape beyond any memory", metadata("data/time", shape=[2**62], chunk_grid=grid(2**62))),
        seed("a format that is a table", attributes(format={}), end=taken("not written by `capture`")),
        seed("task null", attributes(task=None), "task"),
        seed("task {}", attributes(task={}), "task"),
        seed("task of markup", attributes(task="[/]"), end=taken()),
        seed("source 5", attributes(recordings=[{**recording, "source": 5}]), "source"),
        seed("channels x", attributes(recordings=[{**recording, "channels": "x"}]), "channels"),
        seed("a task of 5,000 digits", attributes(task=Raw("9" * 5000)), "digits"),
        seed("a task of 400 digits", attributes(task=Raw("9" * 400)), "digits"),
        seed("100,000 lists in each other", attributes(task=DEEP), "levels deep"),
        seed(
            "a zero character in a name",
            attributes(outputs=[{"name": "q\0x", "unit": "m"}]),
            "control character",
        ),
        seed("markup as a name", attributes(outputs=[{"name": "[/]", "unit": "[/]"}]), end=taken()),
        seed("an empty list of filters", old("data/time", filters=[]), store=OLD, end=taken()),
        seed("a key of 5,000 characters", metadata("data/time", **{"y" * 5000: 1})),
        seed("a chunk that is missing", {f"{NEW}/data/time/c/0": None}, "truncated"),
        seed("an array that is missing", {f"{NEW}/data/time/zarr.json": None}, "data/time"),
        seed("a root that is missing", {f"{NEW}/zarr.json": None}),
        seed("metadata that is no JSON", {f"{NEW}/data/time/zarr.json": b"{"}, "JSON"),
    ]
    identified = [
        seed(f"{s.name}, identified", s.files, of=IDENTIFY, store=_store(s), end=refused())
        for s in seeded
        if s.name in ("codec pickle", "10^7 chunks", "1.6 GB of zeros", "task null", "source 5", "channels x")
    ]
    return [*seeded, *identified]


def _store(case: Case) -> str:
    return case.arguments[1]


def zeros(inputs: Path, names: tuple[str, ...]) -> dict[str, bytes]:
    """Arrays of a log as 200 chunks of a million zeros each, a few bytes on disk."""
    import numcodecs
    import numpy as np

    files: dict[str, bytes] = {}
    packed = bytes(numcodecs.Zstd().encode(np.zeros(10**6)))
    codecs = [{"name": "bytes", "configuration": {"endian": "little"}}, {"name": "zstd", "configuration": {}}]
    for name in names:
        axes = 1 if name == "time" else 2
        path = f"{NEW}/data/{name}"
        document = json.loads((inputs / path / "zarr.json").read_text())
        document |= {
            "shape": [200 * 10**6, 1][:axes],
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [10**6, 1][:axes]}},
            "codecs": codecs,
        }
        files[f"{path}/zarr.json"] = json.dumps(document).encode()
        files |= {f"{path}/c/{n}" + "/0" * (axes - 1): packed for n in range(200)}
    return files


def case(of: str, store: str, files: dict, expected: Expected | None = None, name: str = "") -> Case:
    arguments = tuple(of.format(store).split())
    needs = [store, *(n for n in ("machine", "run.csv") if n in arguments)]
    outputs = ("new", "new.truth.json") if "new" in arguments else (store,) if "--append" in arguments else ()
    return Case(arguments, tuple(needs), files, outputs, expected, name)


def cases(inputs: Path) -> st.SearchStrategy[Case]:
    logs = st.sampled_from((NEW, NEW, OLD)).flatmap(
        lambda s: st.builds(case, st.sampled_from(COMMANDS), st.just(s), damage(inputs, s))
    )
    histories = st.builds(
        case, st.sampled_from(OF_HISTORIES[:2]), st.just(HISTORIES), damage(inputs, HISTORIES)
    )
    return st.one_of(logs, logs, logs, histories)


@st.composite
def damage(draw, inputs: Path, store: str) -> dict[str, bytes | None]:
    """One or two files of a store changed, exchanged, left out, or added."""
    names = sorted(p.relative_to(inputs).as_posix() for p in (inputs / store).rglob("*") if p.is_file())
    documents = [
        n for n in names if n.endswith((".json", ".zarray", ".zattrs", ".zgroup")) and "provenance" not in n
    ]
    chunks = [n for n in names if n not in documents]
    files: dict[str, bytes | None] = {}
    for _ in range(draw(st.integers(1, 2))):
        name = draw(st.sampled_from(documents))
        match draw(
            st.sampled_from(
                ("metadata",) * 5 + ("text", "chunk", "chunk", "numbers", "exchange", "remove", "add")
            )
        ):
            case "metadata":
                document = json.loads((inputs / name).read_text())
                files[name] = json_text(draw(_mutated_metadata(document))).encode("utf-8", "surrogatepass")
            case "text":
                files[name] = draw(mutated_bytes((inputs / name).read_bytes()))
            case "chunk":
                chunk = draw(st.sampled_from(chunks))
                files[chunk] = draw(mutated_bytes((inputs / chunk).read_bytes()))
            case "numbers":
                chunk = draw(st.sampled_from(chunks))
                files[chunk] = draw(_packed())
            case "exchange":
                one, other = draw(st.sampled_from(names)), draw(st.sampled_from(names))
                files |= {one: (inputs / other).read_bytes(), other: (inputs / one).read_bytes()}
            case "remove":
                files[draw(st.sampled_from(names))] = None
            case "add":
                folder = name.rpartition("/")[0]
                beside = draw(
                    st.sampled_from(
                        (
                            "zarr.json",
                            ".zarray",
                            ".zattrs",
                            ".zgroup",
                            "c/1",
                            "0",
                            ".lock",
                            "data",
                            "provenance.json",
                        )
                    )
                )
                if not (inputs / folder / beside).exists():
                    files[f"{folder}/{beside}"] = draw(
                        st.one_of(st.just(b""), st.just(b"{}"), st.binary(max_size=40))
                    )
    return files


@st.composite
def _mutated_metadata(draw, document: dict):
    """Metadata changed anywhere, or where they say how an array lies in its files."""
    keys = [
        k
        for k in (
            "shape",
            "chunks",
            "dtype",
            "data_type",
            "codecs",
            "compressor",
            "filters",
            "fill_value",
            "chunk_grid",
            "chunk_key_encoding",
            "order",
            "dimension_names",
            "attributes",
        )
        if k in document
    ]
    if not keys or draw(st.booleans()):
        return draw(mutated(document, METADATA))
    key = draw(st.sampled_from(keys))
    pool = {"shape": SHAPES, "chunks": SHAPES, "dtype": TYPES, "data_type": TYPES, "compressor": CODECS}.get(
        key
    )
    if pool:
        return {**document, key: draw(st.sampled_from(pool))}
    if key in ("codecs", "filters"):
        return {**document, key: draw(st.lists(st.sampled_from(CODECS), max_size=3))}
    if isinstance(part_at(document, (key,)), dict) and document[key]:
        return {**document, key: draw(mutated(document[key], METADATA, most=1))}
    return {**document, key: draw(METADATA)}


@st.composite
def _packed(draw) -> bytes:
    """A chunk of other numbers, or of more or fewer of them, as those of a log are packed."""
    import numcodecs
    import numpy as np

    count = draw(st.sampled_from((0, 1, 3, STEPS - 1, STEPS, STEPS + 1, 10**6)))
    value = draw(st.sampled_from((0.0, 1.0, -1.0, 1e300, np.nan, np.inf, 5e-324)))
    values = np.full(count, value)
    if draw(st.booleans()):
        values = values + np.arange(count) * draw(st.sampled_from((1.0, -1e-9, 1e6)))
    return bytes(numcodecs.Zstd(0, True).encode(values.astype(draw(st.sampled_from(("<f8", "<i8", ">f8"))))))
