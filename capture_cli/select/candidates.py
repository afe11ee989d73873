"""What a model may lack: every effect at every place, and how much of the residual each would explain at null."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, fields, replace
from typing import Any

import mujoco
import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.common.similarity import similarity
from capture_cli.estimate.checkpoint import what_is_there
from capture_cli.estimate.fit import Fit
from capture_cli.estimate.initial_states.local_motion import Neighbours, local_motion
from capture_cli.estimate.log_windows import clock
from capture_cli.estimate.part_fit import PartFit
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve.linearization import Linearization
from capture_cli.log.fastest import fastest
from capture_cli.log.windows import stretches
from capture_cli.model.coordinate_sources import sources_of
from capture_cli.model.effects import REGISTRY
from capture_cli.model.effects.base import Driven, Effect, JointMotion, Recordings, Reports, SeenLog
from capture_cli.model.effects.placed import Placed
from capture_cli.select.criterion import Support
from capture_cli.select.log_parts import select_folds
from capture_cli.select.narrow_peaks import NarrowPeaks
from capture_cli.select.reason import Reason, Rejection
from capture_cli.select.score import SETTINGS as SCORE
from capture_cli.select.score import Score, score


@frozen
class SETTINGS:
    # Best-scoring candidates that are fitted jointly, each time round: so many that differ, with so many like
    # each, no more than so many in all. A force of one direction can be a bias, a preload or a tilt: they
    # must not keep all others out.
    different: int = 5
    of_a_kind: int = 3
    refitted: int = 8
    alike: float = 0.99  # cosine of responses beyond which candidates are of a kind
    # Of an amplitude's range: a slope near null, and a secant further out to either side. Friction and stops
    # act one way.
    probes: tuple[float, ...] = (0.01, 0.1, -0.1)
    # Where none of those moves anything: what acts from a threshold on only, a limit that the controls never
    # come near
    far_probes: tuple[float, ...] = (0.5, -0.5, 0.8, -0.8, 0.9, -0.9, 0.95, -0.95)
    # values tried of an effect's one shape, or of each of several
    shapes: int = 5
    shapes_of_several: int = 3
    # Times what is left to explain: a probe that changes outputs by more says little of small values, and
    # smaller ones, by so much, are tried as well. A range may be too wide: of a force that grows with a cube,
    # on a wheel that keeps turning.
    too_much: float = 50.0
    most_too_much: float = 1e4


@frozen
class WORTH:
    """When a score at null is no reason to fit. smallest_gain: of the objective, over the variance that would be left,
    below which it is chance; the best of n shapes has 2 log(n) more. promising: of what is left above the noise, below
    which it promises too little, though a fit may find more. absorbed: of a sensitivity, what must be left once the
    declared parameters have imitated it: differences err so much.
    """

    smallest_gain: float = 12.0
    promising: float = 0.01
    absorbed: float = 0.005


# of a candidate, and of its score, what a round says
SCORED = ("start", "start_elsewhere", "shapes_tried")
REJECTION = "rejection"
SCORE_FIELDS = tuple(f.name for f in fields(Score))


@dataclass
class Candidate:
    """An effect at a site, and what became of it in the last round that it was tried in.

    start: where a refit begins; start_elsewhere: at another peak, of an effect that repeats.
    """

    placed: Placed
    score: Score | None = None
    start: np.ndarray | None = None
    fit: Fit | None = None
    select: PartFit | None = None
    support: Support | None = None
    rejection: Rejection | None = None
    shapes_tried: int = 1
    start_elsewhere: np.ndarray | None = None

    @property
    def name(self) -> str:
        return self.placed.name


def told(candidate: Candidate) -> dict[str, Any]:
    """What its score says of it, by name; what is None is left out."""
    out = {} if candidate.rejection is None else {REJECTION: candidate.rejection.document()}
    return {**out, **what_is_there(candidate, SCORED), **what_is_there(candidate.score, SCORE_FIELDS)}


def take(candidate: Candidate, value: Callable[[str], Any]) -> None:
    """Let its score say what was `told`, of which `value` gives what is called so, or None."""
    for name in SCORED:
        setattr(candidate, name, value(name))
    out = value(REJECTION)
    candidate.rejection = None if out is None else Rejection.from_document(out)
    candidate.score = None if value("gain") is None else Score(*map(value, SCORE_FIELDS))


def all_candidates(prepared: PreparedLog) -> list[Candidate]:
    """Every effect at every site of the model that could show in the log."""
    model = _as_driven(prepared)
    every = [Placed(name, cls(model, site)) for name, cls in REGISTRY.items() for site in cls.sites(model)]
    windows, log = prepared.windows, prepared.log
    known = SeenLog(
        window=float(windows.grid_steps.max() * windows.timestep),
        longest=log.longest,
        logged=frozenset(c.index for c in prepared.task.outputs),
        seen=_seen(prepared),
        reports=_reports(prepared),
        recordings=_recordings(prepared),
        driven=Driven(clock(log), _controls(prepared), log.episodes),
    )
    for _, effect in every:
        effect.look_in(known)
    return [Candidate(e) for e in every if e.effect.shows]


def _seen(prepared: PreparedLog) -> dict[int, JointMotion]:
    """The motion of each joint whose position outputs say, alone or together."""
    model, reported, log = prepared.task.model, prepared.initial.reported, prepared.log
    if reported is None:
        return {}
    known = stretches(log.time, log.sampled, log.episodes)
    controls = _controls(prepared)
    seen = {}
    for source in sources_of(model, [c.index for c in prepared.task.outputs]):
        joint = int(model.dof_jntid[source.dofs[0]])
        if source.kind != "position" or model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            continue
        columns = list(source.columns)
        measured = log.sampled[:, columns].all(axis=1)
        path = np.where(measured, source.of(log.outputs[:, columns])[:, 0], np.nan)
        if not measured.any():
            continue
        low, high = np.nanmin(path), np.nanmax(path)
        noise = float(source.noise(prepared.noise.sd)[0])
        begun = np.abs(source.slope_of(reported.derivatives[:, 1, list(source.data)])).max()
        speed = max(begun, fastest(path, log.time, known, noise))  # windows may all begin at rest
        if low < high and speed > 0:
            seen[joint] = JointMotion(
                float(low),
                float(high),
                float(speed),
                path,
                known,
                noise,
                log.time,
                controls,
                *_begun(path, log.time, known, noise),
            )
    return seen


def _begun(
    path: np.ndarray, time: np.ndarray, known: Sequence[slice], noise: float
) -> tuple[np.ndarray, np.ndarray]:
    """How fast a `path` (step,) was where each of the `known` stretches was first measured, per s, and its standard
    deviation, (stretch,) each; 0 of what was not.
    """
    speed, sd = np.zeros((2, len(known)))
    own = np.flatnonzero(np.isfinite(path))
    first, stop = np.array([(s.start, s.stop) for s in known]).T
    at = np.append(own, len(path))[np.searchsorted(own, first)]
    some = np.flatnonzero(at < stop)
    near = Neighbours.of(time, at[some], first[some], stop[some], own)
    motion = local_motion(near, path[near.index][..., None], np.array([noise]))
    speed[some], sd[some] = motion.slope[:, 0], motion.slope_sd[:, 0]
    return speed, sd


def _controls(prepared: PreparedLog) -> dict[int, np.ndarray]:
    """The logged control of each actuator that the log drives, (step,), by its number."""
    return {c.index: prepared.log.inputs[:, k] for k, c in enumerate(prepared.task.inputs)}


def _recordings(prepared: PreparedLog) -> Recordings:
    """The recordings of the log; the reference is one of those that are fitted while effects are selected, too."""
    log, windows, is_test = prepared.log, prepared.windows, prepared.split.is_test
    fitted = np.isin(prepared.recording, prepared.recording[select_folds(windows, is_test).balance])
    samples = np.bincount(prepared.recording, weights=windows.samples * (fitted & ~is_test))
    of_step = np.repeat(log.recording, np.diff(log.episode_ends, prepend=0))
    return Recordings(of_step, clock(log), int(np.argmax(samples)))


def _reports(prepared: PreparedLog) -> Reports:
    """What outputs of the log say, as columns of sensordata."""
    log = prepared.log
    own, count = [c.index for c in prepared.task.outputs], prepared.task.model.nsensordata
    values, noise = np.full((len(log.time), count), np.nan), np.zeros(count)
    values[:, own], noise[own] = np.where(log.sampled, log.outputs, np.nan), prepared.noise.sd
    return Reports(log.time, values, stretches(log.time, log.sampled, log.episodes), noise)


def _as_driven(prepared: PreparedLog) -> mujoco.MjModel:
    """The model with actuators that take what the log gives them, and no more: ranges of effects follow from it."""
    model = copy(prepared.task.model)
    for channel, inputs in zip(prepared.task.inputs, prepared.log.inputs.T, strict=True):
        low, high = min(float(inputs.min()), 0.0), max(float(inputs.max()), 0.0)
        if model.actuator_ctrllimited[channel.index]:
            low, high = np.clip((low, high), *model.actuator_ctrlrange[channel.index])
        if low < high:
            model.actuator_ctrllimited[channel.index] = True
            model.actuator_ctrlrange[channel.index] = low, high
    return model


def score_at_null(narrow: NarrowPeaks, candidate: Candidate) -> None:
    """Fill in the candidate's score and where a refit should start, or why it is out."""
    candidate.score = None
    candidate.rejection = candidate.start_elsewhere = None
    shapes, tried = _shapes(narrow, candidate.placed.effect)
    candidate.shapes_tried = tried * len(candidate.placed.effect.states_scored)
    probed = _probed(narrow, candidate, shapes, SETTINGS.probes)
    if candidate.placed.effect.has_threshold or not (probed.moves or np.isinf(probed.size)):
        probed += _probed(narrow, candidate, shapes, SETTINGS.far_probes)
    elif probed.size > SETTINGS.too_much and candidate.placed.effect.parameters:
        little = SETTINGS.probes[0] / min(probed.size, SETTINGS.most_too_much)
        probed += _probed(narrow, candidate, shapes, (little, -little))
    if scored := sorted(probed.scored, key=lambda s: -s[0].gain):
        effect = candidate.placed.effect
        believed = [s for s in scored if not narrow.doubts(effect, s[1])] or scored
        candidate.score, candidate.start = believed[0]
        candidate.start_elsewhere = _at_another_peak(effect, [s for _, s in believed])
    if candidate.score is None:
        candidate.rejection = Rejection(Reason.DIVERGED)
    elif not probed.moves:
        candidate.rejection = Rejection(Reason.MOVES_NOTHING)
    elif candidate.score.unabsorbed < WORTH.absorbed:
        candidate.rejection = Rejection(Reason.IMITATED)
    elif candidate.score.gain < _least_gain(narrow.fit, candidate):
        candidate.rejection = Rejection(Reason.NO_SCORE, {"score": candidate.score.gain})


