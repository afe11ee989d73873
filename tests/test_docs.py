"""The documentation says what the code does: generated pages, the tree, every command, every link, the tutorial."""

from __future__ import annotations

import importlib
import importlib.util
import json
import re
import shlex
import subprocess
from pathlib import Path

import numpy as np
import pytest
import typer
from conftest import draw_nothing
from diagnosing import look_among
from toy_rounds import histories as toy_histories
from toy_rounds import write
from typer.testing import CliRunner

from benchmarks import REGISTRY as BENCHMARKS
from capture_cli.cli.app import app
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks import load_task
from capture_cli.model.tasks.mjcf_file import KEYS
from capture_cli.stages.diagnose import diagnose
from capture_cli.stages.evaluation.evaluation_run import evaluate
from capture_cli.stages.gen_histories import gen_histories
from capture_cli.stages.identify import identify
from capture_cli.stages.record import record
from capture_cli.stages.train_policy import train_policy
from capture_cli.stages.train_sysid import train_sysid

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted(
    [
        ROOT / "README.md",
        ROOT / "CHANGELOG.md",
        ROOT / "SECURITY.md",
        ROOT / "datasets" / "README.md",
        *(ROOT / "docs").rglob("*.md"),
    ]
)
# of the machine that a text was written on
ABSOLUTE = re.compile(r"(?<![\w.~])/(?:root|home|work|tmp|Users|mnt|srv|opt)/\w")


