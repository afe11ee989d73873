"""The module that `capture export` writes beside a model: its effects for a plain loop, without this package."""

import inspect
import json
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from textwrap import indent
from types import CodeType, ModuleType

import numpy as np

from capture_cli.model.effects._kernel import INDENT, MODELS_STEP, OWN_STEP, Companion, number
from capture_cli.model.effects.base import Effect

PACKAGE = __name__.split(".", 1)[0]
MADE_BY_EXPORT = "made by `capture export`"
# of MjData: not worked out by mj_step
GIVEN = {"qpos", "qvel", "act", "ctrl", "time", "qfrc_applied", "xfrc_applied"}
Pieces = Mapping[str, tuple[Effect, Companion]]


def companion_module(
    model_file: str, task: str, effects: Mapping[str, tuple[Effect, np.ndarray]], substeps: int = 1
) -> str:
    """Source of the module for the model in `model_file`. effects: {NAME@SITE: (effect, values (parameter,))}.

    substeps: steps of that model in one of the grid on which controls come and sensors are read.
    Raises ModelError for an effect that cannot be applied outside of this package.
    """
    pieces = {name: (effect, effect.companion(name, values)) for name, (effect, values) in effects.items()}
    used: dict[str, object] = {}
    for _, piece in pieces.values():
        for kernel in piece.kernels:
            _collect(kernel.__name__, kernel, used)
    return _MODULE.format(
        made=MADE_BY_EXPORT,
        task=_printable(task),
        file=_printable(model_file),
        effects=indent("\n".join(_described(name, *pair) for name, pair in effects.items()), INDENT),
        grid=_GRID.format(substeps=substeps) if substeps > 1 else "",
        controls=f"np.repeat(controls, {substeps}, axis=0)" if substeps > 1 else "controls",
        rows=f"[::{substeps}]" if substeps > 1 else "",
        kernels="\n\n\n".join(_sources(used)),
        reset=_body(_reset(pieces, substeps)),
        step=_body(_step(pieces, substeps)),
        sense=_body(_sense(pieces, substeps)),
    )


def _described(name: str, effect: Effect, values: np.ndarray) -> str:
    lines = [_title(name, effect)]
    pairs = zip(effect.parameters, values, strict=True)
    lines += [f"{INDENT}{p.name} = {v:.6g} {p.unit}".removesuffix(" 1") for p, v in pairs]
    return "\n".join(lines)


def _title(name: str, effect: Effect) -> str:
    return f"{_printable(name)}: {effect.summary}"


def _printable(text: str) -> str:
    """A name from outside, for comments and docstrings: nothing in it ends them."""
    return "".join(c if c.isprintable() and c not in '"\\' else "_" for c in text)


# --- what is pasted ---


def _collect(name: str, value: object, used: dict[str, object]) -> None:
    """Put what `value` looks up in its own module, and then `value`, into `used` by name."""
    if name in used:
        if used[name] is not value:
            raise ValueError(f"two kernels know different things by the name {name}")
        return
    if _is_ours(value):
        scope = vars(sys.modules[value.__module__])
        for other in _names(value):
            if other in scope and other != name and not isinstance(scope[other], ModuleType):
                _collect(other, scope[other], used)
    used[name] = value


def _names(value: Callable) -> Iterator[str]:
    """Names that a function, or a class with its bases and methods, may look up in its module."""
    if not inspect.isclass(value):
        yield from _looked_up(value.__code__)
        return
    yield from (base.__name__ for base in value.__bases__)
    if inspect.isabstract(value):
        yield "abstractmethod"
    for method in filter(inspect.isfunction, vars(value).values()):
        yield from _looked_up(method.__code__)


