"""Where and when is something missing? Residual acceleration before and after, against all that it may depend on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture_cli.autocorrelation import in_order, own_samples
from capture_cli.diagnosis.localisation import Curve, accelerations, curve, largest_around
from capture_cli.model.tasks.base import Channel
from capture_cli.protocol.part_fit import PartFit
from capture_cli.protocol.prepared_log import PreparedLog


@dataclass(frozen=True)
class ResidualCurve:
    """The residual acceleration of `output` against a covariate, in its unit; share, centre (bin,): see `Curve`.

    before, after (bin,): means with the declared model and with the last; error (bin,): of those before.
    """

    output: str
    against: str
    unit: str
    share: float
    centre: np.ndarray
    before: np.ndarray
    after: np.ndarray
    error: np.ndarray


def residual_curves(
    prepared: PreparedLog, before: PartFit, after: PartFit, contacts: np.ndarray
) -> list[ResidualCurve]:
    """Curves of every output of two models. contacts (window, grid): how many there are, on the model's grid.

    Of the other outputs, and of how far they are from this one, only what accounts for most is among them.
    """
    windows = prepared.windows
    time = prepared.log.time[prepared.log_steps]
    inputs = prepared.log.inputs[prepared.log_steps]
    contacts = np.take_along_axis(contacts, windows.index, axis=1)
    contacts = largest_around(np.where(windows.mask, contacts, 0)).astype(float)
    touches = np.ptp(contacts[windows.mask]) > 0
    curves = []
    for k, output in enumerate(prepared.task.outputs):
        order = own_samples(windows.sampled[..., k])
        own_time, own = in_order(time, order), in_order(windows.sampled[..., k], order)
        left = [in_order(model.in_units[..., k, None], order) for model in (before, after)]
        was_and_is = [accelerations(residual, own_time, own)[..., 0] for residual in left]
        measured = in_order(np.where(windows.sampled, windows.measured, np.nan), order)
        covariates = _motion(output, own_time, np.where(own, measured[..., k], np.nan))
        covariates += _inputs(prepared, in_order(inputs, order))
        if touches:
            covariates.append(("number of contacts", "1", in_order(contacts, order)))
        others = _others(prepared.task.outputs, k, measured)
        telling = sorted(others, key=lambda other: -_curve(other, own, was_and_is[0]).share)[:1]
        for covariate in covariates + telling:
            was, now = (_curve(covariate, own, acceleration) for acceleration in was_and_is)
            found = (was.share, was.centre, was.mean, now.mean, was.error)
            curves.append(ResidualCurve(output.name, *covariate[:2], *found))
    return curves


Covariate = tuple[str, str, np.ndarray]  # what it is, its unit, its values (window, step)


def _curve(covariate: Covariate, own: np.ndarray, acceleration: np.ndarray) -> Curve:
    """acceleration (window, step): of the residual, looked at where `own` is true."""
    return curve(np.where(own, covariate[2], np.nan).ravel(), acceleration.ravel())


def _motion(output: Channel, time: np.ndarray, position: np.ndarray) -> list[Covariate]:
    velocity = np.gradient(position, axis=1) / np.gradient(time, axis=1)
    return [
        ("time", "s", time),
        (output.name, output.unit, position),
        (f"rate of {output.name}", f"{output.unit}/s", velocity),
    ]


def _inputs(prepared: PreparedLog, inputs: np.ndarray) -> list[Covariate]:
    return [(c.name, c.unit, inputs[..., i]) for i, c in enumerate(prepared.task.inputs)]


def _others(outputs: Sequence[Channel], k: int, measured: np.ndarray) -> list[Covariate]:
    """The other outputs, and those in the unit of output k less it: bodies push each other by their distance.

    measured (window, step, output): NaN where an output was not sampled.
    """
    covariates = []
    for j, other in enumerate(outputs):
        if j == k:
            continue
        covariates.append((other.name, other.unit, measured[..., j]))
        if other.unit == outputs[k].unit and other.sensor != outputs[k].sensor:
            apart = measured[..., j] - measured[..., k]
            covariates.append((f"{other.name} - {outputs[k].name}", other.unit, apart))
    return covariates
