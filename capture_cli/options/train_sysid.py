"""Options of `capture train-sysid`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer

from capture_cli.options.completion import words
from capture_cli.options.shared import CheckpointOut, Device, Resume, Seed, Writing

LEARNED = (
    "capture",
    "capture-refined",
    "capture-trajectory",
    "expert-distillation",
    "expert-distillation-all-rounds",
    "posterior",
    "tunenet",
    "tunenet-all-rounds",
)


@dataclass(frozen=True, kw_only=True)
class TrainSysidOptions(Writing):
    """window: rounds that it reads; tokens: of a trajectory; None is the identifier's own."""

    histories: Annotated[str, typer.Option(help="Histories to learn from (.zarr): a path, or a URL.")]
    out: CheckpointOut
    identifier: Annotated[
        str, typer.Option(help=f"{', '.join(LEARNED[:-1])} or {LEARNED[-1]}.", autocompletion=words(*LEARNED))
    ] = "capture"
    tokens: Annotated[
        str | None,
        typer.Option(
            help="trajectory: one token each; step: one per state, as capture has. Others: trajectory.",
            autocompletion=words("trajectory", "step"),
        ),
    ] = None
    window: Annotated[
        int | None,
        typer.Option(
            min=1, help="Rounds it reads (the paper's k); 4, or all for posterior and capture-refined."
        ),
    ] = None
    width: Annotated[int, typer.Option(min=1, help="Width of the transformer.")] = 128
    layers: Annotated[int, typer.Option(min=1, help="Its layers.")] = 3
    heads: Annotated[int, typer.Option(min=1, help="Its attention heads.")] = 4
    dropout: Annotated[float, typer.Option(min=0, max=0.9, help="Share of activations dropped.")] = 0.0
    steps: Annotated[int, typer.Option(min=1, help="Optimiser steps at most.")] = 20_000
    batch: Annotated[int, typer.Option(min=1, help="Windows per step.")] = 256
    learning_rate: Annotated[float, typer.Option("--lr", help="Highest learning rate.")] = 1e-3
    warmup: Annotated[int, typer.Option(min=0, help="Steps until it is reached.")] = 200
    weight_decay: Annotated[float, typer.Option(min=0, help="Of AdamW.")] = 0.01
    validation: Annotated[float, typer.Option(help="Share of the pairs held out.")] = 0.1
    patience: Annotated[
        int,
        typer.Option(min=1, help="Stop after so many evaluations, of 50, without a gain since the warm-up."),
    ] = 10
    precision: Annotated[
        str,
        typer.Option(
            help="float32, bfloat16, or auto: bfloat16 on a GPU.",
            autocompletion=words("auto", "float32", "bfloat16"),
        ),
    ] = "auto"
    device: Device = "auto"
    threads: Annotated[int, typer.Option(min=1, help="CPU threads; another number rounds otherwise.")] = 1
    seed: Seed = 0
    resume: Resume = False
