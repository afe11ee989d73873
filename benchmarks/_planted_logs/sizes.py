"""How much an effect of some size shows: what the declared model, refitted, leaves, and what the refit pays for it.

The refit knows no noise: windows begin as the sensors show them, Gauss-Newton moves the declared parameters within
their bounds and each window's start as far as its prior lets it. Sensitivities are differences of simulations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks._planted_logs.machines import Experiment
from capture_cli.log.windows import Windows
from capture_cli.model.states import InitialStates
from capture_cli.simulate.simulator import Simulator

WINDOW = 0.5  # s
WINDOWS = 24  # spread over the log
ROUNDS = 12
DIFFERENCE = 1e-4  # of a parameter's range
# A start is read off some 15 samples: sd of position and of velocity (1/s), over the noise, with ten times the variance
# as the window's own samples are among them.
START_SD = (1.6, 50.0)
DAMPING = 1e-9  # of the largest curvature: directions that nothing shows stay
TINY = 1e-12  # of a range: the solver wants some room
SETTLED = 1e-3  # share of the squares that one more round must take off

CLOSE_ENOUGH = 0.1  # of what is to be left
TOO_FAR = 1.5  # times what is to be left
MOST_TRIALS = 10
FIRST_TRIAL = 0.03  # of the range
LARGEST_STEP = 30.0
SMALLEST_LEFT = 0.01  # below that a trial says little of where to go


@dataclass(frozen=True)
class Shown:
    """left: RMS of what the refitted model leaves, over the noise. shift (parameter,): how far the refit is from the
    truth, in standard deviations that the whole log gives.
    """

    left: float
    shift: tuple[float, ...]

    @property
    def error(self) -> float:
        """Of the refitted model, noise and all, over the noise."""
        return float(np.hypot(1.0, self.left))


class Refit:
    """The declared model of an experiment, fitted to outputs without noise."""

    def __init__(self, made: Experiment):
        self.made = made
        self.simulator = Simulator(made.task, threads=1)
        model = made.task.model
        joints = [model.sensor(c.sensor).objid[0] for c in made.task.outputs]
        self.qpos, self.dof = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        self.sd = np.concatenate([sd * made.noise_sd for sd in START_SD])  # of a start, (2 x output)
        self.columns = np.concatenate([self.dof, model.nv + self.dof])
        self.nothing = self._residual(made.outputs())

    def shown(self, outputs: np.ndarray | None) -> Shown:
        """By outputs (step, output) without noise; infinite where they are None."""
        space = self.made.task.space
        if outputs is None:
            return Shown(np.inf, (np.inf,) * len(space))
        windows, initial, share = self._windows(outputs)
        moved, point = np.zeros((len(windows), len(self.sd))), self.made.parameters
        best, shift, count = np.inf, np.zeros(len(space)), windows.mask.sum() * outputs.shape[1]
        for _ in range(ROUNDS):
            residual, by_point, by_initial = self._linearised(windows, initial, point, moved)
            squares = float((residual**2).sum())
            if squares < best:
                taken = (1 - squares / best) if np.isfinite(best) else 1.0
                sd = _standard_deviations(by_point, by_initial) / np.sqrt(share)
                best, shift = squares, (point - self.made.parameters) / space.span / sd
                if taken < SETTLED:
                    break
            bounds = ((space.low - point) / space.span, (space.high - point) / space.span)
            step, moves = _step(residual, by_point, by_initial, bounds)
            moved, point = moved + moves, point + step * space.span
        return Shown(float(np.sqrt(best / count)), tuple(shift.tolist()))

    def _windows(self, outputs: np.ndarray) -> tuple[Windows, InitialStates, float]:
        """Some windows, where they start, and how many times as many there are."""
        every = self.made.cut(outputs, WINDOW)
        windows = every.rows(np.unique(np.linspace(0, len(every) - 1, WINDOWS).astype(int)))
        return windows, self._starts(outputs, windows.first), len(every) / len(windows)

    def _residual(self, outputs: np.ndarray) -> np.ndarray:
        """What initial states that are a little off leave where nothing is missing, (window, step, output)."""
        windows, initial, _ = self._windows(outputs)
        outputs = self.simulator.simulate(windows, initial, self.made.parameters).outputs[0]
        return np.where(windows.mask[:, :, None], windows.measured - outputs, 0.0)

    def _starts(self, outputs: np.ndarray, first: np.ndarray) -> InitialStates:
        """As the sensors show them, at the steps `first` (window,); what none shows is as in the model."""
        model = self.made.task.model
        rates = np.concatenate(
            [_rates(outputs[e], self.made.time[e], model.opt.timestep) for e in self.made.episodes]
        )
        qpos, qvel = np.repeat(model.qpos0[None], len(first), axis=0), np.zeros((len(first), model.nv))
        qpos[:, self.qpos], qvel[:, self.dof] = outputs[first], rates[first]
        return InitialStates(qpos, qvel, np.zeros((len(first), model.na)), self.made.time[first])

    def _linearised(self, windows, initial, point, moved):
        """Residual (window, row) over the noise and its slopes by parameters, over their ranges, (window, row,
        parameter), and by initial states, over their sd, (window, row, start); priors of initial states are the last
        rows.
        """
        space, count = self.made.task.space, len(point) + len(self.sd)
        change = np.where(point + DIFFERENCE * space.span <= space.high, DIFFERENCE, -DIFFERENCE)
        points = np.repeat(point[None], 1 + count, axis=0)
        points[1 : 1 + len(point)] += np.diag(change * space.span)
        corrections = np.zeros(
            (1 + count, len(windows), 2 * self.made.task.model.nv + self.made.task.model.na)
        )
        corrections[:, :, self.columns] = moved * self.sd
        for i, column in enumerate(self.columns):
            corrections[1 + len(point) + i, :, column] += self.sd[i]
        outputs = self.simulator.simulate(windows, initial, points, corrections).outputs / self.made.noise_sd
        outputs = np.where(windows.mask[:, :, None], outputs, 0.0).reshape(1 + count, len(windows), -1)
        residual = ((windows.measured - self.nothing) / self.made.noise_sd).reshape(
            len(windows), -1
        ) - outputs[0]
        slopes = np.moveaxis(outputs[1:] - outputs[0], 0, -1)
        prior = np.repeat(np.eye(len(self.sd))[None], len(windows), axis=0)
        none = np.zeros((len(windows), len(self.sd), len(point)))
        return (
            np.concatenate([residual, -moved], axis=1),
            np.concatenate([slopes[..., : len(point)] / change, none], axis=1),
            np.concatenate([slopes[..., len(point) :], prior], axis=1),
        )


def _rates(outputs: np.ndarray, time: np.ndarray, timestep: float) -> np.ndarray:
    """Velocities (step, output) by central differences; MuJoCo's is that of the step before, half a step earlier."""
    rates = np.gradient(outputs, time, axis=0, edge_order=2)
    return rates - timestep / 2 * np.gradient(rates, time, axis=0)


