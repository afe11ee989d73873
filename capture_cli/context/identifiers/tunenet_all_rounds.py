"""TuneNet from every round of the same histories: a control, which has as much to learn from as others."""

from capture_cli.context.identifiers._examples import target_after_each
from capture_cli.context.identifiers._learned import LearnedIdentifier


class TuneNetAllRounds(LearnedIdentifier):
    """What `tunenet` is, trained to predict the change from rounds near the target as well."""

    summary = "tunenet, trained on every round of the histories: as much to learn from as capture has"
    fixed_window = 1
    residual = True

    examples = staticmethod(target_after_each)
