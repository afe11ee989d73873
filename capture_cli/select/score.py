"""How much would an effect explain, judged at null, before it is fitted?

The sensitivities of the outputs to the effect's amplitudes are appended to those of the declared parameters; what the
parameters and the initial states can imitate is projected off; the step is kept within the ranges. What is left is the
decrease of the objective to be expected, to first order (a score test, Rao 1948, with the nuisances profiled out).
"""

from dataclasses import dataclass, replace

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.solve.linearization import Linearization, held_step
from capture_cli.model.parameters import SETTINGS as PARAMETERS


@frozen
class SETTINGS:
    step: float = 0.3  # of each parameter's range: how far the linear step may go


@dataclass(frozen=True)
class Score:
    """gain: expected decrease of the objective over the variance that would be left (chi-squared by chance).

    amplitudes (amplitude,): the step, in units of the amplitudes' ranges. parameters (parameter,): that of the
    parameters with it, in the unit cube. unabsorbed: share of the effect's sensitivity (in norm) that parameters
    and initial states cannot imitate. response (row,): what the step adds to the outputs, after that projection.
    """

    gain: float
    amplitudes: np.ndarray
    parameters: np.ndarray
    unabsorbed: float
    response: np.ndarray


def score(at: Linearization, sensitivity: np.ndarray, low: np.ndarray, high: np.ndarray) -> Score:
    """Score of an effect whose outputs change by `sensitivity` (window, row, amplitude) per range of amplitude.

    In units of the noise. low, high (amplitude,): how far each may go from null, in units of its range.
    """
    k = at.inflation
    size, added = at.by_parameter.shape[-1], sensitivity.shape[-1]
    both = replace(at, by_parameter=np.concatenate([at.by_parameter, sensitivity], axis=-1))
    hessian, gradient = both.normal(k)
    bottom = np.concatenate([np.maximum(-SETTINGS.step, -at.x), np.maximum(-SETTINGS.step, low)])
    top = np.concatenate([np.minimum(SETTINGS.step, 1 - at.x), np.minimum(SETTINGS.step, high)])
    step = held_step(hessian, gradient, k, bottom, top)
    alone = held_step(hessian[:size, :size], gradient[:size], k, bottom[:size], top[:size])
    gain = _decrease(hessian, gradient, step) - _decrease(hessian[:size, :size], gradient[:size], alone)
    free = ~(_held(at.x, step[:size]) | _held(at.x, alone))
    imitation = _imitation(hessian, size, free)
    left = hessian[size:, size:] - hessian[size:, :size] @ imitation
    total = np.square(sensitivity).sum()
    projected = _project(at, sensitivity - at.by_parameter @ imitation, k)
    remaining = max(float(at.objectives(k).sum()) - gain, 1e-3 * gain, 1e-300) / at.data.count
    return Score(
        gain=max(gain / max(remaining, 1.0), 0.0),
        amplitudes=step[size:],
        parameters=step[:size],
        unabsorbed=float(np.sqrt(max(np.trace(left), 0.0) / total)) if total > 0 else 0.0,
        response=(projected @ step[size:]).ravel() if added else np.zeros(at.residual.size),
    )


def _decrease(hessian: np.ndarray, gradient: np.ndarray, step: np.ndarray) -> float:
    return float(2 * gradient @ step - step @ hessian @ step)


def _held(x: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Which parameters (parameter,) `step` leaves at an end of their range: they imitate nothing more."""
    low, high = x < PARAMETERS.at_bound, x > 1 - PARAMETERS.at_bound
    return (low & (step <= PARAMETERS.at_bound)) | (high & (step >= -PARAMETERS.at_bound))


def _imitation(hessian: np.ndarray, size: int, free: np.ndarray) -> np.ndarray:
    """The parameter step (parameter, amplitude) that comes nearest to each amplitude's; 0 for those not free."""
    step = np.zeros((size, hessian.shape[0] - size))
    upper = hessian[:size, :size][np.ix_(free, free)]
    step[free] = np.linalg.pinv(upper, rcond=1e-12, hermitian=True) @ hessian[:size, size:][free]
    return step


def _project(at: Linearization, sensitivity: np.ndarray, k: float) -> np.ndarray:
    """The sensitivity (window, row, amplitude) less what the initial states imitate of it."""
    b = at.by_initial
    return sensitivity - b @ (at.initial_gain(k) @ (b.swapaxes(1, 2) @ sensitivity))
