"""Writing a model with its identified values back to MJCF, to full precision."""

import ctypes
import os
from contextlib import contextmanager
from pathlib import Path

import mujoco
import numpy as np

from capture_cli.common.documents import resolved
from capture_cli.errors import ModelError
from capture_cli.model.fields import ModelFields, model_field
from capture_cli.model.mjcf.assets import name_from, name_in_full
from capture_cli.model.mjcf.impossible_inertia import impossible_inertias, without_rounding
from capture_cli.model.mjcf.model_file import MUJOCO_ERRORS, free_centres, refuse_not_finite, refused

_UNNAMED = "without a name: "
# of what a model is made of; a file that is loaded again has as many
_SIZES = [
    "nq",
    "nv",
    "nu",
    "nbody",
    "ngeom",
    "nsite",
    "ntendon",
    "neq",
    "nsensordata",
    "nmeshvert",
    "ntexdata",
    "nkey",
]


def to_mjcf(source: Path, fields: ModelFields, target: Path, header: str = "") -> str:
    """The MJCF at `source` with the values of `fields` (of one simulation), for a file at `target`.

    It was loaded from there once. header: a comment that it begins with.
    Raises ModelError where a value, or the model, cannot be written in MJCF.
    """
    _refuse_impossible(source, fields)
    with refused(source):
        spec = mujoco.MjSpec.from_file(str(source))
        assets = name_in_full(spec)
    folders = _point_at_folders(spec, source, target) if assets else {}
    from_geoms = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    if "geom_size" in fields.values or (from_geoms and any(n.startswith("body_") for n in fields.values)):
        _fix_inertia(spec)
    if "qpos_spring" in fields.values and spec.tendons:
        _fix_rest_lengths(spec)
    if "actuator_biastype" in fields.values:
        for actuator, kind in zip(spec.actuators, fields["actuator_biastype"][0], strict=True):
            actuator.biastype = mujoco.mjtBias(int(kind))
    simple = [body.simple for body in spec.bodies]
    if "body_ipos" in fields.values:
        free_centres(spec, [body.name for body in spec.bodies])
    with refused(source):
        model = spec.compile()
    geoms = _geoms_of(source, fields.model) if model.ngeom > fields.model.ngeom else slice(None)
    _fix_gains(spec, model)
    for name, values in fields.values.items():
        if name != "actuator_biastype":  # set above
            _assign(model, name, values[0], geoms)
    try:
        mujoco.mj_setConst(model, mujoco.MjData(model))
        refuse_not_finite(source, model, cure="look at the values that were found, and identify again")
        spec.copy_back(model)
        for body, was in zip(spec.bodies, simple, strict=True):
            body.simple = was
        with _full_precision():
            text = header + name_from(spec.to_xml(), assets, folders)
    except MUJOCO_ERRORS as error:
        raise ModelError(
            f"{source}: these values cannot be written as MJCF: {error}",
            cure=_cure(str(error)),
        ) from error
    _refuse_what_does_not_load(text, source, target, model)
    return text


def _refuse_impossible(source: Path, fields: ModelFields) -> None:
    """What MuJoCo would refuse, or, where the model asks for balanceinertia, quietly change."""
    impossible = impossible_inertias(fields)
    if impossible:
        raise ModelError(
            f"{source}: {'; '.join(i.text for i in impossible)}",
            cure=f"{impossible[0].cure}, and identify again",
        )


def _cure(message: str) -> str:
    """What mends a model whose values MuJoCo will not write, by its `message`."""
    if "inertiafromgeom" in message:  # of a model that is attached: the model's own was dealt with
        return 'write inertiafromgeom="auto" in the <compiler> of the attached model, and identify again'
    if "settotalmass" in message:
        return (
            "remove settotalmass from the <compiler>, give the bodies in the model file the masses that they should "
            "have, and identify again"
        )
    return "give the elements that parameters set explicit attributes in the model file"


def _fix_inertia(spec: mujoco.MjSpec) -> None:
    """Write the inertia of every body down, or it would follow its geoms, with their new sizes."""
    model = spec.compile()
    if spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    for body in spec.bodies[1:]:
        body.explicitinertial = True
        body.mass = model.body_mass[body.id]
        body.ipos, body.iquat = model.body_ipos[body.id], model.body_iquat[body.id]
        body.fullinertia = np.full(6, np.nan)  # not given: it is in iquat and inertia now
        body.inertia = model.body_inertia[body.id]


