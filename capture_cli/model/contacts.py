"""Which geoms of a model can touch, and whether anything can be hit."""

import mujoco
import numpy as np


def can_touch(model: mujoco.MjModel) -> bool:
    """Whether there can be a contact at all."""
    return bool(model.npair or model.nflex or len(touching_pairs(model)))


def can_hit(model: mujoco.MjModel) -> bool:
    """Whether bodies can touch, or joints or tendons come to an end of their range."""
    return bool(can_touch(model) or model.jnt_limited.any() or model.tendon_limited.any())


def touching_pairs(model: mujoco.MjModel) -> np.ndarray:
    """Pairs of geoms (pair, 2) that may collide by MuJoCo's filters, without those of explicit <pair>s."""
    first, second = np.triu_indices(model.ngeom, 1)
    kind, affinity = model.geom_contype, model.geom_conaffinity
    allowed = (kind[first] & affinity[second]) | (kind[second] & affinity[first])
    body_a, body_b = model.geom_bodyid[first], model.geom_bodyid[second]
    weld_a, weld_b = model.body_weldid[body_a], model.body_weldid[body_b]
    apart = (weld_a != weld_b) & ((model.body_treeid[body_a] >= 0) | (model.body_treeid[body_b] >= 0))
    if not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT:
        parent_a, parent_b = (model.body_weldid[model.body_parentid[weld]] for weld in (weld_a, weld_b))
        # a body does not touch its parent, unless that is the world
        apart &= ~((weld_a == parent_b) & (weld_a != 0)) & ~((weld_b == parent_a) & (weld_b != 0))
    signature = (np.minimum(body_a, body_b) << 16) + np.maximum(body_a, body_b)
    apart &= ~np.isin(signature, model.exclude_signature)
    keep = (allowed != 0) & apart
    pairs = np.stack([first[keep], second[keep]], axis=1)
    named = np.sort(np.stack([model.pair_geom1, model.pair_geom2], axis=1), axis=1)
    return pairs[~np.isin(pairs @ (model.ngeom, 1), named @ (model.ngeom, 1))]
