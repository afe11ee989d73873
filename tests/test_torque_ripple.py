"""A motor constant that depends on the rotor's angle: all of the actuator's force has it, and cogging is another."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from machines import ARM, build, machine, run

from capture_cli.model.effects import REGISTRY
from capture_cli.model.states import InitialStates

TURNING = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody><body>
    <joint name="rotor" type="hinge" axis="0 1 0" damping="0.02" armature="0.01"/>
    <geom type="box" size=".1 .02 .02" pos=".05 0 0" mass="0.5"/>
  </body></worldbody>
  <actuator>{}<motor name="other" joint="rotor"/></actuator>
  <sensor>
    <jointpos joint="rotor"/><jointvel joint="rotor"/><actuatorfrc actuator="drive"/><actuatorfrc actuator="other"/>
  </sensor>
</mujoco>
"""
STEPS = 1000


@pytest.mark.parametrize(
    "drive",
    [
        '<motor name="drive" joint="rotor" gear="-0.3"/>',
        '<motor name="drive" jointinparent="rotor" forcelimited="true" forcerange="-0.5 0.3"/>',
        '<position name="drive" joint="rotor" kp="2" kv="0.3" gear="-0.5" forcelimited="true" forcerange="-2 2"/>',
        '<velocity name="drive" joint="rotor" kv="0.4"/>',
        '<damper name="drive" joint="rotor" kv="0.02" ctrlrange="0 9"/>',
        '<pid name="drive" joint="rotor" kp="2" kv="0.3" ki="3" imax="0.1"/>',
    ],
)
def test_the_force_in_each_step_is_the_models_times_the_ripple_there(drive):
    model = build(TURNING.format(drive))
    effect = REGISTRY.get("torque-ripple")(model, "drive")
    time = model.opt.timestep * np.arange(STEPS)
    tape = np.zeros((1, STEPS, model.nu))
    tape[..., 0] = 4 + 4 * np.sin(3 * time)
    if model.nu > 2:  # of a pid, the target speed
        tape[..., 1] = 12 * np.cos(3 * time)
    tape[..., -1] = 0.4
    begin = InitialStates(np.zeros((1, 1)), np.full((1, 1), 12.0), np.zeros((1, model.na)), np.zeros(1))
    sensors, _ = run(model, (effect, np.array([[0.3, -0.2, 1.1]])), tape=tape, initial=begin)
    turned, speed, given, other = sensors[0].T
    assert np.ptp(turned) > 2 * np.pi
    assert np.array_equal(other, tape[0, :, -1])

    data, expected = mujoco.MjData(model), []
    for ctrl, q, rate in zip(tape[0], turned, speed, strict=True):
        data.qpos[:], data.qvel[:], data.ctrl[:] = q, rate, ctrl
        mujoco.mj_step(model, data)  # what a pid integrates depends on position and control alone
        expected.append(data.sensordata[2])
    phase = 2 * np.pi * turned / 1.1
    ripple = 1 + 0.3 * np.sin(phase) - 0.2 * np.cos(phase)
    np.testing.assert_allclose(given, ripple * expected, rtol=1e-12, atol=1e-12)
    assert np.abs(given - expected).max() > 0.05


def test_a_servo_with_ripple_is_the_servo_with_other_gains_while_its_joint_stands():
    """All that it does is scaled, its damping in the implicit integration too, which a force beside it would not be."""
    weak = 1 - 0.3
    scaled = 'kp="{}" kv="{}" forcelimited="true" forcerange="-{limit} {limit}"'
    other = ARM.replace(scaled.format(40, 2, limit=20), scaled.format(40 * weak, 2 * weak, limit=20 * weak))
    assert other != ARM
    effect = REGISTRY.get("torque-ripple")(machine("arm"), "shoulder")
    found, _ = run(
        machine("arm"), (effect, np.array([[0.0, -0.3, 1e9]]))
    )  # a period that nobody turns through
    np.testing.assert_allclose(found, run(build(other))[0], rtol=0, atol=1e-12)


def test_it_sits_at_motors_and_servos_of_joints():
    model = build("""
        <mujoco><worldbody><body><joint name="a" range="-1 1" limited="true"/><geom size=".1"/><site name="s"/>
          <body><joint name="ball" type="ball"/><geom size=".1"/></body></body></worldbody>
        <tendon><fixed name="cable"><joint joint="a" coef="1"/></fixed></tendon>
        <actuator>
          <motor joint="a"/><position name="servo" joint="a" kp="3"/><motor tendon="cable"/><motor joint="ball"/>
          <motor site="s"/><dcmotor joint="a" motorconst=".1" resistance="1"/>
        </actuator></mujoco>""")
    assert REGISTRY.get("torque-ripple").sites(model) == ["#0", "servo"]