def _without_starts(values: np.ndarray, by_initial: np.ndarray) -> np.ndarray:
    """What of `values` (window, row, column) no start takes up."""
    q, _ = np.linalg.qr(by_initial)
    return values - q @ (q.swapaxes(1, 2) @ values)


def _step(residual, by_point, by_initial, bounds) -> tuple[np.ndarray, np.ndarray]:
    """Of parameters (parameter,), within `bounds`, and of initial states (window, start): one Gauss-Newton step."""
    from scipy.optimize import lsq_linear

    joint = _without_starts(np.concatenate([by_point, residual[..., None]], axis=2), by_initial)
    triangle = np.linalg.qr(joint.reshape(-1, joint.shape[2]), mode="r")
    damped = np.vstack([triangle[:, :-1], DAMPING * np.abs(triangle).max() * np.eye(by_point.shape[2])])
    wanted = np.concatenate([triangle[:, -1], np.zeros(by_point.shape[2])])
    low, high = bounds
    step = lsq_linear(damped, wanted, (np.minimum(low, -TINY), np.maximum(high, TINY))).x
    step = np.clip(step, low, high)
    left = residual - by_point @ step
    return step, (np.linalg.pinv(by_initial) @ left[..., None])[..., 0]


def _standard_deviations(by_point: np.ndarray, by_initial: np.ndarray) -> np.ndarray:
    """Of the parameters, over their ranges, (parameter,), where noise is 1."""
    alone = _without_starts(by_point, by_initial).reshape(-1, by_point.shape[2])
    return np.sqrt(np.diag(np.linalg.pinv(alone.T @ alone, rcond=1e-12)))


def size(left: Callable[[float], float], magnitude: float) -> float | None:
    """The size at which `left`(size) is what an error of `magnitude` leaves; None where the range does not reach it, or
    it jumps across.

    Secant in logarithms, kept within a bracket.
    """
    wanted = np.sqrt(magnitude**2 - 1)
    below, above, tried, best = None, None, FIRST_TRIAL, (np.inf, FIRST_TRIAL)
    for _ in range(MOST_TRIALS):
        found = left(tried)
        best = min(best, (abs(np.log(max(found, 1e-9) / wanted)), tried))
        if abs(found / wanted - 1) < CLOSE_ENOUGH:
            return tried
        if found < wanted and tried >= 1.0:
            return None
        if found < wanted:
            below = (tried, max(found, SMALLEST_LEFT))
        else:
            above = (tried, found)
        tried = _next(below, above, wanted)
    return best[1] if best[0] < np.log(TOO_FAR) else None


def _next(below: tuple[float, float] | None, above: tuple[float, float] | None, wanted: float) -> float:
    """Where to try next, from the nearest (size, what it left) on either side of `wanted`."""
    if below is None or above is None:
        size, found = below or above
        return min(size * float(np.clip(wanted / found, 1 / LARGEST_STEP, LARGEST_STEP)), 1.0)
    (small, less), (large, more) = below, above
    share = np.log(wanted / less) / np.log(more / less) if np.isfinite(more) else 0.5
    return float(small * (large / small) ** np.clip(share, 0.1, 0.9))
