"""A user's own machine: an MJCF and a `task.toml` that says what is open, what drives it and what was measured."""

import json
from pathlib import Path
from typing import Any

import mujoco

from capture_cli.common.documents import SETTINGS as DOCUMENTS
from capture_cli.common.documents import read_toml
from capture_cli.errors import ModelError, TaskError, did_you_mean
from capture_cli.model.mjcf.model_file import compile_file
from capture_cli.model.parameters import Parameter, ParameterSpace
from capture_cli.model.quaternion_signs import is_quaternion
from capture_cli.model.sensor_units import factor_between, refuse_other_units, refuse_period_in_other_unit
from capture_cli.model.target_names import least_value, object_id, parse_target, split_target
from capture_cli.model.targets import Target
from capture_cli.model.tasks.base import Channel, LogColumns, Task
from capture_cli.model.tasks.input_hold import hold_of
from capture_cli.model.tasks.reward import Goal, Reward

FORMAT = 1


_JOINT_SENSORS = {
    int(mujoco.mjtJoint.mjJNT_HINGE): "jointpos",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "jointpos",
    int(mujoco.mjtJoint.mjJNT_BALL): "ballquat",
}
_AXES = {1: ("",), 2: ("_x", "_y"), 3: ("_x", "_y", "_z"), 4: ("_w", "_x", "_y", "_z")}


