"""`capture` for scripts: every command in a copy of one process, which has imported what commands import.

That is most of what a small command takes. The copies share nothing but files, as processes of their own do.
"""

from __future__ import annotations

import asyncio
import importlib
import io
import json
import os
import socket
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

CLIENT = """
import json, os, socket, sys

with socket.socket(socket.AF_UNIX) as server:
    server.connect({address!r})
    socket.send_fds(server, [json.dumps([os.getcwd(), sys.argv[1:]]).encode()], [0, 1, 2])
    sys.exit(int(server.recv(16)))
"""
LONGEST = 1 << 16  # bytes of the arguments of a command
TRAINING = (  # what stages that train import when they do; torch the last of them when it has an optimiser
    "capture_cli.context.policies._sac_training",
    "capture_cli.context.identifiers._training",
    "torch._dynamo",
)
DRAWS = {  # what of a stage draws its pages and figures, in capture_cli
    "train_policy": "report.training.write_policy_figure",
    "train_sysid": "report.training.write_identifier_figure",
    "identify": "stages.identify._write_pages",
    "diagnose": "stages.diagnose._write_pages",
    "eval_sim2sim": "report.evaluation_figures.write_figures",
}


@contextmanager
def warm_capture(
    *stages: str,
    undrawn: Sequence[str] = (),
    among: Sequence[str] = (),
    under: Sequence[str] = (),
    environment: Mapping[str, str] = os.environ,
) -> Iterator[list[str]]:
    """A program, as the words of its command line, that does what `capture` does while the context lasts.

    stages: modules of capture_cli.stages that it has imported. undrawn: those that draw no page and no figure. among:
    kinds of effects that diagnoses look for; all where there are none. under: words of a command that begins it.
    """
    with tempfile.TemporaryDirectory() as folder:
        address, client = f"{folder}/address", Path(folder) / "capture.py"
        client.write_text(CLIENT.format(address=address))
        asked = json.dumps([address, stages, undrawn, among])
        command = [*under, sys.executable, __file__, asked]
        with subprocess.Popen(command, stdout=subprocess.PIPE, env={**environment}) as server:
            try:
                assert server.stdout.readline() == b"ready\n"
                yield [sys.executable, "-I", "-S", str(client)]
            finally:
                server.kill()


def begin_few_threads(put: Callable[[Any, str, Any], None]) -> None:
    """zarr begins no thread for each file of a store, which takes as long as to write it; and beside other workers of
    the tests MuJoCo simulates on one thread, and work is done by one process, where all cores are asked for: threads
    wait for each other at every step, copies of a process are made for seconds of work, and all give the same bits
    however many they are. put: setattr, or what takes it back later.
    """
    from mujoco import batch

    from capture_cli.common import processes

    begin = batch.Batch.__init__

    async def here(function, *arguments, **options):
        return function(*arguments, **options)

    def begun(self, model, nsim, nthread=0, persistent=False):
        begin(self, model, nsim, nthread or 1, persistent)

    put(asyncio, "to_thread", here)
    if "PYTEST_XDIST_WORKER" in os.environ:
        put(batch.Batch, "__init__", begun)
        put(processes, "_cores", lambda: 1)


def serve(address: str, stages: Sequence[str], undrawn: Sequence[str], among: Sequence[str]) -> None:
    """One command after another, each in a copy of this process."""
    importlib.import_module("capture_cli.cli.app")
    for stage in stages:
        importlib.import_module(f"capture_cli.stages.{stage}")
    if any(stage.startswith("train_") for stage in stages):
        os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # as `torch_device` does before it imports torch
        for name in TRAINING:
            importlib.import_module(name)
    for stage in undrawn:
        module, _, function = DRAWS[stage].rpartition(".")
        drawing = importlib.import_module(f"capture_cli.{module}")
        assert callable(getattr(drawing, function))
        setattr(drawing, function, lambda *_: None)
    begin_few_threads(setattr)
    if among:
        import pytest
        from diagnosing import look_among

        look_among(pytest.MonkeyPatch(), *among)
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(address)
        listening.listen()
        print("ready", flush=True)
        while True:
            connection, _ = listening.accept()
            with connection:
                message, streams, *_ = socket.recv_fds(connection, LONGEST, 3)
                child = os.fork()
                if not child:
                    run(*json.loads(message), streams)
                for stream in streams:
                    os.close(stream)
                code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
                connection.sendall(str(code).encode())


def run(folder: str, arguments: Sequence[str], streams: Sequence[int]) -> None:
    """What a copy does: the command, in the folder and with the streams of who asked for it."""
    code = 1
    try:
        from capture_cli.cli import main

        for number, stream in enumerate(streams):
            os.dup2(stream, number)
        sys.stdout, sys.stderr = (
            io.TextIOWrapper(io.FileIO(n, "w"), "utf-8", write_through=True) for n in (1, 2)
        )
        os.chdir(folder)
        sys.argv = ["capture", *arguments]
        main()
        code = 0
    except SystemExit as ended:
        code = ended.code or 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    serve(*json.loads(sys.argv[1]))
