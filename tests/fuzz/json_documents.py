"""JSON: estimates, diagnoses, proposals, and how they were made."""

from __future__ import annotations

import json
from pathlib import Path

from hypothesis import strategies as st

from fuzz.cases import Case, Expected, refused, taken
from fuzz.mutations import DEEP, Document, Raw, Sound, json_text, mutated, mutated_bytes, part_at, places

ESTIMATE, DIAGNOSIS, FORMULA = "estimate/estimate.json", "diagnosis/diagnosis.json", "formula/diagnosis.json"
PROPOSAL, MADE, POLICY = "proposal.json", "estimate/provenance.json", "policy/policy.json"
IDENTIFIER = "identifier/identifier.json"
MODEL_OUT = ("new.xml", "new_effects.py")
LOG_OUT = ("new.zarr", "new.truth.json")
READERS: dict[
    str, tuple[tuple[str, tuple[str, ...]], ...]
] = {  # of each: what reads it, and what that may leave
    ESTIMATE: (
        ("export estimate --out new.xml", MODEL_OUT),
        ("export estimate --task machine --out new.xml --json", MODEL_OUT),
        ("inspect estimate --json", ()),
        ("inspect estimate", ()),
        ("propose estimate --candidates 2 --threads 1 --out new.json --csv new.csv", ("new.json", "new.csv")),
        (
            "identify --real-log log.zarr --starts 1 --threads 1 --quiet --resume --out estimate",
            ("estimate",),
        ),
    ),
    DIAGNOSIS: (
        ("export diagnosis --out new.xml", MODEL_OUT),
        ("inspect diagnosis --json", ()),
        ("inspect diagnosis", ()),
        ("propose diagnosis --candidates 2 --threads 1 --out new.json", ("new.json",)),
    ),
    FORMULA: (("export formula --out new.xml", MODEL_OUT), ("inspect formula", ())),
    PROPOSAL: (
        ("record --task machine --inputs-from proposal.json --threads 1 --out new.zarr", LOG_OUT),
        ("inspect proposal.json --json", ()),
        ("inspect proposal.json", ()),
        ("record --task scooping --actions-from proposal.json --threads 1 --out new.zarr", LOG_OUT),
    ),
    MADE: (
        ("inspect estimate --json", ()),
        ("inspect estimate", ()),
        ("export estimate --out new.xml", MODEL_OUT),
        ("propose estimate --candidates 2 --threads 1", ()),
    ),
    POLICY: (
        ("inspect policy --json", ()),
        ("record --task scooping --policy policy --threads 1 --out new.zarr", LOG_OUT),
    ),
    IDENTIFIER: (
        ("inspect identifier --json", ()),
        ("inspect identifier", ()),
        (
            "identify --real-log scoops.zarr --task scooping --identifier identifier --threads 1 --quiet --out new",
            ("new",),
        ),
    ),
}
TEXTUAL = (
    r'{"format": "capture/estimate", "version": 1}',
    "[]",
    "null",
    "1",
    '"a"',
    "",
    "{}",
    "{",
    "[[" * 40,
    "\ufeff{}",
    "{} {}",
)


