"""How the time of `capture diagnose` grows with the number of joints: chains in a row, dry friction at one of them.

Each joint turns about an upright axis, is driven by a servo and has a damping to identify. The servos are as stiff as
what they carry asks for, so that every joint follows its commands alike. The length of the log is fixed.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from benchmarks import ROOT
from benchmarks._planted.asking import Answer, ask
from benchmarks._planted.outcomes import placed
from benchmarks._planted_logs.cases import direction
from benchmarks._planted_logs.machines import Experiment, Machine
from benchmarks._planted_logs.sizes import Refit, size
from benchmarks.base import Benchmark, Figure, Result
from capture_cli.model.effects import REGISTRY

JOINTS = (3, 6, 12, 24)
EPISODES = 4
EFFECT, MAGNITUDE = "coulomb-friction", 3.0
NOISE = 1e-3  # rad
LENGTH, MASS = 0.1, 0.2  # m, kg, of a link
SERVO, DAMPED, REACH = 5.0, 1.0, 0.3  # Hz, damping ratio, rad
LARGEST_EXPONENT = 1.5


class Chain(Benchmark):
    summary = "time of diagnose as the number of joints grows"

    def run(self) -> Result:
        answers = {joints: _asked(joints) for joints in JOINTS}
        cpu = np.array([a.cpu_seconds for a in answers.values()])
        exponent = float(np.polyfit(np.log(JOINTS), np.log(cpu), 1)[0])
        result = Result(
            details={
                str(joints): {"found": [placed(e) for e in a.document["effects"]], "seconds": a.seconds}
                for joints, a in answers.items()
            }
        )
        result.figures = [Figure(f"  CPU, {j} joints", a.cpu_seconds, "s") for j, a in answers.items()]
        result.figures.append(
            Figure("exponent of CPU by joints", exponent, target=(None, LARGEST_EXPONENT)),
        )
        return result


def _asked(joints: int) -> Answer:
    with tempfile.TemporaryDirectory() as folder:
        task, log = planted(joints, Path(folder))
        return ask(task, log, ROOT)


def planted(joints: int, folder: Path):
    """Task and log of a chain, whose files go to `folder`, with dry friction at its middle joint."""
    machine = chain(joints, folder)
    generator = np.random.default_rng(joints)
    made = Experiment(machine, generator, EPISODES)
    refit = Refit(made)
    effect = REGISTRY.get(EFFECT)(made.task.model, f"j{joints // 2}")
    values = direction(effect, generator)
    found = size(lambda s: refit.shown(made.outputs([(effect, values(s))])).left, MAGNITUDE)
    return made.task, made.log(made.outputs([(effect, values(found))]))


def chain(joints: int, folder: Path) -> Machine:
    """A chain of so many joints, its model.xml and task.toml written to `folder`."""
    (folder / "model.xml").write_text(_model(joints), encoding="utf-8")
    (folder / "task.toml").write_text(_task(joints), encoding="utf-8")
    return Machine("chain", {f"q{i}": NOISE for i in range(joints)}, folder=folder)


def _damping(joints: int, joint: int) -> float:
    """N m s/rad, of a servo at `joint`: what lies beyond it, stretched out, swings at SERVO Hz with it."""
    return 2 * DAMPED * _inertia(joints, joint) * 2 * np.pi * SERVO


def _inertia(joints: int, joint: int) -> float:
    """kg m^2, of the links from `joint` on, stretched out, about it."""
    beyond = joints - joint
    return MASS * beyond * (beyond * LENGTH) ** 2 / 3


def _model(joints: int) -> str:
    bodies, actuators, sensors = "", "", ""
    for i in range(joints):
        place = f' pos="{LENGTH} 0 0"' if i else ""
        bodies += (
            f'<body name="b{i}"{place}><joint name="j{i}" type="hinge" axis="0 0 1" '
            f'damping="{_damping(joints, i) / 20:.6g}"/>'
            f'<geom type="capsule" fromto="0 0 0 {LENGTH} 0 0" size=".01" mass="{MASS}"/>\n'
        )
        stiffness, damping = _inertia(joints, i) * (2 * np.pi * SERVO) ** 2, _damping(joints, i)
        actuators += (
            f'<position name="j{i}" joint="j{i}" kp="{stiffness:.6g}" kv="{damping:.6g}" '
            f'ctrlrange="-{REACH} {REACH}"/>\n'
        )
        sensors += f'<jointpos name="q{i}" joint="j{i}"/>\n'
    return (
        '<mujoco model="chain">\n<option timestep="0.002" integrator="implicitfast"/>\n'
        '<default><geom contype="0" conaffinity="0"/></default>\n'
        f"<worldbody>\n{bodies}{'</body>' * joints}\n</worldbody>\n"
        f"<actuator>\n{actuators}</actuator>\n<sensor>\n{sensors}</sensor>\n</mujoco>\n"
    )


def _task(joints: int) -> str:
    text = 'format = 1\nname = "chain"\nmodel = "model.xml"\n'
    for i in range(joints):
        high = _damping(joints, i) / 5
        text += f'[parameters.d{i}]\nset = "joint:j{i}:damping"\nlow = 0.0\nhigh = {high:.6g}\nunit = "N m s/rad"\n'
        text += f'[inputs.j{i}]\ncolumn = "u{i}"\nunit = "rad"\n'
        text += f'[outputs.q{i}]\ncolumn = "q{i}"\nunit = "rad"\n'
    return text + '[log]\ntime = "t"\nepisode = "episode"\nwindow = 0.5\n'
