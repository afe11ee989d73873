"""What a model may lack: one effect = one file. The file's stem is the effect's public name."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco

from capture_cli.effects.base import PLACES, Effect
from capture_cli.parameters import Parameter
from capture_cli.registry import Registry

REGISTRY: Registry[Effect] = Registry(
    "capture_cli.effects", "Effect", "effect", not_listed=("companion", "placed")
)
EXAMPLE = Path(__file__).with_name("_example_machine.xml")


@dataclass(frozen=True)
class Entry:
    """One effect of the catalogue: its sites in a model, and its parameters, each at the first of them that has it.

    law: what its parameters do, as a formula where it has one.
    """

    name: str
    place: str
    summary: str
    law: str
    where: str
    sites: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    shapes: tuple[str, ...]
    exported_as: str


def catalogue(model: mujoco.MjModel | None = None) -> list[Entry]:
    """Every effect, by place and name, with its sites in `model`; in the example machine where None."""
    model = model or mujoco.MjModel.from_xml_path(str(EXAMPLE))
    entries = []
    for name, effect in REGISTRY.items():
        sites = tuple(effect.sites(model))
        parameters: dict[str, Parameter] = {}
        for parameter in (p for site in sites for p in effect(model, site).parameters):
            parameters.setdefault(parameter.name, parameter)
        entries.append(
            Entry(
                name=name,
                place=effect.place,
                summary=effect.summary,
                law=effect.law(),
                where=effect.where,
                sites=sites,
                parameters=tuple(parameters.values()),
                shapes=effect.shapes,
                exported_as=effect.exported_as(),
            )
        )
    return sorted(entries, key=lambda e: (PLACES.index(e.place), e.name))


def markdown() -> str:
    """docs/effects.md: a row per effect, and its law."""
    entries = catalogue()
    rows = "\n".join(_row(entry) for entry in entries)
    laws = "\n\n".join(f"### {entry.name}\n\n{entry.law}" for entry in entries)
    states = "\n".join(
        f"| `{name}` | {kind.states_mean} |" for name, kind in REGISTRY.items() if kind.states_mean
    )
    memories = "\n".join(
        f"| `{name}` | {kind.remembers} |" for name, kind in REGISTRY.items() if kind.remembers
    )
    return _PAGE.format(
        rows=rows,
        laws=laws,
        states=states,
        memories=memories,
        example=EXAMPLE.read_text(encoding="utf-8").rstrip(),
    )


def _row(entry: Entry) -> str:
    cells = [
        f"[`{entry.name}`](#{entry.name})",
        entry.place,
        entry.summary,
        entry.where,
        "<br>".join(f"`{p.name}`{' (shape)' if p.name in entry.shapes else ''}" for p in entry.parameters),
        "<br>".join(p.unit for p in entry.parameters),
        "<br>".join(f"{p.low:.3g} to {p.high:.3g}" for p in entry.parameters),
        "<br>".join("any" if p.name in entry.shapes else f"{p.nominal:.3g}" for p in entry.parameters),
        entry.exported_as or "not",
    ]
    return f"| {' | '.join(cells)} |"


_PAGE = """# Effects

What a model may lack. Each effect is one file in `capture_cli/effects/`; this page is made from them
(`capture_cli.effects.markdown()`), and a test compares the two.

An effect sits at a place in the model: a joint, a tendon, a body, a geom, an actuator, a sensor, or the model
as a whole. `coulomb-friction@elbow` is that effect at the joint `elbow`, and `coulomb-friction@elbow.friction`
its parameter; `gravity-tilt`, which sits at no one place, has `gravity-tilt.tilt_x`. Objects without a name
are called by their number, `#0` being the first of a kind.

At the null value of its parameters the simulation is, bit by bit, the one without the effect. Parameters
marked *shape* say what the effect looks like; while the others are null they mean nothing, whatever they
are.

Time counts from the first sample of the log, whatever its clock shows there, and in an exported model from the start of
the simulation: the phase of `periodic-disturbance` is that at this moment. Of a log of several recordings it is the
first sample of one of them, as phases do not go on from one to the other. `effects[].first_time` of diagnosis.json says
when it was.

Effects of the place *model* are native MuJoCo features. Those of the place *force* act at every step:
friction and damping that depend on the state change MuJoCo's own `frictionloss` and `damping` step by
step, so that they are integrated implicitly and stick as MuJoCo's do; compliance and backlash keep the
motor's position as a state of their own. `backlash@knee` is a play behind which all sensors are; in
`backlash@knee+angle` the sensor `angle`, of that joint or of its actuator, is the motor's encoder, and shows
what the motor does inside the play. A servo still closes its loop on the joint. Effects of *control*
change what the actuators receive, those of *measurement* what the sensors report. `ctrl` stands for the
unit of the actuator's control.

`capture export` writes a diagnosis as a model that runs without this package. *MJCF*: the effect is in
`model.xml`. *companion*: beside it lies `model_effects.py`, which depends on MuJoCo and numpy alone and applies
the effect in a plain loop; the numbers are filled in, and the functions in it are those of
`capture_cli/effects/`, so that both give the same trajectories.

```python
effects = Effects(model)
for ctrl in controls:
    effects.step(model, data, ctrl)  # instead of data.ctrl[:] = ctrl and mujoco.mj_step(model, data)
    recorded.append(data.sensordata.copy())
reported = effects.sense(model, np.array(recorded))
```

Ranges follow from the model: from the weight that a joint carries, what its actuators can give, its travel
and its inertia; in a diagnosis also from how far and how fast the log saw the joint go, and what its inputs
did. The ones in the table are those of the machine at the end of this page, each at the first
of the effect's sites in it that has the parameter.

| effect | place | what it is | sits at | parameters | unit | range | null | exported as |
|---|---|---|---|---|---|---|---|---|
{rows}

## The laws

What the parameters do. `capture effects NAME --task task.toml` prints one of them with the sites, units and ranges that
it has in that task. Forces and torques are those on the joint, positive in the direction in which its position grows.

{laws}

## Beginning inside a log

A window of a diagnosis begins at `window/start_time`, with `start_qpos`, `start_qvel` and `start_act`, of its store. An
effect with a memory also goes by what was before, which the module of an export does not have:

- Effects of *control* are told the controls before the window first, as many as they remember, on data that is then
  forgotten: for as long as the table below says, of several effects added up. The episode's first control and
  `start_hidden` say what was before it. After that the module goes on with the window as the diagnosis does, if no
  force in it has a memory, too.

  ```python
  effects = Effects(model)
  for ctrl in controls_before:
      effects.step(model, mujoco.MjData(model), ctrl)
  data.qpos[:], data.qvel[:], data.act[:] = start_qpos, start_qvel, start_act
  ```

- *Forces* keep theirs in `effects.state["compliance@knee"]`, under the names of this table; what is set there before
  the first step is what they begin with, in SI units. Otherwise they begin as in the first window of an episode whose
  `start_hidden` is 0. `hysteretic-friction`, `viscoelastic-spring` and `servo-integral` go by all positions of the
  episode up to the window, and `start_hidden` is what they began it with: give the module what that has come to, or
  let it run from the beginning of the episode.
- *Measurement*: `effects.sense` takes motion before its first row for even, and a `sensor-high-pass` for just switched
  on. A `sensor-delay` has none before it: the window's simulation begins so much earlier.

| effect | remembers the controls of |
|---|---|
{memories}

`start_hidden` has a number for each of `effects[].states` of diagnosis.json, effect after effect. They have no unit:
0 is what is likeliest, and most lie within 1, which is:

| effect | states |
|---|---|
{states}

## The machine of the table

```xml
{example}
```
"""
