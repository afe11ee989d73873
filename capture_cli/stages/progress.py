"""Progress on stderr: a tqdm bar on a terminal, a plain line now and then where there is none."""

from __future__ import annotations

import sys
import time

PLAIN_EVERY = 10.0  # s


class Progress:
    """Counts `unit`s of `what`; `step` says what is being done. Silent where `quiet`."""

    def __init__(self, what: str, unit: str, *, quiet: bool, total: int | None = None):
        self.what = what
        self.quiet = quiet
        self.count = 0
        self.began = self.told = time.monotonic()
        self.bar = None
        if not quiet and sys.stderr.isatty():
            from tqdm import tqdm

            self.bar = tqdm(desc=what, unit=unit, total=total, file=sys.stderr, leave=False)

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

    def __exit__(self, *_) -> None:
        if self.bar is not None:
            self.bar.close()