def _least_gain(fit: Fit, candidate: Candidate) -> float:
    """Of the objective over the variance that is left: a smaller one is no reason to fit the candidate."""
    by_chance = WORTH.smallest_gain + 2 * float(np.log(candidate.shapes_tried))
    return max(by_chance, gain_of(WORTH.promising, fit))


def gain_of(share: float, fit: Fit) -> float:
    """The gain of a score that promises this share of the squared error that `fit` leaves above the noise floor."""
    above_noise = fit.excess / max(fit.error**2, 1e-300)
    return share * above_noise * fit.at.data.count


@dataclass(frozen=True)
class _Probed:
    """scored: scores, and where a refit should start from each. moves: whether any probe moves an output. size: of what
    the smallest probes change, over what is left to explain; infinite where they diverge.
    """

    scored: list[tuple[Score, np.ndarray]]
    moves: bool
    size: float

    def __add__(self, other: _Probed) -> _Probed:
        return _Probed(self.scored + other.scored, self.moves or other.moves, self.size)


def _probed(
    narrow: NarrowPeaks, candidate: Candidate, shapes: np.ndarray, shares: Sequence[float]
) -> _Probed:
    """The candidate's effect at null, by probes.

    shapes (point, parameter): with null amplitudes. shares: of the amplitudes' ranges, at which each is probed.
    """
    effect, at = candidate.placed.effect, narrow.fit.at
    space = effect.space
    amplitudes = [i for i, n in enumerate(space.names) if n not in effect.shapes]
    probes, steps = _probes(effect, amplitudes, shapes, shares)
    states = np.repeat(effect.states_scored, len(probes), axis=0)
    probes, steps = (np.concatenate([a] * len(effect.states_scored)) for a in (probes, steps))
    residuals, diverged = narrow.fits.probe(narrow.part, narrow.fit, candidate.placed, probes, states)
    change = at.residual - residuals  # what the probe adds to the outputs
    if amplitudes:
        low = (space.low - space.nominal)[amplitudes] / space.span[amplitudes]
        high = (space.high - space.nominal)[amplitudes] / space.span[amplitudes]
    else:
        low, high = np.zeros(1), steps
    size = len(low)
    scored = []
    for first in range(0, len(probes), size):
        block = slice(first, first + size)
        if diverged[block].any():
            continue
        sensitivity = np.moveaxis(change[block] / steps[block][:, None, None], 0, -1)
        apart = effect.by_recording(sensitivity, probes[first], narrow.part.windows.first)
        found = _of_reference(at, apart, low, high)
        start = probes[first].copy()
        far = shares is SETTINGS.far_probes and found.amplitudes @ steps[block] > 0
        begin = steps[block] if far else found.amplitudes  # below its threshold an effect has no slope
        if amplitudes:
            start[amplitudes] = space.nominal[amplitudes] + begin * space.span[amplitudes]
        scored.append((found, np.clip(start, space.low, space.high)))
    if effect.mixes:
        scored += _mixed(at, effect, change, probes, steps)
    moved = np.linalg.norm(change.reshape(len(change), -1), axis=1) / np.linalg.norm(at.residual)
    moved[diverged] = np.inf
    smallest = np.abs(steps) == np.abs(steps).min()
    return _Probed(scored, bool(moved[~diverged].any()), float(np.median(moved[smallest])))


