"""Source files of any writer: long lines, large cells, types that tell no episode, files that unpack to too much."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from capture_cli.errors import LogError
from capture_cli.log.readers import open_source
from capture_cli.log.readers.csv import SETTINGS as CSV

ROWS = 200


@pytest.fixture
def columns() -> dict[str, np.ndarray]:
    time = 0.01 * np.arange(ROWS)
    return {"t_s": time, "u_N": np.sin(time), "q_m": np.cos(time)}


@pytest.fixture
def by_episode(slider_task) -> Path:
    """A task whose episodes a column tells apart."""
    slider_task.write_text(slider_task.read_text() + 'episode = "run"\n')
    return slider_task


def refusal(path: Path, *names: str, most: int | None = None) -> str:
    with pytest.raises(LogError) as caught:
        open_source(path, most).numbers(names)
    return str(caught.value)


def rows(columns: dict[str, np.ndarray]) -> list[str]:
    return [",".join(map(repr, row)) for row in zip(*(c.tolist() for c in columns.values()), strict=True)]


@pytest.mark.parametrize("length", [131_073, 10**6])
def test_a_name_of_more_characters_than_a_csv_reader_takes(capture, tmp_path, slider_task, columns, length):
    path = tmp_path / "run.csv"
    path.write_text("\n".join([f"t_s,u_N,q_m,{'x' * length}", *(f"{row},0" for row in rows(columns))]) + "\n")
    assert open_source(path).numbers(["q_m"]).shape == (ROWS, 1)
    code, _, err = capture("import-log", path, "--task", slider_task, "--out", "a.zarr", "--quiet")
    assert (code, err) == (0, "")


@pytest.mark.parametrize("where", ["header", "first row", "later row"])
@pytest.mark.parametrize("length", [131_073, 2 * CSV.longest_line])
def test_a_cell_of_any_length_ends_with_a_cure(capture, tmp_path, slider_task, columns, where, length):
    lines = ["t_s,u_N,q_m", *rows(columns)]
    number = {"header": 0, "first row": 1, "later row": 30}[where]
    lines[number] = (
        lines[number].replace(",", f",{'1' * length},", 1) if number else f"{'x' * length},u_N,q_m"
    )
    path = tmp_path / "run.csv"
    path.write_text("\n".join(lines) + "\n")
    code, out, err = capture("import-log", path, "--task", slider_task, "--out", "a.zarr")
    assert (code, out) == (2, "")
    assert len(err) < 1000 and err.splitlines()[-1].startswith("  cure: ")
    assert not (tmp_path / "a.zarr").exists()


def test_a_file_without_line_breaks_is_not_read_whole(tmp_path):
    path = tmp_path / "run.csv"
    with path.open("wb") as file:
        file.truncate(400_000_000)  # takes nothing
    assert f"line 1 has {CSV.longest_line} characters or more" in refusal(path, "t_s")


def test_a_file_larger_than_the_limit_is_not_read(capture, tmp_path, slider_task, columns):
    path = tmp_path / "run.csv"
    path.write_text("\n".join(["t_s,u_N,q_m", *rows(columns)]) + "\n")
    said = refusal(path, "t_s", most=1000)
    assert "the most that is read is 1 kB" in said and "--max-log-size" in said
    command = ("import-log", path, "--task", slider_task, "--out", "a.zarr", "--max-log-size")
    code, _, err = capture(*command, "1kB")
    assert code == 2 and "the most that is read is 1 kB" in err
    assert capture(*command, "1MB", "--quiet")[0] == 0


def test_a_list_tells_no_episode(capture, tmp_path, by_episode, columns):
    table = pa.table({**columns, "run": [[1]] * ROWS})
    parquet.write_table(table, tmp_path / "run.parquet")
    code, _, err = capture("import-log", tmp_path / "run.parquet", "--task", by_episode, "--out", "a.zarr")
    assert code == 2
    assert "column 'run' is of type list<element: int64>" in err and "[log] episode" in err


@pytest.mark.parametrize("run", [["a"] * 90 + ["b"] * 110, [1] * 90 + [2] * 110, [1.5] * 90 + [2.5] * 110])
def test_texts_and_numbers_tell_episodes(capture, tmp_path, by_episode, columns, run):
    table = pa.table({**columns, "run": run})
    parquet.write_table(table, tmp_path / "run.parquet", row_group_size=15)
    assert open_source(tmp_path / "run.parquet").labels("run") == [str(r) for r in run]
    out = tmp_path / "a.zarr"
    assert (
        capture("import-log", tmp_path / "run.parquet", "--task", by_episode, "--out", out, "--quiet")[0] == 0
    )


def test_labels_may_be_missing(tmp_path):
    for name in ("run.csv", "run.parquet"):
        path = tmp_path / name
        if name == "run.csv":
            path.write_text("a,b\nx,1\n,2\nx,3\n")
        else:
            parquet.write_table(pa.table({"a": ["x", None, "x"], "b": [1, 2, 3]}), path)
        assert open_source(path).labels("a") == ["x", None, "x"]


def test_a_parquet_file_of_few_bytes_and_many_rows_is_not_read(tmp_path):
    """Equal values are written once, with how often they come."""
    path = tmp_path / "run.parquet"
    parquet.write_table(pa.table({"t": pa.array(np.zeros(10**7)), "u": pa.array(np.zeros(10**7))}), path)
    assert path.stat().st_size < 100_000
    assert "takes 160 MB in memory, and the most that is read is 100 MB" in refusal(
        path, "t", "u", most=10**8
    )
    assert open_source(path, 2 * 10**8).numbers(["t", "u"]).shape == (10**7, 2)


def test_a_parquet_file_of_one_long_text_is_not_read(tmp_path):
    path = tmp_path / "run.parquet"
    long = pa.DictionaryArray.from_arrays(np.zeros(500, dtype=np.int32), ["x" * 10**6])
    parquet.write_table(pa.table({"t": long.cast(pa.string()), "u": np.zeros(500)}), path)
    assert path.stat().st_size < 2_000_000
    with pytest.raises(LogError, match="take more memory than"):
        open_source(path, 10**7).labels("t")
