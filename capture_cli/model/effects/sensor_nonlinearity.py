"""A sensor whose reading bends: a potentiometer, a load cell, a Hall sensor."""

import numpy as np

from capture_cli.model.effects._places import site_id
from capture_cli.model.effects._sensor_effect import NumberEffect, quantity
from capture_cli.model.parameters import Parameter

LEAST_SLOPE = 0.25  # of the reading: where it grows less it is not undone, nor looked for


def bent(series, *, quadratic, cubic):
    """series + quadratic x^2 + cubic x^3, with x the series."""
    return series + series * series * (quadratic + cubic * series)


class SensorNonlinearity(NumberEffect):
    """Where x is there it reports x + `quadratic` x^2 + `cubic` x^3, in the sensor's unit: each of its numbers by
    itself.

    A potentiometer with a load on its wiper, a load cell, a Hall sensor beyond the middle of its range. Ranges are of
    sensors whose reading still grows at the largest number that the log has. Lengths are not among its sites:
    what moves along a line, and once, can do so as any force has it if the line may be bent.
    """

    summary = "a sensor whose reading bends: a potentiometer, a load cell, a Hall sensor"
    where = "every sensor but those of orientations and lengths"
    kernel = staticmethod(bent)
    _largest: float | None = None  # of what the log has

    @classmethod
    def sites(cls, model):
        return [s for s in super().sites(model) if quantity(model, site_id(model, "sensor", s)).unit != "m"]

    def look_in(self, log):
        super().look_in(log)
        if log.reports is not None:
            sizes = np.abs(log.reports.values[:, self.columns])
            self._largest = float(np.nanmax(sizes, initial=0.0))

    @property
    def parameters(self):
        largest, unit = self._largest or self.quantity.size, self.quantity.unit
        unit = f"({unit})" if set(unit) & set(" /^") else unit
        units = ("1", "1") if unit == "1" else (f"1/{unit}", f"1/{unit}^2")
        # either power alone leaves the reading LEAST_SLOPE where it is largest
        most = (1 - LEAST_SLOPE) / (2 * largest), (1 - LEAST_SLOPE) / (3 * largest**2)
        return tuple(
            Parameter(name, per, -end, end, 0.0)
            for name, per, end in zip(("quadratic", "cubic"), units, most, strict=True)
        )

    def undone(self, derivatives, values):
        quadratic, cubic = values.T[..., None]
        reported, slope, curvature = np.moveaxis(derivatives, 1, 0)
        low, high = _grows(quadratic, cubic)
        true = np.clip(reported, low, high)
        for _ in range(30):  # Newton steps
            gain = 1 + 2 * quadratic * true + 3 * cubic * true**2
            true = np.clip(true - (bent(true, quadratic=quadratic, cubic=cubic) - reported) / gain, low, high)
        gain, bend = 1 + 2 * quadratic * true + 3 * cubic * true**2, 2 * quadratic + 6 * cubic * true
        true_slope = slope / gain
        return np.stack([true, true_slope, (curvature - bend * np.square(true_slope)) / gain], axis=1)


def _grows(quadratic: np.ndarray, cubic: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """From where to where, around 0, the reading grows by LEAST_SLOPE at least, (simulation, 1) each."""
    # 1 + 2 q x + 3 c x^2 = LEAST_SLOPE, in 1/x: no root is lost where c is 0
    left = 1 - LEAST_SLOPE
    root = np.sqrt(np.maximum(quadratic**2 - 3 * cubic * left, 0.0))
    real = quadratic**2 >= 3 * cubic * left
    inverses = np.stack([-quadratic - root, -quadratic + root]) / left
    with np.errstate(divide="ignore"):
        roots = 1 / inverses
    low = np.where(real & (roots < 0), roots, -np.inf).max(axis=0)
    high = np.where(real & (roots > 0), roots, np.inf).min(axis=0)
    return low, high
