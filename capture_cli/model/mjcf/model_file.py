"""The one place where a model of the user's own is compiled: what is wrong with it is said before any work."""

import os
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from capture_cli.common.documents import open_file
from capture_cli.common.frozen import frozen
from capture_cli.errors import ModelError
from capture_cli.model.mjcf.limited_process import CAN_LIMIT, Exceeded, limited
from capture_cli.model.mjcf.mjcf_text import included, largest, refuse_bad_numbers
from capture_cli.model.mujoco_warnings import silence_mujoco


@frozen
class SETTINGS:
    # The largest robots, with all their meshes, take a second and 0.3 GB.
    seconds: float = 15.0
    memory: int = 3 << 29  # bytes
    naming_seconds: float = 4.0  # more, to name what it was that took too much
    # s
    shortest_step: float = 1e-6
    longest_step: float = 1.0
    slowest_step: float = 1.0  # s of a core; a fit takes a million steps


# of a model that MuJoCo does not take
MUJOCO_ERRORS = (ValueError, RuntimeError, MemoryError, mujoco.FatalError)
_XML = (".xml", ".mjcf", ".urdf")
_COUNTS = ("nq", "nv", "nu", "na", "nbody", "njnt", "nsite", "ntendon", "neq", "nsensordata")
_INERTIAL = ("body_mass", "body_ipos", "body_iquat", "body_inertia", "dof_M0")
_NO_MEMORY = ("allocate memory", "unknown exception")  # what MuJoCo says where there is none left
_OBJECTS = {  # how the names of a model's fields begin, and of what they are
    "actuator": mujoco.mjtObj.mjOBJ_ACTUATOR,
    "body": mujoco.mjtObj.mjOBJ_BODY,
    "cam": mujoco.mjtObj.mjOBJ_CAMERA,
    "eq": mujoco.mjtObj.mjOBJ_EQUALITY,
    "geom": mujoco.mjtObj.mjOBJ_GEOM,
    "jnt": mujoco.mjtObj.mjOBJ_JOINT,
    "key": mujoco.mjtObj.mjOBJ_KEY,
    "mat": mujoco.mjtObj.mjOBJ_MATERIAL,
    "pair": mujoco.mjtObj.mjOBJ_PAIR,
    "sensor": mujoco.mjtObj.mjOBJ_SENSOR,
    "site": mujoco.mjtObj.mjOBJ_SITE,
    "tendon": mujoco.mjtObj.mjOBJ_TENDON,
}


def compile_file(path: Path, moved_centres: Collection[str] = ()) -> mujoco.MjModel:
    """The MJCF at `path`, compiled; centres of mass can be moved of bodies that turn and of the `moved_centres`.

    A stranger may have made it, so it is compiled and stepped once in a process of its own, in at most `seconds` and
    `memory`. Raises ModelError that says what is wrong with it: it cannot be read, MuJoCo refuses it, or takes more, a
    number in it is not finite, or its timestep is none.
    """
    silence_mujoco()
    _refuse_unreadable(path)
    compiling = _Compiling(path, moved_centres)
    if not CAN_LIMIT:
        return compiling()
    # both processes have it open; no other sees it, and it ends with them
    file = os.memfd_create("model.mjb")
    name = f"/proc/self/fd/{file}"
    try:
        limited(lambda: compiling.save(name), seconds=SETTINGS.seconds, memory=SETTINGS.memory)
        return mujoco.MjModel.from_binary_path(name)
    except Exceeded as error:
        raise _exceeded(path, error) from None
    finally:
        os.close(file)


def files_of(path: Path) -> list[Path]:
    """The files that the model at `path` is made of: itself, other MJCFs, meshes, textures. Raises ModelError."""
    _refuse_unreadable(path)
    with refused(path):
        return sorted(map(Path, mujoco.mju_getXMLDependencies(str(path))))


