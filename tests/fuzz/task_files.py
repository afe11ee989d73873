"""Task files: every key with values of every kind, tables without end, text that is no TOML."""

from __future__ import annotations

import tomllib
from pathlib import Path

from hypothesis import strategies as st

from fuzz.cases import Case, Expected, refused, taken
from fuzz.mutations import (
    DEEP,
    Document,
    Raw,
    Sound,
    mutated,
    mutated_bytes,
    part_at,
    places,
    toml_text,
    toml_values,
)

FILE = "machine/task.toml"
TASKS = (("tasks", "--task", "machine", "--json"), ("machine",), ())
RECORD = (
    ("record", "--task", "machine", "--duration", "0.1", "--threads", "1", "--out", "new.zarr"),
    ("machine",),
    ("new.zarr", "new.truth.json"),
)
IMPORT = (
    ("import-log", "run.csv", "--task", "machine", "--out", "new.zarr"),
    ("machine", "run.csv"),
    ("new.zarr",),
)
EXPORT = (
    ("export", "estimate", "--task", "machine/task.toml", "--out", "new.xml"),
    ("machine", "estimate"),
    ("new.xml", "new_effects.py"),
)
IDENTIFY = (
    (
        "identify",
        "--real-log",
        "log.zarr",
        "--task",
        "machine",
        "--starts",
        "1",
        "--threads",
        "1",
        "--quiet",
        "--out",
        "new",
    ),
    ("machine", "log.zarr"),
    ("new",),
)
INSPECT = (("inspect", "log.zarr", "--task", "machine", "--json"), ("machine", "log.zarr"), ())
COMMANDS = (*[TASKS, RECORD, IMPORT, EXPORT, INSPECT] * 3, IDENTIFY)
KEYS = {
    "scale": "2.0",
    "offset": "1e300",
    "column_unit": '"deg"',
    "interpolate": '"linear"',
    "noise_sd": "0",
    "period": "360.0",
    "sparse": "true",
    "nominal": "2.0",
    "time_scale": "1e-3",
    "window": "0",
    "unit": '"kg m^2/s"',
    "column": '["", "x"]',
    "set": '["joint:x:damping", "joint:x:stiffness"]',
}
TARGETS = (
    "body:carriage:mass",
    "body:carriage:com_x",
    "body:carriage:inertia",
    "joint:x:damping",
    "joint:x:armature",
    "joint:x:frictionloss",
    "geom:block:friction",
    "actuator:drive:gear",
    "option:gravity_x",
    "option:timestep",
    "option:density",
    "body:world:mass",
    "joint::damping",
    "a:b:c:d",
    ":",
    "tendon:t:stiffness",
)


