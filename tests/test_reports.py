"""What `capture identify` shows: the page, the figures and the terminal tables say what the record says."""

from __future__ import annotations

import base64
import io
import json
import re
import sys
from functools import partial
from html import unescape
from subprocess import run

import numpy as np
import pytest
from html_page import Page
from matplotlib.image import imread
from rich.console import Console

from capture_cli.common.quantities import MISSING, bound, scaled_unit, significant, to_precision_of
from capture_cli.report.curve_plots import SETTINGS as CURVE_PLOTS
from capture_cli.report.curve_plots import curve_views
from capture_cli.report.curves import Curves, autocorrelation, thin
from capture_cli.report.estimate_page import render
from capture_cli.report.figure_parts import new_figure, save
from capture_cli.report.figures import _convergence, write_figures
from capture_cli.report.findings import (
    UNTRUSTED,
    correlation,
    notes,
    output_errors,
    suspicions,
)
from capture_cli.report.terminal import print_estimate
from capture_cli.store.estimate import Estimate, EstimateRecord

PARAMETERS = {
    "mass": ("kg", 50.0, 150.0, 95.108, 0.131),
    "damping": ("N s/m", 0.0, 600.0, 203.5, 1.9),
    "frictionloss": ("N", 0.0, 80.0, 20.39, 0.44),
    "bias": ("N", -20.0, 20.0, -3.16, 0.21),
}
OUTPUTS = {"q": ("m", 2e-5), "qd": ("m/s", 4e-3)}
PROVENANCE = {
    "format": "capture/provenance",
    "version": 1,
    "command": "identify",
    "options": {"identifier": "least-squares", "seed": 0, "out": "runs/estimate", "config": None},
    "inputs": {"real-log": {"path": "runs/slider.zarr", "sha256": "ab" * 32}},
    "capture": "0.1.0",
    "python": "3.11.9",
    "packages": {"mujoco": "4.0.0", "numpy": "1.26.4"},
    "platform": "Linux-6.1-x86_64",
    "began": "2025-03-04T10:11:12+00:00",
    "seconds": 3.218,
}


def make(
    parameters=PARAMETERS, outputs=OUTPUTS, *, windows=20, steps=50, episodes=1, held_out=4, rounds=8, seed=0
):
    """An estimate of a made-up machine: noise, and a slow residual twice as large that is not explained."""
    rng = np.random.default_rng(seed)
    count = windows * steps
    window = np.repeat(np.arange(windows), steps)
    episode = np.arange(windows) * episodes // windows
    is_test = np.arange(windows) >= windows - held_out
    time = 1e-2 * np.arange(count)
    time -= time[np.searchsorted(episode[window], episode[window])]  # each episode on its own clock
    simulated = np.stack([0.2 * np.sin(time + k) for k in range(len(outputs))], axis=1)
    floors = np.array([floor for _, floor in outputs.values()])
    slow = 2 * floors * np.sin(9 * time)[:, None]
    measured = simulated + slow + floors * rng.normal(size=simulated.shape)
    nominal = simulated * 1.3 + 0.01
    values = {n: v for n, (_, _, _, v, _) in parameters.items()}
    sd = np.array([s for *_, s in parameters.values()])
    mixing = 0.5 * np.eye(len(parameters)) + 0.5
    start = np.array([(low + high) / 2 for _, low, high, *_ in parameters.values()])
    fraction = 1 - 0.4 ** np.arange(rounds)
    path = start + fraction[:, None] * (np.array(list(values.values())) - start)
    error = 3 + 400 * (1 - fraction)
    residual = measured - simulated

    def part(mask):
        rmse = np.sqrt(np.mean(residual[mask] ** 2, axis=0))
        named = dict(zip(outputs, rmse.tolist(), strict=True))
        return {"rmse": named, "normalized": float(np.sqrt(np.mean((rmse / floors) ** 2)))}

    document = {
        "format": "capture/estimate",
        "version": 1,
        "task": "slider",
        "log": {"path": "/logs/slider_train.zarr", "sha256": "cd" * 32},
        "identifier": "least-squares",
        "parameters": {
            n: {
                "value": value,
                "unit": unit,
                "low": low,
                "high": high,
                "sd": s,
                "ci95": [value - 1.96 * s, value + 1.96 * s],
                "at_bound": False,
                "identifiable": True,
            }
            for n, (unit, low, high, value, s) in parameters.items()
        },
        "error": {"fit": part(~is_test[window]), "test": part(is_test[window]) if held_out else None},
        "noise_floor": {n: floor for n, (_, floor) in outputs.items()},
        "noise_floor_source": dict.fromkeys(outputs, "differences"),
        "verdict": "unexplained",
        "summary": "A slow residual 1.7 times the noise floor remains: the model lacks something.",
        "diverged_windows": 0,
        "lack_of_fit": {"normalized": 1.72, "threshold": 1.05, "autocorrelation_time": 12.0},
        "undetermined": [],
        "correlation": mixing.tolist(),
        "recordings": None,
        "split": {
            "how": "every fifth block",
            "fit_windows": windows - held_out,
            "test_windows": held_out,
        },
        "rollouts": {"measured": windows, "simulated": 1240},
        "rounds": [
            {"parameters": dict(zip(parameters, p.tolist(), strict=True)), "error": float(e)}
            for p, e in zip(path, error, strict=True)
        ],
        "in_context": None,
        "next_command": None,
    }
    arrays = {
        "window/episode": episode,
        "window/first": np.arange(windows) * steps,
        "window/is_test": is_test,
        "window/start_offset": np.zeros((windows, 2)),
        "step/window": window,
        "step/time": time,
        "step/measured": measured,
        "step/simulated": simulated,
        "step/nominal": nominal,
        "parameter/estimate": np.array(list(values.values())),
        "parameter/covariance": mixing * np.outer(sd, sd),
        "round/parameters": path,
        "round/error": error,
    }
    attributes = {
        "parameters": list(parameters),
        "outputs": [{"name": n, "unit": u} for n, (u, _) in outputs.items()],
        "recordings": ["morning"],
    }
    return Estimate(document, arrays, attributes)


