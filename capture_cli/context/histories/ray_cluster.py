"""Shards of histories made on a Ray cluster. A node that is lost costs the shards it was at: others make them again."""

import os
import re
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial

from capture_cli.common.frozen import frozen
from capture_cli.context.histories.history_recipe import Recipe
from capture_cli.errors import CaptureError, OptionError, StoreError
from capture_cli.store.histories import HistoriesWriter


@frozen
class SETTINGS:
    retries: int = 5  # of a shard, where a node or a process was lost
    queued: int = 2  # shards submitted per processor of the cluster: more would only fill its scheduler
    reach: float = 5.0  # s, to answer at an address


_HOST = re.compile(r"^(?:ray://)?(?P<host>[^/:]+):(?P<port>\d+)$")

Shards = Sequence[tuple[int, range]]


@contextmanager
def ray_cluster(address: str | None) -> Iterator[Callable[..., Iterator[int]]]:
    """What makes shards on the cluster at `address`; one of this machine alone is started where None.

    Yields a function of (recipe, writer, shards (number, pairs), threads), which makes the shards in any order and
    yields how many pairs each held; each shard takes `threads` processors (1 where None). Raises OptionError where
    there is no such cluster.
    """
    ray = _connected(address)
    try:
        yield partial(_make, ray)
    finally:
        ray.shutdown()


def _make(ray, recipe: Recipe, writer: HistoriesWriter, shards: Shards, threads: int | None) -> Iterator[int]:
    threads = threads or 1
    processors = int(ray.cluster_resources().get("CPU", 0))
    if threads > processors:
        raise OptionError(
            f"--threads {threads}: the cluster has {processors} processors", cure="ask for fewer threads"
        )
    task = ray.remote(num_cpus=threads, max_retries=SETTINGS.retries)(_make_shard)
    shared = ray.put(recipe)
    left = iter(shards)
    running = {}
    while True:
        while len(running) < SETTINGS.queued * max(1, processors // threads) and (shard := next(left, None)):
            running[task.remote(shared, writer, *shard, threads)] = shard
        if not running:
            return
        done, _ = ray.wait(list(running), num_returns=1)
        for reference in done:
            _, rows = running.pop(reference)
            _result(ray, reference)
            yield len(rows)


def _make_shard(recipe: Recipe, writer: HistoriesWriter, shard: int, rows: range, threads: int) -> None:
    if writer.attributes() is None:
        raise StoreError(
            f"host {socket.gethostname()} of the cluster sees no store at {writer.location}",
            cure="give an --out that every host can write to: a shared folder, or a URL",
        )
    writer.write(shard, recipe.make(rows, threads))


def _result(ray, reference) -> None:
    """Raise what the task raised, as it was where it was raised."""
    try:
        ray.get(reference)
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, CaptureError | OSError):
            raise error.cause from None
        raise
    except (ray.exceptions.WorkerCrashedError, ray.exceptions.NodeDiedError) as error:
        raise StoreError(
            f"a shard was lost {SETTINGS.retries + 1} times: {error}",
            cure="see to the hosts of the cluster, and go on with --resume",
        ) from error


def _connected(address: str | None):
    """The module `ray`, connected. Raises OptionError."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nothing is reported to anyone
    import ray

    quiet = {"log_to_driver": False, "logging_level": "ERROR", "configure_logging": True}
    if address is None:
        os.environ.setdefault("RAY_worker_niceness", "0")  # 15 by default, which is nobody's wish here
        try:
            ray.init(include_dashboard=False, **quiet)
        except Exception as error:  # Ray raises just that where a node does not start within 30 s
            raise OptionError(
                f"--executor ray: Ray does not start here: {error}",
                cure="try again when the machine is less busy, or --executor local",
            ) from error
        return ray
    _check_reachable(address)
    try:
        ray.init(address=address, **quiet)
    except (ConnectionError, ValueError, RuntimeError, ImportError) as error:
        first = str(error).strip().splitlines()[0]
        raise OptionError(f"--address {address}: {first}", cure=_START) from error
    return ray


_START = "start a cluster (`ray start --head` prints its address), or leave --address out to use this machine alone"


def _check_reachable(address: str) -> None:
    """Raise OptionError where nothing listens; Ray itself would try for minutes."""
    found = _HOST.match(address)
    if address == "auto":
        return
    if found is None:
        raise OptionError(f"--address {address!r}", cure="give HOST:PORT, ray://HOST:PORT, or auto")
    try:
        socket.create_connection((found["host"], int(found["port"])), timeout=SETTINGS.reach).close()
    except OSError as error:
        raise OptionError(f"--address {address}: no cluster answers ({error})", cure=_START) from error
