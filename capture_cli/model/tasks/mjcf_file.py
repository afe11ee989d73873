"""A user's own machine: an MJCF and a `task.toml` that says what is open, what drives it and what was measured."""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path

import mujoco

from capture_cli.common.documents import read_toml
from capture_cli.errors import ModelError, TaskError, did_you_mean
from capture_cli.model.mjcf.model_file import compile_file
from capture_cli.model.parameters import Parameter, ParameterSpace
from capture_cli.model.quaternion_signs import is_quaternion
from capture_cli.model.sensor_units import factor_between, refuse_other_units, refuse_period_in_other_unit
from capture_cli.model.target_names import attribute_of, object_id, parse_target, split_target
from capture_cli.model.targets import Target
from capture_cli.model.tasks._table import REQUIRED, Table
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
KEYS = {  # of the file, and of its tables
    "": ("format", "name", "model", "parameters", "inputs", "outputs", "log", "reward"),
    "parameters": ("set", "low", "high", "unit", "nominal"),
    "inputs": ("column", "unit", "column_unit", "scale", "offset", "interpolate", "late"),
    "outputs": ("column", "unit", "column_unit", "scale", "offset", "noise_sd", "period", "sparse"),
    "log": ("time", "time_scale", "episode", "window"),
    "reward": ("duration", "points", "outputs"),
    "reward.outputs": ("target", "within", "at", "weight"),
}


