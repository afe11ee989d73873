"""One run that is killed, what was left then and what was said, and the run that follows it."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks._kills.runs import Run
from benchmarks._kills.sameness import contents, differences
from capture_cli.store.output import UNFINISHED

PATIENCE = 120.0  # s that a run may go on after its signal
BEGINS = 0.7  # s after which the program has begun, and a signal has its message, on a machine that is busy

# How a run ended that was sent a signal.
DONE, UNHEARD, KILLED = "done", "before the program had begun", "killed"
NOTHING, WHOLE, KEPT = "nothing was written", "all was written", "something is kept"
ENDS = {NOTHING: "interrupted: nothing was written", WHOLE: "interrupted when all was written: "}


class Ended(Exception):
    """The run ended by itself before its signal, after so many `seconds`."""

    def __init__(self, seconds: float):
        super().__init__(seconds)
        self.seconds = seconds


@dataclass
class Outcome:
    """What came of one kill; faults: what was not as it has to be, in words."""

    command: str
    signal: str
    after: float  # s
    ended: str = ""
    left: str = ""
    faults: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Reference:
    """What a run leaves that nothing kills: its outputs by name, its stdout, and how long it takes, s."""

    outputs: dict[str, dict[str, bytes]]
    stdout: str
    seconds: float


def reference(run: Run, folder: Path, capture: Sequence[str]) -> Reference:
    """Let the run end by itself."""
    run.set_up(folder)
    began = time.monotonic()
    done = subprocess.run([*capture, *run.arguments], cwd=folder, capture_output=True, text=True)
    seconds = time.monotonic() - began
    if done.returncode:
        raise RuntimeError(f"{run.name} fails when nothing kills it: {done.stderr}")
    return Reference({name: contents(folder / name) for name in run.outputs}, done.stdout, seconds)


def kill(
    run: Run, made: Reference, folder: Path, number: int, after: float, capture: Sequence[str]
) -> Outcome:
    """Send the run the signal `number` so many s `after` its start, and look at what follows. Raises Ended."""
    outcome = Outcome(run.name, signal.Signals(number).name, round(after, 3))
    run.set_up(folder)
    before = _held(folder)
    code, stderr = _killed(run, folder, number, after, capture)
    left = _Left(run, made, folder, before)
    outcome.left = left.state()
    outcome.faults += left.partial()
    outcome.ended = _ended(code, stderr, number)
    outcome.faults += _faults_of_end(outcome, code, stderr, left)
    outcome.faults += _run_again(run, made, folder, left, capture)
    return outcome


@dataclass
class _Left:
    """What a killed run left in its folder, beside what was `before`."""

    run: Run
    made: Reference
    folder: Path
    before: dict[str, dict[str, bytes]]

    def __post_init__(self):
        self.held = _held(self.folder)
        self.whole = [n for n in self.run.outputs if self.held.get(n) == self.made.outputs[n]]
        self.hidden = sorted(name for name in self.held if name.startswith("."))
        unfinished = [self.folder / n for n in self.hidden if n.endswith(UNFINISHED)]
        self.kept = self.run.kept(unfinished[0]) if unfinished and self.run.kept else ""
        self.is_all = bool(self.run.outputs) and len(self.whole) == len(self.run.outputs)

    def partial(self) -> list[str]:
        """Outputs that are neither whole nor as they were."""
        return [
            f"{name} is there in part: {differences(self.held[name], self.made.outputs[name])[:5]}"
            for name in self.run.outputs
            if name in self.held and name not in self.whole and self.held[name] != self.before.get(name)
        ]

    def state(self) -> str:
        if self.is_all:
            return "whole"
        if self.whole:
            return "some of several"
        return "kept" if self.kept else "hidden" if self.hidden else "nothing"


def _held(folder: Path) -> dict[str, dict[str, bytes]]:
    return {item.name: contents(item) for item in folder.iterdir()}


def _killed(run: Run, folder: Path, number: int, after: float, capture: Sequence[str]) -> tuple[int, str]:
    """Exit code and stderr. Ctrl-C goes to all processes of a terminal, the others to the one that is named.

    Raises Ended.
    """
    began = time.monotonic()
    with (folder.with_suffix(".err")).open("w+") as stderr:
        process = subprocess.Popen(
            [*capture, *run.arguments],
            cwd=folder,
            stdout=subprocess.DEVNULL,
            stderr=stderr,
            start_new_session=True,
            preexec_fn=lambda: signal.signal(
                signal.SIGINT, signal.SIG_DFL
            ),  # a shell's background ignores it
        )
        try:
            with suppress(subprocess.TimeoutExpired):
                process.wait(after)
                raise Ended(time.monotonic() - began)
            (os.killpg if number == signal.SIGINT else os.kill)(process.pid, number)
            code = process.wait(PATIENCE)
        finally:
            process.kill()
        stderr.seek(0)
        return code, stderr.read()


def _ended(code: int, stderr: str, number: int) -> str:
    """In which of the ways that there are a run ended; "" for another."""
    if code == 0:
        return DONE
    if code == -number and number == signal.SIGKILL:
        return KILLED
    if (code == -number and not stderr) or ("Traceback" in stderr and "capture_cli" not in stderr):
        return UNHEARD  # Python itself was starting, and has no message, or a traceback of its own
    if code != 128 + number:
        return ""
    for end, said in ENDS.items():
        if said in stderr:
            return end
    return KEPT if "kept" in stderr and "--resume" in stderr else ""


def _faults_of_end(outcome: Outcome, code: int, stderr: str, left: _Left) -> list[str]:
    """Where what was said is not so, or nothing was."""
    last = stderr.strip().splitlines()[-3:]
    faults = ["a traceback"] if "Traceback" in stderr and outcome.ended != UNHEARD else []
    if not outcome.ended:
        return [*faults, f"exit code {code}, and it said {last}"]
    if outcome.ended == UNHEARD and (outcome.after > BEGINS or left.held != left.before):
        faults.append(f"ended by the signal after {outcome.after} s, and it said {last}")
    if outcome.ended in (DONE, WHOLE) and left.run.outputs and not left.is_all:
        faults.append(f"{outcome.ended}, but whole are {left.whole}")
    if outcome.ended == NOTHING and left.held != left.before:
        faults.append(f"nothing was written, but there are {sorted(left.held)}")
    if outcome.ended == KEPT and not (left.kept and left.kept in stderr):
        faults.append(f"kept is {left.kept!r}, and it said {last}")
    litter = [name for name in left.hidden if not (left.kept and name.endswith(UNFINISHED))]
    if outcome.ended not in (KILLED, UNHEARD) and litter:
        faults.append(f"left {litter}")
    return faults


def _run_again(run: Run, made: Reference, folder: Path, left: _Left, capture: Sequence[str]) -> list[str]:
    """Run it again, to its end; what is not as if it had never been killed."""
    if left.is_all and (run.replaced or not left.hidden):
        return []  # nothing is to do, and an episode is not added twice
    resumes = ["--resume"] if run.kept and any(n.endswith(UNFINISHED) for n in left.hidden) else []
    replaces = ["--force"] if left.whole else []
    again = subprocess.run(
        [*capture, *run.arguments, *resumes, *replaces], cwd=folder, capture_output=True, text=True
    )
    if again.returncode:
        return [f"again it ends with {again.returncode}: {again.stderr.strip().splitlines()[-3:]}"]
    faults = [
        f"again {name} differs in {found[:5]}"
        for name in run.outputs
        if (found := differences(contents(folder / name), made.outputs[name]))
    ]
    if not run.outputs and again.stdout != made.stdout:
        faults.append("again stdout differs")
    if sorted(_held(folder)) != sorted({*run.outputs, *left.before}):
        faults.append(f"again it leaves {sorted(_held(folder))}")
    return faults
