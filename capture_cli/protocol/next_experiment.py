"""The experiment that would separate effects that a log leaves tied."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from capture_cli.multisine import multisine_tape
from capture_cli.protocol.fit import Fit
from capture_cli.protocol.model_fits import ModelFits
from capture_cli.sim.starts import model_starts
from capture_cli.sim.windows import Windows, cut
from capture_cli.tasks.base import Task

BANDS = ((0.1, 0.5), (0.5, 3.0), (3.0, 10.0))  # Hz
SHARES = (0.3, 1.0)  # of the largest input in the log
DURATION = 3.0  # s
RATE = 250.0  # Hz
ENOUGH = 3.0  # times the noise floor: a difference that a test will see
CHANCE = 2.0  # sd, over all samples together: of a smaller difference no test is sure


def next_experiment(fits: ModelFits, mine: Fit, others: Sequence[Fit], seed: int) -> dict[str, Any] | None:
    """The experiment, of a menu of multisines from rest, under which `mine` and its nearest rival differ most.

    None where the task has no inputs, or no experiment of the menu can be simulated. What was simulated for it is
    counted in `fits.rollouts`.
    """
    task, log = fits.prepared.task, fits.prepared.log
    peaks = np.array([*log.input_peaks.values()])
    if not task.inputs or not others or not peaks.any():
        return None
    best = None
    for band, share in product(BANDS, SHARES):
        asked = {
            "band_hz": list(band),
            "peaks": (share * peaks).tolist(),
            "duration_s": DURATION,
            "seed": seed,
        }
        windows = driven_window(task, *experiment_tape(task, asked))
        separation = min(_separation(fits, mine, other, windows) for other in others)
        if np.isfinite(separation) and (best is None or separation > best["separation"]):
            best = {**asked, "separation": separation}
    if best is None:
        return None
    return {**best, "text": _text(task, best, mine, others)}


def experiment_tape(task: Task, asked: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """The drive of an experiment as a diagnosis has it: time (step,) s and inputs (step, input), from rest."""
    time = experiment_times(task, asked["duration_s"])
    generator = np.random.default_rng(asked["seed"])
    peaks, band = np.array(asked["peaks"]), tuple(asked["band_hz"])
    return time, multisine_tape(task, time, peaks, band, generator, at_rest=True)


def experiment_times(task: Task, duration: float = DURATION) -> np.ndarray:
    """When an experiment of `duration` s has samples, s, (step,): no closer together than the task's steps."""
    interval = max(task.timestep, 1 / RATE)
    return interval * np.arange(int(duration / interval) + 1)


def driven_window(task: Task, time: np.ndarray, tape: np.ndarray) -> Windows:
    """One window under the inputs `tape` (step, input) at `time` (step,), in which nothing was measured: of no log."""
    windows = cut(
        time=time,
        inputs=tape,
        outputs=np.zeros((len(time), len(task.outputs))),
        episodes=[slice(0, len(time))],
        timestep=task.timestep,
        duration=None,
        linear=task.linear,
    )
    return replace(windows, first=None)


def _separation(fits: ModelFits, mine: Fit, other: Fit, windows: Windows) -> float:
    """RMS difference of the two models' outputs over the noise floor; NaN where one diverges."""
    starts = model_starts(fits.prepared.task.model, 1).starts
    outputs = []
    for fit in (mine, other):
        simulated = fits.simulator(fit.effects).simulate(windows, starts, fit.point[None])
        if simulated.diverged.any():
            return float("nan")
        outputs.append(simulated.outputs[0][windows.mask] / fits.prepared.noise.sd)
    return float(np.sqrt(np.square(outputs[0] - outputs[1]).mean()))


def _text(task: Task, best: Mapping[str, Any], mine: Fit, others: Sequence[Fit]) -> str:
    least = CHANCE / np.sqrt(len(experiment_times(task)) * len(task.outputs))
    peaks = ", ".join(f"{c.name} {p:.3g} {c.unit}" for c, p in zip(task.inputs, best["peaks"], strict=True))
    own = {e.name for e in mine.effects}
    rivals = sorted({e.name for o in others for e in o.effects} - own)
    low, high = best["band_hz"]
    if best["separation"] < least:
        return f"nothing that was tried tells it from {', '.join(rivals)}: here they may be one and the same"
    separate = (
        f"they would differ by {best['separation']:.2g} times the noise floor"
        if best["separation"] > ENOUGH
        else f"even so they would differ by no more than {best['separation']:.2g} times the noise floor"
    )
    return (
        f"to tell it from {', '.join(rivals)}: drive from rest for {DURATION:g} s with a multisine of "
        f"{low:g} to {high:g} Hz that peaks at {peaks}; {separate}"
    )
