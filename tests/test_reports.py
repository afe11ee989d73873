"""What `capture identify` shows: the page, the figures and the terminal tables say what the record says."""

from __future__ import annotations

import io
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from matplotlib.image import imread
from rich.console import Console

from capture_cli.reports import curves as curves_module
from capture_cli.reports.curves import Curves, autocorrelation, thin
from capture_cli.reports.estimate_page import render
from capture_cli.reports.curve_plots import MOST_POINTS, curve_views
from capture_cli.reports.figures import write_figures
from capture_cli.reports.findings import combination, correlation, notes, output_errors, sentence
from capture_cli.reports.quantities import bound, scaled_unit, significant, to_precision_of
from capture_cli.reports.terminal import print_estimate
from capture_cli.stores.estimate import SCHEMA, Estimate

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
    "options": {"identifier": "least-squares", "seed": 0, "config": None},
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
    """An estimate of a made-up machine: noise on the fitted windows, a slow residual above it on all of them."""
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
        "verdict": "unexplained",
        "rollouts": {"measured": windows, "simulated": 1240},
        "rounds": [
            {"parameters": dict(zip(parameters, p.tolist(), strict=True)), "error": float(e)}
            for p, e in zip(path, error, strict=True)
        ],
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
    document["split"] = {"how": "every fifth block", "fit_windows": 16, "test_windows": 4}
    document["noise_floor_source"] = {"q": "differences", "qd": "declared"}
    document["lack_of_fit"] = {
        "normalized": 1.72,
        "threshold": 1.05,
        "autocorrelation_time": 12,
        "text": "The residual is 1.72 times the noise floor; chance stays under 1.05.",
    }
    document["next_command"] = "capture diagnose --real-log slider.zarr --estimate out --out diagnosis"
    document["summary"] = "A slow residual 1.7 times the noise floor remains: the model lacks something."
    document["starts"] = {"refined": True}
    document["correlation"] = (0.5 * np.eye(4) + 0.5).tolist()
    return estimate
