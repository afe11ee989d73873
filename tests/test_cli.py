"""The command line: what goes to stdout, exit codes, --config, and what is left when a run does not end well."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import typer
from fuzz.forked_run import CAN_RUN, run

from capture_cli.cli.app import app
from capture_cli.errors import OptionError
from capture_cli.estimate.prepare import prepare
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks import load_task
from capture_cli.options.config import _read_config
from capture_cli.simulate.simulator import Simulator
from capture_cli.stages import identify as stage
from capture_cli.store import output
from capture_cli.store.estimate import Estimate
from capture_cli.store.histories import HistoriesWriter
from capture_cli.store.output import PROVENANCE

REPOSITORY = Path(__file__).resolve().parents[1]
MACHINES = REPOSITORY / "benchmarks" / "machines"
SLIDER = MACHINES / "slider" / "task.toml"
CAPTURE = (sys.executable, "-m", "capture_cli")
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
FAST = ("--starts", "1", "--threads", "1")
RECORD = ("record", "--task", str(SLIDER), "--duration", "1.5", "--rate", "250", "--noise", "0.0005")


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    """A log of the slider, 4 episodes of 1.5 s, with noise."""
    path = tmp_path_factory.mktemp("log") / "run.zarr"
    subprocess.run(
        [*CAPTURE, *RECORD, "--episodes", "4", "--param", "mass=1.5", "--seed", "3", "--out", str(path)],
        check=True,
        capture_output=True,
        env=ENVIRONMENT,
    )
    return path


def identify(log: Path, *more) -> tuple:
    return ("identify", "--real-log", log, "--task", SLIDER, *FAST, *more)


def start(folder: Path, *arguments, program: tuple = CAPTURE) -> subprocess.Popen:
    return subprocess.Popen(
        [*program, *map(str, arguments)],
        cwd=folder,
        env=ENVIRONMENT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


# --- the whole path ---


def test_from_record_to_export(tmp_path):
    """Each command as a user runs it: with --json, stdout is one JSON document and nothing else."""

    def run(*arguments) -> dict:
        done = subprocess.run(
            [*CAPTURE, *map(str, arguments), "--json"],
            cwd=tmp_path,
            env=ENVIRONMENT,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    truth = run(*RECORD, "--episodes", 4, "--param", "mass=1.5", "--param", "damping=7", "--out", "run.zarr")
    assert truth["parameters"] == {"mass": 1.5, "damping": 7.0, "stiffness": 60.0}
    assert run("inspect", "run.zarr", "--task", SLIDER)["kind"] == "measured-log"
    document = run(*identify("run.zarr", "--out", "run.estimate"))
    assert document == json.loads((tmp_path / "run.estimate" / "estimate.json").read_text())
    assert (document["format"], document["version"], document["task"]) == ("capture/estimate", 2, "slider")
    assert document["verdict"] == "explained"
    for name, p in document["parameters"].items():
        assert p["value"] == pytest.approx(truth["parameters"][name], abs=4 * p["sd"])
    files = {p.name for p in (tmp_path / "run.estimate").iterdir()}
    assert {"estimate.json", "estimate.zarr", "report.html", PROVENANCE} <= files
    assert run("export", "run.estimate", "--out", "identified.xml") == {"model": "identified.xml"}
    assert_reproduces(tmp_path / "identified.xml", tmp_path / "run.estimate", tmp_path / "run.zarr")
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        *("identified.xml", "run.estimate", "run.truth.json", "run.zarr"),
    ]


def assert_reproduces(model: Path, estimate: Path, log: Path) -> None:
    """The exported model, with nothing left to set, gives the estimate's simulated curves."""
    found = Estimate.read(estimate)
    compiled = mujoco.MjModel.from_xml_path(str(model))
    assert compiled.body("carriage").mass[0] == found.document["parameters"]["mass"]["value"]
    text = SLIDER.read_text().replace("model.xml", model.name)
    bare = model.with_name("task.toml")
    bare.write_text(text[: text.index("[parameters")] + text[text.index("[inputs") :])
    task = load_task(str(bare))
    prepared = prepare(MeasuredLog.read(log), task)
    corrections = found.arrays["window/start_offset"][None]
    simulated = Simulator(task).simulate(
        prepared.windows, prepared.initial.states, np.zeros((1, 0)), corrections
    )
    np.testing.assert_allclose(
        simulated.outputs[0][prepared.windows.mask], found.arrays["step/simulated"], atol=1e-12
    )
    bare.unlink()


