"""A task of one action per episode that can be learned in seconds: drive a slider to where it is to stand."""

from __future__ import annotations

import mujoco
import numpy as np

from capture_cli.model.parameters import Parameter, ParameterSpace
from capture_cli.model.states import InitialStates
from capture_cli.model.tasks.base import ActionTask, Channel, Episodes, Feature, LogColumns

XML = """\
<mujoco>
  <option timestep="0.02" gravity="0 0 0"/>
  <worldbody>
    <body>
      <joint name="x" type="slide" axis="1 0 0"/>
      <geom name="carriage" size="0.1" mass="1"/>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="x"/></actuator>
  <sensor><jointpos name="x" joint="x"/></sensor>
</mujoco>
"""
GOAL, RADIUS = 0.5, 0.1  # m


class Reaching(ActionTask):
    """A carriage of unknown mass under a constant force for 1 s: 0.5 m is F = m, and nothing else will do."""

    name = "reaching"
    trainable = True
    entropy = 0.01

    def __init__(self, heaviest: float = 2.0):
        self.model = mujoco.MjModel.from_xml_string(XML)
        self.space = ParameterSpace([Parameter("mass", "kg", 0.5, heaviest, nominal=1.0)])
        self.actions = ParameterSpace([Parameter("force", "N", 0.0, 3.0, nominal=1.0)])
        self.inputs = (Channel("push", "N", "push", 0),)
        self.outputs = (Channel("x", "m", "x", 0, sensor=0),)
        self.log = LogColumns()
        self.features = (Feature("x", "m", 0.5),)
        self.point_times = np.array([0.5, 1.0])

    def write(self, fields, parameters):
        fields["body_mass"][:, 1] = parameters[:, 0]

    def episodes(self, actions):
        count = len(actions)
        initial = InitialStates(
            np.zeros((count, 1)), np.zeros((count, 1)), np.zeros((count, 0)), np.zeros(count)
        )
        return Episodes(initial, np.repeat(np.asarray(actions)[:, None], self.grid_steps, axis=1))

    def reward(self, actions, trajectories):
        return np.exp(-_miss(trajectories) / (2 * RADIUS))

    def success(self, actions, trajectories):
        return _miss(trajectories) <= RADIUS


def _miss(trajectories: np.ndarray) -> np.ndarray:
    return np.abs(trajectories[:, -1, 0] - GOAL)