def full():
    """With everything a document may carry."""
    estimate = make(episodes=2)
    document = estimate.document
    document["undetermined"] = [
        {
            "combination": {"mass": 0.71, "bias": -0.7},
            "sd_over_range": 3.1,
            "text": "Only mass over bias is known.",
        }
    ]
    document["parameters"]["bias"] |= {
        "at_bound": True,
        "identifiable": False,
        "value": -20.0,
        "ci95": [-20.4, -19.6],
    }
    names = ["morning", "noon", "evening"]
    document["recordings"] = {
        "names": names,
        "agree": False,
        "parameters": {
            n: {
                "values": [p["value"] + 3 * k * p["sd"] for k in (-1, 0, 1)],
                "sd": [p["sd"]] * 3,
                "p_value": 0.004,
            }
            for n, p in document["parameters"].items()
        },
        "text": "The recordings disagree on mass (p = 0.004): the machine changed between them.",
    }
    document["noise_floor_source"] = {"q": "differences", "qd": "declared"}
    document["next_command"] = "capture diagnose --real-log slider.zarr --estimate ESTIMATE"
    return estimate


def bare():
    """A single recording of one window, no parameters, nothing held out, no rounds."""
    estimate = make({}, {"z": ("m", 1e-3)}, windows=1, steps=80, held_out=0, rounds=0)
    estimate.document["verdict"] = "explained"
    return estimate


def not_identifiable():
    """Two parameters of which the log fixes the sum only: no sd, no interval."""
    estimate = make({n: PARAMETERS[n] for n in ("mass", "bias")}, {"contact": ("1", 0.1)})
    estimate.document["verdict"] = "not-identifiable"
    combination = {"combination": {"mass": 1.0, "bias": -0.98}, "sd_over_range": 3.1}
    estimate.document["undetermined"] = [
        combination | {"text": "only a combination of mass, bias shows in the outputs"}
    ]
    for p in estimate.document["parameters"].values():
        p |= {"identifiable": False, "sd": None, "ci95": None}
    return estimate


