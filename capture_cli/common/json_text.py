"""How JSON documents are written: a key a line, and a list of numbers in one."""

import json
import re
from typing import Any

# Text has no newline in a JSON string, so that this is never inside of one.
_NUMBERS = re.compile(r"\[\n\s*((?:-?[\d.eE+-]+|null)(?:,\n\s*(?:-?[\d.eE+-]+|null))*)\n\s*\]")


def json_text(document: Any) -> str:
    """`document` as JSON. Raises ValueError for NaN and infinity, which JSON does not have."""
    text = json.dumps(document, indent=2, allow_nan=False)
    return _NUMBERS.sub(lambda found: f"[{' '.join(found[1].split())}]", text)
