"""Histories: how parameters were walked from a source to a target, round by round (paper, Section III-C).

The store is sharded over pairs. A shard is written whole and then marked, by whichever process or host made it, so
that a run that was killed can go on, and so that no reader takes a part for the whole. The store lies in a folder, or
at any URL that zarr opens through fsspec.
"""

import json
import math
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.common.documents import exists
from capture_cli.common.frozen import frozen
from capture_cli.common.signals import uninterrupted
from capture_cli.errors import StoreError
from capture_cli.store.array_metadata import ArrayMetadata, array_metadata
from capture_cli.store.document_shape import (
    COUNT,
    EFFECTS,
    FEATURES,
    FLAG,
    NUMBER,
    PARAMETERS,
    TEXT,
    WHOLE,
    check_shape,
    or_none,
)
from capture_cli.store.schema import ArraySpec, Schema
from capture_cli.store.zarr_store import MAKE_AGAIN, ROOT, ZarrStore

MARKS = "written"


@frozen
class SETTINGS:
    chunk_pairs: int = 64  # the unit of reading


SCHEMA = Schema(
    format="capture/histories",
    version=2,
    arrays=(
        ArraySpec(
            "parameters",
            "pair round parameter",
            "per parameter",
            "what was simulated in each round: first the source, last the target",
        ),
        ArraySpec(
            "actions",
            "pair round action",
            "per action",
            "what drove both trajectories of the round, chosen by the policy that knew `parameters`",
        ),
        ArraySpec(
            "simulated",
            "pair round point feature",
            "per feature",
            "state trajectory under `parameters`",
            dtype="float32",
        ),
        ArraySpec(
            "measured",
            "pair round point feature",
            "per feature",
            "state trajectory under `target`, with noise",
            dtype="float32",
        ),
        ArraySpec("target", "pair parameter", "per parameter", "what the measured side was made with"),
        ArraySpec(MARKS, "shard", "-", "1 where a shard of pairs was written whole", dtype="uint8"),
    ),
    attributes={
        "complete": "whether every shard is written",
        "task": "name of the task",
        "model": "sha256 of the task's compiled model",
        "parameters": "list of {name, unit, low, high}, one per parameter",
        "actions": "list of {name, unit, low, high}, one per action",
        "library": "sha256 of the sequences that the actions of a task.toml are drawn from; null for other tasks",
        "features": "list of {name, unit, scale}, one per feature of a trajectory",
        "point_times": "s after the start of an episode at which a trajectory is read",
        "pairs": "number of histories",
        "shard_pairs": "histories per shard",
        "rounds": "entries per history",
        "search": "strategy that walked from source to target",
        "alpha": "shape of its symmetric Beta; null where it draws from none",
        "effects": "list of {name, site, parameters: {NAME: {value, unit, low, high, drawn}}}: what machines have "
        "beside the task's model; in `simulated` at `value`, in `measured` between the two of `drawn`, anew for each "
        "pair; low, high: between which it is looked for. Version 1 had none, and is read so",
        "noise": "kind of noise in `measured`: none, label (every third label is random) or scale (times U(0.9, 1.1))",
        "noise_sd": "{FEATURE: standard deviation} of white noise in `measured`, besides",
        "policy": "{name, sha256 of its checkpoint or null} of what chose the actions",
        "seed": "of every random choice",
        "mujoco": "version of MuJoCo that simulated",
    },
    cure_for_other_version="make it again with `capture gen-histories`",
    earlier={1: lambda attributes: {**attributes, "effects": []}},
)
SHAPE = {
    "complete": FLAG,
    "task": TEXT,
    "model": TEXT,
    "parameters": PARAMETERS,
    "actions": PARAMETERS,
    "library": or_none(TEXT),
    "features": FEATURES,
    "point_times": [NUMBER],
    "pairs": COUNT,
    "shard_pairs": COUNT,
    "rounds": COUNT,
    "search": TEXT,
    "alpha": or_none(NUMBER),
    "effects": EFFECTS,
    "noise": TEXT,
    "noise_sd": {str: NUMBER},
    "policy": {"name": TEXT, "sha256": or_none(TEXT)},
    "seed": WHOLE,
    "mujoco": TEXT,
}
_CHECK_URL = "check the URL, and that the package that opens its scheme is installed (s3fs for s3://)"
DATA = tuple(a for a in SCHEMA.arrays if a.path != MARKS)