def runaway_nominal():
    """The model diverges at its nominal values."""
    estimate = make()
    estimate.arrays["step/nominal"][300:600] = 1e200
    estimate.arrays["step/nominal"][600:] = np.nan
    return estimate


RECORDS = {
    "plain": make,
    "full": full,
    "bare": bare,
    "not-identifiable": not_identifiable,
    "runaway-nominal": runaway_nominal,
}


@pytest.fixture(scope="module", params=RECORDS)
def record(request):
    estimate = RECORDS[request.param]()
    return estimate, Page(render(estimate, PROVENANCE))


def printed(estimate, width: int, **console) -> str:
    out = io.StringIO()
    print_estimate(estimate, Console(file=out, width=width, **console), "runs/estimate")
    return out.getvalue()


@pytest.mark.parametrize("width", [40, 60, 80])
def test_a_narrow_terminal_cuts_nothing_off_the_tables(width):
    estimate = full()
    text = printed(estimate, width)
    lines = [line.split() for line in text.splitlines() if line.strip()]
    for error in output_errors(estimate):
        (row,) = [line for line in lines if line[0] == error.name and "×" in line]
        assert set(error.floor.split()) <= set(row)
    for name, parameter in estimate.document["parameters"].items():
        assert any(line[0] == name and parameter["unit"] in " ".join(line) for line in lines)


def test_names_are_whole_where_remarks_beside_them_are_broken():
    estimate = make(
        {
            "motor_constant": ("N m/A", 0.0, 0.1, 0.0564, 0.0543),
            "pend_damping": ("N m s/rad", 0.0, 1.0, 1.8e-4, 1.8e-4),
        }
    )
    for parameter in estimate.document["parameters"].values():
        parameter["identifiable"] = False
    lines = [line.split() for line in printed(estimate, 80).splitlines() if line.strip()]
    assert {"motor_constant", "pend_damping"} <= {line[0] for line in lines}


# ---- the page ----


def test_page_fetches_nothing(record):
    _, page = record
    fetching = {"src", "href", "action", "data", "srcset", "poster", "formaction", "ping", "background"}
    assert [a for a in page.attributes if a[1] in fetching] == []
    assert not any(tag in ("link", "iframe", "object", "img") for tag, _, _ in page.attributes)
    assert "default-src 'none'" in next(v for t, n, v in page.attributes if t == "meta" and n == "content")
    own = "".join(page.scripts[1:])
    assert "http" not in own and "showSendToCloud: false" in own


def test_page_has_no_addresses_outside_plotly():
    html = render(full(), PROVENANCE)
    without_plotly = re.sub(r"<script>.*?</script>", "", html, count=1, flags=re.DOTALL)
    assert not re.search(r"https?://|@import|url\(", without_plotly)
    assert html.count("* plotly.js v") == 1
    assert len(without_plotly) < 400_000


def test_page_structure(record):
    _, page = record
    assert len(page.ids) == len(set(page.ids))
    assert len(page.scripts) == 3
    assert [page.tags.count(tag) for tag in ("html", "head", "title", "body", "main", "h1")] == [1] * 6
    plots = {v for t, n, v in page.attributes if t == "div" and n == "id"}
    assert plots == set(page.data["plots"]), "every plot has its place, and every place its plot"


def test_traces_find_their_curves(record):
    estimate, page = record
    views, sets = page.data["curves"]["views"], page.data["curves"]["sets"]
    steps = len(estimate.arrays["step/time"])
    windows = len(estimate.arrays["window/first"])
    assert views[0]["last"] - views[0]["first"] == steps + windows  # one gap after every window
    assert len(views) == (1 if windows == 1 else 1 + windows)
    for k in range(len(estimate.attributes["outputs"])):
        named = [t["meta"]["series"] for t in page.data["plots"][f"overlay-{k}"]["data"] if "meta" in t]
        assert set(named) == {f"{kind}/{k}" for kind in ("measured", "simulated", "nominal", "residual")}
        assert set(named) <= set(sets["log"])


