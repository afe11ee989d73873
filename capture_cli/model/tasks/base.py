"""What a task is: a compiled model, the parameters that are open, and the channels of its logs."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

import mujoco
import numpy as np

from capture_cli.log.input_sequences import HELD, Hold
from capture_cli.model.fields import ModelFields
from capture_cli.model.parameters import ParameterSpace
from capture_cli.model.states import InitialStates


@dataclass(frozen=True)
class Channel:
    """One input or output: a column of a log, brought to `unit` by value = scale * column + offset.

    index: the actuator (inputs) or the column of sensordata (outputs) it belongs to. sensor: the output's sensor id.
    noise_sd: known standard deviation of an output's noise, in `unit`; None where it is to be estimated. period: after
    which an output's column begins anew, in its own unit: 360 for a heading in degrees; None where it does not.
    hold: how an input acts between rows of a log; None where nobody says, and it is held until the log tells. sparse:
    whether an output may have no value in some rows of a log, as a sensor that is slower than the others.
    """

    name: str
    unit: str
    column: str
    index: int
    sensor: int = -1
    scale: float = 1.0
    offset: float = 0.0
    noise_sd: float | None = None
    hold: Hold | None = HELD
    period: float | None = None
    sparse: bool = False

    @classmethod
    def of_actuator(cls, model: mujoco.MjModel, name: str, unit: str) -> Self:
        """The input, in the unit of the model, whose actuator and column have its name."""
        return cls(name, unit, name, model.actuator(name).id)

    @classmethod
    def of_sensor(cls, model: mujoco.MjModel, name: str, unit: str) -> Self:
        """The output, in the unit of the model, whose sensor and column have its name; of a position, x."""
        sensor = model.sensor(name)
        return cls(name, unit, name, int(sensor.adr[0]), sensor=sensor.id)

    @property
    def read_as(self) -> tuple[str | float, ...]:
        """Column, scale, offset and, if there is one, period: what `import-log` makes the channel of."""
        period = () if self.period is None else (self.period,)
        return self.column, self.scale, self.offset, *period


@dataclass(frozen=True)
class LogColumns:
    """Which columns of a source file hold time and episode, and how long a window is, in s (None: the episode).

    time_scale: s per unit of the time column, so that seconds = time_scale * column.
    """

    time: str = "time"
    episode: str | None = None
    window: float | None = None
    time_scale: float = 1.0


class Task(ABC):
    """A machine: `model`, `space` (its open parameters), `inputs`, `outputs`, and how its logs are cut.

    model_path: the MJCF that the model is made from. path: its task.toml; None where it is built in. effects: what a
    machine of it has beside the model: (Placed, values (parameter,)) each; `with_effects` adds them. model_values: of
    parameters that a task file gives no nominal value: the model's own, and the target that it is of.
    """

    name: str
    path: Path | None = None
    model: mujoco.MjModel
    model_path: Path
    space: ParameterSpace
    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    log: LogColumns
    effects: tuple[tuple[Any, np.ndarray], ...] = ()
    model_values: Mapping[str, tuple[float, str]] = MappingProxyType({})

    def with_effects(self, effects: Iterable[tuple[Any, np.ndarray]]) -> Self:
        """The task of machines that have these effects as well."""
        mended = copy(self)
        mended.effects = (*self.effects, *effects)
        return mended

    @abstractmethod
    def write(self, fields: ModelFields, parameters: np.ndarray) -> None:
        """Set `parameters` (simulation, parameter) in the model of each simulation."""

    @property
    def timestep(self) -> float:
        """Model step, s."""
        return float(self.model.opt.timestep)

    @property
    def holds(self) -> tuple[Hold, ...]:
        """How each input acts between rows of a log."""
        return tuple(HELD if c.hold is None else c.hold for c in self.inputs)

    @property
    def half_late(self) -> np.ndarray:
        """Which inputs are held as those of a machine, half a step late, (input,): a step of MuJoCo kicks at its
        beginning with what a machine feels all through it.
        """
        late = [h.late if h.commands == HELD.commands else np.nan for h in self.holds]
        return np.isclose(np.array(late, dtype=float), self.timestep / 2, rtol=1e-3, atol=0.0)

    @property
    def reads_later(self) -> np.ndarray:
        """Which outputs are those of half a step later, (output,): velocities, where inputs are held as those of a
        machine. Then positions are right to the second order, and velocities those of the middle of the step before.
        """
        sensors = [c.sensor for c in self.outputs]
        is_velocity = self.model.sensor_needstage[sensors] == int(mujoco.mjtStage.mjSTAGE_VEL)
        return is_velocity & self.half_late.any()

    def with_holds(self, holds: Iterable[Hold]) -> Self:
        """The task with inputs that act so between rows."""
        known = copy(self)
        known.inputs = tuple(replace(c, hold=own) for c, own in zip(self.inputs, holds, strict=True))
        return known

    def controls(self, inputs: np.ndarray) -> np.ndarray:
        """Inputs (..., input) as ctrl (..., nu); actuators that are no input get 0."""
        ctrl = np.zeros((*inputs.shape[:-1], self.model.nu))
        ctrl[..., self.model.actuator_ctrladr[[c.index for c in self.inputs]]] = inputs
        return ctrl


@dataclass(frozen=True)
class Episodes:
    """What a batch of episodes starts from, and its inputs (episode, grid, input) at the model's steps."""

    initial: InitialStates
    inputs: np.ndarray