class MjcfFile(Task):
    """The task written in the file at `path`. Raises TaskError or ModelError before any work."""

    def __init__(self, path: Path):
        self.path = Path(path)
        table = Table(read_toml(self.path, TaskError), str(self.path), KEYS[""])
        if table.entry.get("format") != FORMAT or isinstance(table.entry["format"], bool):
            raise table.error(
                f"{table.given('format')}; this program reads {FORMAT}",
                cure=f"begin the file with `format = {FORMAT}`",
            )
        self.name = table.text("name", self.path.parent.name)
        self.model_path = self.path.parent / table.text("model")
        opened = [(name, own, _set_texts(own)) for name, own in _tables(table, "parameters")]
        self.model = compile_file(self.model_path, _moved_centres([texts for *_, texts in opened]))
        self._targets: list[tuple[int, Target]] = []  # with the number of the parameter that sets each
        self.model_values = {}
        parameters = []
        set_by: dict[str, str] = {}
        for name, own, texts in opened:
            parameter, targets = self._parameter(name, own, texts, set_by)
            self._targets += [(len(parameters), target) for target in targets]
            parameters.append(parameter)
        self._targets.sort(key=lambda numbered: not numbered[1].scales)
        self.space = ParameterSpace(parameters)
        self.inputs = tuple(self._input(name, own) for name, own in _tables(table, "inputs"))
        self.outputs = tuple(
            channel for name, own in _tables(table, "outputs") for channel in self._output(name, own)
        )
        if not self.outputs:
            raise table.error("no [outputs.NAME]", cure="name at least one sensor of the model as an output")
        self.log = _log_columns(Table(table.entry.get("log", {}), f"{self.path}: [log]", KEYS["log"]))
        self.reward = None
        if "reward" in table:
            self.reward = self._reward(Table(table.entry["reward"], f"{self.path}: [reward]", KEYS["reward"]))

    def write(self, fields, parameters):
        for column, target in self._targets:
            target.write(fields, parameters[:, column])

    def _parameter(
        self, name: str, own: Table, texts: list[str], set_by: dict[str, str]
    ) -> tuple[Parameter, list[Target]]:
        """The parameter that sets `texts`, and its targets. set_by: which parameter sets each target so far; `name` is
        added.
        """
        if not name.strip():
            raise own.error("the parameter has no name", cure="name it: [parameters.NAME]")
        targets = [parse_target(text, self.model, own.where) for text in texts]
        _set_once(own, texts, name, set_by)
        low, high = own.number("low"), own.number("high")
        if not low < high:
            raise own.error(f"low = {low:g}, high = {high:g}", cure="give bounds with low < high")
        _check_least(own, texts, low)
        value = targets[0].read(self.model)
        if "nominal" not in own:
            self.model_values[name] = value, texts[0]
        nominal = own.number("nominal", value)
        if "nominal" in own and not low <= nominal <= high:
            raise own.error(
                f"nominal = {nominal:g} lies outside [{low:g}, {high:g}]",
                cure="move it inside, widen the bounds, or leave it out to take the model's own value",
            )
        return Parameter(name, own.text("unit"), low, high, min(max(nominal, low), high)), targets

    def _input(self, name: str, own: Table) -> Channel:
        number = object_id(self.model, "actuator", name, own.where)
        self._check_actuator(number, name, own.where)
        return Channel(
            name=name,
            unit=own.text("unit"),
            column=own.text("column"),
            index=number,
            scale=_scale(own),
            offset=own.number("offset", 0.0),
            hold=hold_of(own.entry, own.where),
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

    def _output(self, name: str, own: Table) -> list[Channel]:
        number = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SENSOR, name)
        if number < 0:
            raise ModelError(
                f"{own.where}: the model has no sensor {name!r}", cure=self._sensor_to_take(name)
            )
        if self.model.sensor_history[number, 0] or self.model.sensor_interval[number].any():
            raise ModelError(
                f"{own.where}: the sensor has a delay or an interval, and windows begin with an empty memory",
                cure="leave delay, interval and nsample out of the model: `capture diagnose` finds how late a "
                f"sensor reports (sensor-delay@{name})",
            )
        size, first = int(self.model.sensor_dim[number]), int(self.model.sensor_adr[number])
        columns = _columns(own, size)
        if "" in columns and is_quaternion(self.model, number):
            raise own.error(
                f"{own.given('column')}, and an attitude is all of its {size} values",
                cure="name the columns of all, or leave the output out",
            )
        unit = own.text("unit")
        refuse_other_units(own.entry, unit, self.model, number, own.where)
        noise_sd = own.positive("noise_sd", cure="give a positive number, or leave it out")
        anew = "give what the column goes through before it begins anew, 360 for degrees, or leave it out"
        period, scale = own.positive("period", cure=anew), _scale(own)
        if period is not None:
            refuse_period_in_other_unit(period, unit, scale, own.where)
        axes = endings(size)
        return [
            Channel(
                name=name + axes[i],
                unit=unit,
                column=columns[i],
                index=first + i,
                sensor=number,
                scale=scale,
                offset=own.number("offset", 0.0),
                noise_sd=noise_sd,
                period=period,
                sparse=own.flag("sparse", False),
            )
            for i in range(size)
            if columns[i]
        ]

    def _reward(self, own: Table) -> Reward:
        duration = own.positive("duration", REQUIRED, cure="give the seconds that an episode lasts")
        points = own.number("points", 5.0)
        if points != int(points) or not 2 <= points <= duration / self.timestep + 1:
            raise own.error(
                f"points = {points:g}",
                cure=f"give a whole number, from 2 to one a time step of the model, {self.timestep:g} s",
            )
        entries = own.tables("outputs")
        if not entries:
            raise own.error("no goal", cure="write [reward.outputs.NAME] with target and within")
        places = f"{own.where[:-1]}.outputs"
        goals = tuple(
            self._goal(name, Table(entry, f"{places}.{name}]", KEYS["reward.outputs"]), duration)
            for name, entry in entries
        )
        return Reward(goals, duration, int(points))

    def _goal(self, name: str, own: Table, duration: float) -> Goal:
        names = [c.name for c in self.outputs]
        if name not in names:
            raise own.error(f"there is no output {name!r}", cure=did_you_mean(name, names))
        at = own.positive("at", cure="give a time in the episode, or leave it out for all the while")
        if at is not None and at > duration:
            raise own.error(f"at = {at:g}", cure=f"an episode lasts {duration:g} s: give that at most")
        return Goal(
            output=name,
            target=own.number("target"),
            within=own.positive("within", REQUIRED, cure="give how near counts, above 0"),
            at=at,
            weight=own.positive("weight", 1.0, cure="give a number above 0"),
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


def endings(size: int) -> tuple[str, ...]:
    """Of the names of a sensor's values, of which it has so many."""
    return _AXES.get(size, tuple(f"_{i}" for i in range(size)))


def _tables(table: Table, key: str) -> Iterator[tuple[str, Table]]:
    """The tables in that of `key`, by name."""
    for name, entry in table.tables(key):
        yield name, Table(entry, f"{table.where}: [{key}.{name}]", KEYS[key])


def _log_columns(own: Table) -> LogColumns:
    window = own.positive("window", cure="give a positive number of seconds")
    seconds = "give the seconds in one unit of the time column, say 1e-3 for milliseconds"
    time_scale = own.positive("time_scale", 1.0, cure=seconds)
    return LogColumns(own.text("time", "time"), own.text("episode", None), window, time_scale)


def _columns(own: Table, size: int) -> list[str]:
    """The column of each of a sensor's `size` values, "" of one that was not logged. Raises TaskError."""
    columns = own.entry.get("column")
    columns = [columns] if isinstance(columns, str) else columns
    texts = isinstance(columns, list) and all(isinstance(c, str) for c in columns)
    if texts and len(columns) == size and any(columns):
        return columns
    given = own.given("column")
    if size == 1:
        raise own.error(f"{given}, and the sensor has 1 value", cure="name one column of the log")
    some = [*[""] * (size - 1), columns[0] if texts and len(columns) == 1 and any(columns) else "NAME"]
    raise own.error(
        f"{given}, and the sensor has {size} values",
        cure=f'give a list of {size} columns of the log, "" for what was not logged: column = {json.dumps(some)}',
    )


def _scale(own: Table) -> float:
    """The factor on a channel's column: `scale`, times what brings `column_unit` to `unit`.

    Raises TaskError where it is 0, which would leave nothing of the column, or the units are of different things.
    """
    scale = own.number("scale", 1.0)
    if scale == 0:
        raise own.error(
            "scale = 0 makes every value the same",
            cure="give the factor that brings the column to the unit, or leave it out if that is 1",
        )
    if "column_unit" not in own:
        return scale
    unit, written = own.text("unit"), own.text("column_unit")
    return scale * factor_between(written, unit, own.where)


def _set_once(own: Table, texts: list[str], name: str, set_by: dict[str, str]) -> None:
    """Note in `set_by` that the parameter `name` sets `texts`. Raises TaskError where one of them is set already."""
    for text in texts:
        other = set_by.get(text)
        if other == name:
            raise own.error(f"set names {text!r} twice", cure="name it once")
        if other is not None:
            raise own.error(
                f"sets {text!r}, and so does [parameters.{other}]",
                cure="leave it out of one of them: the log could not tell the two apart",
            )
        set_by[text] = name


def _check_least(own: Table, texts: list[str], low: float) -> None:
    """Raise TaskError where the bound `low` is below what one of the targets `texts` can be."""
    for text in texts:
        least = attribute_of(text).least
        if low < least:
            raise own.error(
                f"low = {low:g}, and {text!r} cannot be below {least:g}", cure=f"give low = {least:g} or more"
            )


def _set_texts(own: Table) -> list[str]:
    """What a parameter's table says it sets. Raises TaskError."""
    texts = own.entry.get("set")
    texts = [texts] if isinstance(texts, str) else texts
    if not isinstance(texts, list) or not texts or not all(isinstance(t, str) for t in texts):
        raise own.error(own.given("set"), cure='write set = "KIND:NAME:ATTRIBUTE", or a list of such')
    return texts


def _moved_centres(texts: Iterable[list[str]]) -> set[str]:
    """Bodies of which one of the parameters that set these sets the centre of mass."""
    targets = [split_target(text) for own in texts for text in own]
    return {name for kind, name, attribute in targets if kind == "body" and attribute.startswith("com_")}
