"""JSON documents: the same values, with lists of numbers in one line."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_cli.common.json_text import json_text

LEAVES = (
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text()
)
DOCUMENTS = st.recursive(
    LEAVES, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=30
)


@given(DOCUMENTS)
def test_every_document_reads_back_as_it_was(document):
    assert json.loads(json_text(document)) == document


def test_a_list_of_numbers_takes_one_line_and_a_key_one():
    document = {"time": [0.0, 1e-3, None], "rows": [[1, 2], [3, 4]], "names": ["a\n[\n1\n]"], "none": []}
    assert json_text(document).splitlines() == [
        "{",
        '  "time": [0.0, 0.001, null],',
        '  "rows": [',
        "    [1, 2],",
        "    [3, 4]",
        "  ],",
        '  "names": [',
        r'    "a\n[\n1\n]"',
        "  ],",
        '  "none": []',
        "}",
    ]


def test_what_json_does_not_have_is_refused():
    with pytest.raises(ValueError, match="JSON"):
        json_text({"value": float("nan")})
