"""Progress on stderr: a tqdm bar on a terminal, a plain line now and then where there is none."""

from __future__ import annotations

import sys
import time

PLAIN_EVERY = 10.0  # s
LONG = 2.0  # s that are worth telling


class Progress:
    """Counts `unit`s of `what`; `step` says what is being done. Silent where `quiet`."""

    def __init__(self, what: str, unit: str, *, quiet: bool, total: int | None = None):
        self.what = what
        self.quiet = quiet
        self.count = 0
        self.began = self.told = time.monotonic()
        self.part_began = self.began
        self.bar = None
        if not quiet and sys.stderr.isatty():
            from tqdm import tqdm

            # how many there were says nothing where nobody knows how many there will be
            form = "{desc} {elapsed}{postfix}" if total is None else None
            self.bar = tqdm(desc=what, unit=unit, total=total, file=sys.stderr, leave=False, bar_format=form)

    def __enter__(self) -> Progress:
        return self

    def step(self, text: str) -> None:
        """One more unit; `text` is shown beside the count."""
        self.count += 1
        if self.bar is not None:
            self.bar.set_postfix_str(text, refresh=False)
            self.bar.update()
        elif not self.quiet and time.monotonic() - self.told >= PLAIN_EVERY:
            self.told = time.monotonic()
            print(f"{self.what}: {self.told - self.began:.0f} s, {text}", file=sys.stderr, flush=True)

    def part(self, what: str, number: int, total: int) -> str:
        """Says that `what` number `number` of `total` begins, and how long, by those before, the rest will take."""
        now = time.monotonic()
        if number == 0:
            self.part_began = now
        left = (now - self.part_began) / number * (total - number) if number else 0.0
        return f"{what} {number + 1} of {total}" + (f", {left:.0f} s left of these" if left >= LONG else "")

    def __exit__(self, *_) -> None:
        if self.bar is not None:
            self.bar.close()
