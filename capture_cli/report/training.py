"""What a training came to: of an identifier, with loss.png, and of a policy, with training.png."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.ticker import EngFormatter, PercentFormatter
from rich import box
from rich.console import Console
from rich.table import Table

from capture_cli.report.figure_parts import PALETTE, RULE, new_figure, restrain, save, title
from capture_cli.store.trained import TrainedIdentifier, TrainedPolicy


def print_training(document: Mapping[str, Any], console: Console, out: Path) -> None:
    """Print identifier.json `document`, written to the directory `out`: errors on pairs that were held out."""
    trained = TrainedIdentifier.of(document)
    result, asked = trained.result, trained.training["steps"]
    early = f", where it stopped: nothing gained in {trained.training['patience']} evaluations"
    console.print(
        f"{out}: {trained.identifier} for {trained.task}, window {trained.architecture['window']}; "
        f"the weights of step {result['best_step']} of {result['steps']}{early if result['steps'] < asked else ''}",
        soft_wrap=True,
    )
    table = Table("parameter", "mean error / range", "95 % intervals cover", box=box.SIMPLE_HEAD)
    for name, error in result["mean_absolute_error"].items():
        table.add_row(name, f"{error:.4f}", f"{result['coverage'][name]:.1%}")
    console.print(table)


def write_identifier_figure(
    metrics: Sequence[Mapping[str, Any]], best_step: int, likelihood: bool, folder: Path
) -> list[Path]:
    """Write loss.png: the loss held out and the mean absolute error at every evaluation; returns its path.

    likelihood: whether the loss is a log likelihood, which can be negative, rather than a mean square.
    """
    figure = new_figure(3.2)
    loss, error = figure.subplots(1, 2)
    steps = [m["step"] for m in metrics]
    loss.plot(steps, [m["validation_loss"] for m in metrics], color=PALETTE["--simulated"])
    title(loss, "negative log likelihood" if likelihood else "mean squared error")
    for key, label, color in (
        ("mean_absolute_error", "all rounds", PALETTE["--before"]),
        ("last_round_error", "last round of the window", PALETTE["--after"]),
    ):
        error.plot(steps, [m[key] for m in metrics], color=color, label=label)
    title(error, "mean absolute error, share of the range")
    error.legend(frameon=False, fontsize=9)
    for axis in (loss, error):
        axis.axvline(best_step, color=RULE, zorder=0)
        _along(axis, "step")
        if not (likelihood and axis is loss):
            axis.set_yscale("log")
    return save({"loss": lambda: figure}, folder)


def print_policy(document: Mapping[str, Any], console: Console, out: Path) -> None:
    """Print policy.json `document`, written to the directory `out`, beside the random policy."""
    trained = TrainedPolicy.of(document)
    result = trained.result
    console.print(
        f"{out}: {trained.policy} for {trained.task}; judged on {result['episodes']} held-out parameter sets",
        soft_wrap=True,
    )
    table = Table("policy", "success", "reward", box=box.SIMPLE_HEAD)
    for name, row in ((trained.policy, result), ("random", result["random"])):
        table.add_row(name, f"{row['success']:.1%}", f"{row['reward']:.3f}")
    console.print(table)
    if result["reward"] <= result["random"]["reward"]:
        console.print(
            "warning: no better than random actions; train longer, or another --seed", soft_wrap=True
        )


def write_policy_figure(
    metrics: Sequence[Mapping[str, Any]], result: Mapping[str, Any], folder: Path
) -> list[Path]:
    """Write training.png: reward and success at every evaluation, and those of the random policy; returns its path."""
    figure = new_figure(3.2)
    steps = [m["step"] for m in metrics]
    for axis, key in zip(figure.subplots(1, 2), ("reward", "success"), strict=True):
        axis.plot(steps, [m[key] for m in metrics], color=PALETTE["--after"], label="held-out parameters")
        exploring = [m[f"training_{key}"] for m in metrics]
        axis.plot(steps, exploring, color=PALETTE["--before"], lw=1, label="while exploring")
        random = result["random"][key]
        axis.axhline(random, color=PALETTE["--nominal"], lw=1, ls=(0, (2, 2)), label="random policy")
        title(axis, key)
        _along(axis, "episodes")
        if key == "success":
            axis.set_ylim(-0.03, 1.03)
            axis.yaxis.set_major_formatter(PercentFormatter(1.0))
            axis.legend(frameon=False, fontsize=9)
    return save({"training": lambda: figure}, folder)


def _along(axis: Axes, what: str) -> None:
    """The axis of a training: numbers of `what`, thousands and millions of them."""
    restrain(axis)
    axis.set_xlabel(what)
    axis.xaxis.set_major_formatter(EngFormatter())