def test_embedded_numbers_are_those_of_the_record():
    estimate = make()
    page = Page(render(estimate, None))
    curves = page.data["curves"]
    view = curves["views"][3]

    def values(series, dtype):
        return np.frombuffer(base64.b64decode(curves["sets"]["log"][series]["bdata"]), dtype)[
            view["first"] : view["last"]
        ]

    rows = slice(100, 150)  # the third window
    np.testing.assert_array_equal(values("x", "<f8"), estimate.arrays["step/time"][rows])
    np.testing.assert_allclose(
        values("measured/0", "<f4"), estimate.arrays["step/measured"][rows, 0], rtol=1e-6
    )
    residual = estimate.arrays["step/measured"][rows, 1] - estimate.arrays["step/simulated"][rows, 1]
    np.testing.assert_allclose(values("residual/1", "<f4"), 1e3 * residual, rtol=1e-5)  # m/s drawn as mm/s


def test_page_says_what_was_found():
    page = Page(render(full(), PROVENANCE))
    for said in (
        "unexplained",
        "A slow residual 1.7 times the noise floor remains",
        "Only mass over bias is known.",
        "bias is at its lower bound, -20 N",
        "The recordings disagree on mass (p = 0.004)",
        "capture diagnose --real-log slider.zarr --estimate runs/estimate",
        "203.5 1.9 199.8 to 207.2",
        "not determined , at its bound",
        "from high-order differences",
        "every fifth block: 16 windows fitted, 4 held out",
        "4 March 2025",
        "mujoco 4.0.0",
        "seed = 0",
        "ab" * 32,
    ):
        assert said in page.text, said
    assert {"correlation", "convergence", "recordings"} <= set(page.data["plots"])
    assert len(page.data["plots"]["recordings"]["data"]) == 4


@pytest.mark.parametrize("name", ["full", "bare"])
def test_page_of_an_estimate_from_disk(name, tmp_path):
    RECORDS[name]().write(tmp_path)
    assert render(Estimate.read(tmp_path), PROVENANCE) == render(RECORDS[name](), PROVENANCE)


def test_page_without_parameters_or_provenance():
    page = Page(render(bare(), None))
    assert "None are declared" in page.text
    assert set(page.data["plots"]) == {"overlay-0", "residual-0"}
    assert "view" not in page.ids
    assert "held out" not in json.dumps(page.data["plots"])


def test_names_cannot_break_the_page():
    estimate = make({"</script><b>": ("kg", 0.0, 1.0, 0.5, 0.1)}, {"<i>&": ("m", 1e-3)})
    page = Page(render(estimate, PROVENANCE))  # raises where the tags do not match
    assert "</script><b>" in page.text and "<i>&" in page.text
    assert page.data["plots"]["convergence"]["data"][1]["name"] == "&lt;/script&gt;&lt;b&gt;"


def texts_in(value) -> list[str]:
    """Every text of a plotly figure, as plotly gets it."""
    if isinstance(value, str):
        return [value]
    inside = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return [text for own in inside for text in texts_in(own)]


def test_plotly_gets_no_name_as_html():
    """It takes <b>, <i>, <a> and entities in titles, legends and tick labels, and drops what it does not know."""
    names = ("m<i>ass", "a<u>&amp;b", "</b>%{x}")
    parameters = {name: ("k<sub>g", 0.0, 1.0, 0.5, 0.1) for name in names}
    estimate = make(parameters, {"cart<script>": ("<b>m", 1e-3)})
    estimate.document["recordings"] = {
        "names": ["<a>1", "2"],
        "agree": True,
        "text": "They agree.",
        "parameters": {name: {"values": [0.4, 0.6], "sd": [0.1, 0.1], "p_value": 0.5} for name in names},
    }
    plots = Page(render(estimate, PROVENANCE)).data["plots"]
    texts = [text.removesuffix("<extra></extra>") for text in texts_in(plots)]
    assert not [text for text in texts if "<" in text]
    shown = "\n".join(unescape(text) for text in texts)
    for name in ("m<i>ass [k<sub>g]", "a<u>&amp;b", "cart<script> [<b>m]", "<a>1", "%{y:.5g} <b>m"):
        assert name in shown
    assert plots["correlation"]["data"][0]["y"][1] == "a&lt;u&gt;&amp;amp;b"
    (template,) = [d["hovertemplate"] for d in plots["convergence"]["data"] if "%" in d["name"]]
    assert "%{x}" not in template and "%{customdata:.5g}" in template and template.endswith("<extra></extra>")


