"""Simulations that begin inside a log that is exact: they go on as the one that the log was recorded from."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from capture_cli.model.effects._joint_effect import JointEffect
from capture_cli.model.effects.base import JointMotion, SeenLog
from capture_cli.model.fields import ModelFields
from capture_cli.model.states import InitialStates
from capture_cli.simulate.engine import Engine, Keep

LENGTH = 100  # steps of a simulation that begins inside


def begun_inside(
    effect: JointEffect,
    values: np.ndarray,
    tape: np.ndarray,
    first: Sequence[int],
    *,
    stretches: Sequence[slice] = (),
    states: np.ndarray | None = None,
    fields: dict[str, np.ndarray] | None = None,
    late: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Positions (simulation, step) of a machine with one joint and one actuator, from the steps `first` of a log on:
    as recorded, and begun there.

    values (parameter,); tape (step,): set points; stretches: the episodes of the log, one where there are none;
    states (simulation, state) of the effect; fields: of the model, what is other than there; late: steps by which the
    log shows the path late.
    """
    model, first = effect.model, np.array(first)
    own = ModelFields(model, 1), ModelFields(model, len(first))
    for name, value in (fields or {}).items():
        for simulations in own:
            simulations[name][:] = value
    timestep, engine = model.opt.timestep, Engine(model, 1)
    start = InitialStates(model.qpos0[None], np.zeros((1, 1)), np.zeros((1, 0)), np.zeros(1))
    whole = engine.rollout(
        initial=start,
        controls=tape[None, :, None],
        fields=own[0],
        forces=[effect.force(values[None], timestep)],
        keep=Keep(states=True),
    )
    path = whole.qpos[0, :, 0]
    shown = np.concatenate([np.full(late, path[0]), path[: len(path) - late]])
    effect.look_in(
        SeenLog(
            window=LENGTH * timestep,
            longest=len(tape) * timestep,
            logged=frozenset([0]),
            seen={effect.joint: _seen(shown, tape, stretches or [slice(0, len(path))], model)},
        )
    )
    each = np.repeat(values[None], len(first), axis=0)
    inside = np.array([np.arange(f, f + LENGTH) for f in first])
    begun = engine.rollout(
        initial=InitialStates(
            whole.qpos[0, first], whole.qvel[0, first], np.zeros((len(first), 0)), timestep * first
        ),
        controls=tape[inside][..., None],
        fields=own[1],
        forces=[
            effect.force(
                each, timestep, states=states, first=first, late=np.full((len(first), 1), late * timestep)
            )
        ],
        keep=Keep(states=True),
    )
    return path[inside], begun.qpos[..., 0]


def _seen(
    path: np.ndarray, tape: np.ndarray, stretches: Sequence[slice], model: mujoco.MjModel
) -> JointMotion:
    time = model.opt.timestep * np.arange(len(path))
    speed = np.abs(np.diff(path)).max() / model.opt.timestep
    return JointMotion(path.min(), path.max(), speed, path, stretches, 0.0, time, {0: tape})
