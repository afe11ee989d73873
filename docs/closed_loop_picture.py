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
    """Of one identifier and its policy: distance, in `unit`, and success (pair, round)."""

    distance: np.ndarray
    success: np.ndarray
    unit: str

    @classmethod
    def read(cls, folder: Path) -> Judged:
        found = Evaluation.read(folder)
        distance, success = (
            found.arrays[name][0, 0].astype(float) for name in ("trajectory_difference", "success")
        )
        unit = found.attributes["features"][0]["unit"]
        return cls(100 * distance, success, "cm") if unit == "m" else cls(distance, success, unit)


def main(folder: Path, picture: Path) -> None:
    """Print what was gained, with its intervals, and draw it."""
    judged = {name: Judged.read(folder / name / "evaluation") for name in NAMES}
    pairs, rounds = judged["declared"].distance.shape
    chosen = np.random.default_rng(0).integers(pairs, size=(RESAMPLED, pairs))
    for name, of in judged.items():
        print(f"{name}: distance at {rounds - 1} over that at 0 {_with_interval(_gain(of.distance, chosen))}")
        print(f"  success {[int(n) for n in of.success.sum(axis=0)]} of {pairs}")
    before, after = (of.success[:, -1] for of in judged.values())
    print(f"success after over before {_with_interval(_ratio(after, before, chosen))}")
    print(f"  only after {int((after > before).sum())}, only before {int((after < before).sum())}")
    _draw(judged, chosen, picture)


def _gain(distance: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Of all pairs first, then as they are drawn."""
    of_draws = distance[chosen].mean(axis=1)
    return np.append(distance[:, -1].mean() / distance[:, 0].mean(), of_draws[:, -1] / of_draws[:, 0])


def _ratio(after: np.ndarray, before: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Of all pairs first, then as they are drawn; infinite where none succeeded before, 1 where none did at all."""
    after, before = (np.append(of.sum(), of[chosen].sum(axis=1)) for of in (after, before))
    ratio = np.full(len(after), np.inf)
    ratio[(before == 0) & (after == 0)] = 1
    return np.divide(after, before, out=ratio, where=before > 0)


def _with_interval(values: np.ndarray) -> str:
    # one of the values: between two infinite ones there is none
    low, high = np.percentile(values[1:], INTERVAL, method="nearest")
    return f"{values[0]:.3g} (95 %: {low:.3g} to {high:.3g})"


def _draw(judged: dict[str, Judged], chosen: np.ndarray, picture: Path) -> None:
    figure = new_figure(3.0)
    axes = figure.subplots(1, 2)
    for name, of in judged.items():
        label, colour = NAMES[name]
        for axis, values in zip(axes, (of.distance, of.success), strict=True):
            rounds = np.arange(values.shape[1])
            low, high = np.percentile(values[chosen].mean(axis=1), INTERVAL, axis=0)
            axis.fill_between(rounds, low, high, color=PALETTE[colour], alpha=0.15, lw=0)
            axis.plot(rounds, values.mean(axis=0), color=PALETTE[colour], label=label)
    unit = judged["declared"].unit
    for axis, title in zip(axes, (f"trajectory difference, {unit}", "task success"), strict=True):
        axis.set_title(title, loc="left", fontsize=10)
        axis.set_xlabel("measured rollouts", color=MUTED)
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
