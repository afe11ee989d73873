"""How far the log shows that a machine went, and whether a model would be taken further.

Of every output; of the rate of an output that is a position, where no other output is that velocity; and of every joint
that the model limits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.model.object_names import object_name
from capture_cli.model.quaternion_signs import is_quaternion
from capture_cli.model.tasks.base import Task


@frozen
class SETTINGS:
    margin: float = 0.5  # of the span that the log shows: what is no further beyond either end of it is near
    noise: float = 3.0  # sd, on top of that: of an output that stood still
    # of a joint's range: stops are springs, and what leans on one is a little beyond it
    stop_gives: float = 0.02


_S, _J = mujoco.mjtSensor, mujoco.mjtJoint
_VELOCITY = {
    _S.mjSENS_JOINTPOS: _S.mjSENS_JOINTVEL,
    _S.mjSENS_TENDONPOS: _S.mjSENS_TENDONVEL,
    _S.mjSENS_ACTUATORPOS: _S.mjSENS_ACTUATORVEL,
    _S.mjSENS_FRAMEPOS: _S.mjSENS_FRAMELINVEL,
}


@dataclass(frozen=True)
class Quantities:
    """What is judged of a task: its outputs, then rates of the outputs `rates` (rate,), then `joints` (joint,)."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    rates: tuple[int, ...]
    joints: tuple[int, ...]

    @classmethod
    def of(cls, task: Task) -> Quantities:
        model, outputs = task.model, task.outputs
        kinds = [_S(int(model.sensor_type[c.sensor])) for c in outputs]
        whose = [
            (
                int(model.sensor_objtype[c.sensor]),
                int(model.sensor_objid[c.sensor]),
                c.index - int(model.sensor_adr[c.sensor]),  # along x, y or z: some may not be logged
            )
            for c in outputs
        ]
        there = set(zip(kinds, whose, strict=True))
        rates = tuple(
            k
            for k, (kind, of) in enumerate(zip(kinds, whose, strict=True))
            if kind in _VELOCITY and (_VELOCITY[kind], of) not in there
        )
        turns = (int(_J.mjJNT_HINGE), int(_J.mjJNT_SLIDE))
        joints = tuple(
            j for j in range(model.njnt) if model.jnt_limited[j] and int(model.jnt_type[j]) in turns
        )
        names = [c.name for c in outputs] + [f"rate of {outputs[k].name}" for k in rates]
        names += [f"joint {object_name(model, 'joint', j)}" for j in joints]
        units = [c.unit for c in outputs] + [f"{outputs[k].unit}/s" for k in rates]
        units += ["rad" if int(model.jnt_type[j]) == turns[0] else "m" for j in joints]
        return cls(tuple(names), tuple(units), rates, joints)


@dataclass(frozen=True)
class Predicted:
    """Where a model takes a machine: ranges (episode, quantity, 2), its low and high ends, and `begin` (quantity,)."""

    ranges: np.ndarray
    begin: np.ndarray

    def joined(self, other: Predicted) -> Predicted:
        """Where either takes it."""
        low = np.minimum(self.ranges[..., 0], other.ranges[..., 0])
        return Predicted(
            np.stack([low, np.maximum(self.ranges[..., 1], other.ranges[..., 1])], axis=-1), self.begin
        )


