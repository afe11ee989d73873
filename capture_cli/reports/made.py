"""How a result was made, as the last section of a page: its inputs, and what provenance.json knows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from capture_cli.reports.page import section
from capture_cli.reports.quantities import significant

Fact = tuple[str, str]  # a title, and its value as HTML


def how_it_was_made(facts: Sequence[Fact], provenance: Mapping[str, Any] | None) -> str:
    """The section: `facts` of the result itself, then those of `provenance` (None: it is not known)."""
    facts = [*facts, *(_provenance_facts(provenance) if provenance else [])]
    listed = "".join(f"<dt>{escape(title)}</dt><dd>{value}</dd>" for title, value in facts)
    return section("How it was made", f'<dl class="facts">{listed}</dl>')


def source(path: str, sha256: str) -> str:
    """A file that was read, with its hash, as HTML."""
    return f"<code>{escape(path)}</code><br><code class=quiet>sha256 {escape(sha256)}</code>"


def _provenance_facts(provenance: Mapping[str, Any]) -> list[Fact]:
    facts = [("command", f"<code>{escape(provenance['command'])}</code>")]
    options = {name: value for name, value in provenance["options"].items() if value is not None}
    if options:
        lines = "<br>".join(f"{escape(name)} = {escape(str(value))}" for name, value in options.items())
        facts.append(("options", f"<code>{lines}</code>"))
    facts += [(f"input: {name}", source(i["path"], i["sha256"])) for name, i in provenance["inputs"].items()]
    packages = [f"{name} {version}" for name, version in provenance["packages"].items()]
    versions = [f"capture {provenance['capture']}", f"Python {provenance['python']}", *packages]
    facts.append(("versions", escape(", ".join(versions))))
    facts.append(("machine", escape(provenance["platform"])))
    began = escape(provenance["began"])
    seconds = provenance.get("seconds")
    facts.append(("began", began if seconds is None else f"{began}, took {significant(seconds)} s"))
    return facts
