"""A world as a machine: the robosuite scene of a task, in which a robot plays actions as a log or a round has them.

robosuite is imported where a world is made.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from capture_cli.common.extras import require
from capture_cli.common.frozen import frozen
from capture_cli.context.worlds._grip import Unreachable
from capture_cli.errors import OptionError, did_you_mean
from capture_cli.model.tasks.base import ActionTask, Task

if TYPE_CHECKING:
    from capture_cli.context.worlds._scene import Played, Scene

PLANT, ROBOSUITE = ("plant", "robosuite")


@frozen
class SETTINGS:
    robot: str = "Panda"
    rate: float = 100.0  # Hz, of the arm's commands and of what is logged
    behind: float = 0.9  # of the way a tool is sent: of one that stays 1, of a Panda's 0.7 in short strokes
    seed: int = 0  # without one robosuite draws other places in every process
    horizon: float = 2.0  # of an episode: robosuite counts its control steps


def check_world(world: str, robot: str | None) -> None:
    """Raise OptionError where the world needs what is not installed, or it has no robot to choose."""
    if world == ROBOSUITE:
        require("robosuite", "--world robosuite")
    elif robot is not None:
        raise OptionError(
            f"--robot {robot} without --world robosuite", cure="add --world robosuite, or leave it out"
        )


@dataclass(frozen=True)
class World:
    """The scene of `task` with `robot`, which is commanded and logged at `rate`, Hz.

    What it plays does not depend on what it played before. Raises OptionError where there is no such scene or robot.
    """

    task: Task
    robot: str = SETTINGS.robot
    rate: float = SETTINGS.rate
    scene: Scene = field(init=False, repr=False, compare=False)

    def __post_init__(self):
        module = f"capture_cli.context.worlds.{self.task.name.replace('-', '_')}"
        if not isinstance(self.task, ActionTask) or find_spec(module) is None:
            raise OptionError(f"there is no robosuite scene of {self.task.name!r}", cure="take --world plant")
        scene = importlib.import_module(module).MACHINE
        _check_robot(self.robot)
        horizon = round(SETTINGS.horizon * self.rate * self.task.point_times[-1])
        options = {"control_freq": self.rate, "horizon": horizon, "hard_reset": False}
        with self._able():  # it takes the tool, in a place that is drawn
            made = scene(robots=self.robot, seed=SETTINGS.seed, **options)
        object.__setattr__(self, "scene", made)

    def play(self, parameters: np.ndarray, actions: np.ndarray) -> list[Played]:
        """What a log of each action would hold, without noise; parameters (parameter,), actions (episode, action)."""
        return [self.scene.play(parameters, action) for action in actions]

    def trajectories(self, parameters: np.ndarray, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As of a Simulator: trajectories (episode, point, feature) and diverged (episode,), one episode per row."""
        points = np.rint(self.task.point_times * self.rate).astype(int)
        played = [self.scene.play(*both) for both in zip(parameters, actions, strict=True)]
        outputs = np.array([p.outputs[points] for p in played])
        return self.task.observe(outputs), np.array([p.diverged for p in played])

    def try_out(self) -> None:
        """Raise OptionError where the robot cannot do what actions ask of it: one in the middle of their range, and
        both of its corners.
        """
        space = self.task.actions
        for action in (space.nominal, space.low, space.high):
            with self._able():
                (played,) = self.play(self.task.space.nominal, action[None])
            if played.diverged:
                raise self._unfit("the simulation of the robot and its controller diverges")
            if played.behind > SETTINGS.behind:
                raise self._unfit(
                    f"its controller leaves the {self.scene.tool} behind by {played.behind:.0%} of the way it is sent"
                )

    @contextmanager
    def _able(self) -> Iterator[None]:
        """Says of which robot something is out of reach."""
        try:
            yield
        except Unreachable as error:
            raise self._unfit(error.message) from error

    def _unfit(self, found: str) -> OptionError:
        other = "take another robot" + f", as {SETTINGS.robot}" * (self.robot != SETTINGS.robot)
        return OptionError(f"--robot {self.robot}, {self.task.name}: {found}", cure=other)


def _check_robot(robot: str) -> None:
    from robosuite.robots import ROBOT_CLASS_MAPPING, FixedBaseRobot

    known: Sequence[str] = [n for n, kind in ROBOT_CLASS_MAPPING.items() if kind is FixedBaseRobot]
    if robot not in known:
        other = " stands on no table" if robot in ROBOT_CLASS_MAPPING else ""
        raise OptionError(
            f"--robot {robot!r}{other or ' is none of robosuite'}", cure=did_you_mean(robot, known)
        )
