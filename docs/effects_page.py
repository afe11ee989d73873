"""docs/effects.md: what stands in it of every effect, and around it."""

from __future__ import annotations

import re
from itertools import accumulate

from capture_cli.model.effects import REGISTRY, Entry, catalogue
from capture_cli.model.effects.base import PLACES


def effects() -> str:
    """A table of each place, a row per effect."""
    entries = catalogue()
    tables = "\n\n".join(_table(place, [e for e in entries if e.kind.place == place]) for place in PLACES)
    states: dict[str, list[str]] = {}
    for name, kind in REGISTRY.items():
        if kind.states_mean:
            states.setdefault(kind.states_mean, []).append(f"`{name}`")
    return _PAGE.format(
        tables=tables,
        states="\n".join(f"| {', '.join(names)} | {meaning} |" for meaning, names in states.items()),
        memories="\n".join(
            f"  | `{n}` | {kind.remembers} |" for n, kind in REGISTRY.items() if kind.remembers
        ),
    )


def _table(place: str, entries: list[Entry]) -> str:
    rows = [f"## {place.capitalize()}", "", _PLACES[place], ""]
    rows += ["| effect | law | parameters | sits at |", "|---|---|---|---|", *map(_row, entries)]
    return "\n".join(rows)


def _row(entry: Entry) -> str:
    parameters = (
        f"`{p.name}`{'*' if p.name in entry.kind.shapes else ''}{f' {p.unit}' * (p.unit != '1')}"
        for p in entry.parameters
    )
    where = entry.kind.where.replace("every hinge and slide joint", "joints").replace(
        " of them together where there are several", " together"
    )
    exported = "" if entry.kind.exported_as() else " Not exported."
    return f"| `{entry.name}` | {_law(entry)}{exported} | {', '.join(parameters)} | {where} |"


def _law(entry: Entry) -> str:
    """As many sentences of its law as name all of its parameters; the first where none do."""
    first, *more = re.split(r"(?<=[.:;]) (?=[A-Z`-])", " ".join(entry.kind.law().split()))
    for text in accumulate([first, *more], "{} {}".format):
        if all(f"`{p.name}`" in text for p in entry.parameters):
            break
    else:
        text = first
    return text.rstrip(":;").replace("|", "\\|")


_PLACES = {
    "model": "Fields of the MuJoCo model. `capture export` writes them into `model.xml`.",
    "force": "A force at every step, positive where the joint's position grows. `capture export` writes a companion. "
    "Friction and damping that depend on the state change MuJoCo's `frictionloss` and `damping` step by "
    "step: they are integrated implicitly, and stick as MuJoCo's do.",
    "control": "What the actuators receive; ctrl: the unit of their control. `capture export` writes a companion.",
    "measurement": "What the sensors report. `capture export` writes a companion.",
}

_PAGE = """# Effects

What a model may lack. `capture effects NAME --task task.toml` prints the whole law of one, and its sites, units and
ranges in your model.

- **Site.** A joint (hinge or slide), tendon, body, geom, actuator or sensor, or the model as a whole:
  `coulomb-friction@elbow`, with the parameter `coulomb-friction@elbow.friction`; `gravity-tilt.tilt_x` of the whole.
  An object without a name is `#N`, from 0. `backlash@knee+angle`: `angle` is the encoder of motor and servo.
- **Null.** At the null of its parameters (0, or the end of the range for limits) the simulation is bit by bit that of
  the model without the effect.
- **Nonlinear parameters** (*) say what the effect looks like: a period, a position. They mean nothing while the
  others are null.
- **Units.** SI; of a joint that turns rad for m and N m for N. The table has those of one machine.
- **Ranges** follow from the model (weight on a joint, actuators, travel, inertia), and in a diagnosis from the motion
  and inputs of the log.
- **Time** t counts from the first sample of the log, in an export from the start of the simulation, unless the law
  says otherwise. Of several recordings it is the first sample of one (`effects[].first_time` of diagnosis.json).

{tables}

## Companions

What MJCF cannot hold is exported as `model_effects.py` beside `model.xml`, of MuJoCo and numpy alone.

```python
effects = Effects(model)
for ctrl in controls:
    effects.step(model, data, ctrl)  # instead of data.ctrl[:] = ctrl and mujoco.mj_step(model, data)
    recorded.append(data.sensordata.copy())
reported = effects.sense(model, np.array(recorded))
```

### Beginning inside a log

A window of a diagnosis begins at `window/start_time` with `start_qpos`, `start_qvel` and `start_act` of its store.
What came before it:

- *Control*: step through the controls before the window first, on an MjData that is then forgotten, for as long as
  the table says, of several effects added up.

  | effect | remembers the controls of |
  |---|---|
{memories}

- *Force*: set `effects.state["compliance@knee"]`, under the names below, before the first step.
  `hysteretic-friction`, `viscoelastic-spring` and `servo-integral` follow all positions of the episode: let the
  module run from its beginning.
- *Measurement*: `effects.sense` takes motion before its first row for even, and a `sensor-high-pass` for just
  switched on. The window of a `sensor-delay` begins so much earlier.

`window/start_hidden` has a number for each of `effects[].states` of diagnosis.json, effect after effect; 0 is
likeliest, and most lie within 1:

| effects | states |
|---|---|
{states}
"""