def test_many_outputs_are_folded():
    page = Page(render(make(outputs={f"j{k}": ("rad", 1e-3) for k in range(6)}, windows=4, held_out=1), None))
    assert page.text.count("white noise stays in the band") == 6
    assert page.tags.count("details") == 2
    assert "details" not in Page(render(make(), None)).tags


def test_what_was_done_round_by_round_is_said():
    estimate = make()
    assert "The best so far, round by round;" in Page(render(estimate, None)).text
    estimate.document["in_context"] = {"rounds": 4, "text": None, "share_beyond": 0.5}
    assert "What each round over the episodes proposed" in Page(render(estimate, None)).text


# ---- long logs ----


def test_long_log_stays_light_and_keeps_its_peaks():
    estimate = make(outputs={"q": ("m", 2e-5)}, windows=50, steps=4000, held_out=10)
    estimate.arrays["step/measured"][123_456, 0] += 5.0
    views = curve_views(Curves.of(estimate))
    assert views["views"][0]["last"] <= CURVE_PLOTS.most_points + 3 * 50
    shown = np.frombuffer(base64.b64decode(views["sets"]["log"]["measured/0"]["bdata"]), "<f4")
    assert np.nanmax(shown) == np.float32(estimate.arrays["step/measured"][123_456, 0])
    labels = [v["label"] for v in views["views"][1:]]
    assert [label.split(" window")[0] for label in labels] == ["worst", "median", "best"] * 2
    assert labels[3].startswith("worst window 30 · fitted"), "the window with the peak"
    assert len(json.dumps(views)) < 2_500_000


def test_thinned_curve_has_the_extremes_of_every_window():
    values = np.random.default_rng(0).normal(size=(3000, 2))
    slices = (slice(0, 1000), slice(1000, 2100), slice(2100, 3000))
    at, rows, ends = thin(values, slices, 300)
    assert len(rows) == pytest.approx(300, rel=0.05)
    assert np.all(np.diff(at) >= 0)
    for (first, last), steps in zip(ends, slices, strict=True):
        np.testing.assert_array_equal(rows[first:last].max(axis=0), values[steps].max(axis=0))
        np.testing.assert_array_equal(rows[first:last].min(axis=0), values[steps].min(axis=0))
        assert np.isnan(rows[last]).all()
        assert steps.start <= at[first] and at[last - 1] < steps.stop


def test_short_curve_is_kept_whole():
    values = np.arange(20.0)[:, None]
    at, rows, ends = thin(values, (slice(0, 12), slice(12, 20)), 100)
    np.testing.assert_array_equal(rows[:12, 0], values[:12, 0])
    np.testing.assert_array_equal(rows[13:21, 0], values[12:, 0])
    assert ends.tolist() == [[0, 12], [13, 21]] and at[-1] == 19


def test_episodes_stand_one_after_the_other():
    curves = Curves.of(make(episodes=4))
    assert np.all(np.diff(curves.x) > 0)
    assert len(curves.episode_starts()) == 3
    assert curves.spans(curves.is_test) == [(curves.x[800], curves.x[999])]


def test_epoch_times_are_counted_from_the_start():
    estimate = make()
    estimate.arrays["step/time"] = estimate.arrays["step/time"] + 1.7e9
    curves = Curves.of(estimate)
    assert curves.x[0] == 0 and curves.x_title == "time since the start [s]"


def test_autocorrelation_of_noise_and_of_a_first_order_process():
    rng = np.random.default_rng(0)
    noise = rng.normal(size=40_000)
    slow = np.zeros_like(noise)
    for i in range(1, len(noise)):
        slow[i] = 0.9 * slow[i - 1] + noise[i]
    slices = tuple(slice(i, i + 2000) for i in range(0, 40_000, 2000))
    assert np.abs(autocorrelation(noise, slices)[1:]).max() < 0.03
    np.testing.assert_allclose(autocorrelation(slow, slices)[:8], 0.9 ** np.arange(8), atol=0.03)


