"""What `diagnosis.json` says against an effect, in words."""

import math
from collections.abc import Mapping
from typing import Any

A_CORRECTION = "a correction of a model that is wrong otherwise"
# by reason, with its facts
SENTENCES = {
    "diverged": "every simulation with it diverged",
    "moves-nothing": "it moves no output of this log",
    "no-column": "it moves nothing in this log, or only with the wrong sign",
    "imitated": "parameters that are in the model imitate it: this log cannot tell it from them",
    "no-score": "it explains nothing (score {score:.2g})",
    "predicts-no-better": "blocks that were not fitted are not predicted better (log likelihood {gain:.3g} with a "
    "standard error of {standard_error:.2g})",
    "behind-at-first-sight": "explains no more at first sight ({score:.3g}; {most:.3g} the best)",
    "promised-little": "its score beside fewer effects promised far less than a fit takes",
    "not-asked": "not asked: simulations alone tell of it, and the force balance found another",
    "at-end": "it would have to be at the end of its range ({parameter} = {value:.3g})",
    "not-believed": "{text}",
    "drives-to-bound": "it drives {parameter} to its bound ({value:.3g})",
    "promises-too-little": "its score test promises {promised:.4g} noise floors where {left:.4g} are left: too little",
    "far-behind": "fitted jointly it stays far behind {rival}",
    "no-gain": "fitted jointly it explains nothing more",
    "slight": "it takes {share:.1%} of what is above the noise floor: that is no explanation of it",
    "little-was-left": "the model without it leaves little, {before:.3g} times the noise floor, and with it "
    f"{{after:.3g}} are left all the same: {A_CORRECTION}",
    "minor": "it takes {share:.1%} of what the declared model left above the noise floor, and with it something is "
    f"left all the same: {A_CORRECTION}",
    "leaves-something": "fitted jointly it leaves {after:.4g} times the noise floor",
    "coarser-does-not-hold": "{rival} takes half of what this does, or more, and does not hold",
    "not-from-zero": "its size cannot be told from zero (p = {p:.2g} over all candidates)",
    "not-worth-parameters": "it is not worth its parameters (BIC rises by {bic:.3g})",
    "not-better-held-out": "data that was not fitted is not explained better (p = {p:.2g})",
    "less-does-it": "{best} explains as much with less, or more",
    "does-not-hold": "fitted in the place of {place} it does not hold",
    "tied": "tied with {best}: this log cannot tell them apart",
    "steps-as-well": "{best} does as well, and so do steps of this length",
    "explains-less": "{best} explains more",
    "explains-enough": "{best} explains more; but with it, too, no more is left than chance allows",
    "more-parameters": "no better than {best}, with more parameters",
    "beaten": "another explains more, and {best} more than that",
    "better-apart": "better at each of its places on its own",
    "out-of-time": "not decided: the time was over",
}


def sentence(rejection: Mapping[str, Any] | None) -> str | None:
    """Of `candidates[].rejection`; None of none."""
    if rejection is None:
        return None
    facts = {name: math.nan if value is None else value for name, value in rejection["facts"].items()}
    text = SENTENCES[rejection["reason"]].format(**facts)
    return f"with the other effects in: {text}" if rejection["beside_others"] else text
