"""Health of logs: every planted fault is found where it was put, a sound log has none, damage is reported."""

from __future__ import annotations

import io
import json
import re
import shutil
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import toy_rounds
from episodes_of import episodes_of
from inspecting import as_inspection, inspect
from rich.console import Console

from capture_cli.context.checkpoints.training_state import save_state
from capture_cli.errors import StoreError, TaskError
from capture_cli.log.checks.log_health import channel, excitation, quantisation, spikes, timing
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.report.inspection import render
from capture_cli.stages.import_log import import_log
from capture_cli.store.output import unfinished
from capture_cli.store.provenance import Provenance, write_json

STEPS, RATE = 1000, 100.0
REPOSITORY = Path(__file__).resolve().parents[1]


def sound_log() -> MeasuredLog:
    """Two recordings of one episode: an input of three frequencies, an output that follows it, and noise."""
    noise = np.random.default_rng(0)
    time = np.arange(STEPS) / RATE
    drive = (
        np.sin(2 * np.pi * 0.7 * time)
        + 0.6 * np.sin(2 * np.pi * 3.1 * time)
        + 0.4 * np.sin(2 * np.pi * 8 * time)
    )
    q = 0.1 * np.cumsum(drive) / RATE + 1e-4 * noise.standard_normal(STEPS)
    return MeasuredLog(
        task="slider",
        time=np.tile(time, 2),
        inputs=np.tile(drive, 2)[:, None],
        outputs=np.concatenate([q, q + 1e-4 * noise.standard_normal(STEPS)])[:, None],
        episode_ends=np.array([STEPS, 2 * STEPS]),
        recording=np.array([0, 1]),
        input_names=("drive",),
        input_units=("N",),
        output_names=("q",),
        output_units=("m",),
        recordings=(
            {"name": "a", "source": "a.csv", "sha256": ""},
            {"name": "b", "source": "b.csv", "sha256": ""},
        ),
    )


def changed(log: MeasuredLog, **arrays) -> MeasuredLog:
    """The log with copies of arrays changed in place by functions."""
    copies = {name: getattr(log, name).copy() for name in arrays}
    for name, change in arrays.items():
        change(copies[name])
    return replace(log, **copies)


def inspected(log: MeasuredLog, folder: Path, task: Path | None = None) -> dict:
    """The inspection of `log`, which must be JSON, and must render."""
    log.write(folder / "log.zarr")
    document = inspect(folder / "log.zarr", None if task is None else str(task))
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert shown(document)
    return document


def shown(document: dict, width: int = 100) -> str:
    console = Console(file=io.StringIO(), width=width)
    render(as_inspection(document), console)
    return console.file.getvalue()


def only(document: dict) -> dict:
    assert len(document["findings"]) == 1, document["findings"]
    return document["findings"][0]


# --- a sound log ---


def test_a_sound_log_has_no_findings_and_true_numbers(tmp_path, slider_task):
    document = inspected(sound_log(), tmp_path, slider_task)
    assert document["findings"] == []
    assert document["kind"] == "measured-log"
    assert document["store"]["format"] == "capture/measured-log"
    assert document["store"]["version"] == 1
    assert document["sizes"] == {"recordings": 2, "episodes": 2, "steps": 2000, "inputs": 1, "outputs": 1}
    episode = document["episodes"][1]
    assert episode["recording"] == "b"
    assert episode["rate"] == pytest.approx(RATE)
    assert episode["duration"] == pytest.approx(9.99)
    assert episode["jitter_sd"] == pytest.approx(0.0, abs=1e-9)
    drive = document["channels"][0]
    assert drive["rms"] == pytest.approx(np.sqrt((1 + 0.36 + 0.16) / 2), rel=0.01)
    assert drive["excitation"]["median_frequency"] == pytest.approx(0.7, abs=0.2)
    assert drive["excitation"]["frequency_95"] == pytest.approx(8.0, abs=0.2)
    assert sum(b["share"] for b in drive["excitation"]["bands"]) == pytest.approx(1.0)
    assert "nothing wrong was found" in shown(document)


def test_real_logs_import_without_errors(tmp_path, slider_task, real_data):
    slider_task.write_text(slider_task.read_text().replace('column = "u_N"', 'column = "u_V"'))
    model = slider_task.parent / "model.xml"
    model.write_text(model.read_text().replace('timestep="0.002"', 'timestep="0.001"'))
    import_log(
        files=sorted((real_data / "emps").glob("*.csv")), task=str(slider_task), out=tmp_path / "emps.zarr"
    )
    document = inspect(tmp_path / "emps.zarr", str(slider_task))
    assert [f for f in document["findings"] if f["severity"] != "note"] == []
    assert document["recordings"][0]["rate"] == pytest.approx(1000, rel=1e-3)
    assert document["provenance"]["command"] == "import-log"


def test_the_servos_encoder_is_recognised(tmp_path, slider_task, real_data):
    text = slider_task.read_text().replace('column = "u_N"', 'column = "duty"').replace('"q_m"', '"q_rad"')
    slider_task.write_text(text)
    file = real_data / "bam_xl330" / "xl330_kp400_lift_and_drop.csv"
    import_log(files=[file], task=str(slider_task), out=tmp_path / "servo.zarr")
    q = inspect(tmp_path / "servo.zarr")["channels"][1]
    assert q["quantisation"]["step"] == pytest.approx(2 * np.pi / 4096, rel=1e-4)


# --- planted faults ---


def set_to(index, value):
    def change(array):
        array[index] = value

    return change


def test_missing_values_are_found_and_the_log_still_described(tmp_path, slider_task):
    log = changed(sound_log(), outputs=set_to([5, 1500], np.nan), inputs=set_to(7, np.inf))
    document = inspected(log, tmp_path, slider_task)
    assert [(f["severity"], f["where"]) for f in document["findings"]] == [
        ("error", "input drive"),
        ("error", "output q"),
    ]
    assert (
        "2 values are NaN, infinite or beyond 1e+15: step 5, step 1500" in document["findings"][1]["message"]
    )
    assert "--drop-nan" in document["findings"][1]["cure"]
    assert document["channels"][1]["nan"] == 2
    assert document["channels"][1]["rms"] > 0


