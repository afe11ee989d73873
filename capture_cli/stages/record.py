"""`capture record`: simulate a machine and write what its sensors would have logged; the truth goes to another file."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from capture_cli.effects import REGISTRY
from capture_cli.effects.base import Effect
from capture_cli.errors import FitError, OptionError, did_you_mean
from capture_cli.sim.engine import Starts
from capture_cli.sim.targets import object_names
from capture_cli.sim.windows import cut
from capture_cli.simulator import Simulator, placed_name
from capture_cli.stages.multisine import BAND, multisine, peak
from capture_cli.stores.measured_log import MeasuredLog
from capture_cli.stores.output import new_directory, new_file, refuse_existing
from capture_cli.stores.provenance import Provenance, write_json
from capture_cli.tasks import load_task
from capture_cli.tasks.base import Channel, Task

_EFFECT = re.compile(r"^(?P<name>[a-z-]+)(@(?P<site>[^.=]*))?(\.(?P<parameter>\w+))?=(?P<value>.+)$")


@dataclass(frozen=True)
class Recording:
    """What a record made: the log, and the truth it was made with."""

    log: MeasuredLog
    truth: dict


def record(
    *,
    task: str,
    out: Path,
    parameters: Mapping[str, float] | None = None,
    random_parameters: bool = False,
    effects: Sequence[str] = (),
    noise: Mapping[str, float] | float = 0.0,
    episodes: int = 1,
    duration: float = 10.0,
    rate: float | None = None,
    inputs_from: Path | None = None,
    amplitude: Mapping[str, float] | None = None,
    band: tuple[float, float] = BAND,
    start: Mapping[str, tuple[float, float]] | None = None,
    start_velocity: Mapping[str, tuple[float, float]] | None = None,
    truth: Path | None = None,
    seed: int = 0,
    threads: int | None = None,
    force: bool = False,
) -> Recording:
    """Record `episodes` of `duration` s at `rate` Hz (the model's own where None) and write a measured log at `out`.

    effects: "NAME@SITE.PARAMETER=VALUE" each; site and parameter may be left out where there is only one.
    noise: standard deviation of white noise per output, or one for all. Inputs are multisines in `band` Hz that peak
    at `amplitude` (the actuator's ctrlrange where not given), or those of the log `inputs_from`. start and
    start_velocity: JOINT -> (low, high), drawn anew for each episode. Raises CaptureError.
    """
    options = {k: v for k, v in locals().items() if k != "force"}
    truth = truth or out.with_suffix(".truth.json")
    refuse_existing(out, force=force)
    machine = load_task(task)
    provenance = Provenance(
        "record", options, {"task": getattr(machine, "path", None), "inputs_from": inputs_from}
    )
    placed, effect_values = parse_effects(effects, machine.model)
    simulator = Simulator(machine, placed, threads)
    generator = np.random.default_rng(seed)
    point = machine.space.to_vector(parameters or {}, default=_random(machine, generator, random_parameters))
    time, inputs, ends = _drive(
        machine, episodes, duration, rate, inputs_from, amplitude or {}, band, generator
    )
    starts = _starts(machine.model, len(ends), start or {}, start_velocity or {}, generator)
    outputs = _simulate(simulator, time, inputs, ends, starts, np.concatenate([point, effect_values]))
    noise_sd = _noise(noise, machine.outputs)
    log = MeasuredLog(
        task=machine.name,
        time=time,
        inputs=inputs,
        outputs=outputs + noise_sd * generator.standard_normal(outputs.shape),
        episode_ends=ends,
        recording=np.zeros(len(ends), dtype=np.int64),
        input_names=tuple(c.name for c in machine.inputs),
        input_units=tuple(c.unit for c in machine.inputs),
        output_names=tuple(c.name for c in machine.outputs),
        output_units=tuple(c.unit for c in machine.outputs),
        recordings=({"name": out.stem, "source": "capture record", "sha256": None},),
    )
    known = {
        "format": "capture/truth",
        "version": 1,
        "task": machine.name,
        "parameters": machine.space.to_dict(point),
        "effects": dict(zip(simulator.space.names[len(point) :], effect_values.tolist(), strict=True)),
        "noise_sd": {c.name: float(s) for c, s in zip(machine.outputs, noise_sd, strict=True)},
        "seed": seed,
    }
    with new_file(truth, force=True) as file:
        write_json(file, known)
    with new_directory(out, force=force) as folder:
        log.write(folder)
        provenance.write(folder)
    return Recording(log, known)


def parse_effects(texts: Sequence[str], model: mujoco.MjModel) -> tuple[list[tuple[str, Effect]], np.ndarray]:
    """Placed effects and the values of all their parameters (parameter,). Raises OptionError."""
    placed: dict[str, tuple[str, Effect, np.ndarray]] = {}
    for text in texts:
        match = _EFFECT.match(text)
        if match is None:
            raise OptionError(
                f"--effect {text!r} is not of the form NAME@SITE.PARAMETER=VALUE",
                cure="for example --effect coulomb-friction@x=3.5; `capture effects` lists what there is",
            )
        cls = REGISTRY.get(match["name"])
        site = _site(match["name"], match["site"], cls.sites(model))
        effect = cls(model, site)
        key = placed_name(match["name"], effect)
        _, effect, values = placed.setdefault(key, (match["name"], effect, effect.space.nominal.copy()))
        names = effect.space.names
        parameter = match["parameter"] or names[0]
        if parameter not in names:
            raise OptionError(
                f"--effect {text!r}: {match['name']} has no parameter {parameter!r}",
                cure=did_you_mean(parameter, names),
            )
        values[names.index(parameter)] = _number(match["value"], f"--effect {text!r}")
    effects = [(name, effect) for name, effect, _ in placed.values()]
    return effects, np.concatenate([np.zeros(0), *(values for _, _, values in placed.values())])


def _site(name: str, site: str | None, sites: list[str]) -> str:
    if site is None and len(sites) == 1:
        return sites[0]
    if site is None or site not in sites:
        found = "no site is given" if site is None else f"{site!r} is not a site"
        raise OptionError(
            f"--effect {name}: {found}, and it can sit at {len(sites)}", cure=did_you_mean(site or "", sites)
        )
    return site


def _number(text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise OptionError(f"{where}: {text!r} is not a finite number", cure="give a number in SI units")
    return value


def _random(machine: Task, generator: np.random.Generator, wanted: bool) -> np.ndarray:
    space = machine.space
    return space.from_unit(generator.uniform(size=len(space))) if wanted else space.nominal


def _drive(machine, episodes, duration, rate, inputs_from, amplitude, band, generator):
    """time (step,), inputs (step, input) and episode ends (episode,)."""
    if inputs_from is not None:
        source = MeasuredLog.read(inputs_from)
        if source.input_names != tuple(c.name for c in machine.inputs):
            raise OptionError(
                f"--inputs-from {inputs_from}: its inputs are ({', '.join(source.input_names)})",
                cure=f"give a log with the task's inputs ({', '.join(c.name for c in machine.inputs)})",
            )
        return source.time, source.inputs, source.episode_ends
    positive = [duration] if rate is None else [duration, rate]
    if episodes < 1 or not all(0 < number < np.inf for number in positive):
        raise OptionError(
            f"episodes = {episodes}, duration = {duration:g} s, rate = {rate} Hz",
            cure="give positive numbers",
        )
    if not 0 <= band[0] < band[1] < np.inf:
        raise OptionError(
            f"--band {band[0]:g} {band[1]:g}", cure="give two frequencies in Hz, the lower one first"
        )
    names = [c.name for c in machine.inputs]
    for name in set(amplitude) - set(names):
        raise OptionError(f"--amplitude: the task has no input {name!r}", cure=did_you_mean(name, names))
    interval = machine.timestep if rate is None else 1.0 / rate
    steps = round(duration / interval) + 1
    time = interval * np.arange(steps)
    peaks = np.array([peak(machine.model, channel, amplitude) for channel in machine.inputs])
    tapes = [peaks * multisine(time, len(peaks), band, generator) for _ in range(episodes)]
    return np.tile(time, episodes), np.concatenate(tapes), steps * (1 + np.arange(episodes))


def _starts(model, count: int, positions, velocities, generator) -> Starts:
    qpos = np.repeat((model.key_qpos[0] if model.nkey else model.qpos0)[None], count, axis=0)
    qvel = np.zeros((count, model.nv))
    for option, given, state, address in (
        ("--start", positions, qpos, model.jnt_qposadr),
        ("--start-velocity", velocities, qvel, model.jnt_dofadr),
    ):
        for joint, (low, high) in given.items():
            number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint)
            if number < 0:
                raise OptionError(
                    f"{option}: the model has no joint {joint!r}",
                    cure=did_you_mean(joint, object_names(model, "joint")),
                )
            state[:, address[number]] = generator.uniform(low, high, count)
    return Starts(qpos, qvel, np.zeros((count, model.na)), np.zeros(count))


def _simulate(simulator: Simulator, time, inputs, ends, starts: Starts, point: np.ndarray) -> np.ndarray:
    machine = simulator.task
    episodes = [slice(a, b) for a, b in zip([0, *ends[:-1]], ends, strict=True)]
    windows = cut(
        time=time,
        inputs=inputs,
        outputs=np.zeros((len(time), len(machine.outputs))),
        episodes=episodes,
        timestep=machine.timestep,
        duration=None,
        linear=np.array([c.linear for c in machine.inputs], dtype=bool),
    )
    simulated = simulator.simulate(windows, starts, point[None])
    if simulated.diverged.any():
        raise FitError(
            f"the simulation diverged in {int(simulated.diverged.sum())} of {len(windows)} episodes",
            cure="drive it less (--amplitude), choose tamer parameters or effects, or a smaller model timestep",
        )
    return simulated.outputs[0][windows.mask]


def _noise(noise: Mapping[str, float] | float, outputs: Sequence[Channel]) -> np.ndarray:
    """Standard deviation per output, (output,)."""
    names = [c.name for c in outputs]
    if isinstance(noise, int | float):
        noise = dict.fromkeys(names, float(noise))
    for name, sd in noise.items():
        if name not in names:
            raise OptionError(f"--noise: the task has no output {name!r}", cure=did_you_mean(name, names))
        if not sd >= 0:
            raise OptionError(
                f"--noise {name}={sd:g}", cure="give a standard deviation of 0 or more, in SI units"
            )
    return np.array([noise.get(name, 0.0) for name in names])
