"""Models of strangers: what is wrong with one is said, with the element and the attribute, and in seconds."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

import mujoco
import numpy as np
import pytest
from conftest import SLIDER_XML
from inspecting import inspect
from setting_numbers import set_numbers

from capture_cli.errors import LogError, ModelError, shortened
from capture_cli.model.fields import ModelFields
from capture_cli.model.mjcf import limited_process, model_file
from capture_cli.model.mjcf.limited_process import Exceeded, limited
from capture_cli.model.mjcf.mjcf_writer import to_mjcf
from capture_cli.model.mjcf.model_file import compile_file, files_of
from capture_cli.model.target_names import parse_target
from capture_cli.stages import identify as identify_stage
from capture_cli.stages.record import record

NOBODY = 65534
STEP, MASS, SIZE = 'timestep="0.002"', 'mass="1.5"', "<worldbody>"
needs_copies = pytest.mark.skipif(not limited_process.CAN_LIMIT, reason="processes are not copied here")


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


@pytest.fixture(autouse=True)
def compiled_in_a_copy(monkeypatch):
    """As users' are."""
    monkeypatch.setattr(model_file, "CAN_LIMIT", limited_process.CAN_LIMIT)


@pytest.fixture
def model(tmp_path) -> Path:
    path = tmp_path / "model.xml"
    path.write_text(SLIDER_XML)
    return path


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        *((STEP, f'timestep="{value}"', "timestep = ") for value in ("0", "-0.01", "1e-12", "1e-7", "10")),
        *((STEP, f'timestep="{value}"', 'timestep="[a-z]+" of <option>') for value in ("nan", "inf")),
        (MASS, 'mass="nan"', 'mass="nan" of <geom>'),
        (MASS, 'mass="inf"', 'mass="inf" of <geom>'),
        ('damping="2"', 'damping="NaN"', 'damping="NaN" of <joint>'),
        ("0 0 0", "0 0 -inf", 'gravity="0 0 -inf" of <option>'),
        (SIZE, f'<size nuser_body="2000000000"/>{SIZE}', 'nuser_body="2000000000" of <size>'),
        (SIZE, f'<size nkey="1000000000"/>{SIZE}', 'nkey="1000000000" of <size>'),
        (SIZE, f'<size memory="5G"/>{SIZE}', 'memory="5G" of <size>'),
        (SIZE, f'<size njmax="{"9" * 400}"/>{SIZE}', "njmax=.* of <size>"),
        (SIZE, f'<option iterations="2000000000"/>{SIZE}', 'iterations="2000000000" of <option>'),
        (SIZE, f'{SIZE}<replicate count="1000000"><geom size="1"/></replicate>', 'count="1000000" of <replicate>'),
        (
            SIZE,
            f'{SIZE}<replicate count="3000"><replicate count="3000"><geom size="1"/></replicate></replicate>',
            'count="3000" of <replicate>.*made 3000 times',
        ),
    ],
)  # fmt: skip
def test_a_number_that_no_machine_has_is_named(model, old, new, named):
    edit(model, old, new)
    began = time.monotonic()
    with pytest.raises(ModelError, match=named) as caught:
        compile_file(model)
    assert time.monotonic() - began < 5
    assert "model.xml" in caught.value.message
    assert len(shortened(str(caught.value))) < 1000


def test_what_is_included_is_read_as_well(model):
    edit(model, MASS, 'mass="nan"')
    model.rename(model.with_name("carriage.xml"))
    model.write_text('<mujoco>\n  <include file="carriage.xml"/>\n</mujoco>')
    with pytest.raises(ModelError, match=r'mass="nan" of <geom> \(carriage.xml, line 6\)'):
        compile_file(model)


def test_names_may_read_like_numbers_that_are_none(model):
    text = model.read_text().replace('joint name="x"', 'joint name="inf"').replace('joint="x"', 'joint="inf"')
    model.write_text(text.replace('name="carriage"', 'name="NaN"'))
    compiled = compile_file(model)
    assert compiled.joint("inf").id == compiled.body("NaN").id - 1 == 0


def test_a_number_that_compilation_makes_infinite_is_named(model):
    edit(model, "<sensor>", '<keyframe><key name="far" qpos="1e308" time="1"/></keyframe><sensor>')
    edit(model, 'damping="2"', 'damping="2" range="-1e308 1e308" limited="true"')
    compile_file(model)  # large, and finite
    spec = mujoco.MjSpec.from_string(SLIDER_XML)
    spec.joint("x").springref = np.inf
    with pytest.raises(ModelError, match="qpos_spring is inf"):
        model_file.refuse_not_finite(model, spec.compile(), cure="")


