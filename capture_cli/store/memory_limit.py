"""How much memory a block of code may take, whatever a file says that it unpacks to."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

try:
    import resource
except ImportError:  # not on this system: then there is no limit
    resource = None

_STATUS = Path("/proc/self/statm")  # pages; the sixth number is of what can be written


@contextmanager
def memory_limit(size: int) -> Iterator[None]:
    """Let the process take `size` bytes more than now while the block runs; where more is asked for, that is a
    MemoryError, or what a library makes of it. No limit where the system has none for memory.
    """
    if resource is None or not _STATUS.is_file():
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    taken = int(_STATUS.read_text().split()[5]) * os.sysconf("SC_PAGE_SIZE")
    most = taken + size
    if soft != resource.RLIM_INFINITY:
        most = min(most, soft)
    resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))
