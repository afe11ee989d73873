"""Options of every command, on the command line and in --config: numbers, names, paths and ranges that are none."""

from __future__ import annotations

import os
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import get_args, get_type_hints

from hypothesis import strategies as st
from typer.models import ArgumentInfo

from fuzz.cases import Case, Expected, refused, taken
from fuzz.mutations import DEEP, LONG, NUMBERS, TEXTS, Raw, mutated_bytes, toml_text, toml_values

CONFIG = "options.toml"
LOG_OUT = ("new", "new.truth.json")
# Of every command a line that is sound and quick, and what it needs and writes.
LINES: dict[str, tuple[str, tuple[str, ...], tuple[str, ...]]] = {
    "record": ("--task machine --duration 0.1 --rate 100 --threads 1 --out new", ("machine",), LOG_OUT),
    "import-log": ("run.csv --task machine --out new", ("machine", "run.csv"), ("new",)),
    "inspect": ("log.zarr", ("log.zarr", "machine"), ()),
    "identify": (
        "--real-log log.zarr --task machine --starts 1 --threads 1 --quiet --out new",
        ("log.zarr", "machine"),
        ("new",),
    ),
    "diagnose": (
        "--real-log log.zarr --task machine --starts 1 --threads 1 --quiet --out new --window 9",
        ("log.zarr", "machine"),
        ("new",),
    ),
    "export": ("estimate --out new.xml", ("estimate", "machine"), ("new.xml", "new_effects.py")),
    "propose": ("estimate --candidates 2 --threads 1", ("estimate", "machine", "log.zarr"), ()),
    "gen-histories": ("--task scooping --pairs 2 --rounds 2 --threads 1 --out new", (), ("new",)),
    "eval-sim2sim": (
        "--task scooping --identifier domain-randomization --pairs 1 --seeds 1 --rounds 1 --threads 1 --out new",
        (),
        ("new",),
    ),
    "tasks": ("--task machine", ("machine",), ()),
    "effects": ("--task machine", ("machine",), ()),
    "train-policy": (
        "--task scooping --steps 8 --evaluations 1 --width 4 --layers 1 --batch 4 --envs 4 --out new",
        (),
        ("new",),
    ),
    "train-sysid": (
        "--histories histories.zarr --identifier posterior --heads 1 --steps 2 --width 4 --layers 1 --out new",
        ("histories.zarr",),
        ("new",),
    ),
}
OFTEN = (
    ("record",) * 6
    + ("import-log", "inspect", "identify", "export", "propose", "gen-histories", "tasks", "effects") * 2
    + ("eval-sim2sim", "diagnose")
)
# What a number may be without hours of work: nothing, or more than any.
COUNTS = (
    "0",
    "1",
    "2",
    "-1",
    "2147483648",
    "4294967296",
    "1e3",
    "1.5",
    "nan",
    "",
    " ",
    "x",
    "0x10",
    "1_000",
    "２",
    *LONG,
)
SIZES = (
    "0",
    "-1",
    "0.1",
    "0.5",
    "1e15",
    "1e16",
    "-1e308",
    "1e300",
    "1e-300",
    "1e-12",
    "nan",
    "inf",
    "1e400",
    "1,5",
    "",
    "x",
    *LONG,
)
NAMED = (
    "x=1",
    "x=1:",
    "x=:1",
    "x=1:2:3",
    "x=nan",
    "x=1e308",
    "=1",
    "x=",
    "x",
    "mass=1",
    "mass=-1",
    "mass=1e308",
    "mass=nan",
    "damping=1,stiffness=2",
    "q=1e-3",
    "drive=0",
    "drive=-5",
    "drive=1e300",
    "coulomb-friction@x=1",
    "coulomb-friction@x.friction=1e300",
    "coulomb-friction@y=1",
    "[/]@x=1",
    "@=",
    "x=0:1",
    "x=1:0",
    "x=-1e15:1e15",
    f"x={'9' * 400}",
)
PATHS = (
    ".",
    "..",
    "machine",
    "nothing",
    "log.zarr",
    "run.csv",
    "estimate",
    "policy",
    "identifier",
    "proposal.json",
    "histories.zarr",
    "machine/task.toml",
    "machine/model.xml",
    "machine/task.toml/x",
    "/dev/null",
    "/",
    "air-hockey",
    "scooping",
    "new/deep/er",
    "a" * 300,
    "a" * 5000,
    "-",
    "~",
    "file.txt",
    "new.txt",
    "memory://x",
    "bogus://x",
    "*",
    "log.zarr/",
)
SAFE_OUTS = (
    "new",
    "new/deep/er",
    "machine",
    "machine/task.toml",
    "machine/task.toml/x",
    "log.zarr",
    ".",
    "..",
    "",
    " ",
    "a" * 300,
    "a" * 5000,
    "new.xml",
    "é",
    "[/]",
    "x\ny",
    "new/",
    "./new",
    "new.zarr/../new",
)