def test_a_truth_is_not_overwritten_unasked(capture, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("known.json").write_text("of another log")
    arguments = [*RECORD, "--out", "run.zarr", "--truth", "known.json"]
    code, _, err = capture(*arguments)
    assert code == 2 and "known.json exists already" in err and "--force" in err
    for here in (".", ".."):
        code, _, err = capture("record", "--task", SLIDER, "--out", here)
        assert code == 2 and f"{here} exists already" in err
    assert not Path("run.zarr").exists() and Path("known.json").read_text() == "of another log"
    assert capture(*arguments, "--force")[0] == 0
    assert "parameters" in json.loads(Path("known.json").read_text())


def test_provenance_says_how_it_was_made(capture, log, tmp_path, without_pages):
    code, _, err = capture(*identify(log, "--out", "e", "--seed", "7"))
    assert (code, err) == (0, err)
    made = json.loads((tmp_path / "e" / PROVENANCE).read_text())
    assert made["command"] == "identify"
    assert (made["options"]["seed"], made["options"]["starts"], made["options"]["task"]) == (
        7,
        1,
        str(SLIDER),
    )
    assert made["inputs"]["real_log"]["path"] == str(log)
    assert len(made["inputs"]["real_log"]["sha256"]) == 64
    assert made["inputs"]["task"]["path"] == str(SLIDER)
    assert {"capture", "python", "packages", "seconds"} <= set(made)


def test_the_default_out_is_beside_the_user(capture, log, tmp_path, without_pages):
    assert capture(*identify(log))[0] == 0
    assert Estimate.read(tmp_path / "run.estimate").document["task"] == "slider"


def test_the_table_is_on_stdout_and_progress_is_not(capture, log, without_pages):
    code, out, err = capture(*identify(log, "--out", "e"))
    assert code == 0
    assert "mass" in out
    assert "explained" in out
    assert "round" not in out
    assert "mass" not in err


def test_quiet_says_nothing(capture, log, without_pages):
    assert capture(*identify(log, "--out", "e", "--quiet")) == (0, "", "")


def test_quiet_hides_no_warnings_of_an_import(capture, tmp_path):
    rows = [f"{0.004 * i:.3f},{np.sin(i):.3f},1,a" for i in range(500)]
    (tmp_path / "still.csv").write_text("\n".join(["t_s,force_N,q_m,episode", *rows]))
    code, out, err = capture("import-log", "still.csv", "--task", SLIDER, "--out", "s.zarr", "--quiet")
    assert (code, out) == (0, "")
    assert err.startswith("error: s.zarr: output q: never changes")
    assert "\n  cure: check the sensor" in err and "note" not in err
    code, out, err = capture("import-log", "s.zarr", "--task", SLIDER, "--out", "t.zarr")
    assert (code, err) == (0, "") and "never changes" in out


@pytest.mark.parametrize("command", ["tasks", "effects"])
def test_listings(capture, command):
    code, out, _ = capture(command, "--task", SLIDER)
    assert code == 0
    assert "mass" in out if command == "tasks" else "coulomb-friction" in out
    code, out, err = capture(command, "--task", SLIDER, "--json")
    assert (code, err) == (0, "")
    assert list(json.loads(out)) == [command]


def test_a_narrow_terminal_shows_names_and_parameters_whole(capture):
    _, out, _ = capture("effects", "--json")
    effects = json.loads(out)["effects"]
    _, out, _ = capture("effects")
    shown = " ".join(out.split())
    for effect in effects:
        parameters = ", ".join(f"{p['name']} ({p['unit']})" for p in effect["parameters"])
        assert f"{effect['name']} {effect['summary']} {parameters}".strip() in shown


def test_one_effect_is_shown_with_its_law_and_ranges(capture):
    code, out, err = capture("effects", "stribeck-friction", "--task", SLIDER)
    assert (code, err) == (0, "")
    shown = " ".join(out.split())
    assert "`breakaway` exp(-(v / `speed`)^2) is added to the joint's dry friction" in shown
    assert "here: x" in shown and "any (shape)" in shown
    _, out, _ = capture("effects", "stribeck-friction", "--json")
    (effect,) = json.loads(out)["effects"]
    assert [(p["name"], p["shape"]) for p in effect["parameters"]] == [("breakaway", False), ("speed", True)]
    code, _, err = capture("effects", "stribek-friction")
    assert code == 2 and "did you mean 'stribeck-friction'" in err


# --- exit codes ---


@pytest.mark.parametrize(
    ("effect", "verdict", "fail_on", "expected"),
    [
        ((), "explained", "unexplained,not-identifiable", 0),
        (("--effect", "coulomb-friction@x=3"), "unexplained", None, 0),
        (("--effect", "coulomb-friction@x=3"), "unexplained", "not-identifiable", 0),
        (("--effect", "coulomb-friction@x=3"), "unexplained", "unexplained", 3),
    ],
)
def test_fail_on_a_verdict(capture, tmp_path, without_pages, effect, verdict, fail_on, expected):
    assert capture(*RECORD, "--episodes", 4, *effect, "--out", "run.zarr")[0] == 0
    more = ("--fail-on", fail_on) if fail_on else ()
    code, out, _ = capture(*identify(tmp_path / "run.zarr", "--out", "e", "--json", *more))
    assert json.loads(out)["verdict"] == verdict
    assert code == expected
    assert Estimate.read(tmp_path / "e").document["verdict"] == verdict  # it ran, and is written


def test_our_own_faults_exit_with_1(capture, log, monkeypatch, tmp_path):
    def broken(_):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(stage, "identify", broken)
    code, out, err = capture(*identify(log, "--out", "e"))
    assert (code, out) == (1, "")
    assert "internal error: ZeroDivisionError: a bug" in err
    assert "--debug" in err
    assert "Traceback" not in err
    code, _, err = capture(*identify(log, "--out", "e", "--debug"))
    assert code == 1
    assert "Traceback" in err
    assert not (tmp_path / "e").exists()


def test_debug_shows_where_a_mendable_error_was_raised(capture, log):
    code, _, err = capture("--debug", *identify(log, "--test", "nowhere", "--out", "e"))
    assert code == 2
    assert "Traceback" in err
    assert "cure:" in err


@pytest.fixture
def foreign(tmp_path) -> Path:
    import zarr

    zarr.open_group(str(tmp_path / "foreign.zarr"), mode="w").create_array("x", shape=(3,), dtype="f8")
    return tmp_path / "foreign.zarr"


def test_mendable_errors_exit_with_2_and_write_nothing(capture, log, tmp_path, foreign):
    puck = MACHINES / "puck" / "task.toml"
    existing = tmp_path / "there"
    existing.mkdir()
    cases = [
        (identify(log, "--out", existing), ["exists already", "--force"]),
        (identify(log, "--test", "nowhere"), ["'nowhere'", "run"]),
        (identify(log, "--identifier", "magic"), ["'magic'", "least-squares"]),
        (identify(log, "--fail-on", "unexplaned"), ["unexplaned", "did you mean 'unexplained'"]),
        (identify(log, "--window", "-1"), ["--window -1"]),
        (identify(log, "--window", "0.001"), ["fewer than"]),
        (identify(log, "--window", "99"), ["99 s", "--window"]),
        (identify(foreign), ["foreign.zarr", "not a capture/measured-log"]),
        (identify(tmp_path / "no.zarr"), ["no.zarr does not exist"]),
        (("identify", "--real-log", log, "--task", "slidr.toml"), ["'slidr.toml'", "task.toml"]),
        (("identify", "--real-log", log), ["'slider'", "--task PATH/TO/task.toml"]),
        (("identify", "--real-log", log, "--task", puck), ["(drive)", "'puck'", "import the log again"]),
        (("identify",), ["--real-log"]),
        (identify(log, "--starts", "0"), ["--starts"]),
        (identify(log, "--starts", "many"), ["--starts"]),
        (identify(log, "--strats", "2"), ["--strats"]),
        (("identfy",), ["identfy", "identify"]),
        ((*RECORD, "--out", "r.zarr", "--param", "mas=1"), ["'mas'", "did you mean 'mass'"]),
        ((*RECORD, "--out", "r.zarr", "--param", "mass"), ["NAME=NUMBER", "--param"]),
        ((*RECORD, "--out", "r.zarr", "--effect", "coulomb@x=1"), ["'coulomb'", "coulomb-friction"]),
        ((*RECORD, "--out", "r.zarr", "--effect", "coulomb-friction@y=1"), ["'y'", "x"]),
        ((*RECORD, "--out", "r.zarr", "--effect", "wind@x=1"), ["as a whole", "without @x"]),
        ((*RECORD[:-2], "--out", "r.zarr", "--noise", "v=1"), ["'v'", "q"]),
        ((*RECORD[:-2], "--out", "r.zarr", "--noise", "-1"), ["--noise q=-1", "0 or more"]),
        ((*RECORD[:-2], "--out", "r.zarr", "--noise", "much"), ["--noise 'much'"]),
        ((*RECORD, "--out", "r.zarr", "--start", "y=1"), ["'y'", "x"]),
        ((*RECORD, "--out", "r.zarr", "--start", "x=1:0"), ["'x=1:0': 1 is above 0", "--start x=0:1"]),
        ((*RECORD, "--out", "r.zarr", "--start", "x=1:"), ["'x=1:'", "LOW:HIGH"]),
        ((*RECORD, "--out", "r.zarr", "--start", "x=:1"), ["'x=:1'", "LOW:HIGH"]),
        ((*RECORD, "--out", "r.zarr", "--start", "x=nan"), ["'x=nan'", "LOW:HIGH"]),
        ((*RECORD, "--out", "r.zarr", "--param", "mass=inf"), ["'mass=inf'"]),
        ((*RECORD, "--out", "r.zarr", "--rate", "-5"), ["--rate -5", "positive"]),
        ((*RECORD, "--out", "r.zarr", "--rate", "inf"), ["--rate inf", "finite"]),
        ((*RECORD, "--out", "r.zarr", "--duration", "nan"), ["--duration nan", "finite"]),
        ((*RECORD[:3], "--out", "r.zarr", "--duration", "1e300"), ["--duration 1e+300", "finite"]),
        ((*RECORD[:3], "--out", "r.zarr", "--duration", "1e9"), ["500 MB", "--duration", "--max-log-size"]),
        ((*RECORD, "--out", "r.zarr", "--episodes", "9" * 400), ["400 characters", "2147483647"]),
        ((*RECORD, "--out", "r.zarr", "--episodes", "9" * 5000), ["5000 characters", "whole number"]),
        ((*RECORD, "--out", "r.zarr", "--episodes", "2000000000"), ["500 MB", "fewer --episodes"]),
        ((*RECORD, "--out", "r.zarr", "--band", "3", "1"), ["--band 3 1", "lower"]),
        ((*RECORD, "--out", "r.zarr", "--seed", "-1"), ["--seed -1", "whole number from 0 to 4294967295"]),
        ((*RECORD, "--out", "r.zarr", "--seed", "4294967296"), ["--seed 4294967296", "from 0 to 4294967295"]),
        ((*RECORD, "--out", "r.zarr", "--episodes", "0"), ["--episodes 0", "a whole number of 1 or more"]),
        ((*RECORD, "--out", "r.zarr", "--episodes=few"), ["--episodes few", "a whole number of 1 or more"]),
        ((*RECORD, "--out", "r.zarr", "--band", "1", "x"), ["--band 1 x", "2 numbers"]),
        (
            ("train-sysid", "--histories", "h", "--out", "o", "--dropout", "2"),
            ["--dropout 2", "a number from 0 to 0.9"],
        ),
        (("train-sysid", "--histories", "h", "--out", "o", "--lr", "x"), ["--lr x", "give a number"]),
        (("record", "--task", str(SLIDER)), ["--out"]),
        ((*RECORD, "--out", "r.zarr", "--duration", "1e-9"), ["1e-09 s at 250 Hz", "single sample"]),
        ((*RECORD, "--out", "r.zarr", "--inputs-from", log), ["--duration means nothing", "time and inputs"]),
        ((*RECORD[:-2], "--out", "r.zarr", "--noise", "inf"), ["--noise inf", "finite"]),
        (
            ("record", "--task", "scooping", "--rate", "1", "--out", "r.zarr"),
            ["0.4 s at 1 Hz", "single sample"],
        ),
        (
            ("gen-histories", "--task", "scooping", "--seed", "-1", "--out", "h.zarr"),
            ["--seed -1", "from 0 to"],
        ),
        ((*RECORD, "--out", "r.zarr", "--amplitude", "push=5"), ["'push'", "drive"]),
        (("export", existing, "--out", "m.xml"), ["estimate.json"]),
        (("inspect", "nothing.zarr"), ["nothing.zarr"]),
        (("tasks", "--task", "nothing"), ["'nothing'"]),
        (("tasks", "--task", "air-hocky"), ["'air-hocky'", "did you mean 'air-hockey'"]),
    ]
    before = sorted(tmp_path.rglob("*"))
    for arguments, named in cases:
        code, out, err = capture(*arguments)
        assert (code, out) == (2, ""), (arguments, err)
        assert "Traceback" not in err
        plain = " ".join(err.split())
        for piece in named:
            assert piece in plain, (arguments, err)
        assert sorted(tmp_path.rglob("*")) == before, arguments


def test_force_replaces_an_output_and_nothing_else(capture, log, tmp_path, without_pages):
    assert capture(*identify(log, "--out", "e"))[0] == 0
    assert capture(*identify(log, "--out", "e"))[0] == 2
    assert capture(*identify(log, "--out", "e", "--force", "--seed", "5"))[0] == 0
    assert json.loads((tmp_path / "e" / PROVENANCE).read_text())["options"]["seed"] == 5
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.tex").write_text("years of work")
    code, _, err = capture(*identify(log, "--out", "mine", "--force"))
    assert code == 2
    assert "not an output of `capture`" in err
    assert (mine / "thesis.tex").read_text() == "years of work"


def test_inspect_ends_with_3_on_warnings_where_it_is_asked_to(capture, tmp_path):
    assert capture(*RECORD, "--episodes", 2, "--out", "run.zarr")[0] == 0
    assert capture("inspect", "run.zarr", "--fail-on", "warning")[0] == 0
    task = tmp_path / "slider" / "task.toml"
    shutil.copytree(SLIDER.parent, task.parent)
    task.write_text(task.read_text().replace("window = ", "window = 0.02 #"))
    assert capture("inspect", "run.zarr", "--task", task)[0] == 0
    assert capture("inspect", "run.zarr", "--task", task, "--fail-on", "warning")[0] == 3
    assert capture("inspect", "run.zarr", "--fail-on", "note")[0] == 2


def test_a_finding_that_is_an_error_ends_inspect_with_2(capture, log, tmp_path):
    assert capture("inspect", log)[0] == 0
    damaged = tmp_path / "damaged.zarr"
    shutil.copytree(log, damaged)
    shutil.rmtree(damaged / "data")
    code, out, err = capture("inspect", damaged)
    assert (code, err) == (2, "") and "is missing" in " ".join(out.split())


# --- --config ---


def test_a_config_gives_defaults_and_options_override_them(capture, log, tmp_path, without_pages):
    config = tmp_path / "run.toml"
    config.write_text(
        f'real-log = "{log}"\ntask = "{SLIDER}"\nstarts = 1\nthreads = 1\nseed = 11\nout = "c"\n'
    )
    code, out, _ = capture("identify", "--config", config, "--seed", "12", "--json")
    assert code == 0
    assert json.loads(out)["log"]["path"] == str(log)
    options = json.loads((tmp_path / "c" / PROVENANCE).read_text())["options"]
    assert (options["starts"], options["seed"], options["out"]) == (1, 12, "c")


def test_a_config_may_hold_sections_for_several_commands(capture, tmp_path):
    config = tmp_path / "run.toml"
    config.write_text(
        f'[record]\ntask = "{SLIDER}"\nout = "a.zarr"\nduration = 0.5\nnoise = [0.001]\n'
        'param = ["mass=1.5", "damping=3"]\nband = [0.5, 2.0]\n[identify]\nstarts = 1\n'
    )
    code, out, _ = capture("record", "--config", config, "--json")
    assert code == 0
    assert json.loads(out)["parameters"] == {"mass": 1.5, "damping": 3.0, "stiffness": 60.0}
    options = json.loads((tmp_path / "a.zarr" / PROVENANCE).read_text())["options"]
    assert (options["duration"], options["band"]) == (0.5, [0.5, 2.0])


def test_a_config_with_tables_for_other_commands_alone(capture, tmp_path):
    config = tmp_path / "run.toml"
    config.write_text(f'task = "{SLIDER}"\nduration = 0.5\n[identify]\nstarts = 1\n[diagnose]\nstarts = 2\n')
    code, _, err = capture("record", "--config", config, "--out", "a.zarr", "--quiet")
    assert (code, err) == (0, "")


def test_a_config_has_options_for_all_commands_at_its_top_and_for_one_in_its_table(capture, tmp_path):
    config = tmp_path / "run.toml"
    config.write_text(f'task = "{SLIDER}"\nduration = 0.5\nseed = 3\n[record]\nduration = 0.7\n')
    code, _, err = capture("record", "--config", config, "--out", "a.zarr", "--quiet")
    assert (code, err) == (0, "")
    options = json.loads((tmp_path / "a.zarr" / PROVENANCE).read_text())["options"]
    assert (options["duration"], options["seed"]) == (0.7, 3)


def test_what_another_command_has_may_stand_at_the_top(capture, tmp_path):
    config = tmp_path / "run.toml"
    config.write_text(f'task = "{SLIDER}"\nduration = 0.5\npairs = 3\nfail-on = "unexplained"\n')
    code, _, err = capture("record", "--config", config, "--out", "a.zarr", "--quiet")
    assert code == 0, err


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("strats = 2\n[identify]\nstarts = 1", ["no option 'strats'"]),
        ("strats = 2", ["no option 'strats'", "did you mean 'starts'"]),
        ("starts = 'many'", ["starts"]),
        ("starts = 0", ["starts"]),
        ("starts = ", ["run.toml"]),
        ("help = true", ["no option 'help'"]),
        ("config = 'x.toml'", ["no option 'config'"]),
        ("window = true", ["run.toml: window = true", "--window is no switch", "give it a value"]),
        ("[identify]\nseed = false", ["run.toml: seed = false", "--seed is no switch"]),
        ("real-log = true", ["run.toml: real-log = true", "--real-log is no switch"]),
        ("rounds = 0", ["--config", "run.toml: --rounds 0", "a whole number of 1 or more"]),
        ("threads = 'all'", ["run.toml: --threads all", "a whole number from 1 to 1024"]),
        ("[identify]\npairs = 3", ["no option 'pairs'"]),
        ("[train_policy]\nsteps = 3", ["[train_policy]", "no command is called so", "'train-policy'"]),
    ],
)
def test_a_config_that_is_wrong(capture, log, tmp_path, text, named):
    config = tmp_path / "run.toml"
    config.write_text(text)
    code, out, err = capture(*identify(log)[:-4], "--config", config)
    assert (code, out) == (2, "")
    for piece in named:
        assert piece in " ".join(err.split())
    assert not (tmp_path / "run.estimate").exists()


