"""Whole `capture gen-histories`, writing included, against bare MuJoCo and against stepping robosuite's environments.

Rates are per CPU second of one thread, in turns in one run, and ratios are medians over repeats. "Bare mj_step" steps
the plant of the same task through the same episodes, with nominal parameters, and records nothing: the faster of
`mj_step` in Python, called once per stretch of constant control, and `mujoco.rollout`. robosuite steps its scene of
the task, arm and controller included, with actions of zero; its resets are not counted.
"""

from __future__ import annotations

import importlib
import itertools
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
from mujoco import rollout

from benchmarks._speeds import interleaved
from benchmarks.base import Benchmark, Figure, Result
from capture_cli.model.tasks import load_task
from capture_cli.options.gen_histories import GenHistoriesOptions
from capture_cli.stages.gen_histories import gen_histories

TASKS = {"air-hockey": 48, "scooping": 384}  # pairs per repeat: some seconds
REPEATS, EPISODES, CONTROL_STEPS = 5, 200, 60
ROUNDS = GenHistoriesOptions.rounds
SIMULATED = 2 * ROUNDS - 1  # rollouts per history: the last round's two are one
OVER_BARE, OVER_ROBOSUITE = 0.75, 15.0
RAY_TASK, RAY_PAIRS = "scooping", 2560


class HistoriesSpeed(Benchmark):
    summary = "gen-histories against bare mj_step and robosuite; two Ray nodes"

    def run(self) -> Result:
        result = Result()
        with tempfile.TemporaryDirectory() as folder:
            for task, pairs in TASKS.items():
                self._speed(task, pairs, Path(folder), result)
            self._ray(Path(folder), result)
        return result

    def _speed(self, name: str, pairs: int, folder: Path, result: Result) -> None:
        task = load_task(name)
        out = folder / f"{name}.zarr"
        bare = _Bare(task)
        kinds: dict[str, Callable[[], float]] = {
            "histories": lambda: _generate(name, pairs, out) * task.grid_steps,
            "mj_step": bare.mj_step,
            "rollout": bare.rollout,
        }
        robosuite = _robosuite_stepper(name)
        if robosuite is not None:
            kinds["robosuite"] = robosuite
        speeds = interleaved(kinds, REPEATS)
        steps = speeds["histories"]
        ratio = np.median(steps / np.maximum(speeds["mj_step"], speeds["rollout"]))
        result.figures.append(
            Figure(f"gen-histories / bare mj_step, {name}", float(ratio), target=(OVER_BARE, None))
        )
        if robosuite is not None:
            over = float(np.median(steps / speeds["robosuite"]))
            result.figures.append(
                Figure(f"gen-histories / robosuite, {name}", over, target=(OVER_ROBOSUITE, None))
            )
        rollouts = float(np.median(steps)) / task.grid_steps
        result.figures += [
            Figure(f"  rollouts, {name}", rollouts, "1/s"),
            Figure(f"  histories of {ROUNDS} rounds, {name}", rollouts / SIMULATED, "1/s"),
            Figure(f"  a history on disk, {name}", _bytes(out) / pairs, "bytes"),
        ]
        result.details[name] = {"steps_per_second": {k: v.tolist() for k, v in speeds.items()}}

    def _ray(self, folder: Path, result: Result) -> None:
        try:
            seconds = {nodes: _on_ray(nodes, folder / f"ray{nodes}.zarr") for nodes in (1, 2)}
        except Exception as error:  # Ray raises just that where a node does not start within 30 s
            result.details["ray"] = f"not measured: {error}"
            return
        result.figures.append(
            Figure(f"two Ray nodes over one, {RAY_PAIRS} pairs of {RAY_TASK}", seconds[1] / seconds[2])
        )
        result.details["ray"] = {f"{n} nodes": s for n, s in seconds.items()}


def _generate(task: str, pairs: int, out: Path) -> int:
    """How many rollouts the histories took."""
    gen_histories(task=task, pairs=pairs, out=out, threads=1, force=True)
    return pairs * SIMULATED


class _Bare:
    """Random episodes of a task, stepped by MuJoCo alone; every method makes all of them and returns the steps."""

    def __init__(self, task):
        self.task, self.model, self.data = task, task.model, mujoco.MjData(task.model)
        uniform = np.random.default_rng(0).random((EPISODES, len(task.actions)))
        episodes = task.episodes(task.draw_actions(uniform))
        self.initial = episodes.initial
        self.controls = task.controls(episodes.inputs)[:, : task.grid_steps]
        size = mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        self.states = np.zeros((EPISODES, size))
        for i in range(EPISODES):
            self._start(i)
            mujoco.mj_getState(self.model, self.data, self.states[i], mujoco.mjtState.mjSTATE_FULLPHYSICS)

    def _start(self, i: int) -> None:
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = self.initial.qpos[i], self.initial.qvel[i]

    def mj_step(self) -> int:
        for i, tape in enumerate(self.controls):
            self._start(i)
            edges = [0, *(np.flatnonzero(np.any(np.diff(tape, axis=0), axis=1)) + 1), len(tape)]
            for first, last in itertools.pairwise(edges):
                self.data.ctrl[:] = tape[first]
                mujoco.mj_step(self.model, self.data, nstep=int(last - first))
        return self.controls.shape[0] * self.controls.shape[1]

    def rollout(self) -> int:
        rollout.rollout(self.model, self.data, self.states, self.controls, nstep=self.controls.shape[1])
        return self.controls.shape[0] * self.controls.shape[1]


def _robosuite_stepper(task: str) -> Callable[[], float] | None:
    """Steps the robosuite scene of `task`; None where there is none."""
    try:
        world = importlib.import_module(f"capture_cli.context.worlds.{task.replace('-', '_')}")
    except ModuleNotFoundError:
        return None
    environment = world.MACHINE.behind_gymnasium(
        control_freq=20,
        horizon=(REPEATS + 1) * CONTROL_STEPS + 1,  # one reset lasts all repeats
    ).environment
    still = np.zeros(environment.action_dim)
    steps = round(environment.control_timestep / environment.model_timestep)
    environment.reset()

    def step() -> float:
        for _ in range(CONTROL_STEPS):
            environment.step(still)
        return CONTROL_STEPS * steps

    return step


def _on_ray(nodes: int, out: Path) -> float:
    """Seconds that a cluster of `nodes` nodes with one processor each takes, its start not counted."""
    os.environ.setdefault(
        "RAY_AUTH_MODE", "disabled"
    )  # by default it writes a token under the home directory
    os.environ.setdefault("RAY_worker_niceness", "0")  # 15 by default
    from ray.cluster_utils import Cluster

    node = {"num_cpus": 1, "object_store_memory": 80 << 20}
    cluster = Cluster(initialize_head=True, head_node_args={"include_dashboard": False, **node})
    try:
        for _ in range(nodes - 1):
            cluster.add_node(**node)
        cluster.wait_for_nodes()
        options = {"task": RAY_TASK, "executor": "ray", "address": cluster.address, "threads": 1}
        gen_histories(**options, pairs=256 * nodes, out=out.with_suffix(".warm"))  # workers start, imports
        began = time.perf_counter()
        gen_histories(**options, pairs=RAY_PAIRS, out=out)
        return time.perf_counter() - began
    finally:
        cluster.shutdown()


def _bytes(folder: Path) -> int:
    return sum(f.stat().st_size for f in folder.rglob("*") if f.is_file())
