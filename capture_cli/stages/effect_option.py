"""`--effect NAME@SITE.PARAMETER=VALUE`, or `=LOW:HIGH`, read: which effects, where, with which values."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from capture_cli.errors import OptionError, did_you_mean
from capture_cli.model.effects import REGISTRY
from capture_cli.model.effects.base import GLOBAL, Effect
from capture_cli.model.effects.placed import Placed
from capture_cli.model.effects.ranges import EffectRanges
from capture_cli.model.fields import ModelFields
from capture_cli.model.parameters import Parameter
from capture_cli.model.tasks.base import Task

# what stands after @ is a site, or a site and a parameter: names in a model may have dots and more in them
_EFFECT = re.compile(
    r"^(?P<name>[a-z-]+)(@(?P<place>.*?)|\.(?P<parameter>\w+))?(=(?P<value>[^=]+))?$", re.DOTALL
)


@dataclass(frozen=True)
class _Given:
    """One --effect. parameter: which of the effect's it sets; None: none, it is there, or all over their ranges."""

    placed: Placed
    parameter: int | None
    low: float = 0.0
    high: float = 0.0


def parse_effects(
    texts: Sequence[str],
    model: mujoco.MjModel,
    *,
    found: Sequence[tuple[Placed, np.ndarray]] = (),
    over_own_range: bool = False,
) -> EffectRanges:
    """The effects of `texts`, after those `found` before, with the values (parameter,) of each. Raises OptionError.

    A text goes before what was found, and parameters that nobody names are null. over_own_range: those of an effect
    that is named alone go over the whole range in which each is looked for; otherwise a value has to be given.
    """
    ranges = {placed.name: (placed, values.copy(), values.copy()) for placed, values in found}
    for text in texts:
        given = _parse(text, model, over_own_range)
        space = given.placed.effect.space
        start = (given.placed, space.nominal.copy(), space.nominal.copy())
        _, low, high = ranges.setdefault(given.placed.name, start)
        if given.parameter is None:
            low[:], high[:] = space.low, space.high
        else:
            low[given.parameter], high[given.parameter] = given.low, given.high
    return EffectRanges.of(ranges.values())


def _parse(text: str, model: mujoco.MjModel, over_own_range: bool) -> _Given:
    match = _EFFECT.match(text)
    if match is None:
        raise OptionError(
            f"--effect {text!r} is not of the form NAME@SITE.PARAMETER=VALUE, or =LOW:HIGH",
            cure="for example --effect coulomb-friction@x=3.5; `capture effects` lists what there is",
        )
    cls = REGISTRY.get(match["name"])
    site, parameter = match["place"], match["parameter"]
    if site is not None:
        site, parameter = _site_and_parameter(site, cls, model)
    effect = cls(model, _site(match["name"], site, cls, model))
    placed = Placed(match["name"], effect)
    if not parameter and not match["value"] and (over_own_range or not effect.parameters):
        return _Given(placed, None)
    which = _parameter(text, match, parameter, effect.space.names)
    low, high = _range(text, match["value"], placed.name, effect.space.names)
    for value in (low, high):
        refuse_negative(f"--effect {text}", effect.space.parameters[which], value)
    return _Given(placed, which, low, high)


def refuse_negative(option: str, parameter: Parameter, value: float) -> None:
    """Raise OptionError for a negative mass, friction, time...: of no machine, and of simulations that run away."""
    if value < 0 <= parameter.low:
        raise OptionError(
            f"{option}: {parameter.name} = {value:g} {parameter.unit}, and it cannot be negative",
            cure=f"choose one from {parameter.low:g} to {parameter.high:g}",
        )


def beyond_range(parameters: Sequence[Parameter], values: np.ndarray) -> list[str]:
    """Which `values` (parameter,) of effects lie outside the ranges in which they are looked for, in words.

    A truth may well; 12 where 12 ms was meant does, too.
    """
    return [
        f"{p.name} = {value:g} {p.unit} is outside the range in which it is looked for, {p.low:g} to {p.high:g}"
        for p, value in zip(parameters, values, strict=True)
        if not p.low <= value <= p.high
    ]