def test_a_channel_without_one_good_value_is_survived(tmp_path):
    document = inspected(changed(sound_log(), inputs=set_to(slice(None), np.nan)), tmp_path)
    assert only(document)["severity"] == "error"
    assert document["channels"][0]["low"] is None


@pytest.mark.parametrize(
    ("large", "said"),
    [
        ([(5, 1e300), (9, -1e16)], "2 values are NaN, infinite or beyond 1e+15: step 5, step 9"),
        ([(slice(None), 1e300)], "values are NaN, infinite or beyond 1e+15: step 0"),
    ],
)
def test_values_that_are_too_large_to_be_measured_are_found_without_a_warning(tmp_path, large, said):
    log = changed(sound_log(), outputs=lambda v: [set_to(where, x)(v) for where, x in large])
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        document = inspected(log, tmp_path)
    found = only(document)
    assert found["severity"] == "error"
    assert said in found["message"]


def test_backward_and_repeated_times_are_found(tmp_path):
    log = changed(sound_log(), time=lambda t: (set_to(1200, t[1199])(t), set_to(300, 0.5)(t)))
    findings = inspected(log, tmp_path)["findings"]
    assert [(f["severity"], f["where"]) for f in findings] == [
        ("error", "a, episode 0"),
        ("error", "b, episode 1"),
    ]
    assert "time goes back in 1 place: after 2.99 s (step 299)" in findings[0]["message"]
    assert "time stands still in 1 place: after 1.99 s (step 199)" in findings[1]["message"]


def test_times_that_are_not_numbers_are_found(tmp_path):
    document = inspected(changed(sound_log(), time=set_to([3, 4], [np.nan, np.inf])), tmp_path)
    assert only(document)["message"] == "2 times are NaN or infinite"


def test_gaps_are_found_with_their_place(tmp_path):
    def pause(t):
        t[400:1000] += 0.8

    finding = only(inspected(changed(sound_log(), time=pause), tmp_path))
    assert finding["severity"] == "warning"
    assert finding["message"] == "1 gap in the sampling: 0.81 s after 3.99 s"


def test_uneven_sampling_is_noted(tmp_path):
    log = sound_log()
    time = log.time + np.random.default_rng(1).uniform(-0.4, 0.4, 2 * STEPS) / RATE
    there = [np.interp(time[e], log.time[e], log.outputs[e, 0]) for e in log.episodes]
    finding = only(inspected(replace(log, time=time, outputs=np.concatenate(there)[:, None]), tmp_path))
    assert finding["severity"] == "note"
    assert "uneven" in finding["message"]
    finding = only(inspected(replace(log, time=time), tmp_path))
    assert finding["severity"] == "warning"
    assert "time stamps jitter" in finding["message"]


@pytest.mark.parametrize(("channel_name", "severity"), [("inputs", "warning"), ("outputs", "error")])
def test_constant_channels_are_found(tmp_path, channel_name, severity):
    finding = only(inspected(changed(sound_log(), **{channel_name: set_to(slice(None), 2.5)}), tmp_path))
    assert finding["severity"] == severity
    assert "never changes: always 2.5" in finding["message"]


def test_a_sensor_dead_in_one_episode_is_found(tmp_path):
    finding = only(inspected(changed(sound_log(), outputs=set_to(slice(STEPS, None), 0.1)), tmp_path))
    assert (finding["severity"], finding["where"]) == ("warning", "output q")
    assert "in 1 of 2 episodes: 1" in finding["message"]


def test_a_saturated_input_is_found_and_a_switched_one_is_not(tmp_path):
    clipped = replace(sound_log(), inputs=np.clip(sound_log().inputs, -1.0, 2.0))
    finding = only(inspected(clipped, tmp_path))
    assert (finding["severity"], finding["where"]) == ("warning", "input drive")
    assert "at exactly -1 N" in finding["message"]
    switched = replace(sound_log(), inputs=np.sign(sound_log().inputs))
    assert inspected(switched, tmp_path)["findings"] == []


def test_a_clipped_output_is_found(tmp_path):
    low = np.quantile(sound_log().outputs, 0.2)
    finding = only(inspected(replace(sound_log(), outputs=np.maximum(sound_log().outputs, low)), tmp_path))
    assert (finding["severity"], finding["where"]) == ("warning", "output q")


def test_a_coarse_sensor_is_noted_with_its_step(tmp_path):
    step = 0.004
    coarse = replace(sound_log(), outputs=step * np.round(sound_log().outputs / step))
    document = inspected(coarse, tmp_path)
    assert document["channels"][1]["quantisation"]["step"] == pytest.approx(step)
    assert only(document)["severity"] == "note"
    assert re.search(r"steps of 0\.004 m *\n", shown(document))
    (tmp_path / "bare").mkdir()
    bare = inspected(replace(coarse, output_units=("1",)), tmp_path / "bare")
    assert re.search(r"steps of 0\.004 *\n", shown(bare))
    assert "in steps of 0.004 (sd" in only(bare)["message"]


def test_single_samples_that_stand_out_are_found(tmp_path):
    log = changed(sound_log(), outputs=set_to([50, 700, 1500], [[3.0], [-8.0], [0.5]]))
    finding = only(inspected(log, tmp_path))
    assert finding["message"].startswith("3 single samples stand out, by up to 8")
    assert finding["message"].endswith("step 50, step 700, step 1500")
    assert "sparse = true" in finding["cure"] and "--drop-nan" not in finding["cure"]


