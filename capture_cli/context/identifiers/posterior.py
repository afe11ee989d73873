"""The target's in-context posterior: ours, beside the paper's imitation of a search."""

from capture_cli.context.identifiers._examples import target_after_each
from capture_cli.context.identifiers._learned import LearnedIdentifier


class Posterior(LearnedIdentifier):
    """Reads a whole history and gives mean and covariance of the target, by maximum likelihood.

    The best guess is asked for next. Where the search hides what it knows (its next parameters are drawn at random),
    this uses it at once; and the covariance says how far to trust it. Trained on rounds in random order: its own
    questions come near the target far sooner than those of a search.
    """

    summary = "ours: mean and covariance of the target given the whole history"
    default_window = None
    likelihood = True
    any_order = True

    examples = staticmethod(target_after_each)
