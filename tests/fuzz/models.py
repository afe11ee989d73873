"""MJCF: numbers that no machine has, counts without end, elements of every kind, files that include files."""

from __future__ import annotations

import copy
from pathlib import Path
from xml.etree import ElementTree

from hypothesis import strategies as st

from fuzz.cases import Case, Expected, refused, taken
from fuzz.mutations import NUMBERS, TEXTS, Sound, mutated_bytes

MODEL = "machine/model.xml"
TASKS = (("tasks", "--task", "machine", "--json"), ("machine",))
RECORD = (
    ("record", "--task", "machine", "--duration", "0.1", "--threads", "1", "--out", "new.zarr"),
    ("machine",),
)
EFFECTS = (("effects", "--task", "machine", "--json"), ("machine",))
INSPECT = (("inspect", "log.zarr", "--task", "machine", "--json"), ("machine", "log.zarr"))
EXPORT = (("export", "estimate", "--task", "machine", "--out", "new.xml"), ("machine", "estimate"))
COMMANDS = (TASKS, TASKS, RECORD, RECORD, EFFECTS, INSPECT, EXPORT)
OUTPUTS = ("new.zarr", "new.truth.json"), ("new.xml", "new_effects.py")
# What a model may hold beside, by the element that it stands in.
PARTS = {
    "mujoco": (
        '<size nuser_body="{}"/>',
        '<size nkey="{}"/>',
        '<size memory="{}"/>',
        '<size njmax="{}" nconmax="{}"/>',
        '<size nuser_geom="{}"/>',
        '<asset><hfield name="h" nrow="{}" ncol="{}" size="1 1 1 1"/></asset>',
        '<asset><hfield name="h" file="{}" size="1 1 1 1"/></asset>',
        '<asset><mesh name="m" file="{}"/></asset>',
        '<asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 {}"/></asset>',
        '<asset><texture name="t" type="2d" builtin="checker" width="{}" height="{}"/></asset>',
        '<include file="{}"/>',
        '<include file="model.xml"/>',
        '<keyframe><key qpos="{}" time="{}"/></keyframe>',
        '<option iterations="{}"/>',
        '<option integrator="RK4" tolerance="{}"/>',
        '<option density="{}" wind="{} 0 0"/>',
        '<compiler angle="radian" inertiafromgeom="true" boundmass="{}"/>',
        '<compiler meshdir="{}"/>',
        '<compiler autolimits="false"/>',
        '<statistic extent="{}"/>',
        '<visual><global offwidth="{}" offheight="{}"/></visual>',
        '<extension><plugin plugin="{}"/></extension>',
        '<custom><numeric name="a" size="{}" data="1"/></custom>',
        '<custom><text name="a" data="{}"/></custom>',
        '<default><geom size="{}"/></default>',
        '<equality><joint joint1="x" polycoef="{} 0 0 0 0"/></equality>',
        '<contact><exclude body1="carriage" body2="{}"/></contact>',
        '<tendon><fixed name="f"><joint joint="x" coef="{}"/></fixed></tendon>',
        '<frame pos="{} 0 0"/>',
        "<worldbody><body><freejoint/></body></worldbody>",
    ),
    "worldbody": (
        '<replicate count="{}"><geom size="1"/></replicate>',
        '<replicate count="{}" offset="{} 0 0"><body><joint/><geom size=".1"/></body></replicate>',
        '<replicate count="40"><replicate count="{}"><geom size="1"/></replicate></replicate>',
        '<geom type="plane" size="{} 1 1"/>',
        '<body mocap="true"><geom size=".1"/></body>',
        '<body><freejoint/><geom size="{}"/></body>',
        '<camera name="{}"/>',
        '<light pos="{} 0 0"/>',
        '<composite type="cable" count="{} 1 1" size="1"><geom type="capsule" size=".01"/></composite>',
        '<geom type="hfield" hfield="h"/>',
        '<flexcomp name="x" type="grid" count="{} {} 1" spacing=".1 .1 .1" mass="1"/>',
        '<site name="{}" size="{}"/>',
        '<geom type="mesh" mesh="m"/>',
    ),
    "body": (
        '<inertial pos="0 0 0" mass="{}" diaginertia="1 1 1"/>',
        '<inertial pos="0 0 0" mass="1" diaginertia="{} 1 {}"/>',
        '<joint type="ball"/>',
        '<joint name="y" type="hinge" range="{} {}"/>',
        '<joint name="{}" stiffness="{}"/>',
        '<geom size="{}" density="{}"/>',
        "<freejoint/>",
        '<geom type="capsule" fromto="0 0 0 {} 0 0" size=".1"/>',
        '<body gravcomp="{}"><geom size=".1"/></body>',
        '<site name="s" quat="{} 0 0 0"/>',
    ),
    "actuator": (
        '<position joint="x" kp="{}"/>',
        '<motor joint="x" gear="{}"/>',
        '<general joint="x" dyntype="filter" dynprm="{}"/>',
        '<velocity joint="x" kv="{}" ctrlrange="{} {}"/>',
        '<muscle joint="x" timeconst="{} {}"/>',
        '<cylinder joint="x" area="{}"/>',
        '<general joint="x" delay="{}" nsample="{}"/>',
    ),
    "sensor": (
        '<jointvel joint="x"/>',
        '<user dim="{}"/>',
        '<jointpos joint="{}"/>',
        '<accelerometer site="s" cutoff="{}"/>',
        "<clock/>",
        '<rangefinder site="s"/>',
        '<jointpos joint="x" nsample="{}" delay="{}"/>',
    ),
}
FILES = {
    "machine/part.xml": b"<mujoco><worldbody><geom size='1'/></worldbody></mujoco>",
    "machine/plate.stl": b"no mesh",
    "machine/empty.png": b"",
}
_ENTITIES = "".join(
    [
        "<!DOCTYPE a [",
        '<!ENTITY e0 "bbbbbbbbbb">',
        *(f'<!ENTITY e{n} "{f"&e{n - 1};" * 10}">' for n in range(1, 10)),
        "]>",
    ]
)
USUAL = (
    "0",
    "0.001",
    "0.1",
    "1",
    "3",
    "-1",
    "20",
    "100",
    "1000",
    "x",
    "block",
    "carriage",
    "true",
    "1 0 0",
    "0.5 0.5",
)
STEP, MASS, WORLD = 'timestep="0.002"', 'mass="2"', "<worldbody>"