@pytest.mark.parametrize("step", [0, 1, 998, 999, 1000, 1998, 1999])
def test_an_end_of_an_episode_that_stands_out_is_found(tmp_path, slider_task, step):
    """As of a line that was cut off in mid-number; of a task that is not known nothing is said."""
    log = changed(sound_log(), outputs=lambda q: q.__setitem__((step, 0), q[step, 0] - 0.05))
    finding = only(inspected(log, tmp_path, slider_task))
    assert finding["message"].startswith("1 single sample stands out, by up to 0.0")
    assert finding["message"].endswith(f"step {step} (1 of them at an end of an episode)")
    assert finding["cure"].startswith("remove these rows from the source")
    assert inspect(tmp_path / "log.zarr")["findings"] == []


def test_what_may_jump_at_an_end_of_an_episode_is_no_spike(tmp_path, slider_task):
    """A step at once at the switch of a motor, a bounce in the last sample, and a sample after a gap."""
    time = np.arange(300) / 100
    starts, ends = np.sin(time) + (time > 0), np.abs(np.sin(time[::-1] - 0.005))
    assert spikes(starts, time, [slice(0, 300)], ("last",))["count"] == 0
    assert spikes(starts, time, [slice(0, 300)], ("first",))["first"] == [0]
    assert spikes(ends, time, [slice(0, 300)], ("first", "last"))["count"] == 0
    late = np.append(time[:-1], 8.0)
    assert spikes(np.sin(late), late, [slice(0, 300)], ("first", "last"))["count"] == 0
    model = slider_task.parent / "model.xml"
    for sensor, count in (("jointvel", 1), ("jointactuatorfrc", 0)):
        model.write_text(model.read_text().replace("jointpos", "jointvel").replace("jointvel", sensor))
        text = slider_task.read_text().replace('unit = "m"', 'unit = "1"')
        slider_task.write_text(text)
        log = changed(sound_log(), outputs=set_to([0, 1999], [[3.0], [3.0]]))
        found = inspected(replace(log, output_units=("1",)), tmp_path, slider_task)["channels"][1]["spikes"]
        assert (found["count"], found["ends"]) == (count, count)
        shutil.rmtree(tmp_path / "log.zarr")


def test_where_bodies_can_touch_a_single_sample_may_be_an_impact(tmp_path, slider_task):
    log = changed(sound_log(), outputs=set_to(50, 3.0))
    assert "hit" not in only(inspected(log, tmp_path, slider_task))["cure"]
    model = slider_task.parent / "model.xml"
    floor = '<worldbody><geom type="plane" size="1 1 1" pos="0 0 -1"/>'
    model.write_text(model.read_text().replace("<worldbody>", floor))
    assert (
        "keep them where bodies hit each other"
        in only(inspect(tmp_path / "log.zarr", str(slider_task)))["cure"]
    )


@pytest.mark.parametrize("kind", ["steps", "bounces", "counts", "uneven"])
def test_fast_motions_are_no_spikes(kind):
    generator = np.random.default_rng(4)
    time = np.arange(600) / 100
    if kind == "uneven":
        time = np.sort(generator.uniform(0, 6, 600))
    values = {
        "steps": (time % 1 > 0.5).astype(float),
        "bounces": np.abs(np.sin(4 * time)),
        "counts": np.round(100 * np.sin(time) + 0.3 * generator.standard_normal(600)) / 100,
        "uneven": np.sin(12 * time) + 1e-4 * generator.standard_normal(600),
    }[kind]
    assert spikes(values, time, [slice(0, 300), slice(300, 600)], ("first", "last"))["count"] == 0


def test_an_input_of_one_frequency_is_found(tmp_path):
    sine = replace(sound_log(), inputs=np.sin(2 * np.pi * 1.3 * sound_log().time)[:, None])
    finding = only(inspected(sine, tmp_path))
    assert finding["message"] == "changes at a single frequency, 1.3 Hz"


@pytest.mark.parametrize("shape", ["step", "noise", "sweep"])
def test_rich_inputs_are_not_taken_for_one_frequency(shape):
    time = np.arange(STEPS) / RATE
    values = {
        "step": (time > 4).astype(float),
        "noise": np.random.default_rng(0).standard_normal(STEPS),
        "sweep": np.sin(2 * np.pi * (0.2 + 0.5 * time) * time),
    }[shape]
    assert excitation(values, time, [slice(0, STEPS)])["single_frequency"] is None


def test_a_few_slow_sines_in_short_episodes_are_not_taken_for_one_frequency():
    generator = np.random.default_rng(3)
    time = np.arange(400) / 100
    for _ in range(20):
        frequency, phase = generator.uniform(0.1, 1.5, 5), generator.uniform(0, 2 * np.pi, 5)
        values = np.sin(2 * np.pi * frequency * time[:, None] + phase).sum(axis=1)
        assert excitation(values, time, [slice(0, 400)])["single_frequency"] is None


@pytest.mark.parametrize("slow", [1.0, 0.3])
def test_slow_sines_beside_fast_ones_are_not_taken_for_one_frequency(slow):
    """Changes weigh sines by the square of their frequency: those at 1.67 and 1.74 Hz alone showed in them."""
    time = np.arange(500) / 100
    fast, other = np.array([1.67, 1.74]), np.array([0.2, 0.26])
    for phase in range(6):
        values = np.sin(2 * np.pi * fast * time[:, None] + phase).sum(axis=1)
        assert excitation(values, time, [slice(0, 500)])["single_frequency"] == pytest.approx(1.7, abs=0.15)
        values += slow * np.sin(2 * np.pi * other * time[:, None] + 2 * phase).sum(axis=1)
        assert excitation(values, time, [slice(0, 500)])["single_frequency"] is None


def test_an_input_mostly_at_rest_is_noted(tmp_path):
    finding = only(inspected(changed(sound_log(), inputs=set_to(slice(100, 1400), 0.0)), tmp_path))
    assert finding["severity"] == "note"
    assert "for 66 % of the samples" in finding["message"]


