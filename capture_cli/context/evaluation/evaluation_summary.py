"""The tables of evaluation.json, from the arrays of an evaluation."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from capture_cli.common.quantities import NORMAL_QUANTILE

YARDSTICK = "domain-randomization"
OURS = "capture-refined"


def summary(
    arrays: Mapping[str, np.ndarray], attributes: Mapping[str, Any], trainable: bool
) -> dict[str, Any]:
    """Means over pairs and seeds, JSON-able; "mean" is over pairs and seeds, "sd" that of the seeds' means."""
    seeds, pairs, entries = arrays["trajectory_difference"].shape[1:]
    rounds = (5, 10, 15, 20, 30)  # the paper's, Table II
    of_worlds = (1, 3, 5, 7, 9)  # Tables III and IV
    shown = rounds if attributes["world"] == "plant" else of_worlds
    reached = [r for r in shown if r < entries] or [entries - 1]
    names = [p["name"] for p in attributes["parameters"]]
    span = np.array([p["high"] - p["low"] for p in attributes["parameters"]])
    difference = np.abs(arrays["estimates"] - arrays["target"][None, :, :, None]) / span
    means = zip(attributes["identifiers"], arrays["trajectory_difference"], strict=True)
    # over all its rounds: they are alike
    yardstick = next((float(own.mean()) for about, own in means if about["identifier"] == YARDSTICK), None)
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
        **{key: attributes[key] for key in ("task", "effects", "world", "robot", "noise")},
        "policy": attributes["policy"]["name"],
        "pairs": pairs,
        "seeds": seeds,
        "rounds": entries - 1,
        "table_rounds": reached,
        "parameters": names,
        "yardstick": YARDSTICK if yardstick is not None else None,
        "identifiers": identifiers,
    }


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


# --- ours against every other, pair by pair ---


def ours_among(identifiers: Sequence[Mapping[str, Any]]) -> str | None:
    """The label of OURS among {label, identifier, ...}: of several the one as in the paper, else the first."""
    labels = [about["label"] for about in identifiers if about["identifier"] == OURS]
    return OURS if OURS in labels else next(iter(labels), None)


def paired_comparison(
    labels: list[str], difference: np.ndarray, ours: str | None = OURS
) -> dict[str, dict[str, list[float]] | None]:
    """For each label: after every round, how often `ours` is nearer the truth than it; None where there is no such one.

    difference (identifier, seed, pair, entry, parameter): |estimate - truth| over the range, averaged here over
    parameters. nearer, as_near, further: pairs in which `ours` is; gained: the mean by which it is nearer, gained_se
    its standard error; p: of the sign test on nearer against further, two-sided.
    """
    if ours not in labels:
        return dict.fromkeys(labels)
    of_pairs = difference.mean(axis=-1).reshape(len(labels), -1, difference.shape[-2])
    own = of_pairs[labels.index(ours)]
    return {
        label: None if label == ours else _compared(other - own)
        for label, other in zip(labels, of_pairs, strict=True)
    }


def _compared(gained: np.ndarray) -> dict[str, list[float]]:
    """gained (pair, entry)."""
    from scipy.stats import binomtest

    as_near = 1e-3  # of the range: differences below this are none
    nearer, further = (gained > as_near).sum(axis=0), (gained < -as_near).sum(axis=0)
    pairs = len(gained)
    se = gained.std(axis=0, ddof=1) / np.sqrt(pairs) if pairs > 1 else np.zeros(gained.shape[1])
    trials = zip(nearer.tolist(), further.tolist(), strict=True)
    return {
        "nearer": nearer.tolist(),
        "as_near": (pairs - nearer - further).tolist(),
        "further": further.tolist(),
        "gained": six_digits(gained.mean(axis=0)),
        "gained_se": six_digits(se),
        "p": [float(binomtest(a, a + b).pvalue) if a + b else 1.0 for a, b in trials],
    }


def six_digits(values: np.ndarray) -> list[float]:
    """What a document says of values (round,)."""
    return [float(f"{v:.6g}") for v in values]
