"""What actuators give under other controls, or with other numbers, against MuJoCo's own."""

import mujoco
import numpy as np
from mujoco import batch

from capture_cli.estimate.balance.actuation import Actuation

XML = """
<mujoco>
  <worldbody>
    <body>
      <joint name="a" axis="0 1 0" actuatorfrcrange="-3 3"/><geom size="0.1"/>
      <body pos="0.3 0 0">
        <joint name="b" axis="0 1 0"/><geom size="0.1"/>
      </body>
    </body>
  </worldbody>
  <tendon><fixed name="both"><joint joint="a" coef="1"/><joint joint="b" coef="-0.5"/></fixed></tendon>
  <actuator>
    <motor joint="a" gear="3" ctrlrange="-1 1"/>
    <position joint="b" kp="20" kv="2" forcerange="-4 4"/>
    <general tendon="both" gainprm="2 0.5 -0.3" gaintype="affine" biastype="affine" biasprm="0.1 -1 -0.2"/>
    {}
  </actuator>
</mujoco>
"""
POINTS = 40


def simulations(model):
    generator, runner = np.random.default_rng(0), batch.Batch(model, POINTS, 1)
    for name in ("qpos", "qvel", "ctrl"):
        field = runner.bind(name)
        field[...] = generator.standard_normal(field.shape)
    return runner


def driven(runner, model):
    """What joints get (point, nv), worked out by MuJoCo."""
    found = runner.bind("qfrc_actuator")
    runner.forward()
    return found.copy()


def test_other_controls_and_numbers_drive_joints_as_they_do_in_mujoco():
    model = mujoco.MjModel.from_xml_string(XML.format(""))
    runner = simulations(model)
    actuation = Actuation.of(model, runner, runner.forward)
    before, controls = driven(runner, model), runner.bind("ctrl").copy()
    generator = np.random.default_rng(1)
    more = controls + 2 * generator.standard_normal(controls.shape)
    runner.bind("ctrl")[...] = more
    np.testing.assert_allclose(
        actuation.changed(actuation.given(more)), driven(runner, model) - before, atol=1e-12
    )
    runner.bind("ctrl")[...] = controls
    limited, ranges, bias = (
        runner.expand(f"actuator_{n}") for n in ("forcelimited", "forcerange", "biasprm")
    )
    limited[...], ranges[...] = 1, np.array([-0.7, 0.4])
    bias[:, 1, 0] += 3.0
    numbers = {"actuator_forcelimited": limited, "actuator_forcerange": ranges, "actuator_biasprm": bias}
    assert actuation.follows(numbers)
    here = np.arange(POINTS)[::-1]
    found = actuation.changed(actuation.given(controls[here], numbers, here), here)
    np.testing.assert_allclose(found[::-1], driven(runner, model) - before, atol=1e-12)


def test_an_actuator_with_an_activation_is_left_to_mujoco():
    model = mujoco.MjModel.from_xml_string(XML.format('<general joint="b" dyntype="integrator"/>'))
    runner = simulations(model)
    assert Actuation.of(model, runner, runner.forward) is None