# --- against a task ---


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (dict(input_names=("motor",)), "the log has (motor); task 'slider' has (drive)"),
        (dict(output_units=("mm",)), "the log has it in 'mm', task 'slider' in 'm'"),
        (dict(task="cart"), "made for the task 'cart'"),
    ],
)
def test_a_log_of_another_task_is_found(tmp_path, slider_task, change, words):
    assert words in only(inspected(replace(sound_log(), **change), tmp_path, slider_task))["message"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "window = 0.5",
            "window = 30.0",
            ("the longest lasts 9.99 s, and a window 30 s", "set `window = 2` under [log]"),
        ),
        (
            "window = 0.5",
            "window = 0.02",
            ("a window of 0.02 s holds 2 samples", "set a longer [log] window"),
        ),
    ],
)
def test_windows_that_do_not_suit_the_log_are_found(tmp_path, slider_task, old, new, words):
    slider_task.write_text(slider_task.read_text().replace(old, new))
    finding = only(inspected(sound_log(), tmp_path, slider_task))
    assert words[0] in finding["message"] and finding["cure"].startswith(words[1])
    assert "time_scale" not in finding["cure"]


@pytest.mark.parametrize(
    ("interval", "unit", "scale"), [(5.0, "ms", "1e-3"), (5e3, "us", "1e-6"), (4e6, "ns", "1e-9")]
)
def test_the_unit_that_times_seem_to_be_in_is_named(tmp_path, slider_task, interval, unit, scale):
    log = sound_log()
    coarse = replace(log, time=log.time * RATE * interval)
    (found,) = [f for f in inspected(coarse, tmp_path, slider_task)["findings"] if "holds" in f["message"]]
    assert f"if the time column is in {unit}, write time_scale = {scale} under [log]" in found["cure"]


@pytest.mark.parametrize(
    ("low", "high", "nominal", "said"),
    [
        ("0.1", "2000", "1.0", "its bounds, 0.1 to 2000 kg, span 2000 times its nominal value, 1.00 kg"),
        ("0.1", "500", "1.0", None),
        ("0.0", "2000", "0.0", None),  # says no size
    ],
)
def test_bounds_that_are_far_too_wide_are_found(tmp_path, slider_task, low, high, nominal, said):
    text = slider_task.read_text()
    bounds = re.search(r"(\[parameters\.mass\][\s\S]*?)low = .*\nhigh = .*\n", text)
    wide = f"{bounds[1]}low = {low}\nhigh = {high}\nnominal = {nominal}\n"
    slider_task.write_text(text.replace(bounds[0], wide))
    document = inspected(sound_log(), tmp_path, slider_task)
    if said is None:
        assert not document["findings"]
        return
    found = only(document)
    assert (found["severity"], found["where"]) == ("warning", "parameter mass")
    assert found["message"].startswith(said)
    assert "slopes over 0.0001 of the range, 0.20 kg" in found["message"]
    assert "[parameters.mass] bounds" in found["cure"]


def test_a_heading_that_begins_anew_after_a_turn_is_found(tmp_path, slider_task):
    model = slider_task.parent / "model.xml"
    sound = sound_log()
    turning = 1.2 * np.tile(np.arange(STEPS) / RATE, 2)[:, None]
    turning[STEPS:] += 0.01
    wrapped = (turning + np.pi) % (2 * np.pi) - np.pi
    slides = inspected(replace(sound, outputs=wrapped), tmp_path / "slide", slider_task)
    assert not any("turn" in f["message"] for f in slides["findings"])
    model.write_text(model.read_text().replace('type="slide"', 'type="hinge"'))
    assert inspected(replace(sound, outputs=turning), tmp_path / "whole", slider_task)["findings"] == []
    found = inspected(replace(sound, outputs=wrapped), tmp_path / "wrapped", slider_task)["findings"]
    (turn,) = [f for f in found if "whole turn" in f["message"]]
    assert turn["severity"] == "warning" and "period = 6.28319" in turn["cure"]
    assert "in 4 places" in turn["message"]


@pytest.mark.parametrize(
    ("old", "new", "where", "key"),
    [
        ('"q_m"', '"q_mm"', "output q", 'column_unit = "mm"'),
        ('"q_m"', '"q_mm"\nscale = 0.001', None, None),
        ('"q_m"', '"q_mm"\ncolumn_unit = "mm"', None, None),
        ('"t_s"', '"t_ms"', "time", "time_scale = 0.001"),
        ('"t_s"', '"t_ms"\ntime_scale = 0.001', None, None),
        ('"t_s"', '"t_s"\ntime_scale = 0.001', "time", "time_scale = 1"),
    ],
)
def test_a_column_named_for_another_unit_is_asked_about(tmp_path, slider_task, old, new, where, key):
    text = slider_task.read_text()
    assert old in text
    slider_task.write_text(text.replace(old, new, 1))
    found = [
        f
        for f in inspected(sound_log(), tmp_path, slider_task)["findings"]
        if "its name ends" in f["message"]
    ]
    assert [f["where"] for f in found] == ([] if where is None else [where])
    assert all(key in f["cure"] and f["severity"] == "warning" for f in found)


def hinged(slider_task: Path) -> None:
    """The slider turned into a hinge that a servo moves, and whose speed is measured too."""
    model = slider_task.parent / "model.xml"
    text = model.read_text().replace('type="slide"', 'type="hinge"').replace("<motor", '<position kp="50"')
    model.write_text(text.replace("</sensor>", '<jointvel name="w" joint="x"/></sensor>'))
    text = slider_task.read_text().replace('unit = "m"', 'unit = "rad"').replace('unit = "N"', 'unit = "rad"')
    slider_task.write_text(text.replace("[log]", '[outputs.w]\ncolumn = "w"\nunit = "rad/s"\n[log]'))