class MjcfFile(Task):
    """The task written in the file at `path`. Raises TaskError or ModelError before any work."""

    def __init__(self, path: Path):
        self.path = Path(path)
        table = read_toml(self.path, TaskError)
        where = str(self.path)
        _known(table, {"format", "name", "model", "parameters", "inputs", "outputs", "log", "reward"}, where)
        if table.get("format") != FORMAT or isinstance(table["format"], bool):
            raise TaskError(
                f"{where}: {_given(table, 'format')}; this program reads {FORMAT}",
                cure=f"begin the file with `format = {FORMAT}`",
            )
        self.name = _value(table, "name", str, where, default=self.path.parent.name)
        self.model_path = self.path.parent / _value(table, "model", str, where)
        self.model = compile_file(self.model_path, _moved_centres(table, where))
        self._targets: list[tuple[int, Target]] = []  # with the number of the parameter that sets each
        parameters = []
        set_by: dict[str, str] = {}
        for name, entry in _tables(table, "parameters", where):
            parameter, targets = self._parameter(name, entry, set_by, f"{where}: [parameters.{name}]")
            self._targets += [(len(parameters), target) for target in targets]
            parameters.append(parameter)
        self._targets.sort(key=lambda own: not own[1].scales)
        self.space = ParameterSpace(parameters)
        self.inputs = tuple(
            self._input(name, entry, f"{where}: [inputs.{name}]")
            for name, entry in _tables(table, "inputs", where)
        )
        self.outputs = tuple(
            channel
            for name, entry in _tables(table, "outputs", where)
            for channel in self._output(name, entry, f"{where}: [outputs.{name}]")
        )
        if not self.outputs:
            raise TaskError(
                f"{where}: no [outputs.NAME]", cure="name at least one sensor of the model as an output"
            )
        self.log = self._log_columns(table.get("log", {}), f"{where}: [log]")
        self.reward = self._reward(table["reward"], f"{where}: [reward]") if "reward" in table else None

    def write(self, fields, parameters):
        for column, target in self._targets:
            target.write(fields, parameters[:, column])

    def _parameter(self, name: str, entry: dict[str, Any], set_by: dict[str, str], where: str):
        """The parameter and its targets. set_by: which parameter sets each target so far; `name` is added."""
        if not name.strip():
            raise TaskError(f"{where}: the parameter has no name", cure="name it: [parameters.NAME]")
        texts = _set_texts(entry, where)
        targets = [parse_target(text, self.model, where) for text in texts]
        _set_once(texts, name, set_by, where)
        low, high = (_value(entry, key, float, where) for key in ("low", "high"))
        if not low < high:
            raise TaskError(f"{where}: low = {low:g}, high = {high:g}", cure="give bounds with low < high")
        _check_least(texts, low, where)
        nominal = _value(entry, "nominal", float, where, default=targets[0].read(self.model))
        if "nominal" in entry and not low <= nominal <= high:
            raise TaskError(
                f"{where}: nominal = {nominal:g} lies outside [{low:g}, {high:g}]",
                cure="move it inside, widen the bounds, or leave it out to take the model's own value",
            )
        unit = _value(entry, "unit", str, where)
        return Parameter(name, unit, low, high, min(max(nominal, low), high)), targets

    def _input(self, name: str, entry: dict[str, Any], where: str) -> Channel:
        _known(entry, {"column", "unit", "column_unit", "scale", "offset", "interpolate", "late"}, where)
        number = object_id(self.model, "actuator", name, where)
        self._check_actuator(number, name, where)
        return Channel(
            name=name,
            unit=_value(entry, "unit", str, where),
            column=_value(entry, "column", str, where),
            index=number,
            scale=_scale(entry, where),
            offset=_value(entry, "offset", float, where, default=0.0),
            hold=hold_of(entry, where),
        )

    def _check_actuator(self, number: int, name: str, where: str) -> None:
        """Raise ModelError where the actuator takes more than one control, or takes it late."""
        controls, delay = int(self.model.actuator_ctrlnum[number]), float(self.model.actuator_delay[number])
        if controls != 1:
            raise ModelError(
                f"{where}: the actuator takes {controls} controls, and an input is one",
                cure="drive the joint with actuators of one control each: motor, position, velocity",
            )
        if delay > 0:
            raise ModelError(
                f"{where}: the actuator has delay = {delay:g} s, and windows begin with an empty memory",
                cure="leave delay and nsample out of the model: `capture diagnose` finds how late a control "
                f"arrives (control-delay@{name})",
            )

    def _output(self, name: str, entry: dict[str, Any], where: str) -> list[Channel]:
        _known(
            entry, {"column", "unit", "column_unit", "scale", "offset", "noise_sd", "period", "sparse"}, where
        )
        number = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SENSOR, name)
        if number < 0:
            raise ModelError(f"{where}: the model has no sensor {name!r}", cure=self._sensor_to_take(name))
        if self.model.sensor_history[number, 0] or self.model.sensor_interval[number].any():
            raise ModelError(
                f"{where}: the sensor has a delay or an interval, and windows begin with an empty memory",
                cure="leave delay, interval and nsample out of the model: `capture diagnose` finds how late a "
                f"sensor reports (sensor-delay@{name})",
            )
        size, first = int(self.model.sensor_dim[number]), int(self.model.sensor_adr[number])
        columns = _columns(entry, size, where)
        if "" in columns and is_quaternion(self.model, number):
            raise TaskError(
                f"{where}: {_given(entry, 'column')}, and an attitude is all of its {size} values",
                cure="name the columns of all, or leave the output out",
            )
        refuse_other_units(entry, _value(entry, "unit", str, where), self.model, number, where)
        noise_sd = _positive(entry, "noise_sd", where, cure="give a positive number, or leave it out")
        period = _positive(
            entry,
            "period",
            where,
            cure="give what the column goes through before it begins anew, 360 for degrees, or leave it out",
        )
        scale = _scale(entry, where)
        if period is not None:
            refuse_period_in_other_unit(period, entry["unit"], scale, where)
        axes = _AXES.get(size, tuple(f"_{i}" for i in range(size)))
        return [
            Channel(
                name=name + axes[i],
                unit=_value(entry, "unit", str, where),
                column=columns[i],
                index=first + i,
                sensor=number,
                scale=scale,
                offset=_value(entry, "offset", float, where, default=0.0),
                noise_sd=noise_sd,
                period=period,
                sparse=_value(entry, "sparse", bool, where, default=False),
            )
            for i in range(size)
            if columns[i]
        ]

    def _reward(self, table: Any, where: str) -> Reward:
        _known(table, {"duration", "points", "outputs"}, where)
        seconds = "give the seconds that an episode lasts"
        duration = _positive(table, "duration", where, default=_REQUIRED, cure=seconds)
        points = _value(table, "points", float, where, default=5.0)
        if points != int(points) or not 2 <= points <= duration / self.timestep + 1:
            raise TaskError(
                f"{where}: points = {points:g}",
                cure=f"give a whole number, from 2 to one a time step of the model, {self.timestep:g} s",
            )
        entries = _tables(table, "outputs", where)
        if not entries:
            raise TaskError(f"{where}: no goal", cure="write [reward.outputs.NAME] with target and within")
        goals = tuple(
            self._goal(name, entry, duration, f"{where[:-1]}.outputs.{name}]") for name, entry in entries
        )
        return Reward(goals, duration, int(points))

    def _goal(self, name: str, entry: Any, duration: float, where: str) -> Goal:
        _known(entry, {"target", "within", "at", "weight"}, where)
        names = [c.name for c in self.outputs]
        if name not in names:
            raise TaskError(f"{where}: there is no output {name!r}", cure=did_you_mean(name, names))
        at = _positive(
            entry, "at", where, cure="give a time in the episode, or leave it out for all the while"
        )
        if at is not None and at > duration:
            raise TaskError(
                f"{where}: at = {at:g}", cure=f"an episode lasts {duration:g} s: give that at most"
            )
        return Goal(
            output=name,
            target=_value(entry, "target", float, where),
            within=_positive(entry, "within", where, default=_REQUIRED, cure="give how near counts, above 0"),
            at=at,
            weight=_positive(entry, "weight", where, default=1.0, cure="give a number above 0"),
        )

    def _sensor_to_take(self, name: str) -> str:
        """The cure where no sensor is called `name`."""
        names = [self.model.sensor(i).name for i in range(self.model.nsensor)]
        joint = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_JOINT, name)
        kind = _JOINT_SENSORS.get(int(self.model.jnt_type[joint])) if joint >= 0 else None
        if kind:
            return (
                f'add <{kind} name="{name}" joint="{name}"/> under <sensor> of the model: outputs are sensors'
            )
        return did_you_mean(name, filter(None, names))

    @staticmethod
    def _log_columns(entry: dict[str, Any], where: str) -> LogColumns:
        _known(entry, {"time", "time_scale", "episode", "window"}, where)
        window = _positive(entry, "window", where, cure="give a positive number of seconds")
        seconds = "give the seconds in one unit of the time column, say 1e-3 for milliseconds"
        time_scale = _positive(entry, "time_scale", where, default=1.0, cure=seconds)
        return LogColumns(
            time=_value(entry, "time", str, where, default="time"),
            episode=_value(entry, "episode", str, where, default=None),
            window=window,
            time_scale=time_scale,
        )


