"""Results find the task and the model they were made with, wherever they were moved, and no other."""

from __future__ import annotations

import json
import shutil
from copy import copy
from pathlib import Path

import mujoco
import numpy as np
import pytest

from capture_cli.errors import LogError, OptionError, OutputError, StoreError
from capture_cli.estimate.log_requirements import all_diverged
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model.tasks import load_task
from capture_cli.stages import diagnose as diagnose_stage
from capture_cli.stages import identify as identify_stage
from capture_cli.stages.export import export
from capture_cli.stages.gen_histories import gen_histories
from capture_cli.stages.import_log import import_log
from capture_cli.stages.propose import propose
from capture_cli.stages.record import record
from capture_cli.stages.recorded.recorded_task import recorded_task
from capture_cli.store.output import sha256

SLIDER = Path(__file__).parents[1] / "benchmarks" / "machines" / "slider"


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """A folder with a machine, a log of it and an estimate, made from within it by relative paths."""
    folder = tmp_path_factory.mktemp("original") / "made"
    shutil.copytree(SLIDER, folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(identify_stage, "_write_pages", lambda *_: None)
        log = Path("log.zarr")
        record(task="task.toml", out=log, noise=5e-4, episodes=2, duration=1.5, rate=250.0, threads=1)
        estimate, options = Path("estimate"), {"starts": 1, "threads": 1, "quiet": True}
        identify_stage.identify(real_log=log, task="task.toml", out=estimate, **options)
    return folder


@pytest.fixture
def made(original, tmp_path, monkeypatch, without_pages):
    """A copy of `original`, to work in."""
    folder = shutil.copytree(original, tmp_path / "made")
    monkeypatch.chdir(folder)
    return folder


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_from_another_folder_the_task_is_that_of_the_result(made, tmp_path, monkeypatch):
    """In the other folder lies a task of the same text, whose model is another."""
    other = tmp_path / "other"
    shutil.copytree(SLIDER, other)
    edit(other / "model.xml", 'mass="2"', 'mass="7"')
    monkeypatch.chdir(other)
    export(result=Path("../made/estimate"), out=Path("found.xml"))
    exported = mujoco.MjModel.from_xml_path("found.xml")
    assert exported.body("carriage").mass[0] == pytest.approx(2.0, rel=0.01)
    assert propose(result=Path("../made/estimate"), threads=1)["task"] == "slider"
    with pytest.raises(OptionError, match=r"model\.xml is not the model"):
        export(result=Path("../made/estimate"), out=Path("wrong.xml"), task="task.toml")
    assert not Path("wrong.xml").exists()


def test_of_a_diagnosis_its_experiment_is_proposed_and_nothing_else(made):
    experiment = {"duration_s": 1.0, "peaks": [2.0], "band_hz": [0.5, 3.0], "text": "drive it"}
    document = {"format": "capture/diagnosis", "version": 1, "log": {"path": "log.zarr"}}
    document |= {"task": "slider", "parameters": {}, "effects": []}
    (made / "diagnosis").mkdir()
    (made / "diagnosis" / "diagnosis.json").write_text(
        json.dumps({**document, "verdict": "tied", "next_experiment": experiment})
    )
    shutil.copy(made / "estimate" / "provenance.json", made / "diagnosis")
    proposal = propose(result=Path("diagnosis"), amplitude={"drive": 3.0})
    assert proposal["text"].startswith("drive it; where it takes the machine is not known")
    assert proposal["peaks"] == {"drive": 3.0}
    with pytest.raises(OptionError, match="no input 'motor'"):
        propose(result=Path("diagnosis"), amplitude={"motor": 1.0})
    with pytest.raises(OptionError, match="is a diagnosis"):
        propose(result=Path("diagnosis"), policy="random")


def test_what_is_proposed_for_a_model_that_lacks_something_says_so(made):
    doubt = "does not explain its log"
    assert doubt not in propose(result=Path("estimate"))["text"]
    edit(made / "estimate" / "estimate.json", '"verdict": "explained"', '"verdict": "unexplained"')
    assert doubt in propose(result=Path("estimate"))["text"]


def test_a_model_that_changed_since_is_refused(made):
    edit(made / "model.xml", 'mass="2"', 'mass="3"')
    for run in (
        lambda: export(result=Path("estimate"), out=Path("m.xml")),
        lambda: propose(result=Path("estimate")),
        lambda: diagnose_stage.diagnose(real_log=Path("log.zarr"), estimate=Path("estimate"), out=Path("d")),
    ):
        with pytest.raises(OptionError, match=r"model\.xml is not the model") as caught:
            run()
        assert caught.value.cure


@pytest.mark.parametrize("value", ["1e308", "-0.5"])
def test_a_value_outside_of_its_bounds_is_used_by_nobody(made, value):
    document = json.loads((made / "estimate" / "estimate.json").read_text())
    document["parameters"]["mass"]["value"] = float(value)
    (made / "estimate" / "estimate.json").write_text(json.dumps(document))
    for use in (
        lambda: export(result=Path("estimate"), out=Path("m.xml")),
        lambda: propose(result=Path("estimate")),
    ):
        with pytest.raises(StoreError, match=r"mass = .*outside of its bounds") as caught:
            use()
        assert "capture identify" in caught.value.cure
    assert not (made / "m.xml").exists()


def test_a_result_that_names_no_task(made):
    provenance = {"inputs": {}, "options": {"task": None}}
    with pytest.raises(OptionError, match="does not say which task") as caught:
        recorded_task(Path("estimate"), provenance)
    assert "--task" in caught.value.cure


def test_what_a_model_includes_is_part_of_it(made):
    (made / "model.xml").rename(made / "carriage.xml")
    (made / "model.xml").write_text('<mujoco><include file="carriage.xml"/></mujoco>')
    identify_stage.identify(
        real_log=Path("log.zarr"), task="task.toml", out=Path("again"), starts=1, threads=1, quiet=True
    )
    export(result=Path("again"), out=Path("m.xml"))
    with pytest.raises(OutputError, match="which is read"):
        export(result=Path("again"), out=Path("carriage.xml"), force=True)
    edit(made / "carriage.xml", 'mass="2"', 'mass="3"')
    with pytest.raises(OptionError, match=r"carriage\.xml is not the model"):
        export(result=Path("again"), out=Path("n.xml"))


def test_a_task_that_is_gone_is_named(made):
    (made / "task.toml").rename(made / "renamed.toml")
    with pytest.raises(OptionError, match=r"task\.toml, which is neither here nor beside it") as caught:
        export(result=Path("estimate"), out=Path("m.xml"))
    assert "--task" in caught.value.cure
    export(result=Path("estimate"), out=Path("m.xml"), task="renamed.toml")


@pytest.mark.parametrize("out", ["log.zarr", "."])
def test_an_output_is_not_what_is_read(made, out):
    with pytest.raises(OutputError):
        identify_stage.identify(
            real_log=Path("log.zarr"), task="task.toml", out=Path(out), force=True, threads=1, quiet=True
        )
    for mine in ("model.xml", "task.toml"):
        with pytest.raises(OutputError, match="which is read"):
            export(result=Path("estimate"), out=Path(mine), force=True)
    assert (made / "log.zarr" / "zarr.json").is_file() and "<mujoco" in (made / "model.xml").read_text()


def test_no_output_is_a_file_in_what_is_read(made):
    files = {path: path.read_bytes() for path in (Path("estimate/estimate.json"), Path("log.zarr/zarr.json"))}
    for mine in files:
        with pytest.raises(OutputError, match=r"--out .* is a file of .*, which is read"):
            propose(result=Path("estimate"), out=mine)
        with pytest.raises(OutputError, match=r"--truth .* is a file of .*, which is read"):
            record(task="task.toml", out=Path("n.zarr"), truth=mine, inputs_from=mine.parent, force=True)
    with pytest.raises(OutputError, match=r"--out .*estimate\.json is a file of estimate, which is read"):
        export(result=Path("estimate"), out=Path("estimate/estimate.json"), force=True)
    assert all(path.read_bytes() == content for path, content in files.items())


@pytest.mark.parametrize("folder", ["estimate", "log.zarr/data", "log.zarr/new"])
def test_no_output_is_new_inside_what_is_read(made, folder):
    before = sha256(Path("log.zarr")), sha256(Path("estimate"))
    out, options = Path(folder, "x"), {"task": "task.toml", "threads": 1, "quiet": True}
    with pytest.raises(OutputError, match=r"lies inside (estimate|log\.zarr), which is read") as caught:
        diagnose_stage.diagnose(
            real_log=Path("log.zarr"), estimate=Path("estimate"), out=out, threads=1, quiet=True
        )
    assert "another --out" in caught.value.cure
    if folder == "estimate":
        with pytest.raises(OutputError, match="lies inside estimate"):
            export(result=Path("estimate"), out=out)
    else:
        with pytest.raises(OutputError, match=r"lies inside log\.zarr"):
            identify_stage.identify(real_log=Path("log.zarr"), out=out, **options)
        with pytest.raises(OutputError, match=r"--truth .*lies inside log\.zarr"):
            record(task="task.toml", out=Path("n.zarr"), truth=out, inputs_from=Path("log.zarr"), threads=1)
    assert (sha256(Path("log.zarr")), sha256(Path("estimate"))) == before


def test_an_output_may_lie_beside_the_task_and_its_model(made):
    """Files are read there, not the folder."""
    beside = made / "results" / "m.xml"
    export(result=Path("estimate"), out=beside)
    assert beside.is_file()


def test_no_output_is_a_file_of_the_task(made):
    parts = Path("parts")
    parts.mkdir()
    (made / "model.xml").rename(parts / "model.xml")
    (parts / "provenance.json").write_text("{}")  # as in an output, which --force replaces
    edit(made / "task.toml", "model.xml", "parts/model.xml")
    files = {path: path.read_bytes() for path in (Path("task.toml"), parts / "model.xml")}
    recorded = {"duration": 1.5, "force": True, "threads": 1}
    for mine in files:
        with pytest.raises(OutputError, match=r"--truth .*which is read"):
            record(task="task.toml", out=Path("new.zarr"), truth=mine, **recorded)
        with pytest.raises(OutputError, match="which is read"):
            propose(result=Path("estimate"), out=mine)
    proposal = Path("proposal.json")
    proposal.write_text("{}")
    with pytest.raises(OutputError, match=r"--truth .*which is read"):
        record(task="scooping", out=Path("new.zarr"), truth=proposal, actions_from=proposal, force=True)
    with pytest.raises(OutputError, match=r"--out .*which is read"):
        record(task="task.toml", out=parts, **recorded)
    with pytest.raises(OutputError, match="which is read"):
        import_log(files=[Path("log.zarr")], task="task.toml", out=parts, force=True)
    with pytest.raises(OutputError, match="which is read"):
        gen_histories(task="task.toml", out=parts, pairs=2, force=True)
    assert all(path.read_bytes() == content for path, content in files.items())
    assert not Path("new.zarr").exists()


def test_recordings_that_fit_alone_do_not_explain_what_is_held_out(made):
    """Monday's mass is not Tuesday's: the fit to one is no explanation of the other."""
    for name, mass in (("monday", 1.2), ("tuesday", 2.4)):
        record(
            task="task.toml",
            out=Path(f"{name}.zarr"),
            parameters={"mass": mass, "damping": 4.0, "stiffness": 60.0},
            noise=5e-4,
            episodes=2,
            duration=1.5,
            rate=250.0,
            threads=1,
        )
    import_log(files=[Path("monday.zarr"), Path("tuesday.zarr")], task="task.toml", out=Path("both.zarr"))
    log = MeasuredLog.read(Path("both.zarr"))
    held = log.recording_names[-1]
    found = identify_stage.identify(
        real_log=Path("both.zarr"), task="task.toml", out=Path("e"), test=held, threads=1, quiet=True
    ).document
    assert found["lack_of_fit"]["normalized"] < 1.1 < 1.4 < found["error"]["test"]["normalized"]
    assert found["verdict"] == "unexplained"
    assert "not what was held out" in found["summary"]


def test_a_log_is_not_read_by_a_task_of_other_scales(made):
    log, task = MeasuredLog.read(Path("log.zarr")), load_task("task.toml")
    columns = ["t_s", "episode", *(c.column for c in (*task.inputs, *task.outputs))]
    table = np.column_stack([log.time, np.zeros(len(log.time)), log.inputs, log.outputs])[log.episodes[0]]
    np.savetxt("run.csv", table, delimiter=",", header=",".join(columns), comments="")
    import_log(files=[Path("run.csv")], task="task.toml", out=Path("run.zarr"))
    column = f'column = "{task.outputs[0].column}"'
    sound = (made / "task.toml").read_text()
    edit(made / "task.toml", 'time = "t_s"', 'time = "t_s"\ntime_scale = 1e-3')
    with pytest.raises(LogError, match=r"was imported as 1 s a unit.*now says 0\.001") as caught:
        identify_stage.identify(
            real_log=Path("run.zarr"), task="task.toml", out=Path("e"), threads=1, quiet=True
        )
    assert "import it again" in caught.value.cure
    (made / "task.toml").write_text(sound)
    edit(made / "task.toml", column, f"{column}\nscale = 0.5")
    with pytest.raises(LogError, match="was imported as 1 \\*") as caught:
        identify_stage.identify(
            real_log=Path("run.zarr"), task="task.toml", out=Path("e"), threads=1, quiet=True
        )
    assert "import it again" in caught.value.cure


def test_joints_that_nothing_measures_are_named_where_all_diverges(made):
    task = load_task("task.toml")
    assert "measure" not in all_diverged(task).cure
    assert "capture inspect" in all_diverged(task).cure
    blind = copy(task)
    blind.outputs = ()
    joints = [task.model.joint(j).name for j in range(task.model.njnt)]
    assert f"measure the position of {', '.join(joints)}" in all_diverged(blind).cure
