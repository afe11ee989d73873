"""Noise from repeats: episodes that were driven in the same way from the same start differ by noise alone.

Initial states are never quite the same, and what they change goes on for as long as the machine remembers. Before
anything is simulated, differences are taken block by block, with a cubic off each: that holds what a slightly different
start does within a block, and slow noise, too. Once there is a model, only what its initial states can do is taken off
(pure error: Box, Hunter & Hunter, Statistics for Experimenters, 2nd ed., section 10.3). What is left is noise, white or
not.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.solve.linearization import Linearization


@frozen
class SETTINGS:
    first: int = 9  # samples that tell whether two initial states are the same
    same: float = 5.0  # standard deviations of their difference
    degree: int = 3  # of the polynomial that a start's influence is within a block
    fewest: int = 200  # degrees of freedom: with fewer the floor would be uncertain by more than 5 %
    rounding: float = 1e-9  # of the largest number: by so much initial states may differ in any case
    # share of a row's noise that initial states cannot take: with less the row says nothing
    left_of_a_row: float = 0.1


SHORTEST = 2 * (SETTINGS.degree + 1)  # samples of such a block


def repeats(
    time: np.ndarray,
    driven_by: Sequence[np.ndarray],
    outputs: np.ndarray,
    episodes: Sequence[slice],
    noise_sd: np.ndarray,
    sampled: np.ndarray,
) -> list[list[int]]:
    """Groups of the numbers of two or more episodes with the same times, inputs and start.

    time (step,) s; driven_by: what drove each episode, arrays of any shape; outputs (step, output). noise_sd (output,):
    by how much the first samples may differ. sampled (step, output): where outputs have a sample. Copies of
    an episode are no repeats of it.
    """
    groups: list[list[int]] = []
    # only episodes that look the same are compared number by number
    by_look: dict[tuple, list[list[int]]] = {}
    for number, steps in enumerate(episodes):
        near = by_look.setdefault((steps.stop - steps.start, _about(driven_by[number])), [])
        for group in near:
            first = group[0]
            same = _same_times(time[episodes[first]], time[episodes[number]]) and _same(
                driven_by[first], driven_by[number]
            )
            pair = [(time[e], outputs[e], sampled[e]) for e in (episodes[first], episodes[number])]
            if same and _same_start(*pair, noise_sd):
                if not any(np.array_equal(outputs[episodes[o]], outputs[episodes[number]]) for o in group):
                    group.append(number)
                break
        else:
            near.append([number])
            groups.append(near[-1])
    return [group for group in groups if len(group) > 1]


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
            if size < SHORTEST:
                continue
            basis, _ = np.linalg.qr(np.vander(np.linspace(-1, 1, size), SETTINGS.degree + 1))
            piece = apart[:, first:last].T
            left = piece - basis @ (basis.T @ piece)
            free = (size - SETTINGS.degree - 1) * (repeated - 1)
            deviations.append(left.ravel() * np.sqrt(size * repeated / free))
            degrees += free
    return np.concatenate([np.zeros(0), *deviations]), degrees


def pure_error(at: Linearization, groups: Sequence[np.ndarray]) -> tuple[list[np.ndarray], np.ndarray]:
    """Deviations of each output from the mean of its repeats, and their degrees of freedom (output,).

    groups: windows (repeat,) that repeat each other. What their initial states can do to first order is taken off;
    deviations are in units of the noise that was assumed, and scaled to its variance.
    """
    steps, outputs = at.data.measured.shape[1:]
    deviations: list[list[np.ndarray]] = [[] for _ in range(outputs)]
    degrees = np.zeros(outputs)
    for group in groups:
        common = at.data.mask[group].all(axis=0)  # samples of one alone cannot be compared
        rows = common.ravel()
        apart = (at.residual[group] - at.residual[group].mean(axis=0)) * rows
        basis = _basis(at.by_initial[group].mean(axis=0) * rows[:, None])
        left = (apart - apart @ basis @ basis.T).reshape(len(group), steps, outputs)
        share = 1 - np.square(basis).sum(axis=1).reshape(steps, outputs)
        says = (share > SETTINGS.left_of_a_row) & common
        for k in range(outputs):
            own = says[:, k]
            scale = np.sqrt(len(group) / (len(group) - 1) / share[own, k])
            deviations[k].append((left[:, own, k] * scale).ravel())
            degrees[k] += share[own, k].sum() * (len(group) - 1)
    return [np.concatenate([np.zeros(0), *d]) for d in deviations], degrees


def _basis(sensitivity: np.ndarray) -> np.ndarray:
    """An orthonormal basis (row, direction) of what the columns of `sensitivity` (row, state) span."""
    left, sizes, _ = np.linalg.svd(sensitivity, full_matrices=False)
    return left[:, sizes > 1e-9 * sizes.max(initial=0.0)]


def _about(driven: np.ndarray) -> tuple:
    """What drove episodes that were driven in the same way has, too, but for rounding at worst."""
    return driven.shape, *(f"{value:.4g}" for value in (driven.min(initial=0), driven.max(initial=0)))


def _same_times(a: np.ndarray, b: np.ndarray) -> bool:
    if len(a) != len(b) or len(a) < SETTINGS.first:
        return False
    return bool(np.allclose(a - a[0], b - b[0], rtol=0, atol=1e-3 * np.median(np.diff(a))))


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    return a.shape == b.shape and bool(
        np.allclose(a, b, rtol=0, atol=1e-9 * max(np.abs(a).max(initial=0), 1e-300))
    )


# Of an episode: time (step,), outputs (step, output) and where they have samples
_Episode = tuple[np.ndarray, np.ndarray, np.ndarray]


def _same_start(a: _Episode, b: _Episode, noise_sd: np.ndarray) -> bool:
    """Whether the values and slopes of two episodes begin the same, within what noise can do.

    By the first samples of each output: those of one that is sparse are later ones, and not of the same steps.
    """
    return all(_same_line(*(_first_samples(e, k) for e in (a, b)), sd) for k, sd in enumerate(noise_sd))


def _first_samples(episode: _Episode, output: int) -> tuple[np.ndarray, np.ndarray]:
    """Times, from the first step on, and values of the first samples of an output, (sample,)."""
    time, outputs, sampled = episode
    steps = np.flatnonzero(sampled[:, output])[: SETTINGS.first]
    return time[steps] - time[0], outputs[steps, output]


def _same_line(a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray], noise_sd: float) -> bool:
    """Whether straight lines through two series (time, values) have the value and the slope in common."""
    lines, variances = [], []
    for time, values in (a, b):
        design = np.vander(time, 2)
        inverse = np.linalg.inv(design.T @ design)
        lines.append(inverse @ design.T @ values)
        variances.append(np.diag(inverse))
    rounding = SETTINGS.rounding * max(np.abs(values).max() for _, values in (a, b))
    sd = np.sqrt(variances[0] + variances[1]) * max(noise_sd, rounding)
    return bool((np.abs(lines[0] - lines[1]) <= SETTINGS.same * sd).all())
