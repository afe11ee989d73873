"""What a training of a policy came to: at the terminal, and training.png."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.ticker import EngFormatter, PercentFormatter
from rich import box
from rich.console import Console
from rich.table import Table

from capture_cli.reports.figure_parts import INK, MUTED, PALETTE, new_figure, save


def print_policy(document: Mapping[str, Any], console: Console, out: Path) -> None:
    """Print policy.json `document`, written to the directory `out`, beside the random policy."""
    result = document["result"]
    console.print(
        f"{out}: {document['policy']} for {document['task']}; judged on {result['episodes']} unseen parameter sets",
        soft_wrap=True,
    )
    table = Table("policy", "success", "reward", box=box.SIMPLE_HEAD)
    for name, row in ((document["policy"], result), ("random", result["random"])):
        table.add_row(name, f"{row['success']:.1%}", f"{row['reward']:.3f}")
    console.print(table)


def write_figure(metrics: Sequence[Mapping[str, Any]], result: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write training.png: reward and success at every evaluation, and those of the random policy; returns its path."""
    figure = new_figure(3.2)
    steps = [m["step"] for m in metrics]
    for axis, key in zip(figure.subplots(1, 2), ("reward", "success"), strict=True):
        axis.plot(steps, [m[key] for m in metrics], color=PALETTE["--after"], label="held-out parameters")
        exploring = [m[f"training_{key}"] for m in metrics]
        axis.plot(steps, exploring, color=PALETTE["--before"], lw=1, label="while exploring")
        random = result["random"][key]
        axis.axhline(random, color=PALETTE["--nominal"], lw=1, ls=(0, (2, 2)), label="random policy")
        axis.set_title(key, loc="left", fontsize=10)
        axis.set_xlabel("episodes", color=MUTED)
        axis.xaxis.set_major_formatter(EngFormatter())
        axis.tick_params(colors=INK, labelsize=9)
        axis.spines[["top", "right"]].set_visible(False)
        if key == "success":
            axis.set_ylim(-0.03, 1.03)
            axis.yaxis.set_major_formatter(PercentFormatter(1.0))
            axis.legend(frameon=False, fontsize=9)
    return save({"training": lambda: figure}, folder)
