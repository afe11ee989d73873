"""What `capture diagnose` shows: the page, the figures and the terminal say what the record says."""

from __future__ import annotations

import base64
import io
import json
import re
from importlib.resources import files

import numpy as np
import pytest
from html_page import Page
from matplotlib.image import imread
from rich.console import Console
from setting_numbers import set_numbers

from capture_cli.common import processes
from capture_cli.report import diagnosis_figures, diagnosis_plots
from capture_cli.report import diagnosis_findings as findings
from capture_cli.report.diagnosis_figures import write_figures
from capture_cli.report.diagnosis_page import render
from capture_cli.report.terminal import print_diagnosis
from capture_cli.store.diagnosis import FORMAT, VERSION, Diagnosis, DiagnosisRecord

OUTPUTS = {"q": ("m", 2e-5), "qd": ("m/s", 4e-3)}
ONE = {"q": OUTPUTS["q"]}
COULOMB = {
    "name": "coulomb-friction",
    "site": "x",
    "summary": "dry friction of constant size in a joint",
    "law": "`friction` (N or N m) is added to the joint's frictionloss.",
    "parameters": {"friction": ("N", 0.0, 80.0, 21.834, 0.199)},
    "tied_with": [],
}
VISCOUS = {
    "name": "direction-dependent-viscous",
    "site": "x",
    "summary": "viscous friction that differs between forward and backward motion",
    "law": "`asymmetry` is added forward.\n\nIn neither direction does the damping fall below zero.",
    "parameters": {"asymmetry": ("N s/m", -354.0, 354.0, -39.738, 0.63)},
    "tied_with": ["constant-force@x", "control-bias@drive"],
}
PROVENANCE = {
    "format": "capture/provenance",
    "version": 1,
    "command": "diagnose",
    "options": {"seed": 0, "task": None},
    "inputs": {"real_log": {"path": "runs/slider.zarr", "sha256": "ab" * 32}},
    "capture": "0.1.0",
    "python": "3.11.9",
    "packages": {"mujoco": "4.0.0"},
    "platform": "Linux-6.1-x86_64",
    "began": "2025-03-04T10:11:12+00:00",
    "seconds": 61.218,
}


