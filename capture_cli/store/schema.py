"""A schema is a table of arrays; it writes a store, reads and checks one, and stands in the docs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.common.signals import uninterrupted
from capture_cli.errors import StoreError, did_you_mean
from capture_cli.store.array_metadata import ArrayMetadata
from capture_cli.store.zarr_store import MAKE_AGAIN, ZarrStore

_WRITTEN_AS = {"f": "fiu", "i": "iu", "u": "iu", "b": "b"}  # kinds of numbers, by that of the schema


Migrations = Mapping[int, Callable[[Mapping[str, Any]], Mapping[str, Any]]]


def migrated(found: Mapping[str, Any], earlier: Migrations) -> dict[str, Any]:
    """A document or attributes as of the version after the last of those in `earlier`, if of one that is read."""
    while isinstance(version := found.get("version"), int) and version in earlier:
        found = {**earlier[version](found), "version": version + 1}
    return dict(found)


@dataclass(frozen=True)
class ArraySpec:
    """One array of a store: where it is, the names of its axes (with spaces between), and what its numbers mean."""

    path: str
    axes: str
    unit: str
    meaning: str
    dtype: str = "float64"
    optional: bool = False

    @property
    def dims(self) -> tuple[str, ...]:
        return tuple(self.axes.split())

    def created(self, group, **how: Any):
        """A new Zarr array of it in `group`. how: shape, chunks, compressors."""
        described = {"unit": self.unit, "meaning": self.meaning}
        return group.create_array(
            self.path, dtype=self.dtype, dimension_names=self.dims, attributes=described, **how
        )


# windows and their steps, in every result that has windows
WINDOWS = (
    ArraySpec("window/episode", "window", "-", "episode each window comes from", dtype="int64"),
    ArraySpec("window/first", "window", "steps", "first step of each window in the log", dtype="int64"),
)
STEPS = (
    ArraySpec("step/window", "step", "-", "window each step belongs to", dtype="int64"),
    ArraySpec("step/time", "step", "s", "time of each step, on the log's clock"),
    ArraySpec("step/measured", "step output", "per output", "measured; NaN: no sample"),
)
# where the simulation of each window begins; results of before these were written have none
INITIAL_STATES = (
    ArraySpec(
        "window/start_time", "window", "s", "when its simulation begins, on the log's clock", optional=True
    ),
    ArraySpec("window/start_qpos", "window qpos", "SI", "in which positions", optional=True),
    ArraySpec("window/start_qvel", "window qvel", "SI", "with which velocities", optional=True),
    ArraySpec("window/start_act", "window act", "SI", "and activations of actuators", optional=True),
)


@dataclass(frozen=True)
class Schema:
    """The arrays and attributes of one kind of Zarr store, at one version."""

    format: str
    version: int
    arrays: tuple[ArraySpec, ...]
    attributes: Mapping[str, str]
    cure_for_other_version: str
    # for each version before this one that is read, what makes its attributes those of the next
    earlier: Migrations = field(default_factory=dict)

    @uninterrupted()  # zarr has threads, which would go on to write where the folder was cleared away
    def write(self, path: Path, arrays: Mapping[str, np.ndarray], attributes: Mapping[str, Any]) -> None:
        """Write `arrays` (by path) and `attributes` into a new Zarr v3 group at `path`.

        Every chunk is written, zeros too, and carries a checksum, so that one that goes missing or is damaged
        later is noticed on reading.
        """
        import zarr

        header = self.header(attributes)
        with zarr.config.set({"array.write_empty_chunks": True}):
            group = zarr.open_group(str(path), mode="w", zarr_format=3, attributes=header)
            for spec in self.arrays:
                if spec.path not in arrays:
                    if not spec.optional:
                        raise ValueError(f"{self.format}: array {spec.path} is not given")
                    continue
                self._write_array(group, spec, np.asarray(arrays[spec.path]))

    def header(self, attributes: Mapping[str, Any]) -> dict[str, Any]:
        """The attributes of a new store, with its format and version. Raises ValueError where some are not given."""
        missing = set(self.attributes) - set(attributes)
        if missing:
            raise ValueError(f"{self.format}: attributes {sorted(missing)} are not given")
        return {"format": self.format, "version": self.version, **attributes}

    @staticmethod
    def _write_array(group, spec: ArraySpec, values: np.ndarray) -> None:
        from zarr.codecs import ZstdCodec

        values = np.ascontiguousarray(values, dtype=spec.dtype)
        row_bytes = max(1, values[:1].nbytes)
        chunk_bytes = 4 << 20
        rows = max(1, min(values.shape[0] if values.ndim else 1, chunk_bytes // row_bytes))
        chunks = (rows, *(max(1, n) for n in values.shape[1:]))
        packed = ZstdCodec(level=0, checksum=True)
        spec.created(group, shape=values.shape, chunks=chunks, compressors=packed)[...] = values

    def read(
        self, path: Path, most: int | None = None, larger: str = MAKE_AGAIN
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """The arrays by path and the attributes of the store at `path`.

        most: bytes that its arrays may take in memory; None: as `ZarrStore.read` has it. larger: the cure of more.
        Raises StoreError if it is not there, foreign, of another version, too large or truncated, or its axes disagree.
        """
        store = ZarrStore(path)
        attributes = self.checked(path, store.attributes)
        found = {}
        for spec in self.arrays:
            metadata = store.metadata(spec.path)
            if metadata is not None:
                found[spec.path] = metadata
            elif not spec.optional:
                there_are = did_you_mean(spec.path, store.names())
                raise StoreError(f"{path}: the array {spec.path!r} is missing; {there_are}", cure=MAKE_AGAIN)
        self._check_axes(path, {name: metadata.shape for name, metadata in found.items()})
        self._check_types(path, found)
        arrays = store.read(found, most, larger)
        types = {spec.path: spec.dtype for spec in self.arrays}
        return {name: a.astype(types[name], copy=False) for name, a in arrays.items()}, attributes

    def _check_types(self, path: Path, found: Mapping[str, ArrayMetadata]) -> None:
        """Raise StoreError where what counts or is a flag has another type of numbers."""
        for spec in self.arrays:
            kinds = _WRITTEN_AS[np.dtype(spec.dtype).kind]
            metadata = found.get(spec.path)
            if metadata is not None and metadata.is_of_numbers and np.dtype(metadata.dtype).kind not in kinds:
                raise StoreError(
                    f"{path}: {spec.path} is of type {metadata.kind}; expected {spec.dtype}", cure=MAKE_AGAIN
                )

    def checked(self, path: Path | str, attributes: Mapping[str, Any]) -> dict[str, Any]:
        """`attributes` of the store at `path`, as of this version where they are of an earlier one that is read.

        Raises StoreError where they are of another format or version, or some are missing.
        """
        found = attributes.get("format")
        if found != self.format:
            what = f"its format is {found!r}" if found else "it has no 'format' attribute"
            raise StoreError(
                f"{path} is not a {self.format} store: {what}",
                cure="`capture inspect PATH` tells what it is; `capture import-log` reads other tools' logs",
            )
        attributes = migrated(attributes, self.earlier)
        if attributes.get("version") != self.version:
            raise StoreError(
                f"{path}: {self.format} version {attributes.get('version')!r}; "
                f"this program reads {self.version}",
                cure=self.cure_for_other_version,
            )
        missing = [name for name in self.attributes if name not in attributes]
        if missing:
            raise StoreError(f"{path}: attributes missing: {', '.join(missing)}", cure=MAKE_AGAIN)
        return attributes

    def _check_axes(self, path: Path, shapes: Mapping[str, tuple[int, ...]]) -> None:
        sizes: dict[str, tuple[int, str]] = {}
        for spec in self.arrays:
            if spec.path not in shapes:
                continue
            shape = shapes[spec.path]
            if len(shape) != len(spec.dims):
                raise StoreError(
                    f"{path}: {spec.path} has shape {shape}; expected axes ({', '.join(spec.dims)})",
                    cure=MAKE_AGAIN,
                )
            for axis, size in zip(spec.dims, shape, strict=True):
                first, where = sizes.setdefault(axis, (size, spec.path))
                if first != size:
                    raise StoreError(
                        f"{path}: axis {axis!r} has {first} entries in {where} and {size} in {spec.path}",
                        cure=MAKE_AGAIN,
                    )