def _mixed(
    at: Linearization, effect: Effect, change: np.ndarray, probes: np.ndarray, steps: np.ndarray
) -> Iterator[tuple[Score, np.ndarray]]:
    """Scores of the effect with an amplitude at each of its shapes, and what does what those do.

    change (probe, window, row): by the `probes` (probe, parameter), whose amplitudes are at `steps` (probe,).
    """
    for step in dict.fromkeys(steps.tolist()):
        own = steps == step
        sensitivity = np.moveaxis(change[own] / step, 0, -1)
        if not np.isfinite(sensitivity).all():
            continue
        count = sensitivity.shape[-1]
        found = score(at, sensitivity, -np.ones(count), np.ones(count))
        values = effect.mixture(probes[own], found.amplitudes)
        if values is not None:
            # what more amplitudes explain by chance, each 1, is not counted
            gain = max(found.gain - count + 1, 0.0)
            yield replace(found, gain=gain), np.clip(values, effect.space.low, effect.space.high)


def _of_reference(at: Linearization, sensitivity: np.ndarray, low: np.ndarray, high: np.ndarray) -> Score:
    """The score of an effect, with the amplitudes of the reference where recordings have some of their own.

    sensitivity (window, row, amplitudes), those of the reference first; low, high (amplitude,). What more amplitudes
    explain by chance, each 1, is not counted.
    """
    own = len(low)
    times = sensitivity.shape[-1] // own
    found = score(at, sensitivity, np.tile(low, times), np.tile(high, times))
    return replace(found, gain=max(found.gain - (times - 1) * own, 0.0), amplitudes=found.amplitudes[:own])


