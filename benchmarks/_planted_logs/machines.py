"""Machines, six of which are drawn from, and logs recorded from them with an effect of any size in memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks import MACHINES
from capture_cli.estimate.balance.input_timing import held_late
from capture_cli.estimate.time_step import FINER
from capture_cli.log.arrays import Log
from capture_cli.log.input_sequences import HELD, Hold
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.log.windows import cut
from capture_cli.model.effects import REGISTRY
from capture_cli.model.effects.base import Effect
from capture_cli.model.states import InitialStates
from capture_cli.model.tasks import load_task
from capture_cli.model.tasks.base import Task
from capture_cli.simulate.multisine import multisine
from capture_cli.simulate.simulator import Simulator

EPISODES, DURATION, RATE = 12, 3.0, 250.0
BAND = (0.1, 3.0)  # Hz
FINE = "eighth"  # of the model's step: those of a machine that was simulated elsewhere


@dataclass(frozen=True)
class Machine:
    """noise: sd per output, in its unit. start_velocity: JOINT -> (low, high), drawn for each episode.

    folder: of its task.toml; that of its name in benchmarks/machines where None.
    """

    name: str
    noise: Mapping[str, float]
    start_velocity: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    folder: Path | None = None

    @property
    def task(self) -> Task:
        return load_task(str((self.folder or MACHINES / self.name) / "task.toml"))


MACHINE = {
    m.name: m
    for m in (
        Machine("slider", {"q": 5e-4}),
        Machine("cart_pole", {"cart": 5e-4, "pole": 1e-3}),
        Machine("arm", {"q1": 1e-3, "q2": 1e-3}),
        Machine("pan_tilt", {"pan": 1e-3, "tilt": 1e-3}),
        Machine("finger", {"mcp": 2e-3, "pip": 2e-3}),
        Machine("puck", {"x": 5e-4, "y": 5e-4}, {"x": (-2.0, 2.0), "y": (-2.0, 2.0)}),
    )
}


class Experiment:
    """One machine with its parameters, its drive and its noise; what an effect adds to it is all that changes.

    rate: rows, and commands that are held, per second. elsewhere: the machine moves in time, and not in the steps of
    its model: in `FINE` of each, and inputs and sensors half a step later (second order in the step).

    time (step,) s; inputs (step, input); noise (step, output); noise_sd (output,); episodes: their steps.
    """

    def __init__(
        self,
        machine: Machine,
        generator: np.random.Generator,
        episodes: int = EPISODES,
        rate: float = RATE,
        *,
        elsewhere: bool = False,
    ):
        self.task, self.elsewhere = machine.task, elsewhere
        self.parameters = self.task.space.from_unit(generator.uniform(size=len(self.task.space)))
        self.noise_sd = np.array([machine.noise[c.name] for c in self.task.outputs])
        steps = round(DURATION * rate) + 1
        clock = np.arange(steps) / rate
        self.time = np.tile(clock, episodes)
        self.episodes = [slice(i * steps, (i + 1) * steps) for i in range(episodes)]
        self.inputs = self._tapes(clock, generator)
        self.initial = self._starts(machine, generator)
        self.noise = self.noise_sd * generator.standard_normal((len(self.time), len(self.noise_sd)))

    def _tapes(self, clock: np.ndarray, generator: np.random.Generator) -> np.ndarray:
        """Multisines that peak at the actuators' limits, (step, input)."""
        actuators = [c.index for c in self.task.inputs]
        peaks = self.task.model.actuator_ctrlrange[actuators, 1]
        return np.concatenate([peaks * multisine(clock, len(peaks), BAND, generator) for _ in self.episodes])

    def _starts(self, machine: Machine, generator: np.random.Generator) -> InitialStates:
        model, count = self.task.model, len(self.episodes)
        qpos, qvel = np.repeat(model.qpos0[None], count, axis=0), np.zeros((count, model.nv))
        for joint, (low, high) in machine.start_velocity.items():
            qvel[:, model.joint(joint).dofadr[0]] = generator.uniform(low, high, count)
        return InitialStates(qpos, qvel, np.zeros((count, model.na)), np.zeros(count))

    def outputs(self, planted: Sequence[tuple[Effect, np.ndarray]] = ()) -> np.ndarray | None:
        """What sensors without noise show, (step, output), with effects at their values (parameter,); None where the
        simulation diverges.
        """
        task, hold = self.task, HELD
        named = [(f"planted-{number}", effect) for number, (effect, _) in enumerate(planted)]
        if self.elsewhere:
            hold = held_late(task, 0.5)
            task = task.with_holds([hold] * len(task.inputs))
            named.append((FINER, REGISTRY.get(FINER)(task.model, FINE)))
        point = np.concatenate([self.parameters, *(values for _, values in planted)])
        whole = self.cut(np.zeros_like(self.noise), None, hold)
        simulator = Simulator(task, named, threads=1)
        simulated = simulator.simulate(whole, self.initial, point[None], logged=True)
        return None if simulated.diverged.any() else simulated.outputs[0][whole.mask]

    def cut(self, outputs: np.ndarray, duration: float | None, hold: Hold = HELD):
        """Windows of `duration` s (episodes where None) of a log of this experiment with `outputs` (step, output)."""
        samples = Log(self.time, outputs, self.episodes, self.inputs)
        return cut(samples, duration, self.task.timestep, [hold] * len(self.task.inputs))

    def log(self, outputs: np.ndarray) -> MeasuredLog:
        """The log of `outputs` (step, output), with the noise."""
        task = self.task
        return MeasuredLog(
            task=task.name,
            time=self.time,
            inputs=self.inputs,
            outputs=outputs + self.noise,
            episode_ends=np.array([e.stop for e in self.episodes]),
            recording=np.zeros(len(self.episodes), dtype=np.int64),
            input_names=tuple(c.name for c in task.inputs),
            input_units=tuple(c.unit for c in task.inputs),
            output_names=tuple(c.name for c in task.outputs),
            output_units=tuple(c.unit for c in task.outputs),
            recordings=({"name": "planted", "source": "benchmarks planted", "sha256": None},),
        )
