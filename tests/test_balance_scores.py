"""Where a log gives a force balance, and which of its steps take part."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from balances import COVERED, Made

from capture_cli.estimate import log_balance as balance_scores
from capture_cli.estimate.log_balance import balanced_point
from capture_cli.log.measured_log import MeasuredLog
from capture_cli.select.balance_scores import screening_of
from capture_cli.select.candidates import Candidate

LOOP = """
<mujoco><option timestep="0.002"/><default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <body name="a"><joint name="a" axis="0 1 0"/><geom size=".1" pos="0 0 -.3"/></body>
    <body name="b"><joint name="b" axis="0 1 0"/><geom size=".1" pos="0 0 -.3"/></body>
  </worldbody>
  {}
  <sensor><jointpos joint="a"/><jointpos joint="b"/></sensor>
</mujoco>"""
COUPLED = '<equality><joint joint1="a" joint2="b"/></equality>'
FILTERED = '<actuator><general joint="a" dyntype="filter" dynprm=".1"/></actuator>'


@pytest.fixture(scope="module")
def made():
    return Made.of("cart_pole", episodes=3)


def asked(prepared):
    fitted = np.arange(len(prepared.windows))
    return screening_of(prepared, fitted, [], 1, lambda *_: None)


def with_task(prepared, **changes):
    task = copy(prepared.task)
    for name, value in changes.items():
        setattr(task, name, value)
    return replace(prepared, task=task)


def test_a_log_of_all_positions_has_a_balance(made):
    assert asked(made.prepared) is not None


@pytest.mark.parametrize("what", [COUPLED, FILTERED], ids=["loop", "activation"])
def test_what_no_balance_covers_has_none(made, monkeypatch, what):
    model = mujoco.MjModel.from_xml_string(LOOP.format(what))
    prepared = with_task(made.prepared, model=model)
    # it is the model that says so, before the log is looked at
    monkeypatch.setattr(MeasuredLog, "arrays", property(lambda _: pytest.fail("the log was looked at")))
    assert asked(prepared) is None


def test_a_joint_that_no_output_tells_leaves_none(made):
    log = made.prepared.log
    few = replace(
        log, outputs=log.outputs[:, :1], output_names=log.output_names[:1], output_units=log.output_units[:1]
    )
    prepared = with_task(made.prepared, outputs=made.prepared.task.outputs[:1])
    assert asked(replace(prepared, log=few)) is None


def test_steps_at_a_stop_are_left_out(made):
    prepared = made.prepared
    model = copy(prepared.task.model)
    joint = int(model.joint("x").id)
    path = prepared.log.values[:, 0]
    model.jnt_limited[joint], model.jnt_range[joint] = True, np.quantile(path, (0.0, 0.8))
    free = balance_scores._between_stops(with_task(prepared, model=model))
    low, high = model.jnt_range[joint]
    np.testing.assert_array_equal(free, (path > low) & (path < high))
    assert free.mean() == pytest.approx(0.8, abs=0.01)
    own = asked(with_task(prepared, model=model))
    steps = own.balance.points.step
    assert len(steps) and free[steps].all()


def test_only_windows_that_are_fitted_take_part(made):
    prepared, fitted = made.prepared, np.arange(len(made.prepared.windows) // 2)
    own = screening_of(prepared, fitted, [], 1, lambda *_: None)
    windows = prepared.windows
    ends = windows.first[fitted] + windows.samples[fitted]
    assert own.balance.points.step.max() < ends.max()


def test_it_says_at_which_candidate_it_is(made):
    told, few = [], [Candidate(p) for p in made.placed[:3]]
    screening_of(made.prepared, np.arange(4), few, 1, lambda *step: told.append(step))
    assert told == [("balance", n, 3) for n in range(3)]


def test_too_short_a_log_gives_no_balance(made):
    assert screening_of(made.prepared, np.arange(1), [], 1, lambda *_: None) is None


@pytest.mark.parametrize("machine", COVERED)
def test_the_balance_says_where_a_fit_begins(machine):
    own = Made.of(machine, seed=1)
    space, windows = own.experiment.task.space, np.arange(len(own.prepared.windows))
    found = balanced_point(own.prepared, windows, space.low, 1)
    assert np.abs((found - own.truth) / space.span).max() < 0.1
