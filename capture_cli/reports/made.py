"""How a result was made: the heading of a page, and its last section with what provenance.json knows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from html import escape
from pathlib import PurePath
from typing import Any

from capture_cli.reports.page import section
from capture_cli.reports.quantities import significant

Fact = tuple[str, str]  # a title, and its value as HTML


def header(
    command: str, document: Mapping[str, Any], facts: Sequence[str], provenance: Mapping[str, Any] | None
) -> str:
    """The top of the page of a result of `capture COMMAND`: its task, its log, `facts` as HTML, and when."""
    shown = [f"log <code>{escape(PurePath(document['log']['path']).name)}</code>", *facts]
    if provenance:
        began = datetime.fromisoformat(provenance["began"])
        shown.append(f"{began.day} {began:%B %Y, %H:%M} UTC")
    return (
        f'<header><p class="overline">capture {command}</p>'
        f'<h1>{escape(document["task"])}</h1><p class="overline">{" · ".join(shown)}</p></header>'
    )


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
