"""Options of `capture train-policy`."""

from dataclasses import dataclass
from math import inf

from capture_cli.options.base import option
from capture_cli.options.completion import tasks
from capture_cli.options.shared import AddedEffects, AddedEstimate, CheckpointOut, Device, Simulating


@dataclass(frozen=True, kw_only=True)
class TrainPolicyOptions(Simulating):
    """effects, estimate: what the simulated machine has that the task's model lacks; of a range, every episode draws,
    and the policy does not know what. threads: of the simulator; the learner has one.
    """

    task: str = option(..., "Built-in task with a reward, or a task.toml with one.", offers=tasks)
    out: CheckpointOut
    policy: str = option("sac", "What to train: sac.", offers=("sac",))
    effects: AddedEffects = ()
    estimate: AddedEstimate = None
    steps: int = option(150_000, "Episodes.", min=1)
    envs: int = option(64, "Episodes simulated at once.", min=1)
    updates: int = option(16, "Gradient steps after each of these.", min=1)
    batch: int = option(256, "Episodes per gradient step.", min=1)
    learning_rate: float = option(
        1e-3, "Learning rate at the start; it falls linearly to 0.", name="--lr", within=(0, inf)
    )
    entropy: float | None = option(None, "Weight of the entropy; the task's own by default.", min=0)
    width: int = option(64, "Width of the networks.", min=1)
    layers: int = option(2, "Hidden layers of the networks.", min=1)
    evaluations: int = option(30, "Points of the evaluation curve; what --resume goes on from.", min=1)
    device: Device = "cpu"
    resume: bool = option(False, "Go on with a training that ended early.")
