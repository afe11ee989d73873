"""Play between a motor and what it drives."""

import numpy as np

from capture_cli.model.effects._scales import characteristic_force
from capture_cli.model.effects._transmission import TransmissionEffect
from capture_cli.model.effects._two_mass import TwoMass
from capture_cli.model.parameters import Parameter

WITHIN = 2  # steps of the play in one of the model: stops are stiff


class Play(TwoMass):
    """Within +-width / 2 the rotor turns alone; beyond, a stop passes on the force F, which pushes and never pulls:

    F give = (|d| - width / 2) + damping_time d'. The step is the theta-method's: next to the trapezoidal rule, which
    lets stops bounce, where it can follow them, and implicit where they are rigid.
    """

    def __init__(self, *, width, give, damping_time, timestep, **rest):
        super().__init__(timestep=timestep, **rest)
        self.half, self.give, self.damping_time = width / 2, give, damping_time

    def at_rest(self, passed):
        return self.half * np.sign(passed) + self.give * passed

    def advance(self, passed, against, slowing, holding):
        step, d, rate = self.timestep / WITHIN, self.deflection, self.rate
        theta = 0.5 + 0.5 * step**2 / (self.give * against + step**2)
        h = theta * step
        drives, holds = h * passed / against, h * holding / against
        slows, lasts = 1 + h * (slowing + holds), self.damping_time + h
        resists = self.give * slows + h * lasts / against
        for _ in range(WITHIN):
            driven = rate + drives - holds * d
            alone = driven / slows
            ahead = d + h * alone
            side = np.sign(ahead)
            into = d - self.half * side
            pushed = (self.give * driven - h * into / against) / resists
            pushes = (into + lasts * pushed) * side >= 0
            mean = np.where((np.abs(ahead) > self.half) & pushes, pushed, alone)
            d, rate = d + step * mean, (mean - (1 - theta) * rate) / theta
        return d, rate, 0.0


class Backlash(TransmissionEffect):
    """Play of `width` (m or rad, from stop to stop) between drive and joint, in which the motor drives nothing.

    `rotor` (kg or kg m^2) is the part of the joint's inertia on the motor's side, `motor_damping` and `motor_friction`
    the shares of its damping and of its dry friction there. A stop gives by `give` (m/N or rad/(N m)) per unit of
    force, and its friction is `damping_time` (s) over that: where it gives, the two sides bounce off each other. The
    equations are in _two_mass.py. A simulation begins with the play taken up in the direction of the force.
    """

    summary = "play between a motor and what it drives"
    shapes = ("rotor", "motor_damping", "give", "damping_time", "motor_friction")
    shares = ("motor_damping", "give", "motor_friction")
    kernel = Play
    # Between which two steps a stop is met jumps at the smallest change. From four starts fits to the log of a geared
    # hinge end at the noise with this, and at up to 18 times it with a hundredth of it.
    difference_step = 0.02

    @property
    def parameters(self):
        widest = 0.1 * self.travel
        # how far a stop gives at most under the force that the joint commonly sees, over the widest play
        softest = 0.1 * widest / characteristic_force(self.model, self.joint)
        return (
            Parameter("width", self.unit("m", "rad"), 0.0, widest, 0.0),
            self.rotor,
            self.motor_damping,
            Parameter("give", self.unit("m/N", "rad/(N m)"), 0.0, softest, 0.0),
            Parameter("damping_time", "s", 1e-5, 2e-2, 1e-3),
            *self.motor_friction,
        )

    def coefficients(self, values):
        given = super().coefficients(values)
        return {**given, "give": np.where(given["width"] > 0, given["give"], 0.0)}

    states_mean = (
        "`ahead`, `turning`: how far (m or rad) and how fast (m/s or rad/s; its `rate`) the rotor is ahead of the stop "
        "against which the forces of the moment push it. At 1 `width`, and the speed that the larger of the weight on "
        "the joint and what its actuators can give lends the rotor over that"
    )

    def looseness(self, values):
        width, rotor, *_ = values.T
        return width, np.sqrt(2 * width * characteristic_force(self.model, self.joint) / rotor)
