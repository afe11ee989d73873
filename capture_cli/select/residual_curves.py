"""Where and when is something missing? Residual acceleration before and after, against all that it may depend on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.noise.autocorrelation import in_order, own_samples
from capture_cli.estimate.part_fit import PartFit
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.model.tasks.base import Channel


@frozen
class SETTINGS:
    bins: int = 24
    half_width: int = 8  # samples on either side of the local quadratic that differentiates the residual


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


@dataclass(frozen=True)
class Curve:
    """Mean residual acceleration in bins of a covariate.

    centre, mean, error (bin,), the last bin repeated where the covariate has fewer values; share: of the residual
    acceleration's variance that the covariate accounts for (correlation ratio, less what as many random bins would).
    """

    centre: np.ndarray
    mean: np.ndarray
    error: np.ndarray
    share: float


def accelerations(residual: np.ndarray, time: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Second derivative of residual (window, step, output) by local quadratics; NaN where there is no room.

    time (window, step): s, evenly spaced or not.
    """
    out = np.full(residual.shape, np.nan)
    width = 2 * SETTINGS.half_width + 1
    if residual.shape[1] < width:
        return out
    views = np.lib.stride_tricks.sliding_window_view
    window, step = np.nonzero(views(mask, width, axis=1).all(axis=-1))
    near = views(time, width, axis=1)[window, step] - time[window, step + SETTINGS.half_width, None]
    basis = near[..., None] ** np.arange(3) / near[:, -1, None, None] ** np.arange(3)
    gram = np.swapaxes(basis, 1, 2) @ basis
    weights = 2 * np.linalg.solve(gram, np.swapaxes(basis, 1, 2))[:, 2] / np.square(near[:, -1:])
    around = views(residual, width, axis=1)[window, step]  # (place, output, sample)
    out[window, step + SETTINGS.half_width] = np.einsum("pos,ps->po", around, weights)
    return out


def largest_around(values: np.ndarray) -> np.ndarray:
    """The largest of `values` (window, step) within the samples that an acceleration is taken over."""
    from scipy.ndimage import maximum_filter1d

    return maximum_filter1d(values, 2 * SETTINGS.half_width + 1, axis=1, mode="nearest")


def curve(covariate: np.ndarray, acceleration: np.ndarray) -> Curve:
    """Bins of equal count of `covariate` (step,), both flat and of one output; NaN are left out.

    A covariate of few values, such as a number of contacts, has a bin for each.
    """
    good = np.isfinite(acceleration) & np.isfinite(covariate)
    x, y = covariate[good], acceleration[good]
    empty = np.full(SETTINGS.bins, np.nan)
    if len(x) < 4 * SETTINGS.bins or np.ptp(x) == 0:
        return Curve(empty, empty, empty, 0.0)
    values = np.unique(x)
    if len(values) <= SETTINGS.bins:
        groups = [np.flatnonzero(x == value) for value in values]
    else:
        groups = np.array_split(np.argsort(x, kind="stable"), SETTINGS.bins)
    mean = _means(y, groups)
    error = np.array([y[g].std() / np.sqrt(len(g)) for g in groups])
    total = np.square(y - y.mean()).sum()
    between = sum(len(g) * (y[g].mean() - y.mean()) ** 2 for g in groups)
    share = 1 - (1 - between / total) * (len(y) - 1) / (len(y) - len(groups)) if total > 0 else 0.0
    curves = (
        np.pad(c, (0, SETTINGS.bins - len(groups)), mode="edge") for c in (_means(x, groups), mean, error)
    )
    return Curve(*curves, float(max(share, 0.0)))


def _means(values: np.ndarray, groups: list[np.ndarray]) -> np.ndarray:
    return np.array([values[g].mean() for g in groups])
