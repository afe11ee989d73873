"""A sensor that is mounted elsewhere on its body than modelled: an IMU, a marker, a tracker."""

import mujoco
import numpy as np

from capture_cli.model.effects._shift import Shift
from capture_cli.model.effects._turning_axes import turning_joints

SITE = int(mujoco.mjtObj.mjOBJ_SITE)
_S = mujoco.mjtSensor
PLACED = [  # what they report depends on where they sit
    int(kind)
    for kind in (
        _S.mjSENS_FRAMEPOS,
        _S.mjSENS_FRAMELINVEL,
        _S.mjSENS_FRAMELINACC,
        _S.mjSENS_ACCELEROMETER,
        _S.mjSENS_VELOCIMETER,
        _S.mjSENS_TORQUE,
        _S.mjSENS_RANGEFINDER,
    )
]


class SiteShift(Shift):
    """Shift (m) of a site, with the sensors at it, along the axes of its body's frame: the lever arm of an IMU, the
    place of a marker.

    A shift along the only axis that the body can turn about shows at most as a steady offset, which is a sensor-bias,
    and is left out. So are sites that an actuator, a tendon or a constraint holds on to.
    """

    summary = (
        "a sensor sits elsewhere on its body: the lever arm of an IMU, a marker that was stuck on by hand"
    )
    where = (
        "every site of a body that some joint can turn, if a sensor of motion or torque is all that is there"
    )
    kind, field = "site", "site_pos"

    @staticmethod
    def carrier(model, number):
        return int(model.site_bodyid[number])

    @classmethod
    def suited(cls, model):
        free = sorted(_sensed(model) - _held(model))
        return [s for s in free if turning_joints(model, model.site_bodyid[s])]

    @property
    def reported(self):
        model = self.model
        own = np.flatnonzero((model.sensor_objtype == SITE) & (model.sensor_objid == self.number))
        shown = [s for s in own if model.sensor_type[s] in PLACED]
        return frozenset(int(model.sensor_adr[s]) + k for s in shown for k in range(int(model.sensor_dim[s])))

    @property
    def shows(self):
        return bool(self.logged & self.reported)


def _sensed(model: mujoco.MjModel) -> set[int]:
    """Sites with a sensor that shows where they are."""
    here = (model.sensor_objtype == SITE) & np.isin(model.sensor_type, PLACED)
    return {int(s) for s in model.sensor_objid[here]}


def _held(model: mujoco.MjModel) -> set[int]:
    """Sites that are more than a place to sense at."""
    by_site = [int(mujoco.mjtTrn.mjTRN_SITE), int(mujoco.mjtTrn.mjTRN_SLIDERCRANK)]
    driven = model.actuator_trnid[np.isin(model.actuator_trntype, by_site)].ravel()
    on_path = model.wrap_objid[model.wrap_type == int(mujoco.mjtWrap.mjWRAP_SITE)]
    tied = model.eq_objtype == SITE
    ends = np.concatenate([model.eq_obj1id[tied], model.eq_obj2id[tied]])
    return {int(s) for s in np.concatenate([driven, on_path, ends])}
