"""Effects along tendons: where they sit, how far their ranges reach, and what they do there."""

from __future__ import annotations

import numpy as np
import pytest
from machines import build, run

from capture_cli.errors import OptionError
from capture_cli.model import effects
from capture_cli.model.effects.base import JointMotion, SeenLog
from capture_cli.model.fields import ModelFields
from capture_cli.stages.effect_option import parse_effects

PENDULUM = """
<mujoco model="pendulum">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <site name="anchor" pos="0 0 .1"/>
    <geom name="peg" type="sphere" size=".01" pos=".1 0 -.1" group="1"/>
    <body>
      <joint name="hinge" type="hinge" axis="0 1 0" damping=".01" {range}/>
      <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".01" mass=".5"/>
      <site name="tip" pos="0 0 -.25"/>
    </body>
  </worldbody>
  <tendon><spatial name="band" {band}><site site="anchor"/>{turn}<site site="tip"/></spatial></tendon>
  <actuator><motor name="m" joint="hinge" ctrllimited="true" ctrlrange="-1 1"/></actuator>
  <sensor><jointpos name="hinge" joint="hinge"/></sensor>
</mujoco>
"""


def pendulum(turn: str = "", band: str = "", limits: str = 'limited="true" range="-1 1"'):
    return build(PENDULUM.format(turn=turn, band=band, range=limits))


def look_in(effect, low: float, high: float) -> None:
    seen = {0: JointMotion(low, high, 2.0)}
    effect.look_in(SeenLog(window=0.5, longest=5.0, logged=frozenset({0}), seen=seen))


def test_a_band_at_dead_centre_has_levers_where_the_joint_goes():
    """By the law of cosines, with 0.1 m to the anchor and 0.25 m to the tip; at qpos0 its lever is 0."""
    spring = effects.REGISTRY.get("tendon-spring")(pendulum(), "band")
    ends = np.sqrt(0.1**2 + 0.25**2 + 2 * 0.1 * 0.25 * np.cos([1.0, 0.0]))
    np.testing.assert_allclose([spring.shortest, spring.longest], ends, atol=2e-3)
    assert spring.levers[0] == pytest.approx(0.1 * 0.25 * np.sin(1.0) / ends[0], rel=0.02)
    look_in(spring, 0.2, 0.4)
    ends = np.sqrt(0.1**2 + 0.25**2 + 2 * 0.1 * 0.25 * np.cos([0.4, 0.2]))
    np.testing.assert_allclose([spring.shortest, 0.35], [ends[0], 0.35], atol=1e-3)
    low, high = (spring.space.low[1], spring.space.high[1])
    assert low < ends[0] and high > ends[1]


def test_a_spring_takes_no_play_from_a_length_that_no_spring_had():
    with_play, without = (
        pendulum(band='springlength=".2 .3"'),
        pendulum(band='stiffness="60" springlength=".25"'),
    )
    spring = effects.REGISTRY.get("tendon-spring")(with_play, "band")
    sensors, _ = run(with_play, (spring, np.array([[60.0, 0.25]])))
    expected, _ = run(without)
    np.testing.assert_allclose(sensors, expected, atol=1e-12)
    assert (
        effects.REGISTRY.get("tendon-spring").sites(pendulum(band='stiffness="1" springlength=".2 .3"')) == []
    )


def test_inertia_is_not_offered_where_mujoco_has_none():
    inertia = effects.REGISTRY.get("tendon-inertia")
    assert inertia.sites(pendulum()) == ["band"]
    assert inertia.sites(pendulum(turn='<geom geom="peg"/>')) == []
    carts = build("""<mujoco><worldbody>
        <body><joint name="x" type="slide" axis="1 0 0"/><geom size=".1" mass="1"/></body>
        <body pos="0 1 0"><joint name="y" type="slide" axis="1 0 0"/><geom size=".1" mass="1"/></body></worldbody>
        <tendon><fixed name="rope"><joint joint="x" coef="1"/><joint joint="y" coef="1"/></fixed></tendon></mujoco>""")
    assert inertia.sites(carts) == [], "MuJoCo leaves out what couples one branch to another"
    assert effects.REGISTRY.get("tendon-damping").sites(carts) == ["rope"]


def test_a_tendon_that_a_loose_body_moves_is_no_site():
    loose = build("""<mujoco><worldbody><site name="a" pos="0 0 1"/>
        <body><freejoint/><geom size=".1" mass="1"/><site name="b"/></body></worldbody>
        <tendon><spatial name="leash"><site site="a"/><site site="b"/></spatial></tendon></mujoco>""")
    assert effects.REGISTRY.get("tendon-friction").sites(loose) == []
    with pytest.raises(OptionError) as caught:
        parse_effects(["tendon-friction@leash=1"], loose)
    assert "every tendon that hinge and slide joints move" in str(caught.value)


def test_what_is_written_is_added_to_the_models_own():
    model = pendulum(band='damping="3" frictionloss=".5" armature=".1"')
    for name, field, own in (
        ("damping", "damping", 3.0),
        ("friction", "frictionloss", 0.5),
        ("inertia", "armature", 0.1),
    ):
        effect, fields = effects.REGISTRY.get(f"tendon-{name}")(model, "band"), ModelFields(model, 2)
        assert effect.space.low[0] == pytest.approx(-own), "no less than nothing is left"
        effect.write(fields, np.array([[0.0], [0.25]]))
        np.testing.assert_allclose(fields[f"tendon_{field}"][:, 0], [own, own + 0.25])
