"""Open-loop error by prediction horizon: how far a model is from the log after so many seconds of simulation.

The inputs are replayed, and no state is set anew on the way. Short predictions begin at many times, spread evenly over
the log; the longest is the free run of each whole episode from its first state. A user of the model meets these errors.

Predictions begin where windows of the fit do, in the states that it found: those that the samples near show, refined
as far as their noise goes, and what no sensor shows. Where windows are longer than short horizons these begin in
between, too, in states that are read off the samples alone, as windows' are before the fit.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from capture_cli.common.evenly_spread import evenly_spread
from capture_cli.common.frozen import frozen
from capture_cli.estimate.initial_states.of_windows import log_initial_states, readable
from capture_cli.estimate.log_windows import clock, windows_at
from capture_cli.estimate.model_fits import ModelFits
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.estimate.solve.base import Trial
from capture_cli.estimate.split import Split
from capture_cli.log.windows import Spans, stretches, usual_interval
from capture_cli.model.coordinate_sources import sources_of
from capture_cli.model.effects.placed import Placed


@frozen
class SETTINGS:
    horizons: tuple[float, ...] = (0.1, 0.5, 2.0)  # s; and the whole of every episode
    # Predictions of one horizon in one part of the log, at most: a root mean square of so many is good to 10
    # %. No horizon costs more than to simulate the log once.
    starts: int = 100
    long: float = 1.5  # times the longest of them: a window that is longer has room for several predictions
    same: float = 1.05  # times a horizon: episodes that are no longer are told in free run alone
    rounding: float = 1e-6  # of a horizon, by which the stamp of a sample at its end may be late


@dataclass(frozen=True)
class PredictingModel:
    """A model by its name: the task with `effects` at `point` (parameter,). corrections (window, state): by how much
    its fit moved the initial states of all windows of the prepared log.
    """

    name: str
    effects: Sequence[Placed]
    point: np.ndarray
    corrections: np.ndarray


@dataclass(frozen=True)
class PredictionError:
    """Of one model over some runs. rmse (output,): in the outputs' units; nan of an output without a sample.
    normalized: RMSE over the noise floor, of all samples of all outputs. diverged: how many runs did; where there are
    any, all errors are nan.
    """

    rmse: np.ndarray
    normalized: float
    diverged: int


@dataclass(frozen=True)
class Runs:
    """Simulations from the same initial states with every model: how many, how long the longest is (s), and the error
    of each model by its name.
    """

    count: int
    longest: float
    errors: dict[str, PredictionError]


@dataclass(frozen=True)
class Prediction:
    """horizon: s; None: free runs of whole episodes, which are told by recording as well."""

    horizon: float | None
    runs: Runs
    recordings: dict[str, Runs]


@dataclass(frozen=True)
class PredictionErrors:
    """Predictions in one part of the log, the free runs last. left_out: which horizons are missing, and why."""

    predictions: list[Prediction]
    left_out: list[str]


@dataclass(frozen=True)
class _Stretch:
    """Steps of the log from `first` to before `stop`, of one episode and one part, without a gap. known_since: the step
    since which their inputs are known.
    """

    episode: int
    known_since: int
    first: int
    stop: int
    is_test: bool


Predicted = Mapping[str, PredictionErrors | None]  # by the name of the part, "fit" or "test"


def prediction_errors(fits: ModelFits, models: Sequence[PredictingModel]) -> Predicted:
    """The errors of `models` in the parts "fit" and "test" of the prepared log of `fits`; None of one that is empty."""
    search = _Predictions(fits, models)
    return {"fit": search.part(is_test=False), "test": search.part(is_test=True)}


class _Predictions:
    def __init__(self, fits: ModelFits, models: Sequence[PredictingModel]):
        self.fits, self.models = fits, models
        self.prepared = fits.prepared
        self.time = clock(self.prepared.log)
        self.stretches = list(_stretches(self.prepared))
        self.between = not self._is_unshown() and self._windows_are_long()

    def part(self, *, is_test: bool) -> PredictionErrors | None:
        """The errors in one part."""
        own = [s for s in self.stretches if s.is_test == is_test]
        if not own:
            return None
        found, left_out = [], []
        for horizon in SETTINGS.horizons:
            spans = self._spans(own, horizon)
            if not len(spans):
                left_out.append(self._why(own, horizon, is_test))
            elif SETTINGS.same * horizon < self._longest(own):
                found.append(Prediction(horizon, *self._predicted(spans, free=False)))
        whole = Spans(*np.array([(s.episode, s.known_since, s.first, s.stop) for s in own]).T)
        free_runs = Prediction(None, *self._predicted(whole, free=True))
        return PredictionErrors([*found, free_runs], left_out)

    def _is_unshown(self) -> bool:
        """Whether a model has a state that the outputs do not show, of its own or of an effect."""
        model, sd = self.prepared.task.model, self.prepared.initial.sd
        shown = np.zeros(sd.shape[1], dtype=bool)
        for source in sources_of(model, readable(self.prepared.task)):
            dofs = np.array(source.dofs)
            shown[model.nv + dofs] = True
            if source.kind != "velocity":
                shown[dofs] = True
        hidden = any(self.fits.simulator(m.effects).hidden_states for m in self.models)
        return hidden or bool((sd[:, ~shown] > 0).any())

    def _windows_are_long(self) -> bool:
        windows = self.prepared.windows
        return float(np.median(windows.grid_steps)) * windows.timestep > SETTINGS.long * SETTINGS.horizons[-1]

    def _spans(self, own: Sequence[_Stretch], horizon: float) -> Spans:
        """Where runs of `horizon` s are in the stretches: as many as cover them once, or `starts`."""
        found = []
        for stretch in own:
            time = self.time[stretch.first : stretch.stop]
            steps = np.searchsorted(time, time[self._starts(stretch, horizon)])
            stops = np.searchsorted(time, time[steps] + horizon * (1 + SETTINGS.rounding), side="right")
            found += [
                (stretch.episode, stretch.known_since, stretch.first + a, stretch.first + b)
                for a, b in zip(steps, stops, strict=True)
                if b - a > 1
            ]
        if not found:
            return Spans(*np.zeros((4, 0), dtype=int))
        seconds = sum(self.time[s.stop - 1] - self.time[s.first] for s in own)
        most = max(1, min(SETTINGS.starts, int(np.ceil(seconds / horizon))))
        return Spans(*np.array(found)[evenly_spread(len(found), most)].T)

    def _starts(self, stretch: _Stretch, horizon: float) -> np.ndarray:
        """The steps, counted from its first, at which runs of `horizon` s may begin in the stretch."""
        time = self.time[stretch.first : stretch.stop]
        late = 0.5 * float(np.median(np.diff(time)))  # an episode of 2 s may end a sample before them
        if not self.between:
            first = self.prepared.windows.first
            steps = first[(first >= stretch.first) & (first < stretch.stop)] - stretch.first
        else:
            count = int((time[-1] - time[0] + late) / horizon)
            steps = np.searchsorted(time, time[0] + horizon * np.arange(count) - late)
        return steps[time[steps] + horizon <= time[-1] + late]

    def _longest(self, own: Sequence[_Stretch]) -> float:
        """s, from the first to the last step of the longest stretch."""
        return float(max(self.time[s.stop - 1] - self.time[s.first] for s in own))

    def _why(self, own: Sequence[_Stretch], horizon: float, is_test: bool) -> str:
        """Why there is no run of `horizon` s in the stretches."""
        longest = self._longest(own)
        where = "what was held out" if is_test else "what was fitted"
        if longest < horizon:
            return f"No prediction over {horizon:g} s of {where}: it is {longest:.3g} s long at most."
        sampled = self.prepared.log.sampled
        apart = max(usual_interval(self.time[s], sampled[s]) for s in self.prepared.log.episodes)
        return f"No prediction over {horizon:g} s of {where}: samples are {apart:.3g} s apart."

    def _predicted(self, spans: Spans, *, free: bool) -> tuple[Runs, dict[str, Runs]]:
        """All runs at the spans, and those of each recording where they are free runs."""
        log, task = self.prepared.log, self.prepared.task
        windows = windows_at(log, task, spans)
        if self.between and not free:
            initial = log_initial_states(log, task, windows, self.prepared.noise, self.fits.engine.threads)
            corrections = [np.zeros((len(spans), m.corrections.shape[1])) for m in self.models]
        else:
            own = np.searchsorted(self.prepared.windows.first, spans.first)
            initial = self.prepared.initial.rows(own)
            corrections = [m.corrections[own] for m in self.models]
        none = Split(np.zeros(len(spans), dtype=bool), "")
        part = replace(self.prepared, windows=windows, initial=initial, split=none)
        simulated = {}
        for model, moved in zip(self.models, corrections, strict=True):
            simulator = self.fits.simulator(model.effects)
            outputs, diverged = part.evaluate(simulator, Trial(model.point[None], moved[None]))
            simulated[model.name] = outputs[0], diverged[0]
        every = np.ones(len(spans), dtype=bool)
        recordings = {}
        if free:
            recordings = {
                log.recording_names[number]: _runs(part, simulated, part.recording == number)
                for number in np.unique(part.recording)
            }
        return _runs(part, simulated, every), recordings


def _runs(part: PreparedLog, simulated: dict[str, tuple[np.ndarray, np.ndarray]], which: np.ndarray) -> Runs:
    """The windows `which` (window,) of the part as runs of the models that were simulated."""
    windows = part.windows
    time = part.log.time[part.log_steps[which]]
    longest = float(np.where(windows.mask[which], time - time[:, :1], 0.0).max())
    errors = {
        name: _error(windows.measured[which] - outputs[which], windows.sampled[which], diverged[which], part)
        for name, (outputs, diverged) in simulated.items()
    }
    return Runs(int(which.sum()), longest, errors)


def _error(
    residual: np.ndarray, sampled: np.ndarray, diverged: np.ndarray, part: PreparedLog
) -> PredictionError:
    """residual (window, step, output), in the outputs' units, counted where `sampled`; diverged (window,)."""
    with np.errstate(over="ignore"):
        squares = np.square(np.where(sampled, residual, 0.0)).sum(axis=1)
    lost = diverged | ~np.isfinite(squares).all(axis=1)
    if lost.any():
        return PredictionError(np.full(squares.shape[1], np.nan), np.nan, int(lost.sum()))
    count = sampled.sum(axis=(0, 1))
    rmse = np.sqrt(np.where(count > 0, squares.sum(axis=0), np.nan) / np.maximum(count, 1))
    over = (squares.sum(axis=0) / np.square(part.noise.sd)).sum()
    return PredictionError(rmse, float(np.sqrt(over / max(count.sum(), 1))), 0)


def _stretches(prepared: PreparedLog) -> Iterator[_Stretch]:
    """Those of the log's steps that windows have, parted where gaps are and where another part begins."""
    log, windows = prepared.log, prepared.windows
    number = np.full(len(log.time), -1)
    for first, count, is_test in zip(windows.first, windows.samples, prepared.split.is_test, strict=True):
        number[first : first + count] = is_test
    time, sampled = clock(log), log.sampled
    for episode, steps in enumerate(log.episodes):
        for whole in stretches(time, sampled, [steps]):
            edges = whole.start + 1 + np.flatnonzero(np.diff(number[whole]))
            for first, stop in zip([whole.start, *edges], [*edges, whole.stop], strict=True):
                if number[first] >= 0 and stop - first > 1:
                    yield _Stretch(episode, whole.start, int(first), int(stop), bool(number[first]))
