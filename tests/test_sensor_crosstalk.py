"""A sensor that picks up a motor's current: found where it is planted, in the sensors next to that motor."""

from pathlib import Path

import numpy as np
import pytest
from diagnosing import diagnose, look_among
from machines import ARM, build, machine, run
from recorded_logs import record_log

from capture_cli.estimate.model_fits import ModelFits
from capture_cli.estimate.prepare import prepare
from capture_cli.estimate.split import NewSplit
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.model import effects
from capture_cli.model.effects.placed import Placed
from capture_cli.model.tasks import load_task

MACHINES = Path(__file__).parents[1] / "benchmarks" / "machines"
PAN_TILT, ARM_TASK = (MACHINES / name / "task.toml" for name in ("pan_tilt", "arm"))
Crosstalk = effects.REGISTRY.get("sensor-crosstalk")


def recorded(folder: Path, task: Path, effect: str) -> MeasuredLog:
    return record_log(folder, task, effect, noise=1e-3, episodes=4, duration=3.0, seed=3)


def test_the_current_of_the_other_motor_is_found_in_an_encoder(tmp_path, monkeypatch):
    look_among(
        monkeypatch,
        "sensor-crosstalk",
        "sensor-scale",
        "sensor-bias",
        "sensor-delay",
        "control-gain",
        "cogging",
    )
    task = load_task(str(PAN_TILT))
    [site] = [s for s in Crosstalk.sites(task.model) if s.startswith("pan+")]
    log = recorded(tmp_path, PAN_TILT, f"sensor-crosstalk@{site}.share=0.02")
    document = diagnose(log, task, seed=0)
    assert [f"{e['name']}@{e['site']}" for e in document["effects"]] == [f"sensor-crosstalk@{site}"]
    share = document["effects"][0]["parameters"]["share"]
    assert share["value"] == pytest.approx(0.02, abs=4 * share["sd"]) and share["sd"] < 0.002
    before, after = (document[when]["test"]["normalized"] for when in ("before", "after"))
    assert after < 1.2 < 2 < before


def test_initial_states_may_be_as_far_off_as_the_sensor_they_were_read_off(tmp_path):
    """In an arm the error was 48 floors with the true effect in the model."""
    task = load_task(str(ARM_TASK))
    effect, share = Crosstalk(task.model, "q1+elbow"), -0.05
    log = recorded(tmp_path, ARM_TASK, f"sensor-crosstalk@q1+elbow.share={share}")
    prepared = prepare(log, task, split=NewSplit(seed=0))
    begin = np.append(prepared.task.space.nominal, share)
    fit = ModelFits(prepared, 1).fit(prepared, [Placed("sensor-crosstalk@q1+elbow", effect)], begin)
    assert fit.point[-1] == pytest.approx(share, rel=0.05)
    assert fit.error < 1.1


def test_the_force_that_the_actuator_gives_is_what_is_picked_up():
    """A servo at its forcerange gives that, whatever its control says."""
    arm = machine("arm")
    effect = Crosstalk(arm, "elbow+shoulder")
    far = np.full((1, 5, 2), 10.0)
    with_it, _ = run(arm, (effect, np.array([[0.01]])), tape=far)
    without, _ = run(arm, tape=far)
    picked_up = with_it - without
    np.testing.assert_allclose(picked_up[0, :, 1], 0.01 * 20.0, atol=1e-12)
    assert not np.delete(picked_up, 1, axis=2).any()


def test_each_number_of_a_sensor_picks_up_its_own_share():
    effect = Crosstalk(machine("arm"), "gyro+elbow")
    assert [p.name for p in effect.parameters] == ["x", "y", "z"]
    assert effect.parameters[0].unit == "rad/s per N m"
    sensors, force = np.zeros((2, 3, 8)), np.ones((2, 3, 2)) * [5.0, 2.0]
    picked_up = effect.pick_up(sensors, np.array([[1.0, 2.0, 3.0], [0.0, 0.0, 1.0]]), force)
    np.testing.assert_array_equal(picked_up[:, 0, 5:], [[2.0, 4.0, 6.0], [0.0, 0.0, 2.0]])
    assert not picked_up[..., :5].any() and not sensors.any()


def test_a_sensor_of_a_joint_does_not_pick_up_its_own_motor():
    """There it would be a transmission that gives, or the scale of the sensor."""
    sites = Crosstalk.sites(machine("arm"))
    assert "shoulder+elbow" in sites and "shoulder+shoulder" not in sites
    of_actuator = ARM.replace("</sensor>", '<actuatorfrc name="torque" actuator="elbow"/></sensor>')
    assert [s for s in Crosstalk.sites(build(of_actuator)) if s.startswith("torque")] == ["torque+shoulder"]
    assert not Crosstalk.sites(machine("slider")) and not Crosstalk.sites(machine("puck"))


def chain(joints: int) -> str:
    """A row of links with a motor at each joint, whose encoders are named as the motors are."""
    inner = "".join(
        f'<body pos="0 0 .1"><joint name="j{k}" axis="0 1 0"/><geom size=".02" mass=".1"/>'
        for k in range(joints)
    )
    motors = "".join(f'<motor name="m{k}" joint="j{k}"/>' for k in range(joints))
    encoders = "".join(f'<jointpos name="e{k}" joint="j{k}"/>' for k in range(joints))
    return (
        f"<mujoco><worldbody>{inner}{'</body>' * joints}</worldbody>"
        f"<actuator>{motors}</actuator><sensor>{encoders}</sensor></mujoco>"
    )


def test_the_number_of_places_grows_with_the_number_of_sensors_not_of_pairs():
    sites = Crosstalk.sites(build(chain(20)))
    assert len(sites) == 20 * 4
    assert {s for s in sites if s.startswith("e10+")} == {f"e10+m{k}" for k in (8, 9, 11, 12)}
