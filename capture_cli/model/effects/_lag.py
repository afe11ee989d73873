"""Lags of first and second order, as kernels."""

import numpy as np


class Lag:
    """A first-order lag, x' = (control - x) / time_constant; the mean of x over the step."""

    def __init__(self, *, time_constant, timestep):
        steps = time_constant / timestep
        self.kept = np.exp(-1 / np.maximum(steps, 1e-12))  # of a deviation, from one step to the next
        self.mean = steps * (1 - self.kept)  # of a deviation, over the step
        self.state = None

    def __call__(self, control):
        before = control if self.state is None else self.state
        self.state = control + self.kept * (before - control)
        return control + self.mean * (before - control)


def second_order_step(time_constant, damping_ratio, timestep):
    """What a step leaves of a deviation (e, T e') that falls by T^2 e'' + 2 damping_ratio T e' + e = 0, T being the
    time_constant: the shares of both in the next e, and those in the next T e'.

    The matrix exponential, in terms of the poles (root - damping_ratio) / T and -(root + damping_ratio) / T.
    """
    turned = 1 / np.maximum(time_constant / timestep, 1e-12)  # the step in units of T
    root = np.sqrt(damping_ratio * damping_ratio - 1 + 0j)
    root = np.where(np.abs(root) < 1e-6, 1e-6, root)  # the limit of a double pole, to 1e-12
    slower = np.exp((root - damping_ratio) * turned)
    gap = np.expm1(-2 * root * turned)  # the faster of both over the slower, less 1
    even, odd = np.real(slower * (1 + gap / 2)), np.real(-slower * gap / (2 * root))
    return (even + damping_ratio * odd, odd), (-odd, even - damping_ratio * odd)


def left_behind(told):
    """By how much what has arrived at the controls of all steps `told` (step, row) is beyond the next, (step, row)."""
    return told - np.concatenate([told[1:], told[-1:]])
