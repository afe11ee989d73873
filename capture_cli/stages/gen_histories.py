"""`capture gen-histories`: walks from sources to targets, and what both sides show on the way (paper, Algorithm 1)."""

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from capture_cli.common.extras import require
from capture_cli.common.progress import Progress
from capture_cli.common.warn import warn
from capture_cli.context import observation_noise
from capture_cli.context.checkpoints.checkpoint_hash import recorded_policy
from capture_cli.context.checkpoints.policy_checkpoint import load_policy, played
from capture_cli.context.histories.action_library import LogWindows, Multisines, library_hash, sequence_task
from capture_cli.context.histories.history_recipe import Recipe
from capture_cli.context.histories.moving_parameters import check_parameters_move_trajectories
from capture_cli.context.histories.resumed_histories import is_complete, place, shards_to_make
from capture_cli.context.observation_noise import standard_deviations
from capture_cli.context.search import REGISTRY as SEARCHES
from capture_cli.context.search.base import Search
from capture_cli.errors import OptionError
from capture_cli.model.effects.ranges import EffectRanges
from capture_cli.model.model_hash import model_hash
from capture_cli.model.tasks.aimed_task import AimedTask
from capture_cli.model.tasks.base import ActionTask, Task
from capture_cli.model.tasks.sequence_task import SequenceTask
from capture_cli.options.base import takes_options
from capture_cli.options.gen_histories import GenHistoriesOptions
from capture_cli.stages.recorded.recorded_task import task_inputs
from capture_cli.stages.simulated_machine import SimulatedMachine
from capture_cli.store.histories import HistoriesWriter, is_url, shard_rows
from capture_cli.store.output import refuse_inputs
from capture_cli.store.provenance import Provenance

OF_SEQUENCES = ("inputs_from", "max_log_size", "window", "points", "amplitude", "band")  # options


@takes_options
def gen_histories(options: GenHistoriesOptions) -> dict[str, Any]:
    """Write `pairs` histories of `rounds` rounds at `out`, a path or a URL; returns what was done, JSON-able.

    Machines have the effects in simulated trajectories at the middle of their ranges, in measured ones anywhere in
    them, anew for each pair. The bytes written do not depend on threads, executor or hosts. Raises CaptureError.
    """
    if options.executor == "ray":
        require("ray", "--executor ray")
    out = str(options.out).removeprefix("file://")
    if options.address is not None and options.executor != "ray":
        raise OptionError(f"--address {options.address} without --executor ray", cure="add --executor ray")
    asked = SimulatedMachine.to_learn_in(
        options.task, options.estimate, options.effects, why="histories go over all values of the parameters"
    )
    machine = asked.task
    checkpoints = [options.policy] if Path(options.policy).exists() else []
    if not is_url(out):
        read = [options.inputs_from, options.estimate, *checkpoints, *task_inputs(machine).values()]
        refuse_inputs(Path(out), read)
    machine = _action_task(machine, options)
    recipe = _recipe(machine, asked.effects, options)
    attributes = _attributes(recipe, options)
    inputs = {"task": machine.path, "inputs_from": options.inputs_from, "estimate": options.estimate}
    provenance = Provenance("gen-histories", options.recorded(), inputs)
    if options.resume and not options.force and is_complete(HistoriesWriter(out), attributes, checkpoints):
        return _summary(out, attributes, made=0, seconds=0.0)
    if isinstance(machine, SequenceTask):
        check_parameters_move_trajectories(
            machine.with_effects(asked.effects.at_middle), seed=options.seed, threads=options.threads
        )
    if isinstance(machine, AimedTask):
        warn(
            "a policy drives these episodes from the model's initial state, and a log has windows: what is trained on "
            "them serves eval-sim2sim, and identify refuses it",
            "leave --policy out where an identifier is to read logs",
        )
    began = time.monotonic()
    with (
        _shard_maker(options) as make_shards,
        place(out, force=options.force, resume=options.resume) as location,
    ):
        writer = HistoriesWriter(location)
        todo = shards_to_make(writer, attributes, checkpoints)
        pairs = range(options.pairs)
        shards = [(s, pairs[shard_rows(s, options.shard_pairs, len(pairs))]) for s in todo]
        _follow(make_shards(recipe, writer, shards, options.threads), shards, len(pairs), options.quiet)
        writer.finish()
        if not is_url(location):
            provenance.write(Path(location))
    return _summary(out, attributes, made=len(todo), seconds=time.monotonic() - began)