def seeds(inputs: Path) -> list[Case]:
    sound = tomllib.loads((inputs / FILE).read_text())
    text = (inputs / FILE).read_text()

    def seed(name: str, way: str, value: object, *words: str, of=TASKS, end: Expected | None = None) -> Case:
        return case(of, toml_text(changed(sound, way, value)).encode(), end or refused(*words), name)

    return [
        case(TASKS, text.encode(), taken(), "as it is"),
        seed("low 400 digits", "parameters.mass.low", Raw("9" * 400), "digits"),
        seed("low 5,000 digits", "parameters.mass.low", Raw("9" * 5000), "digits"),
        seed("100,000 lists in each other", "parameters.mass.low", DEEP, "levels deep"),
        seed("80,000 tables in each other", "name", Raw("{a=" * 80_000), "levels deep"),
        case(
            TASKS,
            f"{'.'.join('a' * 100_000)} = 1\n{text}".encode(),
            refused("levels deep"),
            "a key of 100,000 points",
        ),
        seed("low nan", "parameters.mass.low", Raw("nan"), "finite"),
        seed("high inf", "parameters.mass.high", Raw("inf"), "finite"),
        seed("low -1e308", "parameters.mass.low", -1e308, "low"),
        seed("low -1e308 of what may be negative", "parameters.stiffness.low", -1e308),
        seed("low above high", "parameters.mass.low", 1000.0, "low"),
        seed("a model path of 5,000 characters", "model", "m" * 5000, "too long"),
        seed("a model that is a folder", "model", ".", "folder"),
        seed("a model of zero characters", "model", ""),
        seed("an unknown target of 40,000 characters", "parameters.mass.set", "y" * 40_000),
        seed("an unknown column of 40,000 characters", "outputs.q.column", "y" * 40_000, of=IMPORT),
        seed("a zero character in a model's path", "model", "a\0b", "control character"),
        seed(
            "a zero character in the name of an output",
            "outputs",
            {"q\0x": sound["outputs"]["q"]},
            "control character",
        ),
        seed("a zero character in a column", "outputs.q.column", "q\0m", "control character"),
        seed("markup as a unit", "parameters.mass.unit", "[/]", end=taken()),
        seed("markup as a name", "name", "[/]", end=taken()),
        seed(
            "an element of HTML as a unit",
            "parameters.mass.unit",
            "kg<img src=x onerror=alert(1)>",
            end=taken(),
        ),
        seed("a window of 0", "log.window", 0, "window"),
        seed("a window of 1e300", "log.window", 1e300, "window"),
        seed("an unknown key", "log.widnow", 1.0, "widnow"),
        seed("an unknown target", "parameters.mass.set", "body:carriage:weight", "weight"),
        seed("no number", "parameters.mass.low", "1.0", "low"),
        seed("a format to come", "format", 2, "format"),
        seed("an output that is no sensor", "outputs.velocity", {"column": "v", "unit": "m"}, "velocity"),
        case(TASKS, b"\xff\xfe", refused("UTF-8"), "bytes that are no text"),
        case(TASKS, b"#" * (1 << 19), refused("bytes"), "half a megabyte"),
        case(TASKS, b"", refused(), "an empty task"),
    ]


def changed(document: dict, way: str, value: object) -> dict:
    """A copy with one value of it replaced, or added."""
    key, _, rest = way.partition(".")
    return {**document, key: changed(document.get(key, {}), rest, value) if rest else value}


def case(of: tuple, content: bytes, expected: Expected | None = None, name: str = "") -> Case:
    arguments, needs, outputs = of
    return Case(arguments, needs, {FILE: content}, outputs, expected, name)


def cases(inputs: Path) -> st.SearchStrategy[Case]:
    text = (inputs / FILE).read_text()
    sound = Document(tomllib.loads(text))
    values = st.one_of(
        toml_values, st.sampled_from(TARGETS), st.sampled_from([Raw(v) for v in KEYS.values()])
    )
    contents = st.one_of(
        mutated(sound, values).map(as_bytes),
        mutated(sound, values, most=1).map(as_bytes),
        with_key(sound, values),
        mutated_bytes(Sound(text.encode())),
    )
    of = st.sampled_from(COMMANDS)
    made = st.builds(case, of, contents)
    return st.one_of(made, made, made, made, without_number(sound))


def as_bytes(document: dict) -> bytes:
    return toml_text(document).encode("utf-8", "surrogatepass")


@st.composite
def with_key(draw, sound: dict, values: st.SearchStrategy) -> bytes:
    """A key that the format knows, in a table of its own or another's, with its own value or another."""
    tables = [(), *(p for p in places(sound) if isinstance(part_at(sound, p), dict))]
    way, key = draw(st.sampled_from(tables)), draw(st.sampled_from(sorted(KEYS)))
    value = Raw(KEYS[key]) if draw(st.booleans()) else draw(values)
    return as_bytes(changed(sound, ".".join((*way, key)), value))


def without_number(sound: dict) -> st.SearchStrategy[Case]:
    """A number of the task is none: that is always refused."""
    numbers = [".".join(p) for p in places(sound) if isinstance(part_at(sound, p), float | int)]
    none = st.sampled_from([Raw(v) for v in ("nan", "inf", "-inf", "1e999", "9" * 30, "true", "[]", '"1"')])
    contents = st.builds(
        lambda way, value: as_bytes(changed(sound, way, value)), st.sampled_from(numbers), none
    )
    return st.builds(case, st.sampled_from(COMMANDS), contents, st.just(refused()))
