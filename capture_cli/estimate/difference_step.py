"""How long finite differences have to be: where bodies touch or joints stop, outputs jump at the smallest change.

A box that rocks on a tray lands on another corner when its friction changes by a millionth, and is half a millimetre
elsewhere a second later: a difference over a short step measures the jumps, over a long one what friction does. One
window in fifty that jumps there is enough for an interval a tenth as wide as it should be: its slope, squared, is taken
for information that all the others do not have. So steps are judged by the information of all windows together, and by
what of it is left where the initial states are fitted too: of a slope that initial states make up for a jump is all
that is left.
"""

from dataclasses import replace

import numpy as np

from capture_cli.common.evenly_spread import evenly_spread
from capture_cli.common.frozen import frozen
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve.base import Trial
from capture_cli.estimate.solve.linearization import SETTINGS as LINEARIZATION
from capture_cli.estimate.solve.linearization import Linearization, columns
from capture_cli.model.contacts import can_hit
from capture_cli.simulate.engine import Engine
from capture_cli.simulate.simulator import Simulator


@frozen
class SETTINGS:
    steps: tuple[float, ...] = (1e-4, 1e-3, 1e-2, 5e-2)  # shares of a parameter's range
    agree: float = 0.3  # of a slope, that one over the next step may differ by
    windows: int = 64  # evenly spread, that it is measured in: of a few none need hit anything


def difference_step(
    prepared: PreparedLog,
    threads: int | None,
    point: np.ndarray | None = None,
    corrections: np.ndarray | None = None,
) -> tuple[float, int]:
    """The least share of a parameter's range that differences should take at `point` (parameter,), the nominal values
    where None, with states moved by `corrections` (window, state), as measured where None; 0: none is too short. And
    how many windows were simulated to see that.

    That of the task, where it says one; else the shortest of `steps` over which the slopes of all parameters are those
    over the next, the longest where there is none. 0, too, where nothing is open, or no two bodies touch and no joint
    or tendon is at a stop.
    """
    space, model = prepared.task.space, prepared.task.model
    if not len(space) or not can_hit(model):
        return 0.0, 0
    point = space.nominal if point is None else point
    corrections = np.zeros_like(prepared.initial.sd) if corrections is None else corrections
    some = evenly_spread(len(prepared.windows), SETTINGS.windows)
    few, corrections = prepared.part(some), corrections[some]
    simulator = Simulator(prepared.task, engine=Engine(model, threads))
    if not _hits(few, simulator, point, corrections):
        return 0.0, simulator.rollouts
    if (own := float(space.steps.max())) > SETTINGS.steps[0]:
        return own, simulator.rollouts
    rough = (_disagreement(few, simulator, point, corrections) > SETTINGS.agree).any(axis=1)
    longer = next(
        (s for s, r in zip(SETTINGS.steps[1:], rough[1:], strict=False) if not r), SETTINGS.steps[-1]
    )
    return longer if rough[0] else 0.0, simulator.rollouts


def hits_something(
    prepared: PreparedLog, simulator: Simulator, point: np.ndarray, corrections: np.ndarray
) -> bool:
    """Whether bodies touch, or joints or tendons are at a stop, at `point` (parameter,) with initial states at
    `corrections` (window, state).
    """
    if not can_hit(prepared.task.model):
        return False
    some = evenly_spread(len(prepared.windows), SETTINGS.windows)
    return _hits(prepared.part(some), simulator, point, corrections[some])


def _hits(part: PreparedLog, simulator: Simulator, point: np.ndarray, corrections: np.ndarray) -> bool:
    initial = part.initial
    motion = simulator.motion(part.windows, initial.states, point, corrections, initial.reported)
    return bool(motion.contacts.any() or motion.limits.any())


def _disagreement(
    part: PreparedLog, simulator: Simulator, point: np.ndarray, corrections: np.ndarray
) -> np.ndarray:
    """By which share of it a slope differs from that over the next of `steps`, (step, parameter), initial states
    eliminated; 0 of a parameter that shows nowhere.
    """
    data = replace(part.data(simulator), initial_step=LINEARIZATION.rough_initial_step)
    space = simulator.space
    x = space.to_unit(point)
    towards = np.where(x < 0.5, 1.0, -1.0)
    moves = np.array([np.diag(step * towards) for step in SETTINGS.steps])
    points = (x + moves).reshape(-1, len(x))
    outputs, lost = part.evaluate(simulator, columns(data, x, corrections, parameters=False))
    at = Linearization.from_columns(data, x, corrections, outputs, lost, parameters=False)
    trial = Trial(space.from_unit(points), np.repeat(corrections[None], len(points), axis=0))
    outputs, diverged = part.evaluate(simulator, trial)
    change = (data.residual(outputs) - at.residual) * ~(diverged.any(axis=0) | lost[0])[:, None]
    slope = (
        change.reshape(len(SETTINGS.steps), len(x), *at.residual.shape)
        / np.array(SETTINGS.steps)[:, None, None, None]
    )
    apart, size = _information(at, slope[:-1] - slope[1:]), _information(at, slope[1:])
    return np.sqrt(np.divide(apart, size, out=np.zeros_like(size), where=size > 0))


def _information(at: Linearization, slope: np.ndarray) -> np.ndarray:
    """Of slopes (..., window, row), summed over windows (...), as of a fit that leaves the noise alone."""
    by_initial = np.einsum("wrs,...wr->...ws", at.by_initial, slope)
    taken = np.einsum("...ws,wst,...wt->...", by_initial, at.initial_gain(1.0), by_initial)
    return np.maximum(np.square(slope).sum(axis=(-2, -1)) - taken, 0.0)
