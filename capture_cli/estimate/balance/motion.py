"""How the machine moved: positions, velocities and accelerations of all coordinates, smoothed from a log's outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from scipy.sparse import csr_array

from capture_cli.common.frozen import frozen
from capture_cli.errors import LogError
from capture_cli.estimate.balance.impacts import impacts
from capture_cli.estimate.balance.resting import Resting, model_start, resting
from capture_cli.estimate.balance.smoothing import FEWEST, Series, smooth
from capture_cli.log.arrays import Log
from capture_cli.log.white_noise import noise_and_spacing
from capture_cli.log.windows import stretches
from capture_cli.model.contacts import can_touch
from capture_cli.model.coordinate_sources import Source, sources_of
from capture_cli.model.object_names import object_name
from capture_cli.model.tasks.base import Task

SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


@frozen
class SETTINGS:
    """finest: points in the shortest time in which the smoothed motion turns, pi over its cut-off frequency.
    most_points: of all stretches. fewest_turns: in a mean stretch: of what moves like a parabola a few accelerations
    are wanted, too.
    """

    finest: float = 3.0
    most_points: int = 12_000
    fewest_turns: float = 12.0
    normal_median: float = 0.6745  # of the size of what is normally distributed, in standard deviations
    third_difference: float = 20.0  # variance of that of white noise, over the noise's
    tiny: float = 1e-12  # m or rad: the noise of a coordinate that is measured without any


@dataclass(frozen=True)
class SmoothedLog:
    """The outputs that positions follow from, each smoothed in every stretch between gaps.

    parts: the steps of the log in each stretch; sources: where each coordinate comes from; series[output][part].
    resting: what no sensor shows, at rest wherever there is a stretch. every: a point of evaluation is every so many
    samples. hits: whether steps were left out at which something is hit.
    """

    log: Log
    task: Task
    parts: Sequence[slice]
    sources: Sequence[Source]
    series: dict[int, list[Series]]
    resting: Resting
    every: int
    hits: bool = False

    @property
    def episode_start(self) -> np.ndarray:
        """The step at which the episode of each stretch begins, (stretch,)."""
        starts = np.array([e.start for e in self.log.episodes])
        return starts[np.searchsorted(starts, [p.start for p in self.parts], side="right") - 1]

    @classmethod
    def of(cls, log: Log, task: Task, within: np.ndarray | None = None) -> SmoothedLog:
        """The steps `within` (step,) of the log; all of them where None. Left out are those at which measured
        coordinates hit something, or what no sensor shows moves. Raises LogError where no stretch is left that is long
        enough to be smoothed.
        """
        sources = _sources(task)
        within = np.ones(len(log.time), dtype=bool) if within is None else within
        outputs = _between_samples(log, {c for s in sources for c in s.columns})
        hits = _hits(task.model, log, outputs, sources, within)
        within = within & ~hits
        smoothed = cls._smoothed(log, task, within, sources)
        rest = smoothed._rest(outputs)
        if not rest.rests[within].all():
            smoothed = cls._smoothed(log, task, within & rest.rests, sources)
        return replace(smoothed, resting=rest, hits=bool(hits.any()))

    @classmethod
    def _smoothed(cls, log: Log, task: Task, within: np.ndarray, sources: Sequence[Source]) -> SmoothedLog:
        """As of `of`, what no sensor shows as the model begins."""
        used = sorted({c for s in sources for c in s.columns})
        parts = [p for whole in stretches(log.time, log.sampled, log.episodes) for p in runs(whole, within)]
        parts = [p for p in parts if log.sampled[p][:, used].sum(axis=0).min(initial=len(log.time)) >= FEWEST]
        if not parts or not used:
            raise _too_short()
        series = _series(log, parts, used)
        count = sum(p.stop - p.start for p in parts)
        interval = min(float(np.median(np.diff(log.time[p]))) for p in parts)
        cutoff = max(s[0].cutoff for s in series.values())
        every = max(int(np.pi / cutoff / SETTINGS.finest / interval), -(-count // SETTINGS.most_points), 1)
        # one with fewer points is shorter than any row, and they do not determine a spline
        long = [n for n, p in enumerate(parts) if (p.stop - p.start) // every >= FEWEST]
        if not long:
            raise _too_short()
        parts = [parts[n] for n in long]
        series = {c: [own[n] for n in long] for c, own in series.items()}
        begins = Resting(np.repeat(model_start(task.model)[None], len(log.time), axis=0), within)
        return cls(log, task, parts, sources, series, begins, every)

    def _rest(self, outputs: np.ndarray) -> Resting:
        """What no sensor shows, carried along by the model where the rest moves as it was smoothed, and between
        stretches as the outputs (step, output) have it.
        """
        log, model = self.log, self.task.model
        shown = np.isin(np.arange(model.nv), self.dofs)
        if shown.all():
            return self.resting
        qpos, qvel = _positions(model, outputs, self.sources), np.zeros((len(log.time), model.nv))
        places = model.jnt_qposadr[model.dof_jntid]
        for episode in log.episodes:
            qvel[episode] = np.gradient(qpos[episode][:, places], log.time[episode], axis=0)
        for n, part in enumerate(self.parts):
            numbers = np.zeros((part.stop - part.start, 3, outputs.shape[1]))
            for column, series in self.series.items():
                for derivative in range(2):
                    numbers[:, derivative, column] = series[n].at(log.time[part], derivative)
            qpos[part], qvel[part], _ = self.states(numbers, np.arange(part.start, part.stop))
        return resting(self.task, log, qpos, qvel, shown)

    @property
    def dofs(self) -> np.ndarray:
        """The coordinates that sensors show, (coordinate,)."""
        return np.array(sorted(d for s in self.sources for d in s.dofs))

    def steps(self, part: int) -> np.ndarray:
        """The steps of the log at which forces are worked out in a stretch, (point,)."""
        own = self.parts[part]
        return np.arange(own.start, own.stop, self.every)

    def states(self, numbers: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """qpos (point, nq), qvel and qacc (point, nv) of outputs with slope and curvature (point, 3, output); step
        (point,): of the log. What no sensor shows rests.
        """
        model, count = self.task.model, len(numbers)
        qpos = self.resting.qpos[step]
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
        found = np.zeros_like(values)
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


def _too_short() -> LogError:
    return LogError(
        f"no stretch of the log has {FEWEST} samples of the positions of all joints that move, between impacts",
        cure="log the position of every joint, longer, or at a higher rate",
    )


def runs(whole: slice, within: np.ndarray) -> list[slice]:
    """The longest slices of `whole` in which every step is `within` (step,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], within[whole], [False]]).astype(int)))
    return [slice(whole.start + a, whole.start + b) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _sources(task: Task) -> list[Source]:
    """Where positions come from. Raises LogError naming a joint that is neither a hinge nor a slide."""
    model = task.model
    for joint in range(model.njnt):
        if int(model.jnt_type[joint]) not in SCALAR:
            name = object_name(model, "joint", joint)
            raise LogError(f"joint {name!r} is neither a hinge nor a slide", cure="")
    return [s for s in sources_of(model, [c.index for c in task.outputs]) if s.kind == "position"]


def _between_samples(log: Log, used: Sequence[int]) -> np.ndarray:
    """Outputs (step, output), with straight lines between samples of those that are `used`."""
    outputs = log.outputs.copy()
    for episode in log.episodes:
        for column in used:
            own = episode.start + np.flatnonzero(log.sampled[episode, column])
            if own.size:
                outputs[episode, column] = np.interp(
                    log.time[episode], log.time[own], log.outputs[own, column]
                )
    return outputs


def _positions(model: mujoco.MjModel, outputs: np.ndarray, sources: Sequence[Source]) -> np.ndarray:
    """qpos (step, nq) of outputs (step, output); what no sensor shows as the model begins."""
    qpos = np.repeat(model_start(model)[None], len(outputs), axis=0)
    for source in sources:
        qpos[:, source.qpos] = source.of(outputs[:, list(source.columns)])
    return qpos


def _hits(
    model: mujoco.MjModel, log: Log, outputs: np.ndarray, sources: Sequence[Source], within: np.ndarray
) -> np.ndarray:
    """Steps (step,), of those `within`, at which a measured coordinate may hit something."""
    hits = np.zeros(len(log.time), dtype=bool)
    if not can_touch(model):
        return hits
    third = np.concatenate([np.diff(outputs[e], n=3, axis=0) for e in log.episodes])
    noise = np.median(np.abs(third), axis=0) / SETTINGS.normal_median / np.sqrt(SETTINGS.third_difference)
    sd, travel = np.zeros(model.nv), np.zeros((len(log.time), model.nv))
    for source in sources:
        sd[list(source.dofs)] = np.maximum(source.noise(noise), SETTINGS.tiny)
    qpos, places = _positions(model, outputs, sources), model.jnt_qposadr[model.dof_jntid]
    for episode in log.episodes:
        moved = np.abs(np.diff(qpos[episode][:, places], axis=0))
        travel[episode][1:] = moved
        travel[episode][:-1] = np.maximum(travel[episode][:-1], moved)
    hits[within] = impacts(model, qpos[within], sd, travel[within])
    return hits


def _series(log: Log, parts: Sequence[slice], columns: Sequence[int]) -> dict[int, list[Series]]:
    """The stretches of outputs, of samples whose noise is independent: behind a logger's filter not of each."""
    own = [[log.sampled[p, c] for p in parts] for c in columns]
    times = [[log.time[p][o] for p, o in zip(parts, some, strict=True)] for some in own]
    values = [
        [log.outputs[p, c][o] for p, o in zip(parts, some, strict=True)]
        for c, some in zip(columns, own, strict=True)
    ]
    found = {}
    for k, (_, spacing) in enumerate(noise_and_spacing(values, times)):
        every = spacing if min(len(t) for t in times[k]) >= spacing * FEWEST else 1
        thinned = [[series[::every] for series in part] for part in (times[k], values[k])]
        found[columns[k]] = smooth(*thinned, SETTINGS.fewest_turns)
    return found
