"""What the log leaves open of the parameters: planted servos of which ratios are known, or all, and covariances."""

from __future__ import annotations

import numpy as np
import pytest

from capture_cli.estimate.solve.intervals import Intervals
from capture_cli.estimate.solve.undetermined import (
    COMBINATION,
    NOTHING,
    PRODUCT,
    RATIOS,
    is_confounded,
    undetermined,
)
from capture_cli.model.parameters import Parameter, ParameterSpace
from capture_cli.stages import identify as stage
from capture_cli.stages.documents.undetermined_document import undetermined_of
from capture_cli.stages.record import record

SERVO = """<mujoco><option timestep="0.005" gravity="0 0 {gravity}" integrator="implicitfast"/>
<worldbody><body name="link">
<joint name="pan" axis="0 1 0" damping="0.5" armature="0.02" frictionloss="0.1"/>
<inertial pos=".1 0 0" mass="{mass}" diaginertia="1e-4 1e-4 1e-4"/></body></worldbody>
<actuator><position name="pan" joint="pan" kp="10" ctrlrange="-1 1"/></actuator>
<sensor><jointpos name="pan" joint="pan"/></sensor></mujoco>"""
TASK = """format = 1
name = "servo"
model = "model.xml"
parameters.kp = { set = "actuator:pan:kp", low = 1.0, high = 60.0, unit = "N m/rad" }
parameters.armature = { set = "joint:pan:armature", low = 0.001, high = 0.2, unit = "kg m^2" }
parameters.damping = { set = "joint:pan:damping", low = 0.01, high = 5.0, unit = "N m s/rad" }
parameters.friction = { set = "joint:pan:frictionloss", low = 0.0, high = 2.0, unit = "N m" }
inputs.pan = { column = "cmd", unit = "rad", interpolate = "hold" }
outputs.pan = { column = "pos", unit = "rad" }
log = { time = "t", window = 0.5 }
"""
TRUTH = {"kp": 14.0, "armature": 0.03, "damping": 0.8, "friction": 0.15}


@pytest.fixture
def identified(tmp_path, monkeypatch):
    """The estimate's document of a servo at TRUTH with a link of that mass, which gravity pulls or not."""
    monkeypatch.setattr(stage, "_write_pages", lambda *_: None)

    def identify(mass: float, gravity: float, friction: float = TRUTH["friction"]) -> dict:
        (tmp_path / "model.xml").write_text(SERVO.format(gravity=gravity, mass=mass))
        (tmp_path / "task.toml").write_text(TASK)
        task, log = str(tmp_path / "task.toml"), tmp_path / "log.zarr"
        planted = {**TRUTH, "friction": friction}
        record(
            task=task,
            out=log,
            parameters=planted,
            noise=1e-3,
            episodes=3,
            duration=4.0,
            rate=100.0,
            threads=1,
        )
        options = {"starts": 1, "threads": 1, "quiet": True, "test": "none"}
        return stage.identify(real_log=log, task=task, out=tmp_path / "e", **options).document

    return identify


def values_of(document: dict) -> dict[str, float]:
    return {name: p["value"] for name, p in document["parameters"].items()}


@pytest.mark.parametrize("mass", [1e-3, 0.3], ids=["nothing beside it", "a link that armature makes up for"])
def test_of_a_servo_that_nothing_loads_ratios_are_known(identified, mass):
    document = identified(mass=mass, gravity=0.0)
    (found,) = document["undetermined"]
    assert found["known"] == RATIOS
    assert {"kp", "damping", "friction"} <= set(found["scaled"])
    assert set(found["combination"]) == set(TRUTH)
    values = values_of(document)
    for name in ("damping", "friction"):
        assert values[name] / values["kp"] == pytest.approx(TRUTH[name] / TRUTH["kp"], rel=0.02)
    true = TRUTH["kp"] / values["kp"]
    assert found["factor"][0] < true < found["factor"][1]
    assert found["factor"][1] > 3 * found["factor"][0]
    assert found["text"].startswith("Only the ratios of kp, ")
    assert "can be scaled by" in found["text"]


def test_of_a_servo_that_gravity_loads_all_is_known(identified):
    document = identified(mass=0.5, gravity=-9.81)
    assert document["verdict"] == "explained"
    assert document["undetermined"] == []
    assert list(values_of(document).values()) == pytest.approx(list(TRUTH.values()), rel=0.03)


def test_ratios_are_told_under_another_verdict(identified, monkeypatch):
    """What is missing makes no verdict of what is known."""
    monkeypatch.setattr("capture_cli.stages.documents.estimate_document._verdict", lambda *_: "unexplained")
    document = identified(mass=1e-3, gravity=0.0)
    assert document["verdict"] == "unexplained"
    assert [u["known"] for u in document["undetermined"]] == [RATIOS]


# --- covariances ---


