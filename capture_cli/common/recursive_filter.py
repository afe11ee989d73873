"""Linear filters with a memory, along a signal."""

from collections.abc import Sequence

import numpy as np


def recursively_filtered(zeros: Sequence[float], poles: Sequence[float], signal: np.ndarray) -> np.ndarray:
    """y with y[k] + poles[0] y[k - 1] + poles[1] y[k - 2] + ... = zeros[0] x[k] + zeros[1] x[k - 1] + ..., both null
    before they begin, of x = `signal` (step, ...).

    As scipy.signal.lfilter along the first axis, by a banded system; scipy.signal takes 0.4 s to load.
    """
    from scipy.linalg.lapack import dtbtrs  # loads for 0.14 s, and most effects that may filter do not

    x = signal.reshape(len(signal), -1)
    driven = np.zeros(x.shape, order="F")
    for late, factor in enumerate(zeros):
        driven[late:] += factor * x[: len(x) - late]
    band = np.repeat(np.array([[1.0, *poles]]), len(x), axis=0).T  # by columns, as LAPACK has it
    found, _ = dtbtrs(band, driven, uplo="L", overwrite_b=True)
    return found.reshape(signal.shape)


def recursion(transition: np.ndarray, driven: np.ndarray) -> np.ndarray:
    """x (step, state, row) with x[k + 1] = transition x[k] + driven[k], null at first; transition (state, state, row).

    Blocks of steps begin at 0 side by side, and what each begins with is added, so that few steps follow each other.
    What is not driven stays exactly 0, and a row is the same whatever the others are.
    """
    count, states, rows = driven.shape
    length = max(int(np.ceil(np.sqrt(count))), 1)
    blocks = -(-count // length)
    padded = np.zeros((blocks * length, states, rows))
    padded[:count] = driven
    inputs = padded.reshape(blocks, length, states, rows).transpose(1, 2, 0, 3)  # (step, state, block, row)
    found = np.zeros((length + 1, states, blocks, rows))
    powers = np.zeros((length + 1, states, states, rows))
    powers[0] = np.eye(states)[..., None]
    for k in range(length):
        found[k + 1] = _applied(transition, found[k]) + inputs[k]
        powers[k + 1] = _applied(transition, powers[k])
    begins = np.zeros((blocks, states, rows))
    for block in range(1, blocks):
        last = _applied(powers[-1], begins[block - 1, :, None])[:, 0]
        begins[block] = last + found[-1, :, block - 1]
    found = found[:-1]
    for state in range(states):
        found += powers[:-1, :, state, None] * begins[:, state]
    return found.transpose(2, 0, 1, 3).reshape(blocks * length, states, rows)[:count]


def _applied(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """matrices (state, state, row) times vectors (state, any, row)."""
    return sum(matrices[:, k, None] * vectors[k] for k in range(len(vectors)))
