"""Names, permissions, links and folders that a command meets, and that no strategy makes."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from pathlib import Path

from fuzz.cases import Case, Expected, refused, taken

NOT_UTF_8 = os.fsdecode(b"run\xff.csv")
DAC_OVERRIDE, DAC_READ_SEARCH = 1, 2  # rights by which root reads what nobody may
_VERSION = 0x20080522  # of what Linux is asked for rights by


def seeds(inputs: Path) -> list[Case]:
    run = (inputs / "run.csv").read_bytes()

    def seed(name: str, text: str, expected: Expected, needs: tuple[str, ...] = (), **more) -> Case:
        return Case(
            tuple(text.split(" ")),
            needs,
            more.pop("files", {}),
            more.pop("outputs", ()),
            expected,
            name,
            **more,
        )

    def closed(path: str, text: str, *needs: str) -> Case:
        """Its mode is 000."""
        read = path != "run.csv" or "inspect" not in text  # of any file `inspect` says what reads it
        end = refused("permissions") if read else refused("import-log")
        return seed(
            f"mode 000: {path}, {text.split()[0]}", text, end, needs, prepare=mode(path), enter=without_rights
        )

    return [
        *(
            closed(path, text, *needs)
            for path, text, *needs in (
                ("run.csv", "import-log run.csv --task machine --out new", "run.csv", "machine"),
                ("run.csv", "inspect run.csv --task machine", "run.csv", "machine"),
                ("run.parquet", "import-log run.parquet --task machine --out new", "run.parquet", "machine"),
                ("machine", "tasks --task machine", "machine"),
                ("machine/task.toml", "tasks --task machine", "machine"),
                ("machine/model.xml", "tasks --task machine", "machine"),
                ("machine/model.xml", "record --task machine --duration 0.1 --out new", "machine"),
                ("log.zarr", "inspect log.zarr", "log.zarr"),
                (
                    "log.zarr/zarr.json",
                    "identify --real-log log.zarr --task machine --out new",
                    "log.zarr",
                    "machine",
                ),
                (
                    "log.zarr/data/time/c/0",
                    "identify --real-log log.zarr --task machine --out new",
                    "log.zarr",
                    "machine",
                ),
                ("estimate/estimate.json", "export estimate --out new.xml", "estimate", "machine"),
                ("estimate", "propose estimate", "estimate", "machine"),
                (
                    "proposal.json",
                    "record --task machine --inputs-from proposal.json --out new",
                    "machine",
                    "proposal.json",
                ),
                ("policy/policy.safetensors", "record --task scooping --policy policy --out new", "policy"),
                ("histories.zarr", "inspect histories.zarr", "histories.zarr"),
            )
        ),
        seed(
            "a folder that may not be written to",
            "record --task machine --duration 0.1 --out shut/new",
            refused("may write to"),
            ("machine",),
            prepare=mode("shut", 0o500),
            enter=without_rights,
        ),
        seed(
            "a name that is not UTF-8",
            f"import-log {NOT_UTF_8} --task machine --out new",
            refused("UTF-8"),
            ("machine",),
            files={NOT_UTF_8: run},
        ),
        seed(
            "a name that is not UTF-8, inspected",
            f"inspect {NOT_UTF_8}",
            refused("UTF-8"),
            files={NOT_UTF_8: run},
        ),
        seed(
            "an output that is not UTF-8",
            f"record --task machine --duration 0.1 --out {NOT_UTF_8}",
            refused("UTF-8"),
            ("machine",),
        ),
        seed("a current folder that was deleted", "inspect log.zarr", refused("deleted"), enter=leave),
        seed(
            "a current folder that was deleted, recorded",
            "record --task air-hockey --out new",
            refused("deleted"),
            enter=leave,
        ),
        seed(
            "a pipe for a log",
            "import-log run.csv --task machine --out new",
            refused("pipe"),
            ("machine",),
            prepare=pipe("run.csv"),
        ),
        seed(
            "a pipe for a task",
            "tasks --task machine/task.toml",
            refused("nor a file"),
            ("machine",),
            prepare=pipe("machine/task.toml"),
        ),
        seed(
            "a folder for a log",
            "import-log run.csv --task machine --out new",
            refused(),
            ("machine",),
            files={"run.csv/x": b""},
        ),
        seed(
            "a link that leads to itself", "inspect log.zarr", refused(), prepare=link("log.zarr", "log.zarr")
        ),
        seed(
            "a lock that is a link to a file",
            "record --task machine --duration 0.1 --out new.zarr",
            taken(),
            ("machine", "run.csv"),
            prepare=link(".new.zarr.lock", "run.csv"),
            outputs=("new.zarr", "new.truth.json", ".new.zarr.lock"),
        ),
        seed(
            "a lock that is a link, of an append",
            "import-log run.csv --task machine --append --out log.zarr",
            refused("lock"),
            ("machine", "run.csv", "log.zarr"),
            prepare=link(".log.zarr.lock", "machine/task.toml"),
        ),
        seed(
            "an output that is a link",
            "record --task machine --duration 0.1 --out new.zarr",
            refused("link"),
            ("machine", "log.zarr"),
            prepare=link("new.zarr", "log.zarr"),
        ),
        seed(
            "an output that is an input",
            "import-log run.csv --task machine --out run.csv --force",
            refused(),
            ("machine", "run.csv"),
        ),
        seed(
            "a device for an output",
            "record --task machine --duration 0.1 --out pipe --force",
            refused("pipe"),
            ("machine",),
            prepare=pipe("pipe"),
        ),
        seed(
            "a device that never ends for a log",
            "import-log /dev/zero --task machine --out new",
            refused("device"),
            ("machine",),
        ),
    ]


def mode(path: str, bits: int = 0) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        (folder / path).mkdir(exist_ok=True) if not (folder / path).exists() else None
        (folder / path).chmod(bits)

    return change


def pipe(path: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        (folder / path).unlink(missing_ok=True)
        os.mkfifo(folder / path)

    return make


def link(path: str, target: str) -> Callable[[Path], None]:
    return lambda folder: (folder / path).symlink_to(target)


def leave() -> None:
    """Delete the current folder."""
    gone = Path("gone")
    gone.mkdir()
    os.chdir(gone)
    Path("../gone").rmdir()


def without_rights() -> None:
    """Let this process, where it is root's, read no more than other users may."""
    if os.geteuid():
        return
    libc = ctypes.CDLL(None, use_errno=True)
    header, rights = (ctypes.c_uint32 * 2)(_VERSION, 0), (ctypes.c_uint32 * 6)()
    if libc.capget(header, rights):
        raise OSError(ctypes.get_errno(), "the rights of this process are not told")
    rights[0] &= ~(1 << DAC_OVERRIDE | 1 << DAC_READ_SEARCH)
    if libc.capset(header, rights):
        raise OSError(ctypes.get_errno(), "the rights of this process are not given up")
