"""How a body turned about chosen samples of its attitude, in three numbers that a polynomial can be fitted to."""

from dataclasses import replace

import mujoco
import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.initial_states.local_motion import SETTINGS as LOCAL_MOTION
from capture_cli.estimate.initial_states.local_motion import Neighbours

MOST_TURNED = 0.75 * np.pi  # rad, that a rotation vector is believed up to


@frozen
class SETTINGS:
    enough: int = 10  # samples up to there, to fit a polynomial to
    longer: float = 1.5  # times the interval before: a gap between samples


MOST_FOLLOWED = np.pi  # rad, that a body is followed from sample to sample, if that is fewest samples


def rotations(quaternions: np.ndarray, near: Neighbours) -> tuple[np.ndarray, Neighbours]:
    """How far a body had turned since the middle one of the samples `near` a place, (place, sample, 3) rad: three
    numbers whose derivative there is its angular velocity, in its own frame; and the samples at which they are known.

    quaternions (place, sample, 4), w first, of any length. Rotation vectors, whose noise is that of the attitude, while
    they are MOST_TURNED: they end at half a turn, and go wild at a whole one. A body that has few samples up to there
    is followed from sample to sample.
    """
    from scipy.spatial.transform import Rotation

    places, samples = quaternions.shape[:2]
    last_w = quaternions[..., [1, 2, 3, 0]]
    middle = np.repeat(last_w[:, LOCAL_MOTION.half_widths[-1]], samples, axis=0)
    from_middle = Rotation.from_quat(middle).inv() * Rotation.from_quat(last_w.reshape(-1, 4))
    vectors = from_middle.as_rotvec().reshape(places, samples, 3)
    before, after = (Rotation.from_quat(q.reshape(-1, 4)) for q in (last_w[:, :-1], last_w[:, 1:]))
    steps = (before.inv() * after).as_rotvec().reshape(places, samples - 1, 3)
    angle = np.linalg.norm(steps, axis=2)
    certain = near.known & _as_yet(_followed(angle, near))
    known = certain & _as_yet(np.linalg.norm(vectors, axis=2) <= MOST_TURNED)
    fast = np.flatnonzero((known.sum(axis=1) < SETTINGS.enough) & (known != near.known).any(axis=1))
    if len(fast):
        vectors[fast] = _integral(steps[fast], near.time[fast])
        known[fast] = _needed(angle[fast], near.known[fast], certain[fast])
    return vectors, replace(near, known=known)


def _as_yet(holds: np.ndarray) -> np.ndarray:
    """Where something `holds` (place, sample) at all samples from the middle one on, either way."""
    holds, centre = holds.copy(), LOCAL_MOTION.half_widths[-1]
    for side in (holds[:, centre:], holds[:, centre::-1]):
        np.logical_and.accumulate(side, axis=1, out=side)
    return holds


def _integral(steps: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Of the angular velocity, (place, sample, 3) rad, from the middle sample on; from the rotation vectors from each
    sample to the next, (place, sample - 1, 3). time (place, sample), s.

    The rotation vector of a step of h s is h w + h^3 / 12 w x w', but for h^5, where w is the angular velocity in the
    body's frame halfway (Magnus).
    """
    interval = np.diff(time)[..., None]
    rate = np.divide(steps, interval, out=np.zeros_like(steps), where=interval > 0)
    moved = steps - interval**3 / 12 * np.cross(rate, _change(rate, interval))
    path = np.concatenate([np.zeros_like(moved[:, :1]), np.cumsum(moved, axis=1)], axis=1)
    return path - path[:, [LOCAL_MOTION.half_widths[-1]]]


def _change(rate: np.ndarray, interval: np.ndarray) -> np.ndarray:
    """Per s, of what was `rate` (place, step, 3) on average in steps of `interval` (place, step, 1) s; 0 s beyond the
    episode. From the steps before and after, or that of them which there is.
    """
    apart = (interval[:, 1:] + interval[:, :-1]) / 2
    apart = np.where((interval[:, 1:] > 0) & (interval[:, :-1] > 0), apart, 0.0)
    change = np.where(apart > 0, np.diff(rate, axis=1), 0.0)
    ends = ((0, 0), (1, 1), (0, 0))
    apart, change = np.pad(apart, ends), np.pad(change, ends)
    apart, change = apart[:, 1:] + apart[:, :-1], change[:, 1:] + change[:, :-1]
    return np.divide(change, apart, out=np.zeros_like(change), where=apart > 0)


def _followed(angle: np.ndarray, near: Neighbours) -> np.ndarray:
    """At which samples it is known how a body came there from the one before, (place, sample): not after a gap in which
    it may have gone half a turn, as fast as it was before. angle (place, sample - 1): rad, from each to the next.
    """
    centre, interval = LOCAL_MOTION.half_widths[-1], np.diff(near.time)
    speed = np.divide(angle, interval, out=np.zeros_like(angle), where=interval > 0)
    certain = np.ones(near.known.shape, dtype=bool)
    for side, steps in (
        (np.s_[:, centre:], np.s_[:, centre:]),
        (np.s_[:, centre::-1], np.s_[:, centre - 1 :: -1]),
    ):
        longer, before = interval[steps][:, 1:], interval[steps][:, :-1]
        certain[side][:, 2:] = (longer < SETTINGS.longer * before) | (
            longer * speed[steps][:, :-1] < MOST_TURNED
        )
        # the first step from the middle has none before it: the one after it tells
        first, then = interval[steps][:, 0], interval[steps][:, 1]
        far = (first > SETTINGS.longer * then) & (first * speed[steps][:, 1] > MOST_TURNED) & (then > 0)
        certain[side][:, 1] = ~far
    return certain


def _needed(angle: np.ndarray, known: np.ndarray, certain: np.ndarray) -> np.ndarray:
    """Of samples that are `known`, and `certain` to be followed to, (place, sample): those that a polynomial needs.

    angle (place, sample - 1): rad, from each to the next. The noise of all steps adds up, and a polynomial does not
    follow far what tumbles.
    """
    centre = LOCAL_MOTION.half_widths[-1]
    number = np.abs(np.arange(known.shape[1]) - centre)
    path = np.pad(np.cumsum(angle, axis=1), ((0, 0), (1, 0)))
    away = np.abs(path - path[:, [centre]])
    needed = known
    for close in (
        certain,
        certain & (number < LOCAL_MOTION.fewest),
        certain & ((away < MOST_FOLLOWED) | (2 * number <= LOCAL_MOTION.fewest)),
    ):
        needed = np.where((close.sum(axis=1) >= LOCAL_MOTION.fewest)[:, None], close, needed)
    return needed


def turned(quaternions: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """Quaternions (place, 4), of any length, turned by rotation vectors (place, 3) of their own frames: of length 1."""
    found = np.ascontiguousarray(quaternions, dtype=float)
    for quaternion, rotation in zip(found, np.ascontiguousarray(rotations), strict=True):
        mujoco.mju_normalize4(quaternion)
        mujoco.mju_quatIntegrate(quaternion, rotation, 1.0)
    return found
