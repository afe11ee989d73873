"""A centre of mass that lies elsewhere than modelled."""

from capture_cli.model.effects._scales import moving_bodies
from capture_cli.model.effects._shift import Shift
from capture_cli.model.effects._turning_axes import turning_joints


class ComShift(Shift):
    """Shift (m) of a body's centre of mass along the axes of the body's frame; the mass stays as it is.

    A shift along the only axis that the body can turn about moves nothing, and is left out. So are bodies
    that no joint turns, and bodies that were compiled as `simple`, whose centre MuJoCo cannot move; those of
    a task never are.
    """

    summary = "a body's centre of mass lies elsewhere than modelled"
    where = "every body with mass that some joint can turn"
    kind, field = "body", "body_ipos"

    @staticmethod
    def carrier(model, number):
        return number

    @classmethod
    def suited(cls, model):
        return [b for b in moving_bodies(model) if not model.body_simple[b] and turning_joints(model, b)]
