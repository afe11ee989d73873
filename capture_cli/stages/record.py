"""`capture record`: simulate a machine and write what its sensors would have logged; the truth goes to another file."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from mujoco.batch import SimulationError

from capture_cli.common.documents import resolved
from capture_cli.context.observation_noise import standard_deviations
from capture_cli.context.worlds.world import PLANT, World, check_world
from capture_cli.context.worlds.world import SETTINGS as WORLD
from capture_cli.errors import FitError, OptionError
from capture_cli.log.arrays import Log, slices_until
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.windows import cut
from capture_cli.model.tasks.base import ActionTask
from capture_cli.options.base import takes_options
from capture_cli.options.record import RecordOptions
from capture_cli.simulate.simulator import Simulator
from capture_cli.stages.effect_option import beyond_range, refuse_negative, refuse_without_effect
from capture_cli.stages.excitation.drive import Drive, drive
from capture_cli.stages.recorded.recorded_task import task_inputs
from capture_cli.stages.simulated_machine import SimulatedMachine
from capture_cli.store.output import New, new_outputs, refuse_existing, refuse_inputs, refuse_misnamed
from capture_cli.store.provenance import Provenance, write_json


@dataclass(frozen=True)
class Recording:
    """The log, the truth it was made with, and values of it that may be a slip, in words."""

    log: MeasuredLog
    truth: dict
    truth_path: Path
    doubts: Sequence[str] = ()


@takes_options
def record(options: RecordOptions) -> Recording:
    """Record `episodes` of `duration` s at `rate` Hz (the model's own where None) and write a measured log at `out`.

    The world "plant" simulates the task's model; "robosuite" the whole scene of a built-in task, in which a robot's own
    controller drives it. Effects are of the plant; those of the option stand in the place of the estimate's, as do its
    parameters. Raises CaptureError.
    """
    check_world(options.world, options.robot)
    out = options.out
    refuse_existing(out, force=options.force)
    truth = options.truth or out.with_suffix(".truth.json")
    _refuse_truth(truth, out, force=options.force)
    asked = SimulatedMachine.of(options.task, options.estimate, options.effects)
    machine = asked.task
    policy = Path(options.policy) if options.policy is not None and Path(options.policy).exists() else None
    read = [options.inputs_from, options.actions_from, options.estimate, policy]
    read += task_inputs(machine).values()
    refuse_inputs(out, read)
    refuse_inputs(truth, read, option="--truth")
    refuse_misnamed(truth, ".json", option="--truth")
    inputs = {"task": machine.path, "inputs_from": options.inputs_from, "policy": policy}
    provenance = Provenance("record", options.recorded(), inputs)
    simulator = Simulator(machine, asked.effects.placed, options.threads)
    names = [c.name for c in machine.outputs]
    noise_sd = standard_deviations("--noise", options.noise, names, "the task has no output")
    generator = np.random.default_rng(options.seed)
    point = _point(asked, options, generator)
    driven, outputs = _outputs(options, simulator, point, drive(machine, options, generator))
    outputs = outputs + np.array(noise_sd) * generator.standard_normal(outputs.shape)
    log = driven.log(machine, outputs, name=out.stem, source="capture record")
    known = _truth(simulator, point, dict(zip(names, noise_sd, strict=True)), options)
    places = (New(truth), New(out, is_folder=True))
    with new_outputs(*places, force=options.force) as (file, folder):
        write_json(file, known)
        log.write(folder)
        provenance.write(folder)
    doubts = [*beyond_range(simulator.space.parameters, point), *_repeated(driven.actions, options)]
    return Recording(log, known, truth, doubts)


def _refuse_truth(truth: Path, log: Path, *, force: bool) -> None:
    """Raise OptionError or OutputError where `truth` cannot be written there, beside `log`."""
    refuse_existing(truth, force=force)
    if resolved(log) in (resolved(truth), *resolved(truth).parents):
        raise OptionError(
            f"--truth {truth} is the log at --out {log}, or in it: whoever reads a log must not find its truth",
            cure="choose another --truth, or leave it out: the truth then goes beside the log",
        )


def _outputs(
    options: RecordOptions, simulator: Simulator, point: np.ndarray, driven: Drive
) -> tuple[Drive, np.ndarray]:
    """How the machine was driven in that world, and its outputs (step, output) without noise; point (parameter,): of
    the task and, after them, of the simulator's effects.
    """
    if options.world == PLANT:
        return driven, _simulate(simulator, driven, point)
    if simulator.effects:
        names = ", ".join(placed.name for placed in simulator.effects)
        raise OptionError(
            f"--effect means nothing, and so do effects of --estimate ({names}): --world {options.world} lacks "
            "nothing that could be added to it",
            cure="leave it out; the values of an estimate can be given with --param",
        )
    rate = 1 / (driven.time[1] - driven.time[0])
    return _in_scene(World(simulator.task, options.robot or WORLD.robot, rate), point, driven)


def _truth(
    simulator: Simulator, point: np.ndarray, noise_sd: dict[str, float], options: RecordOptions
) -> dict[str, Any]:
    """The document of the truth, which stands nowhere in the log. point (parameter,): of the task and its effects."""
    task, values = simulator.task, simulator.space.to_dict(point)
    return {
        "format": "capture/truth",
        "version": 2,
        "task": task.name,
        "world": options.world,
        "robot": None if options.world == PLANT else options.robot or WORLD.robot,
        "parameters": {name: values[name] for name in task.space.names},
        "effects": {name: values[name] for name in simulator.space.names[len(task.space) :]},
        "noise_sd": noise_sd,
        "seed": options.seed,
    }


def _repeated(actions: np.ndarray | None, options: RecordOptions) -> list[str]:
    """The doubt, in words, that a policy chose the same action (episode, action) again and again; none where it did
    not.
    """
    if actions is None or options.policy is None or options.belief != "nominal":
        return []
    different = len(np.unique(actions.round(6), axis=0))
    if different == len(actions):
        return []
    return [
        f"the policy chose {different} action{'s' * (different > 1)} for {len(actions)} episodes, as it takes the "
        "parameters for nominal in each: --belief random has it act for others, and more is seen"
    ]


def _point(asked: SimulatedMachine, options: RecordOptions, generator: np.random.Generator) -> np.ndarray:
    """The parameters (parameter,) of the task and its effects. Those of the task without a value are drawn, or as the
    machine has them; those of effects are drawn where they have a range. Raises OptionError.
    """
    space, effects = asked.task.space, asked.effects
    default = (
        space.from_unit(generator.uniform(size=len(space))) if options.random_parameters else asked.values
    )
    point = space.to_vector(options.parameters, default=default)
    for parameter, value in zip(space.parameters, point, strict=True):
        refuse_negative("--param", parameter, value)
    refuse_without_effect(asked.task, point, effects)
    return np.concatenate([point, effects.drawn(generator, 1)[0] if effects.vary else effects.middle])


def _in_scene(world: World, point: np.ndarray, driven: Drive) -> tuple[Drive, np.ndarray]:
    """How the world was driven, its robot taking the actions of `driven`, and outputs (step, output).

    Raises OptionError where the robot cannot, FitError where the simulation diverges.
    """
    world.try_out()
    played = world.play(point, driven.actions)
    if count := sum(p.diverged for p in played):
        raise FitError(
            f"the simulation diverged in {count} of {len(played)} episodes", cure="take another --robot"
        )
    time, inputs, outputs = (
        np.concatenate([getattr(p, n) for p in played]) for n in ("time", "inputs", "outputs")
    )
    return replace(driven, time=time, inputs=inputs, ends=np.cumsum([len(p.time) for p in played])), outputs


def _simulate(simulator: Simulator, driven: Drive, point: np.ndarray) -> np.ndarray:
    """Outputs (step, output) at the task's and the effects' parameters `point`. Raises FitError where one diverges."""
    machine = simulator.task
    time = driven.time - driven.time[0]  # the inputs may be those of a log
    nothing = np.zeros((len(time), len(machine.outputs)))
    samples = Log(time, nothing, slices_until(driven.ends), driven.inputs)
    windows = cut(samples, None, machine.timestep, machine.holds, has_gaps=False)
    try:
        initial = replace(driven.initial, time=windows.time)
        # an action says where the machine is when the log begins
        logged = not isinstance(machine, ActionTask)
        simulated = simulator.simulate(windows, initial, point[None], logged=logged)
    except SimulationError as error:
        raise _not_simulated(simulator, point, f"MuJoCo does not simulate that: {error}") from error
    if simulated.diverged.any():
        count = int(simulated.diverged.sum())
        raise _not_simulated(
            simulator, point, f"the simulation diverged in {count} of {len(windows)} episodes"
        )
    return simulated.outputs[0][windows.mask]


def _not_simulated(simulator: Simulator, point: np.ndarray, found: str) -> FitError:
    beyond = [
        f"{p.name} = {value:g}, and its range is {p.low:g} to {p.high:g} {p.unit}"
        for p, value in zip(simulator.space, point, strict=True)
        if not p.low <= value <= p.high
    ]
    cure = "drive it less (--amplitude), choose tamer parameters or effects, or a smaller model timestep"
    return FitError(found, cure=f"choose from their ranges: {'; '.join(beyond)}" if beyond else cure)
