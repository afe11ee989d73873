"""The tables of evaluation.json, from the arrays of an evaluation. Shared by stages."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from capture_cli.stages.paired_comparison import ours_among, paired_comparison, six_digits

TABLE_ROUNDS = (5, 10, 15, 20, 30)  # the paper's, Table II
YARDSTICK = "domain-randomization"
NORMAL_QUANTILE = 1.959964  # of a 95 % interval


def summary(
    arrays: Mapping[str, np.ndarray], attributes: Mapping[str, Any], trainable: bool
) -> dict[str, Any]:
    """Means over pairs and seeds, JSON-able; "mean" is over pairs and seeds, "sd" that of the seeds' means."""
    seeds, pairs, entries = arrays["trajectory_difference"].shape[1:]
    reached = [r for r in TABLE_ROUNDS if r < entries] or [entries - 1]
    names = [p["name"] for p in attributes["parameters"]]
    span = np.array([p["high"] - p["low"] for p in attributes["parameters"]])
    difference = np.abs(arrays["estimates"] - arrays["target"][None, :, :, None]) / span
    yardstick = _yardstick(arrays, attributes)
    labels = [about["label"] for about in attributes["identifiers"]]
    paired = paired_comparison(labels, difference, ours_among(attributes["identifiers"]))
    identifiers = {}
    for k, about in enumerate(attributes["identifiers"]):
        trajectory = arrays["trajectory_difference"][k]
        of_seeds = trajectory.mean(axis=1)
        entry = {
            **{key: value for key, value in about.items() if key != "label"},
            "parameter_difference": {
                **{name: six_digits(difference[k, ..., j].mean(axis=(0, 1))) for j, name in enumerate(names)},
                "mean": six_digits(difference[k].mean(axis=(0, 1, 3))),
                "median": six_digits(np.median(difference[k].mean(axis=-1), axis=(0, 1))),
            },
            "trajectory_difference": six_digits(of_seeds.mean(axis=0)),
            "trajectory_difference_sd": six_digits(_sd(of_seeds)),
            "ratio": None if yardstick is None else six_digits(of_seeds.mean(axis=0) / yardstick),
            "success": None,
            "success_sd": None,
            "coverage": _coverage(arrays["sd"][k], difference[k] * span),
            "paired": paired[about["label"]],
            "simulated_rollouts": six_digits(arrays["simulated_rollouts"][k].mean(axis=(0, 1))),
        }
        if trainable:
            succeeded = arrays["success"][k].mean(axis=1)
            entry |= {"success": six_digits(succeeded.mean(axis=0)), "success_sd": six_digits(_sd(succeeded))}
        identifiers[about["label"]] = entry
    return {
        "task": attributes["task"],
        "noise": attributes["noise"],
        "policy": attributes["policy"]["name"],
        "pairs": pairs,
        "seeds": seeds,
        "rounds": entries - 1,
        "table_rounds": reached,
        "parameters": names,
        "yardstick": YARDSTICK if yardstick is not None else None,
        "identifiers": identifiers,
    }


def _yardstick(arrays: Mapping[str, np.ndarray], attributes: Mapping[str, Any]) -> float | None:
    """Trajectory difference of domain randomisation, over all its rounds: they are alike."""
    for k, about in enumerate(attributes["identifiers"]):
        if about["identifier"] == YARDSTICK:
            return float(arrays["trajectory_difference"][k].mean())
    return None


def _coverage(sd: np.ndarray, error: np.ndarray) -> list[float] | None:
    """Share of the truths in the 95 % intervals, by round; None where there are none.

    sd, error (seed, pair, round, parameter), in the parameters' units.
    """
    if np.isnan(sd[:, :, 1:]).any():
        return None
    return six_digits((error[:, :, 1:] <= NORMAL_QUANTILE * sd[:, :, 1:]).mean(axis=(0, 1, 3)))


def _sd(of_seeds: np.ndarray) -> np.ndarray:
    """Standard deviation over the seeds (seed, round) -> (round,); 0 where there is one."""
    return of_seeds.std(axis=0, ddof=1) if len(of_seeds) > 1 else np.zeros(of_seeds.shape[1])