# ---- figures ----


@pytest.mark.parametrize("name", RECORDS)
def test_figures(name, tmp_path):
    estimate = RECORDS[name]()
    written = write_figures(estimate, tmp_path)
    expected = {"overlay.png", "residual.png"}
    expected |= {"parameters.png"} if estimate.document["parameters"] else set()
    expected |= {"convergence.png"} if len(estimate.arrays["round/error"]) else set()
    assert {p.name for p in written} == expected == {p.name for p in tmp_path.iterdir()}
    for path in written:
        image = imread(path)[..., :3]
        assert image.shape[1] == 1350, "9 inches at 150 dpi"
        image = image[::3, ::3]
        assert len(np.unique(image.reshape(-1, 3), axis=0)) > 50
        assert 0.002 < np.mean(image.min(axis=2) < 0.9) < 0.6, "neither blank nor filled"


def test_figures_take_no_name_for_a_formula(tmp_path):
    names = ("$\\nonsense$", "a$b$", "_hidden")
    estimate = make({name: ("$x$", 0.0, 1.0, 0.5, 0.1) for name in names}, {"q$^$": ("m$^$", 2e-5)})
    assert len(write_figures(estimate, tmp_path)) == 4  # raises where a formula is none
    figure = _convergence(estimate)
    assert [text.get_text() for text in figure.axes[1].get_legend().get_texts()] == list(names)
    save({"again": lambda: figure}, tmp_path)
    assert not any(text.get_parse_math() for text in figure.axes[1].get_legend().get_texts())
    assert figure.axes[0].get_yscale() == "log" and figure.axes[0].get_yticklabels()[0].get_parse_math()


@pytest.mark.parametrize("broken", [0, 1])
def test_a_figure_that_cannot_be_drawn_is_an_error_whichever_process_draws_it(broken, tmp_path):
    def nonsense():
        raise ValueError("nonsense")

    drawings = {str(i): nonsense if i == broken else partial(new_figure, 1.0) for i in range(2)}
    with pytest.raises(ValueError, match="nonsense"):
        save(drawings, tmp_path)


# ---- the terminal ----


@pytest.mark.parametrize("width", [80, 100])
@pytest.mark.parametrize("name", RECORDS)
def test_terminal_fits(name, width):
    lines = printed(RECORDS[name](), width).splitlines()
    assert len(lines) <= 25
    assert max(len(line) for line in lines) <= width
    assert "\x1b" not in "".join(lines)


def test_terminal_says_what_was_found():
    text = printed(full(), 100)
    for said in (
        r"mass +95\.11 kg +0\.13 +94\.85 to 95\.36 +50 to 150",
        r"damping +203\.5 N s/m +1\.9 +199\.8 to 207\.2 +0 to 600",
        r"bias .* at bound, not determined",
        r"q +35\.1 µm +35\.5 µm +35\.4 mm +20\.0 µm +1\.77 ×",
        r"unexplained  A slow residual",
        r"note  Do not trust the intervals: ",
        r"note  Only mass over bias is known\.",
        r"note  bias is at its lower bound",
        r"note  The recordings disagree on mass",
        r"report  runs/estimate/report\.html",
        r"next    capture diagnose --real-log slider\.zarr --estimate runs/estimate\n",
    ):
        assert re.search(said, text), said


def test_terminal_never_breaks_a_command_or_a_path():
    estimate = make()
    estimate.document["next_command"] = "capture diagnose --real-log " + "long/" * 30 + "log.zarr"
    out = io.StringIO()
    print_estimate(estimate, Console(file=out, width=80), "deep/" * 30)
    assert estimate.document["next_command"] in out.getvalue()
    assert "deep/" * 30 + "report.html" in out.getvalue()


def test_terminal_colours_only_a_terminal():
    assert "\x1b[1;33munexplained" in printed(full(), 100, force_terminal=True, color_system="standard")
    assert "\x1b" not in printed(full(), 100)


def test_terminal_knows_ascii():
    out = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    print_estimate(full(), Console(file=out, width=100), "runs/estimate")
    out.flush()
    text = out.buffer.getvalue().decode("ascii")
    assert "35.1 um" in text and "1.77 x" in text and "?" not in text


