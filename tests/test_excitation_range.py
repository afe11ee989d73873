"""What a log shows of how far a machine went, and that what is proposed stays near it unless told otherwise."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from setting_numbers import set_numbers

from capture_cli.cli import main
from capture_cli.model.tasks import load_task
from capture_cli.model.tasks.base import Task
from capture_cli.select.experiment.excitation_range import SETTINGS as EXCITATION_RANGE
from capture_cli.select.experiment.excitation_range import ExcitationRange, Quantities
from capture_cli.stages.identify import identify
from capture_cli.stages.propose import propose
from capture_cli.stages.record import record

SD = 1e-3  # m, of the noise


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def stopped(slider_task: Path) -> Task:
    """The slider, that ends at stops."""
    model = slider_task.parent / "model.xml"
    edit(model, 'type="slide"', 'type="slide" limited="true" range="-1 3"')
    return load_task(str(slider_task))


def shown_by(task: Task, position: np.ndarray, **other) -> ExcitationRange:
    """Of a position (step,), in steps of 10 ms and two windows."""
    steps = {"time": 0.01 * np.arange(len(position)), "window": np.repeat([0, 1], len(position) // 2)}
    measured = {"measured": position[:, None], "simulated": position[:, None]}
    return ExcitationRange.of(task, np.array([SD]), **{**steps, **measured, **other})


@pytest.mark.filterwarnings("error")
def test_what_is_near_is_what_the_log_shows_half_as_far_again(slider_task):
    """Rates are of a window each, and of what was simulated alone where that is what was measured."""
    task = stopped(slider_task)
    told = Quantities.of(task)
    assert told.names == ("q", "rate of q", "joint x") and told.units == ("m", "m/s", "m")
    position = np.concatenate([np.linspace(0, 0.2, 21)[:20], np.linspace(-0.1, -0.1, 20)])
    ran_away = position.copy()
    ran_away[30:] = 1e6
    for simulated in (position, ran_away):
        shown = shown_by(task, position, simulated=simulated[:, None])
        assert shown.log[:2] == pytest.approx(np.array([[-0.1, 0.19], [0.0, 1.0]]))
        assert np.isnan(shown.log[2]).all()
        span = EXCITATION_RANGE.margin * 0.29 + 3 * SD
        expected = [
            [-0.1 - span, 0.19 + span],
            [-EXCITATION_RANGE.margin, 1 + EXCITATION_RANGE.margin],
            [-1 - 4 * EXCITATION_RANGE.stop_gives, 3 + 4 * EXCITATION_RANGE.stop_gives],
        ]
        assert shown.near == pytest.approx(np.array(expected))
    nowhere = np.where(np.arange(40) < 30, position, np.inf)[:, None]
    again = 0.01 * (
        np.arange(40) - (np.arange(40) >= 20)
    )  # a window begins at the time at which another ended
    assert shown_by(task, position, simulated=nowhere, time=again).log[1] == pytest.approx([0.0, 1.0])
    missing = np.where(np.arange(40) % 2, position, np.nan)
    assert shown_by(task, missing).log[1] == pytest.approx([0.0, 1.0])


def test_a_velocity_that_is_measured_is_no_rate(slider_task):
    model = slider_task.parent / "model.xml"
    edit(model, "</sensor>", '<jointvel name="v" joint="x"/></sensor>')
    slider_task.write_text(slider_task.read_text() + '\n[outputs.v]\ncolumn = "v"\nunit = "m/s"\n')
    assert Quantities.of(load_task(str(slider_task))).names == ("q", "v")


def test_of_a_velocity_that_is_measured_along_one_axis_the_others_are_rates(tmp_path):
    """A camera from above, and a flow sensor that looks ahead."""
    (tmp_path / "model.xml").write_text(
        '<mujoco><worldbody><body name="b"><freejoint/><geom size=".1"/></body></worldbody><sensor>'
        '<framepos name="at" objtype="body" objname="b"/><framelinvel name="v" objtype="body" objname="b"/>'
        "</sensor></mujoco>"
    )
    (tmp_path / "task.toml").write_text(
        'format = 1\nname = "craft"\nmodel = "model.xml"\n'
        '[outputs.at]\ncolumn = ["x", "y", ""]\nunit = "m"\n[outputs.v]\ncolumn = ["vx", "", ""]\nunit = "m/s"\n'
    )
    told = Quantities.of(load_task(str(tmp_path / "task.toml")))
    assert told.names == ("at_x", "at_y", "v_x", "rate of at_y")


def test_how_far_what_is_predicted_goes_beyond(slider_task):
    task = stopped(slider_task)
    shown = shown_by(task, np.linspace(-1.0, 1.0, 40))
    path = np.linspace(0, 1, 101)
    outputs = np.stack([path, 3 * path, 4 * path])[..., None]
    predicted = shown.predicted(outputs, outputs, 0.1)
    excess = shown.excess(predicted)
    low, high = shown.near[0]
    assert excess[0].tolist() == [0, 0, 0]
    assert excess[1] == pytest.approx([(3 - high) / (high - low), 0, 0])
    assert excess[2, 2] == pytest.approx(
        (1 - 4 * EXCITATION_RANGE.stop_gives) / (4 * (1 + 2 * EXCITATION_RANGE.stop_gives))
    )
    assert shown.nearest(predicted, np.ones(3, bool)).tolist() == [True, False, False]
    assert shown.nearest(predicted, np.array([False, True, True])).tolist() == [False, True, False]
    assert shown.where_to(predicted, 2, "none stays").endswith("take q to 4 m (log -1 to 1)")
    judged = shown.judged(predicted, 1)
    assert not judged["is_near"] and judged["predicted"]["q"]["range"] == [0, 3]
    assert judged["predicted"]["joint x"]["log"] is None and judged["predicted"]["joint x"]["is_near"]
    again = ExcitationRange.from_document(task, json.loads(json.dumps(judged["predicted"])))
    assert again.near == pytest.approx(shown.near) and again.judged(predicted, 2) == shown.judged(
        predicted, 2
    )


def test_where_a_machine_is_put_it_may_be(slider_task):
    """It begins far from all that the log shows, and may go from there to that, but no further."""
    task = load_task(str(slider_task))
    shown = shown_by(task, np.linspace(4.0, 6.0, 40))
    outputs = np.linspace(0, [5.0, 8.0], 4001).T[..., None]
    assert shown.excess(shown.predicted(outputs, outputs, 0.01))[:, 0].astype(bool).tolist() == [False, True]


@pytest.fixture
def light(slider_task, tmp_path, without_pages) -> Path:
    """The estimate of a slider without a spring, that was shaken fast by forces which would push it far if slow."""
    options = {"task": str(slider_task), "threads": 1, "noise": SD}
    record(out=tmp_path / "s.zarr", duration=4, amplitude={"drive": 20}, band=(4, 8), rate=200, **options)
    identify(real_log=tmp_path / "s.zarr", out=tmp_path / "e", task=str(slider_task), threads=1, quiet=True)
    return tmp_path / "e"


def test_what_is_proposed_takes_the_machine_no_further_than_it_is_known_to_go(light, slider_task, tmp_path):
    proposal = propose(result=light, threads=1)
    assert proposal["is_near"] and "predicted to stay near what the log shows" in proposal["text"]
    row = proposal["predicted"]["q"]
    (tmp_path / "p.json").write_text(json.dumps(proposal))
    run = record(
        task=str(slider_task), out=tmp_path / "n.zarr", inputs_from=tmp_path / "p.json", threads=1
    ).log
    assert [run.outputs.min(), run.outputs.max()] == pytest.approx(row["range"], rel=0.1, abs=0.01)
    span = row["log"][1] - row["log"][0]
    assert row["near"] == pytest.approx(
        [row["log"][0] - span / 2, row["log"][1] + span / 2], abs=0.02 * span + 4 * SD
    )
    farther = propose(result=light, beyond_log=True, threads=1)
    assert not farther["is_near"]
    assert np.ptp(farther["predicted"]["q"]["range"]) > 1.5 * np.ptp(row["near"])
    assert farther["information"] > proposal["information"]
    assert "it does not stay near what the log shows: it would take " in farther["text"]


def test_where_nothing_stays_near_the_mildest_is_proposed_and_said_to_be_that(light, monkeypatch):
    set_numbers(monkeypatch, "capture_cli.stages.propose", "NEXT_EXPERIMENT", shares=(1.0, 0.9))
    proposal = propose(result=light, amplitude={"drive": 1e4}, threads=1)
    assert not proposal["is_near"]
    assert proposal["text"].startswith("the mildest of 8 multisines from rest")
    assert "none that was tried stays near what the log shows: it would take" in proposal["text"]


def test_the_ranges_are_printed_beside_what_the_log_shows(light, tmp_path, capsys, monkeypatch):
    words = ["capture", "propose", str(light), "--beyond-log", "--out", str(tmp_path / "p.json")]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit, match=r"^0$"):
        main()
    said = capsys.readouterr().err.splitlines()
    assert said[1] == "predicted of the identified model, open loop, and in the log:"
    assert [line.split()[0] for line in said[2:]] == ["q", "rate"]
    assert " m  (log " in said[2] and said[2].endswith("beyond")
