"""Options of a command: a frozen class, from which command line and provenance follow."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, get_type_hints

import pytest
import typer

from capture_cli.cli.app import _COMMANDS
from capture_cli.errors import OptionError
from capture_cli.options.base import LAST, Options, on_command_line, takes_options
from capture_cli.options.diagnose import DiagnoseOptions
from capture_cli.options.identify import IdentifyOptions
from capture_cli.options.record import RecordOptions
from capture_cli.options.shared import Writing

CLASSES = [get_type_hints(command)["options"] for command in _COMMANDS.values()]


@pytest.mark.parametrize("kind", CLASSES, ids=lambda kind: kind.__name__)
def test_options_are_frozen_and_those_of_any_command_come_last(kind):
    assert kind.__dataclass_params__.frozen
    names = [parameter.name for parameter in kind.parameters()]
    assert set(names) <= {field.name for field in dataclasses.fields(kind)}
    last = [name for name in names if name in LAST]
    assert names[-len(last) :] == last == sorted(last, key=LAST.index)


@pytest.mark.parametrize(
    "given, named",
    [
        ({"episodes": 0}, ["--episodes 0", "a whole number of 1 or more"]),
        ({"seed": -1}, ["--seed -1", "a whole number from 0 to"]),
        ({"rate": 0.0}, ["--rate 0", "a positive number"]),
        ({"rate": float("inf")}, ["--rate inf", "a finite number"]),
        ({"band": (0.1, float("nan"))}, ["--band nan", "a finite number"]),
        ({"episodes": 2**31}, ["--episodes 2147483648", "a whole number of 2147483647 at most"]),
        ({"belief": "nominl"}, ["--belief 'nominl'", "did you mean 'nominal'"]),
    ],
)
def test_what_an_option_does_not_take_is_refused_of_whoever_gives_it(given, named):
    with pytest.raises(OptionError) as error:
        RecordOptions(task="scooping", out=Path("log.zarr"), **given)
    assert all(part in str(error.value) for part in named)
    RecordOptions(task="scooping", out=Path("log.zarr"), episodes=1, seed=0, rate=1e-3, belief="random")


@dataclass(frozen=True, kw_only=True)
class Weighing(Writing):
    """What is weighed."""

    what: Annotated[str, typer.Argument()]
    times: Annotated[int, typer.Option("--times")] = 2
    scale: str = "kitchen"  # not on the command line


def test_a_command_is_given_its_options_as_one_value():
    given = []

    def weigh(options: Weighing) -> None:
        """Weigh it."""
        given.append(options)

    called = on_command_line(weigh)
    assert called.__name__ == "weigh" and called.__doc__ == "Weigh it."
    called(what="flour", times=3, force=False, json_=False, quiet=True, config=None)
    assert given == [Weighing(what="flour", times=3, quiet=True)]


def test_a_stage_takes_its_options_or_their_fields():
    @takes_options
    def weighed(options: Weighing) -> str:
        return f"{options.what}, {options.times} times"

    assert weighed(what="salt") == weighed(Weighing(what="salt")) == "salt, 2 times"
    with pytest.raises(TypeError):
        weighed(what="salt", tmes=3)


def test_provenance_has_what_makes_the_result():
    recorded = Weighing(what="flour", force=True, quiet=True).recorded()
    assert recorded == {"what": "flour", "times": 2, "scale": "kitchen"}


def test_texts_are_read_before_a_stage_is_called():
    texts = {"parameters": ["mass=2"], "noise": ["0.1"], "amplitude": [], "start": ["x=-1:1"]}
    texts |= {"start_velocity": [], "task": "task.toml", "out": Path("run.zarr")}
    options = RecordOptions.of_command_line(texts)
    assert options.parameters == {"mass": 2.0} and options.noise == 0.1
    assert options.amplitude == {} and options.start == {"x": (-1.0, 1.0)}
    with pytest.raises(OptionError, match="--param 'mass' is not NAME=NUMBER"):
        RecordOptions.of_command_line(texts | {"parameters": ["mass"]})


def test_a_log_does_not_tell_its_truth():
    options = RecordOptions(task="t", out=Path("o.zarr"), parameters={"mass": 2.0}, effects=["wind.x=3"])
    assert not options.recorded().keys() & {"parameters", "effects", "estimate"}


def test_results_are_called_after_the_log():
    assert IdentifyOptions(real_log=Path("logs/run.zarr")).out == Path("run.estimate")
    assert DiagnoseOptions(real_log=Path("logs/run.zarr")).out == Path("run.diagnosis")
    assert IdentifyOptions(real_log=Path("run.zarr"), out=Path("e")).out == Path("e")


def test_config_is_no_option_of_the_result():
    assert Options().recorded() == {}
