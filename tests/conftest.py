"""A small machine to test on, and the real logs where they are at hand."""

from __future__ import annotations

import gc
import os
import shutil
import signal
import sys
import tempfile
from pathlib import Path

# As the command line does, before numpy is loaded: threads for small matrices only wait for each other.
for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

# Modules are compiled by the first process that imports them. Where the environment forbids to keep that beside them,
# as that of containers does, each of the hundreds of processes that tests begin would compile a thousand modules anew,
# for 2 s. It is kept with what else pytest keeps, so that the next run compiles only what has changed.
COMPILED = Path(__file__).resolve().parents[1] / ".pytest_cache" / "compiled"
KEPT_APART = bool(os.environ.pop("PYTHONDONTWRITEBYTECODE", None))  # in workers it is not set any more
if KEPT_APART:
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix = str(COMPILED)
    sys.dont_write_bytecode = False

import pytest  # noqa: E402
from warm_capture import DRAWS, begin_few_threads  # noqa: E402

from capture_cli.cli import main  # noqa: E402
from capture_cli.common.extras import EXTRAS, missing  # noqa: E402
from capture_cli.common.signals import ENDING  # noqa: E402
from capture_cli.model.mjcf import model_file  # noqa: E402
from capture_cli.store.output import PLACED  # noqa: E402

SLIDER_XML = """\
<mujoco model="slider">
  <option timestep="0.002" gravity="0 0 0" integrator="implicitfast"/>
  <worldbody>
    <body name="carriage">
      <joint name="x" type="slide" axis="1 0 0" damping="2"/>
      <geom type="box" size="0.1 0.1 0.05" mass="1.5"/>
    </body>
  </worldbody>
  <actuator><motor name="drive" joint="x"/></actuator>
  <sensor><jointpos name="q" joint="x"/></sensor>
</mujoco>
"""

SLIDER_TOML = """\
format = 1
name = "slider"
model = "model.xml"

[parameters.mass]
set = "body:carriage:mass"
low = 0.5
high = 4.0
unit = "kg"

[parameters.damping]
set = "joint:x:damping"
low = 0.0
high = 8.0
unit = "N s/m"

[inputs.drive]
column = "u_N"
unit = "N"

[outputs.q]
column = "q_m"
unit = "m"

[log]
time = "t_s"
window = 0.5
"""

REAL_DATA = Path(__file__).resolve().parents[1] / ".." / "shared" / "data"


def pytest_collection_finish() -> None:
    """What is there stays: it is not looked through for garbage, and copies of the process share it."""
    gc.collect()
    gc.freeze()


def pytest_unconfigure() -> None:
    if KEPT_APART:  # copies of the package, which no other run reads
        folder = Path(tempfile.gettempdir())
        shutil.rmtree(COMPILED / folder.relative_to(folder.anchor), ignore_errors=True)


def _extra(name: str):
    """A fixture called like the extra: what needs it is skipped without. `make test` has them all (test_extras.py)."""

    @pytest.fixture(scope="session", name=name)
    def installed() -> None:
        if missing(name):
            pytest.skip(f"needs the extra {name}: no {', '.join(missing(name))}")

    return installed


learn, robosuite, ray = map(_extra, EXTRAS)


@pytest.fixture(autouse=True)
def signals_as_they_were():
    """`capture_cli.cli.main` heeds none any more when it returns: its process is about to end."""
    before, hook = {number: signal.getsignal(number) for number in ENDING}, sys.unraisablehook
    yield
    sys.unraisablehook = hook
    for number, handler in before.items():
        signal.signal(number, handler)
    PLACED.clear()  # a run places a few outputs, and looks through all of them; the tests place thousands


@pytest.fixture(autouse=True, scope="session")
def models_are_compiled_here():
    """Not in a copy of this process, which takes the longer the more it holds: test_model_file.py tests that."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(model_file, "CAN_LIMIT", False)
        yield


@pytest.fixture(autouse=True, scope="session")
def nothing_is_synced():
    """For that a log, of a few milliseconds of work, would wait for the disk twenty times: test_stores.py tests it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


@pytest.fixture(autouse=True, scope="session")
def few_threads_are_begun():
    with pytest.MonkeyPatch.context() as patch:
        begin_few_threads(patch.setattr)
        yield


@pytest.fixture
def slider_task(tmp_path: Path) -> Path:
    """The task.toml of a slider driven by a force: mass and damping are open, its position is measured."""
    folder = tmp_path / "slider"
    folder.mkdir()
    (folder / "model.xml").write_text(SLIDER_XML)
    path = folder / "task.toml"
    path.write_text(SLIDER_TOML)
    return path


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real logs: $CAPTURE_REAL_DATA, or ../shared/data from the repository; skips without."""
    path = Path(os.environ.get("CAPTURE_REAL_DATA", REAL_DATA))
    if not path.is_dir():
        pytest.skip(f"no real logs at {path}: set CAPTURE_REAL_DATA to the folder that holds them")
    return path.resolve()


@pytest.fixture
def capture(capsys, monkeypatch, tmp_path):
    """Runs `capture ARGUMENTS` in this process and in tmp_path: (exit code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["capture", *map(str, arguments)])
        capsys.readouterr()
        try:
            main()
            code = 0
        except SystemExit as ended:
            code = ended.code or 0
        out, err = capsys.readouterr()
        return code, out, err

    return run


def draw_nothing(patch: pytest.MonkeyPatch) -> None:
    """No stage draws a page or a figure from here on: reports have tests of their own."""
    for drawing in DRAWS.values():
        patch.setattr(f"capture_cli.{drawing}", lambda *_: None)


@pytest.fixture
def without_pages(monkeypatch):
    draw_nothing(monkeypatch)
