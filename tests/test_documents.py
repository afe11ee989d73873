"""Documents of any writer: what is read, what is refused and in which words, wherever a document is read."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest
from warm_capture import warm_capture

from capture_cli.common.documents import SETTINGS as DOCUMENTS
from capture_cli.common.documents import parse_json, read_json, read_toml
from capture_cli.errors import LONGEST, OptionError, StoreError, TaskError, shortened
from capture_cli.log.checks.base import finding

DEEP = "[" * 100_000
OTHER_FAULTS = {  # of a value: as TOML and JSON write it, and what the message has
    "400-digits": ("9" * 400, "19 are the most"),
    "5000-digits": ("9" * 5000, "19 are the most"),
    "infinite": ("1e999", "finite number"),
    "deep": (DEEP, f"more than {DOCUMENTS.deepest} levels deep"),
    "zero-character": (r'"a\u0000b"', "the control character U+0000"),
    "escape": (r'"a\u001b[31mb"', "the control character U+001B"),
}
JSON_FAULTS = {
    **OTHER_FAULTS,
    "half-a-character": (r'"\ud800"', "half of a surrogate pair"),
    "nan": ("NaN", "finite number"),
    "many-parts": ("[" + "[]," * DOCUMENTS.most_parts + "[]]", f"{DOCUMENTS.most_parts} are the most"),
    "65-levels": ("[" * 65 + "]" * 65, "levels deep"),
    "no-json": ("{", "is not JSON"),
}
TOML_FAULTS = {
    **OTHER_FAULTS,
    "hexadecimal": ("0x" + "f" * 400, "19 are the most"),
    "nan": ("nan", "finite number"),
    "no-toml": ("{", "is not TOML"),
}


@pytest.mark.parametrize("name", JSON_FAULTS)
def test_what_json_may_not_hold_is_named(tmp_path, name):
    text, named = JSON_FAULTS[name]
    path = tmp_path / "a.json"
    path.write_text(f'{{"rows": [1, {{"width": {text}}}]}}')
    with pytest.raises(StoreError) as caught:
        read_json(path, StoreError, cure="write it again")
    assert named in caught.value.message and str(path) in caught.value.message
    assert caught.value.cure == "write it again"
    if name in ("400-digits", "infinite", "nan"):
        assert "rows[1].width" in caught.value.message


@pytest.mark.parametrize("name", TOML_FAULTS)
def test_what_toml_may_not_hold_is_named(tmp_path, name):
    text, named = TOML_FAULTS[name]
    path = tmp_path / "a.toml"
    path.write_text(f"x = 1\n[parameters.mass]\nlow = {text}\n")
    with pytest.raises(TaskError) as caught:
        read_toml(path, TaskError)
    assert named in caught.value.message and str(path) in caught.value.message


def test_a_key_with_a_hundred_thousand_points_takes_no_time(tmp_path):
    """tomllib takes a time that grows with the square of their number."""
    for key in (".".join("a" * 100_000), ".".join(['"a"'] * 50_000), "a" * 200_000):
        path = tmp_path / "a.toml"
        path.write_text(f"{key} = 1\n")
        if "." in key:
            with pytest.raises(TaskError, match=r"line 1.* levels deep"):
                read_toml(path, TaskError)
        else:
            assert len(read_toml(path, TaskError)) == 1


def test_names_are_read_as_values_are(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text('[outputs."pos\\u0000x"]\nunit = "m"\n')
    with pytest.raises(TaskError, match=r"outputs\.pos\\x00x has the control character U\+0000"):
        read_toml(path, TaskError)
    with pytest.raises(StoreError, match="surrogate"):
        parse_json(r'{"\udc00": 1}', "the header", StoreError, cure="none")


def test_what_is_sound_is_read(tmp_path):
    document = {"a": [1, -(2**63), 2**63 - 1, 1e308, None, True], "ü\n\t": {"": []}}
    path = tmp_path / "a.json"
    path.write_text(json.dumps(document))
    assert read_json(path, StoreError, cure="none") == document
    large = '{"state": 340282366920938463463374607431768211455, "loss": Infinity}'
    assert parse_json(large, "here", StoreError, cure="none", any_numbers=True)["state"] == 2**128 - 1


def test_what_is_no_file_is_said(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "large.toml").write_bytes(b"#" * (DOCUMENTS.largest_toml + 1))
    (tmp_path / "latin.toml").write_bytes(b'a = "\xe4"')
    cases = {
        "missing": "does not exist",
        "": "is a folder",
        "pipe": "is a device or a pipe",
        "large.toml": f"more than {DOCUMENTS.largest_toml} bytes",
        "latin.toml": "is not UTF-8 text: invalid continuation byte at byte 5",
        "a" * 5000: "File name too long",
        "a\0b": "null byte",
        "latin.toml/x": "does not exist",
    }
    for name, named in cases.items():
        with pytest.raises(OptionError) as caught:
            read_toml(tmp_path / name, OptionError, called="--config FILE")
        assert named in caught.value.message and caught.value.message.startswith("--config FILE"), name


def test_a_file_that_may_not_be_read_is_said(tmp_path, monkeypatch):
    path = tmp_path / "a.json"
    path.write_text("{}")

    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    for name in ("open", "stat"):
        with monkeypatch.context() as patched:
            patched.setattr(Path, name, refuse)
            with pytest.raises(StoreError) as caught:
                read_json(path, StoreError, cure="none")
        assert "may not be read: Permission denied" in caught.value.message
        assert "permissions" in caught.value.cure


@pytest.fixture
def without_rights(tmp_path):
    """Runs `capture ARGUMENTS` where files of mode 000 may not be read; root gives that right up."""
    under = []
    if os.geteuid() == 0:
        if shutil.which("setpriv") is None:
            pytest.skip("root may read every file, and there is no setpriv to give that up")
        rights = "-dac_override,-dac_read_search"
        under = ["setpriv", f"--bounding-set={rights}", f"--inh-caps={rights}"]
        done = subprocess.run([*under, "true"], capture_output=True, text=True)
        if done.returncode != 0:
            pytest.skip(f"root may read every file, and may not give that up here: {done.stderr}")
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[1])}
    with warm_capture("import_log", "record", "inspect", under=under, environment=environment) as program:

        def run(*arguments):
            return subprocess.run(
                [*program, *map(str, arguments)], capture_output=True, text=True, cwd=tmp_path
            )

        yield run


def test_files_and_folders_of_mode_000_are_said(without_rights, slider_task, tmp_path):
    (tmp_path / "run.csv").write_text("t_s,u_N,q_m\n0,0,0\n1,0,0\n")
    (tmp_path / "a.json").write_text("{}")
    (tmp_path / "closed").mkdir()
    shutil.copytree(slider_task.parent, tmp_path / "task")
    shutil.copytree(slider_task.parent, tmp_path / "model")
    closed = ["run.csv", "a.json", "closed", "task/task.toml", "model/model.xml"]
    for name in closed:
        (tmp_path / name).chmod(0)
    commands = [
        ("import-log", "run.csv", "--task", slider_task, "--out", "x.zarr"),
        ("record", "--config", "a.json"),
        ("record", "--task", "air-hockey", "--actions-from", "a.json", "--out", "x.zarr"),
        ("tasks", "--task", "task"),
        ("tasks", "--task", "closed/task.toml"),
        ("tasks", "--task", "model"),
        ("inspect", "closed"),
        ("inspect", "closed/x.zarr"),
        ("identify", "--real-log", "closed"),
        ("export", "closed", "--out", "x.xml"),
        ("record", "--task", slider_task, "--out", "closed/x.zarr"),
    ]
    try:
        for command in commands:
            done = without_rights(*command)
            assert done.returncode == 2, (command, done.stderr)
            assert "permissions" in done.stderr or "write to" in done.stderr, (command, done.stderr)
            assert done.stderr.splitlines()[-1].startswith("  cure: "), (command, done.stderr)
    finally:
        for name in closed:
            (tmp_path / name).chmod(0o700)


# --- wherever a document is read ---


@pytest.fixture(scope="module")
def shipped() -> Path:
    return Path(__file__).resolve().parents[1] / "runs" / "policies" / "air-hockey"


def header(fault: str) -> bytes:
    text = f'{{"a": {fault}}}'.encode()
    return len(text).to_bytes(8, "little") + text


READERS = {  # how a document is read: what is written, from a fault, and the command
    "task": (lambda fault: f"format = {fault}", "task.toml", ["tasks", "--task"]),
    "config": (lambda fault: f"seed = {fault}", "run.toml", ["record", "--config"]),
    "proposal": (
        lambda fault: f'{{"format": "capture/proposal", "version": {fault}}}',
        "p.json",
        ["record", "--task", "air-hockey", "--out", "x.zarr", "--actions-from"],
    ),
    "result": (
        lambda fault: f'{{"format": "capture/estimate", "version": {fault}}}',
        "e/estimate.json",
        ["export", "e", "--out"],
    ),
    "weights": (header, "policy/policy.safetensors", ["inspect", "policy", "--json"]),
}


@pytest.mark.parametrize("fault", ["400-digits", "5000-digits", "deep", "zero-character"])
@pytest.mark.parametrize("reader", READERS)
def test_every_reader_refuses_alike(capture, tmp_path, shipped, reader, fault):
    write, name, command = READERS[reader]
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    if reader == "weights":
        shutil.copy(shipped / "policy.json", path.parent)
    text, named = OTHER_FAULTS[fault]
    content = write(text)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    takes = [] if reader == "weights" else ["out.xml"] if reader == "result" else [path]
    code, out, err = capture(*command, *takes)
    said = out if reader == "weights" else err
    assert code == 2, err
    assert named in said
    assert len(err) <= LONGEST + 1
    if reader != "weights":
        assert err.splitlines()[-1].startswith("  cure: ")


@pytest.mark.parametrize("fault", ["400-digits", "5000-digits", "deep", "not-utf-8"])
def test_a_provenance_that_cannot_be_read_is_a_warning(capture, tmp_path, shipped, fault):
    shutil.copytree(shipped, tmp_path / "policy")
    content = OTHER_FAULTS[fault][0].encode() if fault in OTHER_FAULTS else b"\xff"
    (tmp_path / "policy" / "provenance.json").write_bytes(content)
    code, out, _ = capture("inspect", "policy", "--json")
    assert code == 0
    assert "provenance.json" in {f["where"] for f in json.loads(out)["findings"]}


def test_weights_that_no_training_makes_are_refused(capture, tmp_path, shipped):
    import numpy as np

    from capture_cli.store.tensors import read_arrays, save_arrays

    arrays, _ = read_arrays(shipped / "policy.safetensors", "none")
    for name, change, named in (
        ("int32", lambda a: a.astype(np.int32), "is of type int32; expected floating point"),
        ("1e30", lambda a: a * 0 + np.float32(1e30), "holds 1e+30, which no training ends with"),
        ("nan", lambda a: a * np.nan, "is not finite"),
    ):
        folder = tmp_path / name
        shutil.copytree(shipped, folder)
        save_arrays(folder / "policy.safetensors", {n: change(a) for n, a in arrays.items()})
        code, out, _ = capture("inspect", folder, "--json")
        assert code == 2 and named in out
        record = ("record", "--task", "air-hockey", "--policy", folder, "--out", "x.zarr")
        code, _, err = capture(*record)
        assert code == 2 and named in err


# --- messages ---


def test_a_message_is_cut_and_keeps_its_cure():
    message = f"error: {'a' * 40_000} is too long\n  cure: shorten it"
    short = shortened(message)
    assert len(short) <= LONGEST
    assert short.startswith("error: aaa") and short.endswith("is too long\n  cure: shorten it")
    assert len(shortened(f"{message}{'b' * 40_000}")) <= LONGEST
    assert shortened("error: a\n  cure: b") == "error: a\n  cure: b"


def test_a_finding_is_cut_as_a_message_is():
    found = finding("error", "store", f"it is {'a' * 5000} long", "b" * 5000)
    assert len(found["message"]) + len(found["cure"]) < LONGEST + 1
    assert found["message"].startswith("it is aaa") and found["message"].endswith("a long")
    assert finding("note", "store", "a", "b")["message"] == "a"


def test_a_message_does_not_move_the_cursor_of_a_terminal():
    assert shortened("error: a\x1b[2Jb\rc\n  cure: d") == "error: a\\x1b[2Jb\\rc\n  cure: d"


def test_a_cure_is_one_line():
    assert (
        str(OptionError("a", cure="give it\nanother name")).splitlines()[-1] == "  cure: give it another name"
    )


def test_usage_errors_end_with_a_cure(capture):
    for arguments in (
        ["identify"],
        ["--bogus"],
        ["identfy"],
        ["record", "--episods", "3"],
        ["inspect", "a", "b"],
    ):
        code, out, err = capture(*arguments)
        assert (code, out) == (2, "")
        assert err.startswith("error: ") and err.splitlines()[-1].startswith("  cure: ")


def test_markup_in_names_and_units_is_text(capture, slider_task):
    text = slider_task.read_text().replace("[parameters.mass]", '[parameters."[/] :smile:"]')
    text = text.replace('unit = "kg"', 'unit = "[/bold]"').replace('name = "slider"', 'name = "[/]"')
    slider_task.write_text(text.replace('column = "q_m"', 'column = "[red]"'))
    code, out, err = capture("tasks", "--task", slider_task)
    assert code == 0, err
    assert "[/] :smile:" in out and "[/bold]" in out and "[red]" in out


# --- surroundings ---


def test_the_system_says_no(capture, monkeypatch, tmp_path):
    """What the system refuses is the user's to mend, wherever it comes up."""
    for number, name in ((13, "x/y"), (36, "a" * 5000), (40, "loop")):
        error = OSError(number, os.strerror(number), name)

        def refuse(*_, _error=error, **__):
            raise _error

        monkeypatch.setattr("capture_cli.stages.inspect.inspect", refuse)
        code, out, err = capture("inspect", "anything")
        assert (code, out) == (2, "")
        assert name[:20] in err and os.strerror(number) in err
        assert len(err) <= LONGEST + 1 and err.splitlines()[-1].startswith("  cure: ")


def test_a_name_that_is_not_utf_8_is_refused(capture, tmp_path):
    name = os.fsdecode(b"log\xff.csv")
    (tmp_path / name).write_text("t,q\n0,1\n")
    code, _, err = capture("inspect", name)
    assert code == 2
    assert "is not UTF-8" in err and "another name" in err


def test_a_current_folder_that_is_gone(capture, tmp_path, monkeypatch):
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    code, _, err = capture("inspect", "x.zarr")
    assert code == 2
    assert "the current folder was deleted" in err


def test_a_model_whose_path_has_5000_characters(capture, slider_task):
    slider_task.write_text(slider_task.read_text().replace("model.xml", "m" * 5000))
    code, _, err = capture("tasks", "--task", slider_task)
    assert code == 2
    assert "File name too long" in err and len(err) <= LONGEST + 1