COMMANDS = typer.main.get_command(app).commands
OPTIONS = [
    (name, option)
    for name, command in COMMANDS.items()
    for option in command.params
    if option.name not in ("help", "config")
]
REPEATED = [(n, o) for n, o in OPTIONS if getattr(o, "multiple", False) or o.nargs < 0]


@pytest.mark.parametrize(("name", "option"), REPEATED, ids=[f"{n}-{o.name}" for n, o in REPEATED])
def test_in_a_config_one_value_of_an_option_that_repeats_is_a_list_of_one(name, option, tmp_path):
    (tmp_path / "run.toml").write_text(f'{option.opts[0].lstrip("-")} = "one"')
    context = typer.Context(COMMANDS[name], info_name=name)
    _read_config(context, tmp_path / "run.toml")
    assert context.default_map == {option.name: ["one"]}


@pytest.mark.parametrize(("name", "option"), OPTIONS, ids=[f"{n}-{o.name}" for n, o in OPTIONS])
def test_a_config_that_gives_too_many_values_too_few_or_a_table(name, option, tmp_path):
    context = typer.Context(COMMANDS[name], info_name=name)
    repeats = (name, option) in REPEATED
    texts = ["{a = 1}", "[[1, 2]]"] + ["[1, 2, 3]"] * (not repeats) + ["0.5"] * (option.nargs == 2)
    for text in texts:
        key = option.opts[0].lstrip("-")
        (tmp_path / "run.toml").write_text(f"{key} = {text}")
        with pytest.raises(OptionError, match=rf"run\.toml: {key} = ") as caught:
            _read_config(context, tmp_path / "run.toml")
        assert f"{key} = " in caught.value.cure
        assert ("2 numbers" in caught.value.cure) == (option.nargs == 2)