@pytest.mark.parametrize(
    ("scales", "said"),
    [
        ((1, 1, 1), []),
        ((57.3, 57.3, 57.3), []),
        ((1, 2, 1), []),
        ((1, 57.3, 57.3), ["output q in degrees, and input drive in rad"]),
        ((1, 1, 57.3), ["output w in degrees, and output q in rad"]),
        (
            (1, 57.3, 1),
            ["output q in degrees, and output w in rad", "output q in degrees, and input drive in rad"],
        ),
        ((57.3, 1, 1), ["input drive in degrees, and output q in rad"]),
    ],
)
def test_an_angle_in_degrees_beside_one_in_rad_is_found(tmp_path, slider_task, scales, said):
    hinged(slider_task)
    sound, rng = sound_log(), np.random.default_rng(0)
    time = np.tile(np.arange(STEPS) / RATE, 2)
    asked = 0.4 * np.sin(5 * time) + 0.2 * np.sin(13 * time)
    angle = 0.4 * np.sin(5 * time - 0.1) + 0.2 * np.sin(13 * time - 0.2) + 0.3
    speed = 2 * np.cos(5 * time - 0.1) + 2.6 * np.cos(13 * time - 0.2) + 0.05 * rng.standard_normal(len(time))
    drive, q, w = (s * v[:, None] for s, v in zip(scales, (asked, angle, speed), strict=True))
    log = replace(
        sound,
        inputs=drive,
        outputs=np.concatenate([q, w], axis=1),
        input_units=("rad",),
        output_names=("q", "w"),
        output_units=("rad", "rad/s"),
    )
    found = [f for f in inspected(log, tmp_path, slider_task)["findings"] if "degrees" in f["message"]]
    assert len(found) == len(said)
    for finding, words in zip(found, said, strict=True):
        assert finding["severity"] == "warning" and finding["where"] == "output q"
        assert words in finding["message"] and 'column_unit = "deg' in finding["cure"]


def test_an_angle_that_goes_against_its_servo_is_found(tmp_path, slider_task):
    hinged(slider_task)
    time = np.tile(np.arange(STEPS) / RATE, 2)
    asked, angle = 0.4 * np.sin(5 * time), 0.3 - 0.4 * np.sin(5 * time - 0.1)
    speed = -2 * np.cos(5 * time - 0.1)
    log = replace(
        sound_log(),
        inputs=asked[:, None],
        outputs=np.stack([angle, speed], axis=1),
        input_units=("rad",),
        output_names=("q", "w"),
        output_units=("rad", "rad/s"),
    )
    (found,) = (f for f in inspected(log, tmp_path, slider_task)["findings"] if "negative scale" in f["cure"])
    assert found["where"] == "output q" and "where input drive goes up" in found["message"]


@pytest.mark.parametrize(
    ("old", "new", "where", "words"),
    [
        ('timestep="0.002"', 'timestep="0.02"', "time", "the model steps by 0.02 s"),
        ('joint="x"/></actuator>', 'joint="x" ctrlrange="-1 1"/></actuator>', "input drive", "MuJoCo clips"),
        (
            'axis="1 0 0"',
            'axis="1 0 0" range="5 6"',
            "output q",
            "100.0 % of the samples lie outside the joint's range",
        ),
    ],
)
def test_models_that_do_not_suit_the_log_are_found(tmp_path, slider_task, old, new, where, words):
    model = slider_task.parent / "model.xml"
    assert old in model.read_text()
    model.write_text(model.read_text().replace(old, new))
    finding = only(inspected(sound_log(), tmp_path, slider_task))
    assert finding["where"] == where
    assert words in finding["message"]


def test_an_output_that_reads_the_column_of_an_input_is_found(tmp_path, slider_task):
    slider_task.write_text(slider_task.read_text().replace('column = "q_m"', 'column = "u_N"'))
    finding = only(inspected(sound_log(), tmp_path, slider_task))
    assert finding["where"] == "output q"
    assert "reads column 'u_N', as input drive does" in finding["message"]


def test_a_log_is_checked_against_the_task_beside_it(tmp_path, slider_task):
    beside = slider_task.parent
    slider_task.write_text(slider_task.read_text().replace("window = 0.5", "window = 30.0"))
    assert "a window 30 s" in only(inspected(sound_log(), beside))["message"]
    assert inspected(sound_log(), tmp_path)["findings"] == []
    assert inspected(replace(sound_log(), task="cart"), beside)["findings"] == []
    slider_task.write_text("not a task")
    assert inspected(sound_log(), beside)["findings"] == []


def test_a_log_of_a_built_in_task_is_checked_against_it(tmp_path):
    found = inspected(replace(sound_log(), task="air-hockey"), tmp_path)["findings"]
    assert "task 'air-hockey' has (mallet_vx" in found[0]["message"]


def test_a_control_at_the_end_of_its_range_may_be_rounded(tmp_path, slider_task):
    log = sound_log()
    peak = np.abs(log.inputs).max() * (1 - 1e-8)
    model = slider_task.parent / "model.xml"
    limited = f'joint="x" ctrlrange="-{peak:.15g} {peak:.15g}"/></actuator>'
    model.write_text(model.read_text().replace('joint="x"/></actuator>', limited))
    assert limited in model.read_text()
    assert not inspected(log, tmp_path, slider_task)["findings"]


def test_a_bad_task_is_an_error_not_a_finding(tmp_path):
    sound_log().write(tmp_path / "log.zarr")
    with pytest.raises(TaskError):
        inspect(tmp_path / "log.zarr", str(tmp_path / "nowhere.toml"))


# --- other things, and damaged ones ---


def test_a_truncated_log_is_a_finding(tmp_path):
    sound_log().write(tmp_path / "log.zarr")
    (tmp_path / "log.zarr" / "data" / "inputs" / "c" / "0" / "0").unlink()
    document = inspect(tmp_path / "log.zarr")
    assert document["kind"] == "measured-log"
    assert "it is truncated" in only(document)["message"]
    assert "truncated" in shown(document)


