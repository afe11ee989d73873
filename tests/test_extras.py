"""The core without the extras of an installation: it imports none, and who needs one says so before any work."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from test_architecture import MODULES

from capture_cli.common import extras
from capture_cli.common.extras import EXTRAS, missing, require
from capture_cli.errors import OptionError

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
TOO_NEW = [name for name, e in EXTRAS.items() if e.last_python and sys.version_info[:2] > e.last_python]
PACKAGES = sorted({package for extra in EXTRAS.values() for package in extra.brings})
HIDDEN = f"""
import sys
from importlib.machinery import PathFinder

class WithoutExtras(PathFinder):
    @classmethod
    def find_spec(cls, name, *where):
        return None if name in {PACKAGES} else PathFinder.find_spec(name, *where)

sys.meta_path[sys.meta_path.index(PathFinder)] = WithoutExtras
"""
# what trains networks, and robosuite's scenes
NOT_OF_THE_CORE = {
    "context.identifiers._training",
    "context.identifiers._transformer",
    "context.policies._sac_training",
    "context.worlds._gymnasium",
    "context.worlds._pushed",
    "context.worlds._robosuite",
    "context.worlds._scene",
    "context.worlds.air_hockey",
    "context.worlds.door",
    "context.worlds.scooping",
}
NEEDS = {  # commands, and the package that is missing first; no file that they name exists
    "train-policy": ("train-policy --task nowhere.toml --out o", "learn", "train-policy needs torch"),
    "train-sysid": ("train-sysid --histories nowhere.zarr --out o", "learn", "train-sysid needs"),
    "compass": (
        "eval-sim2sim --task nowhere.toml --identifier nowhere --identifier compass --out o",
        "learn",
        "the identifier compass needs",
    ),
    "suite": ("eval-sim2sim --suite paper --identifier nowhere --out o", "learn", "compass needs"),
    "robosuite": (
        "record --task nowhere.toml --world robosuite --out o",
        "robosuite",
        "--world robosuite needs",
    ),
    "ray": ("gen-histories --task nowhere.toml --executor ray --out o", "ray", "--executor ray needs ray"),
}


def without_extras(program: str, folder: Path) -> subprocess.CompletedProcess:
    """Run `program` in `folder` as if no extra were installed."""
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, "-c", HIDDEN + program],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path, "COLUMNS": "80"},
        capture_output=True,
        text=True,
    )


def capture(commands: dict[str, str], folder: Path) -> dict[str, tuple[int, str, str]]:
    """What comes of each `capture ARGUMENTS` in `folder` as if no extra were installed: exit code, stdout, stderr."""
    program = f"""
import contextlib, io, json
from capture_cli.cli import main
ended = {{}}
for name, arguments in {commands}.items():
    sys.argv, code = ["capture", *arguments.split()], 0
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        try:
            main()
        except SystemExit as error:
            code = error.code or 0
    ended[name] = code, out.getvalue(), err.getvalue()
print(json.dumps(ended))
"""
    done = without_extras(program, folder)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.skipif("CAPTURE_ALL_EXTRAS" not in os.environ, reason="says that every extra is installed")
@pytest.mark.parametrize("name", sorted(set(EXTRAS) - set(TOO_NEW)))
def test_nothing_is_left_out_where_everything_is_said_to_be_there(name):
    assert missing(name) == []


def test_the_core_imports_no_extra(tmp_path):
    program = f"""
import importlib, json
failed = []
for module in {[m.removesuffix(".__init__") for m in MODULES if m != "__main__"]}:
    try:
        importlib.import_module(f"capture_cli.{{module}}")
    except Exception:
        failed.append(module)
print(json.dumps(failed))
"""
    done = without_extras(program, tmp_path)
    assert set(json.loads(done.stdout)) == NOT_OF_THE_CORE


def test_who_needs_an_extra_says_so_before_any_work(tmp_path):
    ended = capture({name: arguments for name, (arguments, _, _) in NEEDS.items()}, tmp_path)
    for name, (_, extra, found) in NEEDS.items():
        code, out, err = ended[name]
        first, cure = err.splitlines()
        assert first.startswith("error: ") and found in first and first.endswith("not installed here"), name
        assert cure == f"  cure: pip install 'capture[{extra}]'"
        assert (code, out) == (2, ""), name
    assert list(tmp_path.iterdir()) == []


def test_every_help_is_there_without_extras(tmp_path):
    program = """
from typer.testing import CliRunner
from capture_cli.cli.app import app
names = [c.name for c in app.registered_commands]
for arguments in ([], *([name] for name in names)):
    result = CliRunner().invoke(app, [*arguments, "--help"], catch_exceptions=False)
    assert result.exit_code == 0 and "Usage" in result.output, arguments
print(len(names))
"""
    done = without_extras(program, tmp_path)
    assert int(done.stdout) >= 13, done.stderr


def test_the_plant_is_recorded_and_histories_are_made_without_extras(tmp_path):
    commands = {
        "record": "record --task air-hockey --episodes 2 --out run.zarr",
        "gen-histories": "gen-histories --task scooping --pairs 4 --rounds 3 --out histories.zarr --quiet",
    }
    for code, _, err in capture(commands, tmp_path).values():
        assert code == 0, err
    made = json.loads((tmp_path / "run.zarr" / "provenance.json").read_text(encoding="utf-8"))
    assert {"mujoco", "numpy"} <= set(made["packages"])


def test_an_extra_that_there_is_not_for_this_python(monkeypatch):
    monkeypatch.setattr(extras, "find_spec", lambda _: None)
    monkeypatch.setattr(extras.sys, "version_info", (3, 13, 1))
    with pytest.raises(OptionError, match=r"Python 3\.13\n  cure: with Python 3\.12 or older: pip install"):
        require("robosuite", "--world robosuite")
    with pytest.raises(OptionError, match=r"here\n  cure: pip install 'capture\[learn\]'$"):
        require("learn", "train-sysid")


def test_the_project_declares_these_extras():
    declared = PROJECT["optional-dependencies"]
    assert set(declared) == {*EXTRAS, "all", "benchmarks", "dev"}
    assert declared["all"] == [f"capture[{','.join(sorted(EXTRAS))}]"]
    core = " ".join(PROJECT["dependencies"])
    for name, extra in EXTRAS.items():
        for package in extra.brings:
            assert package.replace("_", "-") in " ".join(declared[name])
            assert package.replace("_", "-") not in core
