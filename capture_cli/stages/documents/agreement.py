"""Do the recordings of a log agree about the parameters?"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capture_cli.common.quantities import significant
from capture_cli.model.parameters import Parameter, ParameterSpace


@dataclass(frozen=True)
class Agreement:
    """Estimates of each recording alone: values, sd (recording, parameter). p_values (parameter,): of Cochran's Q.

    text: whether they agree, in words.
    """

    names: Sequence[str]
    values: np.ndarray
    sd: np.ndarray
    p_values: np.ndarray
    agree: bool
    text: str

    def document(self, space: ParameterSpace) -> dict[str, Any]:
        """As result files have it."""
        columns = zip(self.values.T.tolist(), self.sd.T.tolist(), self.p_values.tolist(), strict=True)
        rows = (dict(zip(("values", "sd", "p_value"), column, strict=True)) for column in columns)
        parameters = dict(zip(space.names, rows, strict=True))
        return {"names": self.names, "agree": self.agree, "parameters": parameters, "text": self.text}


def agreement(
    names: Sequence[str],
    values: np.ndarray,
    sd: np.ndarray,
    gain: float,
    space: ParameterSpace,
    identifiable: np.ndarray,
) -> Agreement:
    """Of estimates of each recording alone, values and sd (recording, parameter). identifiable (parameter,): by all
    together.

    By Cochran's Q per parameter, over those that the log determines, where recordings differ by what matters. gain: of
    the objective, by fits to each alone. Where that is no more than chance they agree, whatever Q says: friction that
    holds makes the error rough, and a fit to little data ends beside where its sensitivities say.
    """
    from scipy.special import chdtrc

    p_values = np.array([chdtrc(len(v) - 1, _cochran(v, s)) for v, s in zip(values.T, sd.T, strict=True)])
    spreads = [_spread(values[:, i], p) for i, p in enumerate(space)]
    # Of the value: of recordings that are as quiet as a simulation chance allows less than any use of a model
    # notices, and less than its time step and the shape of its laws are good for.
    matters = 0.01
    differ = identifiable & (np.array([share for share, _ in spreads]) > matters)
    telling = np.where(differ, p_values, 1.0)
    by_chance = float(chdtrc((len(values) - 1) * len(space), max(gain, 0.0)))
    disagree_p = 0.01  # of all parameters together, Bonferroni
    worst = int(np.argmin(telling))
    agree = bool(max(telling[worst] * len(space), by_chance) > disagree_p)
    if agree:
        text = f"The {len(names)} recordings agree"
    else:
        share, of = spreads[worst]
        text = (
            f"The {len(names)} recordings disagree, most about {space.names[worst]} "
            f"(spread {significant(100 * share, 2)} % {of}, p = {telling[worst]:.1g}): it changed between them, or "
            "stands in for something that did"
        )
    return Agreement(names, values, sd, p_values, agree, text)


def _cochran(values: np.ndarray, sd: np.ndarray) -> float:
    """Q of the values (recording,) and their standard deviations."""
    weight = 1 / np.square(sd)
    mean = (weight * values).sum() / weight.sum()
    return (weight * np.square(values - mean)).sum()


def _spread(values: np.ndarray, parameter: Parameter) -> tuple[float, str]:
    """The spread of the values (recording,) as a share of their mean, and the words for that.

    Of the bounds' span where the value is so near to 0, which it may be, that no share of it means anything.
    """
    value = abs(values.mean())
    near_zero = 1e-3  # of the bounds' span: ten of a fit's finite differences
    if parameter.low <= 0 <= parameter.high and value < near_zero * parameter.span:
        return float(np.ptp(values) / parameter.span), "of its bounds' span"
    return float(np.ptp(values) / value), "of its value"