def test_a_log_of_another_version_is_a_finding_with_the_cure(tmp_path):
    sound_log().write(tmp_path / "log.zarr")
    metadata = tmp_path / "log.zarr" / "zarr.json"
    metadata.write_text(metadata.read_text().replace('"version": 1', '"version": 7'))
    document = inspect(tmp_path / "log.zarr")
    assert document["store"]["version"] == 7
    assert "import-log" in only(document)["cure"]


def test_an_empty_log_and_wrong_episodes_are_findings(tmp_path):
    empty = episodes_of(sound_log(), [])
    assert only(inspected(empty, tmp_path))["message"] == "it is empty"
    wrong = replace(sound_log(), episode_ends=np.array([STEPS, STEPS]))
    assert "do not divide" in only(inspected(wrong, tmp_path))["message"]


def test_dropped_rows_are_noted(tmp_path, slider_task):
    rows = [f"{0.01 * i:.2f},{np.sin(i)},{'' if i in (3, 4) else np.cos(2 * i)}" for i in range(100)]
    (tmp_path / "run.csv").write_text("\n".join(["t_s,u_N,q_m", *rows]))
    import_log(files=[tmp_path / "run.csv"], task=str(slider_task), out=tmp_path / "o.zarr", drop_nan=True)
    notes = [f["message"] for f in inspect(tmp_path / "o.zarr")["findings"] if f["where"] == "run"]
    assert notes == ["2 incomplete rows were dropped on import"]


def test_rows_dropped_for_a_slow_sensor_are_a_warning(tmp_path, slider_task):
    rows = [f"{0.01 * i:.2f},{np.sin(i)},{'' if i % 4 else np.cos(2 * i)}" for i in range(400)]
    (tmp_path / "run.csv").write_text("\n".join(["t_s,u_N,q_m", *rows]))
    import_log(files=[tmp_path / "run.csv"], task=str(slider_task), out=tmp_path / "o.zarr", drop_nan=True)
    (found,) = [f for f in inspect(tmp_path / "o.zarr")["findings"] if f["where"] == "run"]
    assert found["severity"] == "warning" and "300 of 400 rows" in found["message"]
    assert "slower" in found["cure"]


def test_a_slow_sensor_is_described_by_its_samples(tmp_path):
    log = sound_log()
    sampled = np.arange(2 * STEPS) % 4 == 1
    sampled[STEPS:] &= np.arange(STEPS) < 10
    log = replace(log, outputs=np.where(sampled[:, None], log.outputs, np.nan), sparse=frozenset({"q"}))
    log.write(tmp_path / "log.zarr")
    document = inspect(tmp_path / "log.zarr")
    found = document["channels"][1]
    assert found["sampling"] == {"samples": 253, "fewest": 3, "rate": pytest.approx(25.0)}
    assert (found["nan"], found["bad_steps"]) == (0, [])
    (finding,) = [f for f in document["findings"] if f["severity"] == "error"]
    assert "3 samples of it; 5 are needed" in finding["message"]
    whole = episodes_of(replace(log, outputs=sound_log().outputs[:, 0:1]), [0])
    spiked = changed(replace(whole, sparse=frozenset({"q"})), outputs=lambda q: q.__setitem__((401, 0), 5.0))
    spiked = replace(spiked, outputs=np.where(sampled[:STEPS, None], spiked.outputs, np.nan))
    spiked.write(tmp_path / "spiked.zarr")
    document = inspect(tmp_path / "spiked.zarr")
    assert document["channels"][1]["spikes"]["first"] == [401]  # a step of the log
    assert not [f for f in document["findings"] if f["severity"] == "error"]


def test_steps_of_sensors_at_their_own_rates_have_no_rate_of_their_own(tmp_path):
    log = episodes_of(sound_log(), [0])
    step = np.arange(STEPS)
    fast, slow = step % 3 != 1, step % 3 == 1
    outputs = np.stack(
        [np.where(fast, log.outputs[:, 0], np.nan), np.where(slow, log.outputs[:, 0], np.nan)], 1
    )
    merged = replace(
        log,
        outputs=outputs,
        output_names=("q", "r"),
        output_units=("m", "m"),
        sparse=frozenset({"q", "r"}),
        time=log.time + np.where(slow, 0.4, 0.0) * np.diff(log.time)[0],
    )
    merged.write(tmp_path / "log.zarr")
    document = inspect(tmp_path / "log.zarr")
    assert document["recordings"][0]["rate"] is None
    assert not [f for f in document["findings"] if "uneven" in f["message"]]
    rates = [c["sampling"]["rate"] for c in document["channels"][1:]]
    assert rates[0] > rates[1] > 0


def test_a_foreign_zarr_is_described(tmp_path):
    import zarr

    group = zarr.open_group(str(tmp_path / "other.zarr"), mode="w")
    group.create_array("deep/q", data=np.zeros((3, 2)))
    document = inspect(tmp_path / "other.zarr")
    assert document["kind"] == "zarr"
    assert document["arrays"] == [{"path": "deep/q", "shape": [3, 2], "dtype": "float64", "unit": None}]
    assert "deep/q" in shown(document)
    (tmp_path / "other.zarr" / "deep" / "q" / "zarr.json").write_text("{")
    assert only(inspect(tmp_path / "other.zarr"))["severity"] == "error"
    (tmp_path / "other.zarr" / "zarr.json").write_text("{")
    assert "is not JSON" in only(inspect(tmp_path / "other.zarr"))["message"]


