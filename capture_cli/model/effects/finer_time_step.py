"""Steps shorter than the model's."""

from capture_cli.model.effects.base import Effect


class FinerTimeStep(Effect):
    """The model's own motion, in steps that are 2, 4 or 8 times shorter.

    Machines know no steps. What MuJoCo's integrators leave out is of the first order in the step, and looks like a
    delay, or like damping. Controls are held over so many steps, and sensors read at the first of them. There is
    nothing to fit: the motion is this one, or it is not.
    """

    place = "model"
    summary = "the model's time step is too long for how it moves"
    where = "the model as a whole: a half, a quarter or an eighth of its step"
    parameters = ()

    @classmethod
    def sites(cls, model):
        return ["half", "quarter", "eighth"] if model.nv else []

    @property
    def variant_of(self):
        return ""  # a model has one step

    @property
    def substeps(self):
        return 2 ** (1 + self.sites(self.model).index(self.site))

    def write(self, fields, values):
        fields["opt.timestep"][...] /= self.substeps
        fields.substeps *= self.substeps
