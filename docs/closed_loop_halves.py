"""What policy and identifier each gain in the closed loop: `python -m docs.closed_loop_halves FOLDER`.

FOLDER is what closed_loop.sh made at full size. Either policy plays, for what either identifier found in the end, the
machines on which they were judged. FOLDER/halves.json has the successes, pair by pair; a world plays alike every time,
so that of policy and identifier of one kind they are those of its evaluation.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from capture_cli.context.checkpoints.policy_checkpoint import load_policy
from capture_cli.context.evaluation.sim2sim import Sim2Sim
from capture_cli.context.worlds.world import World
from capture_cli.model.tasks import load_task
from capture_cli.model.tasks.base import ActionTask
from capture_cli.store.evaluation import Evaluation
from capture_cli.store.provenance import code_hash, write_json

KINDS = "declared", "mended"


def main(folder: Path) -> None:
    """Write halves.json: {"success": {policy: {identifier: [of each pair]}}}, with rounds and the code."""
    found = {kind: Evaluation.read(folder / kind / "evaluation") for kind in KINDS}
    about = found[KINDS[0]].document
    task = load_task(about["task"])
    world = World(task, about["robot"])
    success = {
        policy: {
            identifier: _successes(task, world, folder / policy / "policy", found[identifier])
            for identifier in KINDS
        }
        for policy in KINDS
    }
    document = {"rounds": about["rounds"], "robot": about["robot"], "success": success, "code": code_hash()}
    write_json(folder / "halves.json", document)


def _successes(task: ActionTask, world: World, folder: Path, found: Evaluation) -> list[bool]:
    """Of the policy in `folder`, one action for the last estimate of each pair, as the evaluation draws it."""
    _, seeds, pairs, entries, _ = found.arrays["estimates"].shape
    assert seeds == 1
    policy = load_policy(str(folder), task)
    draw = Sim2Sim(task, policy, pairs, entries - 1)
    target = found.arrays["target"][0]
    np.testing.assert_array_equal(draw.ends()[1], target)  # of the seed that it was made with
    actions = policy.act(found.arrays["estimates"][0, 0, :, -1], draw._uniform()[:, -1])
    measured, diverged = world.trajectories(target, actions)
    return (task.success(actions, measured) & ~diverged).tolist()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