def _generate():
    spec = importlib.util.spec_from_file_location("docs_generate", ROOT / "docs" / "generate.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


generate = _generate()


def name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


# --- pages made from the code ---


@pytest.mark.parametrize("page", generate.PAGES)
def test_a_generated_page_is_what_the_code_says(page):
    assert (ROOT / page).read_text(encoding="utf-8") == generate.PAGES[page](), "run `make docs`"


@pytest.mark.parametrize("page", generate.PARTS)
def test_a_generated_part_is_what_the_code_says(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    assert text == generate.with_parts(text, generate.PARTS[page]), "run `make docs`"


@pytest.mark.parametrize("kind", ["checkout", "worktree", "archive"])
def test_the_tree_leaves_out_what_is_not_kept(tmp_path, kind):
    folder = tmp_path / "project"
    files = ("kept.py", "deep/new.py", ".venv/installed", ".venv-core/lib/a.py", "deep/__pycache__/b.pyc")
    for file in files:
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_text("")
    (folder / ".gitignore").write_text("/.venv/\n/.venv-core/\n__pycache__/\n")
    if kind != "archive":
        git = ["git", "-c", "user.name=a", "-c", "user.email=a@b.c"]
        for command in (["init", "-q"], ["add", "kept.py", ".gitignore"], ["commit", "-q", "-m", "first"]):
            subprocess.run([*git, *command], cwd=folder, check=True)
    if kind == "worktree":
        subprocess.run(["git", "worktree", "add", "-q", "../other"], cwd=folder, check=True)
        (folder / "deep").rename(tmp_path / "other" / "deep")
        (folder / ".venv-core").rename(tmp_path / "other" / ".venv-core")
        folder = tmp_path / "other"
    found = {path.as_posix() for path in generate.kept_files(folder)}
    assert found == {"kept.py", "deep/new.py", ".gitignore"}


def test_a_page_without_the_marks_of_its_part_is_refused():
    with pytest.raises(ValueError, match="tree begins"):
        generate.with_parts("no marks here", {"tree": str})


def test_every_command_is_documented():
    commands = {c.name for c in app.registered_commands}
    headings = set(re.findall(r"^## capture (\S+)$", generate.commands(), re.MULTILINE))
    assert headings == commands
    assert {"identify", "import-log", "inspect", "record", "export", "tasks", "effects"} <= commands


# --- keys of the JSON documents ---


@pytest.fixture(scope="module")
def written(tmp_path_factory, learn) -> dict[str, dict]:
    """Every JSON document that a log brings about, by the name that docs/schemas.md gives it."""
    folder = tmp_path_factory.mktemp("written")
    task = str(ROOT / "datasets" / "cart" / "task.toml")
    options = {"effects": ["coulomb-friction@rail.friction=1"], "noise": 1e-3, "rate": 100, "duration": 4.0}
    record(task=task, out=folder / "log.zarr", **options)
    with pytest.MonkeyPatch.context() as patch:
        draw_nothing(patch)
        identify(real_log=folder / "log.zarr", task=task, out=folder / "e", starts=1, rounds=2, quiet=True)
        look_among(patch, "coulomb-friction")
        diagnose(real_log=folder / "log.zarr", task=task, out=folder / "d", starts=1, quiet=True)
        histories = write(toy_histories(20, rounds=3), folder / "h.zarr")
        tiny = {"width": 8, "layers": 1, "heads": 1, "steps": 2, "batch": 8}
        train_sysid(histories=histories, out=folder / "i", **tiny)
        train_policy(task="scooping", out=folder / "p", steps=64, envs=32, evaluations=1)
        evaluated = ["domain-randomization", f"posterior={folder / 'q'}"]
        gen_histories(task="scooping", out=folder / "s.zarr", pairs=20, rounds=3, threads=1)
        train_sysid(histories=folder / "s.zarr", out=folder / "q", identifier="posterior", **tiny)
        evaluate(task="scooping", out=folder / "v", identifiers=evaluated, pairs=2, seeds=1, rounds=1)
    files = {
        "evaluation.json": folder / "v" / "evaluation.json",
        "policy.json": folder / "p" / "policy.json",
        "identifier.json": folder / "i" / "identifier.json",
        "diagnosis.json": folder / "d" / "diagnosis.json",
        "estimate.json": folder / "e" / "estimate.json",
        "truth.json": folder / "log.truth.json",
        "provenance.json": folder / "e" / "provenance.json",
    }
    return {name: json.loads(path.read_text(encoding="utf-8")) for name, path in files.items()}


@pytest.mark.parametrize("document", generate.DOCUMENTS)
def test_every_key_of_a_document_is_documented_and_no_other(written, document):
    keys = generate.keys_of(written[document], generate.NAMES)
    opaque = {
        "recordings",
        "undetermined",
        "prediction.fit.left_out",
        "prediction.test.left_out",
        "held_out",
        "beyond_fitted",
        "impossible_inertia",
        "unmeasured_joints",
        "open_loops",
        "time_step",
        "time_stamps",
        "input_timing",
        "misread",
        "options.OPTION",
        "histories.ATTRIBUTE",
        "identifiers.LABEL.coverage",
        "signature",
        "effects[].tied_with",
        "effects[].states",
        "next_experiment",
        "expression",
        "candidates[].rejection",
    }  # tables of their own, described in words
    found = {next((o for o in opaque if key == o or key.startswith((f"{o}.", f"{o}["))), key) for key in keys}
    assert found == generate.documented(document)


# --- commands and links ---


def commands_of(page: Path) -> list[str]:
    """Lines of the shell blocks of a page, or of a script, continued lines joined, comments left out."""
    text = page.read_text(encoding="utf-8")
    if page.suffix == ".sh":
        return [line for line in text.replace("\\\n", " ").splitlines() if line.startswith("capture ")]
    blocks = re.findall(r"^```sh\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    lines = "\n".join(blocks).replace("\\\n", " ").splitlines()
    prose = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    inline = re.findall(r"`((?:capture|make|python -m) [^`\n]+)`", prose)
    return [line.split(" #")[0].strip() for line in [*lines, *inline] if line.split("#")[0].strip()]


def shown() -> list:
    showing = [*PAGES, ROOT / "docs" / "evaluations.sh"]
    return [
        pytest.param(c, id=f"{name(p)}: {c[:60]}") for p in showing for c in dict.fromkeys(commands_of(p))
    ]


@pytest.mark.parametrize("command", shown())
def test_a_command_that_is_shown_can_be_run(command):
    words = shlex.split(command)
    if words[0] == "make":
        targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
        assert words[1] in targets
    elif words[:2] == ["python", "-m"]:
        module, *rest = words[2:]
        assert importlib.util.find_spec(module) is not None
        chosen = [w for w in rest if not w.startswith(("-", "[")) and not w.isdigit()]
        assert module != "benchmarks" or set(chosen) <= set(BENCHMARKS.names())
    elif words[0] == "capture":
        check_options(words[1:])
    else:
        pytest.fail("of what kind is this command?")


def check_options(words: list[str]) -> None:
    """Raise where `capture WORDS` has no such command, or the command no such option."""
    group = typer.main.get_command(app)
    if words[0].startswith("-"):
        assert set(words) <= {"--help", *(option for p in group.params for option in p.opts)}
        return
    command = group.commands[words[0]]
    options = {option for p in command.params for option in p.opts} | {"--help", "--debug"}
    assert {w.split("=")[0] for w in words[1:] if w.startswith("--")} <= options
    is_complete = {o for p in command.params if p.required for o in p.opts if o.startswith("--")} <= set(
        words
    )
    is_mention = len(words) == 1
    if is_complete and not is_mention and "--config" not in words:
        command.make_context(words[0], words[1:])


def test_an_option_that_does_not_exist_is_noticed():
    with pytest.raises(AssertionError):
        check_options(["identify", "--real-log", "a.zarr", "--no-such-option"])


def links() -> list:
    found = []
    for page in PAGES:
        text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
        for target in re.findall(r"\]\(([^)\s]+)\)", text):
            if not target.startswith(("http://", "https://")):
                found.append(pytest.param(page, target, id=f"{name(page)}: {target}"))
    return found


@pytest.mark.parametrize(("page", "target"), links())
def test_a_link_resolves(page, target):
    file, _, heading = target.partition("#")
    path = (page.parent / file) if file else page
    assert path.is_file()  # and no folder, of which the site has no page
    if heading:
        headings = re.findall(r"^#+ (.+)$", path.read_text(encoding="utf-8"), re.MULTILINE)
        assert heading in {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}


def test_the_site_leads_to_every_page():
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    entries = re.findall(r"^ +- (?:[^:\n]+: )?(\S+\.md)$", text, re.MULTILINE)
    assert sorted(entries) == sorted(map(name, PAGES))


def test_pages_are_read_once():
    """Who adds a page takes something out: users have 150 kB to read, developers 60."""
    developers = [
        p for p in PAGES if "dev" in p.parts or p.name == "contributing.md" or p.parent.name == "images"
    ]
    users = [p for p in PAGES if p not in developers]
    assert sum(p.stat().st_size for p in users) <= 150_000
    assert sum(p.stat().st_size for p in developers) <= 60_000


def test_what_the_developers_pages_name_is_there():
    text = "".join(page.read_text(encoding="utf-8") for page in sorted((ROOT / "docs" / "dev").glob("*.md")))
    files = set(re.findall(r"`(capture_cli/[\w/]+\.py)`", text))
    values = set(re.findall(r"^\| `([a-z_.]+)\.([A-Z]\w+)` \|", text, re.MULTILINE))
    assert len(files) > 5 and len(values) > 5
    assert not {file for file in files if not (ROOT / file).is_file()}
    assert all(hasattr(importlib.import_module(f"capture_cli.{module}"), value) for module, value in values)


# --- nothing of the machine it was written on ---


def texts() -> list[Path]:
    """Every text file of the project, but what is not kept."""
    found = []
    for inside in generate.kept_files(ROOT):
        if inside.parts[:2] == ("runs", "demo") or inside.suffix in (".png", ".zarr") or "c" in inside.parts:
            continue
        found.append(ROOT / inside)
    return found


def test_no_path_of_this_machine():
    bad = {
        name(path): match.group()
        for path in texts()
        if (match := ABSOLUTE.search(path.read_text(encoding="utf-8", errors="replace")))
    }
    assert not bad


# --- the tutorial, followed to the letter ---


def test_the_tutorial_works(tmp_path, monkeypatch, without_pages):
    tutorial = ROOT / "docs" / "tutorial.md"
    text = tutorial.read_text(encoding="utf-8")
    for language, file in (("xml", "model.xml"), ("toml", "task.toml")):
        (block,) = re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
        (tmp_path / file).write_text(block)
    monkeypatch.chdir(tmp_path)
    truth = {"mass": 0.8, "damping": 0.11, "friction": 0.08}
    header = text.split("```\n")[1].splitlines()[0]
    for seed, day in enumerate(("monday", "tuesday")):
        log = record(
            task="task.toml",
            out=tmp_path / f"{day}.zarr",
            parameters=truth,
            noise=0.002,
            duration=5.0,
            rate=200,
            amplitude={"motor": 1.2},
            seed=seed,
        ).log
        rows = np.column_stack([log.time, log.inputs, np.rad2deg(log.outputs)])
        np.savetxt(f"{day}.csv", rows, delimiter=",", header=header, comments="")
    look_among(monkeypatch, "coulomb-friction", "backlash", "control-delay", "sensor-bias", "sensor-delay")
    for line in commands_of(tutorial):
        if line.startswith("capture") and "--" in line:
            result = CliRunner().invoke(app, shlex.split(line)[1:], catch_exceptions=False)
            assert result.exit_code == 0, f"{line}\n{result.output}"
    found = json.loads((tmp_path / "swing.estimate" / "estimate.json").read_text(encoding="utf-8"))
    assert found["verdict"] == "explained"
    for parameter, value in truth.items():
        assert found["parameters"][parameter]["value"] == pytest.approx(value, rel=0.02)
    import mujoco

    identified = mujoco.MjModel.from_xml_path(str(tmp_path / "identified.xml"))
    assert identified.body("link").mass[0] == pytest.approx(0.8, rel=0.02)


def test_the_task_of_the_reference_page_is_the_demo_and_loads(tmp_path):
    page = (ROOT / "docs" / "task-file.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```toml\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    (tmp_path / "task.toml").write_text(block)
    (tmp_path / "model.xml").write_text((ROOT / "datasets" / "cart" / "model.xml").read_text())
    assert load_task(str(tmp_path)).space.names == ("mass",)


def test_every_key_of_the_task_file_is_documented():
    page = (ROOT / "docs" / "task-file.md").read_text(encoding="utf-8")
    keys = {key for own in KEYS.values() for key in own} - KEYS.keys()  # tables are shown as such
    assert len(keys) > 15
    assert not [key for key in keys if not re.search(rf"`(?:\w+\.(?:NAME\.)?)?{key}`", page)]


# --- the demo ---


@pytest.mark.parametrize("log", ["air_hockey", "cart/cart"])
def test_a_shipped_log_is_what_its_readme_says(tmp_path, monkeypatch, log):
    monkeypatch.chdir(ROOT)
    shipped = ROOT / "datasets" / f"{log}.zarr"
    (command,) = [
        c for c in commands_of(ROOT / "datasets" / "README.md") if f"--out datasets/{log}.zarr" in c
    ]
    words = shlex.split(command)[1:]
    made = tmp_path / shipped.name
    words[words.index("--out") + 1] = str(made)
    result = CliRunner().invoke(app, words, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    files = {p.relative_to(made) for p in made.rglob("zarr.json")}
    assert len(files) > 5
    for file in files:
        assert (made / file).read_bytes() == (shipped / file).read_bytes(), file
    ours, theirs = MeasuredLog.read(made), MeasuredLog.read(shipped)
    for name in ("time", "inputs", "outputs", "actions", "episode_ends", "recording"):
        mine, other = (np.asarray(getattr(log, name), dtype=float) for log in (ours, theirs))
        # sines and cosines differ in their last bit from one kind of processor to another
        np.testing.assert_allclose(mine, other, rtol=0, atol=1e-12, err_msg=name)
    truth = shipped.with_suffix(".truth.json")
    assert (tmp_path / truth.name).read_text() == truth.read_text()
    # and what is true does not stand in the log
    hidden = [*json.loads(truth.read_text())["effects"], "effects"]
    text = [p.read_text() for p in shipped.rglob("*.json")]
    assert not any(word.split("@")[0].split(".")[0] in t for word in hidden for t in text)


def test_identify_needs_nothing_but_the_shipped_log(tmp_path, monkeypatch, without_pages):
    monkeypatch.chdir(tmp_path)
    log = str(ROOT / "datasets" / "air_hockey.zarr")
    result = CliRunner().invoke(app, ["identify", "--real-log", log, "--json", "--threads", "1"])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["in_context"]["checkpoint"] == "capture_cli/checkpoints/air-hockey"
    assert found["in_context"]["rounds"] == 8
    assert found["verdict"] == "unexplained"
    assert found["error"]["test"]["normalized"] > 2
    assert 0.9e-3 < min(found["noise_floor"].values()) <= max(found["noise_floor"].values()) < 1.1e-3


def test_the_demo_finds_the_tilt_and_nothing_else(tmp_path, without_pages):
    log, folder = str(ROOT / "datasets" / "air_hockey.zarr"), str(tmp_path / "demo")
    for command in commands_of(ROOT / "README.md"):
        if "datasets/air_hockey.zarr" in command:
            words = shlex.split(command.replace("datasets/air_hockey.zarr", log).replace("runs/demo", folder))
            result = CliRunner().invoke(app, [*words[1:], "--json"])
            assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["verdict"] == "effect-found"
    [tilt] = found["effects"]
    truth = json.loads((ROOT / "datasets" / "air_hockey.truth.json").read_text())["effects"]
    assert tilt["name"] == "gravity-tilt"
    assert abs(tilt["parameters"]["tilt_y"]["value"] - truth["gravity-tilt.tilt_y"]) < 5e-4
    assert found["after"]["test"]["normalized"] < 1.1
