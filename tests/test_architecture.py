"""Who may import whom, and what starting the command line may not import."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path

import pytest

from capture_cli.common.registry import Registry

PACKAGE = Path(__file__).resolve().parents[1] / "capture_cli"

# A row may import the rows below it, and what is in it. `log.checks` stands higher than the rest of its room: a check
# is of a log and of what its task makes of it.
ROWS = (
    ("__main__",),
    ("cli",),
    ("stages",),
    ("report",),
    ("context",),
    ("select",),
    ("estimate",),
    ("simulate",),
    ("log.checks",),
    ("model",),
    ("log",),
    ("store",),
    ("options",),
    ("common",),
    ("errors",),
    ("__init__",),
)
ROW = {name: number for number, row in enumerate(ROWS) for name in row}
# only stages, and what the paper's system keeps on disk, join files and algorithms: these take arrays and return arrays
ALGORITHMS = (
    "context.identifiers",
    "context.policies",
    "context.search",
    "estimate.balance",
    "estimate.initial_states.from_outputs",
    "estimate.solve",
    "model",
    "select.criterion",
    "select.score",
    "simulate",
)
MOST_FILES = 25  # of a folder that is no registry of plug-ins
LONGEST_CAPTION = 10  # lines of what a folder is for
MOST_ARGUMENTS = 6  # of a function, besides self
MOST_NUMBERS = 60  # constants of modules, but versions, outside of settings: codes, numbers of kernels
HEAVY = ("torch", "robosuite", "ray", "plotly", "matplotlib", "pyarrow", "scipy", "zarr", "mujoco")

MODULES = sorted(
    ".".join(p.relative_to(PACKAGE).with_suffix("").parts)
    for p in PACKAGE.rglob("*.py")
    if "__pycache__" not in p.parts
)
KNOWN = {*MODULES, *(m.removesuffix(".__init__") for m in MODULES)}


@cache
def tree(module: str) -> ast.Module:
    """The syntax of a module."""
    return ast.parse(PACKAGE.joinpath(*module.split(".")).with_suffix(".py").read_text(encoding="utf-8"))


@cache
def imported(module: str) -> set[str]:
    """Modules of the package that `module` imports anywhere in it, function bodies too, without the prefix."""
    found = set()
    for node in ast.walk(tree(module)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module} imports relatively"
            found |= {f"{node.module}.{alias.name}" for alias in node.names} | {node.module}
    inside = {name.removeprefix("capture_cli.") for name in found if name.startswith("capture_cli.")}
    return inside & KNOWN


def place(module: str) -> str:
    """The name in ROWS that is nearest to `module`."""
    parts = module.split(".")
    names = [".".join(parts[:k]) for k in range(len(parts), 0, -1)]
    return next(name for name in names if name in ROW)


def within(module: str, folders: tuple[str, ...]) -> bool:
    """Whether `module` is one of `folders`, or in one."""
    return any(module == folder or module.startswith(f"{folder}.") for folder in folders)


def registries() -> list[Registry]:
    """Every plug-in folder of the package."""
    folders = (m for m in MODULES if m.endswith(".__init__"))
    packages = (importlib.import_module(f"capture_cli.{m.removesuffix('.__init__')}") for m in folders)
    return [p.REGISTRY for p in packages if hasattr(p, "REGISTRY")]


FOLDERS = sorted({m.rpartition(".")[0] for m in MODULES} - {""})


def test_every_module_has_a_row():
    assert {m.split(".")[0] for m in MODULES} <= {name.split(".")[0] for name in ROW}


@pytest.mark.parametrize("folder", FOLDERS)
def test_a_folder_can_be_taken_in_at_a_glance(folder):
    if f"capture_cli.{folder}" in {r.package for r in registries()}:
        return
    files = [m for m in MODULES if m.rpartition(".")[0] == folder]
    assert len(files) <= MOST_FILES, f"{folder} holds {len(files)}"


@pytest.mark.parametrize("folder", FOLDERS)
def test_a_folder_says_what_it_is_for(folder):
    init = PACKAGE.joinpath(*folder.split("."), "__init__.py")
    caption = ast.get_docstring(ast.parse(init.read_text(encoding="utf-8")))
    assert caption, f"{folder} has no docstring"
    assert len(caption.splitlines()) <= LONGEST_CAPTION


@pytest.mark.smoke
@pytest.mark.parametrize("module", MODULES)
def test_imports_go_down_the_rows(module):
    for other in imported(module):
        here, there = place(module), place(other)
        assert here == there or ROW[there] > ROW[here], f"{module} imports {other}"


@pytest.mark.parametrize("module", [m for m in MODULES if within(m, ALGORITHMS)])
def test_algorithms_do_not_import_stores(module):
    assert not {m for m in imported(module) if within(m, ("store", "log.measured_log"))}


@pytest.mark.parametrize("module", [m for m in MODULES if within(m, ("estimate", "select"))])
def test_fits_and_selection_know_a_log_and_no_other_file(module):
    assert not {m for m in imported(module) if within(m, ("store",))}


@pytest.mark.smoke
@pytest.mark.parametrize("registry", registries(), ids=lambda r: r.package)
def test_plug_ins_do_not_import_each_other(registry):
    folder = registry.package.removeprefix("capture_cli.")
    plug_ins = {f"{folder}.{name.replace('-', '_')}" for name in registry.own_names}
    assert plug_ins <= set(MODULES)
    for plug_in in plug_ins:
        assert not imported(plug_in) & (plug_ins - {plug_in}), plug_in


@pytest.mark.smoke
def test_there_are_plug_ins():
    assert {r.package for r in registries()} >= {
        "capture_cli.model.effects",
        "capture_cli.context.identifiers",
    }


def test_commands_do_not_import_each_other():
    lines = [m for m in MODULES if m.startswith("cli.")]
    commands = {m for line in lines for m in imported(line) if m.startswith("stages.") and m.count(".") == 1}
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
    own = {
        "cli.export",
        "model.effects.__init__",
        "model.effects.companion",
        "model.tasks._scooping",
        "model.tasks.air_hockey",
        "model.tasks.door",
    }
    assert found - own == {"model.mjcf.model_file", "model.mjcf.mjcf_writer"}


def test_robosuite_is_patched_before_anything_of_it_is_imported():
    """A move once lost the import, and no scene ran."""
    scenes = 0
    for module in MODULES:
        if module.startswith("context.worlds.") and module != "context.worlds._robosuite":
            lines = [ast.unparse(n) for n in tree(module).body if isinstance(n, ast.Import | ast.ImportFrom)]
            of_it = [
                k for k, line in enumerate(lines) if line.startswith(("import robosuite", "from robosuite"))
            ]
            patch = "from capture_cli.context.worlds import _robosuite"
            assert not of_it or lines.index(patch) < of_it[0], module
            scenes += bool(of_it)
    assert scenes > 2


def test_a_wheel_holds_what_is_no_module():
    """Models and templates: by the patterns of pyproject.toml, each of a package and not of its subfolders."""
    project = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text(encoding="utf-8"))
    patterns = project["tool"]["setuptools"]["package-data"]
    for file in PACKAGE.rglob("*"):
        if file.is_dir() or file.suffix in (".py", ".pyc"):
            continue
        package = next(folder for folder in file.parents if (folder / "__init__.py").is_file())
        inside = file.relative_to(package)
        own = patterns["*"] + patterns.get(".".join(package.relative_to(PACKAGE.parent).parts), [])
        fits = [p for p in own if inside.match(p) and len(Path(p).parts) == len(inside.parts)]
        assert fits, f"{inside} of {package.name} is in no wheel"


def test_functions_take_few_arguments():
    many = set()
    for module in MODULES:
        for node in ast.walk(tree(module)):
            if isinstance(node, ast.FunctionDef):
                own = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
                if len([a for a in own if a.arg not in ("self", "cls")]) > MOST_ARGUMENTS:
                    many.add(f"{module}.{node.name}")
    assert not many


def test_documents_are_read_as_records():
    """Who reads or writes one knows its keys; all others ask a record of it."""
    keyed = [
        f"{module}:{node.lineno}"
        for module in MODULES
        for node in ast.walk(tree(module))
        if isinstance(node, ast.Subscript) and getattr(node.value, "id", "") == "document"
    ]
    assert not [place for place in keyed if not place.startswith("store.")]


def test_numbers_stand_in_settings():
    loose = []
    for module in MODULES:
        for node in tree(module).body:
            if isinstance(node, ast.Assign) and "VERSION" not in ast.unparse(node.targets[0]):
                values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
                loose += [f"{module}:{node.lineno}" for value in values if is_number(value)]
    assert len(loose) <= MOST_NUMBERS, loose


def is_number(node: ast.expr) -> bool:
    """Whether it is written as a number, or worked out from numbers."""
    if isinstance(node, ast.UnaryOp):
        return is_number(node.operand)
    if isinstance(node, ast.BinOp):
        return is_number(node.left) and is_number(node.right)
    return isinstance(node, ast.Constant) and type(node.value) in (int, float)
