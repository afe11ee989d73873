"""A spring that rests elsewhere: MuJoCo's springref."""

from capture_cli.model.effects._joint_effect import SpringEffect
from capture_cli.model.parameters import Parameter


class SpringPreload(SpringEffect):
    """`shift` (m or rad) of where the joint's spring is at rest. Without a spring, see constant-force."""

    summary = "a joint's spring rests elsewhere than modelled"
    where = "every hinge and slide joint with a spring"

    @classmethod
    def suits(cls, model, joint):
        return model.jnt_stiffness[joint] > 0 or bool(model.jnt_stiffnesspoly[joint].any())

    @property
    def parameters(self):
        return (Parameter("shift", self.unit("m", "rad"), -self.travel, self.travel, 0.0),)

    def write(self, fields, values):
        fields["qpos_spring"][:, self.position] += values[:, 0]
