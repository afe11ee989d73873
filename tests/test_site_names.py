"""Names of a model's parts may have dots in them: an effect at one is not taken for an effect at another."""

from __future__ import annotations

import mujoco
import pytest

from capture_cli.errors import OptionError
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.model.effects.placed import Placed
from capture_cli.select.candidates import Candidate, all_candidates
from capture_cli.select.search import attribution
from capture_cli.stages import diagnose as diagnose_stage
from capture_cli.stages.diagnose import diagnose
from capture_cli.stages.effect_option import parse_effects
from capture_cli.stages.export import export
from capture_cli.stages.record import record

TWO_JOINTS = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body name="a">
      <joint name="arm" type="slide" axis="1 0 0" damping="2" stiffness="40"/>
      <geom type="box" size=".1 .1 .05" mass="2"/>
      <body name="b">
        <joint name="arm.1" type="slide" axis="1 0 0" damping="1" stiffness="30"/>
        <geom type="box" size=".1 .1 .05" mass="1"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="d" joint="arm" ctrlrange="-20 20"/></actuator>
  <sensor><jointpos name="q" joint="arm"/><jointpos name="p" joint="arm.1"/></sensor>
</mujoco>
"""


def test_joints_may_have_dots_in_their_names(tmp_path, monkeypatch):
    """Of joints `arm` and `arm.1`: what is at one is not taken for what is at the other."""
    monkeypatch.setattr(diagnose_stage, "_write_pages", lambda *_: None)
    (tmp_path / "model.xml").write_text(TWO_JOINTS)
    task = tmp_path / "task.toml"
    task.write_text(
        'format = 1\nname = "two"\nmodel = "model.xml"\n[log]\nwindow = 0.5\n'
        '[parameters.mass]\nset = "body:a:mass"\nlow = 1.0\nhigh = 4.0\nunit = "kg"\n'
        '[inputs.d]\ncolumn = "d"\nunit = "N"\ninterpolate = "hold"\n'
        '[outputs.q]\ncolumn = "q"\nunit = "m"\n[outputs.p]\ncolumn = "p"\nunit = "m"\n'
    )
    effects = ["coulomb-friction@arm=2", "coulomb-friction@arm.1.friction=1.5"]
    made = record(
        task=str(task), out=tmp_path / "log.zarr", effects=effects, noise=5e-4, duration=12.0, rate=250.0
    )
    assert made.truth["effects"] == {
        "coulomb-friction@arm.friction": 2.0,
        "coulomb-friction@arm.1.friction": 1.5,
    }
    out = tmp_path / "found"
    monkeypatch.setattr(attribution, "all_candidates", coulomb_alone)
    found = diagnose(real_log=tmp_path / "log.zarr", task=str(task), out=out, threads=1, quiet=True).document
    values = {e["site"]: {n: p["value"] for n, p in e["parameters"].items()} for e in found["effects"]}
    assert {site: set(own) for site, own in values.items()} == {"arm": {"friction"}, "arm.1": {"friction"}}
    assert values["arm"]["friction"] == pytest.approx(2, abs=0.2)
    assert values["arm.1"]["friction"] == pytest.approx(1.5, abs=0.2)
    export(result=out, out=tmp_path / "exported.xml")
    exported = mujoco.MjModel.from_xml_path(str(tmp_path / "exported.xml"))
    assert exported.joint("arm.1").frictionloss[0] == values["arm.1"]["friction"]


def coulomb_alone(prepared: PreparedLog) -> list[Candidate]:
    return [c for c in all_candidates(prepared) if c.placed.kind == "coulomb-friction"]


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("coulomb-friction@arm.1=3", "coulomb-friction@arm.1.friction"),
        ("coulomb-friction@arm.1.friction=3", "coulomb-friction@arm.1.friction"),
        ("coulomb-friction@arm.friction=3", "coulomb-friction@arm.friction"),
        ("coulomb-friction@arm=3", "coulomb-friction@arm.friction"),
        ("coulomb-friction@arm.friction.friction=3", "coulomb-friction@arm.friction.friction"),
        ("coulomb-friction@a=b=3", "coulomb-friction@a=b.friction"),
        ("gravity-tilt.tilt_x=3", "gravity-tilt.tilt_x"),
    ],
)
def test_an_effect_is_named_where_sites_have_dots(text, name):
    xml = TWO_JOINTS.replace(
        "</worldbody>",
        "".join(
            f'<body><joint name="{n}" type="slide" axis="0 1 0"/><geom size=".1"/></body>'
            for n in ("arm.friction", "a=b")
        )
        + "</worldbody>",
    )
    found = parse_effects([text], mujoco.MjModel.from_xml_string(xml))
    [(kind, effect)] = found.placed
    at = effect.space.names.index(name.rpartition(".")[2])
    assert (
        f"{Placed(kind, effect).name}.{effect.space.names[at]}" == name
        and found.low[at] == found.high[at] == 3
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("coulomb-friction@leg.friction=3", "'leg' is not a site"),
        ("coulomb-friction@arm.fricton=3", "no parameter 'fricton'"),
        ("coulomb-friction@arm.=3", "no parameter ''"),
        ("coulomb-friction@arm", "gives friction no value"),
        ("Coulomb=3", "not of the form"),
    ],
)
def test_an_effect_that_is_not_there_is_named(text, said):
    with pytest.raises(OptionError, match=said):
        parse_effects([text], mujoco.MjModel.from_xml_string(TWO_JOINTS))
