"""Which windows of a log are fitted, which choose between models, and which are held out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture_cli.diagnosis.folds import Folds, select_folds
from capture_cli.protocol.prepared_log import PreparedLog

FIT, SELECT, TEST = 0, 1, 2


@dataclass(frozen=True)
class LogParts:
    """number (window,): the part of each window, FIT, SELECT or TEST. folds: how the first two judge models."""

    prepared: PreparedLog
    folds: Folds
    number: np.ndarray

    @classmethod
    def of(cls, prepared: PreparedLog) -> LogParts:
        """What is held out stays so; the others are fitted, or choose where there are enough of them."""
        is_test = prepared.split.is_test
        folds = select_folds(prepared.windows.episode, is_test)
        return cls(prepared, folds, np.where(is_test, TEST, np.where(folds.fit, FIT, SELECT)))

    def windows(self, *parts: int) -> PreparedLog | None:
        """The windows of these parts alone; None where there is none."""
        keep = np.isin(self.number, parts)
        return self.prepared.part(keep) if keep.any() else None
