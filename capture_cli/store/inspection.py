"""What `capture inspect` found of a file or a folder: one record, which reports show and JSON is written from."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

FORMAT = "capture/inspection"
VERSION = 1


@dataclass
class Inspection:
    """store: the format and version found, bytes on disk. checked: whether the content was read, and not only found.
    findings: {severity, where, message, cure} each. result: of what a command made, what it is of, what was found or
    learned, and how well it does. Of a measured log: recordings, episodes (timing), channels (values). What
    is not given at first is in the document where it was set.
    """

    path: str
    kind: str
    store: dict[str, Any]
    provenance: dict[str, Any] | None
    sizes: dict[str, int]
    checked: bool
    findings: list[dict[str, str]]
    task: str | None = field(init=False, default=None)
    result: dict[str, Any] | None = field(init=False, default=None)
    episodes: list[dict[str, Any]] = field(init=False, default=())
    recordings: list[dict[str, Any]] = field(init=False, default=())
    channels: list[dict[str, Any]] = field(init=False, default=())
    time_scatter: dict[str, Any] | None = field(init=False, default=None)
    arrays: list[dict[str, Any]] = field(init=False, default=())

    def header(self, attributes: Mapping[str, Any]) -> None:
        """Take over what a store or a JSON document says it is."""
        self.store.update(format=attributes.get("format"), version=attributes.get("version"))

    def to_document(self) -> dict[str, Any]:
        """The JSON document; keys as they were set."""
        return {"format": FORMAT, "version": VERSION, **vars(self)}
