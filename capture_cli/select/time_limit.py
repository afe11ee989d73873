"""The time that a run is given: what is stopped when what follows needs the rest, and what was left out for that."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

import numpy as np

from capture_cli.errors import OutOfTime

Made = TypeVar("Made")


class TimeLimit:
    """deadline: s, of time.monotonic, when the whole run is to be over.

    left_out: what was stopped, or not begun, in words.
    """

    def __init__(self, deadline: float = np.inf):
        self.deadline = deadline
        self.left_out: list[str] = []
        self._until = np.inf

    @staticmethod
    def now() -> float:
        """s, of time.monotonic."""
        return time.monotonic()

    @property
    def half(self) -> float:
        """s, half of what is left; 0 where there is no end of it."""
        left = self.deadline - self.now()
        return left / 2 if np.isfinite(left) else 0.0

    def check(self) -> None:
        """Raises OutOfTime where what is being done has to stop."""
        if self.now() > self._until:
            raise OutOfTime

    @contextmanager
    def keeping(self, seconds: float) -> Iterator[None]:
        """Within, what checks is stopped when no more than these are left, or when what is around it has to stop."""
        before = self._until
        self._until = min(before, self.deadline - seconds)
        try:
            yield
        finally:
            self._until = before

    def keep(self, seconds: float) -> None:
        """From here on, what checks is stopped when no more than these are left, until what is around it ends."""
        self._until = min(self._until, self.deadline - seconds)

    def made(self, make: Callable[[], Made], what: str, *, keeping: float) -> Made | None:
        """What `make` makes; None where it was stopped, and `what` is left out. keeping: as of `keeping`."""
        around = self._until
        try:
            with self.keeping(keeping):
                return make()
        except OutOfTime:
            if self.now() > around:
                raise
            if what not in self.left_out:
                self.left_out.append(what)
            return None
