"""A result on disk: a folder with NAME.json, what was found, NAME.zarr, the curves, and how it was made."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from capture_cli.common.documents import SETTINGS as DOCUMENTS
from capture_cli.common.documents import read_json
from capture_cli.errors import StoreError
from capture_cli.store import provenance
from capture_cli.store.document_shape import OBJECT, TEXT, check_shape
from capture_cli.store.output import PROVENANCE
from capture_cli.store.provenance import write_json
from capture_cli.store.schema import Migrations, Schema, migrated

Row = Mapping[str, Any]
Rows = Mapping[str, Row]


@dataclass(frozen=True, kw_only=True)
class Keys:
    """What is read of a JSON document, by its keys."""

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> Self:
        """Of the document, which may have other keys besides."""
        return cls(**{f.name: document[f.name] for f in fields(cls) if f.name in document})


@dataclass(frozen=True, kw_only=True)
class Record(Keys):
    """What reports read of the JSON document of an estimate or a diagnosis, by its keys; the meaning of each is in
    docs/schemas.md. None is what an earlier version did not write.
    """

    task: str | None = None
    log: Row | None = None
    parameters: Rows | None = None
    undetermined: Sequence[Row] | None = None
    noise_floor: Mapping[str, float] | None = None
    noise_floor_source: Mapping[str, str] | None = None
    prediction: Row | None = None
    held_out: Row | None = None
    beyond_fitted: Row | None = None
    impossible_inertia: Sequence[Row] | None = None
    time_step: Row | None = None
    time_stamps: Row | None = None
    input_timing: Row | None = None
    split: Row | None = None
    rollouts: Mapping[str, int] | None = None
    effects: Sequence[Row] | None = None
    verdict: str | None = None
    summary: str | None = None
    lack_of_fit: Row | None = None


@dataclass(frozen=True)
class DocumentKind:
    """What a JSON document is: its format and version. cure: of one that cannot be read. shape: of what is read of it.

    earlier: for each version before this one that is read, what makes its document one of the next.
    """

    format: str
    version: int
    cure: str
    shape: Mapping[str, Any] = field(default_factory=dict)
    earlier: Migrations = field(default_factory=dict)


@dataclass(frozen=True)
class Result:
    """NAME.json as a dict (`document`) and the arrays of NAME.zarr by path.

    KIND is that of NAME.json, and SCHEMA that of NAME.zarr. RECORD: of the document.
    """

    NAME: ClassVar[str]
    KIND: ClassVar[DocumentKind]
    SCHEMA: ClassVar[Schema]
    RECORD: ClassVar[type[Record]] = Record

    document: dict[str, Any]
    arrays: dict[str, np.ndarray]
    attributes: dict[str, Any]

    @property
    def record(self) -> Record:
        """The document as reports read it."""
        return self.RECORD.of(self.document)

    def changed(self, **keys: Any) -> Self:
        """With other values of these keys of the document."""
        return replace(self, document={**self.document, **keys})

    def write(self, folder: Path) -> None:
        write_json(folder / f"{self.NAME}.json", self.document)
        self.SCHEMA.write(folder / f"{self.NAME}.zarr", self.arrays, self.attributes)

    @classmethod
    def read(cls, folder: Path) -> Self:
        """The result in `folder`. Raises StoreError where it is none, damaged or of another version."""
        document = cls.read_document(folder)
        return cls(document, *cls.SCHEMA.read(Path(folder) / f"{cls.NAME}.zarr"))

    @classmethod
    def read_document(cls, folder: Path) -> dict[str, Any]:
        """NAME.json alone. Raises StoreError where there is none, or it is damaged or of another version."""
        name = f"{cls.NAME}.json"
        document = read_result(Path(folder), name, cls.KIND)
        check_bounds(document, Path(folder) / name, cls.KIND.cure)
        return document


def check_bounds(document: Mapping[str, Any], where: object, cure: str) -> None:
    """Raise StoreError where a parameter is outside of the bounds that are written beside it, or an effect's is larger
    than any quantity: no fit goes there.
    """
    declared, effects = document.get("parameters"), document.get("effects")
    for name, parameter in declared.items() if isinstance(declared, dict) else ():
        if "low" not in parameter or "high" not in parameter:
            continue
        value, low, high = (parameter[key] for key in ("value", "low", "high"))
        if not is_within(value, low, high):
            raise StoreError(
                f"{where}: {name} = {value:g} is outside of its bounds, {low:g} to {high:g}", cure=cure
            )
    for effect in effects or ():
        for name, parameter in effect["parameters"].items():
            if abs(parameter["value"]) > DOCUMENTS.largest:
                raise StoreError(
                    f"{where}: {effect['name']}@{effect['site']}.{name} = {parameter['value']:g}, and no quantity is "
                    f"larger than {DOCUMENTS.largest:g} in SI units",
                    cure=cure,
                )


def is_within(value: float, low: float, high: float) -> bool:
    """Whether a fit between these bounds may have ended at the value."""
    rounding = 1e-9  # of a range: a value at one end may be beyond it in its last digits
    slack = rounding * (high - low)
    return low - slack <= value <= high + slack


def read_provenance(folder: Path, cure: str) -> dict[str, Any]:
    """The provenance.json of a result directory. Raises StoreError where it is none, damaged or of another version."""
    shape = {"options": OBJECT, "inputs": {str: {"path": TEXT, "sha256": TEXT}}}
    return read_result(folder, PROVENANCE, DocumentKind(provenance.FORMAT, provenance.VERSION, cure, shape))


def read_result(folder: Path, name: str, kind: DocumentKind) -> dict[str, Any]:
    """The JSON document `name` of a result directory, as of the version of its kind. Raises StoreError where it is
    none, or lacks or mistypes what the shape says.
    """
    path, cure = folder / name, kind.cure
    if not folder.exists():
        raise StoreError(f"{folder} does not exist", cure="check the path")
    if not path.is_file():
        raise StoreError(f"{folder} holds no {name}", cure=f"give the directory that holds it; {cure}")
    document = read_json(path, StoreError, cure=cure)
    if not isinstance(document, dict) or document.get("format") != kind.format:
        raise StoreError(f"{path} is not of the format {kind.format}", cure=cure)
    document = migrated(document, kind.earlier)
    if (version := document.get("version")) != kind.version:
        raise StoreError(
            f"{path}: {kind.format} version {version!r}; this program reads {kind.version}", cure=cure
        )
    check_shape(document, kind.shape, path, cure)
    return document
