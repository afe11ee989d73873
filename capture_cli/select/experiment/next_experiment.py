"""The experiment that would separate effects that a log leaves tied."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.fit import Fit
from capture_cli.estimate.initial_states.from_outputs import model_initial_states
from capture_cli.estimate.model_fits import ModelFits
from capture_cli.log.arrays import Log
from capture_cli.log.windows import Windows, cut
from capture_cli.model.tasks.base import Task
from capture_cli.select.experiment.excitation_range import ExcitationRange, Predicted
from capture_cli.simulate.multisine import multisine_sequence
from capture_cli.simulate.simulator import Simulator


@frozen
class SETTINGS:
    bands: tuple[tuple[float, ...], ...] = ((0.1, 0.5), (0.5, 3.0), (3.0, 10.0))  # Hz
    duration: float = 3.0  # s
    rate: float = 250.0  # Hz
    enough: float = 3.0  # times the noise floor: a difference that a test will see
    chance: float = 2.0  # sd, over all samples together: of a smaller difference no test is sure
    shares: tuple[float, ...] = tuple(0.5**k for k in range(8))  # of the largest input in the log


def next_experiment(
    fits: ModelFits, mine: Fit, others: Sequence[Fit], seed: int, shown: ExcitationRange
) -> dict[str, Any] | None:
    """The experiment, of a menu of multisines from rest, under which `mine` and its nearest rival differ most, of those
    under which all of these models stay near what the log shows; the one that takes them least far, where none does.

    Its `beyond_log` is that under which they differ most of all, or None where it is the same. None where the task has
    no inputs, or no experiment of the menu can be simulated. What was simulated for it is counted in `fits.rollouts`.
    """
    task, log = fits.prepared.task, fits.prepared.log
    peaks = np.array([*log.input_peaks.values()])
    if not task.inputs or not others or not peaks.any():
        return None
    menu = [
        {
            "band_hz": list(band),
            "peaks": (share * peaks).tolist(),
            "duration_s": SETTINGS.duration,
            "seed": seed,
        }
        for band, share in product(SETTINGS.bands, SETTINGS.shares)
    ]
    sequences = [experiment_sequence(task, asked)[1] for asked in menu]
    windows = driven_windows(task, experiment_times(task), np.stack(sequences))
    separation, predicted = _compared(fits, mine, others, windows, shown)
    sound = np.isfinite(separation)
    if not sound.any():
        return None
    near, most = (
        int(np.argmax(np.where(among, separation, -np.inf)))
        for among in (shown.nearest(predicted, sound), sound)
    )
    found = {
        k: {**menu[k], "separation": float(separation[k]), **shown.judged(predicted, k)} for k in (near, most)
    }
    farther_tells = found[near]["separation"] <= SETTINGS.enough < found[most]["separation"]
    where = shown.where_to(predicted, near, "none that was tried stays")
    text = _text(task, mine, others, found[near], where, farther_tells=farther_tells)
    if most == near:
        return {**found[near], "text": text, "beyond_log": None}
    where = shown.where_to(predicted, most, "it does not stay")
    beyond = {**found[most], "text": _text(task, mine, others, found[most], where)}
    return {**found[near], "text": text, "beyond_log": beyond}


def experiment_sequence(task: Task, asked: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """The drive of an experiment as a diagnosis has it: time (step,) s and inputs (step, input), from rest."""
    time = experiment_times(task, asked["duration_s"])
    generator = np.random.default_rng(asked["seed"])
    peaks, band = np.array(asked["peaks"]), tuple(asked["band_hz"])
    return time, multisine_sequence(task, time, peaks, band, generator, at_rest=True)


def experiment_times(task: Task, duration: float = SETTINGS.duration) -> np.ndarray:
    """When an experiment of `duration` s has samples, s, (step,): no closer together than the task's steps."""
    interval = max(task.timestep, 1 / SETTINGS.rate)
    return interval * np.arange(int(duration / interval) + 1)


def driven_windows(task: Task, time: np.ndarray, sequences: np.ndarray) -> Windows:
    """One window under each of `sequences` (window, step, input) at `time` (step,), of no log: nothing was measured."""
    count, steps = sequences.shape[:2]
    samples = Log(
        np.tile(time, count),
        np.zeros((count * steps, len(task.outputs))),
        [slice(steps * k, steps * (k + 1)) for k in range(count)],
        np.concatenate(sequences),
    )
    return replace(cut(samples, None, task.timestep, task.holds), first=None)


def driven_motion(
    simulator: Simulator, windows: Windows, point: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Outputs (window, step, output) and qpos (window, grid, nq) of a machine that is driven so from where its model
    initial states, and which windows diverge, (window,).

    What runs away need not be finite: it is said to stay where it began.
    """
    motion = simulator.motion(windows, model_initial_states(simulator.task.model, len(windows)).states, point)
    stays = motion.diverged[:, None, None]
    outputs, qpos = (np.where(stays, values[:, :1], values) for values in (motion.sensors, motion.qpos))
    return windows.sample(outputs, np.arange(len(windows))), qpos, motion.diverged


def _compared(
    fits: ModelFits, mine: Fit, others: Sequence[Fit], windows: Windows, shown: ExcitationRange
) -> tuple[np.ndarray, Predicted]:
    """RMS difference over the noise floor of the outputs of `mine` and its nearest rival, (window,), NaN where one
    diverges; and where any of them takes the machine.
    """
    interval = float(experiment_times(fits.prepared.task)[1])
    sampled, predicted, sound = [], None, np.ones(len(windows), dtype=bool)
    for fit in (mine, *others):
        outputs, qpos, diverged = driven_motion(fits.simulator(fit.effects), windows, fit.point)
        sound &= ~diverged
        sampled.append(outputs)
        own = shown.predicted(outputs, qpos, interval)
        predicted = own if predicted is None else predicted.joined(own)
    apart = [(sampled[0] - other) / fits.prepared.noise.sd for other in sampled[1:]]
    separation = np.min([np.sqrt(np.square(d).mean(axis=(1, 2))) for d in apart], axis=0)
    return np.where(sound, separation, np.nan), predicted


def _text(
    task: Task,
    mine: Fit,
    others: Sequence[Fit],
    asked: Mapping[str, Any],
    where: str,
    *,
    farther_tells: bool = False,
) -> str:
    """where: it takes the machine. farther_tells: whether one that takes it farther would do what this one does not."""
    least = SETTINGS.chance / np.sqrt(len(experiment_times(task)) * len(task.outputs))
    peaks = ", ".join(f"{c.name} {p:.3g} {c.unit}" for c, p in zip(task.inputs, asked["peaks"], strict=True))
    own = {e.name for e in mine.effects}
    rivals = ", ".join(sorted({e.name for o in others for e in o.effects} - own))
    low, high = asked["band_hz"]
    farther = "; one that goes farther would (propose --beyond-log)" if farther_tells else ""
    if asked["separation"] < least:
        if farther:
            return f"nothing that stays near what the log shows tells it from {rivals}{farther}"
        return f"nothing that was tried tells it from {rivals}: here they may be one and the same"
    separate = (
        f"they would differ by {asked['separation']:.2g} times the noise floor"
        if asked["separation"] > SETTINGS.enough
        else f"even so they would differ by no more than {asked['separation']:.2g} times the noise floor{farther}"
    )
    return (
        f"to tell it from {rivals}: drive from rest for {SETTINGS.duration:g} s with a multisine of "
        f"{low:g} to {high:g} Hz that peaks at {peaks}; {where}; {separate}"
    )
