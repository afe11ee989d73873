"""What moves along with a tendon: MuJoCo's armature of it."""

import mujoco
import numpy as np

from capture_cli.model.effects._raised import Raised
from capture_cli.model.effects._tendon_effect import TendonEffect, moving_dofs, wraps

GEOMS = [int(w) for w in (mujoco.mjtWrap.mjWRAP_SPHERE, mujoco.mjtWrap.mjWRAP_CYLINDER)]


class TendonInertia(Raised, TendonEffect):
    """`armature` (kg, or kg m^2 over hinges) is added to the tendon's: what speeds up as its length does, and is felt
    by all joints that it couples, each by its lever.
    """

    summary = (
        "what speeds up along with a tendon: the drum that winds it up and its motor, a piston and its oil"
    )
    field = "tendon_armature"
    where = "every tendon that joints which hang on each other move, and that no geom turns aside"

    @classmethod
    def suits(cls, model, tendon):
        """MuJoCo has no inertia along tendons that geoms turn aside, and none that couples one branch to another."""
        turned_aside = np.isin(wraps(model, tendon), GEOMS).any()
        return (
            super().suits(model, tendon) and not turned_aside and _is_chain(model, moving_dofs(model, tendon))
        )

    @property
    def parameters(self):
        most = 2.0  # times the inertia that the tendon moves
        return self.added("armature", self.unit("kg", "kg m^2"), most * self.inertia)


def _is_chain(model: mujoco.MjModel, dofs: np.ndarray) -> bool:
    """Whether each of the degrees of freedom, in order, is moved by the one before it."""
    above, dof = set(), int(dofs[-1])
    while dof >= 0:
        above.add(dof)
        dof = int(model.dof_parentid[dof])
    return above.issuperset(dofs.tolist())
