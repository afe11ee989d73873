"""The measured log: what was recorded on a machine, as `import-log` and `record` write it.

The layout is the field's replay buffer: steps of all episodes one after the other, and where each one ends.
The truth, where there is one, is never in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from capture_cli.common.documents import SETTINGS as DOCUMENTS
from capture_cli.common.frozen import frozen
from capture_cli.errors import LogError, StoreError
from capture_cli.log.arrays import Log, slices_until
from capture_cli.store.document_shape import FLAG, NAME, NUMBER, TEXT, WHOLE, Kind, check_shape, or_none
from capture_cli.store.schema import ArraySpec, Schema

SCHEMA = Schema(
    format="capture/measured-log",
    version=1,
    arrays=(
        ArraySpec("data/time", "step", "s", "time of each sample, on the recording's own clock"),
        ArraySpec("data/inputs", "step input", "per input", "what drove the machine, as model ctrl"),
        ArraySpec("data/outputs", "step output", "per output", "what the sensors measured"),
        ArraySpec(
            "meta/episode_ends", "episode", "steps", "index one past each episode's last step", dtype="int64"
        ),
        ArraySpec(
            "meta/recording", "episode", "-", "which of `recordings` the episode comes from", dtype="int64"
        ),
        ArraySpec("meta/actions", "episode action", "per action", "the action taken", optional=True),
    ),
    attributes={
        "task": "name of the task the log belongs to",
        "inputs": "list of {name, unit}, one per input",
        "outputs": "list of {name, unit}, one per output; and sparse, true, of one that has no sample, but NaN, in "
        "some steps",
        "recordings": "list of {name, source, sha256, channels, ...}: files read in, or how it was recorded",
    },
    cure_for_other_version="read the source files in again with `capture import-log`",
)
# how a column was read: its name, scale, offset and, if there is one, period
_READ_AS = Kind(
    "[column, scale, offset]",
    lambda v: isinstance(v, list) and len(v) in (3, 4) and TEXT.holds(v[0]) and all(map(NUMBER.holds, v[1:])),
)
SHAPE = {  # of the attributes
    "task": NAME,
    "inputs": [{"name": NAME, "unit": TEXT}],
    "outputs": [{"name": NAME, "unit": TEXT, "sparse?": FLAG}],
    "recordings": [
        {
            "name": NAME,
            "source?": or_none(TEXT),
            "sha256?": or_none(TEXT),
            "cut_off?": or_none(TEXT),
            "dropped_rows?": or_none(WHOLE),
            "repeated_rows?": or_none(WHOLE),
            "held_repeats?": or_none(WHOLE),
            "comment_lines?": or_none(WHOLE),
            "evened_times?": or_none(NUMBER),
            "time_scale?": or_none(NUMBER),
            "channels?": or_none({"inputs?": {str: _READ_AS}, "outputs?": {str: _READ_AS}}),
        }
    ],
}
# the cure where it takes more memory than is read
LARGER = "if it is that long, say how much may be read, say --max-log-size 2GB; otherwise copy it again"


@frozen
class SETTINGS:
    fewest_of_a_sparse: int = 5  # samples of an episode: with fewer nobody can tell how the output moves


@dataclass(frozen=True)
class MeasuredLog:
    """A log in memory; SI units.

    time (step,), inputs (step, input), outputs (step, output), episode_ends (episode,), recording (episode,):
    index into `recordings`, each {name, source, sha256}. actions (episode, action) or None. sparse: names of the
    outputs that need not have a sample in every step: where one has none it is NaN, which `values` and `sampled` tell
    apart.
    """

    task: str
    time: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    episode_ends: np.ndarray
    recording: np.ndarray
    input_names: tuple[str, ...]
    input_units: tuple[str, ...]
    output_names: tuple[str, ...]
    output_units: tuple[str, ...]
    recordings: tuple[dict[str, Any], ...]
    actions: np.ndarray | None = None
    path: Path | None = field(default=None, compare=False)
    sparse: frozenset[str] = frozenset()

    @classmethod
    def of_recording(
        cls, task, recording: dict[str, Any], episode_ends: np.ndarray, **fields: Any
    ) -> MeasuredLog:
        """Of one `recording`, {name, source, sha256}, with the channels of `task` (a Task). fields: others, by name."""
        return cls(
            task=task.name,
            episode_ends=episode_ends,
            recording=np.zeros(len(episode_ends), dtype=np.int64),
            input_names=tuple(c.name for c in task.inputs),
            input_units=tuple(c.unit for c in task.inputs),
            output_names=tuple(c.name for c in task.outputs),
            output_units=tuple(c.unit for c in task.outputs),
            recordings=(recording,),
            **fields,
        )

    @property
    def is_sparse(self) -> np.ndarray:
        """Which outputs are sparse, (output,)."""
        return np.array([name in self.sparse for name in self.output_names], dtype=bool)

    @property
    def sampled(self) -> np.ndarray:
        """Where the outputs have a sample, (step, output): everywhere but where those that are sparse have none."""
        return ~(np.isnan(self.outputs) & self.is_sparse)

    @property
    def values(self) -> np.ndarray:
        """The outputs (step, output), 0 where they have no sample."""
        sampled = self.sampled
        return self.outputs if sampled.all() else np.where(sampled, self.outputs, 0.0)

    @property
    def arrays(self) -> Log:
        """The numbers alone."""
        return Log(self.time, self.values, self.episodes, self.inputs, self.sampled)

    @property
    def episodes(self) -> list[slice]:
        """The steps of each episode."""
        return slices_until(self.episode_ends)

    @property
    def longest(self) -> float:
        """s: from the first to the last sample of the longest episode."""
        return float(max(self.time[e.stop - 1] - self.time[e.start] for e in self.episodes))

    @property
    def steps_of_longest(self) -> int:
        """How many steps the longest episode has."""
        longest = max(self.episodes, key=lambda e: self.time[e.stop - 1] - self.time[e.start])
        return longest.stop - longest.start

    @property
    def input_peaks(self) -> dict[str, float]:
        """How far from 0 each input went, by name, in its own unit: as far as the machine is known to bear."""
        return dict(zip(self.input_names, np.abs(self.inputs).max(axis=0).tolist(), strict=True))

    @property
    def episodes_cover_steps(self) -> bool:
        """Whether the episodes divide the steps without overlap or rest, as those of a sound log do."""
        ends = np.asarray(self.episode_ends)
        increasing = len(ends) > 0 and ends[0] > 0 and np.all(np.diff(ends) > 0)
        return bool(increasing and ends[-1] == len(self.time))

    @property
    def recording_names(self) -> tuple[str, ...]:
        return tuple(r["name"] for r in self.recordings)

    def check(self) -> MeasuredLog:
        """Return self. Raises LogError naming the first fault: no steps, NaN, values that are too large to be measured,
        time that does not increase.
        """
        where = f"{self.path}: " if self.path else ""
        if not len(self.episode_ends) or not len(self.time):
            raise LogError(f"{where}the log is empty", cure="record or import at least one episode")
        if not self.episodes_cover_steps:
            raise LogError(
                f"{where}episode_ends {self.episode_ends[:5].tolist()}... "
                f"do not divide {len(self.time)} steps",
                cure="import the log again",
            )
        for name, values, is_sparse in self._channels():
            bad = np.flatnonzero(np.isinf(values) if is_sparse else ~np.isfinite(values))
            if bad.size:
                raise LogError(
                    f"{where}{name} is {values[bad[0]]} at step {bad[0]} ({bad.size} such values)",
                    cure="drop those rows (`capture import-log --drop-nan`) or fill them in the source file",
                )
            huge = np.flatnonzero(np.abs(values) > DOCUMENTS.largest) if name != "time" else bad
            if huge.size:
                raise LogError(
                    f"{where}{name} is {values[huge[0]]:.4g} at step {huge[0]} ({huge.size} such values), too large to "
                    f"be a measurement: {DOCUMENTS.largest:g} is the most",
                    cure="correct the value in the source file, or its scale in the task.toml, and import again",
                )
        for number, steps in enumerate(self.episodes):
            back = np.flatnonzero(np.diff(self.time[steps]) <= 0)
            if back.size:
                i = steps.start + int(back[0])
                raise LogError(
                    f"{where}time does not increase in episode {number}: "
                    f"{self.time[i]:.9g} s at step {i}, then {self.time[i + 1]:.9g} s",
                    cure="sort the rows, drop duplicates, or name the episode column in [log] episode",
                )
        self._check_samples()
        return self

    def _check_samples(self) -> None:
        """Raise LogError where a sparse output has next to no sample in an episode."""
        counts = np.add.reduceat(self.sampled, [e.start for e in self.episodes], axis=0, dtype=int)
        few = np.argwhere(self.is_sparse & (counts < SETTINGS.fewest_of_a_sparse))
        if few.size:
            number, k = few[0]
            where = f"{self.path}: " if self.path else ""
            episode = self.episodes[number]
            recording = self.recording_names[self.recording[number]]
            raise LogError(
                f"{where}output {self.output_names[k]!r} has {counts[number, k]} samples in the "
                f"{episode.stop - episode.start} steps of episode {number} (recording {recording!r}), and even "
                f"a sparse output needs {SETTINGS.fewest_of_a_sparse}",
                cure="check its column; leave that episode out, record longer, or take the output out of the task.toml",
            )

    def _channels(self):
        """Name, values (step,) and whether some may be missing, of each."""
        yield "time", self.time, False
        for names, kind, values, sparse in (
            (self.input_names, "input", self.inputs, ()),
            (self.output_names, "output", self.outputs, self.sparse),
        ):
            for k, name in enumerate(names):
                yield f"{kind} {name!r}", values[:, k], name in sparse

    def followed_by(self, *others: MeasuredLog) -> MeasuredLog:
        """With the episodes of `others` after its own; recordings of the same name are told apart by a number.

        Raises LogError where the task, the channels or their units differ, or one has actions and another has none.
        """
        logs = (self, *others)
        for other in others:
            for what in ("task", "input_names", "input_units", "output_names", "output_units"):
                mine, theirs = getattr(self, what), getattr(other, what)
                if mine != theirs:
                    found = f"its {what.replace('_', ' ')} {_listed(theirs)}; {self.path} has {_listed(mine)}"
                    cure = "import it with the task of the log that it is to be added to"
                    raise LogError(f"{other.path}: {found}", cure=cure)
            if (self.actions is None) != (other.actions is None):
                without, having = (self, other) if self.actions is None else (other, self)
                raise LogError(
                    f"{without.path} has no actions, and {having.path} has",
                    cure="give the actions of every episode, in columns action.NAME of a file, or of none",
                )
        recordings: dict[str, dict[str, Any]] = {}
        for recording in (r for log in logs for r in log.recordings):
            name, number = recording["name"], 2
            while name in recordings:
                name, number = f"{recording['name']}-{number}", number + 1
            recordings[name] = {**recording, "name": name}
        steps = np.cumsum([0, *(len(log.time) for log in logs[:-1])])
        files = np.cumsum([0, *(len(log.recordings) for log in logs[:-1])])
        return replace(
            self,
            time=np.concatenate([log.time for log in logs]),
            inputs=np.concatenate([log.inputs for log in logs]),
            outputs=np.concatenate([log.outputs for log in logs]),
            episode_ends=np.concatenate([log.episode_ends + b for log, b in zip(logs, steps, strict=True)]),
            recording=np.concatenate([log.recording + b for log, b in zip(logs, files, strict=True)]),
            recordings=tuple(recordings.values()),
            actions=None if self.actions is None else np.concatenate([log.actions for log in logs]),
            sparse=frozenset().union(*(log.sparse for log in logs)),
        )

    def write(self, path: Path) -> None:
        """Write to `path` (a folder made by `new_directory`)."""
        arrays = {spec.path: getattr(self, _field(spec.path)) for spec in SCHEMA.arrays}
        attributes = {
            "task": self.task,
            "inputs": _named(self.input_names, self.input_units),
            "outputs": [
                {**named, "sparse": True} if named["name"] in self.sparse else named
                for named in _named(self.output_names, self.output_units)
            ],
            "recordings": list(self.recordings),
        }
        SCHEMA.write(path, {name: a for name, a in arrays.items() if a is not None}, attributes)

    @classmethod
    def read(cls, path: Path, most: int | None = None) -> MeasuredLog:
        """The log at `path`, checked. most: bytes in memory, see `ZarrStore.read`. Raises StoreError or LogError."""
        return cls.read_unchecked(path, most).check()

    @classmethod
    def read_unchecked(cls, path: Path, most: int | None = None) -> MeasuredLog:
        """The log at `path` with whatever values it holds, NaN and backward times too. Raises StoreError."""
        arrays, attributes = SCHEMA.read(path, most, LARGER)
        check_shape(attributes, SHAPE, path, SCHEMA.cure_for_other_version)
        input_names, input_units = _channel_list(path, attributes, "inputs", arrays["data/inputs"].shape[1])
        output_names, output_units = _channel_list(
            path, attributes, "outputs", arrays["data/outputs"].shape[1]
        )
        recordings = attributes["recordings"]
        if np.any((arrays["meta/recording"] < 0) | (arrays["meta/recording"] >= len(recordings))):
            raise StoreError(
                f"{path}: meta/recording points outside the attribute 'recordings', {recordings!r:.80}",
                cure=SCHEMA.cure_for_other_version,
            )
        return cls(
            task=attributes["task"],
            **{_field(name): array for name, array in arrays.items()},
            input_names=input_names,
            input_units=input_units,
            output_names=output_names,
            output_units=output_units,
            recordings=tuple(recordings),
            path=Path(path),
            sparse=frozenset(e["name"] for e in attributes["outputs"] if e.get("sparse") is True),
        )


def _field(path: str) -> str:
    """The field of a log that holds the array of this path in its store."""
    return path.split("/")[1]


def _channel_list(path: Path, attributes: Mapping[str, Any], key: str, size: int):
    """Names and units of the attribute `key`, checked against the `size` columns of its array."""
    entries = attributes[key]
    if len(entries) != size:
        raise StoreError(
            f"{path}: the attribute {key!r} is {entries!r:.80}; expected {size} of {{name, unit}}",
            cure=SCHEMA.cure_for_other_version,
        )
    return tuple(e["name"] for e in entries), tuple(e["unit"] for e in entries)


def _named(names: Sequence[str], units: Sequence[str]) -> list[dict[str, str]]:
    return [{"name": n, "unit": u} for n, u in zip(names, units, strict=True)]


def _listed(value: str | Sequence[str]) -> str:
    return repr(value) if isinstance(value, str) else f"({', '.join(value)})"
