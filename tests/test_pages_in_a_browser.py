"""How pages look once a browser has drawn them."""

from __future__ import annotations

import re

import pytest
import test_diagnosis_page
import test_reports
from browser import in_chromium, opened

from capture_cli.report import diagnosis_page, estimate_page

PAGES = {
    "estimate_page": (estimate_page, test_reports),
    "diagnosis_page": (diagnosis_page, test_diagnosis_page),
}
# For each title of a vertical axis: whether it touches a number of that axis, or comes as near as 3 pixels.
LOOK = """<script>
addEventListener("load", () => {
  const overlaps = (a, b) => a.left - 3 < b.right && b.left < a.right + 3 && a.top < b.bottom && b.top < a.bottom;
  const over = [...document.querySelectorAll(".plot")].flatMap((plot) => {
    const boxes = (of) => [...plot.querySelectorAll(of)].map((found) => found.getBoundingClientRect());
    const numbers = boxes("[class*=yaxislayer] text");
    return boxes("[class$=title][class^=y]").map((title) => numbers.some((number) => overlaps(title, number)));
  });
  document.documentElement.dataset.titles = over.join(" ");
});
</script>"""


@in_chromium
@pytest.mark.parametrize("kind", PAGES)
def test_no_number_of_an_axis_touches_its_title(kind, tmp_path):
    """The numbers are those of a motion of millimetres around 1.2 m: they have many digits."""
    module, made = PAGES[kind]
    record = made.RECORDS["full"]()
    for name, values in record.arrays.items():
        if name.startswith("step/") and values.ndim == 2:
            values[...] = -1.2 + 1e-3 * values
    html = re.sub(r"<meta[^>]*Content-Security-Policy[^>]*>", "", module.render(record, made.PROVENANCE))
    assert "Content-Security-Policy" not in html, "which stops the script of this test"
    document, _ = opened(html.replace("</body>", f"{LOOK}</body>"), tmp_path)
    (said,) = re.findall(r'data-titles="([^"]*)"', document)
    assert len(said.split()) > 3
    assert "true" not in said.split()
