"""A force that repeats with time: an unbalanced fan, a machine next door, the mains."""

from copy import copy

import numpy as np

from capture_cli.model.effects._joint_force import ForceOfKernel
from capture_cli.model.effects._periodic_force import SETTINGS as PERIODIC_FORCE
from capture_cli.model.effects._periodic_force import PeriodicForce
from capture_cli.model.effects.base import Recordings
from capture_cli.model.parameters import Parameter


def periodic_disturbance(time, *, sine, cosine, frequency):
    """Joint force: sine sin(2 pi f t) + cosine cos(2 pi f t), f the frequency in Hz, t in s since the log began."""
    phase = 2 * np.pi * frequency * time
    return sine * np.sin(phase) + cosine * np.cos(phase)


class PeriodicDisturbance(PeriodicForce):
    """The joint force `sine` sin(2 pi f t) + `cosine` cos(2 pi f t) with f the `frequency` and t in s
    since the log began: since its first time, whatever that is.

    Of a log of several recordings t counts from the beginning of one, the longest that is fitted. From there to another
    nobody knows how far the phase turns: clocks may differ, and over a day a frequency that is known to a millionth
    leaves it open. So windows of the others have the same amplitude and frequency, and a phase of their own each.
    """

    summary = "a force that repeats with time: vibration from outside"
    shapes = ("frequency",)
    states_anywhere = True
    states_mean = (
        "`phase`, in windows of other recordings than that whose beginning is `effects[].first_time`: the phase where "
        "the window begins, in turns"
    )
    kernel = staticmethod(periodic_disturbance)
    recordings: Recordings | None = None  # of the log, where it has several
    anchored = True  # whether the phase in the reference is known

    def look_in(self, log):
        super().look_in(log)
        phases = 8  # that are tried: from the best of them a descent need turn no further than a sixteenth
        if log.recordings is not None and log.recordings.several:
            self.recordings = log.recordings
            self.states = ("phase",)  # where a window begins, in turns
            self.states_tried = np.arange(phases)[:, None] / phases - 0.5

    def force(self, values, timestep, *, states=None, first=None, **_):
        given = self.coefficients(values)
        if self.recordings is None or first is None:
            return ForceOfKernel(self, given, timestep)
        turns = -given["frequency"] * self._zero(first) + (0.0 if states is None else states[:, 0])
        given["sine"], given["cosine"] = _turned(given["sine"], given["cosine"], turns)
        return ForceOfKernel(self, given, timestep)

    def states_sd(self, first):
        if self.recordings is None:
            return super().states_sd(first)
        return 1.0 - (self._in_reference(first) & self.anchored)[:, None]

    def fitted_to(self, first):
        if self.recordings is None or self._in_reference(first).any():
            return self
        effect = copy(self)
        effect.anchored = False
        return effect

    def first_step(self):
        if self.recordings is None:
            return 0
        return int(np.argmax(self.recordings.of_step == self.recordings.reference))

    def by_recording(self, sensitivity, values, first):
        if self.recordings is None:
            return sensitivity
        turns = values[2] * (self._zero(first) - self.began(first))  # since the recording began
        cosine, sine = _turned(sensitivity[..., 1], sensitivity[..., 0], turns[:, None])
        waves = np.stack([sine, cosine], axis=-1)
        each = self._in_reference(first), *self.apart(first)
        return np.concatenate([waves * own[:, None, None] for own in each], axis=-1)

    def recording(self, first):
        return super().recording(first) if self.recordings is None else self.recordings.of_step[first]

    def apart(self, first):
        number = self.recording(first)
        own = [n for n in np.unique(number) if self.recordings is not None and n != self.recordings.reference]
        return number == np.reshape(own, (-1, 1))

    def began(self, first):
        return super().began(first) if self.recordings is None else self.recordings.began[first]

    def doubt(self, values, duration):
        periods = values[2] * duration
        fewest_periods = 2.0
        if periods < fewest_periods:
            return f"only {periods:.2g} of its periods fit into an episode: any slow change looks like that"
        if self.recordings is not None and values[2] * self.window < 1:
            return (
                f"only {values[2] * self.window:.2g} of its periods fit into a window: where each has a phase of its "
                "own, any slow change looks like that"
            )
        return None

    @property
    def parameters(self):
        high, unit = self.characteristic_force, self.unit("N", "N m")
        return (
            Parameter("sine", unit, -high, high, 0.0),
            Parameter("cosine", unit, -high, high, 0.0),
            Parameter("frequency", "Hz", 0.1, 1 / self.shortest_period, 1.0, PERIODIC_FORCE.shape_step),
        )

    def _in_reference(self, first: np.ndarray) -> np.ndarray:
        return self.recordings.of_step[first] == self.recordings.reference

    def _zero(self, first: np.ndarray) -> np.ndarray:
        """s, by the clock of simulations that begin at the steps `first` of the log, (simulation,): when the phase is
        that of `sine` and `cosine`, or, outside the reference, differs from it by the hidden one.
        """
        return np.where(self._in_reference(first), self.recordings.began[first], self.recordings.time[first])


def _turned(sine: np.ndarray, cosine: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Amplitudes of the wave with these that is so many `turns` ahead."""
    phase = 2 * np.pi * turns
    ahead = np.cos(phase), np.sin(phase)
    return sine * ahead[0] - cosine * ahead[1], sine * ahead[1] + cosine * ahead[0]