def seeds(inputs: Path) -> list[Case]:
    def line(
        name: str, text: str, *words: str, end: Expected | None = None, files: dict[str, bytes] | None = None
    ) -> Case:
        arguments = tuple(text.split(" "))
        return Case(
            arguments,
            LINES[arguments[0]][1] if arguments[0] in LINES else (),
            files or {},
            LINES.get(arguments[0], ("", (), ()))[2],
            end or refused(*words),
            name,
        )

    def sound(command: str, more: str) -> str:
        return f"{command} {LINES[command][0]} {more}".strip()

    def config(name: str, content: bytes, *words: str, end: Expected | None = None) -> Case:
        return replace(
            line(name, sound("record", f"--config {CONFIG}"), *words, end=end), files={CONFIG: content}
        )

    return [
        *(
            line(f"{command} as it is", sound(command, ""), end=taken())
            for command in (
                "record",
                "import-log",
                "inspect",
                "export",
                "propose",
                "gen-histories",
                "tasks",
                "effects",
            )
        ),
        line("duration 1e300", "record --task machine --duration 1e300 --out new", "--duration"),
        line("duration nan", "record --task machine --duration nan --out new", "--duration"),
        line("duration 1e15", "record --task machine --duration 1e15 --out new"),
        line("episodes of 400 digits", sound("record", f"--episodes {'9' * 400}"), "--episodes"),
        line("episodes of 5,000 digits", sound("record", f"--episodes {'9' * 5000}"), "--episodes"),
        line("starts of 400 digits", sound("identify", f"--starts {'9' * 400}"), "--starts"),
        line("pairs of 400 digits", sound("gen-histories", f"--pairs {'9' * 400}"), "--pairs"),
        line("seed of 400 digits", sound("record", f"--seed {'9' * 400}")),
        line("threads of 400 digits", sound("record", f"--threads {'9' * 400}"), "--threads"),
        line("start x=1:", sound("record", "--start x=1:"), "LOW:HIGH"),
        line("start x=:1", sound("record", "--start x=:1"), "LOW:HIGH"),
        line("start x=nan", sound("record", "--start x=nan")),
        line("start of a joint that there is not", sound("record", "--start y=1"), "y"),
        *(
            line(f"up from a folder that there is not: {command}", sound(command, options), "does not exist")
            for command, options in (
                ("record", "--out new.zarr/../new"),
                ("record", "--truth new.zarr/../new.json"),
                ("import-log", "--force --out new.zarr/../new --even-times"),
                ("identify", "--out new.zarr/../new --resume"),
                ("diagnose", "--out new.zarr/../new --resume"),
                ("export", "--out new.zarr/../new.xml"),
                ("propose", "--out new.zarr/../new.json"),
                ("gen-histories", "--out new.zarr/../new --resume"),
                ("eval-sim2sim", "--out new.zarr/../new"),
            )
        ),
        *(
            line(f"a name of another format: {command} {options}", sound(command, options), *words)
            for command, options, *words in (
                ("record", "--truth new.xml", "XML", "JSON"),
                ("export", "--out new.json", "JSON", "XML"),
                ("propose", "--out new.CSV", "CSV", "JSON"),
                ("propose", "--csv new.json", "JSON", "CSV"),
            )
        ),
        line(
            "--version before a command", "--version proposal.json train-sysid --json", end=taken("capture")
        ),
        line("a path of 5,000 characters", f"inspect {'a' * 5000}"),
        line("a command that there is not", "identfy", "identify"),
        line("an option that there is not", sound("record", "--episods 3"), "--episods"),
        line("no value", sound("record", "--seed"), "--seed"),
        line("a task of markup", "tasks --task [/]", "[/]"),
        line("an effect of markup", sound("record", "--effect [/]@x=1"), "[/]"),
        line("a log size of 400 digits", sound("inspect", f"--max-log-size {'9' * 400}"), "--max-log-size"),
        config("an option of 400 digits in a config", b"episodes = " + b"9" * 400, "digits"),
        config("an option of 5,000 digits in a config", b"episodes = " + b"9" * 5000, "digits"),
        config("a config 100,000 deep", b"episodes = " + DEEP.encode(), "levels deep"),
        config("a config of nan", b"duration = nan", "finite"),
        config("a config of a text", b'episodes = "many"', "episodes"),
        config("a config of an unknown option", b"episods = 1", "episods"),
        config("a config for another command", b"[identify]\nstarts = 1", end=taken()),
        config("a config that is sound", b"seed = 5", end=taken()),
        config("a config in Latin-1", b'task = "\xe4"', "UTF-8"),
    ]


