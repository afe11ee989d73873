"""Items that several copies of the process work on: the same values, errors and order as one process gives."""

import os
import signal
import sys

import numpy as np
import pytest
from setting_numbers import set_numbers

from capture_cli.common import processes
from capture_cli.common.processes import in_processes, own_threads
from capture_cli.errors import LogError

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are copied on Linux alone")


@pytest.fixture(autouse=True)
def _always_worth_it(monkeypatch):
    monkeypatch.setattr(processes, "_lasted", {})
    set_numbers(monkeypatch, processes, worth=0.0)


def _found(threads, count=9):
    known = np.arange(count, dtype=float)
    return list(in_processes(lambda n: (os.getpid(), known[n] ** 0.5), range(count), threads))


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_values_and_their_order_are_those_of_one_process(threads):
    found = _found(threads)
    assert [value for _, value in found] == [n**0.5 for n in range(9)]
    assert found[0][0] == os.getpid()
    copies = {pid for pid, _ in found} - {os.getpid()}
    assert len(copies) <= threads and bool(copies) == (threads > 1)


def test_nothing_is_made_of_nothing():
    assert list(in_processes(lambda n: n, [], 4)) == []


def test_an_error_is_raised_where_its_item_is_due_with_its_cure():
    def made(n):
        if n == 3:
            raise LogError("of the third", cure="mend it")
        return n

    found = in_processes(made, range(6), 2)
    assert [next(found) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(LogError, match="of the third") as raised:
        next(found)
    assert raised.value.cure == "mend it"


def test_copies_that_are_killed_leave_their_items_to_this_process():
    own = os.getpid()

    def made(n):
        if os.getpid() != own:
            os.kill(os.getpid(), signal.SIGKILL)
        return n

    assert list(in_processes(made, range(5), 3)) == [0, 1, 2, 3, 4]


def test_whoever_stops_asking_ends_the_copies():
    found = in_processes(lambda n: os.getpid(), range(1000), 2)
    copy = [next(found) for _ in range(2)][1]
    found.close()
    with pytest.raises(ProcessLookupError):
        os.kill(copy, 0)


def test_a_copy_works_alone():
    """One of several processes takes one thread, and makes no copies of its own."""

    def made(_):
        pids = set(in_processes(lambda _: os.getpid(), range(3), 8))
        return own_threads(8), pids == {os.getpid()}

    own, *copies = in_processes(made, range(3), 2)
    assert own[0] == 8 and copies == [(1, True)] * 2
