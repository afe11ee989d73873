"""What closing the loop gained, as a picture and in words: `python -m docs.closed_loop_picture FOLDER PICTURE`.

FOLDER is what closed_loop.sh made.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.ticker import MaxNLocator, PercentFormatter

from capture_cli.report.figure_parts import INK, MUTED, PALETTE, new_figure, save
from capture_cli.store.evaluation import Evaluation

NAMES = {
    "declared": ("before: the declared model", "--before"),
    "mended": ("after: with what was found", "--after"),
}
RESAMPLED = 10_000  # times that pairs are drawn anew
INTERVAL = (2.5, 97.5)  # %


@dataclass(frozen=True)
class Judged:
    """Of one identifier and its policy: distance and success (pair, round), m and of no unit."""

    distance: np.ndarray
    success: np.ndarray

    @classmethod
    def read(cls, folder: Path) -> Judged:
        arrays = Evaluation.read(folder).arrays
        return cls(*(arrays[name][0, 0].astype(float) for name in ("trajectory_difference", "success")))


def main(folder: Path, picture: Path) -> None:
    """Print what was gained, with its intervals, and draw it."""
    judged = {name: Judged.read(folder / name / "evaluation") for name in NAMES}
    pairs, rounds = judged["declared"].distance.shape
    chosen = np.random.default_rng(0).integers(pairs, size=(RESAMPLED, pairs))
    for name, of in judged.items():
        print(f"{name}: distance at {rounds - 1} over that at 0 {_with_interval(_gain(of.distance, chosen))}")
        print(f"  success {[int(n) for n in of.success.sum(axis=0)]} of {pairs}")
    before, after = (of.success[:, -1] for of in judged.values())
    ratio = np.append(after.sum(), after[chosen].sum(axis=1)) / np.append(
        before.sum(), before[chosen].sum(axis=1)
    )
    print(f"success after over before {_with_interval(ratio)}")
    print(f"  only after {int((after > before).sum())}, only before {int((after < before).sum())}")
    _draw(judged, chosen, picture)


def _gain(distance: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Of all pairs first, then as they are drawn."""
    of_draws = distance[chosen].mean(axis=1)
    return np.append(distance[:, -1].mean() / distance[:, 0].mean(), of_draws[:, -1] / of_draws[:, 0])


def _with_interval(values: np.ndarray) -> str:
    low, high = np.percentile(values[1:], INTERVAL)
    return f"{values[0]:.3g} (95 %: {low:.3g} to {high:.3g})"


def _draw(judged: dict[str, Judged], chosen: np.ndarray, picture: Path) -> None:
    figure = new_figure(3.0)
    axes = figure.subplots(1, 2)
    for name, of in judged.items():
        label, colour = NAMES[name]
        for axis, values in zip(axes, (100 * of.distance, of.success), strict=True):
            rounds = np.arange(values.shape[1])
            low, high = np.percentile(values[chosen].mean(axis=1), INTERVAL, axis=0)
            axis.fill_between(rounds, low, high, color=PALETTE[colour], alpha=0.15, lw=0)
            axis.plot(rounds, values.mean(axis=0), color=PALETTE[colour], label=label)
    for axis, title in zip(axes, ("trajectory difference, cm", "task success"), strict=True):
        axis.set_title(title, loc="left", fontsize=10)
        axis.set_xlabel("measured strokes", color=MUTED)
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        axis.tick_params(colors=INK, labelsize=9)
        axis.spines[["top", "right"]].set_visible(False)
        axis.set_ylim(bottom=0)
    axes[1].set_ylim(0, 1)
    axes[1].yaxis.set_major_formatter(PercentFormatter(1.0))
    axes[0].legend(frameon=False, fontsize=9)
    save({picture.stem: lambda: figure}, picture.parent)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
