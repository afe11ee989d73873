"""CAPTURE with one token a trajectory, and the residual shown: ours, beside the paper's network."""

from capture_cli.context.identifiers._examples import next_parameters
from capture_cli.context.identifiers._learned import LearnedIdentifier


class CaptureTrajectory(LearnedIdentifier):
    """Learns what `capture` does, from the same histories by the same loss, and reads a round in four tokens.

    That of the measured trajectory holds the residual, too, plain and through asinh: the network need not learn to
    subtract, and sees small differences near the target.
    """

    summary = "ours: learns as capture does, with one token a trajectory that shows the residual"
    tokens = "trajectory"

    examples = staticmethod(next_parameters)
