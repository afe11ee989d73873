"""Attitudes in logs: the sign of a quaternion, which a device may choose as it likes, changes no estimate."""

from __future__ import annotations

import shutil
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from episodes_of import episodes_of
from gimbal import gimbal

from capture_cli.errors import OptionError
from capture_cli.model.quaternion_signs import aligned, continuous, quaternion_columns
from capture_cli.stages.identify import identify
from capture_cli.stages.record import record

MODEL = """
<mujoco><worldbody><body name="box"><freejoint/><geom size=".1"/></body></worldbody>
  <sensor>
    <framepos name="p" objtype="body" objname="box"/><framequat name="q" objtype="body" objname="box"/>
  </sensor></mujoco>"""
EPISODES = [slice(0, 60), slice(60, 100)]


def attitudes(generator) -> np.ndarray:
    """Outputs (step, 7) of a box that turns more than once, in two episodes."""
    angle = np.concatenate([np.linspace(0, 15, 60), np.linspace(1, 9, 40)])
    axis = np.array([1, 2, -1]) / np.sqrt(6)
    quaternions = np.concatenate([np.cos(angle / 2)[:, None], np.sin(angle / 2)[:, None] * axis], axis=1)
    return np.concatenate([generator.normal(size=(100, 3)), quaternions], axis=1)


def test_the_outputs_of_an_attitude_are_known():
    model = mujoco.MjModel.from_xml_string(MODEL)
    sensors = [0, 0, 0, 1, 1, 1, 1]
    (columns,) = quaternion_columns(model, sensors)
    assert columns.tolist() == [3, 4, 5, 6]
    assert quaternion_columns(model, [0, 0, 0]) == []


def test_any_signs_give_the_same_series_up_to_one_sign_an_episode():
    generator = np.random.default_rng(0)
    outputs = attitudes(generator)
    columns = [np.arange(3, 7)]
    flipped = outputs.copy()
    flipped[:, 3:] *= generator.choice([-1.0, 1.0], size=(100, 1))
    found = continuous(flipped, EPISODES, columns)
    for steps in EPISODES:
        sign = np.sign(flipped[steps.start, 3:] @ outputs[steps.start, 3:])
        np.testing.assert_allclose(found[steps, 3:], sign * outputs[steps, 3:])
    assert np.array_equal(found[:, :3], outputs[:, :3])
    assert np.array_equal(continuous(found, EPISODES, columns), found)


def test_between_samples_there_are_no_signs():
    generator = np.random.default_rng(2)
    outputs = attitudes(generator)
    sampled = np.ones(outputs.shape, dtype=bool)
    sampled[:, 3:] = (np.arange(100) % 3 == 1)[:, None]
    flipped = np.where(sampled, outputs * np.r_[1, 1, 1, -1, -1, -1, -1], np.nan)
    flipped[::2, 3:] *= -1
    own = sampled[:, 3]
    found = continuous(flipped, EPISODES, [np.arange(3, 7)], sampled)
    alone = [slice(0, int(own[:60].sum())), slice(int(own[:60].sum()), int(own.sum()))]
    np.testing.assert_array_equal(found[own], continuous(flipped[own], alone, [np.arange(3, 7)]))
    assert np.isnan(found[~own, 3:]).all()


def test_a_simulation_takes_the_sign_of_what_was_measured():
    generator = np.random.default_rng(1)
    measured = np.stack([attitudes(generator)[s : s + 20] for s in (0, 20, 60)])
    simulated = np.stack([measured, measured]) + 1e-3 * generator.normal(size=(2, *measured.shape))
    turned = simulated.copy()
    turned[0, 1, :, 3:] *= -1
    turned[1, 2, 7:, 3:] *= -1
    assert np.array_equal(aligned(turned, measured, [np.arange(3, 7)]), simulated)


def test_an_estimate_is_taken_up_whatever_the_signs_in_its_log(tmp_path, without_pages):
    options = {"task": str(gimbal(tmp_path)), "threads": 1}
    log = record(out=tmp_path / "made.zarr", episodes=3, duration=1.5, rate=250.0, noise=1e-3, **options).log
    outputs = log.outputs.copy()
    for steps in log.episodes:
        outputs[steps.start + 100 : steps.stop] *= -1
    log = replace(log, outputs=outputs)
    episodes_of(log, [0, 1]).write(tmp_path / "log.zarr")
    options |= {"real_log": tmp_path / "log.zarr", "out": tmp_path / "e", "starts": 1, "quiet": True}
    identify(**options)
    shutil.rmtree(tmp_path / "log.zarr")
    log.write(tmp_path / "log.zarr")
    assert identify(resume=True, **options).document["rollouts"]["measured"] == 3
    shutil.rmtree(tmp_path / "log.zarr")
    episodes_of(log, [2, 0, 1, 0]).write(tmp_path / "log.zarr")
    with pytest.raises(OptionError, match="made from other episodes"):
        identify(resume=True, **options)