def space(*values: float, unit: str = "1") -> tuple[ParameterSpace, np.ndarray]:
    """Parameters a, b, c ... from 0 to 100, and their values."""
    names = "abcdefgh"[: len(values)]
    return ParameterSpace([Parameter(n, unit, 0.0, 100.0, 1.0) for n in names]), np.array(values)


def intervals(of: tuple[ParameterSpace, np.ndarray], *changes: np.ndarray, noise: float = 1e-3) -> Intervals:
    """Of errors along `changes` (parameter,), one standard deviation each, and `noise` of the value of each alone."""
    own, value = of
    covariance = np.diag(np.square(noise * value)) + sum(np.outer(c, c) for c in changes)
    sd = np.sqrt(np.diag(covariance))
    low, high = np.maximum(value - 2 * sd, own.low), np.minimum(value + 2 * sd, own.high)
    return Intervals(covariance, sd, low, high, sd / own.span <= 1 / 6, degrees=1e6)


def test_two_joints_that_are_alike_are_told_apart():
    """Their combinations are as open: eigenvectors of both together may be any mixture."""
    own = space(4.0, 2.0, 1.0, 4.0, 2.0, 1.0)
    first, second = np.array([1, 1, 1, 0, 0, 0]), np.array([0, 0, 0, 1, 1, 1])
    found = undetermined(intervals(own, 0.2 * own[1] * first, 0.2 * own[1] * second), *own)
    assert [u.which.tolist() for u in found] == [[0, 1, 2], [3, 4, 5]]
    for u in found:
        assert (u.known, u.scaled, u.open) == (RATIOS, (0, 1, 2), 1)
        assert u.factor == pytest.approx(np.exp([-0.392, 0.392]), rel=0.01)


def test_a_factor_goes_no_farther_than_the_bounds():
    own = space(50.0, 20.0)
    (found,) = undetermined(intervals(own, 3.0 * own[1]), *own)
    assert found.factor == (pytest.approx(0.0, abs=0.01), pytest.approx(2.0))
    assert found.ends[1].tolist() == pytest.approx([100.0, 40.0])


def test_what_else_changes_with_a_ratio_is_told_from_where_to_where():
    own = space(4.0, 2.0, 10.0)
    (found,) = undetermined(intervals(own, np.array([0.8, 0.4, -6.0])), *own)
    assert (found.known, found.scaled) == (RATIOS, (0, 1))
    document = undetermined_of(*own, intervals(own, np.array([0.8, 0.4, -6.0])))[0]
    assert document["text"] == (
        "Only the ratio of a and b is known: together they can be scaled by 0.68 to 1.3, with c from 19.7 to 0."
    )


def test_a_product():
    own = space(4.0, 0.5)
    found = undetermined(intervals(own, np.array([0.8, -0.1])), *own)[0]
    assert found.known == PRODUCT
    assert np.prod(found.ends, axis=1) == pytest.approx([2.0, 2.0])


def test_a_sum_is_no_product():
    own = space(4.0, 4.0)
    (found,) = undetermined(intervals(own, np.array([0.8, -0.8])), *own)
    assert (found.known, found.ends) == (COMBINATION, None)


def test_a_combination_is_told_by_two_points_that_are_as_good():
    own = space(10.0, 3.0)
    (document,) = undetermined_of(*own, intervals(own, np.array([8.0, -8.0])))
    assert document["known"] == COMBINATION
    assert document["ends"]["b"] == pytest.approx([18.7, 0.0], abs=0.1) or document["ends"]["b"][1] == 0.0
    assert sum(ends[0] for ends in document["ends"].values()) == pytest.approx(13.0)
    assert " is as good as a 13.0 with b 0" in document["text"]


def test_of_a_sum_of_four_terms_one_combination_is_known():
    own = space(4.0, 3.0, 2.0, 1.0)
    ways = [np.array(c) for c in ([1.0, -1, 0, 0], [0, 1.0, -1, 0], [0, 0, 1.0, -1])]
    (document,) = undetermined_of(*own, intervals(own, *ways))
    assert document["text"] == "Only a combination of a, b, c and d is known."


@pytest.mark.parametrize("share", [0.004, 0.2])
def test_what_is_known_well_enough_is_not_told(share):
    own = space(4.0, 2.0)
    found = intervals(own, share * own[1], noise=1e-6)
    assert is_confounded(found.covariance)
    assert len(undetermined(found, *own)) == (share > 0.05)


def test_correlation_of_less_than_0_99_is_no_confounding():
    own = space(4.0, 2.0)
    found = intervals(own, 0.2 * own[1], noise=0.05)
    assert not is_confounded(found.covariance)
    assert undetermined(found, *own) == []


def test_a_parameter_that_is_open_by_itself():
    own = space(4.0, 2.0)
    (found,) = undetermined(intervals(own, np.array([30.0, 0.0])), *own)
    assert (found.known, found.which.tolist()) == (NOTHING, [0])
