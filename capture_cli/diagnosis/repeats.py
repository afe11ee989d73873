"""Noise from repeats: episodes that were driven alike from the same start differ by noise alone.

Starts are never quite the same, and what they change goes on for as long as the machine remembers. So differences are
taken block by block, with a cubic off each: that holds what a slightly different start does within a block, and no
noise but the slowest. What is left is noise, white or not.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

FIRST = 9  # samples that tell whether two starts are the same
SAME = 5.0  # standard deviations of their difference
DEGREE = 3  # of the polynomial that a start's influence is within a block
FEWEST = 200  # degrees of freedom: with fewer the floor would be uncertain by more than 5 %


def repeats(
    time: np.ndarray,
    driven_by: Sequence[np.ndarray],
    outputs: np.ndarray,
    episodes: Sequence[slice],
    noise_sd: np.ndarray,
) -> list[list[slice]]:
    """Groups of two or more episodes with the same times, inputs and start.

    time (step,) s; driven_by: what drove each episode, arrays of any shape; outputs (step, output). noise_sd (output,):
    by how much the first samples may differ. Copies of an episode are no repeats of it.
    """
    groups: list[list[int]] = []
    for number in range(len(episodes)):
        for group in groups:
            first = group[0]
            same = _same_times(time[episodes[first]], time[episodes[number]]) and _same(
                driven_by[first], driven_by[number]
            )
            if same and _same_start(
                outputs[episodes[first]], outputs[episodes[number]], time[episodes[first]], noise_sd
            ):
                if not any(np.array_equal(outputs[episodes[o]], outputs[episodes[number]]) for o in group):
                    group.append(number)
                break
        else:
            groups.append([number])
    return [[episodes[i] for i in group] for group in groups if len(group) > 1]


def from_repeats(series: Sequence[np.ndarray], block: int) -> tuple[np.ndarray, int]:
    """Deviations of one output from the mean of its repeats, scaled to the noise's variance, and degrees of freedom.

    series: groups of repeats (repeat, step). block: samples in a row that one polynomial is taken off.
    """
    deviations, degrees = [], 0
    for group in series:
        repeated, steps = group.shape
        apart = group - group.mean(axis=0)
        for first, last in pairwise(np.linspace(0, steps, max(1, steps // block) + 1).astype(int)):
            size = last - first
            if size < 2 * (DEGREE + 1):
                continue
            basis, _ = np.linalg.qr(np.vander(np.linspace(-1, 1, size), DEGREE + 1))
            piece = apart[:, first:last].T
            left = piece - basis @ (basis.T @ piece)
            free = (size - DEGREE - 1) * (repeated - 1)
            deviations.append(left.ravel() * np.sqrt(size * repeated / free))
            degrees += free
    return np.concatenate([np.zeros(0), *deviations]), degrees


def _same_times(a: np.ndarray, b: np.ndarray) -> bool:
    if len(a) != len(b) or len(a) < FIRST:
        return False
    return bool(np.allclose(a - a[0], b - b[0], rtol=0, atol=1e-3 * np.median(np.diff(a))))


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    return a.shape == b.shape and bool(
        np.allclose(a, b, rtol=0, atol=1e-9 * max(np.abs(a).max(initial=0), 1e-300))
    )


def _same_start(a: np.ndarray, b: np.ndarray, time: np.ndarray, noise_sd: np.ndarray) -> bool:
    """Whether the values and slopes of two episodes (step, output) begin alike, within what noise can do."""
    since = time[:FIRST] - time[0]
    design = np.vander(since, 2)
    inverse = np.linalg.inv(design.T @ design)
    difference = inverse @ design.T @ (a[:FIRST] - b[:FIRST])  # slope and value, (2, output)
    sd = np.sqrt(2 * np.diag(inverse))[:, None] * noise_sd
    return bool((np.abs(difference) <= SAME * sd).all())
