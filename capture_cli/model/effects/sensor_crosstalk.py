"""A sensor that shows a motor's current: a magnetic encoder or a compass beside it, a load cell, a long cable."""

from functools import lru_cache

import mujoco

from capture_cli.model.effects._kernel import Companion, call
from capture_cli.model.effects._places import site_id
from capture_cli.model.effects._scales import actuator_force_scale, actuator_force_unit, driven_joint
from capture_cli.model.effects._sensor_effect import NumberEffect, columns_of, columns_source, quantity
from capture_cli.model.effects.base import GLOBAL
from capture_cli.model.object_names import object_name

NEAREST = 4  # actuators, of which a sensor may show the current

_S, _O, _T = mujoco.mjtSensor, mujoco.mjtObj, mujoco.mjtTrn
# Without the actuator of its own joint: there it is a transmission that gives, or the sensor's scale.
_OF_ACTUATOR = (_S.mjSENS_ACTUATORPOS, _S.mjSENS_ACTUATORVEL, _S.mjSENS_ACTUATORFRC)
_OF_JOINT = (_S.mjSENS_JOINTPOS, _S.mjSENS_JOINTVEL, _S.mjSENS_JOINTACTFRC)
# What an actuator acts on, by its kind of transmission; others act on several bodies
_DRIVES = {
    int(_T.mjTRN_JOINT): int(_O.mjOBJ_JOINT),
    int(_T.mjTRN_JOINTINPARENT): int(_O.mjOBJ_JOINT),
    int(_T.mjTRN_SITE): int(_O.mjOBJ_SITE),
    int(_T.mjTRN_BODY): int(_O.mjOBJ_BODY),
}


def picked_up(series, force, *, share):
    """series + share force, share one number or one for each column."""
    return series + share * force


class SensorCrosstalk(NumberEffect):
    """The sensor reports, beside what is there, `share` (or `x`, `y` and `z`), in its unit per N or N m, of the force
    that an actuator gives: its current, which goes with that, is picked up. SENSOR+ACTUATOR.

    It is added to what is there before any other effect on the sensor.
    """

    summary = "a sensor picks up a motor's current: an encoder or a compass beside it, a load cell"
    where = "every sensor but those of orientation, with actuators next to it that do not drive its own joint"
    reads_actuators = True
    number_by_number = True

    def __init__(self, model: mujoco.MjModel, site: str = GLOBAL):
        super().__init__(model, site)
        self.sensor, self.actuator = _places(model)[site]

    @classmethod
    def sites(cls, model):
        return list(_places(model))

    @property
    def columns(self):
        return columns_of(self.model, self.sensor)

    @property
    def quantity(self):
        return quantity(self.model, self.sensor)

    @property
    def parameters(self):
        unit = f"{self.quantity.unit} per {actuator_force_unit(self.model, self.actuator)}"
        strongest = actuator_force_scale(self.model, self.actuator)
        most = 1.0  # of what a sensor commonly shows, from the largest force of an actuator
        return self.for_each("share", unit, most * self.quantity.size / strongest)

    @property
    def most_picked_up(self):
        picked_up = super().most_picked_up
        picked_up[self.columns] = self.space.high.max() * actuator_force_scale(self.model, self.actuator)
        return picked_up

    def coefficients(self, values):
        return {"share": self.of_all(values)}

    def pick_up(self, sensors, values, actuator_force):
        reported, force = sensors.copy(), actuator_force[..., [self.actuator]]
        share = self.of_all(values)[:, None]
        reported[..., self.columns] = picked_up(reported[..., self.columns], force, share=share)
        return reported

    def measure(self, sensors, values, timestep, **_):
        return sensors

    def companion(self, name, values):
        force = f"data.actuator_force[{self.actuator}]"
        (shares,) = self.of_all(values[None])
        shares = {"share": shares if len(shares) > 1 else shares[0]}
        reported, _ = call(name, picked_up, ["data.sensordata[at]", force], shares)
        at = columns_source(self.model, object_name(self.model, "sensor", self.sensor))
        return Companion((picked_up,), (), after=(f"at = {at}", f"data.sensordata[at] = {reported}"))


@lru_cache(maxsize=16)
def _places(model: mujoco.MjModel) -> dict[str, tuple[int, int]]:
    """Sites: a sensor and an actuator."""
    places = {}
    for site in NumberEffect.sites(model):
        sensor = site_id(model, "sensor", site)
        for actuator in _next_to(model, sensor):
            places[f"{site}+{object_name(model, 'actuator', actuator)}"] = sensor, actuator
    return places


def _next_to(model: mujoco.MjModel, sensor: int) -> list[int]:
    """Actuators, those with the fewest bodies between them and the sensor first."""
    joint = _joint(model, sensor)
    others = [a for a in range(model.nactuator) if joint < 0 or driven_joint(model, a) != joint]
    where = _bodies_above(
        model, _body(model, int(model.sensor_objtype[sensor]), int(model.sensor_objid[sensor]))
    )
    between = {a: len(where ^ _bodies_above(model, _body(model, int(_O.mjOBJ_ACTUATOR), a))) for a in others}
    return sorted(others, key=between.get)[:NEAREST]


def _joint(model: mujoco.MjModel, sensor: int) -> int:
    """The joint that a sensor is of; -1 where it is of none."""
    kind, which = mujoco.mjtSensor(int(model.sensor_type[sensor])), int(model.sensor_objid[sensor])
    if kind in _OF_JOINT:
        return which
    return driven_joint(model, which) if kind in _OF_ACTUATOR else -1


def _body(model: mujoco.MjModel, kind: int, which: int) -> int:
    """The body that an object is on; the world where it is on none alone, as a tendon."""
    if kind == _O.mjOBJ_ACTUATOR:
        kind, which = _DRIVES.get(int(model.actuator_trntype[which]), -1), int(model.actuator_trnid[which, 0])
    match kind:
        case _O.mjOBJ_JOINT:
            return int(model.jnt_bodyid[which])
        case _O.mjOBJ_SITE:
            return int(model.site_bodyid[which])
        case _O.mjOBJ_GEOM:
            return int(model.geom_bodyid[which])
        case _O.mjOBJ_CAMERA:
            return int(model.cam_bodyid[which])
        case _O.mjOBJ_BODY | _O.mjOBJ_XBODY:
            return which
    return 0


def _bodies_above(model: mujoco.MjModel, body: int) -> set[int]:
    """A body and all that it hangs on, but for the world."""
    above = set()
    while body:
        above.add(body)
        body = int(model.body_parentid[body])
    return above
