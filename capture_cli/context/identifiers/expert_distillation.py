"""Expert distillation (paper, Section IV-B; Laskin et al. 2022): from the source to the target in one iteration."""

from capture_cli.context.identifiers._examples import target_after_the_first
from capture_cli.context.identifiers._learned import LearnedIdentifier


class ExpertDistillation(LearnedIdentifier):
    """The paper's model, trained on one-iteration adaptation: one round under the source, then the target.

    It learns no history, so each new round is all that it reads.
    """

    summary = "a transformer trained to jump from a random source to the target in one round"
    fixed_window = 1

    examples = staticmethod(target_after_the_first)
