"""One evaluation: identifiers against each other on the same pairs (paper, Section IV-C). Shared by stages."""

from __future__ import annotations

import json
import shutil
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli import observation_noise
from capture_cli.errors import OptionError, OutputError, TaskError
from capture_cli.identifiers.rounds import Signature
from capture_cli.simulator import Simulator
from capture_cli.stages.evaluated_identifier import Evaluated, load_evaluated
from capture_cli.stages.evaluation_summary import summary
from capture_cli.stages.policy_checkpoint import SETTINGS, load_policy
from capture_cli.stages.progress import Progress
from capture_cli.stages.sim2sim import Sim2Sim, batched
from capture_cli.stores.evaluation import FORMAT, SCHEMA, VERSION, Evaluation, joined
from capture_cli.stores.output import refuse_existing, resumable_directory, sha256
from capture_cli.stores.provenance import Provenance, write_json
from capture_cli.tasks import load_task
from capture_cli.tasks.base import ActionTask

PARTS, RECIPE = "parts", "recipe.json"  # of a run that is not complete
PROBED = 64  # episodes, simulated to see how long it will take
PROBED_PAIRS, PROBED_ROUNDS = 2, 5  # of identifiers that simulate by themselves
SMALLEST_PLANNED = 50  # pairs in all, from which on it is said how long it will take


def evaluate(
    *,
    task: str | None,
    identifiers: Sequence[str],
    out: Path,
    policy: str = "random",
    pairs: int = 100,
    seeds: int = 3,
    rounds: int = 30,
    noise: str = "none",
    seed: int = 0,
    threads: int | None = None,
    known_noise: bool = False,
    force: bool = False,
    resume: bool = False,
    quiet: bool = True,
) -> Evaluation:
    """Evaluate `identifiers` on `pairs` pairs of `task`, `seeds` times; write the evaluation directory at `out`.

    identifiers: as `load_evaluated` takes them. noise: one of `observation_noise.NOISES`, on what is measured.
    known_noise: identifiers are told which labels are random. With `resume` a run that was killed goes on after the
    identifier and seed it last completed, and one that is complete is read. The arrays do not depend on
    `threads`. Raises CaptureError before any work.
    """
    options = {k: v for k, v in locals().items() if k not in ("force", "resume", "quiet")}
    _check(pairs, seeds, rounds)
    machine = _action_task(task)
    observation_noise.check(noise, [f.name for f in machine.features])
    chosen = load_policy(policy, machine)
    evaluated = load_evaluated(identifiers, Signature.of(machine))
    if known_noise:
        observation_noise.error_rate(noise)
    attributes = _attributes(machine, policy, f"{noise} (known)" if known_noise else noise, seed, evaluated)
    recipe = {"pairs": pairs, "seeds": seeds, "rounds": rounds, **attributes}
    if resume and not force and Path(out).exists():
        return _completed(Path(out), recipe)
    refuse_existing(out, force=force)
    provenance = Provenance("eval-sim2sim", options, {})
    draws = [
        Sim2Sim(machine, chosen, pairs, rounds, noise, seed, number, threads, known_noise)
        for number in range(seeds)
    ]
    with resumable_directory(out, force=force, resume=resume) as folder:
        _begin(folder, recipe)
        _run(evaluated, draws, folder, attributes, quiet)
        arrays = _joined(folder, evaluated, draws)
        document = {"format": FORMAT, "version": VERSION, **summary(arrays, attributes, machine.trainable)}
        evaluation = Evaluation(document, arrays, attributes)
        evaluation.write(folder)
        _write_reports(evaluation, folder)
        shutil.rmtree(folder / PARTS)
        (folder / RECIPE).unlink()
        provenance.write(folder)
    return evaluation


# --- what is asked for ---


def _check(pairs: int, seeds: int, rounds: int) -> None:
    for option, value in (("--pairs", pairs), ("--seeds", seeds), ("--rounds", rounds)):
        if value < 1:
            raise OptionError(f"{option} {value}", cure="give at least 1")


def _action_task(name: str | None) -> ActionTask:
    if name is None:
        raise OptionError("no --task", cure="name one, or run all with --suite paper")
    machine = load_task(name)
    if not isinstance(machine, ActionTask):
        raise TaskError(
            f"{name} has no actions of its own, which a round chooses",
            cure="give a built-in task (`capture tasks` lists them); a machine's own log is for `capture identify`",
        )
    return machine


def _attributes(task: ActionTask, policy: str, noise: str, seed: int, evaluated: list[Evaluated]) -> dict:
    checkpoint = (Path(policy) / SETTINGS).is_file()
    return {
        "task": task.name,
        "parameters": [{k: getattr(p, k) for k in ("name", "unit", "low", "high")} for p in task.space],
        "features": [{"name": f.name, "unit": f.unit, "scale": f.scale} for f in task.features],
        "identifiers": [{"label": e.label, **e.facts} for e in evaluated],
        "policy": {
            "name": Path(policy).name if checkpoint else policy,
            "sha256": sha256(Path(policy)) if checkpoint else None,
        },
        "noise": noise,
        "seed": seed,
    }


