"""Rotations of whole arrays of vectors; a rotation by nothing changes no bit."""

import numpy as np

from capture_cli.common.frozen import frozen


@frozen
class SETTINGS:
    largest_turn: float = 0.3  # rad, that a sensor may be off by


def rotate(vectors: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) turned by the rotation vectors (..., 3), in rad (Rodrigues)."""
    angle = np.linalg.norm(rotation, axis=-1, keepdims=True)
    once = np.cross(rotation, vectors)
    half_sine = np.sinc(angle / (2 * np.pi))  # sin(angle / 2) / (angle / 2), 1 at 0
    return vectors + np.sinc(angle / np.pi) * once + 0.5 * half_sine**2 * np.cross(rotation, once)


def rotate_quaternions(quaternions: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Unit quaternions (..., 4) turned, in the world, by the rotation vectors (..., 3), in rad."""
    return product(_turn(rotation), quaternions)


def rotate_in_own_frame(quaternions: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Unit quaternions (..., 4) turned, in their own frames, by the rotation vectors (..., 3), in rad."""
    return product(quaternions, _turn(rotation))


def _turn(rotation: np.ndarray) -> np.ndarray:
    """Unit quaternions (..., 4) of rotation vectors (..., 3), in rad."""
    angle = np.linalg.norm(rotation, axis=-1, keepdims=True)
    return np.concatenate([np.cos(angle / 2), 0.5 * np.sinc(angle / (2 * np.pi)) * rotation], axis=-1)


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Of quaternions (..., 4): the rotation b, then a."""
    w, v, x, u = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    return np.concatenate(
        [w * x - (v * u).sum(axis=-1, keepdims=True), w * u + x * v + np.cross(v, u)], axis=-1
    )


def body_vectors(quaternions: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) of frames with the orientations (..., 4), in the world."""
    axis = quaternions[..., 1:]
    twice = 2 * np.cross(axis, vectors)
    return vectors + quaternions[..., :1] * twice + np.cross(axis, twice)
