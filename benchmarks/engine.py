"""Steps per second of the batch engine over bare MuJoCo in C, of the same model, in the same run.

Both make the same simulations (initial states, controls, steps) on one thread. The engine does what a fit needs
besides: parameters of their own in every simulation, sensors recorded at every step. The bare loop is the faster of
`mj_step(model, data, nstep)` and `mujoco.rollout`. Repeats are interleaved, ratios are medians over repeats, and time
is that of the CPU, so that other work on the machine matters less.
"""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco import rollout

from benchmarks import EMPS, MACHINES
from benchmarks._speeds import interleaved
from benchmarks.base import Benchmark, Figure, Result
from capture_cli.estimate.initial_states.from_outputs import model_initial_states
from capture_cli.model.fields import ModelFields
from capture_cli.model.tasks import load_task
from capture_cli.model.tasks.base import Task
from capture_cli.model.world import World
from capture_cli.simulate.engine import Engine

SIMULATIONS, STEPS, REPEATS = 256, 500, 9
SPREAD = 0.05  # of the nominal values: simulations must differ, and cost the same
PUSH = 3.0  # of the control, where the model sets no range
TARGET = 0.85


class EngineSpeed(Benchmark):
    summary = "the batch engine over bare mj_step in C, one thread"

    def run(self) -> Result:
        result = Result()
        for folder in [*sorted(MACHINES.iterdir()), EMPS]:
            runs = _Runs(load_task(str(folder)))
            kinds = {"mj_step": runs.mj_step, "rollout": runs.rollout, "engine": runs.engine}
            kinds["engine with a force"] = lambda runs=runs: runs.engine(drag)
            speeds = interleaved(kinds, REPEATS)
            bare = np.maximum(speeds["mj_step"], speeds["rollout"])
            ratio = {k: float(np.median(speeds[k] / bare)) for k in ("engine", "engine with a force")}
            name = folder.name
            result.figures += [
                Figure(f"engine / bare mj_step, {name}", ratio["engine"], target=(TARGET, None)),
                Figure(f"  with a numpy force at every step, {name}", ratio["engine with a force"]),
                Figure(f"  engine, {name}", float(np.median(speeds["engine"])), "steps/s"),
            ]
            result.details[name] = {
                "steps_per_second": {k: v.tolist() for k, v in speeds.items()},
                "ratio": ratio,
            }
        result.details["workload"] = {"simulations": SIMULATIONS, "steps": STEPS, "repeats": REPEATS}
        return result


def drag(world: World) -> None:
    """A force that depends on the state: quadratic drag on every degree of freedom."""
    world.qfrc_applied[...] -= 0.01 * world.qvel * np.abs(world.qvel)


class _Runs:
    """The same simulations by each way of stepping; every method makes all of them and returns the steps."""

    def __init__(self, task: Task):
        self.task, self.model = task, task.model
        generator = np.random.default_rng(0)
        self.initial = model_initial_states(task.model, SIMULATIONS).states
        push = generator.uniform(-1, 1, (SIMULATIONS, task.model.nu))
        push *= np.where(task.model.actuator_ctrllimited, task.model.actuator_ctrlrange[:, 1], PUSH)
        self.controls = np.repeat(push[:, None], STEPS, axis=1)
        spread = generator.uniform(-SPREAD, SPREAD, (SIMULATIONS, len(task.space)))
        self.parameters = task.space.nominal + spread * task.space.nominal
        self.stepper = Engine(task.model, threads=1)
        self.data = mujoco.MjData(task.model)
        mujoco.mj_resetData(task.model, self.data)
        size = mujoco.mj_stateSize(task.model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        state = np.zeros(size)
        mujoco.mj_getState(task.model, self.data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        self.states = np.repeat(state[None], SIMULATIONS, axis=0)

    def engine(self, *forces) -> int:
        fields = ModelFields(self.model, SIMULATIONS)
        self.task.write(fields, self.parameters)
        self.stepper.rollout(initial=self.initial, controls=self.controls, fields=fields, forces=forces)
        return SIMULATIONS * STEPS

    def mj_step(self) -> int:
        for push in self.controls[:, 0]:
            mujoco.mj_resetData(self.model, self.data)
            self.data.ctrl[:] = push
            mujoco.mj_step(self.model, self.data, nstep=STEPS)
        return SIMULATIONS * STEPS

    def rollout(self) -> int:
        controls = self.controls if self.model.nu else None
        rollout.rollout(self.model, self.data, self.states, controls, nstep=STEPS)
        return SIMULATIONS * STEPS
