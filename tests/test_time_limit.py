"""`diagnose --time-limit`: a whole result with the best so far, in time, which says that it was ended."""

from __future__ import annotations

from dataclasses import replace

import pytest
from balances import Made
from conftest import draw_nothing
from diagnosing import look_among
from held_inputs import held_machine

from capture_cli.errors import CaptureError, OutOfTime
from capture_cli.estimate.prepared_log import PreparedLog
from capture_cli.report.diagnosis_findings import notes, placed
from capture_cli.select import explain as explaining
from capture_cli.select.candidates import all_candidates
from capture_cli.select.explain import Settings
from capture_cli.select.explanation import Explanation
from capture_cli.select.judged_models import Closing
from capture_cli.select.search.attribution import Attribution
from capture_cli.select.search.rivals import Rivals
from capture_cli.select.time_limit import TimeLimit
from capture_cli.simulate.engine import Engine
from capture_cli.stages.diagnose import diagnose
from capture_cli.stages.record import record
from capture_cli.store.diagnosis import Diagnosis, DiagnosisRecord

ASKED = {"starts": 1, "threads": 1, "quiet": True, "expression": False}
PLANTED = ["coulomb-friction@x=1.5", "sensor-bias@q=0.05"]


FEW = ("coulomb-friction", "sensor-bias", "constant-force")


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """A search among a few effects is a fast one."""
    look_among(monkeypatch, *FEW)


@pytest.fixture(scope="module")
def asked(tmp_path_factory) -> dict:
    """Options of a diagnosis of a log with two effects."""
    folder = tmp_path_factory.mktemp("log")
    task = str(held_machine(folder / "slider", "slider", 0.008))
    options = {"noise": 5e-4, "episodes": 4, "duration": 1.5, "rate": 125.0, "threads": 1}
    record(task=task, out=folder / "log.zarr", effects=PLANTED, **options)
    return {"task": task, "real_log": folder / "log.zarr", **ASKED}


@pytest.fixture(scope="module")
def whole(asked, tmp_path_factory) -> tuple[dict, float]:
    """diagnosis.json of one that has time enough, and how long it took by the clock below."""
    with pytest.MonkeyPatch.context() as patch:
        look_among(patch, *FEW)
        draw_nothing(patch)
        clock = wound_up(patch)
        found = diagnose(out=tmp_path_factory.mktemp("whole") / "d", time_limit=1e6, **asked).document
    return found, clock.seconds


class Clock:
    """A clock that a simulated window moves by a second."""

    def __init__(self):
        self.seconds = 0.0
        self.longest = 0  # of a simulation call: the clock is looked at before each

    def rollout(self, engine: Engine, initial, *more, **options):
        found = self.own(engine, initial, *more, **options)
        self.seconds += len(initial)
        self.longest = max(self.longest, len(initial))
        return found


def wound_up(patch: pytest.MonkeyPatch) -> Clock:
    """Time is what simulations take, from here on."""
    clock = Clock()
    Clock.own = staticmethod(Engine.rollout)
    patch.setattr(Engine, "rollout", lambda *given, **options: clock.rollout(*given, **options))
    patch.setattr(TimeLimit, "now", lambda _=None: clock.seconds)
    return clock


def test_no_time_at_all_is_a_whole_result_without_effects(asked, tmp_path):
    found = diagnose(out=tmp_path / "d", time_limit=0.0, **asked).document
    assert found["verdict"] == "unexplained" and found["effects"] == []
    assert "time limit" in found["out_of_time"] and found["out_of_time"] in notes(DiagnosisRecord.of(found))
    assert "a refit of the declared model" in found["out_of_time"]
    assert [stage["refitted"] for stage in found["stages"]] == [False]
    assert (tmp_path / "d" / "report.html").is_file()
    # a run that may search longer takes it for another one
    with pytest.raises(CaptureError, match="time_limit"):
        diagnose(out=tmp_path / "d", resume=True, **asked)


def test_what_was_found_until_then_stands(asked, tmp_path, monkeypatch, without_pages):
    over, keep = [], Attribution._keep

    def kept(self, current):
        over.extend([True] * bool(self.answer.accepted))
        return keep(self, current)

    monkeypatch.setattr(Attribution, "_keep", kept)
    monkeypatch.setattr(TimeLimit, "now", lambda _=None: 1e6 if over else 0.0)
    found = diagnose(out=tmp_path / "d", time_limit=1e5, **asked).document
    assert found["effects"] and "a refit of the last model" in found["out_of_time"]
    names = [stage["model"] for stage in found["stages"]]
    assert [names[0], names[-1]] == ["declared", f"+ {placed(found['effects'][-1])}"]
    assert Diagnosis.read(tmp_path / "d").document == found


def test_without_a_limit_nothing_is_ended(whole):
    found, _ = whole
    # on a linear spring a bias of its sensor is a constant force
    names = {name.partition("@")[0] for e in found["effects"] for name in [e["name"], *e["tied_with"]]}
    assert len(found["effects"]) == 2 and names >= {"coulomb-friction", "sensor-bias"}
    assert found["out_of_time"] is None
    assert [stage["refitted"] for stage in found["stages"]] == [True, False, True]


