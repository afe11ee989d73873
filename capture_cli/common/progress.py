"""Progress on stderr: a tqdm bar on a terminal, a plain line now and then where there is none."""

import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Self

from capture_cli.common.frozen import frozen


@frozen
class SETTINGS:
    first: float = 1.0  # s until the first line: what is done sooner needs none, and starting takes some, too
    plain_every: float = 10.0  # s
    refreshed_every: float = 1.0  # s, the bar of a terminal
    long: float = 2.0  # s that are worth telling


@dataclass(frozen=True)
class _Doing:
    """What is being done since `since`, s of the clock. done, total: of things of its kind, from `first` on, if any."""

    text: str
    since: float
    first: float = 0.0
    done: int = 0
    total: int = 0

    def at(self, now: float) -> str:
        """In words, with how long, by those before, the rest will take, or how long it lasts already."""
        lasts, left = now - self.since, 0.0
        if self.done:  # where this one takes longer than those before it, so may the others
            each = max((self.since - self.first) / self.done, lasts)
            left = each * (self.total - self.done) - lasts
        if left >= SETTINGS.long:
            return f"{self.text}, {left:.0f} s left of these"
        return self.text + (f", for {lasts:.0f} s" if lasts >= SETTINGS.plain_every else "")


class Progress:
    """Counts `unit`s of `what`, and shows the current work. Silent where `quiet`.

    It says so from a thread of its own: what takes long may be one call that comes back when all is done.
    """

    def __init__(self, what: str, unit: str, *, quiet: bool, total: int | None = None):
        self.what = what
        self.quiet = quiet
        self.count = 0
        self.began = self.first = time.monotonic()
        self.whole = ""
        self.now = _Doing("", self.began)
        self.over = threading.Event()
        self.bar = None
        if not quiet and sys.stderr.isatty():
            from tqdm import tqdm

            # how many there were says nothing where nobody knows how many there will be
            form = "{desc} {elapsed}{postfix}" if total is None else None
            self.bar = tqdm(desc=what, unit=unit, total=total, file=sys.stderr, leave=False, bar_format=form)
        self.teller = threading.Thread(target=self._tell, daemon=True)

    def __enter__(self) -> Self:
        if not self.quiet:
            self.teller.start()
        return self

    def of(self, whole: str, text: str) -> None:
        """`text` is being done from now on, and it is part `whole` ("step 2 of 5") of all that is to be done."""
        self.whole = whole
        self.doing(text)

    def doing(self, text: str) -> None:
        """`text` is being done from now on."""
        self.now = _Doing(text, time.monotonic())
        self._show()

    def step(self, text: str) -> None:
        """One more unit is done; `text` from now on."""
        self._count()
        self.doing(text)

    def part(self, what: str, number: int, total: int, more: str = "") -> None:
        """`what` number `number` of `total` begins, and before it one unit was done; `more` is shown after it."""
        now = time.monotonic()
        if number == 0:
            self.first = now
        self._count()
        self.now = _Doing(f"{what} {number + 1} of {total}{more}", now, self.first, number, total)
        self._show()

    def said(self) -> str:
        """What is being done, in words."""
        now = self.now.at(time.monotonic())
        return f"{self.whole}, {now}" if self.whole else now

    def __exit__(self, *_) -> None:
        self.over.set()
        if self.teller.is_alive():
            self.teller.join()
        if self.bar is not None:
            self.bar.close()

    def _count(self) -> None:
        self.count += 1
        if self.bar is not None:
            self.bar.update()

    def _show(self) -> None:
        if self.bar is not None:
            self.bar.set_postfix_str(self.said())

    def _tell(self) -> None:
        """What the thread does until all is over."""
        wait = SETTINGS.first if self.bar is None else SETTINGS.refreshed_every
        while not self.over.wait(wait):
            with suppress(OSError, ValueError):  # nobody listens any more
                if self.bar is not None:
                    self._show()
                elif text := self.said():
                    elapsed = time.monotonic() - self.began
                    print(f"{self.what}: {elapsed:.0f} s, {text}", file=sys.stderr, flush=True)
            wait = SETTINGS.plain_every if self.bar is None else SETTINGS.refreshed_every
