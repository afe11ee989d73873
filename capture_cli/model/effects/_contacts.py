"""What effects on contacts have in common: the geoms that have a say in them."""

from abc import abstractmethod
from collections.abc import Sequence
from functools import lru_cache

import mujoco
import numpy as np

from capture_cli.model.contacts import touching_pairs
from capture_cli.model.effects.base import GLOBAL, Effect
from capture_cli.model.object_names import object_name


class ContactEffect(Effect):
    """An effect on the contacts of a geom, of geoms of one make, or of an explicit <pair>; those are called GEOM+GEOM.

    pair: the pair's number, or -1; then geoms (geom,) are the geoms' numbers, and partners (partner,) are what they mix
    with.
    """

    where = (
        "geoms that have a say in a contact; those of one make together, as a robot's feet (GEOM+...); "
        "explicit pairs (GEOM+GEOM)"
    )

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        pairs = [_pair_name(model, k) for k in range(model.npair)]
        self.pair = pairs.index(site) if site in pairs else -1
        if self.pair < 0:
            self.geoms = self._geoms(model)[site]
            a, b = _touching_pairs(model).T
            touched = np.union1d(b[np.isin(a, self.geoms)], a[np.isin(b, self.geoms)])
            others = np.setdiff1d(touched, self.geoms)
            self.partners = others[model.geom_priority[others] == model.geom_priority[self.geoms[0]]]

    @classmethod
    def sites(cls, model):
        pairs = [_pair_name(model, k) for k in range(model.npair) if cls.pair_matters(model, k)]
        return [site for site in cls._geoms(model) if site not in pairs] + pairs

    @classmethod
    @lru_cache(maxsize=16)
    def _geoms(cls, model: mujoco.MjModel) -> dict[str, np.ndarray]:
        """Sites and their geoms, (geom,) each: those of one make together, then one by one."""
        a, b = _touching_pairs(model).T
        a, b = np.concatenate([a, b]), np.concatenate([b, a])
        rank = model.geom_priority
        says = (rank[a] > rank[b]) | ((rank[a] == rank[b]) & cls.decides(model, a, b))
        geoms = np.unique(a[says & cls.matters(model, a, b)])
        makes: dict[tuple, list[int]] = {}
        for geom in geoms:
            makes.setdefault(_make(model, geom), []).append(int(geom))
        groups = [make for make in makes.values() if len(make) > 1]
        return {_name(model, geoms): np.array(geoms) for geoms in [*groups, *([int(g)] for g in geoms)]}

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


@lru_cache(maxsize=16)
def _touching_pairs(model: mujoco.MjModel) -> np.ndarray:
    return touching_pairs(model)


def _make(model: mujoco.MjModel, geom: int) -> tuple:
    """What geoms of one make have in common: shape, size and material."""
    kind = (int(model.geom_type[geom]), int(model.geom_dataid[geom]), int(model.geom_priority[geom]))
    numbers = (model.geom_size, model.geom_friction, model.geom_solref, model.geom_solimp)
    return (*kind, *(float(x) for values in numbers for x in values[geom]))


def _name(model: mujoco.MjModel, geoms: Sequence[int]) -> str:
    return "+".join(object_name(model, "geom", int(g)) for g in geoms)


def _pair_name(model: mujoco.MjModel, pair: int) -> str:
    return _name(model, (model.pair_geom1[pair], model.pair_geom2[pair]))