def test_it_ends_in_time_and_says_what_was_left_out(asked, whole, tmp_path, without_pages, monkeypatch):
    clock, (_, seconds) = wound_up(monkeypatch), whole
    for share in (0.2, 0.95):
        clock.seconds = 0.0
        found = diagnose(out=tmp_path / str(share), time_limit=share * seconds, **asked).document
        assert 0.5 * share * seconds < clock.seconds <= share * seconds + clock.longest
        assert found["out_of_time"].startswith("The time limit ended the search")
        assert found["stages"][-1]["refitted"] and found["prediction"]["test"]
    declared, *_, last = (stage["select"]["normalized"] for stage in found["stages"])
    assert found["effects"] and last < declared  # of what held in the round that was cut short


def test_what_was_found_stands_once_where_the_time_ends_after_it(asked, tmp_path, without_pages, monkeypatch):
    def over(*_):
        raise OutOfTime

    monkeypatch.setattr(Rivals, "ask", over)
    found = diagnose(out=tmp_path / "d", **asked).document
    names = [e["name"] for e in found["effects"]]
    assert len(names) == 2 and len(set(names)) == 2
    assert found["out_of_time"].startswith("The time limit ended the search")


def test_what_is_stopped_is_left_out(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(TimeLimit, "now", lambda _=None: now[0])
    limit = TimeLimit(10.0)

    def work(seconds: float) -> str:
        now[0] += seconds
        limit.check()
        return "made"

    assert (limit.half, TimeLimit().half) == (5.0, 0.0)
    assert limit.made(lambda: work(5.0), "a", keeping=3.0) == "made"
    assert limit.made(lambda: work(3.0), "b", keeping=3.0) is None and limit.left_out == ["b"]
    assert limit.made(lambda: work(1.0), "c", keeping=0.0) == "made"
    assert work(100.0) == "made"  # nothing says how much is to be left
    assert limit.made(lambda: work(1.0), "b", keeping=0.0) is None and limit.left_out == ["b"]


def test_what_is_around_stops_what_is_within(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(TimeLimit, "now", lambda _=None: now[0])
    limit = TimeLimit(10.0)

    def late() -> None:
        now[0] = 7.0
        limit.check()

    with pytest.raises(OutOfTime), limit.keeping(4.0):
        limit.made(late, "a", keeping=2.0)
    assert limit.left_out == []
    with limit.keeping(2.0):
        assert limit.made(late, "a", keeping=4.0) is None and limit.left_out == ["a"]


def test_in_shorter_steps_more_is_kept_for_what_follows_a_search(monkeypatch):
    monkeypatch.setattr(TimeLimit, "now", lambda _=None: 80.0)
    prepared = Made.of("slider", episodes=1).prepared
    protocol = explaining._Protocol(prepared, Settings(threads=1, limit=TimeLimit(100.0)), lambda *_: None, 0)
    protocol.rows.closing = Closing(refit=1.0, whole=2.0)
    quarter = next(c.placed for c in all_candidates(prepared) if c.placed.effect.substeps == 4)
    search = protocol._attribution()
    with protocol.limit.keeping(protocol.rows.closing.after_search):
        search.answer.on_step("score", 0, 1, [])
        with pytest.raises(OutOfTime):
            search.answer.on_step("score", 0, 1, [quarter])
    protocol.limit.check()


@pytest.fixture(scope="module")
def explained() -> Explanation:
    """Of a short log, by the declared model alone."""
    return explained_by(Made.of("slider", episodes=1).prepared, most_effects=0)


def explained_by(prepared: PreparedLog, **settings) -> Explanation:
    nominal = prepared.task.space.nominal
    return explaining.explain(prepared, nominal, Settings(threads=1, **settings), lambda *_: None)


def leaving(explained: Explanation, left: float, **said) -> Explanation:
    """Another, whose last model leaves so many times the noise floor."""
    fit = explained.after.fit
    fit = replace(fit, at=replace(fit.at, residual=fit.at.residual * left / fit.error))
    last = replace(explained.after, fit=fit, again=fit)
    return replace(explained, models=[*explained.models[:-1], last], **said)


@pytest.mark.parametrize("left", [1.0, 4.0, 6.0])
@pytest.mark.parametrize("stopped", ["in the search", "before it", "not at all"])
def test_where_another_search_is_stopped_or_finds_less_what_was_found_before_stands(
    explained, monkeypatch, stopped, left
):
    as_acted = leaving(explained, 5.0, left_out=("minima",), rollouts=4)
    free = leaving(explained, left, out_of_time=stopped == "in the search", rollouts=9)

    def run(protocol, declared, *, last_time):
        if last_time and stopped == "before it":
            raise OutOfTime
        return free if last_time else as_acted

    prepared = explained.parts.prepared
    monkeypatch.setattr(explaining, "begins_as_acted", lambda _: True)
    monkeypatch.setattr(explaining._Protocol, "run", run)
    monkeypatch.setattr(explaining, "with_outliers", lambda prepared, *_: prepared)
    found = explained_by(prepared)
    is_free = found.models is free.models
    assert is_free or found.models is as_acted.models
    if stopped != "not at all":
        assert not is_free and found.left_out == ("minima", "a search with free initial states")
    elif left < 5.0:
        assert is_free and not found.left_out
    else:
        assert not is_free and found.left_out == ("minima",) and found.rollouts == 9