def _at_another_peak(effect: Effect, starts: Sequence[np.ndarray]) -> np.ndarray | None:
    """The first of `starts`, best first, with another period than the first: a fit goes no further than one peak.

    Or with another limit, of what is at it for a while: there the error does not change with it.
    """
    if not (effect.narrow_shape or len(effect.states_scored) > 1):
        return None
    column = effect.space.names.index(effect.shapes[0])
    return next((s for s in starts[1:] if s[column] != starts[0][column]), None)


def _shapes(narrow: NarrowPeaks, effect: Effect) -> tuple[np.ndarray, int]:
    """Points (point, parameter) with null amplitudes at which to score, and how many they were chosen from."""
    if effect.narrow_shape:
        return narrow.points(effect)
    grid = effect.shape_grid(SETTINGS.shapes if len(effect.shapes) < 2 else SETTINGS.shapes_of_several)
    return grid, len(grid)


def _probes(
    effect: Effect, amplitudes: list[int], shapes: np.ndarray, shares: Sequence[float]
) -> tuple[np.ndarray, np.ndarray]:
    """Probe points (probe, parameter), one per amplitude after the other, and their steps in ranges (probe,).

    An effect without amplitudes is probed as a whole, as far as a linear step may go.
    """
    if not amplitudes:
        return shapes, np.full(len(shapes), SCORE.step)
    space = effect.space
    points, steps = [], []
    above, below = (space.high - space.nominal) / space.span, (space.nominal - space.low) / space.span
    two_sided = any(min(above[i], below[i]) >= max(shares) for i in amplitudes)
    for shape in shapes:
        for share in shares if two_sided else [s for s in shares if s > 0]:
            for i in amplitudes:
                point = shape.copy()
                step = share if (above if share > 0 else below)[i] >= abs(share) else -share
                point[i] = space.nominal[i] + step * space.span[i]
                points.append(point)
                steps.append(step)
    return np.array(points), np.array(steps)


