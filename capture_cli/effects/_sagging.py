"""How a supply sags under a load, as a kernel."""

from __future__ import annotations

import numpy as np

from capture_cli.effects._lag import Lag
from capture_cli.parameters import Parameter

TIME_CONSTANT = Parameter(
    "time_constant", "s", 0.01, 0.5, 0.07
)  # of supplies with their capacitors, and of batteries


class Sagging:
    """How many times its own size what is fed from the supply arrives, under `load`: at least 0."""

    def __init__(self, *, sag, time_constant, timestep):
        self.sag = sag
        self.felt = Lag(time_constant=time_constant, timestep=timestep)

    def __call__(self, load):
        return np.maximum(1 - self.sag * self.felt(load), 0.0)
