"""A schema is a table of arrays; it writes a store, reads and checks one, and prints itself for the docs."""

from __future__ import annotations

import shlex
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.errors import StoreError, did_you_mean

CHUNK_BYTES = 4 << 20
_MAKE_AGAIN = "the store is damaged: copy it again, or make it again with the command that wrote it"


@dataclass(frozen=True)
class ArraySpec:
    """One array of a store: where it is, its axes by name, and what its numbers mean."""

    path: str
    dims: tuple[str, ...]
    dtype: str
    unit: str
    meaning: str
    optional: bool = False


# where the simulation of each window begins; results of before these were written have none
STARTS = (
    ArraySpec(
        "window/start_time",
        ("window",),
        "float64",
        "s",
        "when its simulation begins, on the log's clock",
        True,
    ),
    ArraySpec("window/start_qpos", ("window", "qpos"), "float64", "SI", "in which positions", True),
    ArraySpec("window/start_qvel", ("window", "qvel"), "float64", "SI", "with which velocities", True),
    ArraySpec("window/start_act", ("window", "act"), "float64", "SI", "and activations of actuators", True),
)


@dataclass(frozen=True)
class Schema:
    """The arrays and attributes of one kind of Zarr store, at one version."""

    format: str
    version: int
    arrays: tuple[ArraySpec, ...]
    attributes: Mapping[str, str]
    cure_for_other_version: str

    def write(self, path: Path, arrays: Mapping[str, np.ndarray], attributes: Mapping[str, Any]) -> None:
        """Write `arrays` (by path) and `attributes` into a new Zarr v3 group at `path`.

        Every chunk is written, zeros too, and carries a checksum, so that one that goes missing or is damaged
        later is noticed on reading.
        """
        import zarr

        missing = set(self.attributes) - set(attributes)
        if missing:
            raise ValueError(f"{self.format}: attributes {sorted(missing)} are not given")
        with zarr.config.set({"array.write_empty_chunks": True}):
            group = zarr.open_group(str(path), mode="w", zarr_format=3)
            group.attrs.update({"format": self.format, "version": self.version, **attributes})
            for spec in self.arrays:
                if spec.path not in arrays:
                    if not spec.optional:
                        raise ValueError(f"{self.format}: array {spec.path} is not given")
                    continue
                self._write_array(group, spec, np.asarray(arrays[spec.path]))

    @staticmethod
    def _write_array(group, spec: ArraySpec, values: np.ndarray) -> None:
        from zarr.codecs import ZstdCodec

        values = np.ascontiguousarray(values, dtype=spec.dtype)
        row_bytes = max(1, values[:1].nbytes)
        rows = max(1, min(values.shape[0] if values.ndim else 1, CHUNK_BYTES // row_bytes))
        chunks = (rows, *(max(1, n) for n in values.shape[1:]))
        array = group.create_array(
            spec.path,
            shape=values.shape,
            dtype=values.dtype,
            chunks=chunks,
            compressors=ZstdCodec(level=0, checksum=True),
            dimension_names=spec.dims,
            attributes={"unit": spec.unit, "meaning": spec.meaning},
        )
        array[...] = values

    def read(self, path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """The arrays by path and the attributes of the store at `path`.

        Raises StoreError if it is not there, foreign, of another version, truncated, or its axes disagree.
        """
        group = open_group(path)
        attributes = dict(group.attrs)
        self.check_header(path, attributes)
        arrays = {}
        for spec in self.arrays:
            array = open_array(path, group, spec.path)
            if array is not None:
                arrays[spec.path] = self._read_array(path, array, spec)
            elif not spec.optional:
                there_are = did_you_mean(spec.path, array_paths(group))
                raise StoreError(f"{path}: the array {spec.path!r} is missing; {there_are}", cure=_MAKE_AGAIN)
        self._check_axes(path, arrays)
        return arrays, attributes

    def check_header(self, path: Path, attributes: Mapping[str, Any]) -> None:
        found = attributes.get("format")
        if found != self.format:
            what = f"its format is {found!r}" if found else "it has no 'format' attribute"
            raise StoreError(
                f"{path} is not a {self.format} store: {what}",
                cure="`capture inspect PATH` tells what it is; `capture import-log` reads other tools' logs",
            )
        if attributes.get("version") != self.version:
            raise StoreError(
                f"{path}: {self.format} version {attributes.get('version')!r}; "
                f"this program reads {self.version}",
                cure=self.cure_for_other_version,
            )
        missing = [name for name in self.attributes if name not in attributes]
        if missing:
            raise StoreError(
                f"{path}: attributes missing: {', '.join(missing)}",
                cure=_MAKE_AGAIN,
            )

    @staticmethod
    def _read_array(path: Path, array, spec: ArraySpec) -> np.ndarray:
        if array.ndim != len(spec.dims):
            raise StoreError(
                f"{path}: {spec.path} has shape {array.shape}; expected axes ({', '.join(spec.dims)})",
                cure=_MAKE_AGAIN,
            )
        try:
            if array.nchunks_initialized < array.nchunks:
                raise StoreError(
                    f"{path}: {spec.path} has {array.nchunks_initialized} of its {array.nchunks} chunks: "
                    "it is truncated",
                    cure=f"{_MAKE_AGAIN} (another program that writes one must write empty chunks too)",
                )
            return np.asarray(array[...]).astype(spec.dtype, copy=False)
        except StoreError:
            raise
        except Exception as error:  # whatever a codec raises on damaged bytes
            raise StoreError(f"{path}: {spec.path} cannot be decoded: {error}", cure=_MAKE_AGAIN) from error

    def _check_axes(self, path: Path, arrays: Mapping[str, np.ndarray]) -> None:
        sizes: dict[str, tuple[int, str]] = {}
        for spec in self.arrays:
            if spec.path not in arrays:
                continue
            for axis, size in zip(spec.dims, arrays[spec.path].shape, strict=True):
                first, where = sizes.setdefault(axis, (size, spec.path))
                if first != size:
                    raise StoreError(
                        f"{path}: axis {axis!r} has {first} entries in {where} and {size} in {spec.path}",
                        cure=_MAKE_AGAIN,
                    )

    def markdown(self) -> str:
        """The schema as the tables of docs/schemas.md."""
        lines = [f"### {self.format}, version {self.version}", "", "| array | axes | type | unit | meaning |"]
        lines.append("|---|---|---|---|---|")
        for a in self.arrays:
            optional = " (optional)" if a.optional else ""
            lines.append(
                f"| `{a.path}`{optional} | {', '.join(a.dims)} | {a.dtype} | {a.unit} | {a.meaning} |"
            )
        lines += ["", "| attribute | meaning |", "|---|---|"]
        lines += [f"| `{name}` | {meaning} |" for name, meaning in self.attributes.items()]
        return "\n".join(lines)


def open_group(path: Path):
    """The Zarr group (v3 or v2) at `path`, read-only. Raises StoreError where there is none."""
    import zarr

    path = Path(path)
    if not path.exists():
        raise StoreError(f"{path} does not exist", cure="check the path")
    if not path.is_dir():
        raise StoreError(
            f"{path} is a file, not a Zarr store",
            cure=f"read it in first: `capture import-log {shlex.quote(str(path))} --task task.toml "
            f"--out {shlex.quote(path.stem)}.zarr`",
        )
    try:
        return zarr.open_group(str(path), mode="r")
    except Exception as error:
        raise StoreError(
            f"{path} is not a readable Zarr group: {type(error).__name__}: {error}",
            cure="check the path; a log is read in by `capture import-log FILE --task task.toml --out LOG.zarr`",
        ) from error


def open_array(path: Path | str, group, name: str):
    """The array called `name`, or None where there is none. Raises StoreError on damaged metadata."""
    import zarr

    try:
        item = group.get(name)
    except Exception as error:  # JSON, key, type and codec errors, by what is damaged
        raise StoreError(
            f"{path}: the metadata of {name} cannot be read: {type(error).__name__}: {error}",
            cure=_MAKE_AGAIN,
        ) from error
    return item if isinstance(item, zarr.Array) else None


def array_paths(group) -> list[str]:
    """The paths of all arrays in `group`, at any depth. Raises StoreError on damaged metadata."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # zarr warns of files of ours that lie beside the arrays
            return [name for name, item in group.members(max_depth=None) if hasattr(item, "shape")]
    except Exception as error:  # JSON, key, type and codec errors, by what is damaged
        raise StoreError(
            f"the arrays of {group.store} cannot be listed: {error}", cure=_MAKE_AGAIN
        ) from error