def test_the_model_is_the_one_that_mujoco_compiles(model):
    spec = mujoco.MjSpec.from_file(str(model))
    model_file.free_centres(spec)
    models = compile_file(model), spec.compile()
    binaries = [np.zeros(mujoco.mj_sizeModel(m), dtype=np.uint8) for m in models]
    for own, binary in zip(models, binaries, strict=True):
        mujoco.mj_saveModel(own, buffer=binary)
    np.testing.assert_array_equal(*binaries)


# --- limits ---


@needs_copies
@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            SIZE,
            f'{SIZE}<replicate count="90000"><geom size="1"/></replicate>',
            r'takes more than 1 s; .* count="90000" of <replicate> \(model.xml, line 3\)',
        ),
        (
            SIZE,
            f'<asset><hfield name="h" nrow="99999" ncol="99999" size="1 1 1 1"/></asset>{SIZE}',
            r'GB of memory; .* nrow="99999" of <hfield> \(model.xml, line 3\)',
        ),
    ],
)
def test_what_takes_too_much_is_named(model, monkeypatch, old, new, told):
    set_numbers(monkeypatch, model_file, seconds=1.0)
    edit(model, old, new)
    with pytest.raises(ModelError, match=told) as caught:
        compile_file(model)
    assert caught.value.cure


def test_a_step_that_takes_too_long_is_no_step(model, monkeypatch):
    set_numbers(monkeypatch, model_file, slowest_step=-1.0)
    with pytest.raises(ModelError, match="one step of it takes"):
        compile_file(model)


def ends(how: Callable[[], object]) -> Callable[[], bytes]:
    def work() -> bytes:
        how()
        return b"done"

    return work


@needs_copies
@pytest.mark.parametrize(
    ("work", "told"),
    [
        (ends(os.abort), "ends the process .SIGABRT."),
        (ends(lambda: os._exit(3)), "ends the process"),
        (ends(lambda: time.sleep(60)), "takes more than 1 s"),
        (ends(lambda: all(True for _ in iter(int, 1))), "takes more than 1 s"),
        (ends(lambda: bytearray(1 << 29)), "GB of memory"),
        (ends(lambda: [][0]), "fails with IndexError"),
    ],
)
def test_whatever_the_work_does_the_process_goes_on(work, told, monkeypatch):
    made, fork = [], os.fork
    monkeypatch.setattr(os, "fork", lambda: made.append(fork()) or made[-1])
    with pytest.raises(Exceeded, match=told):
        limited(work, seconds=1.0, memory=1 << 28)
    (child,) = made
    with pytest.raises(ChildProcessError):  # it is not left; other tests' processes may be
        os.waitpid(child, os.WNOHANG)
    assert limited(ends(lambda: None), seconds=1.0, memory=1 << 28) == b"done"


@needs_copies
def test_what_the_work_refuses_is_refused_here(capfd):
    def refuse() -> None:
        os.write(1, b"nobody hears that")
        raise LogError("found that", cure="do this")

    with pytest.raises(LogError, match="found that") as caught:
        limited(ends(refuse), seconds=1.0, memory=1 << 28)
    assert caught.value.cure == "do this"
    assert capfd.readouterr() == ("", "")


@needs_copies
def test_a_large_answer_comes_whole():
    answer = bytes(range(256)) * (1 << 16)
    assert limited(lambda: answer, seconds=10.0, memory=1 << 28) == answer


# --- files ---


@contextmanager
def as_nobody():
    """Root may read everything; what it is not allowed is another user's."""
    if os.geteuid():
        yield
        return
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)


