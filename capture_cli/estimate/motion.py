"""How the machine moved: positions, velocities and accelerations of all coordinates, smoothed from a log's outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.sparse import csr_array

from capture_cli.errors import LogError
from capture_cli.estimate.smoothing import FEWEST, Series, smooth
from capture_cli.sim.coordinate_sources import Source, sources_of
from capture_cli.sim.object_names import object_name
from capture_cli.sim.windows import stretches
from capture_cli.tasks.base import Task

SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
FINEST = 3.0  # points in the shortest time in which the smoothed motion turns: pi over its cut-off frequency
MOST_POINTS = 12_000  # of all stretches


@dataclass(frozen=True)
class Log:
    """What a log holds, as arrays: time (step,), s; inputs (step, input); outputs (step, output), which have a sample
    where `sampled` (step, output). episodes: their steps.
    """

    time: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    sampled: np.ndarray
    episodes: Sequence[slice]


@dataclass(frozen=True)
class SmoothedLog:
    """The outputs that positions follow from, each smoothed in every stretch between gaps.

    parts: the steps of the log in each stretch; sources: where each coordinate comes from; series[output][part].
    every: a point of evaluation is every so many samples.
    """

    log: Log
    task: Task
    parts: Sequence[slice]
    sources: Sequence[Source]
    series: dict[int, list[Series]]
    every: int

    @property
    def episode_start(self) -> np.ndarray:
        """The step at which the episode of each stretch begins, (stretch,)."""
        starts = np.array([e.start for e in self.log.episodes])
        return starts[np.searchsorted(starts, [p.start for p in self.parts], side="right") - 1]

    @classmethod
    def of(cls, log: Log, task: Task, within: np.ndarray | None = None) -> SmoothedLog:
        """The steps `within` (step,) of the log; all of them where None. Raises LogError where the positions of some
        joint cannot be told from the outputs, or no stretch is long enough to be smoothed.
        """
        sources = _sources(task)
        used = sorted({c for s in sources for c in s.columns})
        within = np.ones(len(log.time), dtype=bool) if within is None else within
        parts = [p for whole in stretches(log.time, log.sampled, log.episodes) for p in _runs(whole, within)]
        parts = [p for p in parts if log.sampled[p][:, used].sum(axis=0).min() >= FEWEST]
        if not parts:
            raise LogError(
                f"no stretch of the log has {FEWEST} samples of every joint's position",
                cure="record longer episodes, or at a higher rate",
            )
        series = {c: _smoothed(log, parts, c) for c in used}
        count = sum(p.stop - p.start for p in parts)
        interval = min(float(np.median(np.diff(log.time[p]))) for p in parts)
        cutoff = max(s[0].cutoff for s in series.values())
        every = max(int(np.pi / cutoff / FINEST / interval), -(-count // MOST_POINTS), 1)
        return cls(log, task, parts, sources, series, every)

    def steps(self, part: int) -> np.ndarray:
        """The steps of the log at which forces are worked out in a stretch, (point,)."""
        own = self.parts[part]
        return np.arange(own.start, own.stop, self.every)

    def states(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """qpos (point, nq), qvel and qacc (point, nv) of outputs with slope and curvature (point, 3, output)."""
        model, count = self.task.model, len(numbers)
        qpos = np.repeat(model.qpos0[None], count, axis=0)
        qvel, qacc = np.zeros((count, model.nv)), np.zeros((count, model.nv))
        for source in self.sources:
            own = numbers[:, :, list(source.columns)]
            qpos[:, source.qpos] = source.of(own[:, 0])
            qvel[:, source.dofs] = source.slope_of(own[:, 1])
            qacc[:, source.dofs] = source.slope_of(own[:, 2])
        return qpos, qvel, qacc

    def filtered(self, values: np.ndarray, part: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Series (point, nv) of the coordinates behind the filter that their accelerations went through; part, step
        (point,): of which stretch, and of the log, each point is.
        """
        found = np.empty_like(values)
        for source in self.sources:
            for n in range(len(self.parts)):
                own = part == n
                dofs = list(source.dofs)
                whole = self.series[source.columns[0]][n]
                found[np.ix_(own, dofs)] = whole.filtered(values[np.ix_(own, dofs)], self.log.time[step[own]])
        return found

    def filtering(
        self, rows: Sequence[csr_array], part: np.ndarray, step: np.ndarray
    ) -> list[list[csr_array]]:
        """Sums `rows` (row, point) over each stretch with the filter of each coordinate before them: [stretch][dof]."""
        found: list[list] = [[None] * self.task.model.nv for _ in self.parts]
        for source in self.sources:
            for n in range(len(self.parts)):
                whole = self.series[source.columns[0]][n].filtering(rows[n], self.log.time[step[part == n]])
                for dof in source.dofs:
                    found[n][dof] = whole
        return found

    def sd(self, derivative: int) -> np.ndarray:
        """Standard deviation of a derivative of each coordinate, (nv,), in the middle of the longest stretch."""
        longest = int(np.argmax([p.stop - p.start for p in self.parts]))
        own = np.zeros(len(self.task.outputs))
        for column, series in self.series.items():
            own[column] = series[longest].sd_of(derivative)
        found = np.zeros(self.task.model.nv)
        for source in self.sources:
            found[list(source.dofs)] = source.noise(own)
        return found


def _runs(whole: slice, within: np.ndarray) -> list[slice]:
    """The longest slices of `whole` in which every step is `within` (step,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], within[whole], [False]]).astype(int)))
    return [slice(whole.start + a, whole.start + b) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _sources(task: Task) -> list[Source]:
    """Where the position of each coordinate comes from. Raises LogError naming a joint of which nothing tells."""
    model = task.model
    found = [s for s in sources_of(model, [c.index for c in task.outputs]) if s.kind == "position"]
    known = {d for s in found for d in s.dofs}
    for joint in range(model.njnt):
        name = object_name(model, "joint", joint)
        if int(model.jnt_type[joint]) not in SCALAR:
            raise LogError(f"joint {name!r} is neither a hinge nor a slide", cure="")
        if int(model.jnt_dofadr[joint]) not in known:
            raise LogError(f"no output tells the position of joint {name!r}", cure="log its position")
    return found


def _smoothed(log: Log, parts: Sequence[slice], column: int) -> list[Series]:
    times, values = [], []
    for part in parts:
        own = log.sampled[part, column]
        times.append(log.time[part][own])
        values.append(log.outputs[part, column][own])
    return smooth(times, values)