def without_visuals(spec: mujoco.MjSpec, model: mujoco.MjModel) -> mujoco.MjModel:
    """What moves of the `model`, compiled of `spec`: without meshes, textures and geoms that are only looked at, of
    which models of real robots are full, and which every copy of one copies. The model itself where a sensor sees them.
    """
    if not (model.nmesh or model.ntex or model.nhfield) or _are_seen(model):
        return model
    spec.compiler.discardvisual = True
    try:
        lean = spec.compile()
    except MUJOCO_ERRORS:
        return model
    same = all(getattr(lean, name) == getattr(model, name) for name in _COUNTS)
    same = same and all(np.allclose(getattr(lean, n), getattr(model, n), rtol=1e-12) for n in _INERTIAL)
    return lean if same else model


def _are_seen(model: mujoco.MjModel) -> bool:
    """Whether what does not collide shows: to a rangefinder, as a ground to what flies, or as what a medium flows
    around.
    """
    sees = (model.sensor_type == int(mujoco.mjtSensor.mjSENS_RANGEFINDER)).any()
    visual = (model.geom_contype | model.geom_conaffinity) == 0
    grounds = model.geom_type[visual] == int(mujoco.mjtGeom.mjGEOM_PLANE)
    return bool(sees or grounds.any() or model.geom_fluid[:, 0].any())


def free_centres(spec: mujoco.MjSpec, names: Collection[str] = ()) -> None:
    """Let the centres of mass of bodies that can turn, and of those in `names`, be moved after compilation.

    MuJoCo takes a body whose centre lies in its frame as "simple" and then refuses to move it. Turning that off costs
    1 % (a wheel) to 7 % (a free box) of the speed, and a model of ten loose boxes 28 %.
    """
    for body in spec.bodies[1:]:
        if body.name in names or any(joint.type != mujoco.mjtJoint.mjJNT_SLIDE for joint in body.joints):
            body.simple = 0


@contextmanager
def refused(path: Path) -> Iterator[None]:
    """Raise ModelError, with MuJoCo's own words, for whatever MuJoCo raises of the model at `path`."""
    try:
        yield
    except MUJOCO_ERRORS as error:
        raise ModelError(
            f"{path} does not compile: {error or type(error).__name__}",
            cure="correct the MJCF at the place named",
        ) from error


def refuse_not_finite(path: Path, model: mujoco.MjModel, cure: str) -> None:
    """Raise ModelError where a number in the `model`, compiled of the file at `path`, is not finite."""
    for owner in (model, model.opt, model.stat):
        for name in dir(owner):
            value = getattr(owner, name) if not name.startswith("_") else None
            if isinstance(value, float | np.ndarray) and not _is_finite(value):
                raise ModelError(f"{path}: {_place(model, name, np.asarray(value))}", cure=cure)


@dataclass(frozen=True)
class _Compiling:
    """What is done in the process of its own: compiles the model at `path`, and looks at what comes of it."""

    path: Path
    moved_centres: Collection[str]

    def __call__(self) -> mujoco.MjModel:
        warnings: list[str] = []
        mujoco.set_mju_user_warning(warnings.append)
        try:
            return self._looked_at(warnings)
        finally:
            mujoco.set_mju_user_warning(None)

    def _looked_at(self, warnings: list[str]) -> mujoco.MjModel:
        """warnings: what MuJoCo says meanwhile comes there."""
        try:
            for file in included(self.path):
                _refuse_unreadable_part(file)
            files = files_of(self.path)
            for file in files:
                _refuse_unreadable_part(file)
            refuse_bad_numbers(_xml(files))
            with refused(self.path):
                spec = mujoco.MjSpec.from_file(str(self.path))
                free_centres(spec, self.moved_centres)
                model = spec.compile()
        except ModelError as error:
            if any(words in error.message for words in _NO_MEMORY):
                raise MemoryError from None
            raise
        if any("NaN" in warning for warning in warnings):
            raise ModelError(
                f"{self.path}: a number in it is NaN",
                cure="give the number, or leave the attribute out",
            )
        self._refuse_timestep(model)
        refuse_not_finite(self.path, model, cure="look there for a number that is missing or far too large")
        self._step(model)
        return without_visuals(spec, model)

    def save(self, name: str) -> bytes:
        """Write the model, as MuJoCo does, to the file of that `name`."""
        mujoco.mj_saveModel(self(), name, None)
        return b""

    def _refuse_timestep(self, model: mujoco.MjModel) -> None:
        step = model.opt.timestep
        if not SETTINGS.shortest_step <= step <= SETTINGS.longest_step:
            raise ModelError(
                f"{self.path}: timestep = {step:g} s; steps of {SETTINGS.shortest_step:g} to "
                f"{SETTINGS.longest_step:g} s can be simulated",
                cure='write the model\'s own in <option timestep="0.002"/>, in seconds; machines have 1e-4 to 0.01',
            )

    def _step(self, model: mujoco.MjModel) -> None:
        try:
            data = mujoco.MjData(model)
            began = time.process_time()
            mujoco.mj_step(model, data)
        except mujoco.FatalError as error:
            if any(words in str(error) for words in _NO_MEMORY):
                raise MemoryError from None
            raise ModelError(
                f"{self.path}: MuJoCo does not step it: {error}",
                cure="correct what it names in the MJCF",
            ) from error
        taken = time.process_time() - began
        if taken > SETTINGS.slowest_step:
            raise ModelError(
                f"{self.path}: one step of it takes {taken:.2g} s, and a fit a million of them",
                cure="make the model smaller: fewer bodies, contacts and iterations",
            )


