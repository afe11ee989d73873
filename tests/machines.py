"""Machines on which every effect has a site, and how to run them with effects in place."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np

from capture_cli.model import effects
from capture_cli.model.fields import ModelFields
from capture_cli.model.states import InitialStates
from capture_cli.simulate.engine import Engine, Keep

SLIDER = """
<mujoco model="slider">
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="carriage">
      <joint name="x" type="slide" axis="1 0 0" damping="2" stiffness="20" limited="true" range="-.4 .4"/>
      <geom type="box" size=".05 .05 .02" mass="1.5" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator><motor name="drive" joint="x" gear="4" ctrllimited="true" ctrlrange="-3 3"/></actuator>
  <sensor><jointpos name="x" joint="x"/><jointvel name="v" joint="x"/></sensor>
</mujoco>
"""

CART_POLE = """
<mujoco model="cart_pole">
  <option timestep="0.002" integrator="implicitfast"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <body name="cart">
      <joint name="cart" type="slide" axis="1 0 0" damping="0.5" frictionloss="0.2"/>
      <geom type="box" size=".1 .05 .05" mass="1"/>
      <body name="pole">
        <joint name="pole" type="hinge" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.5" size=".02" mass="0.3"/>
        <site name="tip" pos="0 0 -0.5"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="cart" ctrllimited="true" ctrlrange="-8 8"/></actuator>
  <sensor>
    <jointpos name="cart" joint="cart"/><jointpos name="pole" joint="pole"/>
    <e_potential name="potential"/><e_kinetic name="kinetic"/>
    <accelerometer name="tip" site="tip"/>
  </sensor>
</mujoco>
"""

ARM = """
<mujoco model="arm">
  <option timestep="0.002" integrator="implicitfast"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" type="hinge" axis="0 1 0" damping="0.2" armature="0.02"/>
      <geom type="capsule" fromto="0 0 0 .4 0 0" size=".03" mass="1.2"/>
      <body name="fore" pos=".4 0 0">
        <joint name="elbow" type="hinge" axis="0 1 0" damping="0.1" armature="0.01"/>
        <geom type="capsule" fromto="0 0 0 .3 0 .05" size=".02" mass="0.6"/>
        <site name="hand" pos=".3 0 .05"/>
      </body>
    </body>
  </worldbody>
  <tendon><fixed name="belt"><joint joint="shoulder" coef=".04"/><joint joint="elbow" coef="-.03"/></fixed></tendon>
  <actuator>
    <position name="shoulder" joint="shoulder" kp="40" kv="2" forcelimited="true" forcerange="-20 20"/>
    <position name="elbow" joint="elbow" kp="20" kv="1" forcelimited="true" forcerange="-8 8"/>
  </actuator>
  <sensor>
    <jointpos name="shoulder" joint="shoulder"/><jointpos name="elbow" joint="elbow"/>
    <framepos name="hand" objtype="site" objname="hand"/><gyro name="gyro" site="hand"/>
  </sensor>
</mujoco>
"""

DRONE = """
<mujoco model="drone">
  <option timestep="0.001" integrator="implicitfast"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="3 3 .1"/>
    <body name="frame" pos="0 0 .08">
      <joint name="across" type="slide" axis="1 0 0" damping="0.05"/>
      <joint name="up" type="slide" axis="0 0 1" damping="0.05"/>
      <joint name="pitch" type="hinge" axis="0 1 0" damping="0.001"/>
      <geom type="box" size=".15 .03 .02" mass=".35"/><geom type="box" size=".03 .03 .01" pos=".01 0 .02" mass=".05"/>
      <site name="left" pos="-.1 0 .02"/><site name="right" pos=".1 0 .02"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="left" site="left" gear="0 0 1 0 0 .02" ctrllimited="true" ctrlrange="0 3.5"/>
    <motor name="right" site="right" gear="0 0 1 0 0 -.02" ctrllimited="true" ctrlrange="0 3.5"/>
  </actuator>
  <sensor>
    <jointpos name="across" joint="across"/><jointpos name="up" joint="up"/><jointpos name="pitch" joint="pitch"/>
  </sensor>
</mujoco>
"""

PUCK = """
<mujoco model="puck">
  <option timestep="0.001" cone="elliptic"/>
  <default><geom solref="-5000 -10"/></default>
  <worldbody>
    <geom name="table" type="box" size="1 .5 .1" pos="0 0 -.1" friction=".05 .005 .0001"/>
    <geom name="wall" type="box" size=".2 .5 .1" pos=".6 0 .1" friction=".1 .005 .0001"/>
    <body name="puck" pos="0 0 .011">
      <joint name="px" type="slide" axis="1 0 0"/>
      <joint name="py" type="slide" axis="0 1 0"/>
      <joint name="pz" type="slide" axis="0 0 1"/>
      <geom name="puck" type="cylinder" size=".03 .01" mass=".1" friction="0 0 0"/>
    </body>
  </worldbody>
  <sensor><jointpos name="px" joint="px"/><jointpos name="py" joint="py"/></sensor>
