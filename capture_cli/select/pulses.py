"""How the outputs respond to a force at a joint, whenever in a window it acts.

The response to short pulses, one after the other, is simulated; that to any force along the motion is to first order
a sum of them, so that hundreds of forces are judged at the price of a few dozen simulations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.estimate.solve.linearization import Linearization
from capture_cli.model.effects._joint_effect import JointEffect
from capture_cli.model.parameters import Parameter
from capture_cli.model.world import Force, World

NAME = "pulses"


@frozen
class SETTINGS:
    per_period: int = 4  # pulses in the shortest period asked for
    most: int = 64  # pulses in a window; a longer window resolves slower forces only
    resolved: float = 0.45  # periods per pulse up to which pulses can follow a force


class Pulses(JointEffect):
    """Forces at a joint that rise and fall within 2 `spacing` model steps, each `spacing` after the one before.

    There are `count`; the first peaks at the start of the simulation, the amplitude of each is a parameter.
    """

    place = "force"
    summary = "a force at some time of a window"

    def __init__(self, model, site: str, spacing: int, count: int):
        super().__init__(model, site)
        self.spacing, self.count = spacing, count

    @classmethod
    def over(cls, model, site: str, steps: int, shortest: float) -> Pulses:
        """For windows of `steps` model steps and forces with periods down to `shortest`, in s."""
        wanted = shortest / SETTINGS.per_period / float(model.opt.timestep)
        spacing = max(int(wanted), -(-steps // (SETTINGS.most - 1)), 1)
        return cls(model, site, spacing, -(-steps // spacing) + 1)

    @property
    def parameters(self):
        size = self.characteristic_force
        return tuple(
            Parameter(f"pulse_{k}", self.unit("N", "N m"), -size, size, 0.0) for k in range(self.count)
        )

    @property
    def fastest(self) -> float:
        """Hz: the fastest force that they can add up to."""
        return SETTINGS.resolved / (self.spacing * float(self.model.opt.timestep))

    def force(self, values, timestep, **_) -> Force:
        return _Force(self, values, round(float(self.model.opt.timestep) / timestep))

    def shares(self, steps: np.ndarray) -> np.ndarray:
        """Height of each pulse at `steps` (step,) after the start, (step, pulse)."""
        return np.maximum(1 - np.abs(steps[:, None] / self.spacing - np.arange(self.count)), 0.0)


class _Force:
    """Pulses over a batch, chunk after chunk; in each model step it is called `substeps` times."""

    def __init__(self, pulses: Pulses, values: np.ndarray, substeps: int):
        self.pulses, self.values = pulses, values
        self.spacing = substeps * pulses.spacing
        self.world: World | None = None

    def __call__(self, world: World) -> None:
        if world is not self.world:
            self.world, self.step = world, 0
        first, into = divmod(self.step, self.spacing)
        rising = into / self.spacing
        force = (1 - rising) * self._height(world.rows, first) + rising * self._height(world.rows, first + 1)
        world.qfrc_applied[:, self.pulses.dof] += force
        self.step += 1

    def _height(self, rows: slice, pulse: int) -> np.ndarray | float:
        """Of a pulse, (simulation,); there are none after the last."""
        return self.values[rows, pulse] if pulse < self.pulses.count else 0.0


@dataclass(frozen=True)
class PulseResponse:
    """What pulses would explain, the initial states eliminated: the normal equations of the amplitudes, window by
    window.

    gram (window, pulse, pulse), across (window, pulse, parameter), pull (window, pulse); those of the parameters,
    summed over windows: hessian (parameter, parameter), gradient (parameter,).
    """

    gram: np.ndarray
    across: np.ndarray
    pull: np.ndarray
    hessian: np.ndarray
    gradient: np.ndarray

    @classmethod
    def of(cls, at: Linearization, change: np.ndarray) -> PulseResponse:
        """From what a unit of each pulse adds to the outputs, (window, row, pulse), in units of the noise."""
        k = at.inflation
        through = at.by_initial.swapaxes(1, 2) @ change  # (window, state, pulse)
        held = at.initial_gain(k) @ through
        to_start = at.by_initial.swapaxes(1, 2) @ at.by_parameter
        start_pull = (at.by_initial.swapaxes(1, 2) @ at.residual[..., None])[..., 0] - k * at.z
        turned = change.swapaxes(1, 2)
        hessian, gradient = at.normal(k)
        return cls(
            gram=turned @ change - through.swapaxes(1, 2) @ held,
            across=turned @ at.by_parameter - held.swapaxes(1, 2) @ to_start,
            pull=(turned @ at.residual[..., None])[..., 0]
            - (held.swapaxes(1, 2) @ start_pull[..., None])[..., 0],
            hessian=hessian,
            gradient=gradient,
        )

    def gains(self, forces: np.ndarray, apart: np.ndarray | None = None) -> np.ndarray:
        """Decrease of the objective by each of `forces` (force, amplitude, window, pulse), amplitudes free, (force,).

        What the parameters can imitate is projected off. apart (window,): numbers of the windows, between which the
        amplitudes differ; alike in all where None.
        """
        if apart is None or not np.ptp(apart):
            return self._gains(forces)
        groups = [np.flatnonzero(apart == number) for number in np.unique(apart)]
        return sum(self._windows(own)._gains(forces[:, :, own]) for own in groups)

    def _windows(self, keep: np.ndarray) -> PulseResponse:
        """Of the windows at `keep` alone, beside the same parameters."""
        return replace(self, gram=self.gram[keep], across=self.across[keep], pull=self.pull[keep])

    def _gains(self, forces: np.ndarray) -> np.ndarray:
        across = np.tensordot(forces, self.across, 2)
        gram = _squared(forces, self.gram)
        pull = np.tensordot(forces, self.pull, 2)
        inverse = np.linalg.pinv(self.hessian, rcond=1e-12, hermitian=True)
        left = gram - across @ inverse @ across.swapaxes(1, 2)
        size = np.trace(gram, axis1=1, axis2=2)
        left += 1e-9 * np.maximum(size, 1e-90)[:, None, None] * np.eye(left.shape[-1])
        pull = pull - across @ inverse @ self.gradient
        return np.einsum("fa,fa->f", pull, np.linalg.solve(left, pull[..., None])[..., 0])


def _squared(forces: np.ndarray, gram: np.ndarray) -> np.ndarray:
    """forces gram forces', (force, amplitude, amplitude): one product of large matrices for each window."""
    count, size = forces.shape[:2]
    total = np.zeros((count, size, size))
    for window, own in enumerate(gram):
        each = np.ascontiguousarray(forces[:, :, window]).reshape(count * size, -1)
        felt = (each @ own).reshape(count, size, -1)
        total += felt @ each.reshape(count, size, -1).swapaxes(1, 2)
    return total
