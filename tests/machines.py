"""Small machines that tests share: between them they have every kind of place where an effect can sit."""

from __future__ import annotations

SLIDER = """
<mujoco model="slider">
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="carriage">
      <joint name="x" type="slide" axis="1 0 0" damping="2" stiffness="20" limited="true" range="-0.4 0.4"/>
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
  <worldbody>
    <body name="cart">
      <joint name="cart" type="slide" axis="1 0 0" damping="0.5" frictionloss="0.2"/>
      <geom type="box" size=".1 .05 .05" mass="1" contype="0" conaffinity="0"/>
      <body name="pole">
        <joint name="pole" type="hinge" axis="0 1 0" damping="0.01"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.5" size=".02" mass="0.3" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="cart" gear="1" ctrllimited="true" ctrlrange="-8 8"/></actuator>
  <sensor><jointpos name="cart" joint="cart"/><jointpos name="pole" joint="pole"/></sensor>
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
        <geom type="capsule" fromto="0 0 0 .3 0 0.05" size=".02" mass="0.6"/>
        <site name="hand" pos=".3 0 0.05"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="shoulder" joint="shoulder" kp="40" kv="2" forcelimited="true" forcerange="-20 20"/>
    <position name="elbow" joint="elbow" kp="20" kv="1" forcelimited="true" forcerange="-8 8"/>
  </actuator>
  <sensor>
    <jointpos name="shoulder" joint="shoulder"/>
    <jointpos name="elbow" joint="elbow"/>
    <framepos name="hand" objtype="site" objname="hand"/>
    <gyro name="gyro" site="hand"/>
    <accelerometer name="imu" site="hand"/>
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
      <joint name="turn" type="hinge" axis="0 0 1"/>
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
    <body name="ball" pos="0 0 .5" simple="false">
      <freejoint name="ball"/>
      <geom name="ball" type="sphere" size=".05" mass=".05"/>
    </body>
    <body name="brick" pos="0 2 .3">
      <freejoint/>
      <geom name="brick" type="box" size=".1 .05 .02" mass=".4"/>
      <geom name="corner" type="sphere" size=".02" pos=".1 .05 .02" mass=".1"/>
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

MACHINES = {"slider": SLIDER, "cart_pole": CART_POLE, "arm": ARM, "puck": PUCK, "ball": BALL}