def test_a_config_with_one_value_of_options_that_repeat(capture, tmp_path):
    config = tmp_path / "run.toml"
    config.write_text(f'task = "{SLIDER}"\nduration = 0.5\nparam = "mass=1.5"\nnoise = 0.001\n')
    code, out, _ = capture("record", "--config", config, "--out", "a.zarr", "--json")
    assert code == 0 and json.loads(out)["parameters"]["mass"] == 1.5


def test_no_output_replaces_the_config(capture, tmp_path):
    config = tmp_path / "kept" / "run.toml"
    config.parent.mkdir()
    config.with_name("provenance.json").write_text("{}")  # as in an output, which --force replaces
    config.write_text("duration = 1.0\nforce = true\n")
    for option, path in (("--out", config.parent), ("--truth", config)):
        options = ("--out", "r.zarr", option, path)
        code, out, err = capture("record", "--task", SLIDER, "--config", config, *options)
        assert (code, out) == (2, "")
        assert f"{option} {path}" in err and "which is read" in err
    assert config.read_text().startswith("duration") and not (tmp_path / "r.zarr").exists()


def test_an_argument_in_a_config_is_no_switch(capture, tmp_path):
    config = tmp_path / "run.toml"
    config.write_text(f'task = "{SLIDER}"\nfiles = [true]\n')
    code, _, err = capture("import-log", "--config", config, "--out", "a.zarr")
    assert code == 2 and "files = [true], and files is no switch" in " ".join(err.split())


