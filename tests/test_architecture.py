"""Who may import whom, and what starting the command line may not import."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

from capture_cli.registry import Registry

PACKAGE = Path(__file__).resolve().parents[1] / "capture_cli"

# A row may import the rows below it, and within its own folder what `SIBLINGS` allows.
ROWS = (
    ("__main__",),
    ("cli",),
    ("app",),
    ("commands",),
    ("stages",),
    ("reports", "protocol"),
    ("select",),
    ("estimate",),
    ("identifiers", "policies", "search", "diagnosis"),
    ("linearization",),
    ("simulator", "worlds", "observation_noise", "multisine"),
    ("tasks", "effects"),
    ("sim", "stores"),
    (
        "autocorrelation",
        "documents",
        "evenly_spread",
        "extras",
        "json_text",
        "named_arrays",
        "parameters",
        "registry",
        "signals",
    ),
    ("errors",),
    ("__init__",),
)
ROW = {name: number for number, row in enumerate(ROWS) for name in row}
# only stages join files and algorithms: these take arrays and return arrays
ALGORITHMS = (
    "autocorrelation",
    "evenly_spread",
    "identifiers",
    "linearization",
    "policies",
    "search",
    "diagnosis",
    "estimate",
    "select",
    "simulator",
    "tasks",
    "effects",
    "sim",
)
HEAVY = ("torch", "robosuite", "ray", "plotly", "matplotlib", "pyarrow", "scipy", "zarr", "mujoco")

MODULES = sorted(
    ".".join(p.relative_to(PACKAGE).with_suffix("").parts)
    for p in PACKAGE.rglob("*.py")
    if "__pycache__" not in p.parts
)


def imported(module: str) -> set[str]:
    """Modules of the package that `module` imports anywhere in it, function bodies too, without the prefix."""
    path = PACKAGE.joinpath(*module.split(".")).with_suffix(".py")
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module} imports relatively"
            found |= {f"{node.module}.{alias.name}" for alias in node.names} | {node.module}
    inside = {name.removeprefix("capture_cli.") for name in found if name.startswith("capture_cli.")}
    known = {*MODULES, *(m.removesuffix(".__init__") for m in MODULES)}
    return inside & known


def row(module: str) -> int:
    return ROW[module.split(".")[0]]


def registries() -> list[Registry]:
    """Every plug-in folder of the package."""
    folders = (m for m in MODULES if m.count(".") == 1 and m.endswith(".__init__"))
    packages = (importlib.import_module(f"capture_cli.{m.removesuffix('.__init__')}") for m in folders)
    return [p.REGISTRY for p in packages if hasattr(p, "REGISTRY")]


def test_every_module_has_a_row():
    assert {m.split(".")[0] for m in MODULES} <= set(ROW)


@pytest.mark.smoke
@pytest.mark.parametrize("module", MODULES)
def test_imports_go_down_the_rows(module):
    folder = module.split(".")[0]
    for other in imported(module):
        same_folder = other.split(".")[0] == folder
        assert same_folder or row(other) > row(module), f"{module} imports {other}"


@pytest.mark.parametrize("module", [m for m in MODULES if m.split(".")[0] in ALGORITHMS])
def test_algorithms_do_not_import_stores(module):
    assert not {m for m in imported(module) if m.startswith("stores")}


@pytest.mark.parametrize("module", [m for m in MODULES if m.startswith("protocol.")])
def test_the_protocol_knows_a_log_and_no_other_file(module):
    assert {m for m in imported(module) if m.startswith("stores")} <= {"stores.measured_log"}


@pytest.mark.smoke
@pytest.mark.parametrize("registry", registries(), ids=lambda r: r.package)
def test_plug_ins_do_not_import_each_other(registry):
    folder = registry.package.removeprefix("capture_cli.")
    plug_ins = {f"{folder}.{name.replace('-', '_')}" for name in registry.names()}
    assert plug_ins <= set(MODULES)
    for plug_in in plug_ins:
        assert not imported(plug_in) & (plug_ins - {plug_in}), plug_in


@pytest.mark.smoke
def test_there_are_plug_ins():
    assert {r.package for r in registries()} >= {"capture_cli.effects", "capture_cli.identifiers"}


def test_commands_do_not_import_each_other():
    lines = [m for m in MODULES if m.startswith("commands.")]
    commands = {m for line in lines for m in imported(line) if m.startswith("stages.")}
    assert "stages.identify" in commands
    for command in commands:
        assert not imported(command) & (commands - {command}), command


@pytest.mark.parametrize("arguments", [[], ["--help"], ["--version"], ["identify", "--help"]])
def test_starting_imports_nothing_heavy(arguments):
    program = (
        "import sys, atexit\n"
        f"atexit.register(lambda: print('HEAVY', [m for m in {HEAVY} if m in sys.modules]))\n"
        "import capture_cli.cli\n"
        f"sys.argv = ['capture', *{arguments}]\n"
        f"{'capture_cli.cli.main()' if arguments else ''}"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "HEAVY []"


def test_models_of_users_are_compiled_in_one_place():
    """Others compile what the package brings, or write what was compiled there."""
    compiling = ("MjSpec.from_", "MjModel.from_xml")
    found = {
        module
        for module in MODULES
        if any(word in (PACKAGE / f"{module.replace('.', '/')}.py").read_text() for word in compiling)
    }
    own = {"effects.__init__", "tasks.air_hockey", "tasks._scooping", "effects.companion", "commands.export"}
    assert found - own == {"sim.model_file", "sim.mjcf"}
