"""What speaks against an effect: a code with numbers in the search and in files, a sentence in reports."""

import string

import numpy as np
import pytest

from capture_cli.report.rejection_sentences import SENTENCES, sentence
from capture_cli.select.reason import Reason, Rejection


def facts_of(reason: str) -> dict[str, float | str]:
    """A number for each fact that its sentence formats, a word for others."""
    fields = [f for f in string.Formatter().parse(SENTENCES[reason]) if f[1]]
    return {name: 0.25 if spec else "WORD" for _, name, spec, _ in fields}


def test_each_reason_has_a_sentence_and_no_other_does():
    assert set(SENTENCES) == {str(reason) for reason in Reason}


@pytest.mark.parametrize("reason", Reason)
def test_a_rejection_is_written_read_and_said(reason):
    rejection = Rejection(reason, facts_of(reason))
    document = rejection.document()
    assert Rejection.from_document(document) == rejection
    said = sentence(document)
    assert said and "{" not in said and all(str(v).strip("0.") in said for v in rejection.facts.values())
    beside = sentence(rejection.with_others().document())
    assert beside == f"with the other effects in: {said}"


def test_a_number_that_json_does_not_have_is_left_out_and_said():
    document = Rejection(Reason.NO_SCORE, {"score": np.inf}).document()
    assert document["facts"] == {"score": None}
    assert sentence(document) == "it explains nothing (score nan)"


def test_of_no_rejection_nothing_is_said():
    assert sentence(None) is None