@cache
def options(command: str) -> tuple[tuple[str, str, int], ...]:
    """(name, kind, how many values) of each option of a command. kind: "flag", "whole", "number" or "text"."""
    from capture_cli.cli.app import _COMMANDS

    found = []
    for hint in (p.annotation for p in get_type_hints(_COMMANDS[command])["options"].parameters()):
        if not hasattr(hint, "__metadata__"):
            continue
        option = hint.__metadata__[0]
        if isinstance(option, ArgumentInfo):
            continue
        # inside Annotated, typer.Option takes its first name for a default, and corrects that when it runs
        name = str(option.default).split("/")[0]
        inner = [k for k in get_args(hint.__origin__) if k is not type(None)] or [hint.__origin__]
        kind = {bool: "flag", int: "whole", float: "number"}.get(inner[0], "text")
        found.append((name, kind, len(inner)))
    return tuple(found)


def cases(inputs: Path) -> st.SearchStrategy[Case]:
    commands = st.sampled_from(OFTEN)
    lines = commands.flatmap(_lines)
    return st.one_of(
        lines,
        lines,
        lines,
        commands.flatmap(_configured),
        st.sampled_from(("train-policy", "train-sysid")).flatmap(_refused_lines),
        _words(),
    )


def _value(name: str, kind: str) -> st.SearchStrategy[str]:
    if name in ("--out", "--csv", "--truth"):
        return st.sampled_from(SAFE_OUTS)
    if kind == "whole":
        return st.sampled_from(COUNTS)
    if kind == "number":
        return st.sampled_from(SIZES)
    if name in ("--address", "--executor", "--world"):
        return st.sampled_from(("", "x", "local", "[/]", "plant"))
    texts = tuple(t for t in TEXTS if "\0" not in t)
    return st.one_of(*(st.sampled_from(some) for some in (texts, NAMED, PATHS, NUMBERS)))


@st.composite
def _lines(draw, command: str) -> Case:
    """A sound line with one to three options that it has not, or with others."""
    text, needs, outputs = LINES[command]
    arguments = [command, *text.split()]
    for _ in range(draw(st.integers(1, 3))):
        name, kind, count = draw(st.sampled_from(options(command)))
        if name == "--config":
            continue
        arguments += [name] if kind == "flag" else [name, *(draw(_value(name, kind)) for _ in range(count))]
    return _case(arguments, needs, outputs)


def _case(arguments: list[str], needs: tuple[str, ...], outputs: tuple[str, ...]) -> Case:
    """What it may write is what it is told to."""
    given = [os.path.normpath(b) for a, b in pairwise(arguments) if a in ("--out", "--csv", "--truth") and b]
    told = {path for path in given if path not in (".", "..")} - set(outputs)
    beside = {f"{path.removesuffix('.zarr')}.truth.json" for path in told}
    beside |= {f"{path.removesuffix('.xml')}_effects.py" for path in told}
    folders = {path.split("/")[0] for path in told} - set(needs)
    may = (*outputs, *sorted((told | beside | folders) - set(outputs)))
    return Case(tuple(arguments), needs, outputs=may if told or outputs else ())


@st.composite
def _refused_lines(draw, command: str) -> Case:
    """Trainings take long to begin: only what is refused before."""
    text, needs, outputs = LINES[command]
    numbers = [(n, k) for n, k, _ in options(command) if k in ("whole", "number")]
    name, kind = draw(st.sampled_from(numbers))
    value = draw(
        st.sampled_from(
            ("nan", "x", "", "1e400", "-9" * 200) if kind == "number" else ("x", "1.5", "", "9" * 400, "nan")
        )
    )
    return Case((command, *text.split(), name, value), needs, {}, outputs, refused())


@st.composite
def _configured(draw, command: str) -> Case:
    """A sound line with a --config of options, most of them of another type."""
    text, needs, outputs = LINES[command]
    names = [
        n.removeprefix("--")
        for n, _, _ in options(command)
        if n not in ("--out", "--csv", "--truth", "--config", "--debug", "--address", "--executor", "--world")
    ]
    names += [n.replace("-", "_") for n in names]
    values = st.one_of(
        toml_values, st.sampled_from([Raw(f'["{n}"]') for n in NAMED]), st.sampled_from((True, False))
    )
    table = draw(
        st.dictionaries(
            st.one_of(st.sampled_from(names), st.sampled_from(names), st.sampled_from(TEXTS)),
            values,
            min_size=1,
            max_size=3,
        )
    )
    if draw(st.booleans()):
        table = {command: table}
    content = toml_text(table).encode("utf-8", "surrogatepass")
    if draw(st.integers(0, 5)) == 0:
        content = draw(mutated_bytes(content))
    return replace(
        _case([command, *text.split(), "--config", CONFIG], needs, outputs), files={CONFIG: content}
    )


@st.composite
def _words(draw) -> Case:
    """Words that are hardly a command line."""
    words = st.one_of(
        st.sampled_from((*LINES, "--json", "--quiet", "--help", "--version", "--", "-x")),
        st.sampled_from(PATHS[:12]),
    )
    return Case(tuple(draw(st.lists(words, min_size=1, max_size=4))), ("machine", "log.zarr", "run.csv"))
