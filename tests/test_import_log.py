"""Logs in: what is read, what is refused and in which words; no file can do worse than be refused."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from inspecting import inspect
from pyarrow import parquet

from capture_cli.common.documents import SETTINGS as DOCUMENTS
from capture_cli.errors import CaptureError, LogError, OutputError
from capture_cli.estimate.log_requirements import check_fits
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.readers import open_source
from capture_cli.model.tasks import load_task
from capture_cli.stages import import_log as stage
from capture_cli.stages.import_log import import_log
from capture_cli.stages.record import record

HEADER = "t_s,u_N,q_m"
ROWS = [f"{0.1 * i:.1f},{math.sin(i):.6f},{0.01 * i:.3f}" for i in range(12)]
QUICK = settings(
    max_examples=25,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


def csv(path: Path, *rows: str, header: str = HEADER) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


def refusal(path: Path, task: Path, **options) -> LogError:
    """The error that importing `path` ends in; nothing may have been written."""
    out = path.parent / "refused.zarr"
    with pytest.raises(LogError) as caught:
        import_log(files=[path], task=str(task), out=out, **options)
    assert not out.exists()
    assert not list(path.parent.glob(".refused*"))
    assert caught.value.cure
    return caught.value


# --- what is read ---


def test_an_actuator_and_a_sensor_may_have_one_name(tmp_path, slider_task):
    for path in slider_task.parent.iterdir():
        path.write_text(path.read_text().replace("drive", "q"))
    log = import_log(files=[csv(tmp_path / "a.csv", *ROWS)], task=str(slider_task), out=tmp_path / "a.zarr")
    assert log.input_names == log.output_names == ("q",)
    check_fits(MeasuredLog.read(tmp_path / "a.zarr"), load_task(str(slider_task)))


def test_a_csv_becomes_a_log_that_reads_back(tmp_path, slider_task):
    log = import_log(
        files=[csv(tmp_path / "run.csv", *ROWS)], task=str(slider_task), out=tmp_path / "run.zarr"
    )
    again = MeasuredLog.read(tmp_path / "run.zarr")
    for found in (log, again):
        np.testing.assert_allclose(found.time, 0.1 * np.arange(12), atol=1e-12)
        np.testing.assert_allclose(found.inputs[:, 0], np.sin(np.arange(12)), atol=1e-6)
        np.testing.assert_allclose(found.outputs[:, 0], 0.01 * np.arange(12), atol=1e-12)
        assert found.task == "slider"
        assert (found.input_names, found.input_units) == (("drive",), ("N",))
        assert (found.output_names, found.output_units) == (("q",), ("m",))
        assert found.recording_names == ("run",)
        assert found.recordings[0]["source"].endswith("run.csv")


def test_provenance_names_the_files_and_the_options(tmp_path, slider_task):
    file = csv(tmp_path / "run.csv", *ROWS)
    import_log(files=[file], task=str(slider_task), out=tmp_path / "run.zarr")
    provenance = json.loads((tmp_path / "run.zarr" / "provenance.json").read_text())
    assert provenance["command"] == "import-log"
    assert set(provenance["inputs"]) == {"task", str(file)}
    assert provenance["options"]["files"] == [str(file)]


def test_scale_and_offset_bring_columns_to_the_unit_of_the_channel(tmp_path, slider_task):
    text = slider_task.read_text()
    slider_task.write_text(text.replace('column = "q_m"', 'column = "q_m"\nscale = -2.0\noffset = 0.5'))
    log = import_log(
        files=[csv(tmp_path / "run.csv", *ROWS)], task=str(slider_task), out=tmp_path / "run.zarr"
    )
    np.testing.assert_allclose(log.outputs[:, 0], 0.5 - 0.02 * np.arange(12), atol=1e-12)


def test_time_may_be_in_another_unit(tmp_path, slider_task):
    slider_task.write_text(slider_task.read_text().replace('"t_s"', '"t_s"\ntime_scale = 1e-3'))
    rows = [f"{100 * i},0.0,{i}" for i in range(12)]
    log = import_log(
        files=[csv(tmp_path / "run.csv", *rows)], task=str(slider_task), out=tmp_path / "run.zarr"
    )
    np.testing.assert_allclose(log.time, 0.1 * np.arange(12), atol=1e-12)
    error = refusal(csv(tmp_path / "run.csv", *rows, "900,0,0"), slider_task)
    assert "goes back at line 14: 900.0 after 1100.0 at line 13" in error.message
    short = refusal(csv(tmp_path / "run.csv", *rows[:3]), slider_task)
    assert "lasts 0.2 s" in short.message and "[log] time_scale" in short.cure
    assert short.cure.startswith("record longer; if")  # no window that short holds enough samples
    some = refusal(csv(tmp_path / "run.csv", *(f"{10 * i},0.0,{i}" for i in range(41))), slider_task)
    assert some.cure.startswith("set `window = 0.1` under [log] of the task.toml, or record longer; if")


def test_times_need_not_begin_at_zero(tmp_path, slider_task):
    rows = [f"{1.7e9 + 0.1 * i!r},0.0,{i}" for i in range(12)]
    log = import_log(
        files=[csv(tmp_path / "run.csv", *rows)], task=str(slider_task), out=tmp_path / "run.zarr"
    )
    assert log.time[0] == 1.7e9


@pytest.mark.parametrize(
    "text",
    [
        "\n".join([HEADER, *ROWS]).replace(",", ";"),
        "\n".join([HEADER, *ROWS]).replace(",", ";").replace(".", ","),
        "\n".join([HEADER, *ROWS]).replace(",", "\t"),
        "\r\n".join([HEADER, *ROWS, ""]),
        "sep=;\n" + "\n".join([HEADER, *ROWS]).replace(",", ";").replace(".", ","),
        "\n".join([HEADER, *('"' + r.replace(",", '","').replace(".", ",") + '"' for r in ROWS)]),
        "\n\n" + "\n\n".join([HEADER, *ROWS]) + "\n\n",
        "\ufeff" + "\n".join([HEADER, *ROWS]),
        "\n".join(['"t_s", u_N ,"q_m"', *ROWS]),
        "\n".join(["q_m,other,t_s,u_N", *(f"{r.split(',')[2]},text,{r.rsplit(',', 1)[0]}" for r in ROWS)]),
    ],
    ids=[
        "semicolon",
        "decimal-comma",
        "tab",
        "crlf",
        "excel-separator",
        "quoted-decimal-comma",
        "blank-lines",
        "byte-order-mark",
        "spaces",
        "more-columns",
    ],
)
def test_every_spelling_of_a_csv_reads_alike(tmp_path, slider_task, text):
    plain = import_log(
        files=[csv(tmp_path / "plain.csv", *ROWS)], task=str(slider_task), out=tmp_path / "a.zarr"
    )
    (tmp_path / "other.csv").write_bytes(text.encode())
    other = import_log(files=[tmp_path / "other.csv"], task=str(slider_task), out=tmp_path / "b.zarr")
    for name in ("time", "inputs", "outputs"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(other, name))


@pytest.mark.parametrize(
    "kind", [pa.float32(), pa.int64(), pa.decimal128(22, 3), pa.bool_(), pa.string()], ids=str
)
def test_parquet_columns_of_any_numeric_type_are_read(tmp_path, slider_task, kind):
    values = [str(i % 2) for i in range(12)] if kind == pa.string() else [i % 2 for i in range(12)]
    column = pa.array(values) if kind == pa.string() else pa.array(values).cast(kind)
    table = pa.table({"t_s": 0.1 * np.arange(12), "u_N": column, "q_m": np.zeros(12)})
    parquet.write_table(table, tmp_path / "run.parquet")
    log = import_log(files=[tmp_path / "run.parquet"], task=str(slider_task), out=tmp_path / "run.zarr")
    np.testing.assert_array_equal(log.inputs[:, 0], np.arange(12) % 2)


def test_several_files_become_recordings_named_apart(tmp_path, slider_task):
    files = [csv(tmp_path / d / "run.csv", *ROWS[: 8 + i]) for i, d in enumerate(("monday", "tuesday"))]
    log = import_log(files=files, task=str(slider_task), out=tmp_path / "run.zarr")
    assert log.recording_names == ("monday/run", "tuesday/run")
    assert log.episode_ends.tolist() == [8, 17]
    assert log.recording.tolist() == [0, 1]


def test_files_and_logs_stay_in_the_order_they_are_given(tmp_path, slider_task):
    """Logs before files, between them and after."""
    options = {"task": str(slider_task)}
    files = {name: csv(tmp_path / f"{name}.csv", *ROWS[: 7 + i]) for i, name in enumerate("abcde")}
    for name in "ace":
        import_log(files=[files[name]], out=tmp_path / f"{name}.zarr", **options)
        files[name] = tmp_path / f"{name}.zarr"
    for number, order in enumerate(("abcde", "dbace", "cdeab")):
        given = [files[name] for name in order]
        log = import_log(files=given, out=tmp_path / f"{number}.zarr", **options)
        assert log.recording_names == tuple(order)
        lengths = np.diff([0, *log.episode_ends])
        assert lengths.tolist() == [7 + "abcde".index(name) for name in order]


def test_the_episode_column_separates_episodes(tmp_path, slider_task):
    slider_task.write_text(slider_task.read_text() + 'episode = "drop"\n')
    rows = [f"{r},{'first' if i < 7 else 'second'}" for i, r in enumerate([*ROWS[:7], *ROWS])]
    others = [row.replace(",first", "5,first").replace(",second", "5,second") for row in rows]
    files = [csv(tmp_path / f"{n}.csv", *r, header=HEADER + ",drop") for n, r in (("a", rows), ("b", others))]
    log = import_log(files=files, task=str(slider_task), out=tmp_path / "run.zarr")
    assert log.episode_ends.tolist() == [7, 19, 26, 38]
    assert log.recording.tolist() == [0, 0, 1, 1]


def test_drop_nan_drops_rows_and_says_how_many(tmp_path, slider_task):
    rows = [*ROWS[:4], "0.35,,1", "0.36,nan,1", "0.37,1,inf", *ROWS[4:]]
    file = csv(tmp_path / "run.csv", *rows)
    log = import_log(files=[file], task=str(slider_task), out=tmp_path / "run.zarr", drop_nan=True)
    assert len(log.time) == len(ROWS)
    assert MeasuredLog.read(tmp_path / "run.zarr").recordings[0]["dropped_rows"] == 3


def test_rows_that_were_written_twice(tmp_path, slider_task):
    file = csv(tmp_path / "run.csv", *ROWS[:5], ROWS[4], ROWS[4], *ROWS[5:])
    assert "--drop-repeats" in refusal(file, slider_task).cure
    options = {"task": str(slider_task), "drop_repeats": True}
    log = import_log(files=[file], out=tmp_path / "run.zarr", **options)
    once = import_log(files=[csv(tmp_path / "once.csv", *ROWS)], out=tmp_path / "once.zarr", **options)
    assert np.array_equal(log.outputs, once.outputs) and np.array_equal(log.time, once.time)
    assert [r["repeated_rows"] for r in (*log.recordings, *once.recordings)] == [2, 0]
    # another value at the same time is no repeat
    other = csv(tmp_path / "other.csv", *ROWS[:5], "0.4,9,9", *ROWS[5:])
    assert "stands still" in refusal(other, slider_task, drop_repeats=True).message


def test_a_heading_that_begins_anew_goes_on(tmp_path, slider_task):
    """Read in degrees, in two episodes that begin where they like."""
    degrees = np.concatenate([170 + 7 * np.arange(60.0), -175 - 9 * np.arange(40.0)])
    text = slider_task.read_text() + 'episode = "run"\n'
    slider_task.write_text(text.replace('column = "q_m"', 'column = "q_m"\nscale = 0.1\nperiod = 360'))
    wrapped = (degrees + 180) % 360 - 180
    rows = [f"{0.1 * i:.1f},1,{v!r},{int(i >= 60)}" for i, v in enumerate(wrapped.tolist())]
    file = csv(tmp_path / "run.csv", *rows, header=HEADER + ",run")
    log = import_log(files=[file], task=str(slider_task), out=tmp_path / "run.zarr")
    np.testing.assert_allclose(np.diff(log.outputs[:60, 0]), 0.7, atol=1e-9)
    np.testing.assert_allclose(np.diff(log.outputs[60:, 0]), -0.9, atol=1e-9)
    assert log.outputs[[0, 60], 0] == pytest.approx([17.0, -17.5])
    task = load_task(str(slider_task))
    check_fits(log, task)
    slider_task.write_text(slider_task.read_text().replace("period = 360", "period = 400"))
    with pytest.raises(LogError, match=r"begins anew after 360; task .* now says .* after 400"):
        check_fits(log, load_task(str(slider_task)))


def test_real_logs_are_read(tmp_path, slider_task, real_data):
    text = slider_task.read_text().replace('"u_N"', '"u_V"')
    slider_task.write_text(text)
    files = sorted((real_data / "emps").glob("emps_*.csv"))
    log = import_log(files=files, task=str(slider_task), out=tmp_path / "emps.zarr")
    assert log.recording_names == ("emps_test_pulses", "emps_train")
    assert len(log.time) == 2 * 24841


@pytest.mark.parametrize(
    ("end", "cut"),
    [("0.1", "0.1"), ("0.", "0."), ("0", "0"), ("0.110", None), ("0.1\n", None), ("0.110\n", None)],
)
@pytest.mark.parametrize("delimiter", [",", ";"])
def test_a_line_that_was_cut_off_in_mid_number_is_pointed_to(tmp_path, slider_task, end, cut, delimiter):
    text = "\n".join([HEADER, *ROWS[:-1], ROWS[-1].rsplit(",", 1)[0] + "," + end])
    if delimiter == ";":
        text, cut = text.replace(",", ";").replace(".", ","), cut and cut.replace(".", ",")
    (tmp_path / "run.csv").write_text(text)
    log = import_log(files=[tmp_path / "run.csv"], task=str(slider_task), out=tmp_path / "run.zarr")
    assert log.recordings[0]["cut_off"] == cut
    found = [f for f in inspect(tmp_path / "run.zarr")["findings"] if "mid-number" in f["message"]]
    assert [f["severity"] for f in found] == ["warning"] * (cut is not None)
    if cut is not None:
        assert f"run.csv ends in '{cut}', without a line break" in found[0]["message"]
        assert found[0]["cure"].startswith("remove its last line")


# --- what is refused ---


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([*ROWS[:5], "0.5,x,0"], "'u_N' holds 'x' at line 7"),
        ([*ROWS[:5], "", "0.5,1 000,0"], "'u_N' holds '1 000' at line 8"),
        ([*ROWS[:5], "0.5,nan,0", "0.6,,0"], "'u_N' is missing or NaN at line 7 (2 of 7 rows"),
        ([*ROWS[:5], "0.5,1,-inf"], "'q_m' is -inf at line 7"),
        ([*ROWS[:5], "0.5,1,-1e300"], "'q_m' comes to -1e+300 m at line 7 (1 such values), too large"),
        (
            [*ROWS[:5], "0.5,1e16,1", "0.6,-2e18,1"],
            "'u_N' comes to 1e+16 N at line 7 (2 such values), too large",
        ),
        ([*ROWS[:5], "0.4,1,1"], "'t_s' stands still at line 7: 0.4 s after 0.4 s at line 6"),
        ([*ROWS[:5], "0.39,1,1"], "'t_s' goes back at line 7: 0.39 s after 0.4 s at line 6"),
        ([*ROWS[:5], "0.5,1"], "2 values at line 7, and the header has 3"),
        ([], "no rows"),
        (ROWS[:1], "single row"),
        (ROWS[:3], "lasts 0.2 s, which is shorter than a window of 0.5 s"),
        (["0.0,,"] * 3, "line 2"),
    ],
)
def test_bad_rows_are_refused_with_their_place(tmp_path, slider_task, rows, words):
    assert words in refusal(csv(tmp_path / "run.csv", *rows), slider_task).message


def test_commas_that_part_thousands_are_no_decimal_points(tmp_path, slider_task):
    rows = [f"{0.1 * i:.1f};0.5;9,99{i % 10}" for i in range(12)]
    header = HEADER.replace(",", ";")
    error = refusal(csv(tmp_path / "run.csv", *rows, header=header), slider_task)
    assert "'q_m' holds '9,990' at line 2, not a number" in error.message
    assert "other numbers of the file have a decimal point" in error.cure
    rows = [f"{i};1;9,99{i % 10}" for i in range(12)]
    error = refusal(csv(tmp_path / "either.csv", *rows, header=header), slider_task)
    assert "'q_m' holds '9,990' at line 2: nothing in the file tells" in error.message
    # another column does tell
    rows = [f"{0.1 * i:.1f};1;9.99{i % 10}".replace(".", ",") for i in range(12)]
    file = csv(tmp_path / "decimal.csv", *rows, header=header)
    log = import_log(files=[file], task=str(slider_task), out=tmp_path / "run.zarr")
    np.testing.assert_allclose(log.outputs[:3, 0], [9.990, 9.991, 9.992])


def test_what_delimiters_and_decimals_are_read_is_said(tmp_path, slider_task):
    rows = [row.replace(".", ",") for row in ROWS[1:]]
    error = refusal(csv(tmp_path / "comma.csv", *rows), slider_task)
    assert "the header has 3" in error.message and error.cure.startswith("if its numbers have decimal commas")
    rows = [row.replace(",", " ") for row in ROWS]
    error = refusal(csv(tmp_path / "space.csv", *rows, header=HEADER.replace(",", " ")), slider_task)
    assert "by commas, semicolons or tabs" in error.cure


def test_rows_that_are_not_sorted_are_told_from_episodes_that_begin(tmp_path, slider_task):
    shuffled = np.random.default_rng(0).permutation(ROWS + [f"{1.2 + 0.1 * i:.1f},1,{i}" for i in range(30)])
    error = refusal(csv(tmp_path / "run.csv", *shuffled), slider_task)
    assert error.cure == "the rows are not sorted by time: sort them"
    begins = refusal(csv(tmp_path / "two.csv", *ROWS * 8), slider_task)
    assert begins.cure.startswith("if an episode begins there") and "happens 7 times" in begins.message
    slider_task.write_text(slider_task.read_text() + 'episode = "run"\n')
    rows = [f"{row},1" for row in shuffled]
    labelled = refusal(csv(tmp_path / "runs.csv", *rows, header=HEADER + ",run"), slider_task)
    assert labelled.cure.endswith("sort them, those of each 'run' by themselves")


@pytest.mark.parametrize("seconds", [4, 400])
def test_times_since_1970_in_single_precision_are_named(tmp_path, slider_task, seconds):
    times = (1.7e9 + np.arange(0, seconds, seconds / 200)).astype(np.float32).tolist()
    error = refusal(csv(tmp_path / "a.csv", *(f"{t!r},1,{i}" for i, t in enumerate(times))), slider_task)
    assert "stands still" in error.message
    assert "float32) tells times about 1.7e+09 only 128 s apart" in error.cure
    assert "in double precision, or from the start of the recording" in error.cure
    whole = refusal(csv(tmp_path / "b.csv", *(f"{i // 2},1,{i}" for i in range(40))), slider_task)
    assert whole.cure == "remove repeated rows, and sort the others by time"


def test_times_with_too_few_digits_are_named(tmp_path, slider_task):
    """As a spreadsheet saves nanoseconds since 1970, or a logger that counts whole seconds."""
    for form, few in (("{:.5e}", "1 different one;"), ("{:.9e}", "2 different ones")):
        rows = [f"{form.format(1.763911115e18 + 5e6 * i)},1,{i}" for i in range(200)]
        error = refusal(csv(tmp_path / "a.csv", *rows), slider_task)
        assert "stands still" in error.message
        assert f"too few digits: the file's 200 rows have {few}" in error.cure


@pytest.mark.parametrize(
    ("line", "message", "cure"),
    [
        ('0.5,"1,2', 'quotation mark (") is not closed at line 7', 'remove that "'),
        ('"0.5,1,2', 'quotation mark (") is not closed at line 7', 'remove that "'),
        ('0.5,1,"2', "'q_m' holds '2", 'remove that "'),
        ('0.5,1",2', "'u_N' holds '1\"' at line 7", 'remove that "'),
        ("# resumed", "1 value at line 7", "remove that line if it is a comment"),
        ("# resumed,at,0.5", "'t_s' holds '# resumed' at line 7", "remove the line if it is a comment"),
        ("0.5,1,2,3", "4 values at line 7", "correct that line"),
        ("0.5,1", "2 values at line 7", "complete that line"),
    ],
)
def test_the_cure_of_a_line_fits_what_is_wrong_with_it(tmp_path, slider_task, line, message, cure):
    error = refusal(csv(tmp_path / "run.csv", *ROWS[:5], line, *ROWS[5:]), slider_task)
    assert message in error.message
    assert error.cure.startswith(cure)


@pytest.mark.parametrize(
    ("more", "cure"),
    [
        (",", "end the header in ',' as the rows do, or remove it"),
        (",1.5", "name the columns that it lacks in the header"),
    ],
)
def test_rows_that_all_have_a_value_more_are_told_from_one_that_has(tmp_path, slider_task, more, cure):
    error = refusal(csv(tmp_path / "run.csv", *(row + more for row in ROWS)), slider_task)
    assert "every row has 4 values, and the header has 3" in error.message
    assert error.cure.startswith(cure)
    short = refusal(csv(tmp_path / "short.csv", *ROWS, header=HEADER + ",w"), slider_task)
    assert "every row has 3 values, and the header has 4" in short.message


STAMPS = {  # how a row's time is written, given its seconds
    "iso": "2026-11-23T10:00:{:09.6f}",
    "pandas": "2026-11-23 10:00:{:09.6f}",
    "ns": "2026-11-23T10:00:{:012.9f}Z",
    "zone": "2026-11-23T10:00:{:09.6f}+01:00",
    "clock": "10:00:{:09.6f}",
    "one-digit": "9:00:{:09.6f}",
}


@pytest.mark.parametrize("name", STAMPS)
@pytest.mark.parametrize("as_parquet", [False, True])
def test_times_as_text_are_seconds_since_the_first(tmp_path, slider_task, name, as_parquet):
    """To the microsecond, which since 1970 no float has room for."""
    times = [5 + 0.1 * i + 1e-6 * (i % 3) for i in range(12)]
    texts = [STAMPS[name].format(t) for t in times]
    if as_parquet:
        file = tmp_path / "run.parquet"
        parquet.write_table(pa.table({"t_s": texts, "u_N": np.ones(12), "q_m": np.arange(12.0)}), file)
    else:
        file = csv(tmp_path / "run.csv", *(f"{text},1,{i}" for i, text in enumerate(texts)))
    log = import_log(files=[file], task=str(slider_task), out=tmp_path / "run.zarr")
    assert log.time.tolist() == [(100_000 * i + i % 3) / 1e6 for i in range(12)]
    assert log.outputs[:, 0].tolist() == list(range(12))


@pytest.mark.parametrize(
    "kind", ["timestamp[ns]", "timestamp[ms]", "timestamp[us, tz=Europe/Berlin]", "time64[us]"]
)
def test_times_of_a_parquet_file_are_seconds_since_the_first(tmp_path, slider_task, kind):
    ticks = pa.array([10**9 * 36_000 + 10**8 * i for i in range(12)])
    nanoseconds = ticks.cast(pa.time64("ns") if kind == "time64[us]" else pa.timestamp("ns"))
    zoned = pa.timestamp("us", "Europe/Berlin")
    time = nanoseconds.cast(zoned if "tz" in kind else pa.type_for_alias(kind))
    file = tmp_path / "run.parquet"
    parquet.write_table(pa.table({"t_s": time, "u_N": np.ones(12), "q_m": np.arange(12.0)}), file)
    log = import_log(files=[file], task=str(slider_task), out=tmp_path / "run.zarr")
    assert log.time.tolist() == [i / 10 for i in range(12)]


def test_times_of_day_go_on_after_midnight(tmp_path, slider_task):
    """Where a row lacks its time, and where fractions have a decimal comma, too."""
    clock = [f"23:59:59.{i}" for i in (5, 7, 9)] + [f"00:00:0{i // 10}.{i % 10}" for i in range(1, 12, 2)]
    file = csv(tmp_path / "run.csv", *(f"{t},1,{i}" for i, t in enumerate(clock)), ",1,0")
    log = import_log(files=[file], task=str(slider_task), out=tmp_path / "a.zarr", drop_nan=True)
    assert log.time.tolist() == [2 * i / 10 for i in range(9)]
    rows = [f"{t};1,5;{i}".replace(".", ",") for i, t in enumerate(clock)]
    decimal = csv(tmp_path / "decimal.csv", *rows, header=HEADER.replace(",", ";"))
    log = import_log(files=[decimal], task=str(slider_task), out=tmp_path / "b.zarr")
    assert log.time.tolist() == [2 * i / 10 for i in range(9)] and (log.inputs == 1.5).all()


def test_times_as_text_that_are_refused(tmp_path, slider_task):
    rows = [f"10:00:0{i},1,{i}" for i in range(9)]
    back = refusal(csv(tmp_path / "back.csv", *rows, rows[3]), slider_task)
    assert "'t_s' goes back at line 11: 3.0 s after 8.0 s at line 10" in back.message
    for other in ("2026-11-23T10:00:10", "10:00:10Z", "10:61:00", "10.5"):
        error = refusal(csv(tmp_path / "mixed.csv", *rows, f"{other},1,2"), slider_task)
        assert f"'t_s' holds '{other}' at line 11, and begins with '10:00:00'" in error.message
    slider_task.write_text(slider_task.read_text() + "time_scale = 1e-9\n")
    scaled = refusal(csv(tmp_path / "scaled.csv", *rows), slider_task)
    assert "time_scale is 1e-09" in scaled.message and scaled.cure.startswith("take time_scale out")


@pytest.mark.parametrize("begin", ["14.11.2023 22:1{}", "11/14/2023 22:13:2{}", "2023-02-30T10:00:0{}"])
def test_dates_that_are_not_read_get_the_cure(tmp_path, slider_task, begin):
    rows = [f"{begin.format(i % 10)},1,{i}" for i in range(12)]
    error = refusal(csv(tmp_path / "run.csv", *rows), slider_task)
    assert "at line 2, not a number" in error.message
    assert error.cure.endswith("in all rows as 2026-11-23T10:00:00.005 or 10:00:00.005")
    units = refusal(csv(tmp_path / "units.csv", "s,N,m", *ROWS), slider_task)
    assert units.cure.startswith("remove the row if it holds units")


def test_stamps_in_nanoseconds_are_named_as_the_file_has_them(tmp_path, slider_task):
    slider_task.write_text(slider_task.read_text() + "time_scale = 1e-9\n")
    stamps = [1732180000000000000 + 10_000_000 * i for i in (*range(100), 99)]
    error = refusal(csv(tmp_path / "run.csv", *(f"{stamp},1,2" for stamp in stamps)), slider_task)
    assert (
        "stands still at line 102: 1732180000990000128 after 1732180000990000128 at line 101" in error.message
    )


def test_a_slow_sensor_is_told_from_lost_samples(tmp_path, slider_task):
    lost = refusal(csv(tmp_path / "lost.csv", *ROWS, "2.0,1,"), slider_task)
    assert lost.cure.startswith("write sparse = true under [outputs.q], which keeps what drove the machine")
    assert "or add --drop-nan" in lost.cure
    row = refusal(csv(tmp_path / "row.csv", *ROWS, "2.0,,"), slider_task)
    assert row.cure.startswith("add --drop-nan")
    rows = [f"{0.1 * i:.1f},{i % 3},{'' if i % 4 else i}" for i in range(40)]
    slow = refusal(csv(tmp_path / "slow.csv", *rows), slider_task)
    assert slow.cure.startswith("'q_m' (30 rows): if that is a sensor slower than the others")
    assert "write sparse = true under [outputs.q]" in slow.cure
    rows = [f"{0.1 * i:.1f},{'' if i % 2 else 1},{i if i % 2 else ''}" for i in range(40)]
    both = refusal(csv(tmp_path / "both.csv", *rows), slider_task)
    assert "sparse = true" in both.cure
    assert "'u_N' (20 rows): write what was last commanded into every row" in both.cure


def test_every_column_with_holes_is_named(tmp_path, slider_task):
    rows = [f"{0.1 * i:.1f},{'' if i == 30 else 1},{'' if i % 4 else i}" for i in range(40)]
    message = refusal(csv(tmp_path / "a.csv", *rows), slider_task).message
    assert "column 'q_m' is missing or NaN at line 3" in message
    assert message.endswith("(30 of 40 rows are incomplete: 'q_m' in 30, 'u_N' in 1)")


@pytest.fixture
def sparse_task(slider_task) -> Path:
    """The slider, of which a slow sensor reports the position."""
    slider_task.write_text(slider_task.read_text().replace("[outputs.q]", "[outputs.q]\nsparse = true"))
    return slider_task


SLOW = [f"{0.1 * i:.1f},{i % 3},{'' if i % 4 else i}" for i in range(40)]


def test_a_slow_sensor_leaves_the_rows_between_its_samples(tmp_path, sparse_task):
    for drop_nan in (False, True):
        out = tmp_path / f"{drop_nan}.zarr"
        import_log(files=[csv(tmp_path / "a.csv", *SLOW)], task=str(sparse_task), out=out, drop_nan=drop_nan)
        log = MeasuredLog.read(out)
        assert (log.sparse, log.recordings[0]["dropped_rows"]) == ({"q"}, 0)
        assert np.array_equal(log.sampled[:, 0], np.arange(40) % 4 == 0)
        assert np.array_equal(log.values[:, 0], np.where(np.arange(40) % 4, 0, np.arange(40)))
        assert np.array_equal(np.isnan(log.outputs), ~log.sampled)
    check_fits(log, load_task(str(sparse_task)))


def test_what_a_sparse_output_may_not_be(tmp_path, sparse_task):
    """Infinite, next to never there; and what drove the machine has to be in every row."""
    infinite = refusal(csv(tmp_path / "inf.csv", *SLOW, "4.0,0,inf"), sparse_task)
    assert "column 'q_m' is inf at line 42 (1 of 41 rows" in infinite.message
    blind = refusal(csv(tmp_path / "blind.csv", *(r.rsplit(",", 1)[0] + "," for r in SLOW)), sparse_task)
    assert "output 'q' has 0 samples in the 40 steps of episode 0 (recording 'blind')" in blind.message
    few = refusal(csv(tmp_path / "few.csv", *SLOW[:14]), sparse_task)
    assert "has 4 samples in the 14 steps" in few.message
    undriven = refusal(csv(tmp_path / "u.csv", *SLOW, "4.0,,40"), sparse_task)
    assert "column 'u_N' is missing" in undriven.message


def test_a_slow_heading_goes_on_and_rows_without_a_sample_may_be_repeats(tmp_path, sparse_task):
    sparse_task.write_text(sparse_task.read_text().replace('column = "q_m"', 'column = "q_m"\nperiod = 360'))
    degrees = (25.0 * np.arange(60)) % 360
    rows = [f"{0.01 * i:.2f},0,{'' if i % 3 else degrees[i]}" for i in range(60)]
    file = csv(tmp_path / "run.csv", *rows[:5], rows[4], *rows[5:])
    assert "--drop-repeats" in refusal(file, sparse_task).cure
    sparse_task.write_text(sparse_task.read_text().replace("window = 0.5", ""))
    log = import_log(files=[file], task=str(sparse_task), out=tmp_path / "a.zarr", drop_repeats=True)
    np.testing.assert_allclose(log.outputs[::3, 0], 25.0 * np.arange(0, 60, 3))
    assert log.recordings[0]["repeated_rows"] == 1


def test_a_log_that_is_complete_is_followed_by_one_that_is_sparse(tmp_path, sparse_task):
    whole = csv(tmp_path / "whole.csv", *ROWS)
    text = sparse_task.read_text()
    sparse_task.write_text(text.replace("sparse = true", ""))
    import_log(files=[whole], task=str(sparse_task), out=tmp_path / "log.zarr")
    assert "sparse" not in (tmp_path / "log.zarr" / "zarr.json").read_text()
    sparse_task.write_text(text)
    options = {"task": str(sparse_task), "out": tmp_path / "log.zarr", "append": True}
    log = import_log(files=[csv(tmp_path / "slow.csv", *SLOW)], **options)
    assert log.sparse == {"q"} and log.sampled[:12].all() and log.sampled[12:].sum() == 10
    sparse_task.write_text(text.replace("sparse = true", ""))
    with pytest.raises(LogError, match="'q' was imported as sparse"):
        import_log(files=[csv(tmp_path / "more.csv", *ROWS)], **options)


def test_nothing_left_after_drop_nan_is_refused(tmp_path, slider_task):
    error = refusal(csv(tmp_path / "run.csv", *["0.0,,"] * 3), slider_task, drop_nan=True)
    assert "not one of its 3 rows is complete" in error.message


def test_a_missing_column_names_those_that_exist(tmp_path, slider_task):
    error = refusal(csv(tmp_path / "run.csv", *ROWS, header="t_s,u_N,q_mm"), slider_task)
    assert "no column 'q_m': did you mean 'q_mm'? There are: q_mm, t_s, u_N" in error.message


def test_a_column_in_other_letters_is_pointed_to(tmp_path, slider_task):
    error = refusal(csv(tmp_path / "run.csv", *ROWS, header="T_S,U_N,Q_M"), slider_task)
    assert "no column 't_s': did you mean 'T_S'? There are" in error.message


def test_comments_before_the_header_are_passed_over(tmp_path, slider_task):
    """And said; of a header with a mark before it the mark is to be removed, as no other line names the columns."""
    for mark in ("# logger v3, 2 Hz", "% 1,2,3", "// t_s;u_N", "# a\n\n#\n# 0.1"):
        file = csv(tmp_path / "run.csv", HEADER, *ROWS, header=mark)
        log = import_log(files=[file], task=str(slider_task), out=tmp_path / "run.zarr", force=True)
        assert len(log.time) == len(ROWS)
        assert log.recordings[0]["comment_lines"] == (3 if "\n" in mark else 1)
        (found,) = [f for f in inspect(tmp_path / "run.zarr")["findings"] if "comments" in f["message"]]
        assert found["severity"] == "note"
    for lines in (["# " + HEADER], ["# logger v3", "#" + HEADER], ["# logger v3"]):
        error = refusal(csv(tmp_path / "run.csv", *lines[1:], *ROWS, header=lines[0]), slider_task)
        assert "no column 't_s': " in error.message and lines[-1].split(",")[0] in error.message
        assert error.cure.startswith("remove the mark at the start of that line if it names the columns")
    decimal = [row.replace(",", ";").replace(".", ",") for row in ROWS[1:]]
    error = refusal(csv(tmp_path / "run.csv", *decimal, header="# t_s;u_N;q_m"), slider_task)
    assert "remove the mark" in error.cure
    broken = refusal(csv(tmp_path / "run.csv", HEADER, *ROWS, "1.2,x,0", header="# logger"), slider_task)
    assert "'u_N' holds 'x' at line 15" in broken.message
    # as a ROS bag's topics are exported
    slider_task.write_text(slider_task.read_text().replace('"t_s"', '"%time"'))
    file = csv(tmp_path / "bag.csv", *ROWS, header="%time,u_N,q_m")
    log = import_log(files=[file], task=str(slider_task), out=tmp_path / "bag.zarr")
    assert log.recordings[0]["comment_lines"] == 0


def test_a_row_of_units_is_to_be_removed(tmp_path, slider_task):
    error = refusal(csv(tmp_path / "run.csv", "s,N,m", *ROWS), slider_task)
    assert "'t_s' holds 's' at line 2, not a number" in error.message
    assert "remove the row" in error.cure


def test_a_file_without_a_header_is_told_so(tmp_path, slider_task):
    error = refusal(csv(tmp_path / "run.csv", *ROWS[1:], header=ROWS[0]), slider_task)
    assert "the first line must name the columns" in error.message


def test_a_column_named_twice_is_refused(tmp_path, slider_task):
    error = refusal(csv(tmp_path / "run.csv", *(f"{r},1" for r in ROWS), header=HEADER + ",q_m"), slider_task)
    assert "2 columns named 'q_m'" in error.message


def test_a_clock_that_restarts_points_to_the_episode_column(tmp_path, slider_task):
    error = refusal(csv(tmp_path / "run.csv", *ROWS, *ROWS), slider_task)
    assert "[log] episode" in error.cure


def test_interleaved_episodes_are_refused(tmp_path, slider_task):
    slider_task.write_text(slider_task.read_text() + 'episode = "drop"\n')
    rows = [f"{r},{i % 2}" for i, r in enumerate(ROWS)]
    error = refusal(csv(tmp_path / "run.csv", *rows, header=HEADER + ",drop"), slider_task)
    assert "12 of 12 episodes have a single row" in error.message
    assert "sort the rows by 'drop'" in error.cure


def test_an_empty_episode_cell_is_refused(tmp_path, slider_task):
    slider_task.write_text(slider_task.read_text() + 'episode = "drop"\n')
    rows = [f"{r},{'' if i == 3 else 'a'}" for i, r in enumerate(ROWS)]
    error = refusal(csv(tmp_path / "run.csv", *rows, header=HEADER + ",drop"), slider_task)
    assert "'drop' is empty at line 5" in error.message


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("run.csv", b"", "is empty"),
        ("run.csv", b"\n \n", "blank lines only"),
        ("run.csv", "t_s,u_N,q_m,\u00b5\n".encode("latin-1"), "is not UTF-8"),
        ("run.csv", b"PAR1\x00\xff\xfe", "is a Parquet file, by its first bytes"),
        ("run.tsv", b"PK\x03\x04\x14\x00", "is a zip archive or an Excel workbook"),
        ("run.csv", b"\x1f\x8b\x08\x00", "is compressed by gzip"),
        ("run.parquet", b"\x1f\x8b\x08\x00", "is compressed by gzip"),
        ("run.parquet", b"t_s,u_N,q_m\n0,0,0\n", "is not a readable Parquet file"),
        ("run.mat", b"MATLAB 5.0", "files that end in '.mat' are not read; .csv"),
        ("run", b"t_s", "files without an ending"),
    ],
)
def test_files_of_another_kind_are_refused(tmp_path, slider_task, name, content, words):
    (tmp_path / name).write_bytes(content)
    assert words in refusal(tmp_path / name, slider_task).message


def test_missing_files_folders_and_repeats_are_refused(tmp_path, slider_task):
    assert "does not exist" in refusal(tmp_path / "nowhere.csv", slider_task).message
    (tmp_path / "logs").mkdir()
    assert "is a folder" in refusal(tmp_path / "logs", slider_task).message
    file = csv(tmp_path / "run.csv", *ROWS)
    with pytest.raises(LogError, match="given twice"):
        import_log(
            files=[file, tmp_path / "logs" / ".." / "run.csv"], task=str(slider_task), out=tmp_path / "o"
        )
    with pytest.raises(LogError, match="no file"):
        import_log(files=[], task=str(slider_task), out=tmp_path / "o")


def test_a_parquet_column_of_text_is_refused_with_row_and_value(tmp_path, slider_task):
    table = pa.table({"t_s": [0.0, 0.5, 1.0], "u_N": ["0", "off", "1"], "q_m": [0.0, 0.0, 0.0]})
    parquet.write_table(table, tmp_path / "run.parquet")
    assert "'u_N' holds 'off' at row 2 (of 3)" in refusal(tmp_path / "run.parquet", slider_task).message


def test_a_decimal_point_in_one_parquet_column_says_what_a_comma_in_another_is_not(tmp_path, slider_task):
    """As of CSV: one writer wrote all of them."""
    times = [f"{i / 250:.3f}" for i in range(12)]
    table = pa.table({"t_s": times, "u_N": ["1,11"] * 12, "q_m": np.zeros(12)})
    parquet.write_table(table, tmp_path / "run.parquet")
    assert "'u_N' holds '1,11' at row 1" in refusal(tmp_path / "run.parquet", slider_task).message


def test_a_parquet_column_of_dates_is_no_measurement(tmp_path, slider_task):
    times = pa.array([0, 1, 2], pa.timestamp("ms"))
    parquet.write_table(
        pa.table({"t_s": [0.0, 1.0, 2.0], "u_N": times, "q_m": [0.0] * 3}), tmp_path / "run.parquet"
    )
    error = refusal(tmp_path / "run.parquet", slider_task)
    assert "'u_N' is of type timestamp[ms]" in error.message
    assert "seconds" in error.cure and "time_scale" in error.cure


def test_an_output_that_exists_is_refused_before_the_files_are_read(tmp_path, slider_task):
    (tmp_path / "run.zarr").mkdir()
    with pytest.raises(OutputError, match="exists already"):
        import_log(files=[tmp_path / "nowhere.csv"], task=str(slider_task), out=tmp_path / "run.zarr")


def test_a_file_that_the_log_holds_is_not_added_again(tmp_path, slider_task):
    out = tmp_path / "run.zarr"
    options = {"task": str(slider_task), "out": out, "append": True}
    first = csv(tmp_path / "a.csv", *ROWS)
    import_log(files=[first], task=str(slider_task), out=out)
    import_log(files=[csv(tmp_path / "b.csv", *ROWS[1:])], **options)
    import_log(files=[first], task=str(slider_task), out=tmp_path / "same.zarr")
    for again in (first, csv(tmp_path / "copy.csv", *ROWS), tmp_path / "same.zarr"):
        with pytest.raises(LogError, match=r"is in .*run\.zarr already, as the recording 'a'") as caught:
            import_log(files=[again], **options)
        assert "leave it out" in caught.value.cure
    assert MeasuredLog.read(out).recording_names == ("a", "b")


def test_a_recording_that_is_given_twice_is_refused(tmp_path, slider_task):
    options = {"task": str(slider_task), "out": tmp_path / "run.zarr"}
    file, copy = (csv(tmp_path / f"{name}.csv", *ROWS) for name in ("monday", "monday (1)"))
    with pytest.raises(
        LogError, match=r"monday \(1\).csv is in .*monday.csv already, as the recording 'monday'"
    ):
        import_log(files=[file, copy], **options)
    # a log that was recorded has no file
    for name, seed in (("a", 1), ("b", 2)):
        drive = {"duration": 1.0, "amplitude": {"drive": 3.0}, "noise": 1e-3, "threads": 1}
        record(task=str(slider_task), out=tmp_path / f"{name}.zarr", seed=seed, **drive)
    a, b = tmp_path / "a.zarr", tmp_path / "b.zarr"
    with pytest.raises(LogError, match=r"a.zarr is in .*a.zarr already, as the recording 'a'"):
        import_log(files=[a, b, a], **options)
    import_log(files=[a, b], **options)
    with pytest.raises(LogError, match=r"b.zarr is in .*run.zarr already, as the recording 'b'"):
        import_log(files=[b], append=True, **options)
    assert not inspect(options["out"])["findings"] or "holds the same" not in str(inspect(options["out"]))
    # one of before this was refused
    MeasuredLog.read(a).followed_by(MeasuredLog.read(a)).write(tmp_path / "twice.zarr")
    (found,) = [f for f in inspect(tmp_path / "twice.zarr")["findings"] if "holds the same" in f["message"]]
    assert (found["where"], found["severity"]) == ("a-2, episode 1", "warning")


def test_two_that_add_to_a_log_at_once_do_not_lose_a_recording(tmp_path, slider_task, monkeypatch):
    """The second is refused while the first is at it."""
    options = {"task": str(slider_task), "out": tmp_path / "run.zarr"}
    files = [csv(tmp_path / f"{n}.csv", *ROWS[: 8 + n]) for n in range(3)]
    import_log(files=files[:1], **options)
    seen = []

    def meanwhile(log, task):
        if not seen:
            seen.append(True)
            with pytest.raises(OutputError, match=r"process \d+ .* is writing .*run.zarr"):
                import_log(files=files[2:], append=True, **options)
        check(log, task)

    check = stage._check_task
    monkeypatch.setattr(stage, "_check_task", meanwhile)
    import_log(files=files[1:2], append=True, **options)
    log = import_log(files=files[2:], append=True, **options)
    assert log.recording_names == ("0", "1", "2")
    assert not list(tmp_path.glob(".*"))


# --- whatever a file holds ---

numbers = st.floats(-DOCUMENTS.largest, DOCUMENTS.largest)
increasing_times = st.lists(st.integers(0, 10**9), min_size=2, max_size=30, unique=True).map(
    lambda ticks: [1e-3 * t for t in sorted(ticks)]
)


@st.composite
def tables(draw) -> dict[str, list[float]]:
    times = draw(increasing_times)
    column = st.lists(numbers, min_size=len(times), max_size=len(times))
    return {"t_s": times, "u_N": draw(column), "q_m": draw(column)}


@pytest.fixture
def any_length(slider_task) -> Path:
    """The slider without a window, so that a log of any length will do."""
    slider_task.write_text(slider_task.read_text().replace("window = 0.5\n", ""))
    return slider_task


@QUICK
@given(table=tables(), delimiter=st.sampled_from(",;\t"), as_parquet=st.booleans())
def test_any_table_of_finite_numbers_round_trips(tmp_path, any_length, table, delimiter, as_parquet):
    if as_parquet:
        file = tmp_path / "run.parquet"
        parquet.write_table(pa.table(table), file)
    else:
        file = tmp_path / "run.csv"
        rows = [delimiter.join(map(repr, row)) for row in zip(*table.values(), strict=True)]
        csv(file, *rows, header=delimiter.join(table))
    log = import_log(files=[file], task=str(any_length), out=tmp_path / "run.zarr", force=True)
    again = MeasuredLog.read(tmp_path / "run.zarr")
    for found in (log, again):
        np.testing.assert_array_equal(found.time, table["t_s"])
        np.testing.assert_array_equal(found.inputs[:, 0], table["u_N"])
        np.testing.assert_array_equal(found.outputs[:, 0], table["q_m"])


cells = st.one_of(
    numbers.map(repr),
    st.sampled_from(
        ["", "nan", "inf", "-inf", "1e999", "x", '"', '""', "1,5", "\u00e9", "0x1F", "True", "1_0", "#N/A"]
    ),
    st.just("1e300"),
    st.text(max_size=4),
)


@QUICK
@given(table=tables(), data=st.data())
def test_a_corrupt_csv_is_read_or_refused_never_a_crash(tmp_path, any_length, table, data):
    rows = [list(map(repr, row)) for row in zip(*table.values(), strict=True)]
    header = list(table)
    how = data.draw(st.sampled_from(["cell", "column", "shuffle", "cut", "bytes"]))
    if how == "cell":
        data.draw(st.sampled_from([header, *rows]))[data.draw(st.integers(0, 2))] = data.draw(cells)
    elif how == "column":
        del header[data.draw(st.integers(0, 2))]
    elif how == "shuffle":
        rows = data.draw(st.permutations(rows))
    text = "\n".join([",".join(header), *(",".join(row) for row in rows)]).encode()
    if how == "cut":
        text = text[: data.draw(st.integers(0, len(text)))]
    elif how == "bytes":
        at = data.draw(st.integers(0, len(text)))
        text = text[:at] + data.draw(st.binary(min_size=1, max_size=4)) + text[at + 1 :]
    file = tmp_path / "run.csv"
    file.write_bytes(text)
    try:
        log = import_log(
            files=[file],
            task=str(any_length),
            out=tmp_path / "o.zarr",
            force=True,
            drop_nan=data.draw(st.booleans()),
            drop_repeats=data.draw(st.booleans()),
            drop_held=data.draw(st.booleans()),
        )
    except CaptureError as error:
        assert error.cure
    else:
        assert log.check() is log


@QUICK
@given(table=tables(), data=st.data())
def test_a_corrupt_parquet_is_read_or_refused_never_a_crash(tmp_path, any_length, table, data):
    how = data.draw(st.sampled_from(["column", "null", "kind", "bytes"]))
    name = data.draw(st.sampled_from(sorted(table)))
    columns = {key: pa.array(values) for key, values in table.items()}
    if how == "column":
        columns.pop(name)
    elif how == "null":
        columns[name] = pa.array([None, *table[name][1:]])
    elif how == "kind":
        count = len(table[name])
        other = data.draw(st.sampled_from(["x", b"x", [1.0], {"a": 1.0}, None, True, "1.5"]))
        columns[name] = pa.array([other] * count)
    file = tmp_path / "run.parquet"
    parquet.write_table(pa.table(columns), file)
    if how == "bytes":
        content = bytearray(file.read_bytes())
        content[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
        file.write_bytes(content)
    try:
        log = import_log(files=[file], task=str(any_length), out=tmp_path / "o.zarr", force=True)
    except CaptureError as error:
        assert error.cure
    else:
        assert log.check() is log


def test_a_parquet_whose_names_are_no_text_is_refused(tmp_path, any_length):
    file = tmp_path / "run.parquet"
    parquet.write_table(pa.table({"time_stamp": [0.0, 0.1]}), file)
    file.write_bytes(file.read_bytes().replace(b"time_stamp", b"time_stam\xff"))
    with pytest.raises(LogError, match="not a readable Parquet file"):
        import_log(files=[file], task=str(any_length), out=tmp_path / "o.zarr")


def test_records_of_columns_of_a_small_parquet_are_not_looked_at(tmp_path):
    """One that is damaged may end the process: a name in it that is no text stands for that."""
    file = tmp_path / "run.parquet"
    parquet.write_table(pa.table({"time_stamp": [0.0, 0.1]}), file)
    before, _, after = file.read_bytes().rpartition(b"\x0atime_stamp")  # of the chunk, behind the schema's
    assert b"time_stamp" in before
    file.write_bytes(before + b"\x0atime_stam\xff" + after)
    with pytest.raises(UnicodeDecodeError):
        parquet.ParquetFile(file).metadata.row_group(0).column(0).path_in_schema  # noqa: B018
    np.testing.assert_array_equal(open_source(file).numbers(["time_stamp"])[:, 0], [0.0, 0.1])


def test_place_counts_lines_as_an_editor_does(tmp_path):
    file = tmp_path / "run.csv"
    file.write_text("\n" + HEADER + "\n\n" + ROWS[0] + "\n\n" + ROWS[1] + "\n")
    source = open_source(file)
    assert [source.place(0), source.place(1)] == ["line 4", "line 6"]
