"""Histories made on a Ray cluster of two nodes on this machine, one of which is killed at work."""

from __future__ import annotations

from pathlib import Path

import pytest

from capture_cli.errors import OptionError
from capture_cli.stages.gen_histories import gen_histories
from capture_cli.store.histories import Histories
from capture_cli.store.output import sha256, unfinished

SMALL = {
    "rounds": 4,
    "points": 5,
    "window": 0.1,
    "amplitude": {"drive": 3.0},
    "threads": 1,
    "shard_pairs": 16,
}


def test_a_cluster_that_is_not_there(ray, slider_task, tmp_path):
    options = {**SMALL, "task": str(slider_task), "out": tmp_path / "h.zarr", "pairs": 40, "executor": "ray"}
    with pytest.raises(OptionError, match=r"127.0.0.1:9: no cluster answers[\s\S]*ray start --head"):
        gen_histories(**options, address="127.0.0.1:9")
    with pytest.raises(OptionError, match=r"'somewhere'[\s\S]*HOST:PORT"):
        gen_histories(**options, address="somewhere")
    assert not list(tmp_path.glob("*h.zarr*"))


@pytest.fixture
def cluster(monkeypatch, ray):
    """A cluster of two nodes, the head and another."""
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")  # by default it writes a token under the home directory
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    monkeypatch.setenv("RAY_worker_niceness", "0")  # 15 by default: workers would starve beside other tests
    from ray.cluster_utils import Cluster

    node = {"num_cpus": 1, "object_store_memory": 80 << 20}
    cluster = Cluster()
    try:
        cluster.add_node(include_dashboard=False, **node)
        cluster.add_node(**node)
        cluster.wait_for_nodes()
    except Exception as error:
        cluster.shutdown()
        if "timed out" not in str(error).lower():
            raise
        pytest.skip(f"the machine is too busy for Ray, which gives a node 30 s to start: {error}")
    yield cluster
    cluster.shutdown()


def test_a_node_that_dies_at_work_costs_nothing(cluster, slider_task, tmp_path, monkeypatch):
    options = {**SMALL, "task": str(slider_task), "pairs": 192}
    gen_histories(**options, out=tmp_path / "here.zarr")
    partial = unfinished(tmp_path / "there.zarr")
    victim = next(iter(cluster.worker_nodes))

    def kill_at_work(self, text):
        if victim in cluster.worker_nodes and len(list(partial.glob("written/c/*"))) >= 3:
            cluster.remove_node(victim, allow_graceful=False)

    monkeypatch.setattr("capture_cli.stages.gen_histories.Progress.step", kill_at_work)
    gen_histories(**options, out=tmp_path / "there.zarr", executor="ray", address=cluster.address)
    assert victim not in cluster.worker_nodes
    assert len(Histories(tmp_path / "there.zarr")) == 192
    assert sha256(Path(tmp_path / "there.zarr")) == sha256(tmp_path / "here.zarr")
