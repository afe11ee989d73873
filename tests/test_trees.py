"""Kinematic trees of a model: inertias, and dry friction, of one are nothing to another."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from capture_cli.estimate.balance.dry_friction import dry_friction
from capture_cli.estimate.balance.resting import mass_matrix
from capture_cli.estimate.balance.trees import in_whole_trees, inverse_of, made_heavier, solved, trees

LIMB = """<body pos="{at} 0 0"><joint name="a{at}" axis="0 1 0" frictionloss="0.3"/>
<geom size=".03" pos="0 0 -.2" mass=".2"/><body pos="0 0 -.3"><joint name="b{at}" axis="0 1 0" frictionloss="0.1"/>
<geom size=".03" pos="0 0 -.1" mass=".1"/></body></body>"""
PENDULUM = """<body pos="9 0 0"><joint axis="0 1 0" frictionloss="0.2"/>
<geom size=".03" pos="0 0 -.2" mass=".2"/></body>"""


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    """Two limbs of two joints, and a pendulum between them."""
    limbs = LIMB.format(at=0) + PENDULUM + LIMB.format(at=4)
    return mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{limbs}</worldbody></mujoco>")


@pytest.fixture(scope="module")
def inertia(model) -> np.ndarray:
    """M (point, nv, nv) in 40 poses."""
    data, generator, found = mujoco.MjData(model), np.random.default_rng(0), []
    for _ in range(40):
        data.qpos[:] = generator.normal(size=model.nq)
        mujoco.mj_forward(model, data)
        found.append(data.M.copy())
    return mass_matrix(model, np.array(found))


def test_coordinates_of_a_tree_follow_each_other(model):
    assert trees(model) == [slice(0, 2), slice(2, 3), slice(3, 5)]


def test_matrices_fall_into_blocks(model, inertia):
    vectors = np.random.default_rng(1).normal(size=inertia.shape[:2])
    np.testing.assert_allclose(inverse_of(model, inertia), np.linalg.inv(inertia), rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(
        solved(model, inertia, vectors), np.linalg.solve(inertia, vectors[..., None])[..., 0], rtol=1e-10
    )
    which = np.array([[False, True, False, False, False], [False, False, False, False, False]])
    np.testing.assert_array_equal(
        in_whole_trees(model, which), [[True, True, False, False, False], [False] * 5]
    )


def test_an_inverse_follows_larger_inertias(inertia):
    heavier = np.random.default_rng(3).uniform(-0.002, 0.1, size=inertia.shape[:2]) * [1, 0, 1, 1, 0]
    larger = inertia + heavier[..., None] * np.eye(inertia.shape[-1])
    np.testing.assert_allclose(
        made_heavier(np.linalg.inv(inertia), heavier), np.linalg.inv(larger), rtol=1e-9
    )


def test_friction_of_one_tree_is_nothing_to_another(model, inertia):
    generator = np.random.default_rng(2)
    inverse = np.linalg.inv(inertia)
    applied, velocity = generator.normal(size=(2, *inertia.shape[:2])) * [[[0.5]], [[0.02]]]
    loss, sd = np.repeat(model.dof_frictionloss[None], len(applied), axis=0), np.full(model.nv, 0.01)
    whole = dry_friction(model, inverse, applied, velocity, sd, loss)
    held = np.abs(whole) < 0.999 * loss
    assert 0.1 < held.mean() < 0.9
    # to the last bit, whatever the others do
    asked = np.zeros(loss.shape, dtype=bool)
    asked[:20, 3:] = True
    other = np.where(asked, applied, 7.0)
    some = dry_friction(model, inverse, other, velocity, sd, np.where(asked, loss, 0.0))
    np.testing.assert_array_equal(some, np.where(asked, whole, 0.0))
