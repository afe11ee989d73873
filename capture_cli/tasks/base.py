"""What a task is: a compiled model, the parameters that are open, and the channels of its logs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import mujoco
import numpy as np

from capture_cli.parameters import ParameterSpace
from capture_cli.sim.engine import ModelFields


@dataclass(frozen=True)
class Channel:
    """One input or output: a column of a log, brought to `unit` by value = scale * column + offset.

    index: the actuator (inputs) or the column of sensordata (outputs) it belongs to. sensor: the output's sensor id.
    noise_sd: known standard deviation of an output's noise, in `unit`; None where it is to be estimated.
    linear: whether an input is interpolated between samples rather than held.
    """

    name: str
    unit: str
    column: str
    index: int
    sensor: int = -1
    scale: float = 1.0
    offset: float = 0.0
    noise_sd: float | None = None
    linear: bool = False


@dataclass(frozen=True)
class LogColumns:
    """Which columns of a source file hold time and episode, and how long a window is, in s (None: the episode)."""

    time: str = "time"
    episode: str | None = None
    window: float | None = None


class Task(ABC):
    """A machine: `model`, `space` (its open parameters), `inputs`, `outputs`, and how its logs are cut."""

    name: str
    model: mujoco.MjModel
    space: ParameterSpace
    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    log: LogColumns

    @abstractmethod
    def write(self, fields: ModelFields, parameters: np.ndarray) -> None:
        """Set `parameters` (simulation, parameter) in the model of each simulation."""

    @property
    def timestep(self) -> float:
        """Model step, s."""
        return float(self.model.opt.timestep)

    def controls(self, inputs: np.ndarray) -> np.ndarray:
        """Inputs (..., input) as ctrl (..., nu); actuators that are no input get 0."""
        ctrl = np.zeros((*inputs.shape[:-1], self.model.nu))
        ctrl[..., [c.index for c in self.inputs]] = inputs
        return ctrl
