"""What `diagnose` proposes where effects are tied."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from capture_cli.effects import REGISTRY
from capture_cli.protocol.model_fits import ModelFits
from capture_cli.protocol.next_experiment import BANDS, SHARES, next_experiment
from capture_cli.protocol.prepare import prepare
from capture_cli.stages.record import record
from capture_cli.tasks import load_task

SLIDER = Path(__file__).parents[1] / "benchmarks" / "machines" / "slider" / "task.toml"


@pytest.fixture
def fits(tmp_path) -> ModelFits:
    log = record(task=str(SLIDER), out=tmp_path / "log.zarr", noise=5e-4, duration=2.0, rate=250).log
    return ModelFits(prepare(log, load_task(str(SLIDER)), window=None, test=None, seed=0), 1)


def with_effect(fits: ModelFits, name: str, value: float):
    """The nominal model with an effect of one parameter at its joint."""
    effect = REGISTRY.get(name)(fits.prepared.task.model, "x")
    return SimpleNamespace(
        effects=((name, effect),), point=np.append(fits.prepared.task.space.nominal, value)
    )


def test_an_experiment_that_tells_two_effects_apart_is_found_and_what_it_took_is_counted(fits):
    found = next_experiment(
        fits, with_effect(fits, "coulomb-friction", 1.0), [with_effect(fits, "cubic-stiffness", 50.0)], seed=0
    )
    assert found["separation"] > 3
    assert found["text"].startswith("to tell it from cubic-stiffness@x: drive from rest")
    assert fits.rollouts == 2 * len(BANDS) * len(SHARES)


def test_nothing_tells_a_model_from_itself(fits):
    same = with_effect(fits, "coulomb-friction", 1.0)
    assert "one and the same" in next_experiment(fits, same, [same], seed=0)["text"]
    assert next_experiment(fits, same, [], seed=0) is None
