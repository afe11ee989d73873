"""Ours: the transformer proposes, the simulator refines, and the two are weighed by their uncertainty."""

from capture_cli.context.identifiers._examples import target_after_each
from capture_cli.context.identifiers._label_refinement import LabelRefinement
from capture_cli.context.identifiers._learned import LearnedIdentifier
from capture_cli.context.identifiers._refinement import Refinement
from capture_cli.context.identifiers.base import Rounds


class CaptureRefined(LearnedIdentifier):
    """The target's in-context posterior as the prior of a fit through the simulator to all rounds so far.

    The transformer reads the whole history, as `posterior` does, and its mean and covariance are a Gaussian prior: a
    start near the target where a descent from anywhere else may end in a wrong valley, and an answer about what no
    round has shown. Gauss-Newton then makes the rounds agree (`_refinement`); where their noise keeps them from it, a
    regression over many points says what they tell (`_cloud`). Where they show a label, which has no slope, the
    posterior of every value takes the place of both (`_label_refinement`).
    """

    summary = (
        "ours: the transformer's posterior, refined by least squares (labels: likelihood) in the simulator"
    )
    default_window = None
    likelihood = True
    any_order = True
    simulates = True

    examples = staticmethod(target_after_each)

    def __init__(self, signature, start, *, model, **options):
        super().__init__(signature, start, model=model, **options)
        if self.simulate is None:
            raise TypeError("capture-refined needs `simulate`")
        self._asked = self._best
        labels = [f.name for f in signature.features] == ["label"] and len(signature.space) == 1
        self._refinement = (
            LabelRefinement(signature, len(self.start), self.simulate, self.error_rate)
            if labels
            else Refinement(signature, len(self.start), self.simulate, rough=self.rough)
        )

    def ask(self):
        return self._asked[:, None]

    def recall(self, earlier: Rounds) -> None:
        super().recall(earlier)
        self._refinement.recall(earlier)

    def tell(self, actions, simulated, measured) -> None:
        super().tell(actions, simulated, measured)
        self.prediction = self._refinement.refine(
            self.prediction, self._asked, actions, simulated[:, 0], measured
        )
        self._best = self.prediction.mean
        self._asked = self._refinement.question(self._best)
        self.simulated_rollouts = self._refinement.rollouts.copy()