@dataclass(frozen=True)
class ExcitationRange:
    """log (quantity, 2): from where to where each went, nan where the log does not show it. near (quantity, 2): what is
    near to that, and within the model's joint ranges; infinite where nothing bounds it.
    """

    task: Task
    log: np.ndarray
    near: np.ndarray

    @classmethod
    def of(
        cls,
        task: Task,
        noise_sd: np.ndarray,
        *,
        time: np.ndarray,
        window: np.ndarray,
        measured: np.ndarray,
        simulated: np.ndarray,
    ) -> ExcitationRange:
        """time (step,) s, window (step,): which each step is in; measured, simulated (step, output): NaN where there is
        no sample. Rates are of what was simulated, which has no noise, where that is where the machine was.

        noise_sd (output,). The four numbers of an attitude do not count: either sign of them is the same one.
        """
        told = Quantities.of(task)
        count = len(task.outputs)
        log = np.full((len(told.names), 2), np.nan)
        near = np.full((len(told.names), 2), np.inf) * [-1, 1]
        for k, channel in enumerate(task.outputs):
            own = measured[~np.isnan(measured[:, k]), k]
            if not own.size:
                continue
            log[k] = own.min(), own.max()
            if not is_quaternion(task.model, channel.sensor):
                near[k] = _widened(log[k], SETTINGS.noise * noise_sd[k])
        for number, k in enumerate(told.rates, start=count):
            rate = _rates(time, window, measured[:, k], simulated[:, k], near[k])
            if rate.size:
                log[number] = min(rate.min(), 0.0), max(rate.max(), 0.0)
                near[number] = _widened(log[number], 0.0)
        for number, j in enumerate(told.joints, start=count + len(told.rates)):
            low, high = task.model.jnt_range[j]
            near[number] = np.array([low, high]) + SETTINGS.stop_gives * (high - low) * np.array([-1, 1])
        return cls(task, log, near)

    @classmethod
    def from_document(cls, task: Task, predicted: Mapping[str, Any]) -> ExcitationRange:
        """What the `predicted` of a document was `judged` with. A quantity that is not in it has no bounds."""
        found = [predicted.get(name, {}) for name in Quantities.of(task).names]
        log = [own.get("log") or [np.nan, np.nan] for own in found]
        near = np.array([own.get("near") or [None, None] for own in found], dtype=float).reshape(-1, 2)
        return cls(task, np.array(log, dtype=float).reshape(-1, 2), np.where(np.isnan(near), _NONE, near))

    @cached_property
    def told(self) -> Quantities:
        return Quantities.of(self.task)

    def predicted(self, outputs: np.ndarray, qpos: np.ndarray, interval: float) -> Predicted:
        """Of outputs (episode, step, output) every `interval` s and qpos (episode, grid, nq), from the same start."""
        rates = np.diff(outputs[..., list(self.told.rates)], axis=1) / interval
        at_rest = np.zeros((len(outputs), 1, rates.shape[2]))
        joints = qpos[..., self.task.model.jnt_qposadr[list(self.told.joints)]]
        series = (outputs, np.concatenate([at_rest, rates], axis=1), joints)
        ranges = [np.stack([values.min(axis=1), values.max(axis=1)], axis=-1) for values in series]
        return Predicted(np.concatenate(ranges, axis=1), np.concatenate([values[0, 0] for values in series]))

    def excess(self, predicted: Predicted) -> np.ndarray:
        """How far each quantity goes beyond what is near, over the width of that, (episode, quantity); 0 of one that
        does not. From where the machine begins to what is near it may go: it is put there.
        """
        near = self._near(predicted)
        width = near[:, 1] - near[:, 0]
        low, high = predicted.ranges[..., 0], predicted.ranges[..., 1]
        beyond = np.maximum(np.maximum(near[:, 0] - low, high - near[:, 1]), 0.0)
        return beyond / np.where(width > 0, width, 1.0)

    def nearest(self, predicted: Predicted, sound: np.ndarray) -> np.ndarray:
        """Which of the `sound` episodes, (episode,), stay near all that the log shows; else the one that does best."""
        excess = np.where(sound, self.excess(predicted).max(axis=1), np.inf)
        return excess <= excess.min()

    def where_to(self, predicted: Predicted, episode: int, far: str) -> str:
        """In words, whether an episode stays near what the log shows; `far` begins the sentence where it does not."""
        if not self.excess(predicted)[episode].any():
            return "predicted to stay near what the log shows"
        return f"{far} near what the log shows: it would take {self._farthest(predicted, episode)}"

    def _farthest(self, predicted: Predicted, episode: int) -> str:
        """What goes farthest beyond, how far, and how far it went in the log."""
        k = int(np.argmax(self.excess(predicted)[episode]))
        low, high = predicted.ranges[episode, k]
        near, unit = self._near(predicted)[k], self.told.units[k]
        end = low if near[0] - low > high - near[1] else high
        shown = self.log[k] if not np.isnan(self.log[k]).any() else near
        whose = "log" if shown is not near else "its range"
        return f"{self.told.names[k]} to {end:.3g} {unit} ({whose} {shown[0]:.3g} to {shown[1]:.3g})"

    def judged(self, predicted: Predicted, episode: int) -> dict[str, Any]:
        """Of an episode, for a document: is_near, whether all stays near what the log shows, and `predicted`:
        {QUANTITY: {unit, range, log, near, is_near}}; log, and ends of near, are null where they are not known.
        """
        excess, near = self.excess(predicted)[episode], self._near(predicted)
        rows = {
            name: {
                "unit": self.told.units[k],
                "range": predicted.ranges[episode, k].tolist(),
                "log": None if np.isnan(self.log[k]).any() else self.log[k].tolist(),
                "near": [float(end) if np.isfinite(end) else None for end in near[k]],
                "is_near": bool(excess[k] == 0),
            }
            for k, name in enumerate(self.told.names)
        }
        return {"is_near": not bool(excess.any()), "predicted": rows}

    def _near(self, predicted: Predicted) -> np.ndarray:
        """What is near, with where the machine begins, (quantity, 2)."""
        begin = predicted.begin
        return np.stack([np.minimum(self.near[:, 0], begin), np.maximum(self.near[:, 1], begin)], axis=-1)


_NONE = np.array([-np.inf, np.inf])


def _widened(shown: np.ndarray, more: float) -> np.ndarray:
    """`shown` (2,), by `margin` of its span and `more` to either side."""
    return shown + (SETTINGS.margin * (shown[1] - shown[0]) + more) * np.array([-1, 1])


def _rates(
    time: np.ndarray, window: np.ndarray, measured: np.ndarray, simulated: np.ndarray, near: np.ndarray
) -> np.ndarray:
    """Rates, (n,), per s, of what was simulated where there are samples, within windows and `near` (2,)."""
    own = np.flatnonzero(~np.isnan(measured))
    sound = (simulated[own] >= near[0]) & (simulated[own] <= near[1])
    first = np.flatnonzero((np.diff(window[own]) == 0) & sound[1:] & sound[:-1])
    begin, end = own[first], own[first + 1]
    return (simulated[end] - simulated[begin]) / (time[end] - time[begin])
