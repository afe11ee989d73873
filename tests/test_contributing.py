"""docs/contributing.md, to the letter: its examples are put into a copy of the package, and what is shown is run."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from warm_capture import warm_capture

from capture_cli.stages.record import record

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "contributing.md").read_text(encoding="utf-8")
FILES = re.findall(r"^`(capture_cli/\S+\.py)`\n\n```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
STAGES = ("record", "import_log", "inspect", "identify", "diagnose")
AMONG = ("square-root-drag", "viscous-damping", "quadratic-drag", "coulomb-friction", "control-lag")
SESSIONS = re.findall(r"^```console\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def project(tmp_path_factory) -> Path:
    """A folder with the package and every example in it, a task, and a recording as an archive of arrays."""
    folder = tmp_path_factory.mktemp("project")
    being_written = shutil.ignore_patterns("*.pyc.*")
    shutil.copytree(ROOT / "capture_cli", folder / "capture_cli", ignore=being_written)
    if sys.pycache_prefix:  # there is what is compiled of it: not once more, for five seconds
        compiled = Path(sys.pycache_prefix)
        own, copied = (compiled / f.relative_to(f.anchor) / "capture_cli" for f in (ROOT, folder))
        shutil.copytree(own, copied, ignore=being_written)
    for path, text in FILES:
        assert not (folder / path).exists(), f"{path} is there already"
        (folder / path).write_text(text, encoding="utf-8")
    for name in ("model.xml", "task.toml"):
        shutil.copy(ROOT / "datasets" / "cart" / name, folder)
    log = record(
        task=str(folder / "task.toml"), out=folder / "made.zarr", noise=1e-3, rate=100, duration=4.0
    ).log
    run = np.ones(len(log.time))
    np.savez(
        folder / "run.npz", t_s=log.time, run=run, force_N=log.inputs[:, 0], position_m=log.outputs[:, 0]
    )
    return folder


def in_copy(project: Path, *arguments: str) -> subprocess.CompletedProcess:
    """Python in the folder of the copy, which goes before the package that is installed."""
    environment = {**os.environ, "PYTHONPATH": str(project)}
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=project,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


def words(text: str) -> str:
    return " ".join(text.split())


def test_every_kind_of_plug_in_has_an_example():
    assert {Path(path).parent.as_posix() for path, _ in FILES} >= {
        "capture_cli/model/effects",
        "capture_cli/log/checks",
        "capture_cli/log/readers",
        "capture_cli/estimate/solve",
        "capture_cli/cli",
    }
    assert all(len(text.splitlines()) <= 40 for _, text in FILES)


def test_what_is_shown_happens(project):
    assert len(SESSIONS) >= 5
    steps = [step.partition("\n") for session in SESSIONS for step in session.split("$ ")[1:]]
    environment = {**os.environ, "PYTHONPATH": str(project)}
    with warm_capture(
        *STAGES, undrawn=["identify", "diagnose"], among=AMONG, environment=environment
    ) as capture:
        for command, _, shown in steps:
            program, *arguments = command.split()
            assert program == "capture"
            done = subprocess.run(
                [*capture, *arguments], cwd=project, capture_output=True, text=True, check=False
            )
            assert done.returncode == 0, f"{command}\n{done.stderr}"
            assert words(shown) in words(done.stdout), f"{command}\n{done.stdout}"


def test_the_effect_keeps_the_contract_of_effects(project):
    """It does so without a line in a test: the contract asks every file of the folder."""
    asked = [
        "-q",
        "-p",
        "no:cacheprovider",
        str(ROOT / "tests" / "test_effects.py"),
        "-k",
        "square-root-drag",
    ]
    done = in_copy(project, "-m", "pytest", *asked)
    assert done.returncode == 0, done.stdout
    assert int(re.search(r"(\d+) passed", done.stdout).group(1)) >= 5


def test_the_identifier_asks_within_bounds_and_twice_the_same(project):
    program = (
        "from capture_cli.stages import identify as stage\n"
        "stage._write_pages = lambda *_: None\n"
        "for out in 'ab':\n"
        "    options = dict(task='task.toml', out=out, identifier='random-search', rounds=2)\n"
        "    found = stage.identify(real_log='made.zarr', **options)\n"
        "    print([p['value'] for p in found.document['parameters'].values()])\n"
    )
    done = in_copy(project, "-c", program)
    assert done.returncode == 0, done.stderr
    one, again = done.stdout.splitlines()
    assert len(one) > 2 and one == again