@dataclass(frozen=True)
class Feature:
    """One component of a state trajectory. scale: a typical size of it, in `unit`, that identifiers divide by."""

    name: str
    unit: str
    scale: float


class ActionTask(Task):
    """A task whose every episode is driven by one action and observed as one state trajectory (paper, Section III-A).

    actions: the components of an action, with units and ranges. features: those of the trajectory. point_times
    (point,): s after the start of an episode, where the trajectory is read; the last one ends the episode.
    trainable: whether `reward` and `success` are defined, as a policy that is to be trained needs them. entropy: the
    weight of a policy's entropy that suits the reward, in training (the paper's, by its released code). mirrored:
    whether an episode seen in a mirror is one of the task's as well, of the same worth: `mirror_parameters` and
    `mirror_actions` say which.
    """

    actions: ParameterSpace
    features: tuple[Feature, ...]
    point_times: np.ndarray
    trainable: bool = False
    entropy: float = 0.005
    mirrored: bool = False

    @abstractmethod
    def episodes(self, actions: np.ndarray) -> Episodes:
        """What the actions (episode, action) do."""

    def draw_actions(self, uniform: np.ndarray) -> np.ndarray:
        """Actions (n, action) to explore with, from draws (n, action) of [0, 1); uniform over `actions`."""
        return self.actions.from_unit(uniform)

    def observe(self, outputs: np.ndarray) -> np.ndarray:
        """Outputs (..., point, output) at `point_times` as a state trajectory (..., point, feature)."""
        return outputs

    def reward(self, actions: np.ndarray, trajectories: np.ndarray) -> np.ndarray:
        """What each episode was worth, (episode,).

        actions (episode, action), trajectories (episode, point, feature).
        """
        raise NotImplementedError(f"{self.name} defines no reward")

    def success(self, actions: np.ndarray, trajectories: np.ndarray) -> np.ndarray:
        """Whether each episode did what the task is about, bool (episode,)."""
        raise NotImplementedError(f"{self.name} defines no success")

    def mirror_parameters(self, parameters: np.ndarray) -> np.ndarray:
        """Parameters (n, parameter) seen in a mirror; twice gives them back."""
        raise NotImplementedError(f"{self.name} has no mirror")

    def mirror_actions(self, actions: np.ndarray) -> np.ndarray:
        """Actions (n, action) seen in a mirror; twice gives them back."""
        raise NotImplementedError(f"{self.name} has no mirror")

    @property
    def grid_steps(self) -> int:
        """Model steps of an episode, its first state counted."""
        return round(float(self.point_times[-1]) / self.timestep) + 1

    def share_of_steps(self, pause: float, duration: np.ndarray) -> np.ndarray:
        """Of each step of an episode, the share in what begins after `pause` s and takes `duration` s (episode,):
        (episode, step).
        """
        waited = np.arange(self.grid_steps) - round(pause / self.timestep)
        steps = duration / self.timestep
        return np.where(waited < 0, 0.0, np.clip(steps[:, None] - waited, 0.0, 1.0))