def _completed(out: Path, recipe: dict[str, Any]) -> Evaluation:
    """The evaluation at `out`, if it is the one asked for. Raises CaptureError otherwise."""
    evaluation = Evaluation.read(out)
    _, seeds, pairs, entries = evaluation.arrays["trajectory_difference"].shape
    _refuse_other(
        {"pairs": pairs, "seeds": seeds, "rounds": entries - 1, **evaluation.attributes}, recipe, out
    )
    return evaluation


def _begin(folder: Path, recipe: dict[str, Any]) -> None:
    """Take note of what is run, or see that it is what an earlier run took note of."""
    path = folder / RECIPE
    if path.is_file():
        _refuse_other(json.loads(path.read_text(encoding="utf-8")), recipe, folder)
    (folder / PARTS).mkdir(exist_ok=True)
    write_json(path, recipe)


def _refuse_other(found: dict[str, Any], wanted: dict[str, Any], where: Path) -> None:
    other = [k for k in wanted if found.get(k) != wanted[k]]
    if other:
        raise OptionError(
            f"--resume: {where} was begun with other {', '.join(other)}",
            cure="give the options it was begun with, or begin anew with --force",
        )


# --- the work ---


def _run(
    evaluated: list[Evaluated], draws: list[Sim2Sim], folder: Path, attributes: dict, quiet: bool
) -> None:
    parts = [(k, e, draw) for k, e in enumerate(evaluated) for draw in draws]
    todo = [(k, e, draw) for k, e, draw in parts if not _part(folder, k, draw).is_dir()]
    if not quiet:
        _say_how_long([(e, draw) for _, e, draw in todo], draws[0])
    try:
        with Progress("eval-sim2sim", "round", quiet=quiet, total=len(todo) * draws[0].rounds) as progress:
            for k, e, draw in todo:
                label = f"{e.label}, seed {draw.number + 1} of {len(draws)}"
                arrays = draw.run(e.make, lambda n, label=label: progress.step(f"{label}, round {n + 1}"))
                _keep(_part(folder, k, draw), arrays, draw, attributes)
    except KeyboardInterrupt:
        kept = sum(_part(folder, k, draw).is_dir() for k, _, draw in parts)
        raise OutputError(
            f"interrupted: {kept} of {len(parts)} parts are kept",
            cure="go on with the same command and --resume",
        ) from None


def _part(folder: Path, k: int, draw: Sim2Sim) -> Path:
    """Where identifier k's results of one seed are kept."""
    return folder / PARTS / f"{k}-{draw.number}"


def _keep(path: Path, arrays: dict[str, np.ndarray], draw: Sim2Sim, attributes: dict) -> None:
    source, target = draw.ends()
    arrays = {name: a[None, None] for name, a in arrays.items()}
    arrays |= {"source": source[None], "target": target[None]}
    beside = path.with_name(f"{path.name}.new")
    shutil.rmtree(beside, ignore_errors=True)
    SCHEMA.write(beside, arrays, attributes)
    beside.rename(path)


def _joined(folder: Path, evaluated: list[Evaluated], draws: list[Sim2Sim]) -> dict[str, np.ndarray]:
    by_identifier = []
    for k in range(len(evaluated)):
        parts = [SCHEMA.read(_part(folder, k, draw))[0] for draw in draws]
        by_identifier.append(joined(parts, "seed"))
    return joined(by_identifier, "identifier")


def _say_how_long(todo: list[tuple[Evaluated, Sim2Sim]], machine: Sim2Sim) -> None:
    """One line on stderr: what is to be done, and about how long that takes here and now.

    What identifiers simulate by themselves is seen on a few pairs and rounds, and taken to go on so.
    """
    pairs = sum(draw.pairs for _, draw in todo)
    if pairs < SMALLEST_PLANNED:
        return
    seen: dict[str, np.ndarray] = {}
    rollouts, probe = 0.0, replace(machine, pairs=PROBED_PAIRS, rounds=min(machine.rounds, PROBED_ROUNDS))
    for e, draw in todo:
        per_pair = draw.rounds * (1 + e.kind.candidates)
        if e.kind.simulates:
            spent = seen.get(e.label)
            if spent is None:
                spent = seen[e.label] = probe.run(e.make)["simulated_rollouts"].mean(axis=0)
            per_pair = draw.rounds + spent[-1] + (draw.rounds - probe.rounds) * (spent[-1] - spent[-2])
        rollouts += per_pair * draw.pairs
    rate = _rate(machine)
    print(
        f"about {rollouts:.3g} rollouts at {rate:.0f}/s: {_duration(rollouts / rate)}",
        file=sys.stderr,
        flush=True,
    )


def _rate(draw: Sim2Sim) -> float:
    """Rollouts per second."""
    source, _ = Sim2Sim(draw.task, draw.policy, PROBED, 1, seed=draw.seed).ends()
    uniform = np.random.default_rng(0).random((PROBED, len(draw.task.actions)))
    actions = draw.policy.act(source, uniform)
    began = time.monotonic()
    batched(Simulator(draw.task, threads=draw.threads))(source, actions)
    return PROBED / (time.monotonic() - began)


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"


def _write_reports(evaluation: Evaluation, folder: Path) -> None:
    from capture_cli.reports.evaluation_figures import write_figures
    from capture_cli.reports.evaluation_tables import markdown

    (folder / "tables.md").write_text(markdown(evaluation.document), encoding="utf-8")
    write_figures(evaluation.document, folder)