</mujoco>
"""

BALL = """
<mujoco model="ball">
  <option timestep="0.002" density="1.2"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1"/>
    <body name="ball" pos="0 0 .3">
      <freejoint name="ball"/>
      <geom name="ball" type="sphere" size=".05" mass=".05"/>
    </body>
    <body name="brick" pos="0 2 .12">
      <freejoint/>
      <geom name="brick" type="box" size=".1 .05 .02" mass=".4"/>
      <geom name="corner" type="sphere" size=".04" pos=".1 .05 .02" mass=".1"/>
    </body>
  </worldbody>
  <contact><pair geom1="corner" geom2="floor" condim="3" friction=".6 .6 .005 .0001 .0001"/></contact>
  <sensor>
    <framepos name="ball" objtype="xbody" objname="ball"/>
    <framequat name="attitude" objtype="xbody" objname="ball"/>
    <framepos name="brick" objtype="xbody" objname="brick"/>
  </sensor>
</mujoco>
"""

MACHINES = {"slider": SLIDER, "cart_pole": CART_POLE, "arm": ARM, "drone": DRONE, "puck": PUCK, "ball": BALL}
NAMES = effects.REGISTRY.names()
DURATION = 0.4  # s


def build(xml: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(xml)


@cache
def machine(name: str) -> mujoco.MjModel:
    return build(MACHINES[name])


def start(model: mujoco.MjModel, count: int) -> InitialStates:
    """`count` times a motion in which every part of the machine takes part."""
    qpos, qvel = model.qpos0.copy(), np.zeros(model.nv)
    match model.names.split(b"\0")[0]:
        case b"slider":
            qvel[0] = 0.5
        case b"cart_pole":
            qpos[1] = 0.6
        case b"drone":
            qvel[:2] = 0.3, 0.5
        case b"puck":
            qvel[:2] = 1.5, 0.4
        case b"ball":
            qvel[[0, 4, 6]] = 1, 20, 0.5
            qvel[9:12] = 1, 2, 3
    many = (np.repeat(a[None], count, axis=0) for a in (qpos, qvel, np.zeros(model.na)))
    return InitialStates(*many, time=np.full(count, 0.25))


def controls(model: mujoco.MjModel, count: int) -> np.ndarray:
    """Square waves (simulation, grid, nu), of most of what the actuators take, and of less in the second half."""
    time = np.arange(round(DURATION / model.opt.timestep)) * model.opt.timestep
    size = np.where(model.actuator_ctrllimited, model.actuator_ctrlrange[:, 1], 1.0) * 0.8
    waves = size * np.sign(np.sin(2 * np.pi * (3.1 + np.arange(model.nu)) * time[:, None] + 0.5))
    waves[len(time) // 2 :] *= 0.9
    return np.repeat(waves[None], count, axis=0)


def run(model: mujoco.MjModel, *effect_values, count: int = 1, initial=None, tape=None):
    """Sensors (simulation, grid, sensordata) and diverged (simulation,) with (effect, values) pairs in place."""
    step, fields, forces = model.opt.timestep, ModelFields(model, count), []
    tape = controls(model, count) if tape is None else tape
    initial = initial or start(model, count)
    for effect, values in sorted(effect_values, key=lambda pair: pair[0].reads_acceleration):
        effect.write(fields, values)
        tape = effect.drive(tape, values, step, elapsed=initial.time)
        forces += [f for f in [effect.force(values, step)] if f]  # substeps belong to effects without a force
    rollouts = Engine(model, 1).rollout(
        initial=initial,
        controls=tape,
        fields=fields,
        forces=forces,
        keep=Keep(actuator_forces=True),
    )
    sensors = rollouts.sensors
    for effect, values in effect_values:
        sensors = effect.pick_up(sensors, values, rollouts.actuator_force)
    for effect, values in effect_values:
        sensors = effect.measure(sensors, values, step)
    return sensors, rollouts.diverged


@cache
def plain(name: str) -> np.ndarray:
    return run(machine(name))[0]


@cache
def placed(name: str) -> list[tuple[str, effects.Effect]]:
    """(machine, effect) for every site of the effect on every machine."""
    effect = effects.REGISTRY.get(name)
    return [(m, effect(machine(m), site)) for m in MACHINES for site in effect.sites(machine(m))]


def is_shape(effect) -> np.ndarray:
    return np.array([p.name in effect.shapes for p in effect.parameters])


def away(effect, part: float) -> np.ndarray:
    """Amplitudes at `part` of the way from null to the farther bound, shapes at their nominal values."""
    space = effect.space
    farther = np.where(space.high - space.nominal >= space.nominal - space.low, space.high, space.low)
    return np.where(is_shape(effect), space.nominal, space.nominal + part * (farther - space.nominal))