def test_a_config_that_is_missing(capture, log):
    code, _, err = capture(*identify(log, "--config", "nowhere.toml"))
    assert code == 2
    assert "nowhere.toml" in err


# --- runs that do not end ---


def die(*_):
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.skipif(not CAN_RUN, reason="processes are copied on Linux alone")
@pytest.mark.parametrize(
    ("module", "name"), [(stage, "_write_pages"), (output, "_sync"), (output, "_move_into_place")]
)
def test_a_run_killed_while_it_writes(
    tmp_path, tmp_path_factory, log, capture, without_pages, monkeypatch, module, name
):
    arguments = [*map(str, identify(log, "--out", "e", "--quiet"))]
    with monkeypatch.context() as patch:
        patch.setattr(module, name, die)
        assert run(arguments, tmp_path, tmp_path_factory.mktemp("temporary")).code == -signal.SIGKILL
    assert not (tmp_path / "e").exists()
    assert [p.name[:11] for p in tmp_path.iterdir()] == [".e.partial-"]
    assert capture(*identify(log, "--out", "e"))[0] == 0
    assert [p.name for p in tmp_path.iterdir()] == ["e"]


FITTING_FOR_EVER = """
import signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs start with it ignored
from capture_cli.cli import main
from capture_cli.stages.identification import estimation

def run(*_):
    print("fitting", file=sys.stderr, flush=True)
    while True:
        time.sleep(0.01)

estimation.run = run
main()
"""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_exits_with_its_number_and_leaves_nothing(tmp_path, log, number, code):
    program = (sys.executable, "-c", FITTING_FOR_EVER)
    run = start(tmp_path, *identify(log, "--out", "e", "--quiet"), program=program)
    assert run.stderr.readline() == "fitting\n"
    run.send_signal(number)
    out, err = run.communicate()
    assert (run.returncode, out) == (code, "")
    assert err.startswith("interrupted: nothing was written\n  cure: run the same command again")
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_while_it_writes(capture, log, monkeypatch, tmp_path):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(stage, "_write_pages", interrupted)
    code, out, err = capture(*identify(log, "--out", "e"))
    assert (code, out) == (130, "")
    assert "interrupted: nothing was written" in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_what_is_kept_is_said_whatever_signal_ended_it(request, capture, monkeypatch, number, code):
    write = HistoriesWriter.write

    def once(self, *arguments):
        write(self, *arguments)
        os.kill(os.getpid(), number)

    monkeypatch.setattr(HistoriesWriter, "write", once)
    ours = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, ours))
    options = ("--task", "scooping", "--policy", "random", "--pairs", 300, "--rounds", 2, "--out", "h.zarr")
    ended, out, err = capture("gen-histories", *options, "--quiet")
    assert (ended, out) == (code, "")
    assert err == (
        "interrupted: 256 of 300 histories are kept\n  cure: go on with the same command and --resume\n"
    )
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN, "what is left is the interpreter's end"


