"""How long finite differences have to be: where bodies touch or joints stop, outputs jump at the smallest change.

A box that rocks on a tray lands on another corner when its friction changes by a millionth, and is half a millimetre
elsewhere a second later: a difference over a short step measures the jumps, over a long one what friction does.
"""

from __future__ import annotations

import numpy as np

from capture_cli.identifiers.base import Trial
from capture_cli.protocol.prepared_log import PreparedLog
from capture_cli.sim.contacts import at_stops, can_touch
from capture_cli.sim.engine import Engine
from capture_cli.simulator import Simulator

STEPS = (1e-4, 1e-3, 1e-2, 5e-2)  # shares of a parameter's range
AGREE = 0.3  # of a slope, that one over the next step may differ by
WINDOWS = 16  # evenly spread, that it is measured in


def difference_step(prepared: PreparedLog, threads: int | None) -> tuple[float, int]:
    """The least share of a parameter's range that differences should take at the nominal point; 0: none is too short.
    And how many windows were simulated to see that.

    The shortest of STEPS over which the slopes of all parameters are those over the next, the longest where there is
    none. 0, too, where the task says which it needs, nothing is open, or no two bodies touch and no joint is at a stop.
    """
    space, model = prepared.task.space, prepared.task.model
    if not len(space) or space.steps.max() > STEPS[0] or not (can_touch(model) or model.jnt_limited.any()):
        return 0.0, 0
    few = prepared.part(np.unique(np.linspace(0, len(prepared.windows) - 1, WINDOWS).astype(int)))
    simulator = Simulator(prepared.task, engine=Engine(model, threads))
    still = np.zeros((len(few.windows), few.starts.sd.shape[1]))
    starts = few.starts
    motion = simulator.motion(few.windows, starts.starts, space.nominal, still, starts.reported)
    if not motion.contacts.any() and not at_stops(model, motion.qpos):
        return 0.0, simulator.rollouts
    rough = (_disagreement(few, simulator) > AGREE).any(axis=1)
    longer = next((s for s, r in zip(STEPS[1:], rough[1:], strict=False) if not r), STEPS[-1])
    return longer if rough[0] else 0.0, simulator.rollouts


def _disagreement(part: PreparedLog, simulator: Simulator) -> np.ndarray:
    """By which share of it a slope differs from that over the next step of STEPS, (step, parameter), at least, in a
    quarter of the windows that it shows in.
    """
    evidence, space = part.evidence(simulator), simulator.space
    x = space.to_unit(space.nominal)
    towards = np.where(x < 0.5, 1.0, -1.0)
    moves = np.array([np.diag(step * towards) for step in STEPS])
    points = np.concatenate([x[None], (x + moves).reshape(-1, len(x))])
    trial = Trial(space.from_unit(points), np.zeros((len(points), *evidence.start_sd.shape)))
    outputs, diverged = part.evaluate(simulator, trial)
    residual = evidence.residual(outputs)
    change = (residual[1:] - residual[0]).reshape(len(STEPS), len(x), *residual.shape[1:])
    slope = change / np.array(STEPS)[:, None, None, None]
    apart = np.linalg.norm(slope[:-1] - slope[1:], axis=-1)
    size = np.linalg.norm(slope[1:], axis=-1)
    shows = (size > 0) & ~diverged.any(axis=0)
    share = np.where(shows, apart / np.maximum(size, np.finfo(float).tiny), np.nan)
    return np.array([[_upper_quartile(windows[~np.isnan(windows)]) for windows in rows] for rows in share])


def _upper_quartile(values: np.ndarray) -> float:
    """0 of none."""
    return float(np.quantile(values, 0.75)) if len(values) else 0.0