@pytest.fixture
def open_folder():
    """A folder that every user may look into."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


@pytest.mark.parametrize("unreadable", ["model.xml", "carriage.xml", "plate.stl", "."])
def test_a_file_that_may_not_be_read_is_not_called_empty(open_folder, unreadable):
    (open_folder / "carriage.xml").write_text(SLIDER_XML)
    (open_folder / "plate.stl").write_bytes(b"no mesh")
    model = open_folder / "model.xml"
    model.write_text(
        '<mujoco><include file="carriage.xml"/><asset><mesh name="plate" file="plate.stl"/></asset></mujoco>'
    )
    (open_folder / unreadable).chmod(0)
    with as_nobody(), pytest.raises(ModelError, match="may not be read") as caught:
        compile_file(model)
    (open_folder / unreadable).chmod(0o755)
    assert "permissions" in caught.value.cure
    assert unreadable in str(caught.value)


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("none.xml", "does not exist"),
        ("model.xml/none.xml", "does not exist"),
        ("folder.xml", "is a folder"),
        ("pipe.xml", "is a device or a pipe"),
        ("empty.xml", "is empty"),
        ("a\0b.xml", "cannot be read"),
        ("a" * 5000, "cannot be read"),
        ("\udcff.xml", "not UTF-8"),
    ],
)
def test_what_is_no_file_to_read_is_said(model, name, told):
    (model.parent / "folder.xml").mkdir()
    os.mkfifo(model.parent / "pipe.xml")
    (model.parent / "empty.xml").touch()
    (model.parent / "\udcff.xml").write_text(SLIDER_XML)
    for use in (compile_file, files_of):
        with pytest.raises(ModelError, match=told) as caught:
            use(model.parent / name)
        assert caught.value.cure
        assert len(shortened(str(caught.value))) < 1000


@pytest.mark.parametrize(
    "text", ["no XML", "<mujoco>", "<mujoco><arm/></mujoco>", '<mujoco><include file="a"/></mujoco>']
)
def test_what_mujoco_refuses_is_told_in_its_words(model, text):
    model.write_text(text)
    with pytest.raises(ModelError, match="does not compile") as caught:
        compile_file(model)
    assert caught.value.cure == "correct the MJCF at the place named"


# --- commands ---


@pytest.fixture
def log(slider_task) -> Path:
    """A log of the slider, 2 episodes of 1.5 s at 100 Hz."""
    edit(slider_task.with_name("model.xml"), 'joint="x"/></act', 'joint="x" ctrlrange="-3 3"/></act')
    path = slider_task.with_name("log.zarr")
    record(task=str(slider_task), out=path, noise=5e-4, episodes=2, duration=1.5, rate=100.0, threads=1)
    return path


@pytest.mark.parametrize("step", ["0.000001", "0.4"])
def test_a_time_step_has_to_suit_the_log(slider_task, log, monkeypatch, step):
    """A step that a model may have, of another log."""
    if step == "0.000001":
        set_numbers(monkeypatch, "capture_cli.log.step_length", most_per_sample=1000)
    edit(slider_task.with_name("model.xml"), STEP, f'timestep="{step}"')
    with pytest.raises(ModelError, match=f"the model steps by {float(step):g} s") as caught:
        identify_stage.identify(
            real_log=log, task=str(slider_task), out=log.with_name("e"), threads=1, quiet=True
        )
    found = [f for f in inspect(log, task=str(slider_task))["findings"] if f["severity"] == "error"]
    assert [f["cure"] for f in found] == [caught.value.cure]
    assert "<option>" in caught.value.cure


def test_every_command_says_so(slider_task, log, monkeypatch, capture):
    folder = slider_task.parent
    monkeypatch.chdir(folder)
    monkeypatch.setattr(identify_stage, "_write_pages", lambda *_: None)
    identify_stage.identify(
        real_log=log, task=str(slider_task), out=folder / "estimate", starts=1, threads=1, quiet=True
    )
    (folder / "log.csv").write_text("t_s,u_N,q_m\n" + "".join(f"{0.01 * i},0,0\n" for i in range(20)))
    edit(folder / "model.xml", MASS, 'mass="nan"')
    before = sorted(folder.iterdir())
    task = ("--task", "task.toml")
    for arguments in (
        ("identify", "--real-log", "log.zarr", *task, "--out", "o"),
        ("identify", "--real-log", "log.zarr", "--out", "o"),
        ("diagnose", "--real-log", "log.zarr", *task, "--out", "o"),
        ("diagnose", "--real-log", "log.zarr", "--estimate", "estimate", "--out", "o"),
        ("import-log", "log.csv", *task, "--out", "o.zarr"),
        ("inspect", "log.zarr", *task),
        ("record", *task, "--duration", "1", "--out", "o.zarr"),
        ("gen-histories", *task, "--window", "0.5", "--pairs", "2", "--out", "o.zarr"),
        ("propose", "estimate"),
        ("export", "estimate", "--out", "o.xml"),
        ("tasks", *task),
        ("effects", *task),
    ):
        code, _, err = capture(*arguments)
        assert code == 2, arguments
        assert 'mass="nan" of <geom> (model.xml, line 6)' in err, arguments
        assert err.splitlines()[-1].startswith("  cure: "), arguments
    assert sorted(folder.iterdir()) == before


def test_a_result_whose_model_is_none_any_more(slider_task, log, monkeypatch):
    """The model is refused, and not where the task is looked for."""
    from capture_cli.stages.export import export

    monkeypatch.chdir(slider_task.parent)
    monkeypatch.setattr(identify_stage, "_write_pages", lambda *_: None)
    identify_stage.identify(
        real_log=log, task="task.toml", out=Path("estimate"), starts=1, threads=1, quiet=True
    )
    Path("model.xml").write_text("no XML")
    with pytest.raises(ModelError, match=r"model\.xml does not compile"):
        export(result=Path("estimate"), out=Path("found.xml"))


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_values_that_no_model_can_have_are_not_exported(model, value):
    compiled = compile_file(model)
    fields = ModelFields(compiled, 1)
    parse_target("body:carriage:mass", compiled, "").write(fields, np.array([value]))
    with pytest.raises(ModelError) as caught:
        to_mjcf(model, fields, model.with_name("found.xml"))
    assert "identify again" in caught.value.cure or "explicit" in caught.value.cure
