"""A user's own machine as a task of actions: an action is a start and a sequence of inputs, over one window."""

from collections.abc import Sequence

import mujoco
import numpy as np

from capture_cli.model.parameters import Parameter, ParameterSpace
from capture_cli.model.states import InitialStates
from capture_cli.model.tasks.base import ActionTask, Episodes, Feature, Task


class MachineTask(ActionTask):
    """A user's own `machine` as a task of actions."""

    def __init__(self, machine: Task):
        self.machine = machine
        self.name, self.path, self.effects = machine.name, machine.path, machine.effects
        self.model, self.model_path, self.space = machine.model, machine.model_path, machine.space
        self.inputs, self.outputs, self.log = machine.inputs, machine.outputs, machine.log

    def write(self, fields, parameters):
        self.machine.write(fields, parameters)


class SequenceTask(MachineTask):
    """`machine` over windows that are read at `point_times`.

    An action is (qpos (nq), qvel (nv), act (na), inputs (point * input)): the state at the start, and each input at
    each point, between which it is interpolated. The trajectory is the machine's outputs at the points.

    point_times (point,): s, the first one 0; brought onto the model's steps. library (entry, action): the actions that
    are drawn from, which span the range of `actions`. scales (output,): typical sizes of the outputs.
    """

    def __init__(self, machine: Task, point_times: np.ndarray, library: np.ndarray, scales: Sequence[float]):
        super().__init__(machine)
        self.point_times = self.on_grid(point_times)
        self.library = np.asarray(library, dtype=float)
        names, units = action_names(machine, self.point_times)
        low, high = self.library.min(axis=0), self.library.max(axis=0)
        # what never varies gets a range as well: it is then normalised to the middle of it
        still = high - low <= 1e-9 * np.maximum(np.abs(high), 1.0)
        low, high = np.where(still, low - 1, low), np.where(still, high + 1, high)
        self.actions = ParameterSpace(
            [Parameter(*p) for p in zip(names, units, low, high, (low + high) / 2, strict=True)]
        )
        self.features = tuple(
            Feature(c.name, c.unit, float(s)) for c, s in zip(machine.outputs, scales, strict=True)
        )
        grid = self.timestep * np.arange(self.grid_steps)
        before = np.searchsorted(self.point_times, grid + 1e-9, side="right") - 1
        self._before = np.clip(before, 0, len(self.point_times) - 2)
        self._part = (grid - self.point_times[self._before]) / np.diff(self.point_times)[self._before]

    def on_grid(self, times: np.ndarray) -> np.ndarray:
        """The model's steps nearest to `times`, s."""
        return self.timestep * np.rint(np.asarray(times, dtype=float) / self.timestep)

    def draw_actions(self, uniform):
        """An entry of the library each, by the first of its draws."""
        return self.library[(uniform[:, 0] * len(self.library)).astype(int)]

    def episodes(self, actions):
        """Inputs between the points are on the straight line."""
        nq, nv, na = self.model.nq, self.model.nv, self.model.na
        qpos, qvel, act, sequence = np.split(actions, np.cumsum([nq, nv, na]), axis=1)
        sequence = sequence.reshape(len(actions), len(self.point_times), len(self.inputs))
        before, after = sequence[:, self._before], sequence[:, self._before + 1]
        inputs = before + self._part[:, None] * (after - before)
        return Episodes(InitialStates(qpos, qvel, act, np.zeros(len(actions))), inputs)


def actions_of(initial: InitialStates, sequences: np.ndarray) -> np.ndarray:
    """Actions (episode, action) from initial states and the inputs at the points, sequences (episode, point, input)."""
    return np.concatenate(
        [initial.qpos, initial.qvel, initial.act, sequences.reshape(len(sequences), -1)], axis=1
    )


def resample(inputs: np.ndarray, timestep: float, point_times: np.ndarray) -> np.ndarray:
    """Sequences (episode, point, input) whose straight lines are nearest to `inputs` (episode, grid, input), L2."""
    grid = timestep * np.arange(inputs.shape[1])
    lines = np.stack([np.interp(grid, point_times, row) for row in np.eye(len(point_times))], axis=1)
    return np.einsum("pg,egi->epi", np.linalg.pinv(lines), inputs)


# of a joint's part in qpos and in qvel: what is added to its name, and the unit
_QUATERNION = tuple((f"_q{axis}", "1") for axis in "wxyz")
_TURN = tuple((f"_w{axis}", "rad/s") for axis in "xyz")
_COORDINATES = {
    mujoco.mjtJoint.mjJNT_FREE: (
        (*((f"_{axis}", "m") for axis in "xyz"), *_QUATERNION),
        (*((f"_v{axis}", "m/s") for axis in "xyz"), *_TURN),
    ),
    mujoco.mjtJoint.mjJNT_BALL: (_QUATERNION, _TURN),
    mujoco.mjtJoint.mjJNT_SLIDE: ((("", "m"),), (("_v", "m/s"),)),
    mujoco.mjtJoint.mjJNT_HINGE: ((("", "rad"),), (("_w", "rad/s"),)),
}


def action_names(machine: Task, point_times: np.ndarray) -> tuple[list[str], list[str]]:
    """Names and units of an action's components."""
    model = machine.model
    named = []
    for part in range(2):
        for number, kind in enumerate(model.jnt_type):
            joint = model.joint(number).name or f"joint{number}"
            named += [(f"start_{joint}{suffix}", unit) for suffix, unit in _COORDINATES[int(kind)][part]]
    named += [(f"start_act_{k}", "1") for k in range(model.na)]
    named += [(f"{c.name}@{t:g}s", c.unit) for t in point_times for c in machine.inputs]
    names, units = zip(*named, strict=True)
    return list(names), list(units)