def _xml(files: Collection[Path]) -> list[Path]:
    return [file for file in files if file.suffix.lower() in _XML]


def _refuse_unreadable(path: Path) -> None:
    """Raise ModelError where there is no file at `path`, or none that may be read, or nothing in it."""
    where = f"the model {path}"
    elsewhere = "correct `model = ...` in the task.toml: a path from its folder"
    with open_file(path, ModelError, called=where, elsewhere=elsewhere) as file:
        if not file.read(1):
            raise ModelError(f"{where} is empty", cure="write an MJCF there: <mujoco>...</mujoco>")
    try:
        str(path).encode()
    except UnicodeEncodeError as error:
        raise ModelError(
            f"{where} has a name that is not UTF-8, which MuJoCo does not open",
            cure="rename it, or the folder it is in",
        ) from error


def _refuse_unreadable_part(path: Path) -> None:
    """Raise ModelError where a file that a model is made of may not be read; where there is none MuJoCo says so."""
    with suppress(OSError):
        if not path.exists():
            return
    open_file(path, ModelError, elsewhere="name another file in the MJCF").close()


def _is_finite(value: float | np.ndarray) -> bool:
    value = np.asarray(value)
    return value.dtype.kind != "f" or bool(np.isfinite(value).all())


def _place(model: mujoco.MjModel, field: str, value: np.ndarray) -> str:
    """Where the value of a field is not finite, and what it is: "mass = nan of body 'arm'"."""
    prefix, _, attribute = field.partition("_")
    rows = value.reshape(len(value), -1) if value.ndim else value.reshape(1, 1)
    row = int(np.flatnonzero(~np.isfinite(rows).all(axis=1))[0])
    found = rows[row][~np.isfinite(rows[row])][0]
    if attribute and prefix in _OBJECTS:
        name = mujoco.mj_id2name(model, _OBJECTS[prefix], row)
        return f"{attribute} of {prefix} {name or row!r} is {found}"
    return f"{field} is {found}"


def _exceeded(path: Path, error: Exceeded) -> ModelError:
    """What to say of a model that took more than it may: with the attribute that makes most of something."""
    try:
        most = limited(
            lambda: _largest(path), seconds=SETTINGS.naming_seconds, memory=SETTINGS.memory
        ).decode()
    except (Exceeded, ModelError):
        most = ""
    if most:
        return ModelError(
            f"{path}: to compile it {error}; what it has most of is {most}",
            cure="give that the number that the machine has",
        )
    return ModelError(
        f"{path}: to compile it {error}",
        cure="leave out what the motion does not need: meshes, textures, height fields",
    )


def _largest(path: Path) -> bytes:
    attribute = largest(_xml(files_of(path)))
    return str(attribute or "").encode()