def make(
    outputs=ONE, effects=(COULOMB, VISCOUS), *, windows=12, steps=60, episodes=2, parts=(0, 1, 2), seed=0
):
    """A diagnosis of a made-up machine whose error falls by a third with every effect."""
    rng = np.random.default_rng(seed)
    window = np.repeat(np.arange(windows), steps)
    episode = np.arange(windows) * episodes // windows
    time = 1e-2 * np.arange(windows * steps)
    time -= time[np.searchsorted(episode[window], episode[window])]
    truth = np.stack([0.2 * np.sin(time + k) for k in range(len(outputs))], axis=1)
    floors = np.array([floor for _, floor in outputs.values()])
    measured = truth + floors * rng.normal(size=truth.shape)
    slow = 20 * floors * np.sin(9 * time)[:, None]
    sizes = [3.0**-k for k in range(len(effects) + 1)]
    part = np.array([parts[k * len(parts) // windows] for k in range(windows)])

    def error(size: float, of: int) -> dict | None:
        rows = (part == of)[window]
        if not rows.any():
            return None
        rmse = np.sqrt(np.mean((measured - truth + size * slow)[rows] ** 2, axis=0))
        named = dict(zip(outputs, rmse.tolist(), strict=True))
        return {"rmse": named, "mae": named, "normalized": float(np.sqrt(np.mean((rmse / floors) ** 2)))}

    tied = [name for effect in effects for name in effect["tied_with"]]
    names = ["declared", *(f"+ {findings.placed(e)}" for e in effects)]
    stages = [
        {"model": name, "fit": error(size, 0), "select": error(size, 1), "test": error(size, 2)}
        for name, size in zip(names, sizes, strict=True)
    ]
    curves = [
        {"output": o, "against": against, "unit": unit, "share": share}
        for o in outputs
        for against, unit, share in (("time", "s", 0.02), (o, outputs[o][0], 0.1), ("drive", "V", 0.45))
    ]
    centre = np.tile(np.linspace(-1, 1, 24), (len(curves), 1))
    bins = 0.1 * np.sin(4 * centre)
    document = {
        "format": FORMAT,
        "version": VERSION,
        "task": "slider",
        "log": {"path": "/logs/slider.zarr", "sha256": "cd" * 32},
        "verdict": "tied" if tied else "effect-found" if effects else "explained",
        "effects": [_effect(e) for e in effects],
        "parameters": {
            "mass": _parameter("kg", 50.0, 150.0, 93.21 if effects else 110.44, 0.418),
            "damping": _parameter("N s/m", 0.0, 600.0, 191.13 if effects else 425.43, 2.01),
        },
        "stages": stages,
        "before": {"test": stages[0]["test"]},
        "after": {"test": stages[-1]["test"]},
        "noise_floor": {n: floor for n, (_, floor) in outputs.items()},
        "noise_floor_source": dict.fromkeys(outputs, "differences"),
        "lack_of_fit": {
            "before": {"normalized": 14.1, "threshold": 1.1, "autocorrelation_time": 12.0, "lacking": True},
            "after": {"normalized": 1.02, "threshold": 1.1, "autocorrelation_time": 1.0, "lacking": False},
        },
        "absorbed": {
            "mass": {"before": 110.44, "after": 93.21, "unit": "kg", "shift_in_sd": -41.2},
            "damping": {"before": 425.43, "after": 191.13, "unit": "N s/m", "shift_in_sd": -116.4},
        }
        if effects
        else {},
        "candidates": [
            *(_candidate(e["name"], e["site"], 38.4, 1.02, None) for e in effects),
            *(_candidate(*name.split("@"), 12.0, 1.03, "this log cannot tell") for name in tied),
            _candidate("cogging", "x", 16.3, 1.4, "no better than coulomb-friction@x, with more parameters"),
            _candidate("stribeck-friction", "x", 30.0, 1.6, "stribeck-friction@x.speed = 2 is a bound"),
            _candidate("wind", "", 0.0, None, "it moves no output of this log"),
        ]
        if effects
        else [_candidate("cogging", "x", None, None, None)],
        "localisation": curves,
        "split": {
            "how": "1 of 4 episodes held out",
            "fit_windows": 6,
            "select_windows": 3,
            "test_windows": 3,
        },
        "rollouts": {"measured": 4, "simulated": 72958},
        "next_experiment": None,
        "expression": None,
    }
    document["summary"] = findings.summary(DiagnosisRecord.of(document))
    arrays = {
        "window/episode": episode,
        "window/first": np.arange(windows) * steps,
        "window/part": part,
        "step/window": window,
        "step/time": time,
        "step/measured": measured,
        "step/before": truth - slow,
        "step/after": truth - sizes[-1] * slow,
        "bin/centre": centre,
        "bin/before": bins,
        "bin/after": 0.1 * bins,
        "bin/error": np.full_like(bins, 0.01),
    }
    attributes = {
        "outputs": [{"name": n, "unit": u} for n, (u, _) in outputs.items()],
        "recordings": ["morning"],
        "curves": curves,
    }
    return Diagnosis(document, arrays, attributes)


def _parameter(unit, low, high, value, sd):
    ends = {"low": low, "high": high, "ci95": [value - 1.96 * sd, value + 1.96 * sd]}
    return {"value": value, "unit": unit, "sd": sd, "at_bound": False, "identifiable": True, **ends}


def _effect(effect):
    parameters = {name: _parameter(*p) for name, p in effect["parameters"].items()}
    return effect | {"parameters": parameters, "p_value": 9.6e-44, "p_select": 0.00025}


def _candidate(effect, site, score, error, why):
    return {
        "effect": effect,
        "site": site,
        "score": score,
        "refit_select_error": error,
        "why_rejected": why,
    }


def full():
    """With everything a document may carry."""
    diagnosis = make(OUTPUTS)
    document = diagnosis.document
    document["verdict"] = "unexplained"
    document["summary"] = findings.summary(DiagnosisRecord.of(document))
    document["expression"] = {
        "text": "missing force at x = -3.2 v|v|",
        "terms": [{"site": "x: v|v|", "coefficient": -3.21, "sd": 0.12, "unit": "N per (m/s)^2"}],
        "select": None,
        "test": document["stages"][-1]["test"] | {"normalized": 1.1},
    }
    document["next_experiment"] = {"text": "Hold the carriage at 0.1 m and push it both ways."}
    document["parameters"]["mass"] |= {"at_bound": True, "identifiable": False, "sd": None, "ci95": None}
    document["effects"][0]["p_value"] = None
    document["candidates"][0]["score"] = None
    return diagnosis


def nothing_found():
    """Something is missing, and none of the catalogue explains it."""
    diagnosis = make(effects=())
    diagnosis.document["verdict"] = "unexplained"
    diagnosis.document["lack_of_fit"]["after"] = diagnosis.document["lack_of_fit"]["before"]
    diagnosis.document["summary"] = findings.summary(diagnosis.record)
    diagnosis.document["candidates"] = [
        _candidate("cogging", "x", 3.0, None, "it explains nothing (score 3)")
    ]
    return diagnosis


def short():
    """A log of one window: nothing selects, nothing is held out, no curve has enough data, no parameter is declared."""
    diagnosis = make(effects=(COULOMB,), windows=1, episodes=1, parts=(0,))
    diagnosis.document.update({"parameters": {}, "absorbed": {}, "next_experiment": {}})
    for kind in ("centre", "before", "after", "error"):
        diagnosis.arrays[f"bin/{kind}"] = np.zeros_like(diagnosis.arrays[f"bin/{kind}"])
    return diagnosis


def many():
    """An arm with more outputs, effects and candidates than fit on a screen."""
    sites = [f"joint_{k}" for k in range(6)]
    diagnosis = make(
        {f"q{k}": ("rad", 1e-3) for k in range(6)}, [COULOMB | {"site": site} for site in sites], windows=6
    )
    diagnosis.document["candidates"] += [
        _candidate("cogging", f"joint_{k}", 1.0, None, "it explains nothing") for k in range(200)
    ]
    return diagnosis


RECORDS = {
    "plain": make,
    "full": full,
    "explained": lambda: make(effects=()),
    "nothing-found": nothing_found,
    "short": short,
    "many": many,
}


@pytest.fixture(scope="module", params=RECORDS)
def record(request):
    diagnosis = RECORDS[request.param]()
    return diagnosis, Page(render(diagnosis, PROVENANCE))


def printed(diagnosis, width: int) -> str:
    out = io.StringIO()
    print_diagnosis(diagnosis, Console(file=out, width=width), "runs/diagnosis")
    return out.getvalue()


def test_a_clock_of_an_epoch_is_drawn_since_the_start():
    plain, epoch = make(), make()
    row = [c["against"] for c in epoch.attributes["curves"]].index("time")
    epoch.arrays["bin/centre"][row] += 1.7e9
    epoch.arrays["step/time"] = epoch.arrays["step/time"] + 1.7e9
    x, title = diagnosis_plots.drawn_against(epoch, row)
    assert title == "time since the start [s]"
    np.testing.assert_allclose(x, diagnosis_plots.drawn_against(plain, row)[0], atol=1e-6)
    drawn = diagnosis_plots.localisation(epoch, 0)["data"][row]["x"]
    assert len(set(drawn)) == len(x), "six digits tell them apart"


# ---- the page ----


def test_page_fetches_nothing(record):
    _, page = record
    fetching = {"src", "href", "action", "data", "srcset", "poster", "formaction", "ping", "background"}
    assert [a for a in page.attributes if a[1] in fetching] == []
    assert "default-src 'none'" in next(v for t, n, v in page.attributes if t == "meta" and n == "content")


def test_every_plot_has_its_place_and_every_place_its_plot(record):
    _, page = record
    assert len(page.ids) == len(set(page.ids))
    assert {v for t, n, v in page.attributes if t == "div" and n == "id"} == set(page.data["plots"])


def test_traces_find_their_curves(record):
    diagnosis, page = record
    expected = {"measured", "before", "residual"}
    expected |= {"after", "residual before"} if diagnosis.document["effects"] else set()
    for k in range(len(diagnosis.attributes["outputs"])):
        named = {t["meta"]["series"] for t in page.data["plots"][f"overlay-{k}"]["data"] if "meta" in t}
        assert named == {f"{kind}/{k}" for kind in expected}
        assert named <= set(page.data["curves"]["sets"]["log"])


def test_colours_have_names_in_the_style_sheet(record):
    _, page = record
    named = set(re.findall(r'"(--[a-z-]+)"', json.dumps(page.data["plots"])))
    style = files("capture_cli.report").joinpath("templates", "page.css").read_text(encoding="utf-8")
    assert {name for name in named if f"{name}:" not in style} == set()


def test_embedded_residuals_are_those_of_the_record():
    diagnosis = make()
    curves = Page(render(diagnosis, None)).data["curves"]
    view = curves["views"][3]
    assert "window 2 of episode 0 · fitted" in view["label"]
    rows = slice(120, 180)
    for series, kind in (("residual/0", "after"), ("residual before/0", "before")):
        values = np.frombuffer(base64.b64decode(curves["sets"]["log"][series]["bdata"]), "<f4")
        expected = diagnosis.arrays["step/measured"][rows, 0] - diagnosis.arrays[f"step/{kind}"][rows, 0]
        shown = values[view["first"] : view["last"]]
        np.testing.assert_allclose(shown, 1e3 * expected, rtol=1e-5)  # drawn in mm


def test_page_says_what_was_found():
    text = Page(render(full(), PROVENANCE)).text
    for said in (
        "unexplained The model lacks coulomb-friction@x and direction-dependent-viscous@x (or constant-force@x, "
        "control-bias@drive): with them the held-out error falls to",
        "times the noise floor: this is not all.",
        "This log cannot tell direction-dependent-viscous@x from constant-force@x or control-bias@drive.",
        "Take what was found as a part of the answer",
        "mass is at the end of its range",
        "coulomb-friction@x dry friction of constant size in a joint friction N 21.83 0.20 21.44 to 22.22",
        "– 0.00025",
        "-39.74 0.63 -40.97 to -38.50 -354 354 < 1e-16 0.00025",
        "direction-dependent-viscous@x is tied with constant-force@x and control-bias@drive",
        "As a formula missing force at x = -3.2 v|v| With it the error is 1.10 × noise floor on held-out data.",
        "x: v|v| -3.21 0.12 N per (m/s)^2",
        "damping N s/m 425.4 191.1 2.0",
        "-116 sd had absorbed",
        "not determined , at its bound",
        "cogging x 16.3 1.40 × no better than coulomb-friction@x, with more parameters",
        "constant-force x 12.0 1.03 × tied: this log cannot tell",
        "wind the whole model 0 – it moves no output of this log",
        "Next experiment Hold the carriage at 0.1 m",
        "1 of 4 episodes held out; windows: 6 fitted, 3 selecting, 3 held out",
        "4 March 2025",
    ):
        assert said in text, said


def test_errors_stand_beside_the_floor():
    text = Page(render(make(), None)).text
    rmse = [s["test"]["rmse"]["q"] for s in make().document["stages"]]
    assert f"{1e6 * rmse[0]:.0f} → {1e6 * rmse[-1]:.1f} µm" in text
    assert (
        f"{100 * rmse[-1] / rmse[0]:.0f} % 20.0 µm {rmse[-1] / 2e-5:.2f} × from high-order differences"
        in text
    )
    assert "all, over the noise floor" not in text
    both = make(OUTPUTS)
    ratio = [s["test"]["normalized"] for s in both.document["stages"]]
    page = Page(render(both, None))
    assert "all, over the noise floor" in page.text and f"{ratio[0]:.1f} → {ratio[-1]:.2f} ×" in page.text


def test_starts_that_hide_what_is_missing_are_named():
    """Of a crane without its friction 7.9 noise floors are left where it was fitted, and 15.8 where it was judged."""
    diagnosis = make()
    declared = diagnosis.document["stages"][0]
    assert "Trust the other errors" not in Page(render(diagnosis, None)).text
    declared["fit"]["normalized"] = 0.5 * declared["select"]["normalized"]
    assert "Trust the other errors" in Page(render(diagnosis, None)).text


def test_what_is_not_there_is_not_shown():
    plain = Page(render(make(), None)).text
    assert "Next experiment" not in plain and "As a formula" not in plain
    explained = Page(render(make(effects=()), None))
    assert "What the model lacks" not in explained.text and "absorbed" not in explained.data["plots"]
    assert "None was tried: nothing is missing." in explained.text
    assert "is left" not in explained.text and "with what was found" not in explained.text
    brief = Page(render(short(), None))
    assert set(brief.data["plots"]) == {"stages", "overlay-0"} and "view" not in brief.ids
    assert "Nothing was held out" in brief.text


def test_the_candidates_can_be_sorted_and_filtered():
    html = render(make(), None)
    page = Page(html)
    assert page.tags.count("input") == 1
    rows = re.findall(r'<tr>(<td data-key="[^"]*">.*?)</tr>', html, flags=re.DOTALL)
    keys = [re.findall(r'data-key="([^"]*)"', row) for row in rows]
    assert keys[0] == ["coulomb-friction", "x", "38.4", "1.02", "accepted"]
    assert keys[-1] == ["wind", "", "0.0", "", "it moves no output of this log"]
    assert len(keys) == len(make().document["candidates"])


def test_names_cannot_break_the_page():
    diagnosis = make({"<i>&": ("m", 1e-3)}, [COULOMB | {"site": "</script><b>"}])
    diagnosis.document["candidates"][0]["why_rejected"] = '"><b>'
    diagnosis.document["expression"] = {"text": "</pre>"}
    page = Page(render(diagnosis, PROVENANCE))  # raises where the tags do not match
    assert "coulomb-friction@</script><b>" in page.text and "<i>&" in page.text and "</pre>" in page.text


def test_many_outputs_are_folded():
    page = Page(render(many(), None))
    assert page.tags.count("details") == 6, "three overlays, three of where the residual arises"


def test_the_law_of_what_was_found_stands_in_its_page():
    page = render(RECORDS["full"](), PROVENANCE)
    assert (
        "coulomb-friction: <code>friction</code> (N or N m) is added to the joint&#39;s frictionloss." in page
    )
    assert "direction-dependent-viscous: <code>asymmetry</code> is added forward.</p>" in page
    of_six = render(RECORDS["many"](), None)
    assert of_six.count("(N or N m) is added to the joint&#39;s frictionloss.") == 1


@pytest.mark.parametrize("name", ["full", "short"])
def test_page_of_a_diagnosis_from_disk(name, tmp_path):
    RECORDS[name]().write(tmp_path)
    assert render(Diagnosis.read(tmp_path), PROVENANCE) == render(RECORDS[name](), PROVENANCE)


# ---- figures ----


@pytest.mark.parametrize("name", [name for name in RECORDS if name != "many"])  # drawn once, below
def test_figures(name, tmp_path):
    diagnosis = RECORDS[name]()
    written = {p.name for p in write_figures(diagnosis, tmp_path)}
    expected = {"before_after.png", "stages.png"}
    expected |= {"localisation.png"} if name != "short" else set()
    expected |= {"absorbed.png"} if diagnosis.document["absorbed"] else set()
    assert written == expected == {p.name for p in tmp_path.iterdir()}
    for path in tmp_path.iterdir():
        image = imread(path)[..., :3]
        assert image.shape[1] == 1350, "9 inches at 150 dpi"
        image = image[::3, ::3]
        assert 0.002 < np.mean(image.min(axis=2) < 0.9) < 0.6, "neither blank nor filled"


def test_a_figure_of_many_curves_has_those_that_account_for_most(tmp_path):
    diagnosis = many()
    own = diagnosis.attributes["curves"]
    often = [{**c, "share": c["share"] + 0.001 * k} for k in range(8) for c in own]
    diagnosis.attributes["curves"] = often
    bins = {n: np.tile(v, (8, 1)) for n, v in diagnosis.arrays.items() if n.startswith("bin/")}
    diagnosis.arrays.update(bins)
    drawn = []
    with pytest.MonkeyPatch.context() as patch:
        set_numbers(patch, processes, worth=np.inf)  # drawn here
        patch.setattr(
            diagnosis_figures, "_draw_curve", lambda axis, d, k, row: drawn.append(often[row]) or []
        )
        write_figures(diagnosis, tmp_path)
    assert imread(tmp_path / "localisation.png").shape[0] <= 150 * 24, "inches, of twelve rows"
    kept = sorted(c["share"] for c in drawn if c["output"] == "q0")
    assert kept == sorted(c["share"] for c in often if c["output"] == "q0")[-len(kept) :]


# ---- the terminal ----


@pytest.mark.parametrize("name", RECORDS)
def test_terminal_is_short(name):
    wide, narrow = (printed(RECORDS[name](), width).splitlines() for width in (140, 80))
    told = [line for line in (wide[: wide.index("")] if "" in wide else wide) if not line.startswith(" ")]
    assert len(told) <= 5 + 2 * (name == "full"), "and a formula and an experiment where there are"
    assert told[-1].split() == ["report", "runs/diagnosis/report.html"]
    assert len(wide) <= 12 and len(narrow) <= 12
    assert max(len(line) for line in narrow) <= 80 and "\x1b" not in "".join(narrow)


def test_terminal_says_what_was_found():
    lines = printed(make(), 120).splitlines()
    rmse = [1e6 * s["test"]["rmse"]["q"] for s in make().document["stages"]]
    assert lines[:5] == [
        "effect found, tied  The model lacks coulomb-friction@x and direction-dependent-viscous@x.",
        f"error      q {rmse[0]:.0f} → {rmse[-1]:.1f} µm on held-out data; noise floor 20.0 µm",
        "absorbed   damping 425 → 191 N s/m, mass 110 → 93.2 kg",
        "tied       direction-dependent-viscous@x with constant-force@x, control-bias@drive: this log cannot tell",
        "report     runs/diagnosis/report.html",
    ]
    assert re.search(r"coulomb-friction@x +friction +21\.83 N +21\.44 to 22\.22", "\n".join(lines))


def test_terminal_tells_the_sizes_of_several_effects_where_there_is_no_room_for_a_table():
    lines = printed(RECORDS["full"](), 80).splitlines()
    told = " ".join(" ".join(lines[lines.index(next(x for x in lines if x.startswith("report"))) :]).split())
    assert "coulomb-friction@x friction 21.83 N; direction-dependent-viscous@x" in told
    assert len(lines) <= 12


def test_terminal_tells_sizes_below_however_many_notes():
    diagnosis = make()
    diagnosis.document["impossible_inertia"] = [
        {"body": f"arm{k}", "moments": [0.001, 0.002, 0.004], "text": f"Note {k}. " + "word " * 30}
        for k in range(6)
    ]
    told = " ".join(printed(diagnosis, 80).split())
    assert "sizes coulomb-friction@x friction 21.83 N; direction-dependent-viscous@x" in told


def test_terminal_tells_the_size_of_a_single_effect_and_the_runner_up():
    lines = printed(make(effects=(COULOMB,)), 120).splitlines()
    found = "The model lacks coulomb-friction@x (friction 21.83 N): dry friction of constant size in a joint."
    assert lines[0] == f"effect found  {found}"
    assert lines[3] == "runner-up  cogging@x: no better than coulomb-friction@x, with more parameters"
    assert len(lines) == 5


def test_terminal_gives_no_number_for_what_the_log_does_not_say():
    diagnosis = make(effects=(COULOMB,))
    diagnosis.document["effects"][0]["parameters"]["friction"]["identifiable"] = False
    assert "coulomb-friction@x (friction not determined): dry" in printed(diagnosis, 120)


def test_terminal_names_the_outputs_that_had_been_farthest_from_their_floor():
    outputs = {name: ("m", 1e-3) for name in "abcd"}
    diagnosis = make(outputs, effects=(COULOMB,))
    first, last = (stage["test"]["rmse"] for stage in diagnosis.document["stages"])
    first.update(a=1.1e-3, b=1.2e-3, c=5e-3, d=4e-3)
    last.update(a=1.02e-3, b=1.03e-3, c=1.01e-3, d=1e-3)
    assert "(c 5.00 → 1.01 mm, d 4.00 → 1.00 mm)" in printed(diagnosis, 140)


def test_inertia_that_no_body_has_is_noted():
    diagnosis = make(effects=(COULOMB,))
    note = "No body has the moments of inertia of arm."
    diagnosis.document["impossible_inertia"] = [
        {"body": "arm", "moments": [0.001, 0.002, 0.004], "text": note}
    ]
    assert f"note       {note}" in printed(diagnosis, 120).splitlines()
    assert note in findings.notes(diagnosis.record) and note in render(diagnosis, None)


def test_terminal_says_that_none_of_these_explains_it():
    text = printed(nothing_found(), 140)
    assert (
        "None of these: the held-out error is 14.1 times the noise floor, and no effect of the catalogue"
        in text
    )
    assert "runner-up  cogging@x, of 1 candidates: it explains nothing (score 3)" in text
    ended = nothing_found()
    ended.document["out_of_time"] = "The time limit ended the search."
    assert findings.summary(ended.record).startswith(
        "In the time given no effect was found: the held-out error"
    )
    assert "where      drive accounts for 45 % of the residual acceleration of q" in text
    assert "Nothing is missing: the error is 1.02 times the noise floor." in printed(make(effects=()), 140)
    assert "and more." in printed(full(), 140)
    assert "missing force at x = -3.2 v|v| (1.10 × noise floor on held-out data)" in printed(full(), 140)


def test_terminal_knows_ascii():
    out = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    print_diagnosis(make(), Console(file=out, width=120), "runs/diagnosis")
    out.flush()
    text = out.buffer.getvalue().decode("ascii")
    assert "damping 425 -> 191 N s/m" in text and "?" not in text


# ---- words and numbers ----


def test_the_runner_up_has_the_least_error_where_any_was_refitted():
    document = make().document
    assert findings.closest_rejected(DiagnosisRecord.of(document))["effect"] == "cogging"
    for candidate in document["candidates"]:
        candidate["refit_select_error"] = None
    assert findings.closest_rejected(DiagnosisRecord.of(document))["effect"] == "stribeck-friction"
    assert findings.closest_rejected(make(effects=()).record) is None


def test_only_parameters_that_moved_beyond_chance_had_absorbed_something():
    document = make().document
    document["absorbed"]["mass"]["shift_in_sd"] = 1.2
    assert [row.name for row in findings.absorbing(DiagnosisRecord.of(document))] == ["damping"]
    assert "stayed" in Page(render(make_with(document), None)).text
    document["absorbed"]["damping"]["shift_in_sd"] = -0.3
    assert "absorbed   nothing" in printed(make_with(document), 100)


def make_with(document) -> Diagnosis:
    diagnosis = make()
    return Diagnosis(document, diagnosis.arrays, diagnosis.attributes)


def test_a_logarithm_where_errors_span_decades():
    diagnosis = make()
    assert diagnosis_plots.stages(diagnosis)["layout"]["xaxis"].get("type") is None
    diagnosis.document["stages"][0]["test"]["rmse"]["q"] = 1.0
    assert diagnosis_plots.stages(diagnosis)["layout"]["xaxis"]["type"] == "log"


def test_a_floor_far_below_is_told_in_its_own_unit():
    diagnosis = make()
    diagnosis.document["noise_floor"]["q"] = 1.7e-8
    found = findings.stage_errors(diagnosis)
    assert (found.unit, found.floor_text) == ("µm", "17.0 nm")
    assert diagnosis_plots.stages(diagnosis)["data"][-1]["text"] == ["17.0 nm"]


@pytest.mark.parametrize(
    ("unit", "derived"), [("m", "m/s^2"), ("m/s", "m/s^3"), ("rad", "rad/s^2"), ("1", "1/s^2")]
)
def test_unit_of_the_second_derivative(unit, derived):
    assert diagnosis_plots.acceleration_unit(unit) == derived