def _columns(entry: dict[str, Any], size: int, where: str) -> list[str]:
    """The column of each of a sensor's `size` values, "" of one that was not logged. Raises TaskError."""
    columns = entry.get("column")
    columns = [columns] if isinstance(columns, str) else columns
    texts = isinstance(columns, list) and all(isinstance(c, str) for c in columns)
    if texts and len(columns) == size and any(columns):
        return columns
    given = _given(entry, "column")
    if size == 1:
        raise TaskError(f"{where}: {given}, and the sensor has 1 value", cure="name one column of the log")
    some = [*[""] * (size - 1), columns[0] if texts and len(columns) == 1 and any(columns) else "NAME"]
    raise TaskError(
        f"{where}: {given}, and the sensor has {size} values",
        cure=f'give a list of {size} columns of the log, "" for what was not logged: column = {json.dumps(some)}',
    )


def _positive(entry: dict[str, Any], key: str, where: str, *, cure: str, default: float | None = None):
    """entry[key], a number above 0, or `default` where it is missing. Raises TaskError, with `cure` where it is not."""
    value = _value(entry, key, float, where, default=default)
    if value is not None and value <= 0:
        raise TaskError(f"{where}: {key} = {value:g}", cure=cure)
    return value


def _scale(entry: dict[str, Any], where: str) -> float:
    """The factor on a channel's column: `scale`, times what brings `column_unit` to `unit`.

    Raises TaskError where it is 0, which would leave nothing of the column, or the units are of different things.
    """
    scale = _value(entry, "scale", float, where, default=1.0)
    if scale == 0:
        raise TaskError(
            f"{where}: scale = 0 makes every value the same",
            cure="give the factor that brings the column to the unit, or leave it out if that is 1",
        )
    if "column_unit" not in entry:
        return scale
    unit, written = (_value(entry, key, str, where) for key in ("unit", "column_unit"))
    return scale * factor_between(written, unit, where)