def _looked_up(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from _looked_up(inner)


def _sources(used: Mapping[str, object]) -> Iterator[str]:
    """Imports, numbers, and the source of functions and classes, each after what it needs."""
    foreign = {
        name: value.__module__ for name, value in used.items() if callable(value) and not _is_ours(value)
    }
    imports = [
        f"from {module} import {', '.join(sorted(n for n, m in foreign.items() if m == module))}"
        for module in sorted(set(foreign.values()))
    ]
    numbers = [f"{name} = {number(value)}" for name, value in used.items() if not callable(value)]
    yield "\n".join([*imports, *([""] if imports else []), "import mujoco", "import numpy as np"])
    if numbers:
        yield "\n".join(numbers)
    yield from (inspect.getsource(value).rstrip() for value in used.values() if _is_ours(value))


def _is_ours(value: object) -> bool:
    return callable(value) and value.__module__.split(".", 1)[0] == PACKAGE


# --- what is generated ---


def _reset(pieces: Pieces, substeps: int) -> Iterator[str]:
    controls = [*_blocks(pieces, "control")]
    if any(OWN_STEP in text for text in (*controls, *_blocks(pieces, "measurement"), *_states(pieces))):
        yield f"{OWN_STEP} = {MODELS_STEP}" + (f" * {substeps}" if substeps > 1 else "")
    kept = {name: piece.state for name, (_, piece) in pieces.items() if piece.state}
    entries = [f"{json.dumps(name, ensure_ascii=False)}: {state}," for name, state in kept.items()]
    yield (
        "\n".join(["self.state = {", indent("\n".join(entries), INDENT), "}"]) if kept else "self.state = {}"
    )
    if any(_late(block) for block in _blocks(pieces, "force")):
        yield "self.first = True"
    if controls and substeps > 1:
        yield "self.steps = 0"


def _states(pieces: Pieces) -> Iterator[str]:
    yield from (piece.state for _, piece in pieces.values())


def _step(pieces: Pieces, substeps: int) -> Iterator[str]:
    yield from _drive(pieces, substeps)
    changes = dict.fromkeys(field for _, piece in pieces.values() for field in piece.changes)
    own = {field: f"own_{field.split('.')[-1]}" for field in changes}
    yield from (f"{name} = {field}.copy()" for field, name in own.items())
    known: set[str] = set()
    for block in _blocks(pieces, "force"):
        late = _late(block)
        if late and (not known or "qacc" in late - known):  # which is that under the forces before it
            yield _FIRST
        known |= late
        yield block
    yield "mujoco.mj_step(model, data)"
    yield from (f"{field}[:] = {name}" for field, name in own.items())
    yield from (line for _, piece in pieces.values() for line in piece.after)
    if known:
        yield "self.first = False"


def _drive(pieces: Pieces, substeps: int) -> Iterator[str]:
    controls = ["data.ctrl[:] = ctrl", *_blocks(pieces, "control")]
    if len(controls) == 1 or substeps == 1:
        yield from controls
        return
    yield f"if self.steps % {substeps} == 0:"
    yield indent("\n".join([*controls, "self.arrived = data.ctrl.copy()"]), INDENT)
    yield "data.ctrl[:] = self.arrived"
    yield "self.steps += 1"


def _sense(pieces: Pieces, substeps: int) -> Iterator[str]:
    reports = [*_blocks(pieces, "measurement")]
    held = bool(reports) and substeps > 1
    yield "sensors = np.array(sensors, dtype=float)"
    if held:
        yield f"steps, sensors = len(sensors), sensors[::{substeps}]"
    yield from reports
    yield f"return np.repeat(sensors, {substeps}, axis=0)[:steps]" if held else "return sensors"


def _late(block: str) -> set[str]:
    """Fields that mj_step leaves as they were at the start of the step before."""
    return set(re.findall(r"data\.(\w+)", block)) - GIVEN


def _blocks(pieces: Pieces, place: str) -> Iterator[str]:
    """The lines of each effect at `place` under a line that says which it is, in the order of simulations."""
    for name, (effect, piece) in sorted(pieces.items(), key=lambda item: item[1][0].reads_acceleration):
        if effect.place == place:
            yield "\n".join([f"# {_title(name, effect)}", *piece.lines])


def _body(blocks: Iterator[str]) -> str:
    return indent("\n".join(blocks), 2 * INDENT)


_FIRST = """if self.first:  # what the step before worked out is read, and there is none
    mujoco.mj_forward(model, data)"""

_GRID = """
The model steps {substeps} times in each step of the grid on which controls come and sensors are read. Effects on
controls and on sensors work on that grid, as in the diagnosis: they take the control, and the sensors, of the first
of every {substeps} steps, and hold over all of them what arrives, and what is reported.
"""

_MODULE = '''"""Effects that {file} cannot hold, for a plain loop; {made} for the task {task}.

{effects}
{grid}
Depends on mujoco and numpy only:

    model = mujoco.MjModel.from_xml_path("{file}")
    data = mujoco.MjData(model)
    effects = Effects(model)
    recorded = []
    for ctrl in {controls}:
        effects.step(model, data, ctrl)  # instead of data.ctrl[:] = ctrl and mujoco.mj_step(model, data)
        recorded.append(data.sensordata.copy())
    reported = effects.sense(model, np.array(recorded)){rows}
"""


{kernels}


class Effects:
    """The effects around mujoco.mj_step. What the model or the user sets is put back after every step."""

    def __init__(self, model):
        self.reset(model)

    def reset(self, model):
        """Forget what was; call it whenever the simulation starts anew."""
{reset}

    def step(self, model, data, ctrl):
        """Advance the simulation by one step, driven by ctrl (nu,)."""
{step}

    def sense(self, model, sensors):
        """What is reported of `sensors` (step, nsensordata): sensordata of every step since the start."""
{sense}
'''
