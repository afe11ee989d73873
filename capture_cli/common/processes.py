"""Independent items of work in several processes at a time, each a copy of this one."""

import os
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from types import CodeType
from typing import Any, TypeVar

from capture_cli.common.frozen import frozen
from capture_cli.common.signals import end_with_parent

Item = TypeVar("Item")
Made = TypeVar("Made")


@frozen
class SETTINGS:
    worth: float = 0.3  # s of work that is left: less is done sooner than copies of this process are made
    ahead: int = 2  # items for each process that are asked for before the first of them is done


# What a copy works on: it has them from this process, and is told no more than the number of an item
_work: tuple[Callable[[Any], Any], Sequence[Any]] | None = None
_is_copy = False
_lasted: dict[CodeType, float] = {}  # s, what an item took a function the last time


def own_threads(threads: int | None) -> int:
    """How many threads may be used here of `threads` (all cores where None or 0): one in a process that is one of
    several.
    """
    return 1 if _is_copy else threads or _cores()


def in_processes(
    function: Callable[[Item], Made], items: Sequence[Item], threads: int | None
) -> Iterator[Made]:
    """function(item) of each item, in their order: the same values in any number of processes.

    function: changes nothing that is asked for later, as what a copy changes is lost. threads: how many processes at a
    time; all cores where None or 0. Copies are made where an item took it long enough the last time; the first time of
    all, the first item says it. Whoever asks for no more items ends what is worked on ahead.
    """
    number, count = 0, own_threads(threads) if sys.platform == "linux" else 1
    while number < len(items):
        left = len(items) - number
        lasted = _lasted.get(function.__code__, 0.0)
        if min(count, left) > 1 and lasted * left > SETTINGS.worth:
            yield from _in_copies(function, items[number:], min(count, left))
            return
        yield _timed(function, items[number])
        number += 1


def _in_copies(function: Callable[[Item], Made], items: Sequence[Item], count: int) -> Iterator[Made]:
    from concurrent.futures import ProcessPoolExecutor
    from concurrent.futures.process import BrokenProcessPool
    from multiprocessing import get_context

    global _work
    _work, done = (function, items), 0
    pool = ProcessPoolExecutor(count, get_context("fork"), _begin, (os.getpid(),))
    try:
        numbers = iter(range(len(items)))
        asked = deque(pool.submit(_of_item, n) for n in islice(numbers, SETTINGS.ahead * count))
        while asked:
            found, _lasted[function.__code__] = asked.popleft().result()
            asked.extend(pool.submit(_of_item, n) for n in islice(numbers, 1))
            done += 1
            yield found
    except BrokenProcessPool:  # a copy was killed, as where memory is short
        yield from map(function, items[done:])
    finally:
        pool.shutdown(cancel_futures=True)
        _work = None


def _timed(function: Callable[[Item], Made], item: Item) -> Made:
    began = time.monotonic()
    found = function(item)
    _lasted[function.__code__] = time.monotonic() - began
    return found


def _begin(parent: int) -> None:
    """In a copy of the process `parent`."""
    global _is_copy
    _is_copy = True
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to all; the parent says what it means
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    end_with_parent(parent)


def _of_item(number: int) -> Any:
    function, items = _work
    return _timed(function, items[number]), _lasted[function.__code__]


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