def _set_once(texts: list[str], name: str, set_by: dict[str, str], where: str) -> None:
    """Note in `set_by` that the parameter `name` sets `texts`. Raises TaskError where one of them is set already."""
    for text in texts:
        other = set_by.get(text)
        if other == name:
            raise TaskError(f"{where}: set names {text!r} twice", cure="name it once")
        if other is not None:
            raise TaskError(
                f"{where}: sets {text!r}, and so does [parameters.{other}]",
                cure="leave it out of one of them: the log could not tell the two apart",
            )
        set_by[text] = name


def _check_least(texts: list[str], low: float, where: str) -> None:
    """Raise TaskError where the bound `low` is below what one of the targets `texts` can be."""
    for text in texts:
        least = least_value(text)
        if low < least:
            raise TaskError(
                f"{where}: low = {low:g}, and {text!r} cannot be below {least:g}",
                cure=f"give low = {least:g} or more",
            )


def _set_texts(entry: Any, where: str) -> list[str]:
    """What a parameter's table says it sets. Raises TaskError."""
    _known(entry, {"set", "low", "high", "unit", "nominal"}, where)
    texts = entry.get("set")
    texts = [texts] if isinstance(texts, str) else texts
    if not isinstance(texts, list) or not texts or not all(isinstance(t, str) for t in texts):
        raise TaskError(
            f"{where}: {_given(entry, 'set')}",
            cure='write set = "KIND:NAME:ATTRIBUTE", or a list of such',
        )
    return texts


def _moved_centres(table: dict[str, Any], where: str) -> set[str]:
    """Bodies of which a parameter sets the centre of mass. Raises TaskError."""
    targets = [
        split_target(text)
        for name, entry in _tables(table, "parameters", where)
        for text in _set_texts(entry, f"{where}: [parameters.{name}]")
    ]
    return {name for kind, name, attribute in targets if kind == "body" and attribute.startswith("com_")}


def _known(table: Any, keys: set[str], where: str) -> None:
    if not isinstance(table, dict):
        raise TaskError(f"{where} is {table!r}, not a table", cure="write it as a [table] with keys")
    for key in table:
        if key not in keys:
            raise TaskError(f"{where}: unknown key {key!r}", cure=did_you_mean(key, keys))


def _tables(table: dict[str, Any], key: str, where: str) -> list[tuple[str, dict[str, Any]]]:
    section = table.get(key, {})
    if not isinstance(section, dict):
        raise TaskError(f"{where}: {key} is {section!r}", cure=f"write [{key}.NAME] tables")
    return list(section.items())


def _given(table: dict[str, Any], key: str) -> str:
    """What `table` says of `key`, for a message."""
    return f"{key} = {table[key]!r}" if key in table else f"{key!r} is missing"


_REQUIRED = object()


def _value(table: dict[str, Any], key: str, kind: type, where: str, default: Any = _REQUIRED) -> Any:
    """table[key] as `kind`, of `largest` at most if a number. Raises TaskError where it is missing or is none."""
    names = {str: "a string", float: "a number", bool: "true or false"}
    if key not in table:
        if default is _REQUIRED:
            raise TaskError(f"{where}: {key!r} is missing", cure=f"add `{key} = ...` ({names[kind]})")
        return default
    value = table[key]
    if kind is float and isinstance(value, int | float) and not isinstance(value, bool):
        if abs(value) > DOCUMENTS.largest:
            raise TaskError(
                f"{where}: {key} = {value:g}, and no quantity is larger than {DOCUMENTS.largest:g} in SI units",
                cure="correct it, or its unit",
            )
        return float(value)
    if kind is str and isinstance(value, str) and value:
        return value
    if kind is bool and isinstance(value, bool):
        return value
    cure = 'give a unit: "1" for a number without one' if key == "unit" else f"give {names[kind]}"
    raise TaskError(f"{where}: {key} = {value!r}", cure=cure)
