"""A spring that relaxes: rubber, a belt, a bellows, a gel, a cable with a polymer core."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from capture_cli.common.frozen import frozen
from capture_cli.common.recursive_filter import recursively_filtered
from capture_cli.model.effects._followed_force import Begins, FollowedForce
from capture_cli.model.effects._followed_log import at_steps, measured_stretches, since_stretches_began
from capture_cli.model.effects._joint_force import ForceOfKernel
from capture_cli.model.effects._scales import SETTINGS as SCALES
from capture_cli.model.effects._scales import free_inertia
from capture_cli.model.parameters import Parameter


@frozen
class SETTINGS:
    # steps of the log, or of the model, that relaxing takes: what is quicker is a damper
    quickest: float = 4.0
    slowest: float = 0.5  # of the longest episode: what is slower is an elastic spring
    forgotten: float = 5.0  # times the relaxation time: then nothing is left of what was before
    kept: int = 64  # relaxation times, the last ones tried, of which it is known where the spring would rest


class MaxwellElement:
    """The force -stiffness u of a spring in series with a damper: du/dt = dq/dt - u / relaxation.

    Exact where q moves steadily over a step. stretch: u at the start.
    """

    def __init__(self, *, stiffness, relaxation, timestep, stretch=0.0):
        self.stiffness, self.stretch, self.position = stiffness, stretch, None
        self.decay = np.exp(-timestep / relaxation)
        self.taken_up = (1 - self.decay) * relaxation / timestep  # of the way of a step

    def __call__(self, qpos):
        if self.position is not None:
            self.stretch = self.decay * self.stretch + self.taken_up * (qpos - self.position)
        self.position = np.copy(qpos)
        return -self.stiffness * self.stretch


class ViscoelasticSpring(FollowedForce):
    """A spring of `stiffness` (N/m or N m/rad) that creeps after the joint, so that its force has fallen to 37 % after
    `relaxation` seconds: one arm of a Maxwell model of rubber, beside the spring that stays, which is linear-stiffness.

    Where it rests when a window begins follows from where the joint was before, which the log has to measure, and from
    how far it was stretched when the episode began, or went on after a gap, which nobody knows. A simulation that
    begins otherwise begins with a spring at rest.
    """

    summary = "a spring that relaxes: rubber, a belt, a bellows, a gel"
    where = "every hinge and slide joint whose position is measured"
    shapes = ("relaxation",)
    vague_at_end = ("relaxation",)  # a damper, or a spring that stays
    states = ("stretch",)  # when the episode began, over half of how far the joint goes
    states_mean = (
        "`stretch`: how far the spring was stretched when the episode began, m or rad. At 1 half of how far the joint "
        "goes in the log"
    )
    kernel = MaxwellElement
    kernel_keeps = ("stretch", "position")

    @property
    def parameters(self):
        step = self.model.opt.timestep
        stiffest = free_inertia(self.model, self.joint) * (SCALES.stiffest / step) ** 2
        stiffest = min(stiffest, 5 * self.characteristic_force / self.characteristic_travel)
        quickest, slowest = SETTINGS.quickest * step, 1.0
        if self.longest is not None:
            quickest = SETTINGS.quickest * max(step, self._sampled)
            slowest = max(SETTINGS.slowest * self.longest, 2 * quickest)
        return (
            Parameter("stiffness", self.unit("N/m", "N m/rad"), 0.0, stiffest, 0.0),
            Parameter("relaxation", "s", quickest, slowest, float(np.sqrt(quickest * slowest))),
        )

    def look_in(self, log):
        super().look_in(log)
        self._sampled = 0.0
        self._rests = lru_cache(maxsize=SETTINGS.kept)(self._followed)
        if self.seen is not None and self.seen.stretches:
            self._elapsed = since_stretches_began(self.seen.time, self.seen.stretches)
            self._sampled = float(np.median(np.diff(self.seen.time)))

    def force_since(self, given, timestep, begins):
        rest = self._rest(given["relaxation"], begins)
        return ForceSinceBefore(self, given | {"rest": rest}, timestep)

    def states_sd(self, first):
        if self.seen is None:
            return super().states_sd(first)
        slowest = self.space.high[self.space.names.index("relaxation")]
        return (self._elapsed[first] < SETTINGS.forgotten * slowest)[:, None].astype(float)

    def _rest(self, relaxation: np.ndarray, begins: Begins) -> np.ndarray:
        """m or rad: where springs rest where simulations begin, (simulation,), relaxation likewise. Their state is how
        far they were stretched when the stretch of the log began, over the characteristic travel.
        """
        rest = np.empty(len(relaxation))
        for time in np.unique(relaxation):
            rows = relaxation == time
            rest[rows] = at_steps(self._rests(float(time)), begins.shown[rows])
        left = np.exp(-self._elapsed[begins.first] / relaxation)
        return rest - self.characteristic_travel * begins.states[:, 0] * left

    def _followed(self, relaxation: float) -> np.ndarray:
        """m or rad: where a spring rests at each step of the log (step,) that was at rest when each stretch began."""
        rests = np.zeros(len(self.seen.path))
        for steps, time, path in measured_stretches(self.seen.time, self.seen.path, self.seen.stretches):
            rests[steps] = followed(time, path, relaxation)
        return rests


class ForceSinceBefore(ForceOfKernel):
    """The force of a spring that has crept after the joint in the log: it begins stretched from there to where the
    joint is now.
    """

    def own(self, world):
        own = super().own(world)
        own["stretch"] = self.effect.read(world, "qpos") - own.pop("rest")
        return own


def followed(time: np.ndarray, path: Callable[[np.ndarray], np.ndarray], relaxation: float) -> np.ndarray:
    """What creeps after a path at its difference over `relaxation`, s, from its first value, at `time` (step,), s.

    path: of times (n,). Exact for what moves steadily between steps that are even.
    """
    even = np.linspace(time[0], time[-1], len(time))
    at = path(even)
    step = (time[-1] - time[0]) / max(len(time) - 1, 1)
    decay = np.exp(-step / relaxation)
    taken_up = (1 - decay) * relaxation / step if step else 1.0
    stretch = recursively_filtered((taken_up,), (-decay,), np.diff(at, prepend=at[0]))
    return np.interp(time, even, at - stretch)
