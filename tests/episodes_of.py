"""Logs cut down to some of their episodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from capture_cli.log.measured_log import MeasuredLog


def episodes_of(log: MeasuredLog, keep: Sequence[int]) -> MeasuredLog:
    """The log of these episodes alone, in this order."""
    slices = [log.episodes[i] for i in keep]
    rows = np.concatenate([np.arange(s.start, s.stop) for s in slices]) if slices else np.empty(0, int)
    return replace(
        log,
        time=log.time[rows],
        inputs=log.inputs[rows],
        outputs=log.outputs[rows],
        episode_ends=np.cumsum([s.stop - s.start for s in slices]),
        recording=np.asarray(log.recording)[list(keep)],
        actions=None if log.actions is None else log.actions[list(keep)],
    )