def seeds(inputs: Path) -> list[Case]:
    documents = {path: json.loads((inputs / path).read_text()) for path in READERS}

    def seed(
        name: str, path: str, way: str, value: object, *words: str, of: int = 0, end: Expected | None = None
    ) -> Case:
        changed = replaced(documents[path], way.split("/"), value)
        return case(path, READERS[path][of], json_text(changed).encode(), end or refused(*words), name)

    def text(name: str, path: str, content: bytes, *words: str, of: int = 0) -> Case:
        return case(path, READERS[path][of], content, refused(*words), name)

    value = "parameters/mass/value"
    (effect,) = documents[DIAGNOSIS]["effects"]
    (friction,) = effect["parameters"]
    values = documents[FORMULA]["expression"]["values"]
    fewer = {k: v for k, v in values.items() if k != "mass"}
    force = f"effects/0/parameters/{friction}/value"
    return [
        *(
            case(
                path,
                reader,
                (inputs / path).read_bytes(),
                taken(),
                f"{reader[0].split()[0]} of {path} as it is",
            )
            for path, readers in READERS.items()
            for reader in readers[:1]
        ),
        seed("an estimate of 1e308", ESTIMATE, value, 1e308, "outside of its bounds"),
        seed("an estimate of 1e308, inspected", ESTIMATE, value, 1e308, "outside of its bounds", of=2),
        seed("an estimate of nan", ESTIMATE, value, Raw("NaN"), "finite"),
        seed("an estimate that is a text", ESTIMATE, value, "2.0", "value"),
        seed("an estimate of 400 digits", ESTIMATE, value, Raw("9" * 400), "digits"),
        seed("an estimate of 5,000 digits", ESTIMATE, value, Raw("9" * 5000), "digits"),
        seed("an estimate 100,000 deep", ESTIMATE, value, DEEP, "levels deep"),
        seed("an estimate whose task is a zero character", ESTIMATE, "task", "a\0b", "control character"),
        seed("an estimate of another version", ESTIMATE, "version", 99, "version"),
        seed("an estimate without parameters", ESTIMATE, "parameters", {}),
        seed("an estimate with markup as a unit", ESTIMATE, "parameters/mass/unit", "[/]", of=3, end=taken()),
        seed("an effect of 1e308", DIAGNOSIS, force, 1e308),
        seed("an effect that there is not", DIAGNOSIS, "effects/0/name", "telekinesis", "telekinesis"),
        seed("an effect of a site that there is not", DIAGNOSIS, "effects/0/site", "[/]", "[/]"),
        seed("a formula whose values lack a name", FORMULA, "expression/values", fewer, "mass"),
        seed("a formula without values", FORMULA, "expression/values", {}, "values"),
        seed("a formula whose values are 1e308", FORMULA, "expression/values", {**values, "mass": 1e308}),
        seed("a formula of 1e300", FORMULA, "expression/terms/0/coefficient", 1e300),
        seed("a proposal 100,000 deep", PROPOSAL, "version", DEEP, "levels deep"),
        seed("a proposal of 5,000 digits", PROPOSAL, "version", Raw("9" * 5000), "digits"),
        seed("a proposal of 400 digits", PROPOSAL, "version", Raw("9" * 400), "digits"),
        seed("a proposal for nothing", PROPOSAL, "task", None),
        seed("a policy of 400 digits", POLICY, "version", Raw("9" * 400), "digits"),
        seed("a policy 100,000 deep", POLICY, "version", DEEP, "levels deep"),
        *(
            seed(
                f"a policy whose {place} is {found!r}", POLICY, place, found, place.rsplit("/", 1)[-1], of=of
            )
            for place, found in (
                ("settings/layers", {}),
                ("settings/layers", 0),
                ("settings/layers", 10**18),
                ("result/success", {}),
                ("result/random/reward", "much"),
                ("training/steps", []),
            )
            for of in (0, 1)
        ),
        *(
            seed(
                f"an identifier whose {place} is {found!r}",
                IDENTIFIER,
                place,
                found,
                place.rsplit("/", 1)[-1],
                of=of,
            )
            for place, found in (
                ("result/coverage", {"com": {"com": 0.95}}),
                ("result/coverage", {}),
                ("result/mean_absolute_error/com", "little"),
                ("result/validation_loss", []),
                ("result/best_step", {}),
                ("training/steps", {}),
                ("architecture/layers", 10**18),
                ("architecture/width", -1),
                ("architecture/residual", []),
                ("signature/parameters/0/nominal", {}),
                ("signature/parameters/0/step", "small"),
                ("histories/noise", "loud"),
                ("identifier", "compass"),
            )
            for of in (1, 2)
        ),
        seed("a network 10^18 wide", IDENTIFIER, "architecture/width", 10**18, "expected (7, 10", of=1),
        seed(
            "provenance of 400 digits",
            MADE,
            "version",
            Raw("9" * 400),
            "digits",
            end=taken("provenance.json"),
        ),
        seed("provenance 100,000 deep", MADE, "version", DEEP, end=taken("provenance.json")),
        seed("provenance of 5,000 digits, exported", MADE, "version", Raw("9" * 5000), "digits", of=2),
        text("an estimate in Latin-1", ESTIMATE, '{"format": "\xe4"}'.encode("latin-1"), "UTF-8"),
        text("an estimate that is empty", ESTIMATE, b"", "JSON"),
        text("an estimate of 20 MB", ESTIMATE, b" " * 20_000_000, "bytes"),
        text("an estimate of a million lists", ESTIMATE, b"[" + b"[]," * 1_100_000 + b"[]]"),
    ]


def replaced(document: object, way: list[str], value: object) -> object:
    """A copy of `document` with the part at `way` replaced."""
    if not way:
        return value
    key: object = int(way[0]) if isinstance(document, list) else way[0]
    inner = replaced(part_at(document, (key,)), way[1:], value)
    if isinstance(document, list):
        return [inner if n == key else v for n, v in enumerate(document)]
    return {**document, key: inner}


def case(
    path: str,
    reader: tuple[str, tuple[str, ...]],
    content: bytes,
    expected: Expected | None = None,
    name: str = "",
) -> Case:
    text, outputs = reader
    needs = {path.split("/")[0], "machine", "log.zarr", *(n for n in ("scoops.zarr",) if n in text)}
    return Case(tuple(text.split()), tuple(sorted(needs)), {path: content}, outputs, expected, name)


def cases(inputs: Path) -> st.SearchStrategy[Case]:
    return st.one_of(*(_cases_of(inputs, path) for path in READERS), without_number(inputs))


def _cases_of(inputs: Path, path: str) -> st.SearchStrategy[Case]:
    content = Sound((inputs / path).read_bytes())
    document = Document(json.loads(content))
    contents = st.one_of(
        mutated(document, most=1).map(as_bytes),
        mutated(document).map(as_bytes),
        mutated(document).map(as_bytes),
        mutated_bytes(content),
        st.sampled_from(TEXTUAL).map(str.encode),
    )
    return st.builds(case, st.just(path), st.sampled_from(READERS[path]), contents)


def as_bytes(document: object) -> bytes:
    return json_text(document).encode("utf-8", "surrogatepass")


def without_number(inputs: Path) -> st.SearchStrategy[Case]:
    """A number of a document that is read whole is none: that is always refused."""
    documents = {
        path: json.loads((inputs / path).read_text()) for path in (ESTIMATE, DIAGNOSIS, FORMULA, POLICY)
    }
    numbers = [
        (path, place)
        for path, document in documents.items()
        for place in places(document)
        if isinstance(part_at(document, place), float)
    ]
    none = st.sampled_from([Raw(v) for v in ("NaN", "Infinity", "-Infinity", "1e999", "9" * 30, '"\\u0000"')])

    def make(where: tuple, value: Raw) -> Case:
        path, place = where
        content = as_bytes(replaced(documents[path], [str(k) for k in place], value))
        return case(path, READERS[path][0], content, refused())

    return st.builds(make, st.sampled_from(numbers), none)
