"""What effects of the medium that a machine moves in share."""

from capture_cli.model.effects._scales import moving_bodies
from capture_cli.model.effects.base import GLOBAL, Effect


class MediumEffect(Effect):
    """An effect of the medium on all bodies."""

    place = "model"
    where = "the model as a whole"

    @classmethod
    def sites(cls, model):
        return [GLOBAL] if moving_bodies(model) else []