def test_names_are_not_markup():
    assert "[red]mass" in printed(make({"[red]mass": ("kg", 0.0, 1.0, 0.5, 0.1)}), 100)


def test_terminal_limits_notes_and_outputs():
    estimate = make(outputs={f"j{k}": ("rad", 1e-3) for k in range(12)}, windows=4, held_out=1)
    estimate.document["noise_floor"] |= {"j5": 1e-4}
    for p in estimate.document["parameters"].values():
        p["at_bound"] = True
    estimate.document["undetermined"] = [{"text": "this log does not determine mass"}]
    text = printed(estimate, 100)
    assert len(re.findall(r"^j\d+ ", text, flags=re.MULTILINE)) == 8
    assert re.search(r"^j5 ", text, flags=re.MULTILINE), "the one that stands out stays"
    assert "Only in the report: notes (2) and outputs nearer to their floor (4)." in text


# ---- words and numbers ----


def test_a_noise_floor_that_is_too_high_is_said_to_be():
    lack = {"normalized": 0.45, "threshold": 1.1}
    document = make().document | {"verdict": "explained", "lack_of_fit": lack}
    assert any("floor is too high" in note for note in notes(EstimateRecord.of(document)))
    assert not any(
        "too high" in n
        for n in notes(EstimateRecord.of(document | {"lack_of_fit": lack | {"normalized": 0.9}}))
    )


def test_a_fit_that_is_worse_than_none_asks_for_unit_and_sign():
    estimate = make()
    assert suspicions(estimate) == []
    far = {name: 1e3 for name in estimate.document["error"]["fit"]["rmse"]}
    estimate.document["error"]["fit"]["rmse"] = far
    (said,) = suspicions(estimate)
    assert all(name in said for name in far) and "unit and sign" in said
    # an output that does nothing but its noise is as far from its mean as from any fit
    estimate.document["noise_floor"] = far
    assert suspicions(estimate) == []


def test_a_fit_that_leaves_half_of_the_motion_asks_for_unit_and_sign():
    estimate = make()
    window = np.asarray(estimate.arrays["step/window"])
    for k, output in enumerate(estimate.attributes["outputs"]):
        measured = np.asarray(estimate.arrays["step/measured"])[:, k]
        within = [
            measured[window == w] - measured[window == w].mean() for w in np.unique(window[window >= 0])
        ]
        motion = float(np.concatenate(within).std())
        rmse = estimate.document["error"]["fit"]["rmse"]
        floors = estimate.document["noise_floor"]
        before, floors[output["name"]] = floors[output["name"]], 1e-3 * motion
        for share, is_told in ((0.3, False), (0.7, True)):
            rmse[output["name"]] = share * motion
            assert bool(suspicions(estimate)) is is_told
        rmse[output["name"]], floors[output["name"]] = 0.0, before


def test_notes():
    assert notes(make().record) == [UNTRUSTED]
    assert notes(EstimateRecord.of(make().document | {"verdict": "explained"})) == []
    assert notes(EstimateRecord.of(make().document | {"parameters": {}})) == []
    assert notes(not_identifiable().record) == ["only a combination of mass, bias shows in the outputs"]
    (_, joints) = notes(EstimateRecord.of(make().document | {"unmeasured_joints": ["wrist", "#3"]}))
    assert "position of wrist, #3" in joints
    assert (
        notes(EstimateRecord.of(make().document | {"unmeasured_joints": ["wrist"], "verdict": "explained"}))
        == []
    )
    loops, _ = notes(EstimateRecord.of(make().document | {"open_loops": {"pin": 0.0312}}))
    assert "stay open: pin by 0.031" in loops
    assert (
        notes(EstimateRecord.of(make().document | {"open_loops": {"pin": 0.0312}, "verdict": "explained"}))
        == []
    )
    recordings = {"names": ["a", "b"], "agree": False, "text": "the 2 recordings disagree, most about bias"}
    in_context = {"text": "8 rounds were made with 4 episodes, taken in turn again."}
    document = make().document | {"recordings": recordings, "in_context": in_context}
    assert notes(EstimateRecord.of(document)) == [UNTRUSTED, in_context["text"], recordings["text"]]
    agree = {"recordings": recordings | {"agree": True}, "in_context": {"text": None}}
    assert notes(EstimateRecord.of(document | agree)) == [UNTRUSTED]