def seeds(inputs: Path) -> list[Case]:
    text = (inputs / MODEL).read_text()

    def seed(name: str, old: str, new: str, *words: str, of=TASKS, end: Expected | None = None) -> Case:
        if old not in text:
            raise ValueError(f"{old} is not in {MODEL}")
        return case(of, text.replace(old, new, 1).encode(), end or refused(*words), name)

    def size(attributes: str) -> str:
        return f"<size {attributes}/>{WORLD}"

    def inside(element: str) -> str:
        return f"{WORLD}{element}"

    steps = [
        seed(f"timestep {value} and {of[0][0]}", STEP, f'timestep="{value}"', "timestep", of=of)
        for value in ("0", "-1", "nan", "inf", "1e-12", "10", "1e-7")
        for of in (TASKS, INSPECT)
    ]
    return [
        *steps,
        seed("mass nan", MASS, 'mass="nan"', 'mass="nan" of <geom>'),
        seed("mass nan at export", MASS, 'mass="nan"', 'mass="nan" of <geom>', of=EXPORT),
        seed("mass 0 at export", MASS, 'mass="0"', of=EXPORT),
        seed("mass inf", MASS, 'mass="inf"', 'mass="inf" of <geom>'),
        seed("mass of 400 digits", MASS, f'mass="{"9" * 400}"'),
        seed("nuser_body 2e9", WORLD, size('nuser_body="2000000000"'), "nuser_body"),
        seed("nkey 1e9", WORLD, size('nkey="1000000000"'), "nkey"),
        seed("memory 5G", WORLD, size('memory="5G"'), "memory"),
        seed(
            "a huge hfield",
            WORLD,
            f'<asset><hfield name="h" nrow="99999" ncol="99999" size="1 1 1 1"/></asset>{WORLD}',
            "hfield",
        ),
        seed(
            "a million copies",
            WORLD,
            inside('<replicate count="1000000"><geom size="1"/></replicate>'),
            "replicate",
        ),
        seed(
            "copies of copies",
            WORLD,
            inside(
                '<replicate count="3000"><replicate count="3000"><geom size="1"/></replicate></replicate>'
            ),
            "replicate",
        ),
        seed("an effect on nothing that moves", 'type="slide" axis="1 0 0"', 'type="slide" axis="0 0 0"'),
        seed("a model that includes itself", WORLD, f'<include file="model.xml"/>{WORLD}'),
        seed("100,000 elements in each other", WORLD, WORLD + "<body>" * 100_000 + "</body>" * 100_000),
        seed("entities that are a billion", "<mujoco", f"{_ENTITIES}<mujoco", of=TASKS, end=taken()),
        seed(
            "a name of entities that are a billion",
            '<mujoco model="slider"',
            f'{_ENTITIES}<mujoco model="&e9;"',
            end=taken(),
        ),
        seed("an unknown element", WORLD, f"<arm/>{WORLD}", "arm"),
        seed("a name of markup", 'name="block"', 'name="[/]"', end=taken()),
        seed("a comment", WORLD, f"<!-- of a stranger -->{WORLD}", end=taken()),
        case(TASKS, b"", refused("is empty"), "an empty model"),
        case(TASKS, text.encode("utf-16"), refused(), "a model in UTF-16"),
        Case(*TASKS, {MODEL: None}, expected=refused("does not exist"), name="no model"),
    ]