def _fix_gains(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Write down what dampratio and springdamper came to in `model`, or they would follow the inertia, which is new."""
    for actuator in spec.actuators:
        if actuator.biasprm[2] > 0:  # a dampratio, where it is one at all
            actuator.biasprm = model.actuator_biasprm[actuator.id]
    for joint in spec.joints:
        if np.any(joint.springdamper):
            joint.springdamper = np.zeros(2)
            joint.stiffness[0] = model.jnt_stiffness[joint.id]
            joint.damping[0] = model.dof_damping[model.jnt_dofadr[joint.id]]


def _fix_rest_lengths(spec: mujoco.MjSpec) -> None:
    """Write the rest lengths of tendons down, or they would follow the joints, whose springs rest elsewhere now."""
    for tendon, lengths in zip(spec.tendons, spec.compile().tendon_lengthspring, strict=True):
        tendon.springlength = lengths


def _geoms_of(source: Path, model: mujoco.MjModel) -> np.ndarray:
    """Which geoms of the MJCF at `source` those of the `model` are, which is without those only looked at, (geom,)."""
    spec = mujoco.MjSpec.from_file(str(source))
    for number, geom in enumerate(spec.geoms):
        geom.name = geom.name or f"{_UNNAMED}{number}"
    names = [geom.name for geom in spec.geoms]
    spec.compiler.discardvisual = True
    return np.array([names.index(g.name) for g in map(spec.compile().geom, range(model.ngeom))], dtype=int)


def _assign(model: mujoco.MjModel, name: str, value: np.ndarray, geoms: np.ndarray | slice) -> None:
    if name.startswith("opt.") and np.ndim(value) == 0:
        setattr(model.opt, name[4:], float(value))
    elif name == "body_inertia":
        model.body_inertia[:] = without_rounding(value)
    elif name.startswith("geom_"):
        model_field(model, name)[geoms] = value
    else:
        model_field(model, name)[...] = value


def _point_at_folders(spec: mujoco.MjSpec, source: Path, target: Path) -> dict[str, Path]:
    """Make asset folders, which are relative to the model file, right for where the new one will lie.

    Returns the whole path of each, by what MJCF calls it.
    """
    there = target.parent.resolve()
    folders = {}
    for key in ("meshdir", "texturedir"):
        folder = resolved(source.parent / getattr(spec, key))
        # one that is not there, since only attached models have assets, leads nowhere, not even up again
        folders[key] = folder if folder.is_dir() else there
        setattr(spec, key, "" if folders[key] == there else os.path.relpath(folders[key], there))
    return folders


def _refuse_what_does_not_load(text: str, source: Path, target: Path, model: mujoco.MjModel) -> None:
    """Raise ModelError where MuJoCo does not make of `text`, at `target`, a model of the sizes of `model`."""
    try:
        spec = mujoco.MjSpec.from_string(text)
        spec.modelfiledir = str(target.parent.resolve())
        loaded = spec.compile()
        other = [name for name in _SIZES if getattr(loaded, name) != getattr(model, name)]
        wrong = ", ".join(f"{name} = {getattr(loaded, name)}, not {getattr(model, name)}" for name in other)
    except MUJOCO_ERRORS as error:
        wrong = str(error)
    if wrong:
        raise ModelError(
            f"{source}: as one MJCF it does not load as it was: {wrong}",
            cure="write what MuJoCo names here in a simpler way in the model file, and identify again",
        )


@contextmanager
def _full_precision():
    """MuJoCo writes six digits unless its library is told otherwise; the setting has no Python binding."""
    library = ctypes.CDLL(str(next(Path(mujoco.__file__).parent.glob("libmujoco.*"))))
    library._mjPRIVATE__set_xml_precision.argtypes = [ctypes.c_int]
    before = library._mjPRIVATE__get_xml_precision()
    full_precision = 17  # significant digits that carry a double through text
    library._mjPRIVATE__set_xml_precision(full_precision)
    try:
        yield
    finally:
        library._mjPRIVATE__set_xml_precision(before)