def test_errors_over_the_floor():
    q, qd = output_errors(make())
    rmse = make().document["error"]["test"]["rmse"]
    assert q.test == f"{significant(1e6 * rmse['q'])} µm" and q.ratio == pytest.approx(rmse["q"] / 2e-5)
    assert q.nominal.endswith(" mm") and qd.test.endswith(" mm/s")
    assert output_errors(bare())[0].test == MISSING and output_errors(bare())[0].ratio > 1
    assert output_errors(runaway_nominal())[0].nominal == MISSING


def test_a_floor_far_below_has_a_unit_of_its_own():
    estimate = make()
    estimate.document["noise_floor"]["qd"] = 2e-8
    errors = output_errors(estimate)
    assert [e.floor for e in errors] == ["20.0 µm", "20.0 nm/s"]


def test_no_floor_no_ratio():
    estimate = make()
    estimate.document["noise_floor"] = {"q": 0.0, "qd": 0.0}
    assert [e.ratio for e in output_errors(estimate)] == [None, None]
    assert "noise floor ±2 sd" not in json.dumps(Page(render(estimate, None)).data["plots"])


def test_correlation():
    matrix = correlation(make())
    np.testing.assert_allclose(np.diag(matrix), 1)
    np.testing.assert_allclose(matrix[0, 1], 0.5)
    assert correlation(bare()) is None


@pytest.mark.parametrize(
    ("unit", "magnitude", "factor", "shown"),
    [
        ("m", 7.3e-4, 1e3, "mm"),
        ("m", 0.25, 1.0, "m"),
        ("rad/s", 3e-5, 1e6, "µrad/s"),
        ("N m", 0.02, 1e3, "mN m"),
        ("kg", 1e-4, 1.0, "kg"),
        ("m^2", 1e-4, 1.0, "m^2"),
        ("1", 1e-4, 1.0, ""),
        ("m", 0.0, 1.0, "m"),
        ("m", None, 1.0, "m"),
        ("m", 1e-30, 1.0, "m"),
    ],
)
def test_scaled_unit(unit, magnitude, factor, shown):
    assert scaled_unit(unit, magnitude) == (factor, shown)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.7304, "0.730"),
        (1234.5, "1234"),
        (0.9999, "1.00"),
        (-9.996, "-10.0"),
        (3.2e-7, "3.20e-7"),
        (4e9, "4.00e9"),
        (0.0, "0"),
        (None, MISSING),
        (float("inf"), MISSING),
    ],
)
def test_significant(value, text):
    assert significant(value) == text


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [
        (95.1078, 0.131, "95.11"),
        (203.46, 1.9, "203.5"),
        (-3.16, 25.0, "-3"),
        (1.0, 1e-12, "1.00000"),
        (2.5e-7, 1e-9, "2.500e-7"),
        (0.0, 0.02, "0.000"),
        (1e8, 1e5, "1.0000e8"),
        (5.0, None, "5.000"),
        (None, 0.1, MISSING),
    ],
)
def test_to_precision_of(value, sd, text):
    assert to_precision_of(value, sd) == text


def test_bound():
    assert [bound(v) for v in (50.0, 0.025, -20.0, 1e9, 1e-7)] == ["50", "0.025", "-20", "1e9", "1e-7"]


def test_imports_stay_light():
    """`capture identify` must not wait for pyplot, plotly's figure classes or pandas."""
    program = (
        "import sys;"
        "import capture_cli.report.estimate_page, capture_cli.report.figures, capture_cli.report.terminal;"
        "from capture_cli.report.page import page;"
        "page('page.html', plots={}, curves=None, document={'task': ''}, badge='');"
        "print([m for m in ('matplotlib.pyplot', 'plotly.graph_objs', 'pandas') if m in sys.modules])"
    )
    assert run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout == "[]\n"