def test_a_full_disk(capture, log, monkeypatch, tmp_path):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(stage, "_write_pages", full)
    code, out, err = capture(*identify(log, "--out", "e"))
    assert (code, out) == (2, "")
    assert "the disk is full" in err
    assert "cure: free some space" in err
    assert list(tmp_path.iterdir()) == []


def test_an_out_that_may_not_be_written(capture, log, tmp_path, without_pages):
    (tmp_path / "file").write_text("")
    code, _, err = capture(*identify(log, "--out", "file/e"))
    assert code == 2
    assert "file/e: file is a file, not a folder" in err
    code, _, err = capture(*identify(log, "--out", "/dev/null/e"))
    assert code == 2 and "/dev/null is a device or a pipe, not a folder" in err


@pytest.mark.parametrize(
    "arguments",
    [
        ("effects", "--json"),
        ("--help",),
    ],
)
def test_a_reader_that_goes_away_is_no_error(tmp_path, arguments):
    """As in `capture effects --json | head -1`."""
    run = start(tmp_path, *arguments)
    run.stdout.close()
    assert run.stderr.read() == ""
    assert run.wait() == 0


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no device that is always full")
@pytest.mark.parametrize("arguments", [("tasks",), ("tasks", "--json"), ("--help",)])
def test_a_stdout_that_is_full(arguments):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*CAPTURE, *arguments],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            env=ENVIRONMENT,
        )
    assert done.returncode == 2
    assert done.stderr.startswith("error: the disk is full") and "internal" not in done.stderr


def test_a_stdout_that_is_closed():
    command = " ".join([*CAPTURE, "tasks", ">&-"])
    done = subprocess.run(command, shell=True, capture_output=True, text=True, check=False, env=ENVIRONMENT)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("diag", ["diagnose"]),
        ("identify --task ", ["air-hockey", "door", "scooping", "scooping-distance", "arm.toml"]),
        ("record --effect coulomb", ["coulomb-friction"]),
        ("effects coulomb", ["coulomb-friction"]),
        ("gen-histories --search b", ["binary"]),
        (
            "eval-sim2sim --identifier c",
            ["capture", "capture-refined", "capture-trajectory", "cma-es", "compass"],
        ),
        ("identify --fail-on ", ["unexplained", "not-identifiable"]),
        ("identify --task nothing", []),
    ],
)
def test_commands_and_values_are_completed(capture, tmp_path, monkeypatch, typed, offered):
    """What the script of `--show-completion bash` runs when a user presses tab."""
    (tmp_path / "arm.toml").touch()
    words = f"capture {typed}"
    asked = {"_CAPTURE_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    for name, value in asked.items():
        monkeypatch.setenv(name, value)
    assert capture()[1].split() == offered
