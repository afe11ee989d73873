"""CAPTURE (paper, Section III-D): distils the search that the histories show, by predicting its next parameters."""

from capture_cli.context.identifiers._examples import next_parameters
from capture_cli.context.identifiers._learned import LearnedIdentifier


class Capture(LearnedIdentifier):
    """Reads the last rounds of a history and proposes the next parameters, as the search would have chosen them.

    The search that is distilled is that of the histories: randomised binary in the paper, linear interpolation and
    plain binary in its ablations. The network is the paper's: 2 + 2 T tokens a round, the squared error. The head of
    the uncertainty, which is ours, shares no weights with it.
    """

    summary = "the paper's: the next parameters of the search, from the last rounds; 2 + 2T tokens a round"
    tokens = "step"

    examples = staticmethod(next_parameters)
