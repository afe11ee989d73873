"""A motor that gives less, the hotter its own current has made it."""

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.common.recursive_filter import recursively_filtered
from capture_cli.model.effects._actuator_effect import ActuatorEffect, without_target
from capture_cli.model.effects._growth import TIME_CONSTANT
from capture_cli.model.effects.base import Driven, Recordings
from capture_cli.model.parameters import Parameter


@frozen
class SETTINGS:
    # Of a control as large as the largest, held for ever; motors are rated for a fraction of that, and a
    # fifth of it is a twenty-fifth of the heat
    largest: float = 8.0
    most_before: float = 0.5
    most_recordings: int = 6  # that each have a heat of their own to begin with
    step: float = 0.02  # s, of the heat over a log: a twenty-fifth of the shortest time constant


class HeatFade:
    """What a motor loses of its control follows the square of it: lost' = (fade control^2 - lost) / time_constant.

    before: lost as it begins.
    """

    def __init__(self, *, fade, before, time_constant, timestep):
        self.fade, self.lost = fade, before + 0.0 * fade
        self.kept = np.exp(-timestep / time_constant)

    def __call__(self, control):
        arrives = control * np.maximum(1 - self.lost, 0.0)
        self.lost = self.kept * self.lost + (1 - self.kept) * self.fade * np.square(control)
        return arrives


class ControlHeatFade(ActuatorEffect):
    """The control arrives 1 - lost times as large, time_constant lost' = `fade` control^2 - lost (1/ctrl^2, s): magnets
    and windings that warm with the current. `before` is what is lost already as an episode begins; of a log of up to 6
    recordings that of the first, and each of the others has its own, `before_2`, `before_3`.
    """

    summary = "a control arrives smaller, the more of it there was: a motor that its own current warms"
    where = "every actuator whose control is a force or a voltage"
    shapes = ("time_constant",)
    kernel = HeatFade
    remembers = "all since the episode began"
    _driven: Driven | None = None
    _recordings: Recordings | None = None  # where each has a heat of its own
    _heats = 1

    @classmethod
    def sites(cls, model):
        return without_target(model)

    def look_in(self, log):
        super().look_in(log)
        self._driven = log.driven
        if log.recordings is not None and log.recordings.several:
            count = int(log.recordings.of_step.max()) + 1
            if count <= SETTINGS.most_recordings:
                self._recordings, self._heats = log.recordings, count

    @classmethod
    def of_one_recording(cls, name):
        return name.startswith("before_")

    @property
    def parameters(self):
        names = ["before", *(f"before_{number}" for number in range(2, self._heats + 1))]
        return (
            Parameter("fade", "1/ctrl^2", 0.0, SETTINGS.largest / self.scale**2, 0.0),
            *(Parameter(name, "1", 0.0, SETTINGS.most_before, 0.0) for name in names),
            TIME_CONSTANT,
        )

    def drive(self, controls, values, timestep, *, elapsed=0.0, first=None):
        fade, before, time_constant = values[:, 0], values[:, 1], values[:, -1]
        if first is not None and self._recordings is not None:
            before = values[np.arange(len(values)), 1 + self._recordings.of_step[first]]
        elapsed = np.broadcast_to(elapsed, len(values))
        lost = before * np.exp(-np.maximum(elapsed, 0.0) / time_constant)
        if first is not None and self._driven is not None:
            lost = lost + fade * self._heat(first, elapsed, time_constant)
        fading = HeatFade(fade=fade, before=lost, time_constant=time_constant, timestep=timestep)
        controls = controls.copy()
        column = self.columns[0]
        for step in range(controls.shape[1]):
            controls[:, step, column] = fading(controls[:, step, column])
            fading.lost = np.where(elapsed + step * timestep < 0, lost, fading.lost)  # not before it began
        return controls

    def _heat(self, first: np.ndarray, elapsed: np.ndarray, time_constant: np.ndarray) -> np.ndarray:
        """The square of the log's control through the lag, (simulation,): of the episodes that the steps `first` of the
        log are in, `elapsed` s after they began.
        """
        episode = self._driven.episode_of(first)
        heat = np.zeros(len(first))
        pairs, which = np.unique(np.stack([episode, time_constant]), axis=1, return_inverse=True)
        for number, (of, lag) in enumerate(pairs.T):
            own = which == number
            time, square = self._squares(int(of))
            kept = np.exp(-SETTINGS.step / lag)
            felt = recursively_filtered((0.0, 1 - kept), (-kept,), square)
            heat[own] = np.interp(elapsed[own], time, felt)
        return heat

    def _squares(self, episode: int) -> tuple[np.ndarray, np.ndarray]:
        """Times (point,), s since the episode began, and the mean square of the control from each to the next."""
        time, control = self._driven.of_episode(episode, self.actuators[0])
        grid = SETTINGS.step * np.arange(int(np.ceil(time[-1] / SETTINGS.step)) + 1)
        total = np.concatenate([[0.0], np.cumsum(np.square(control[:-1]) * np.diff(time))])
        return grid, np.diff(
            np.interp(np.append(grid, grid[-1] + SETTINGS.step), time, total)
        ) / SETTINGS.step