@pytest.mark.parametrize("kind", ["estimate", "diagnosis"])
def test_result_directories_are_described(tmp_path, kind):
    parameter = {"value": 95.1, "unit": "kg", "sd": 0.1, "at_bound": False, "identifiable": True}
    log = tmp_path / "log.zarr"
    sound_log().write(log)
    result = {
        "format": f"capture/{kind}",
        "version": 1,
        "task": "slider",
        "log": {"path": str(log), "sha256": "of an earlier log"},
        "verdict": "unexplained",
        "parameters": {"mass": parameter, "gain": {**parameter, "at_bound": True}},
        "effects": [
            {
                "name": "coulomb-friction",
                "site": "x",
                "parameters": {"level": {**parameter, "value": 3.21, "high": 5.0}},
            }
        ]
        if kind == "diagnosis"
        else [],
        "expression": {
            "text": "missing force at x = -3.2 v",
            "terms": [{"site": "x: v", "coefficient": -3.2}],
        },
        "noise_floor": {"q": 1e-3},
        "lack_of_fit": {"normalized": 3.0, "autocorrelation_time": 2.0, "lacking": True},
        "rollouts": {"measured": 4},
        "rounds": [],
        "split": {"how": "1 of 4 episodes held out"},
    }
    folder = tmp_path / f"my {kind}"
    folder.mkdir()
    write_json(folder / f"{kind}.json", result)
    Provenance("identify", {}, {}).write(folder)
    document = inspect(folder)
    assert document["kind"] == kind
    assert document["result"]["verdict"] == "unexplained"
    messages = {f["where"]: f["message"] for f in document["findings"]}
    assert messages["parameter gain"] == "is at a bound"
    assert "has changed since" in messages["log"]
    cure = next(f["cure"] for f in document["findings"] if f["where"] == "verdict")
    command = f"`capture diagnose --real-log {log} --estimate '{folder}'`"
    assert (command if kind == "estimate" else "missing force at x = -3.2 v") in cure
    assert re.search(r"mass\s+95.10 kg\s+0.10 kg", shown(document))
    assert kind == "estimate" or re.search(r"coulomb-friction@x\s+level\s+3.21 kg\s+0.10 kg", shown(document))
    assert messages["report.html"] == "is missing"
    assert ("estimate.zarr does not exist" in messages.get("store", "")) == (kind == "estimate")


def the_copy_of(source: str, tmp_path: Path) -> Path:
    return Path(shutil.copytree(REPOSITORY / "runs" / source, tmp_path / "copy"))


@pytest.mark.parametrize(
    ("source", "kind", "weights", "told"),
    [
        ("sysid/scooping/capture-refined", "identifier", "identifier.safetensors", "a window of 7 rounds"),
        ("policies/scooping", "policy", "policy.safetensors", "sac"),
    ],
)
def test_checkpoints_are_described_and_their_weights_opened(tmp_path, source, kind, weights, told):
    folder = the_copy_of(source, tmp_path)
    document = inspect(folder)
    assert (document["kind"], document["task"], document["findings"]) == (kind, "scooping", [])
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert document["result"]["training"]["steps"]
    said = shown(document)
    assert "nothing wrong was found" in said
    assert told in said and "com" in said
    whole = (folder / weights).read_bytes()
    (folder / weights).write_bytes(whole[:3000])
    found = only(inspect(folder))
    assert found["severity"] == "error"
    assert f"{weights} cannot be read: it was cut short to 3000 bytes, of at least" in found["message"]
    assert "nothing wrong" not in shown(inspect(folder))
    (folder / weights).unlink()
    assert f"holds no {weights}" in only(inspect(folder))["message"]


def test_a_policy_of_ranges_that_have_changed_is_found(tmp_path):
    folder = the_copy_of("policies/scooping", tmp_path)
    settings = json.loads((folder / "policy.json").read_text())
    settings["bounds"]["parameters"][0][1] += 1.0
    (folder / "policy.json").write_text(json.dumps(settings))
    assert "was made for com between" in only(inspect(folder))["message"]


def test_files_that_a_folder_should_have_are_missed(tmp_path):
    folder = the_copy_of("sysid/scooping/capture-refined", tmp_path)
    (folder / "loss.png").write_bytes(b"")
    (folder / "provenance.json").unlink()
    found = {f["where"]: (f["severity"], f["message"]) for f in inspect(folder)["findings"]}
    assert found == {"loss.png": ("note", "is empty"), "provenance.json": ("warning", "is missing")}
    (folder / "provenance.json").write_text("[]")
    damaged = next(f for f in inspect(folder)["findings"] if f["where"] == "provenance.json")
    assert "cannot be read" in damaged["message"] and "commands look for it" in damaged["cure"]


def test_an_evaluation_is_described_and_its_arrays_read(tmp_path):
    folder = the_copy_of("evaluation/scooping", tmp_path)
    document = inspect(folder)
    assert (document["kind"], document["findings"]) == ("evaluation", [])
    assert document["sizes"]["identifiers"] == len(document["result"]["identifiers"])
    assert "trajectory difference" in shown(document)
    assert inspect(folder / "evaluation.zarr")["checked"]
    next(f for f in (folder / "evaluation.zarr" / "estimates" / "c").rglob("*") if f.is_file()).unlink()
    assert "it is truncated" in only(inspect(folder))["message"]


def test_an_unfinished_run_says_how_to_go_on(tmp_path):
    folder = unfinished(tmp_path / "id")
    folder.mkdir()
    nothing = only(inspect(folder))
    assert "an unfinished run, which has kept nothing" in nothing["message"] and "--force" in nothing["cure"]
    (folder / "metrics.jsonl").write_text("")
    assert "training, which has kept nothing" in only(inspect(folder))["message"]
    recipe = {"identifier": "capture", "task": "slider", "training": {"steps": 300}}
    counters = {"metrics": [{"step": 60, "validation_loss": 0.5}]}
    save_state(folder, counters, {"weights": np.ones(1000)}, recipe)
    for path in (folder, tmp_path / "id"):  # which is not there yet
        document = inspect(path)
        found = only(document)
        assert (document["kind"], document["result"]["command"]) == ("unfinished", "train-sysid")
        assert found["message"] == "an unfinished training, kept up to step 60 of 300"
        assert "--resume" in found["cure"]
        assert "0.5000" in shown(document)
    state = folder / "state.safetensors"
    state.write_bytes(state.read_bytes()[:-800])
    assert "was cut short" in only(inspect(folder))["message"]


