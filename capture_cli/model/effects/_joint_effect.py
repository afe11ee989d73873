"""What effects at a hinge or slide joint share."""

from abc import abstractmethod

import mujoco

from capture_cli.model.effects._places import site_id
from capture_cli.model.effects._scales import (
    HINGE,
    SLIDE,
    characteristic_force,
    characteristic_speed,
    inertia,
    travel,
)
from capture_cli.model.effects.base import GLOBAL, Effect, JointMotion
from capture_cli.model.object_names import object_name


class JointEffect(Effect):
    """An effect at a joint with one degree of freedom. `is_hinge` decides between rad and m.

    seen: the joint's motion in the log that the effect is looked for in, which may be a small part of what it can do.
    """

    where = "every hinge and slide joint"
    seen: JointMotion | None = None

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.joint_name = self.joint_at(model, site)
        self.joint = site_id(model, "joint", self.joint_name)
        self.dof = int(model.jnt_dofadr[self.joint])
        self.is_hinge = int(model.jnt_type[self.joint]) == HINGE

    def look_in(self, log):
        super().look_in(log)
        self.seen = log.seen.get(self.joint)

    @classmethod
    def sites(cls, model: mujoco.MjModel) -> list[str]:
        return [
            object_name(model, "joint", j) for j in range(model.njnt) if model.jnt_type[j] in (HINGE, SLIDE)
        ]

    @classmethod
    def joint_at(cls, model: mujoco.MjModel, site: str) -> str:
        """The name of the joint that it sits at."""
        return site

    @property
    def characteristic_force(self) -> float:
        """N or N m."""
        return characteristic_force(self.model, self.joint)

    @property
    def characteristic_speed(self) -> float:
        """m/s or rad/s."""
        speed = characteristic_speed(self.model, self.joint)
        return min(speed, self.seen.speed) if self.seen else speed

    @property
    def travel(self) -> float:
        """m or rad: half of how far the joint goes, whatever a log saw."""
        return travel(self.model, self.joint)

    @property
    def middle(self) -> float:
        """m or rad: of where the joint goes in the log, or else of its range."""
        if self.seen:
            return (self.seen.low + self.seen.high) / 2
        return float(self.model.jnt_range[self.joint].mean()) if self.model.jnt_limited[self.joint] else 0.0

    @property
    def reach(self) -> float:
        """m or rad: how far about the middle the joint goes in the log, or else in its range."""
        return self.seen.travel if self.seen else self.travel

    @property
    def characteristic_travel(self) -> float:
        """m or rad: half of how far it goes in the log."""
        return min(self.travel, self.seen.travel) if self.seen else self.travel

    @property
    def inertia(self) -> float:
        """kg or kg m^2."""
        return inertia(self.model, self.joint)

    def unit(self, slide: str, hinge: str) -> str:
        """The unit of a quantity of this joint."""
        return hinge if self.is_hinge else slide


class SpringEffect(JointEffect):
    """An effect on where a joint's spring is at rest; `position` is the joint's place in qpos."""

    place = "model"

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.position = int(model.jnt_qposadr[self.joint])

    @classmethod
    def sites(cls, model):
        return [s for s in super().sites(model) if cls.suits(model, site_id(model, "joint", s))]

    @classmethod
    @abstractmethod
    def suits(cls, model: mujoco.MjModel, joint: int) -> bool:
        """Whether the joint's spring, or that it has none, lets the effect sit there."""
