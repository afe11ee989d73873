"""Expert distillation from every round of the same histories: a control, which has as much to learn from as others."""

from capture_cli.context.identifiers._examples import target_after_each
from capture_cli.context.identifiers._learned import LearnedIdentifier


class ExpertDistillationAllRounds(LearnedIdentifier):
    """What `expert-distillation` is, trained to jump to the target from rounds near it as well."""

    summary = (
        "expert-distillation, trained on every round of the histories: as much to learn from as capture has"
    )
    fixed_window = 1

    examples = staticmethod(target_after_each)
