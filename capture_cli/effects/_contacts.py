"""Which geoms of a model can touch."""

from __future__ import annotations

from abc import abstractmethod

import mujoco
import numpy as np

from capture_cli.effects._places import site_id, site_name
from capture_cli.effects.base import GLOBAL, Effect


def touching_pairs(model: mujoco.MjModel) -> np.ndarray:
    """Pairs of geoms (pair, 2) that may collide by MuJoCo's filters, without those of explicit <pair>s."""
    first, second = np.triu_indices(model.ngeom, 1)
    kind, affinity = model.geom_contype, model.geom_conaffinity
    allowed = (kind[first] & affinity[second]) | (kind[second] & affinity[first])
    body_a, body_b = model.geom_bodyid[first], model.geom_bodyid[second]
    weld_a, weld_b = model.body_weldid[body_a], model.body_weldid[body_b]
    apart = weld_a != weld_b
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


class ContactEffect(Effect):
    """An effect on the contacts of a geom, or on those of an explicit <pair>, called GEOM+GEOM.

    pair: the pair's number, or -1; then geom is the geom's, and partners (partner,) are what it mixes with.
    """

    where = "every geom that has a say in some contact, every explicit pair (GEOM+GEOM)"

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        pairs = [_pair_name(model, k) for k in range(model.npair)]
        self.pair = pairs.index(site) if site in pairs else -1
        if self.pair < 0:
            self.geom = site_id(model, "geom", site)
            pairs = touching_pairs(model)
            touched = np.concatenate([pairs[pairs[:, 0] == self.geom, 1], pairs[pairs[:, 1] == self.geom, 0]])
            self.partners = touched[model.geom_priority[touched] == model.geom_priority[self.geom]]

    @classmethod
    def sites(cls, model):
        a, b = touching_pairs(model).T
        a, b = np.concatenate([a, b]), np.concatenate([b, a])
        rank = model.geom_priority
        says = (rank[a] > rank[b]) | ((rank[a] == rank[b]) & cls.decides(model, a, b))
        geoms = np.unique(a[says & cls.matters(model, a, b)])
        pairs = (k for k in range(model.npair) if cls.pair_matters(model, k))
        return [site_name(model, "geom", int(g)) for g in geoms] + [_pair_name(model, k) for k in pairs]

    @staticmethod
    @abstractmethod
    def decides(model: mujoco.MjModel, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Whether geoms a have a say in their contacts with geoms b of the same priority, (pair,)."""

    @staticmethod
    @abstractmethod
    def matters(model: mujoco.MjModel, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Whether the effect can change anything in contacts of a with b, where a decides, (pair,)."""

    @staticmethod
    @abstractmethod
    def pair_matters(model: mujoco.MjModel, pair: int) -> bool:
        """Whether the effect can change anything in the contacts of an explicit pair."""


def _pair_name(model: mujoco.MjModel, pair: int) -> str:
    geoms = (model.pair_geom1[pair], model.pair_geom2[pair])
    return "+".join(site_name(model, "geom", int(g)) for g in geoms)
