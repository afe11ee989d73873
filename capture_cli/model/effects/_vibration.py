"""A mass on a spring that is shaken: what a loose mass and a base that gives share."""

from __future__ import annotations

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.model.effects.base import Effect, spread
from capture_cli.model.parameters import Parameter


@frozen
class SETTINGS:
    # Hz
    slowest: float = 0.3
    fastest: float = 20.0
    # Swings within a window, at least: with how it begins free, less of one imitates any force that changes slowly.
    swings: float = 0.5
    # How much farther it commonly swings, before a window begins, than what pushes it would push it once
    resonates: float = 4.0


class Vibration:
    """apart d'' + 2 zeta w d' + w^2 d = -shaken, w = 2 pi frequency, by trapezoidal steps, which damp nothing.

    displaced, moving: d and d' at the start.
    """

    def __init__(self, *, frequency, damping_ratio, timestep, displaced=0.0, moving=0.0):
        self.timestep = timestep
        self.turning = 2 * np.pi * frequency  # w, rad/s
        self.slowing = 2 * damping_ratio * self.turning
        self.displaced, self.rate = displaced + 0.0 * frequency, moving + 0.0 * frequency  # d, d'
        self.change = None  # d''

    def advance(self, shaken, apart=1.0):
        """The mean of d'' over a step."""
        h = self.timestep
        if self.change is None:
            self.change = -(shaken + self.turning**2 * self.displaced + self.slowing * self.rate) / apart
        pulled = self.turning**2 * (self.displaced + h * self.rate + h * h / 4 * self.change)
        pulled = pulled + self.slowing * (self.rate + h / 2 * self.change)
        resists = apart + self.slowing * h / 2 + (self.turning * h) ** 2 / 4
        now = -(shaken + pulled) / resists
        mean = (self.change + now) / 2
        self.displaced = self.displaced + h * self.rate + h * h / 2 * mean
        self.rate, self.change = self.rate + h * mean, now
        return mean


class VibrationEffect(Effect):
    """An effect of something that swings. Its parameters are how much does, the frequency and the damping ratio."""

    shapes = ("frequency", "damping_ratio")
    vague_at_end = ("frequency",)
    states = ("displaced", "moving")
    states_mean = (
        "`displaced`, `moving`: how far (m or rad) and how fast (m/s or rad/s; its `rate`) what swings is from where "
        "it rests. At 1 what an acceleration of the base (5 m/s^2 times `mobility`), or of the joint by its greatest "
        "common force, comes to at resonance: 4 times it over w^2, and over w, with w = 2 pi `frequency`"
    )

    @property
    def swinging(self) -> tuple[Parameter, Parameter]:
        """The frequency and the damping ratio."""
        slowest = float(
            np.clip(SETTINGS.swings / (self.window or np.inf), SETTINGS.slowest, SETTINGS.fastest / 4)
        )
        return (
            Parameter("frequency", "Hz", slowest, SETTINGS.fastest, max(2 * slowest, 2.0)),
            Parameter("damping_ratio", "1", 0.002, 0.7, 0.05),
        )

    def shape_grid(self, count=5):
        # resonances are narrow, and how narrow shows once the frequency is right
        grid = np.repeat(self.space.nominal[None], 2 * count, axis=0)
        grid[:, 1] = spread(self.parameters[1], 2 * count)
        return grid

    def doubt(self, values, duration):
        if values[1] * duration >= 1:
            return None
        return f"it swings once in {1 / values[1]:.3g} s, and no episode lasts longer than {duration:.3g} s"

    def begins(
        self, values: np.ndarray, states: np.ndarray | None, push: np.ndarray | float
    ) -> dict[str, np.ndarray]:
        """How it begins, (simulation,) each, at `states`; push: its usual accelerations, m/s^2 or rad/s^2."""
        states = np.zeros((len(values), len(self.states))) if states is None else states
        turning, size = 2 * np.pi * values[:, 1], SETTINGS.resonates * push
        return {"displaced": size / turning**2 * states[:, 0], "moving": size / turning * states[:, 1]}
