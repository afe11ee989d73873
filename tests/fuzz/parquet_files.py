"""Parquet files: columns of every type, lists and tables in cells, few bytes that are many rows, damaged pages."""

from __future__ import annotations

import io
from decimal import Decimal
from functools import cache
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from fuzz.cases import Case, Expected, refused, taken
from fuzz.mutations import TEXTS, Sound, mutated_bytes

FILE = "run.parquet"
NEEDS = ("machine", FILE)
OUT = "new.zarr"
IMPORT = ("import-log", FILE, "--task", "machine", "--out", OUT)
LINES = (  # that are given it: the arguments, what they need, what they write
    *[(IMPORT, NEEDS, (OUT,))] * 8,
    ((*IMPORT[:-2], "--append", "--out", "log.zarr"), (*NEEDS, "log.zarr"), ("log.zarr",)),
    (("inspect", FILE, "--task", "machine", "--json"), NEEDS, ()),
)
ROWS = 64
COLUMNS = ("t_s", "force_N", "q_m", "episode")


def seeds(inputs: Path) -> list[Case]:
    content = (inputs / FILE).read_bytes()

    def seed(name: str, expected: Expected, changes: dict | None = None, **writing: object) -> Case:
        return Case(
            IMPORT, NEEDS, {FILE: written({**sound(), **(changes or {})}, **writing)}, (OUT,), expected, name
        )

    def damaged(name: str, content: bytes) -> Case:
        return Case(IMPORT, NEEDS, {FILE: content}, (OUT,), refused(FILE), name)

    return [
        seed("as it is", taken()),
        seed("a list for an episode", refused("episode"), {"episode": [[1, 2]] * ROWS}),
        seed("a table for an episode", refused("episode"), {"episode": [{"a": 1}] * ROWS}),
        seed("a list for an output", refused("q_m"), {"q_m": [[0.0]] * ROWS}),
        seed("halves for an episode", taken(), {"episode": np.zeros(ROWS, dtype=np.float16)}),
        seed("decimals for an episode", taken(), {"episode": [Decimal("1.50")] * ROWS}),
        seed("bytes for an episode", taken(), {"episode": [b"\xff"] * ROWS}),
        seed("truths for an episode", taken(), {"episode": [True] * ROWS}),
        seed("nothing for an episode", refused("episode"), {"episode": [None] * ROWS}),
        seed("durations for an episode", taken(), {"episode": np.full(ROWS, 7, dtype="m8[ns]")}),
        seed("durations for an output", refused("q_m", "7 ns"), {"q_m": np.full(ROWS, 7, dtype="m8[ns]")}),
        seed("texts for an episode", taken(), {"episode": ["[/]"] * ROWS}),
        seed("texts for an output", refused("q_m"), {"q_m": ["x"] * ROWS}),
        seed("bytes for an output", refused("q_m"), {"q_m": [b"\xff"] * ROWS}),
        seed("nothing for an output", refused("q_m"), {"q_m": [None] * ROWS}),
        seed("truths for an output", taken(), {"q_m": [True] * ROWS}),
        seed("no rows", refused(), {name: [] for name in COLUMNS}),
        seed(
            "20 million rows in few bytes",
            refused(),
            {name: np.zeros(1) for name in COLUMNS},
            times=20_000_000,
        ),
        seed("without an output", refused("q_m"), {"q_m": None}),
        damaged("cut short", content[: len(content) // 2]),
        damaged("its signature alone", b"PAR1"),
        damaged("empty", b""),
        damaged("a CSV", b"t_s,force_N,q_m,episode\n0,0,0,0\n"),
    ]


def sound() -> dict[str, object]:
    time = np.arange(ROWS) * 0.01
    return dict(
        zip(COLUMNS, (time, np.sin(20 * time), np.cos(7 * time), np.zeros(ROWS, dtype=int)), strict=True)
    )


@cache
def _many(count: int) -> bytes:
    import pyarrow as pa
    from pyarrow import parquet

    out = io.BytesIO()
    table = pa.table({name: pa.array(np.zeros(10**6)) for name in COLUMNS})
    with parquet.ParquetWriter(out, table.schema, compression="zstd", use_dictionary=True) as writer:
        for _ in range(count // 10**6):
            writer.write_table(table, row_group_size=10**6)
    return out.getvalue()


def written(columns: dict, times: int = 0, **writing: object) -> bytes:
    """The columns as a file; None for one that is left out. times: so many rows of zeros instead."""
    import pyarrow as pa
    from pyarrow import parquet

    if times:
        return _many(times)
    out = io.BytesIO()
    parquet.write_table(pa.table({k: v for k, v in columns.items() if v is not None}), out, **writing)
    return out.getvalue()


def cases(inputs: Path) -> st.SearchStrategy[Case]:
    contents = st.one_of(with_columns(), with_columns(), mutated_bytes(Sound((inputs / FILE).read_bytes())))
    return st.builds(
        _case,
        contents,
        st.sampled_from(((), ("--drop-nan",), ("--drop-repeats", "--even-times"))),
        st.sampled_from(LINES),
    )


def _case(content: bytes, switches: tuple[str, ...], line: tuple) -> Case:
    arguments, needs, outputs = line
    more = switches if arguments[0] == "import-log" else ()
    return Case((*arguments, *more), needs, {FILE: content}, outputs)


@st.composite
def with_columns(draw) -> bytes:
    """One to three columns of another type, or with other values, written in some way."""
    import pyarrow as pa

    columns = sound()
    for _ in range(draw(st.integers(1, 3))):
        name = draw(st.sampled_from(COLUMNS))
        plain = columns[name] if isinstance(columns[name], np.ndarray) else np.arange(ROWS) * 0.01
        match draw(st.sampled_from(("type", "type", "cell", "cells", "name", "none", "add"))):
            case "type":
                columns[name] = draw(_columns(plain))
            case "cell":
                values = np.array(plain, dtype=float)
                values[draw(st.integers(0, ROWS - 1))] = draw(_NUMBERS)
                columns[name] = values
            case "cells":
                columns[name] = np.full(ROWS, draw(_NUMBERS))
            case "name":
                columns[draw(st.sampled_from(TEXTS[:20]))] = columns.pop(name)
                columns.setdefault(name, None)
            case "none":
                columns[name] = pa.array(
                    [None] * ROWS, type=draw(st.sampled_from((pa.null(), pa.float64(), pa.string())))
                )
            case "add":
                columns[draw(st.sampled_from(("index", "action.x", "__index_level_0__", *TEXTS[3:12])))] = (
                    draw(_columns(plain))
                )
    return written(
        columns,
        compression=draw(st.sampled_from(("none", "snappy", "zstd", "gzip"))),
        row_group_size=draw(st.sampled_from((1, 7, 1000))),
        use_dictionary=draw(st.booleans()),
    )


_NUMBERS = st.sampled_from((0.0, -1.0, np.nan, np.inf, -np.inf, 1e15, 1e16, 1e300, -1e308, 5e-324, 1e-12))


def _columns(values: np.ndarray) -> st.SearchStrategy:
    """The values as columns of other types."""
    import pyarrow as pa

    whole = [int(1000 * v) for v in np.clip(np.nan_to_num(values), -1e4, 1e4)]
    of_time = [pa.timestamp(unit, zone) for unit in ("s", "ms", "us", "ns") for zone in (None, "UTC")]
    return st.sampled_from(
        [
            *(
                pa.array(whole, type=t)
                for t in (pa.int64(), pa.int32(), pa.float32(), *of_time, pa.time64("us"), pa.duration("ns"))
            ),
            pa.array([abs(w) % 100 for w in whole], type=pa.uint8()),
            pa.array([w % 2 == 0 for w in whole]),
            pa.array([str(v) for v in values]),
            pa.array([str(v) for v in values]).dictionary_encode(),
            pa.array([str(v).encode() for v in values]),
            pa.array([[float(v)] for v in values]),
            pa.array([{"a": float(v)} for v in values]),
            pa.array([None if n % 3 else float(v) for n, v in enumerate(values)]),
            pa.array(whole).cast(pa.decimal128(30, 2)),
            pa.array([TEXTS[n % len(TEXTS)] for n in range(len(values))]),
            pa.array(np.clip(values, -1e4, 1e4).astype(np.float16)),
        ]
    )
