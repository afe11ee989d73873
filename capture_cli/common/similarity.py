"""How alike two effects are in what they do."""

import numpy as np


def similarity(a: np.ndarray, b: np.ndarray) -> float:
    """Cosine of two responses (row,): 1 where no parameter value could tell the effects apart; 0 of rows of two kinds,
    of outputs and of accelerations.
    """
    if len(a) != len(b):
        return 0.0
    norm = np.linalg.norm(a) * np.linalg.norm(b)
    return float(a @ b / norm) if norm > 0 else 0.0
