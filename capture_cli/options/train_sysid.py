"""Options of `capture train-sysid`."""

from dataclasses import dataclass
from math import inf

from capture_cli.options.base import option
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

    histories: str = option(..., "Histories to learn from (.zarr): a path, or a URL.")
    out: CheckpointOut
    identifier: str = option("capture", f"{', '.join(LEARNED[:-1])} or {LEARNED[-1]}.", offers=LEARNED)
    tokens: str | None = option(
        None,
        "trajectory: one token each; step: one per state, as capture has. Others: trajectory.",
        offers=("trajectory", "step"),
    )
    window: int | None = option(
        None, "Rounds it reads (the paper's k); 4, or all for posterior and capture-refined.", min=1
    )
    width: int = option(128, "Width of the transformer.", min=1)
    layers: int = option(3, "Its layers.", min=1)
    heads: int = option(4, "Its attention heads.", min=1)
    dropout: float = option(0.0, "Share of activations dropped.", min=0, max=0.9)
    steps: int = option(20_000, "Optimiser steps at most.", min=1)
    batch: int = option(256, "Windows per step.", min=1)
    learning_rate: float = option(1e-3, "Highest learning rate.", name="--lr", within=(0, inf))
    warmup: int = option(200, "Steps until it is reached.", min=0)
    weight_decay: float = option(0.01, "Of AdamW.", min=0)
    validation: float = option(0.1, "Share of the pairs held out.", within=(0, 1))
    patience: int = option(
        10, "Stop after so many evaluations, of 50, without a gain since the warm-up.", min=1
    )
    precision: str = option(
        "auto", "float32, bfloat16, or auto: bfloat16 on a GPU.", one_of=("auto", "float32", "bfloat16")
    )
    device: Device = "auto"
    threads: int = option(1, "CPU threads; another number rounds otherwise.", min=1)
    seed: Seed = 0
    resume: Resume = False
