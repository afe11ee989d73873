"""Dry friction of the force balance: what MuJoCo's solver gives."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from capture_cli.estimate.balance.dry_friction import dry_friction

ARM = """<mujoco><option timestep="0.002" tolerance="0" iterations="200"/><worldbody>
<body><joint name="a" axis="0 1 0" frictionloss="0.3" {of_a}/><geom size=".03" pos="0 0 -.2" mass=".2"/>
<body pos="0 0 -.3"><joint name="b" axis="0 1 0" frictionloss="0.1"/><geom size=".03" pos="0 0 -.1" mass=".1"/></body>
</body></worldbody><actuator><motor joint="a"/><motor joint="b"/></actuator></mujoco>"""
SOLVER = ["", 'solreffriction="0.01 1" solimpfriction="0.99 0.995 0.001"', 'solreffriction="-500 -30"']


def states(model: mujoco.MjModel, count: int = 100):
    """Inverse inertia, forces beside friction, velocities and friction of states, some of which it holds."""
    data, generator = mujoco.MjData(model), np.random.default_rng(0)
    dense, found = np.zeros((model.nv, model.nv)), []
    for _ in range(count):
        data.qpos[:] = generator.normal(size=model.nv)
        data.qvel[:] = generator.normal(size=model.nv) * generator.choice([0.01, 0.1, 1.0, 10.0], model.nv)
        data.ctrl[:] = generator.normal(size=model.nu) * 0.3
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, dense)
        found.append(
            (np.linalg.inv(dense), data.qfrc_smooth.copy(), data.qvel.copy(), data.qfrc_constraint.copy())
        )
    return (np.array(own) for own in zip(*found, strict=True))


@pytest.mark.parametrize("of_a", SOLVER)
def test_it_is_what_the_solver_gives(of_a):
    model = mujoco.MjModel.from_xml_string(ARM.format(of_a=of_a))
    inverse, applied, velocity, expected = states(model)
    loss = np.repeat(model.dof_frictionloss[None], len(applied), axis=0)
    held = np.abs(expected) < 0.999 * loss
    assert 0.1 < held.mean() < 0.5
    found = dry_friction(model, inverse, applied, velocity, np.zeros(model.nv), loss)
    np.testing.assert_allclose(found, expected, atol=1e-3)


def test_of_velocities_that_are_not_known_it_is_the_mean():
    model = mujoco.MjModel.from_xml_string(ARM.format(of_a=""))
    inverse, applied, velocity, _ = (own[:5] for own in states(model))
    inverse = inverse * np.eye(model.nv)  # or what one holds depends on the other
    loss, sd = np.repeat(model.dof_frictionloss[None], 5, axis=0), np.array([0.5, 2.0])
    draws = 20_000
    noise = np.repeat(sd * np.random.default_rng(0).standard_normal((draws, model.nv)), 5, axis=0)
    inverses, forces, velocities, losses = (
        np.tile(own, (draws, *[1] * (own.ndim - 1))) for own in (inverse, applied, velocity, loss)
    )
    several = dry_friction(model, inverses, forces, velocities + noise, 0 * sd, losses)
    found = dry_friction(model, inverse, applied, velocity, sd, loss)
    np.testing.assert_allclose(
        found, several.reshape(draws, 5, -1).mean(axis=0), atol=5 * 0.3 / np.sqrt(draws)
    )


def test_without_frictionloss_there_is_none():
    model = mujoco.MjModel.from_xml_string(ARM.format(of_a=""))
    inverse, applied, velocity, _ = states(model, 3)
    assert not dry_friction(
        model, inverse, applied, velocity, np.ones(model.nv), np.zeros_like(applied)
    ).any()