def refuse_without_effect(task: Task, point: np.ndarray, effects: EffectRanges) -> None:
    """Raise OptionError where the model at `point` (parameter,) takes less of an effect than an end of its range says.

    A joint has no less friction than none, and a truth must not say that it had. Only what is written into the model
    can be less than was asked for, and only beyond the range in which it is looked for.
    """
    for ends in (effects.low, effects.high):
        first = 0
        for one in effects.placed:
            effect = one.effect
            own = ends[first : first + len(effect.space)]
            first += len(effect.space)
            for k, parameter in enumerate(effect.space.parameters if effect.place == "model" else ()):
                nearest = np.clip(own[k], parameter.low, parameter.high)
                less = own.copy()
                less[k] += 1e-3 * (nearest - own[k])
                if own[k] != nearest and _same_model(task, point, effect, own, less):
                    raise OptionError(
                        f"--effect {one.name}.{parameter.name}={own[k]:g}: the model takes no more of it "
                        f"than of values nearer to its range, {parameter.low:g} to {parameter.high:g} {parameter.unit}",
                        cure="choose one from this range",
                    )


def _same_model(task: Task, point: np.ndarray, effect: Effect, *values: np.ndarray) -> bool:
    """Whether an effect writes the same into the model at two values (parameter,)."""
    fields = ModelFields(task.model, len(values))
    task.write(fields, np.repeat(point[None], len(values), axis=0))
    effect.write(fields, np.stack(values))
    return all(np.array_equal(field[0], field[1]) for field in fields.values.values())


def _site_and_parameter(place: str, cls: type[Effect], model: mujoco.MjModel) -> tuple[str, str | None]:
    """SITE.PARAMETER or SITE, where a site may have dots in it: parted at the last one, if that makes sense."""
    sites = cls.sites(model)
    site, dot, parameter = place.rpartition(".")
    makes_sense = site in sites and parameter in cls(model, site).space.names
    return (site, parameter) if dot and (makes_sense or place not in sites) else (place, None)


def _parameter(text: str, match: re.Match, parameter: str | None, names: Sequence[str]) -> int:
    """Which of the effect's parameters `text` sets; the first where it names none."""
    if not names:
        raise OptionError(
            f"--effect {text!r}: {match['name']} has no parameters",
            cure="leave the value out: it is there, or it is not",
        )
    parameter = names[0] if parameter is None else parameter
    if parameter not in names:
        raise OptionError(
            f"--effect {text!r}: {match['name']} has no parameter {parameter!r}",
            cure=did_you_mean(parameter, names),
        )
    if match["value"] is None:
        raise OptionError(
            f"--effect {text!r} gives {parameter} no value",
            cure=f"for example {text}=3.5; `capture effects` has its range",
        )
    return names.index(parameter)


def _site(name: str, site: str | None, cls: type[Effect], model: mujoco.MjModel) -> str:
    sites = cls.sites(model)
    if not sites:
        raise OptionError(
            f"--effect {name}: the model has no place for it", cure=f"it sits at {cls.where}: leave it out"
        )
    if site is None and len(sites) == 1:
        return sites[0]
    if site is None and GLOBAL in sites:
        return GLOBAL
    if sites == [GLOBAL] and site:
        raise OptionError(
            f"--effect {name}@{site}: the effect concerns the model as a whole, and sits nowhere in it",
            cure=f"write it without @{site}",
        )
    if site is None or site not in sites:
        found = "no site is given" if site is None else f"{site!r} is not a site"
        raise OptionError(
            f"--effect {name}: {found}; there {'is' if len(sites) == 1 else 'are'} {len(sites)}",
            cure=did_you_mean(site or "", sites),
        )
    return site


def _range(text: str, value: str, placed: str, names: Sequence[str]) -> tuple[float, float]:
    """`value` of `--effect text`, LOW:HIGH or one number, which is both; placed: the effect's name and site, which has
    parameters of these names.
    """
    low, colon, high = value.partition(":")
    ends = tuple(_number(text, end, placed, names) for end in ((low, high) if colon else (low, low)))
    if colon and not ends[0] < ends[1]:
        raise OptionError(
            f"--effect {text!r}: nothing lies between {low} and {high}",
            cure="give the lower end first, and a higher one; of one value, leave the colon out",
        )
    return ends


def _number(text: str, value: str, placed: str, names: Sequence[str]) -> float:
    """`value` of `--effect text`, or an end of its range; other arguments as of `_range`."""
    try:
        number = float(value)
    except ValueError:
        number = float("nan")
    if not np.isfinite(number):
        cure = "give a number in SI units"
        if len(names) > 1:
            cure += f", each parameter by an option of its own: --effect {placed}.{names[0]}=VALUE"
            cure += f" --effect {placed}.{names[1]}=VALUE"
        raise OptionError(f"--effect {text!r}: {value!r} is not a finite number", cure=cure)
    return number
