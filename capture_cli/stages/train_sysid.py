"""`capture train-sysid`: histories in, a learned identifier's checkpoint directory out (paper, Section III-D)."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from capture_cli.common.extras import require
from capture_cli.common.progress import Progress
from capture_cli.context.checkpoints.identifier_checkpoint import read_document, save_identifier
from capture_cli.context.checkpoints.training_state import (
    STATE,
    check_made,
    kept,
    load_state,
    save_state,
    write_metrics,
)
from capture_cli.context.identifiers import REGISTRY, round_identifier
from capture_cli.context.identifiers._architecture import DEFAULT_TOKENS
from capture_cli.context.identifiers.base import Rounds, Signature
from capture_cli.context.torch_device import torch_device
from capture_cli.errors import OptionError, StoreError
from capture_cli.options.base import takes_options
from capture_cli.options.train_sysid import TrainSysidOptions
from capture_cli.store.histories import SCHEMA, Histories, is_url
from capture_cli.store.output import is_complete, refuse_inputs, resumable_directory, unfinished
from capture_cli.store.provenance import Provenance

if TYPE_CHECKING:
    from capture_cli.context.identifiers._learned import LearnedIdentifier
    from capture_cli.context.identifiers._training import Device, Settings, Trainer
    from capture_cli.context.identifiers._transformer import Architecture

# options of the transformer and of its training, by their names there
SIZES = ("width", "layers", "heads", "dropout")
TRAINING = ("steps", "batch", "learning_rate", "weight_decay", "validation", "patience", "seed")
# attributes of a store that the signature holds, or that do not change what is in it
NOT_OF_HISTORIES = {"complete", "shard_pairs", "task", "parameters", "actions", "features", "point_times"}
OF_EVERY_KIND = "scattered"  # the search whose histories are meant for posteriors


@takes_options
def train_sysid(options: TrainSysidOptions) -> dict[str, Any]:
    """Train the identifier on the store `histories`; write its checkpoint directory at `out`; returns identifier.json.

    With `resume` a run that was killed goes on from its last evaluation to the same result, and one that is complete is
    read. Raises CaptureError before anything is written.
    """
    require("learn", "train-sysid")
    out, resume = options.out, options.resume
    complete = is_complete(out, force=options.force, resume=resume)
    kind = _learned(options.identifier)
    store = Histories(options.histories)
    signature = Signature.from_document(store.attributes)
    _check_size(store)
    window = _window(kind, options, store.attributes["rounds"])
    _check_tokens(kind, options)
    if not options.quiet:
        _note_search(options.identifier, kind, store.attributes["search"])
    trains_on = None if is_url(str(options.histories)) else Path(options.histories)
    refuse_inputs(out, [trains_on])
    where = _device(options)
    # torch is imported from here on: its settings are made
    from capture_cli.context.identifiers._training import Trainer, TrainingHistories

    architecture, settings = _architecture(kind, signature, window, options), _settings(options)
    recipe = {
        "identifier": options.identifier,
        "task": signature.task,
        "architecture": asdict(architecture),
        "training": asdict(settings),
        "histories": {n: store.attributes[n] for n in SCHEMA.attributes if n not in NOT_OF_HISTORIES},
    }
    if complete:
        document = read_document(out)
        check_made(document, recipe)
        return document
    provenance = Provenance("train-sysid", options.recorded(), {"histories": trains_on})
    _check_finite(store, options.quiet)

    def read(first: int, last: int) -> Rounds:
        return Rounds(**store.read(first, last))

    trainer = Trainer(kind, TrainingHistories(signature, read, len(store)), architecture, settings, where)
    recipe_here = {**recipe, "device": asdict(where)}
    state = load_state(unfinished(out), recipe_here) if resume else None
    if state is not None:
        trainer.restore(*state)
    with resumable_directory(out, kept=kept, scaffold=[STATE], force=options.force, resume=resume) as folder:
        _train(trainer, folder, recipe_here, options.quiet)
        document = _finish(trainer, recipe, folder)
        provenance.write(folder)
    return document


# --- checks, before anything is written ---


def _learned(name: str) -> type[LearnedIdentifier]:
    kind = REGISTRY.get(name, lambda kind: kind.needs_checkpoint)
    if not kind.needs_checkpoint:
        learned = [n for n, c in REGISTRY.items() if c.needs_checkpoint]
        raise OptionError(f"--identifier {name} learns nothing", cure=f"choose {', '.join(learned)}")
    return round_identifier(name)


def _check_size(store: Histories) -> None:
    smallest_histories = 10  # pairs
    if len(store) < smallest_histories:
        raise StoreError(
            f"{store.location} holds {len(store)} histories",
            cure=f"make at least {smallest_histories}; thousands are needed to learn anything",
        )


def _window(kind: type[LearnedIdentifier], options: TrainSysidOptions, rounds: int) -> int:
    window = options.window
    if kind.fixed_window is not None:
        if window not in (None, kind.fixed_window):
            raise OptionError(
                f"--window {window}: {options.identifier} reads {kind.fixed_window} round",
                cure="leave it out",
            )
        return kind.fixed_window
    if window is None:
        return min(kind.default_window or rounds, rounds)
    if not 1 <= window <= rounds:
        raise OptionError(
            f"--window {window}: the histories have {rounds} rounds",
            cure=f"give 1 to {rounds}, or make longer histories with `capture gen-histories --rounds`",
        )
    return window


def _check_tokens(kind: type[LearnedIdentifier], options: TrainSysidOptions) -> None:
    if kind.tokens in (None, options.tokens) or options.tokens is None:
        return
    others = [n for n, c in REGISTRY.items() if getattr(c, "tokens", None) == options.tokens]
    raise OptionError(
        f"--tokens {options.tokens!r}: {options.identifier} has one token a {kind.tokens}",
        cure=" or ".join(["leave it out", *(f"--identifier {other}" for other in others)]),
    )


def _note_search(name: str, kind: type[LearnedIdentifier], search: str) -> None:
    """On stderr, where the histories were searched in another way than the identifier will."""
    if kind.any_order and search != OF_EVERY_KIND:
        print(
            f"note: {name} will ask other questions than {search} did; on histories by --search {OF_EVERY_KIND} it "
            "learns to know better how sure it is",
            file=sys.stderr,
        )


def _check_finite(store: Histories, quiet: bool) -> None:
    """Read everything once: damage shows now rather than after an hour. The store says what is wrong, and where."""
    checked_pairs = 8192  # read at once while looking for what is not finite
    with Progress("reading", "block", quiet=quiet, total=-(-len(store) // checked_pairs)) as progress:
        for first in range(0, len(store), checked_pairs):
            store.read(first, min(first + checked_pairs, len(store)))
            progress.step(f"{first} of {len(store)} pairs checked")


def _device(options: TrainSysidOptions) -> Device:
    """Where to compute, and how precisely. Raises OptionError."""
    name = torch_device(options.device, options.threads)
    # torch is imported from here on
    from capture_cli.context.identifiers._training import Device

    # on a CPU bfloat16 gains little or nothing, and rounds
    return Device(name, options.precision == "bfloat16" or (options.precision == "auto" and name == "cuda"))


# --- what is trained, and how ---


def _architecture(
    kind: type[LearnedIdentifier], signature: Signature, window: int, options: TrainSysidOptions
) -> Architecture:
    """The transformer of the sizes in the options, for histories of the signature's shapes."""
    from capture_cli.context.identifiers._transformer import Architecture

    points, features = signature.trajectory_shape
    return Architecture(
        parameters=len(signature.space),
        actions=len(signature.actions),
        points=points,
        features=features,
        window=window,
        residual=kind.residual,
        tokens=kind.tokens or options.tokens or DEFAULT_TOKENS,
        **{name: getattr(options, name) for name in SIZES},
    )


