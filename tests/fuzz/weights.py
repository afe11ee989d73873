"""safetensors: headers that promise too much, tensors of other types and sizes, weights that no training makes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from fuzz.cases import Case, Expected, refused, taken
from fuzz.mutations import DEEP, Raw, Sound, json_text, json_values, mutated, mutated_bytes

POLICY, IDENTIFIER = "policy/policy.safetensors", "identifier/identifier.safetensors"
LENGTH = 8  # bytes, before the header
READERS = {
    POLICY: (
        ("inspect policy --json", ()),
        ("inspect policy", ()),
        ("record --task scooping --policy policy --threads 1 --out new.zarr", ("new.zarr", "new.truth.json")),
        (
            "gen-histories --task scooping --policy policy --pairs 2 --rounds 2 --threads 1 --out new.zarr",
            ("new.zarr",),
        ),
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
FLOATS = {"F64": "<f8", "F32": "<f4", "F16": "<f2"}
TYPES = ("F64", "F32", "F16", "BF16", "I64", "I32", "U8", "BOOL", "F8_E4M3", "C64", "F4", "X", "", 5, None)
SHAPES = ([], [0], [1], [-1], [2**40, 2**40], [64], [64, 64], ["a"], "ab", None, [1.5])
OFFSETS = ([0, 0], [0, 4], [4, 0], [-4, 4], [0, 2**40], [0], "ab", None, [2**63, 2**63 + 4])


def seeds(inputs: Path) -> list[Case]:
    header, data = parts((inputs / POLICY).read_bytes())
    arrays, learned = tensors(header, data), tensors(*parts((inputs / IDENTIFIER).read_bytes()))

    def seed(name: str, content: bytes, expected: Expected, of: int = 0, path: str = POLICY) -> Case:
        return case(path, READERS[path][of], content, expected, name)

    def of_type(change) -> bytes:
        return packed({n: change(a) for n, a in arrays.items()})

    def whole(change: dict) -> bytes:
        return joined(json_text({**header, **change}).encode(), data)

    first = next(n for n in header if n != "__metadata__")
    large, int32, nan = (
        of_type(lambda a: a * 0 + np.float32(1e30)),
        of_type(lambda a: a.astype(np.int32)),
        of_type(lambda a: a * np.float32(np.nan)),
    )
    return [
        *(
            seed(f"{name}, {how}", content, refused(words), of)
            for name, content, words in (
                ("int32", int32, "int32"),
                ("1e30", large, "1e+30"),
                ("nan", nan, "finite"),
            )
            for of, how in ((0, "inspected"), (2, "recorded"))
        ),
        *(
            seed(
                f"{what} of {tensor} of {path}, {how}",
                packed({**own, tensor: change(own[tensor])}),
                refused(tensor, "expected"),
                of,
                path,
            )
            for path, own, tensors_ in (
                (POLICY, arrays, ("0.bias", "2.weight")),
                (IDENTIFIER, learned, ("network.spread_head.0.bias", "family.usual", "normalisation.spread")),
            )
            for tensor in tensors_
            for what, change in (
                ("one axis more", lambda a: a[..., None]),
                ("three times the rows", lambda a: np.concatenate([a] * 3)),
                ("no number", lambda a: np.zeros(0, "f4")),
                ("one number", lambda a: np.float32(0)),
            )
            for of, how in ((0, "inspected"), (2, "used"))
        ),
        seed("as it is", (inputs / POLICY).read_bytes(), taken()),
        seed("a header 100,000 deep", joined(b'{"a": ' + DEEP.encode() + b"}", data), refused("levels deep")),
        seed("a header of 400 digits", joined(b'{"a": ' + b"9" * 400 + b"}", data), refused("digits")),
        seed("a header of 5,000 digits", joined(b'{"a": ' + b"9" * 5000 + b"}", data), refused("digits")),
        seed("a header of 2^63 bytes", (2**63).to_bytes(LENGTH, "little") + b"{}", refused()),
        seed("a header of 10 GB", (10**10).to_bytes(LENGTH, "little") + b"{}", refused()),
        seed(
            "a tensor of 2^80 elements",
            whole({first: {"dtype": "F32", "shape": [2**40, 2**40], "data_offsets": [0, 4]}}),
            refused(),
        ),
        seed(
            "a tensor beyond the file",
            whole({first: {"dtype": "F32", "shape": [2**38], "data_offsets": [0, 2**40]}}),
            refused(),
        ),
        seed("metadata that are no texts", whole({"__metadata__": {"a": Raw("5")}}), refused()),
        seed("an empty file", b"", refused()),
        seed("a file of seven bytes", b"\0" * 7, refused()),
        seed("a pickle", b"\x80\x04\x95" + b"a" * 100, refused()),
    ]


def parts(content: bytes) -> tuple[dict, bytes]:
    """The header of a file, and what comes after it."""
    end = LENGTH + int.from_bytes(content[:LENGTH], "little")
    return json.loads(content[LENGTH:end]), content[end:]


def joined(header: bytes, data: bytes) -> bytes:
    return len(header).to_bytes(LENGTH, "little") + header + data


def tensors(header: dict, data: bytes) -> dict[str, np.ndarray]:
    found = {}
    for name, spec in header.items():
        if name != "__metadata__":
            first, end = spec["data_offsets"]
            found[name] = np.frombuffer(data[first:end], dtype=FLOATS[spec["dtype"]]).reshape(spec["shape"])
    return found


def packed(arrays: dict[str, np.ndarray]) -> bytes:
    from safetensors.numpy import save

    return save({n: np.ascontiguousarray(a) for n, a in arrays.items()})


def case(path: str, reader: tuple, content: bytes, expected: Expected | None = None, name: str = "") -> Case:
    text, outputs = reader
    needs = {path.split("/")[0], *(n for n in ("scoops.zarr",) if n in text)}
    return Case(tuple(text.split()), tuple(sorted(needs)), {path: content}, outputs, expected, name)


def cases(inputs: Path) -> st.SearchStrategy[Case]:
    return st.one_of(
        *(
            st.builds(
                case,
                st.just(path),
                st.sampled_from(READERS[path]),
                damage(Sound((inputs / path).read_bytes())),
            )
            for path in READERS
        )
    )


@st.composite
def damage(draw, content: bytes) -> bytes:
    header, data = parts(content)
    names = [n for n in header if n != "__metadata__"]
    match draw(
        st.sampled_from(("entry", "entry", "header", "bytes", "length", "tensor", "tensor", "numbers"))
    ):
        case "entry":
            name, key = (
                draw(st.sampled_from(names)),
                draw(st.sampled_from(("dtype", "shape", "data_offsets"))),
            )
            pool = {"dtype": TYPES, "shape": SHAPES, "data_offsets": OFFSETS}[key]
            header[name] = {**header[name], key: draw(st.one_of(st.sampled_from(pool), json_values))}
        case "header":
            header = draw(mutated(header))
        case "bytes":
            return draw(mutated_bytes(content))
        case "length":
            length = draw(
                st.sampled_from(
                    (0, 1, 2, len(content) - LENGTH, len(content), 10**8, 2**40, 2**63, 2**64 - 1)
                )
            )
            return length.to_bytes(LENGTH, "little") + content[LENGTH:]
        case "tensor":
            return packed(draw(_changed(tensors(header, data))))
        case "numbers":
            data = draw(mutated_bytes(data))
    return joined(json_text(header).encode("utf-8", "surrogatepass"), data)


@st.composite
def _changed(draw, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """One tensor of another type, another shape or with other numbers, under another name, or left out."""
    name = draw(st.sampled_from(sorted(arrays)))
    array = arrays[name]
    match draw(st.sampled_from(("type", "shape", "numbers", "name", "remove"))):
        case "type":
            array = array.astype(draw(st.sampled_from(("f8", "f2", "i4", "u1", "?"))))
        case "shape":
            array = draw(
                st.sampled_from(
                    (
                        array[..., None],
                        array.reshape(-1),
                        array[:1],
                        array.T,
                        np.zeros(0, "f4"),
                        np.concatenate([array] * 3),
                    )
                )
            )
        case "numbers":
            array = array * np.float32(draw(st.sampled_from((0.0, -1.0, 1e3, 1e5, 1e30, np.nan, np.inf))))
        case "name":
            return {f"{n}x" if n == name else n: a for n, a in arrays.items()}
        case "remove":
            return {n: a for n, a in arrays.items() if n != name}
    return {**arrays, name: array}
