"""What a comma in numbers that are written as text stands for: the decimal point, or the parting of thousands."""

import re
from collections.abc import Iterable, Sequence

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(inf|infinity|nan)", re.IGNORECASE)
WHOLE = re.compile(r"[+-]?\d+")
GROUPS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+(\.\d*)?")  # 9,997 may be either; 0,997 parts no thousands


def has_decimal_commas(columns: Iterable[Sequence[str]]) -> bool | None:
    """Whether commas are decimal points in the texts of a file's columns, (row,) each; None where nothing tells.

    One writer wrote all of them: where any number has a decimal point, no comma is one.
    """
    texts = [text for column in columns for text in column if "," in text or "." in text]
    if any("." in text and NUMBER.fullmatch(text) for text in texts):
        return False
    with_comma = [text for text in texts if "," in text]
    if with_comma and all(GROUPS.fullmatch(text) for text in with_comma):
        return None
    return True
