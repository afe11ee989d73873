"""Mass that a body carries and the model does not know of."""

import itertools

import mujoco
import numpy as np

from capture_cli.model.effects._places import ObjectEffect
from capture_cli.model.effects._rotation import body_vectors, product
from capture_cli.model.effects._scales import moving_bodies
from capture_cli.model.effects._turning_axes import axes_that_show, reach, turning_joints
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.fields import ModelFields
from capture_cli.model.parameters import Parameter


class Payload(ObjectEffect):
    """A point of `mass` (kg), fixed to a body at `x`, `y`, `z` (m) in the body's frame.

    Where the body can turn about one axis only, the place along it moves nothing, and is left out; where it
    cannot turn, the whole place is. Of bodies that are fixed to each other it is looked for at the first.
    """

    place, kind = "model", "body"
    summary = "a body carries mass that the model does not know of"
    where = "every moving body with mass"
    shapes = ("x", "y", "z")
    mixes = True

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.centre = model.body_ipos[self.number].copy()
        root, weld = model.body_rootid[self.number], model.body_weldid[self.number]
        self.tree = [b for b in moving_bodies(model) if model.body_rootid[b] == root]
        self.fixed = [b for b in self.tree if model.body_weldid[b] == weld]
        largest = max(reach(model, b, model.body_ipos[b]) for b in self.tree)
        self.farthest = max(largest, *(self._farthest(b) for b in self.fixed))
        # of a body that was compiled as `simple` MuJoCo cannot move the centre; those of a task never are
        shows = turning_joints(model, self.number) and not model.body_simple[self.number]
        self.axes = axes_that_show(model, self.number) if shows else np.zeros(0, dtype=int)

    @classmethod
    def suited(cls, model):
        return moving_bodies(model)

    @property
    def shows(self):
        return super().shows and self.number == self.fixed[0]

    @property
    def parameters(self):
        # a tool may weigh many times what its flange does: the range follows from the machine
        mass = Parameter("mass", "kg", 0.0, 2 * float(self.model.body_mass[self.tree].sum()), 0.0)
        places = (Parameter("xyz"[i], "m", -self.farthest, self.farthest, self.centre[i]) for i in self.axes)
        return (mass, *places)

    def shape_grid(self, count=5):
        """At the centre of mass, and as far on all sides of it as the body is large."""
        aside = reach(self.model, self.number, self.centre) * np.eye(len(self.axes))
        places = self.centre[self.axes] + np.concatenate([np.zeros((1, len(self.axes))), aside, -aside])
        return np.insert(places, 0, 0.0, axis=1)

    def mixture(self, shapes, amplitudes):
        """All their mass, where its centre is; no less of it than has their moment within reach.

        Of a body whose own mass is a parameter, a log tells the moment alone.
        """
        moment = amplitudes @ (shapes[:, 1:] - self.centre[self.axes])
        space = self.space
        below, above = (space.nominal - space.low)[1:], (space.high - space.nominal)[1:]
        farthest = np.where(moment > 0, above, below)
        share = max(amplitudes.sum(), *(np.abs(moment) / farthest), 0.0)
        aside = moment / share if share > 0 else moment
        return np.append(share * space.span[0], self.centre[self.axes] + aside)

    def _farthest(self, body: int) -> float:
        """m: how far from its own frame it may sit on a `body` that is fixed to its own, or is it."""
        data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, data)
        centre = data.xipos[body] - data.xpos[self.number]
        farthest = 3.0  # times the distance of the centre of mass; the end of a rod is at 2
        return max(farthest * float(np.linalg.norm(centre)), reach(self.model, body, centre))

    def write(self, fields, values):
        position = np.repeat(self.centre[None], len(values), axis=0)
        position[:, self.axes] = values[:, 1:]
        add_point_mass(fields, self.number, values[:, 0], position)


CONJUGATE = np.array([1, -1, -1, -1])
ALIGNED = 1 - 1e-9  # a direction this close to a principal axis is one


def add_point_mass(fields: ModelFields, body: int, mass: np.ndarray, position: np.ndarray) -> None:
    """Fix a point `mass` (simulation,), kg, to `body`, at `position` (simulation, 3), m, in its frame."""
    own, centre = fields["body_mass"][:, body].copy(), fields["body_ipos"][:, body].copy()
    total = own + mass
    fields["body_mass"][:, body] = total
    apart = position - centre
    if not apart.any():
        return
    fields["body_ipos"][:, body] += (mass / total)[:, None] * apart
    _add_spread(fields, body, own * mass / total, apart)


def _add_spread(fields: ModelFields, body: int, mass: np.ndarray, apart: np.ndarray) -> None:
    """Add the inertia of two masses, of reduced mass `mass`, that lie `apart` (simulation, 3)."""
    local = body_vectors(fields["body_iquat"][:, body] * CONJUGATE, apart)  # in the principal frame
    added = mass[:, None, None] * (
        np.square(local).sum(axis=1)[:, None, None] * np.eye(3) - local[:, :, None] * local[:, None, :]
    )
    moments = fields["body_inertia"][:, body]
    length = np.linalg.norm(apart, axis=1)
    along_axis = (np.abs(local) >= ALIGNED * length[:, None]).any(axis=1)
    moments[along_axis] += _diagonal(added)[along_axis]
    rows = np.flatnonzero(~along_axis & (mass != 0))
    if not rows.size:
        return
    moments[rows], turns = _principal(moments[rows, :, None] * np.eye(3) + added[rows])
    quaternions = fields["body_iquat"][:, body]
    quaternions[rows] = product(quaternions[rows], turns)


def _principal(inertia: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Moments (row, 3) and orientations (row, 4) of the principal frames of inertias (row, 3, 3), those that are turned
    least from the present ones.
    """
    from scipy.spatial.transform import Rotation

    moments, vectors = np.linalg.eigh(inertia)
    orders = np.array(list(itertools.permutations(range(3))))
    straight = np.abs(vectors[:, range(3), orders]).sum(axis=-1)  # (row, order)
    order = orders[straight.argmax(axis=1)]
    moments = np.take_along_axis(moments, order, axis=1)
    vectors = np.take_along_axis(vectors, order[:, None], axis=2)
    vectors *= np.where(_diagonal(vectors) < 0, -1.0, 1.0)[:, None]
    mirrored = np.flatnonzero(np.linalg.det(vectors) < 0)
    vectors[mirrored, :, np.abs(_diagonal(vectors[mirrored])).argmin(axis=1)] *= -1
    return moments, np.roll(Rotation.from_matrix(vectors).as_quat(), 1, axis=1)  # w first


def _diagonal(matrices: np.ndarray) -> np.ndarray:
    """(row, 3)"""
    return np.diagonal(matrices, axis1=1, axis2=2)
