"""TuneNet (Allevato et al. 2020) with a transformer for its network, as the paper compares it (Section IV-B)."""

from capture_cli.context.identifiers._examples import target_after_the_first
from capture_cli.context.identifiers._learned import LearnedIdentifier


class TuneNet(LearnedIdentifier):
    """Predicts the residual update from the current parameters to the target, from one round, again and again."""

    summary = "a transformer that predicts the change of the parameters, from one round at a time"
    fixed_window = 1
    residual = True

    examples = staticmethod(target_after_the_first)
