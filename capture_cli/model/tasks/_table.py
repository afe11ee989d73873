"""A table of a task.toml, read key by key: what is wrong with one is said with its place and the cure."""

from collections.abc import Collection
from typing import Any

from capture_cli.common.documents import SETTINGS as DOCUMENTS
from capture_cli.errors import TaskError, did_you_mean

REQUIRED = object()  # the default of a key that has none


class Table:
    """The table `entry` of the file, which messages place at `where`. Every method raises TaskError.

    keys: that it may have; whether it has others is told at once.
    """

    def __init__(self, entry: Any, where: str, keys: Collection[str]):
        if not isinstance(entry, dict):
            raise TaskError(f"{where} is {entry!r}, not a table", cure="write it as a [table] with keys")
        self.entry, self.where = entry, where
        for key in entry:
            if key not in keys:
                raise self.error(f"unknown key {key!r}", cure=did_you_mean(key, keys))

    def __contains__(self, key: str) -> bool:
        return key in self.entry

    def error(self, what: str, *, cure: str) -> TaskError:
        return TaskError(f"{self.where}: {what}", cure=cure)

    def given(self, key: str) -> str:
        """What it says of the key, for a message."""
        return f"{key} = {self.entry[key]!r}" if key in self.entry else f"{key!r} is missing"

    def tables(self, key: str) -> list[tuple[str, Any]]:
        """What is in the table of that key, by name; nothing where there is none."""
        section = self.entry.get(key, {})
        if not isinstance(section, dict):
            raise self.error(f"{key} is {section!r}", cure=f"write [{key}.NAME] tables")
        return list(section.items())

    def text(self, key: str, default: Any = REQUIRED) -> Any:
        """The text of the key, not empty."""
        value = self._value(key, "a string", default)
        if value is default or (isinstance(value, str) and value):
            return value
        raise self._other(key, "a string")

    def number(self, key: str, default: Any = REQUIRED) -> Any:
        """The number of the key, no larger than any quantity."""
        value = self._value(key, "a number", default)
        if value is default:
            return value
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise self._other(key, "a number")
        if abs(value) > DOCUMENTS.largest:
            raise self.error(
                f"{key} = {value:g}, and no quantity is larger than {DOCUMENTS.largest:g} in SI units",
                cure="correct it, or its unit",
            )
        return float(value)

    def positive(self, key: str, default: Any = None, *, cure: str) -> Any:
        """The number of the key, which is above 0. cure: where it is not."""
        value = self.number(key, default)
        if value is not None and value <= 0:
            raise self.error(f"{key} = {value:g}", cure=cure)
        return value

    def flag(self, key: str, default: bool) -> bool:
        """Whether the key is true."""
        value = self._value(key, "true or false", default)
        if not isinstance(value, bool):
            raise self._other(key, "true or false")
        return value

    def _value(self, key: str, kind: str, default: Any) -> Any:
        if key not in self.entry and default is REQUIRED:
            raise self.error(f"{key!r} is missing", cure=f"add `{key} = ...` ({kind})")
        return self.entry.get(key, default)

    def _other(self, key: str, kind: str) -> TaskError:
        """The error of a key that is not of its kind."""
        cure = 'give a unit: "1" for a number without one' if key == "unit" else f"give {kind}"
        return self.error(f"{key} = {self.entry[key]!r}", cure=cure)
