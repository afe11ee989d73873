"""`capture` run in a copy of this process, which has imported it already: within limits, and how it ended."""

from __future__ import annotations

import faulthandler
import gc
import importlib
import io
import os
import pkgutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from capture_cli.model.mjcf.limited_process import bytes_taken

if sys.platform != "win32":
    import resource

CAN_RUN = sys.platform == "linux"
LONGEST = 20.0  # s
MOST_MEMORY = 2 << 30  # bytes
STOPPED_AT = (
    4 << 30
)  # bytes of data that a run may ask for beside what this process has: more would harm the machine
MOST_SHOWN = 1 << 20  # bytes of what it says
WARM = (
    "typer._adapters",
    "tomllib",
    "pyarrow.compute",
    "numpy",
    "scipy.optimize",
    "scipy.signal",
    "mujoco",
    "zarr",
    "pyarrow.csv",
    "pyarrow.parquet",
    "rich.table",
    "safetensors.numpy",
    "jinja2",
    "matplotlib.figure",
    "matplotlib.backends.backend_agg",
    "plotly.graph_objects",
    "pydantic.plugin._loader",
)
ROOMS = (
    "cli",
    "stages",
    "store",
    "log",
    "model",
    "simulate",
    "estimate",
    "select",
    "report",
    "context.identifiers",
    "context.policies",
)
SLOW_IMPORTS = (  # in the name of a module: those who need them import them
    "training",
    "train_",
    "torch",
    "transformer",
    "_env",
    "ray",
)
_PAUSES = (0.001, 0.02)  # s, shortest and longest, between looks at a run


@dataclass(frozen=True)
class Ended:
    """code: None where it was ended after LONGEST, negative for a signal. memory: bytes, of its largest process.

    left: whether processes of it were still there.
    """

    code: int | None
    stdout: str
    stderr: str
    seconds: float
    memory: int
    left: bool = False


def warm_up() -> None:
    """Import what commands import, so that its copies need not."""
    os.environ.setdefault("MUJOCO_GL", "disable")
    for name in WARM:
        importlib.import_module(name)
    for room in ROOMS:
        package = importlib.import_module(f"capture_cli.{room}")
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not any(word in module.name for word in SLOW_IMPORTS):
                importlib.import_module(module.name)
    _build_commands()
    gc.collect()
    gc.freeze()  # it stays where it is: copies share it


def _build_commands() -> None:
    """Once, rather than in every copy: it takes as long as a short command."""
    import typer.main

    from capture_cli.cli.app import app

    built = typer.main.get_command(app)
    for command in built.commands.values():
        for parameter in command.params:
            parameter.get_runtime_param()
    typer.main.get_command = lambda _: built


def run(
    arguments: Sequence[str],
    folder: Path,
    temporary: Path,
    *,
    enter: Callable[[], None] | None = None,
    seconds: float = LONGEST,
) -> Ended:
    """`capture ARGUMENTS` in `folder`. temporary: where it finds room for files of its own. enter: see Case."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        began = time.monotonic()
        child = os.fork()
        if not child:
            _be_capture(arguments, folder, temporary, enter, out.fileno(), err.fileno())
        status, usage = _waited(child, began + seconds)
        taken = time.monotonic() - began
        left = _end_group(child)
        code = None if status is None else os.waitstatus_to_exitcode(status)
        return Ended(code, _text(out), _text(err), taken, usage.ru_maxrss * 1024, left and code is not None)


def _waited(child: int, deadline: float) -> tuple[int | None, resource.struct_rusage]:
    pause, longest = _PAUSES
    while True:
        done, status, usage = os.wait4(child, os.WNOHANG)
        if done:
            return status, usage
        if time.monotonic() > deadline:
            _end_group(child)
            os.kill(child, signal.SIGKILL)
            return None, os.wait4(child, 0)[2]
        time.sleep(pause)
        pause = min(2 * pause, longest)


def _end_group(leader: int) -> bool:
    """Kill what is left of the processes that a run began; whether there were any."""
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(leader, signal.SIGKILL)
        return True
    return False


def _text(file) -> str:
    file.seek(0)
    return file.read(MOST_SHOWN).decode(errors="replace")


def _be_capture(
    arguments: Sequence[str],
    folder: Path,
    temporary: Path,
    enter: Callable[[], None] | None,
    out: int,
    err: int,
) -> NoReturn:
    """What the copy of the process does: no more than this, whatever happens."""
    code = 1
    try:
        faulthandler.disable()
        os.setsid()
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(out, 1)
        os.dup2(err, 2)
        sys.stdout, sys.stderr = (
            io.TextIOWrapper(io.FileIO(n, "w"), "utf-8", write_through=True) for n in (1, 2)
        )
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        os.environ.update(TMPDIR=str(temporary), MUJOCO_GL="disable", COLUMNS="120")
        tempfile.tempdir = None
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        most = bytes_taken() + STOPPED_AT
        resource.setrlimit(resource.RLIMIT_DATA, (most, most))
        os.chdir(folder)
        if enter:
            enter()
        code = _main(arguments)
    except BaseException:
        traceback.print_exc()
    finally:
        with suppress(BaseException):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)


def _main(arguments: Sequence[str]) -> int:
    from capture_cli.cli import main

    sys.argv = ["capture", *arguments]
    try:
        main()
    except SystemExit as ended:
        return ended.code or 0
    return 0