def case(of: tuple, content: bytes, expected: Expected | None = None, name: str = "") -> Case:
    arguments, needs = of
    outputs = next((o for o in OUTPUTS if o[0] in arguments), ())
    return Case(arguments, needs, {MODEL: content, **FILES}, outputs, expected, name)


def cases(inputs: Path) -> st.SearchStrategy[Case]:
    content = Sound((inputs / MODEL).read_bytes())
    changed = st.one_of(
        mutated_model(content), mutated_model(content), mutated_model(content), mutated_bytes(content)
    )
    of = st.sampled_from(COMMANDS)
    made = st.builds(case, of, changed)
    return st.one_of(made, made, made, made, without_numbers(content))


def without_numbers(content: bytes) -> st.SearchStrategy[Case]:
    """One number of the model is none: that is always refused."""

    @st.composite
    def make(draw) -> bytes:
        root = ElementTree.fromstring(content)
        numeric = [(e, a) for e in root.iter() for a, v in e.attrib.items() if _is_numbers(v)]
        element, attribute = draw(st.sampled_from(numeric))
        numbers = element.get(attribute).split()
        numbers[draw(st.integers(0, len(numbers) - 1))] = draw(
            st.sampled_from(("nan", "NaN", "inf", "-inf", "1e999"))
        )
        element.set(attribute, " ".join(numbers))
        return ElementTree.tostring(root)

    return st.builds(case, st.sampled_from(COMMANDS), make(), st.just(refused()))


def _is_numbers(text: str) -> bool:
    return bool(text) and all(c in "0123456789.-e " for c in text)


@st.composite
def mutated_model(draw, content: bytes) -> bytes:
    """The model with one to three of its attributes and elements changed, or others added."""
    root = ElementTree.fromstring(content)
    values = st.one_of(
        st.sampled_from(USUAL),
        st.sampled_from(USUAL),
        st.sampled_from(NUMBERS),
        st.sampled_from((*TEXTS, *FILES)),
    )
    for _ in range(draw(st.sampled_from((1, 1, 2, 3)))):
        elements = list(root.iter())
        element = draw(st.sampled_from(elements))
        match draw(st.sampled_from(("attribute", "attribute", "add", "add", "remove", "copy", "new"))):
            case "attribute" if element.attrib:
                name = draw(st.sampled_from(sorted(element.attrib)))
                numbers = element.get(name).split()
                if len(numbers) > 1 and draw(st.booleans()):
                    numbers[draw(st.integers(0, len(numbers) - 1))] = draw(values)
                    element.set(name, _legal(" ".join(numbers)))
                else:
                    element.set(name, _legal(draw(values)))
            case "add":
                place = draw(st.sampled_from([e for e in elements if e.tag in PARTS]))
                part = draw(st.sampled_from(PARTS[place.tag]))
                parsed = ElementTree.fromstring(part)
                for inner in parsed.iter():
                    for name, value in inner.attrib.items():
                        inner.set(name, _legal(value.replace("{}", draw(values))))
                place.insert(draw(st.integers(0, len(place))), parsed)
            case "remove":
                parents = [e for e in elements if len(e)]
                if parents:
                    parent = draw(st.sampled_from(parents))
                    parent.remove(parent[draw(st.integers(0, len(parent) - 1))])
            case "copy":
                parent = draw(st.sampled_from(elements))
                parent.append(copy.deepcopy(element))
            case "new":
                element.set(
                    draw(
                        st.sampled_from(
                            ("name", "mass", "pos", "class", "range", "user", "xyz", "damping", "armature")
                        )
                    ),
                    _legal(draw(values)),
                )
    return ElementTree.tostring(root)


def _legal(text: str) -> str:
    """XML has no place for control characters."""
    return "".join(c for c in text if c.isprintable() or c == " ")
