"""`capture gen-histories`: walks from sources to targets, and what both sides show on the way (paper, Algorithm 1)."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from capture_cli.common.extras import require
from capture_cli.common.progress import Progress
from capture_cli.context import observation_noise
from capture_cli.context.checkpoints.checkpoint_hash import checkpoint_hash
from capture_cli.context.checkpoints.policy_checkpoint import SETTINGS, load_policy
from capture_cli.context.histories.action_library import sequence_task
from capture_cli.context.histories.history_recipe import Recipe
from capture_cli.context.histories.moving_parameters import check_parameters_move_trajectories
from capture_cli.context.histories.resumed_histories import is_complete, place, shards_to_make
from capture_cli.context.observation_noise import standard_deviations
from capture_cli.context.search import REGISTRY as SEARCHES
from capture_cli.context.search.base import ALPHA, Search
from capture_cli.errors import OptionError, did_you_mean
from capture_cli.model.model_hash import model_hash
from capture_cli.model.parameters import ParameterSpace
from capture_cli.model.tasks.base import ActionTask, Task
from capture_cli.model.tasks.sequence_task import SequenceTask
from capture_cli.stages.recorded.recorded_task import task_inputs
from capture_cli.stages.simulated_machine import SimulatedMachine
from capture_cli.store.histories import SHARD_PAIRS, HistoriesWriter, is_url, shard_rows
from capture_cli.store.output import refuse_inputs
from capture_cli.store.provenance import Provenance

ROUNDS = 7  # L of the paper
EXECUTORS = ("local", "ray")


def gen_histories(
    *,
    task: str,
    out: str | Path,
    policy: str = "random",
    search: str = "randomized-binary",
    pairs: int = 1000,
    rounds: int = ROUNDS,
    alpha: float | None = None,
    effects: Sequence[str] = (),
    estimate: Path | None = None,
    noise: str = "none",
    noise_sd: Mapping[str, float] | float = 0.0,
    inputs_from: Path | None = None,
    window: float | None = None,
    points: int | None = None,
    amplitude: Mapping[str, float] | None = None,
    band: tuple[float, float] | None = None,
    seed: int = 0,
    max_log_size: int | None = None,
    threads: int | None = None,
    executor: str = "local",
    address: str | None = None,
    shard_pairs: int = SHARD_PAIRS,
    force: bool = False,
    resume: bool = False,
    quiet: bool = True,
) -> dict[str, Any]:
    """Write `pairs` histories of `rounds` rounds at `out`, a path or a URL; returns what was done, JSON-able.

    policy: a name, or a checkpoint directory. alpha: shape of the Beta that `search` draws from. noise: one of
    `observation_noise.NOISES`; noise_sd: standard deviation of white noise besides, per feature or one for all.
    effects, estimate: what machines have that the task's model lacks, see `SimulatedMachine`; in simulated trajectories
    at the middle of its range, in measured ones anywhere in it, anew for each pair.
    inputs_from, window, points, amplitude, band, max_log_size: the actions of a task.toml, see `sequence_task`.
    executor: where shards are made, "local" or "ray" (at `address`). With `resume` a run that ended early goes on,
    and one that is complete is left as it is. The bytes written do not depend on threads, executor or hosts.
    Raises CaptureError.
    """
    options = {k: v for k, v in locals().items() if k not in ("force", "resume", "quiet")}
    if executor == "ray":
        require("ray", "--executor ray")
    out = str(out).removeprefix("file://")
    _check(pairs, rounds, executor, address)
    asked = SimulatedMachine.to_learn_in(
        task, estimate, effects, why="histories go over all values of the parameters"
    )
    machine = asked.task
    checkpoints = [policy] if Path(policy).exists() else []
    if not is_url(out):
        refuse_inputs(Path(out), [inputs_from, estimate, *checkpoints, *task_inputs(machine).values()])
    machine = _action_task(
        machine,
        seed,
        inputs_from=inputs_from,
        max_log_size=max_log_size,
        window=window,
        points=points,
        amplitude=amplitude or None,
        band=band,
    )
    features = [f.name for f in machine.features]
    observation_noise.check(noise, features)
    recipe = Recipe(
        task=machine,
        policy=load_policy(policy, machine),
        effects=asked.effects,
        search=_search(search, alpha),
        rounds=rounds,
        noise=noise,
        noise_sd=standard_deviations("--noise-sd", noise_sd, features, "a trajectory has no feature"),
        seed=seed,
    )
    attributes = _attributes(recipe, policy, search, pairs, shard_pairs)
    inputs = {"task": machine.path, "inputs_from": inputs_from, "estimate": estimate}
    provenance = Provenance("gen-histories", options, inputs)
    if resume and not force and is_complete(HistoriesWriter(out), attributes, checkpoints):
        return _summary(out, attributes, made=0, seconds=0.0)
    if isinstance(machine, SequenceTask):
        check_parameters_move_trajectories(
            machine.with_effects(asked.effects.at_middle), seed=seed, threads=threads
        )
    began = time.monotonic()
    with _shard_maker(executor, address) as make_shards, place(out, force=force, resume=resume) as location:
        writer = HistoriesWriter(location)
        todo = shards_to_make(writer, attributes, checkpoints)
        shards = [(s, range(pairs)[shard_rows(s, shard_pairs, pairs)]) for s in todo]
        _follow(make_shards(recipe, writer, shards, threads), shards, pairs, quiet)
        writer.finish()
        if not is_url(location):
            provenance.write(Path(location))
    return _summary(out, attributes, made=len(todo), seconds=time.monotonic() - began)


# --- what is asked for ---


def _check(pairs: int, rounds: int, executor: str, address: str | None) -> None:
    if pairs < 1:
        raise OptionError(f"--pairs {pairs}", cure="give at least 1")
    if rounds < 2:
        raise OptionError(
            f"--rounds {rounds}: a history has a source and a target", cure="give at least 2 rounds"
        )
    if executor not in EXECUTORS:
        raise OptionError(f"--executor {executor!r}", cure=did_you_mean(executor, EXECUTORS))
    if address is not None and executor != "ray":
        raise OptionError(f"--address {address} without --executor ray", cure="add --executor ray")


def _action_task(machine: Task, seed: int, **tape_options) -> ActionTask:
    """A built-in task as it is; that of a task.toml with actions made as `tape_options` say."""
    given = {k: v for k, v in tape_options.items() if v is not None}
    if not isinstance(machine, ActionTask):
        return sequence_task(machine, **given, seed=seed)
    if given:
        options = ", ".join(f"--{k.replace('_', '-')}" for k in given)
        raise OptionError(
            f"{options}: {machine.name!r} has actions of its own", cure="leave it out, or give a task.toml"
        )
    return machine


def _search(name: str, alpha: float | None) -> Search:
    cls = SEARCHES.get(name)
    if alpha is None:
        return cls()
    if not cls.takes_alpha:
        raise OptionError(
            f"--alpha {alpha:g}: {name} draws from no Beta",
            cure="leave it out, or --search randomized-binary",
        )
    if not 0 < alpha < np.inf:
        raise OptionError(f"--alpha {alpha:g}", cure=f"give a positive number; the paper's is {ALPHA:g}")
    return cls(alpha)


def _attributes(recipe: Recipe, policy: str, search: str, pairs: int, shard_pairs: int) -> dict[str, Any]:
    """All that the store says of itself; equal attributes mean equal bytes."""
    task = recipe.task
    checkpoint = (Path(policy) / SETTINGS).is_file()
    return {
        "task": task.name,
        "model": model_hash(task.model),
        "parameters": _box(task.space),
        "actions": _box(task.actions),
        "library": _hash(library) if (library := getattr(task, "library", None)) is not None else None,
        "features": [{"name": f.name, "unit": f.unit, "scale": f.scale} for f in task.features],
        "point_times": np.asarray(task.point_times, dtype=float).tolist(),
        "pairs": pairs,
        "shard_pairs": shard_pairs,
        "rounds": recipe.rounds,
        "search": search,
        "alpha": float(recipe.search.alpha) if recipe.search.takes_alpha else None,
        "effects": recipe.effects.rows(),
        "noise": recipe.noise,
        "noise_sd": {f.name: s for f, s in zip(task.features, recipe.noise_sd, strict=True)},
        "policy": {
            "name": Path(policy).name if checkpoint else policy,
            "sha256": checkpoint_hash(policy) if checkpoint else None,
        },
        "seed": recipe.seed,
        "mujoco": mujoco.__version__,
    }


def _box(space: ParameterSpace) -> list[dict[str, Any]]:
    return [{"name": p.name, "unit": p.unit, "low": p.low, "high": p.high} for p in space]


def _hash(array: np.ndarray) -> str:
    return hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()


# --- the work ---


@contextmanager
def _shard_maker(executor: str, address: str | None) -> Iterator[Callable[..., Iterator[int]]]:
    """A function of (recipe, writer, shards (number, pairs), threads) that yields how many pairs each shard held."""
    if executor == "local":
        yield _make_here
        return
    from capture_cli.context.histories.ray_cluster import ray_cluster

    with ray_cluster(address) as make:
        yield make


def _make_here(recipe: Recipe, writer: HistoriesWriter, shards, threads: int | None) -> Iterator[int]:
    for shard, rows in shards:
        writer.write(shard, recipe.make(rows, threads))
        yield len(rows)


def _follow(results: Iterator[int], shards, pairs: int, quiet: bool) -> None:
    """Tell how far it is until every shard is made."""
    kept = pairs - sum(len(rows) for _, rows in shards)
    done, began = 0, time.monotonic()
    with Progress("histories", "shard", quiet=quiet, total=len(shards)) as progress:
        for made in results:
            done += made
            rate = done / (time.monotonic() - began)
            left = (pairs - kept - done) / rate
            progress.step(f"{kept + done} of {pairs} histories, {rate:.1f}/s, {left:.0f} s left")


def _summary(out: str, attributes: dict[str, Any], *, made: int, seconds: float) -> dict[str, Any]:
    pairs, rounds = attributes["pairs"], attributes["rounds"]
    shards = -(-pairs // attributes["shard_pairs"])
    return {
        "out": out,
        "task": attributes["task"],
        "search": attributes["search"],
        "policy": attributes["policy"]["name"],
        "pairs": pairs,
        "rounds": rounds,
        "shards": shards,
        "shards_made": made,
        "seconds": round(seconds, 3),
    }
