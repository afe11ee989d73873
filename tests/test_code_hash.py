"""Lines of a benchmark are kept while the code they depend on is the same, and no longer."""

from __future__ import annotations

import shutil

from benchmarks import _code_hash
from benchmarks._code_hash import ROOT, code_hash, imported_files

MODULE = "capture_cli.stages.diagnose"


def names(modules) -> set[str]:
    return {f.relative_to(_code_hash.ROOT).as_posix() for f in imported_files(modules)}


def test_it_follows_imports_and_leaves_out_what_draws():
    found = names([MODULE])
    assert {
        "capture_cli/stages/diagnose.py",
        "capture_cli/simulate/engine.py",
        "capture_cli/errors.py",
    } <= found
    assert not any(name.startswith("capture_cli/report/") for name in found)
    assert "capture_cli/stages/record.py" not in found


def test_it_changes_with_the_code_it_depends_on_and_with_no_other(tmp_path, monkeypatch):
    for package in ("capture_cli", "benchmarks"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(_code_hash, "ROOT", tmp_path)
    before = code_hash([MODULE], ["benchmarks/machines"])
    for path, matters in (
        ("capture_cli/stages/record.py", False),
        ("capture_cli/report/terminal.py", False),
        ("capture_cli/simulate/engine.py", True),
        ("benchmarks/machines/arm/model.xml", True),
    ):
        file = tmp_path / path
        text = file.read_text(encoding="utf-8")
        file.write_text(text + "\n", encoding="utf-8")
        assert (code_hash([MODULE], ["benchmarks/machines"]) != before) == matters, path
        file.write_text(text, encoding="utf-8")