def worth_a_refit(ranked: Sequence[Candidate]) -> tuple[list[Candidate], list[Candidate]]:
    """The candidates to fit jointly, and the others; ranked: by score, best first."""
    kinds: list[list[Candidate]] = []
    for candidate in ranked:
        own = next((k for k in kinds if _alike(k[0], candidate)), None)
        if own is not None:
            own.append(candidate)
        elif len(kinds) < SETTINGS.different:
            kinds.append([candidate])
    chosen = {id(c) for kind in kinds for c in _best_and_simplest(kind)}
    refitted = [c for c in ranked if id(c) in chosen][: SETTINGS.refitted]
    chosen = {id(c) for c in refitted}
    return refitted, [c for c in ranked if id(c) not in chosen]


def _best_and_simplest(kind: Sequence[Candidate]) -> list[Candidate]:
    """`of_a_kind` of a `kind`, ranked by score: the two best, and what is simpler than these, which may be all that is
    there.
    """
    others = sorted(kind[2:], key=lambda c: _size(c) >= _size(kind[0]))
    return [*kind[:2], *others][: SETTINGS.of_a_kind]


def _size(candidate: Candidate) -> int:
    _, effect = candidate.placed
    return len(effect.parameters)


def _alike(a: Candidate, b: Candidate) -> bool:
    """Whether they are one effect at variants of one site, or what they change is the same."""
    (kind, effect), (other_kind, other) = a.placed, b.placed
    if kind == other_kind and effect.variant_of == other.variant_of:
        return True
    return abs(similarity(a.score.response, b.score.response)) > SETTINGS.alike