def _settings(options: TrainSysidOptions) -> Settings:
    """How to train; of a short training half is the warm-up at most."""
    from capture_cli.context.identifiers._training import Settings

    warmup = min(options.warmup, options.steps // 2)
    return Settings(warmup=warmup, **{name: getattr(options, name) for name in TRAINING})


# --- the work ---


def _train(trainer: Trainer, folder: Path, recipe: Mapping[str, Any], quiet: bool) -> None:
    write_metrics(folder, trainer.metrics)
    steps, done, clock = trainer.settings.steps, trainer.step, time.monotonic()
    left = -(-(steps - done) // trainer.settings.every)
    with Progress("train-sysid", "evaluation", quiet=quiet, total=left) as progress:
        for metrics in trainer.run():
            write_metrics(folder, trainer.metrics)
            save_state(folder, *trainer.state(), recipe)
            step, loss = metrics["step"], metrics["validation_loss"]
            rate = (step - done) / (time.monotonic() - clock)
            progress.step(
                f"step {step} of {steps}, validation loss {loss:.3g}, "
                f"{rate:.1f} steps/s, {(steps - step) / rate:.0f} s left at most"
            )


def _finish(trainer: Trainer, recipe: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Write what was learned; returns identifier.json."""
    from capture_cli.report.training import write_identifier_figure

    model, report = trainer.finish()
    document = save_identifier(model, {**recipe, "result": report}, folder)
    write_identifier_figure(trainer.metrics, trainer.best["step"], trainer.kind.likelihood, folder)
    return document
