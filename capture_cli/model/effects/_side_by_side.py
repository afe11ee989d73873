"""Two springs side by side, which are one."""

import numpy as np


def side_by_side(
    own: np.ndarray, rest: np.ndarray, added: np.ndarray, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness, and where it is at rest, of a spring `own` that rests at `rest` and one `added` that rests at `at`.

    All broadcast; without any stiffness it rests where the first does.
    """
    both = own + added
    shift = np.divide(added * (at - rest), both, out=np.zeros_like(rest), where=both != 0)
    return both, rest + shift
