"""Which geoms can touch, against the contacts that MuJoCo makes where all of them overlap."""

from __future__ import annotations

import mujoco
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_cli.model.contacts import can_touch, touching_pairs


@st.composite
def trees(draw) -> mujoco.MjModel:
    """Bodies on bodies, some of them welded or driven by hand, with overlapping spheres of any collision bits."""
    spec = mujoco.MjSpec()
    bodies = [spec.worldbody]
    bits = st.integers(0, 3)
    for number in range(draw(st.integers(1, 6))):
        parent = draw(st.sampled_from(bodies))
        body = parent.add_body(name=f"b{number}", mocap=parent is spec.worldbody and draw(st.booleans()))
        if not body.mocap and draw(st.booleans()):
            body.add_joint(axis=[0, 1, 0])
        bodies.append(body)
    for body in bodies:
        for _ in range(draw(st.integers(0, 2)) or (body is not spec.worldbody and not body.geoms)):
            own = {"contype": draw(bits), "conaffinity": draw(bits)}
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[1, 0, 0], pos=[0.01 * len(spec.geoms), 0, 0], **own
            )
    named = [b.name for b in bodies[1:]]
    if len(named) > 1 and draw(st.booleans()):
        one, other = draw(st.lists(st.sampled_from(named), min_size=2, max_size=2, unique=True))
        spec.add_exclude(bodyname1=one, bodyname2=other)
    if draw(st.booleans()):
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    return spec.compile()


@settings(max_examples=200, deadline=None)
@given(trees())
def test_they_are_those_that_mujoco_lets_touch(model):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    touching = {tuple(sorted(map(int, pair))) for pair in data.contact.geom[: data.ncon]}
    assert touching == {tuple(map(int, pair)) for pair in touching_pairs(model)}
    assert can_touch(model) == bool(touching)


def test_an_explicit_pair_can_touch_whatever_the_bits_say():
    model = mujoco.MjModel.from_xml_string("""<mujoco><worldbody><geom name="a" size="1" contype="0" conaffinity="0"/>
      <body><freejoint/><geom name="b" size="1" contype="0" conaffinity="0"/></body></worldbody>
      <contact><pair geom1="a" geom2="b"/></contact></mujoco>""")
    assert can_touch(model) and not np.size(touching_pairs(model))