# --- what is asked for ---


def _action_task(machine: Task, options: GenHistoriesOptions) -> ActionTask:
    """A built-in task as it is; that of a task.toml with actions of its policy, or made as the options say."""
    given = {n: v for n in OF_SEQUENCES if (v := getattr(options, n)) not in (None, {})}
    machine = played(machine, options.policy)
    if not isinstance(machine, ActionTask):
        lasts = {name: given[name] for name in ("window", "points") if name in given}
        return sequence_task(machine, _actions(options), **lasts, seed=options.seed)
    if given:
        names = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        raise OptionError(
            f"{names}: {machine.name!r} has actions of its own, or those of its policy",
            cure="leave it out, or give a task.toml without --policy",
        )
    return machine


def _actions(options: GenHistoriesOptions) -> LogWindows | Multisines:
    """Where actions of a machine that has none come from."""
    driven = {name: v for name in ("amplitude", "band") if (v := getattr(options, name))}
    if options.inputs_from is None:
        return Multisines(**driven)
    for name in driven:
        raise OptionError(
            f"--{name} means nothing: the actions are the windows of {options.inputs_from}",
            cure="leave it out",
        )
    return LogWindows(options.inputs_from, options.max_log_size)


def _recipe(machine: ActionTask, effects: EffectRanges, options: GenHistoriesOptions) -> Recipe:
    features = [f.name for f in machine.features]
    observation_noise.check(options.noise, features)
    return Recipe(
        task=machine,
        policy=load_policy(options.policy, machine),
        effects=effects,
        search=_search(options.search, options.alpha),
        rounds=options.rounds,
        noise=options.noise,
        noise_sd=standard_deviations("--noise-sd", options.noise_sd, features, "a trajectory has no feature"),
        seed=options.seed,
    )


def _search(name: str, alpha: float | None) -> Search:
    cls = SEARCHES.get(name)
    if alpha is None:
        return cls()
    if cls.alpha is None:
        raise OptionError(
            f"--alpha {alpha:g}: {name} draws from no Beta",
            cure="leave it out, or --search randomized-binary",
        )
    if not 0 < alpha < np.inf:
        raise OptionError(f"--alpha {alpha:g}", cure=f"give a positive number; the paper's is {cls.alpha:g}")
    return cls(alpha)


def _attributes(recipe: Recipe, options: GenHistoriesOptions) -> dict[str, Any]:
    """All that the store says of itself; equal attributes mean equal bytes."""
    task = recipe.task
    return {
        "task": task.name,
        "model": model_hash(task.model),
        "parameters": task.space.ranges(),
        "actions": task.actions.ranges(),
        "library": library_hash(task),
        "features": [asdict(f) for f in task.features],
        "point_times": np.asarray(task.point_times, dtype=float).tolist(),
        "pairs": options.pairs,
        "shard_pairs": options.shard_pairs,
        "rounds": recipe.rounds,
        "search": options.search,
        "alpha": None if recipe.search.alpha is None else float(recipe.search.alpha),
        "effects": recipe.effects.rows(),
        "noise": recipe.noise,
        "noise_sd": {f.name: s for f, s in zip(task.features, recipe.noise_sd, strict=True)},
        "policy": recorded_policy(options.policy),
        "seed": recipe.seed,
        "mujoco": mujoco.__version__,
    }


# --- the work ---


def _shard_maker(options: GenHistoriesOptions) -> AbstractContextManager[Callable[..., Iterator[int]]]:
    """A function of (recipe, writer, shards (number, pairs), threads) that yields how many pairs each shard held."""
    if options.executor == "local":
        return nullcontext(_make_here)
    from capture_cli.context.histories.ray_cluster import ray_cluster

    return ray_cluster(options.address)


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