def is_url(location: str) -> bool:
    """Whether `location` is a URL (of an object store, say) rather than a path."""
    return "://" in location


class HistoriesWriter:
    """Writes the shards of the store at `location`, in any order, from any number of processes."""

    def __init__(self, location: str):
        self.location = location

    def create(self, attributes: Mapping[str, Any]) -> None:
        """Make a store without shards, described by all `attributes` of the schema but `complete`."""
        header = SCHEMA.header({"complete": False, **attributes})
        sizes = _sizes(attributes)
        pairs, shard = sizes["pair"], attributes["shard_pairs"]
        chunk = math.gcd(SETTINGS.chunk_pairs, shard)
        with self._while_zarr_writes():
            group = self.clear()
            for spec in DATA:
                rest = tuple(sizes[d] for d in spec.dims[1:])
                _create(group, spec, (pairs, *rest), (chunk, *rest), (shard, *rest))
            _create(group, SCHEMA.arrays[-1], (sizes["shard"],), (1,), None)
            # last: until now, whoever opens it finds no store
            group.attrs.update(header)

    def attributes(self) -> dict[str, Any] | None:
        """Those of the store there, None where there is none. Raises StoreError where that cannot be told."""
        if not is_url(self.location) and not exists(Path(self.location) / ROOT, StoreError):
            return None
        try:
            found = _open(self.location).attributes
        except FileNotFoundError:
            return None
        if not found:
            return None  # a run that was killed before it had described the store
        return SCHEMA.checked(self.location, found)

    def clear(self):
        """Remove what is there; returns the group, in which nothing is left."""
        import zarr

        return zarr.open_group(self.location, mode="w", zarr_format=3)

    def remove_halves(self) -> None:
        """Remove half-written files of a run that was killed; no other process may write meanwhile.

        Zarr writes a file beside its place and renames it. Objects at a URL are written whole or not at all.
        """
        if not is_url(self.location):
            for half in Path(self.location).rglob("*.partial"):
                half.unlink()

    def is_written(self) -> np.ndarray:
        """Which shards are marked as whole, bool (shard,)."""
        return np.asarray(_open(self.location).open(MARKS)[...]).astype(bool)

    def _while_zarr_writes(self) -> AbstractContextManager[None]:
        """Hold signals back from a folder: zarr's threads would go on to write where it was cleared away."""
        return nullcontext() if is_url(self.location) else uninterrupted()

    def write(self, shard: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Write the histories of one shard, then mark it."""
        import zarr

        with self._while_zarr_writes():
            group = zarr.open_group(self.location, mode="r+")
            rows = shard_rows(shard, group.attrs["shard_pairs"], group["target"].shape[0])
            for spec in DATA:
                group[spec.path][rows] = arrays[spec.path].astype(spec.dtype)
            group[MARKS][shard] = 1

    def is_sound(self, shard: int) -> bool:
        """Whether what a marked shard holds can be read, checksums and all."""
        store = _open(self.location)
        rows = shard_rows(shard, store.attributes["shard_pairs"], store.metadata("target").shape[0])
        try:
            return all(np.isfinite(store.open(spec.path)[rows]).all() for spec in DATA)
        except Exception:  # whatever a codec raises on damaged bytes
            return False

    def finish(self) -> None:
        """Mark the store as complete."""
        import zarr

        if not self.is_written().all():
            raise ValueError(f"{self.location}: shards are missing")
        with self._while_zarr_writes():
            zarr.open_group(self.location, mode="r+").attrs["complete"] = True


class Histories:
    """A finished store, read a part at a time. Opening reads the attributes alone."""

    def __init__(self, location: str | Path):
        self.location = str(location)
        try:
            self._store = _open(self.location)
        except FileNotFoundError as error:
            raise StoreError(f"{location} does not exist", cure=_CHECK_URL) from error
        self.attributes = SCHEMA.checked(self.location, self._store.attributes)
        check_shape(self.attributes, SHAPE, self.location, SCHEMA.cure_for_other_version)
        if not self.attributes["complete"]:
            raise StoreError(
                f"{self.location} is not finished",
                cure="run the `capture gen-histories` that began it again, with --resume",
            )
        self._check_shapes()
        self._arrays = {spec.path: self._store.open(spec.path) for spec in DATA}

    def __len__(self) -> int:
        return int(self.attributes["pairs"])

    def read(self, first: int, last: int) -> dict[str, np.ndarray]:
        """The arrays of the histories [first, last). Raises StoreError where one of them is missing or damaged."""
        return {spec.path: self._read(spec.path, first, last) for spec in DATA}

    def _read(self, name: str, first: int, last: int) -> np.ndarray:
        again = "make the histories again with `capture gen-histories`"
        try:
            values = np.asarray(self._arrays[name][first:last])
        except Exception as error:  # whatever a codec raises on damaged bytes
            raise StoreError(f"{self.location}: {name} cannot be decoded: {error}", cure=again) from error
        bad = np.flatnonzero(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))
        if bad.size:
            raise StoreError(
                f"{self.location}: {name} of pair {first + bad[0]} is missing or not finite", cure=again
            )
        return values

    def _check_shapes(self) -> None:
        sizes = _sizes(self.attributes)
        for spec in DATA:
            metadata = self._store.metadata(spec.path)
            expected = tuple(sizes[d] for d in spec.dims)
            found = None if metadata is None else metadata.shape
            if found != expected:
                raise StoreError(
                    f"{self.location}: {spec.path} has shape {found}; its attributes say {expected}",
                    cure="make the histories again with `capture gen-histories`",
                )


def shard_rows(shard: int, shard_pairs: int, pairs: int) -> slice:
    """Which pairs a shard holds."""
    return slice(shard * shard_pairs, min(pairs, (shard + 1) * shard_pairs))


def _sizes(attributes: Mapping[str, Any]) -> dict[str, int]:
    return {
        "pair": attributes["pairs"],
        "round": attributes["rounds"],
        "parameter": len(attributes["parameters"]),
        "action": len(attributes["actions"]),
        "point": len(attributes["point_times"]),
        "feature": len(attributes["features"]),
        "shard": -(-attributes["pairs"] // attributes["shard_pairs"]),
    }


def _create(group, spec: ArraySpec, shape, chunks, shards) -> None:
    from zarr.codecs import Crc32cCodec, ZstdCodec

    spec.created(
        group,
        shape=shape,
        chunks=tuple(max(1, n) for n in chunks),
        shards=None if shards is None else tuple(max(1, n) for n in shards),
        compressors=(ZstdCodec(level=0), Crc32cCodec()),
        fill_value=0 if spec.path == MARKS else float("nan"),  # what was never written cannot pass for data
    )


class _RemoteStore:
    """The store at a URL, as ZarrStore is one in a folder. Zarr reads its metadata, of version 3 alone: what these
    name is looked up among what Zarr itself brings.
    """

    def __init__(self, location: str):
        import zarr

        self.location = location
        try:
            self._group = zarr.open_group(location, mode="r", zarr_format=3)
        except FileNotFoundError:
            raise
        except Exception as error:  # of the network, or of a package that is not there
            raise StoreError(
                f"{location} cannot be opened: {type(error).__name__}: {error}", cure=_CHECK_URL
            ) from error
        self.attributes = dict(self._group.attrs)

    def metadata(self, name: str) -> ArrayMetadata | None:
        try:
            array = self._group.get(name)
        except Exception as error:  # JSON, key, type and codec errors, by what is damaged
            raise StoreError(
                f"{self.location}: the metadata of {name} cannot be read: {type(error).__name__}: {error}",
                cure=MAKE_AGAIN,
            ) from error
        if not hasattr(array, "shape"):
            return None
        where = f"{self.location}: the metadata of {name}"
        document = json.loads(json.dumps(array.metadata.to_dict(), default=str))  # without tuples
        return array_metadata(document, dict(array.attrs), where, MAKE_AGAIN)

    def open(self, name: str):
        self.metadata(name).check(f"{self.location}: {name}", MAKE_AGAIN)
        return self._group[name]


def _open(location: str) -> ZarrStore | _RemoteStore:
    """The store at `location`. Raises StoreError, or of a URL FileNotFoundError, where there is none."""
    made_by = "histories are made by `capture gen-histories`"
    return _RemoteStore(location) if is_url(location) else ZarrStore(Path(location), made_by)
