"""The rule that `capture` keeps to, whatever it is given: how a run ends, what it says, what it leaves."""

from __future__ import annotations

import json
import re
import stat
from collections.abc import Mapping, Sequence
from itertools import takewhile
from pathlib import Path
from xml.etree import ElementTree

from fuzz.cases import Case, Expected
from fuzz.forked_run import LONGEST, MOST_MEMORY, Ended

LONGEST_MESSAGE = 1000  # characters, and fewer
CURE = "  cure: "
ERROR = "error: "
# What a run can be found to have done; how many did is counted under these names.
EXIT, HANG, MEMORY, LITTER, MESSAGE, TRACEBACK, WRONG = KINDS = (
    "exit code",
    "hang",
    "memory",
    "left behind",
    "message",
    "traceback",
    "wrong end",
)
_PYTHON = re.compile(r"Traceback \(most recent|internal error|\.py:\d+: \w*Warning|Exception ignored")
# of the table of findings: what was found, and, indented, what to do
_ERROR_AND_CURE = re.compile(r"^error +\S.*\n( +\S.*\n?)+", re.MULTILINE)

State = Mapping[str, tuple[int, int, int]]  # of every file and folder: mode, bytes, time of its last change


def state(folder: Path) -> State:
    found = {}
    for path in sorted(folder.rglob("*")):
        status = path.lstat()
        is_folder = stat.S_ISDIR(status.st_mode)
        kept = (0, 0) if is_folder else (status.st_size, status.st_mtime_ns)
        found[path.relative_to(folder).as_posix()] = (status.st_mode, *kept)
    return found


def faults(case: Case, ended: Ended, before: State, folder: Path) -> list[tuple[str, str]]:
    """(which of KINDS, in words) of all that a run of `case` in `folder` did not do as it has to."""
    found = [*_of_its_end(case, ended), *_of_what_it_left(case, ended, before, folder)]
    if ended.code == 2:
        found += _of_its_message(case, ended)
    if case.expected:
        found += _of_what_is_known(case.expected, ended)
    return found


def _of_its_end(case: Case, ended: Ended) -> list[tuple[str, str]]:
    found = []
    if ended.code is None:
        found.append((HANG, f"it did not end in {LONGEST:g} s"))
    elif ended.code not in ({0, 2, 3} if "--fail-on" in case.arguments else {0, 2}):
        found.append((EXIT, f"exit code {ended.code}: {ended.stderr[-500:]!r}"))
    if ended.memory > MOST_MEMORY:
        found.append((MEMORY, f"it took {ended.memory / 1e9:.2f} GB"))
    elif "out of memory" in ended.stderr:
        found.append((MEMORY, "it asked for more than there was"))
    if spoken := _PYTHON.search(ended.stderr) or _PYTHON.search(ended.stdout):
        found.append((TRACEBACK, f"it said {spoken[0]!r}: {ended.stderr[-500:]!r}"))
    if ended.left:
        found.append((LITTER, "a process of it was still there"))
    expects_json = "--json" in case.arguments and not _asks_for_words(case.arguments)
    if ended.code == 0 and expects_json and not _is_json(ended.stdout):
        found.append((WRONG, "with --json, stdout is no JSON document"))
    return found


def _asks_for_words(arguments: Sequence[str]) -> bool:
    """Whether --version, before any command, or --help ends it with words, whatever else is asked for."""
    return "--version" in takewhile(lambda a: a.startswith("-"), arguments) or "--help" in arguments


def _of_what_it_left(case: Case, ended: Ended, before: State, folder: Path) -> list[tuple[str, str]]:
    after = state(folder)
    may = set(case.outputs) if ended.code in (0, 3) else set()
    changed = sorted(p for p, s in before.items() if after.get(p) != s and not _is_in(p, may))
    new = sorted(p for p in after.keys() - before.keys() if not _is_in(p, may))
    found = [
        (LITTER, f"{what} {names[:5]}")
        for what, names in (("it changed", changed), ("it left", new))
        if names
    ]
    if ended.code == 0 and may:
        if not any((folder / name).exists() for name in case.outputs):
            found.append((WRONG, f"exit code 0, and there is none of {case.outputs}"))
        found += [
            (WRONG, f"{name} is not whole: {why}")
            for name in case.outputs
            if not any(other.startswith(f"{name}/") for other in case.outputs)  # it is what another lies in
            if (folder / name).exists() and (why := _not_whole(folder / name))
        ]
    return found


def _is_in(path: str, names: set[str]) -> bool:
    return any(path == name or path.startswith(f"{name}/") for name in names)


def _not_whole(path: Path) -> str:
    """Why an output is none; "" where it is one."""
    try:
        if path.is_dir():
            json.loads((path / "provenance.json").read_text())
            hidden = [f.name for f in path.rglob(".*")]
            return f"it has {hidden[:3]}" if hidden else ""
        text = path.read_text(encoding="utf-8")
        if path.suffix == ".json":
            json.loads(text)
        elif path.suffix == ".xml":
            ElementTree.fromstring(text)
        return "" if text else "it is empty"
    except (OSError, ValueError, ElementTree.ParseError) as error:
        return f"{type(error).__name__}: {error}"


def _of_its_message(case: Case, ended: Ended) -> list[tuple[str, str]]:
    lines = ended.stderr.rstrip("\n").splitlines()
    begins = [n for n, line in enumerate(lines) if line.startswith(ERROR)]
    if not begins and case.arguments[:1] == ("inspect",):
        return _of_findings(ended.stdout)
    if not begins:
        return [(MESSAGE, f"no line begins with {ERROR!r}: {ended.stderr[-500:]!r}")]
    message = "\n".join(lines[begins[-1] :])
    found = []
    if not (lines[-1].startswith(CURE) and lines[-1][len(CURE) :].strip()):
        found.append((MESSAGE, f"its last line is no cure: {lines[-1][:200]!r}"))
    if len(message) >= LONGEST_MESSAGE:
        found.append((MESSAGE, f"it has {len(message)} characters: {message[:100]!r}"))
    return found


def _of_findings(stdout: str) -> list[tuple[str, str]]:
    """What `inspect` has to say of an error goes to stdout: a table, or a document."""
    if not _is_json(stdout):
        return (
            []
            if _ERROR_AND_CURE.search(stdout)
            else [(MESSAGE, f"stdout has no error with a cure: {stdout[-500:]!r}")]
        )
    errors = [f for f in json.loads(stdout)["findings"] if f["severity"] == "error"]
    if not errors:
        return [(MESSAGE, "exit code 2, and no finding is an error")]
    return [
        (MESSAGE, f"a finding without a cure, or of {len(f['message'])} characters: {f['message'][:100]!r}")
        for f in errors
        if not f["cure"] or len(f["message"]) + len(f["cure"]) >= LONGEST_MESSAGE
    ]


def _of_what_is_known(expected: Expected, ended: Ended) -> list[tuple[str, str]]:
    if ended.code != expected.code:
        return [(WRONG, f"exit code {ended.code}, and {expected.code} is right: {ended.stderr[-500:]!r}")]
    said = " ".join(f"{ended.stdout} {ended.stderr}".split())
    return [(WRONG, f"it says nothing of {w!r}: {said[-700:]!r}") for w in expected.words if w not in said]


def _is_json(text: str) -> bool:
    try:
        json.loads(text)
    except ValueError:
        return False
    return True
