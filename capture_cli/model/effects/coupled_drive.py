"""A motor whose force acts on the joint before its own, too: a cable that runs over it, a differential."""

import mujoco

from capture_cli.model.effects._joint_force import FORCE, JointForce
from capture_cli.model.effects._kernel import Companion, call
from capture_cli.model.effects._neighbours import joint_before
from capture_cli.model.effects._places import source
from capture_cli.model.effects._scales import HINGE, characteristic_force, driven_joints
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.object_names import object_name
from capture_cli.model.parameters import Parameter


def passed_on(qfrc_actuator, *, ratio):
    """What the joint before gets of the force that drives this one."""
    return ratio * qfrc_actuator


class CoupledDrive(JointForce):
    """`ratio` (1, m or 1/m) times the force that actuators give the joint acts on the one before it, too.

    So does a cable that runs over a pulley there, of `ratio` times the radius of its own: the motor turns by
    q + ratio p for positions q of its joint and p of the one before. The force passed on is that of the step before.
    """

    summary = "a motor's force that also acts on the joint before: a cable that runs over it, a differential, a belt"
    where = "every hinge and slide joint that an actuator drives and that hangs on another"
    kernel = staticmethod(passed_on)

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.hangs_on = joint_before(model, self.joint)

    @classmethod
    def sites(cls, model):
        return [object_name(model, "joint", j) for j in driven_joints(model) if joint_before(model, j) >= 0]

    @property
    def parameters(self):
        turns = self.model.jnt_type[self.hangs_on] == HINGE
        unit = "1" if turns == self.is_hinge else "m" if turns else "1/m"
        most = 1.5  # pulleys of joints that follow each other are about as large
        if turns != self.is_hinge:  # a length: such that what is passed on is like other forces there
            most *= characteristic_force(self.model, self.hangs_on) / self.characteristic_force
        return (Parameter("ratio", unit, -most, most, 0.0),)

    def add(self, world, term):
        world.qfrc_applied[:, self.model.jnt_dofadr[self.hangs_on]] += term

    def companion(self, name, values):
        own, before = (
            f"{source(self.model, 'joint', site)}.dofadr"
            for site in (self.joint_name, object_name(self.model, "joint", self.hangs_on))
        )
        term, _ = call(name, passed_on, [f"data.qfrc_actuator[{own}]"], {"ratio": values[0]})
        return Companion((passed_on,), (f"data.{FORCE}[{before}] += {term}",), changes=(f"data.{FORCE}",))