def test_unfinished_histories_and_evaluations_say_how_to_go_on(tmp_path):
    import zarr

    written = Path(toy_rounds.write(toy_rounds.histories(20, rounds=3), tmp_path / "whole.zarr"))
    folder = written.rename(unfinished(tmp_path / "h.zarr"))
    zarr.open_group(str(folder), mode="r+").attrs["complete"] = False
    document = inspect(folder)
    assert (document["kind"], document["result"]["command"]) == ("unfinished", "gen-histories")
    assert re.search(r"of whose 20 histories \d+ of \d+ shards are kept", only(document)["message"])
    folder = unfinished(tmp_path / "ev")
    (folder / "parts" / "one").mkdir(parents=True)
    (folder / "recipe.json").write_text("{}")
    assert only(inspect(folder))["message"] == "an unfinished evaluation, of which 1 parts are kept"
    shutil.rmtree(folder / "parts")  # killed as it cleared up
    assert only(inspect(folder))["message"] == "an unfinished evaluation, of which 0 parts are kept"


def test_a_proposal_is_described_and_its_times_checked(tmp_path):
    proposal = {
        "format": "capture/proposal",
        "version": 1,
        "task": "slider",
        "kind": "inputs",
        "text": "the most telling of 8 multisines",
        "band_hz": [0.1, 2.0],
        "peaks": {"drive": 2.5},
        "time_s": [0.0, 0.5, 1.0],
        "inputs": {"drive": [0.0, 2.5, 0.0]},
    }
    path = tmp_path / "p.json"
    path.write_text(json.dumps(proposal))
    document = inspect(path)
    assert (document["kind"], document["findings"]) == ("proposal", [])
    assert (document["result"]["duration_s"], document["result"]["peaks"]) == (1.0, {"drive": 2.5})
    assert all(
        word in shown(document) for word in ("most telling of 8", "2.50", "0.1 to 2 Hz", "nothing wrong")
    )
    path.write_text(json.dumps({**proposal, "time_s": [0.0, 1.0, 0.5]}))
    found = only(inspect(path))
    assert (found["severity"], "time_s does not increase" in found["message"]) == ("error", True)


def test_any_folder_with_provenance_is_described_and_no_other(tmp_path):
    folder = tmp_path / "result"
    folder.mkdir()
    with pytest.raises(StoreError, match="without a Zarr store"):
        inspect(folder)
    Provenance("export", {}, {}).write(folder)
    document = inspect(folder)
    assert (document["kind"], document["provenance"]["command"]) == ("directory", "export")
    assert "what is in it was not checked" in shown(document)
    (folder / "provenance.json").write_text("[]")
    assert only(inspect(folder))["severity"] == "warning"


def test_a_store_that_lost_its_root_is_damaged(tmp_path):
    folder = tmp_path / "run"
    sound_log().write(folder)
    Provenance("record", {}, {}).write(folder)
    (folder / "zarr.json").unlink()
    document = inspect(folder)
    found = only(document)
    assert (document["kind"], found["severity"], found["where"]) == ("zarr", "error", "store")
    assert "has no zarr.json" in found["message"]
    assert "`capture record`" in found["cure"]
    (folder / "provenance.json").unlink()
    renamed = only(inspect(folder.rename(tmp_path / "run.zarr")))
    assert "has no zarr.json" in renamed["message"] and "make the store again" in renamed["cure"]


def test_what_is_not_there_or_is_a_file_is_refused_with_the_cure(tmp_path):
    with pytest.raises(StoreError, match="does not exist"):
        inspect(tmp_path / "nowhere")
    (tmp_path / "run.csv").write_text("t_s\n0\n")
    with pytest.raises(StoreError, match="is a file") as caught:
        inspect(tmp_path / "run.csv")
    assert "import-log" in caught.value.cure


# --- numbers ---


def test_timing_of_too_few_samples_has_no_rate():
    for time in ([], [1.0], [1.0, 1.0], [np.nan, np.nan]):
        found = timing(np.array(time))
        assert found["rate"] is None
        assert found["jitter_sd"] is None


def test_a_grid_is_found_through_the_digits_of_a_file():
    angles = 2 * np.pi / 4096 * np.random.default_rng(0).integers(-800, 800, 1000)
    printed = np.array([float(f"{a:.7g}") for a in angles])
    assert quantisation(printed)["step"] == pytest.approx(2 * np.pi / 4096, rel=1e-5)
    assert quantisation(angles + 1e-5 * np.random.default_rng(1).standard_normal(1000))["step"] is None


def test_visits_count_separate_stays():
    values = np.array([1.0, 1.0, 0.0, 1.0, 0.5, 0.0, 0.0])
    found = channel(values, [slice(0, 7)])
    assert found["high"]["value"] == 1.0
    assert found["high"]["share"] == pytest.approx(3 / 7)
    assert found["high"]["neighbours"] == pytest.approx((1 / 7 + 3 / 7) / 2)
    assert found["high"]["visits"] == 2
    assert found["low"]["visits"] == 2


def test_single_files_are_known_for_what_they_are(tmp_path):
    write_json(tmp_path / "run.truth.json", {"format": "capture/truth", "version": 1, "task": "slider"})
    document = inspect(tmp_path / "run.truth.json")
    assert (document["kind"], document["store"]["format"]) == ("file", "capture/truth")
    assert "capture/truth version 1, task slider" in shown(document)
    folder = tmp_path / "made"
    folder.mkdir()
    for name in ("identifier", "provenance"):
        write_json(folder / f"{name}.json", {"format": f"capture/{name}", "version": 1})
    document = inspect(folder / "identifier.json")
    assert (document["kind"], document["path"]) == ("identifier", str(folder))
    for name, cure in (
        ("task.toml", "capture tasks"),
        ("run.csv", "capture import-log"),
        ("a.json", "give a log"),
    ):
        (tmp_path / name).write_text("{}")
        with pytest.raises(StoreError, match="neither a Zarr store nor JSON that `capture` wrote") as caught:
            inspect(tmp_path / name)
        assert cure in caught.value.cure
