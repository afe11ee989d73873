"""Nothing that a file says becomes part of a page: markup in every name, unit, title and message stays text."""

from __future__ import annotations

import json
import re
from collections import Counter
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
import test_diagnosis_page
import test_reports
from browser import in_chromium, opened
from html_page import Page

from capture_cli.report import diagnosis_page, estimate_page

# What a browser would run, were it not text. It leaves a trace where it does.
RUN = "document.documentElement.dataset.ran=1"
MARKUP = (
    f"<img src=x onerror={RUN}>",
    f"\"><svg onload='{RUN}'>",
    f"</script><script>{RUN}</script>",
    f"<!--<script>{RUN}",
    f"</title></style></textarea>' autofocus onfocus={RUN} x='",
    f'<a href="javascript:{RUN}">{{{{ 7*7 }}}} %{{x}} &lt;b&gt; \u2028',
)
PAGES = {
    "estimate_page": (estimate_page, test_reports),
    "diagnosis_page": (diagnosis_page, test_diagnosis_page),
}
# What the program itself says in a document, and goes by.
OWN = {"", "unexplained", "explained", "not-identifiable", "tied", "effect-found"}
OWN |= {"2025-03-04T10:11:12+00:00", "time"}
# Keys under which a file's own names are keys.
NAMED = {"parameters", "noise_floor", "noise_floor_source", "rmse", "mae", "absorbed", "outputs"}
NAMED |= {"output_thresholds", "options", "inputs", "packages", "combination"}


def hostile(value: Any, markup: str, key: str = "") -> Any:
    """A document whose every text, and every name among its keys, ends in markup. key: where `value` stood."""
    if isinstance(value, dict):
        return {
            name + markup if key in NAMED else name: hostile(own, markup, "" if key in NAMED else name)
            for name, own in value.items()
        }
    if isinstance(value, list):
        return [hostile(own, markup) for own in value]
    return value + markup if isinstance(value, str) and value not in OWN else value


def pages(kind: str, record: str, markup: str) -> tuple[str, str]:
    """(the page of a record, the page of the same record with markup in all that it says)."""
    module, made = PAGES[kind]
    other = made.RECORDS[record]()
    marked = type(other)(hostile(other.document, markup), other.arrays, hostile(other.attributes, markup))
    return plain_page(kind, record), module.render(marked, hostile(made.PROVENANCE, markup))


@cache
def plain_page(kind: str, record: str) -> str:
    module, made = PAGES[kind]
    return module.render(made.RECORDS[record](), made.PROVENANCE)


CASES = [(kind, record, "".join(MARKUP)) for kind, (_, made) in PAGES.items() for record in made.RECORDS]
CASES += [(kind, "full", markup) for kind in PAGES for markup in MARKUP]


def test_every_page_is_tried():
    """A template that extends page.html is a page."""
    folder = files("capture_cli.report") / "templates"
    found = {
        Path(f.name).stem
        for f in folder.iterdir()
        if f.name.endswith(".html") and "extends" in f.read_text(encoding="utf-8")
    }
    assert found == set(PAGES)


@pytest.mark.parametrize(("kind", "record", "markup"), CASES)
def test_markup_changes_no_element_of_a_page(kind, record, markup):
    plain, marked = map(Page, pages(kind, record, markup))
    assert Counter(marked.tags) == Counter(plain.tags)
    assert Counter((t, n) for t, n, _ in marked.attributes) == Counter((t, n) for t, n, _ in plain.attributes)
    assert marked.scripts[0] == plain.scripts[0] and marked.scripts[2:] == plain.scripts[2:]
    assert marked.text.count(" ".join(markup.split())) > 10, "it is shown as the text that it is"


def test_one_sided_intervals_hold_markup_as_text():
    """Of a parameter that is known to be "at least" something the remark ends in its unit."""
    estimate = test_reports.not_identifiable()
    for p in estimate.document["parameters"].values():
        p |= {"unit": MARKUP[0], "limits": {"at_least": 0.62, "at_most": None}}
    page = Page(estimate_page.render(estimate, None))
    assert "img" not in page.tags and f"at least 0.620 {MARKUP[0]}" in page.text


def test_the_policy_allows_the_two_scripts_of_the_page_and_no_other():
    html, _ = pages("estimate_page", "plain", "")
    (policy,) = [v for t, n, v in Page(html).attributes if n == "content" and "default-src" in v]
    rules = dict(rule.split(" ", 1) for rule in policy.split("; "))
    assert rules["default-src"] == "'none'" and rules["form-action"] == "'none'"
    assert rules["base-uri"] == "'none'" and rules["img-src"] == "data: blob:"
    assert re.fullmatch(r"'sha256-[\w+/=]{44}' 'sha256-[\w+/=]{44}'", rules["script-src"])
    assert "connect-src" not in rules and "unsafe-eval" not in policy


def test_no_template_turns_the_escaping_off():
    folder = files("capture_cli.report")
    own = (f for place in (folder, folder / "templates") for f in place.iterdir() if f.is_file())
    texts = {f.name: f.read_text(encoding="utf-8") for f in own}
    assert not [n for n, t in texts.items() if n.endswith(".html") and re.search(r"\|\s*safe|autoescape", t)]
    marked = {n: t.count("Markup(") for n, t in texts.items() if n.endswith(".py") and "Markup(" in t}
    assert marked == {"page.py": 2}, "of its own style and scripts, and of plotly.js"


# ---- in a browser ----


def has_run(document: str) -> bool:
    return "data-ran" in document[: document.index("<head")]


@in_chromium
@pytest.mark.parametrize("markup", MARKUP[:2])
def test_a_browser_would_run_it_were_it_not_text(markup, tmp_path):
    document, _ = opened(f"<!DOCTYPE html><html><head></head><body>{markup}</body></html>", tmp_path)
    assert has_run(document), "these tests see a script that ran"


@in_chromium
@pytest.mark.parametrize("kind", PAGES)
def test_a_browser_runs_no_script_of_a_file(kind, tmp_path):
    """And those of the page: every plot that is not folded away is drawn, the views can be chosen."""
    _, html = pages(kind, "full", "".join(MARKUP))
    document, console = opened(html, tmp_path)
    assert not has_run(document)
    assert document.count('class="main-svg"') >= 3 * 3, "the plots are drawn"
    assert document.count("<option>") > 5
    assert console == "", "nothing of the page is refused, and none of its scripts fails"


@in_chromium
@pytest.mark.parametrize("markup", [*MARKUP[:2], f"<script>{RUN}</script>"])
def test_the_policy_stops_what_would_slip_through(markup, tmp_path):
    html, _ = pages("estimate_page", "plain", "")
    document, console = opened(html.replace("</h1>", f"</h1>{markup}", 1), tmp_path)
    assert not has_run(document)
    assert "Content Security Policy" in console
    assert json.dumps("main-svg") in document, "what is the page's own still runs"
