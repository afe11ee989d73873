"""Cases drawn from a strategy by a number, the same ones whenever it is the same."""

from __future__ import annotations

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis.strategies import SearchStrategy

from fuzz.cases import Case


def draw(strategy: SearchStrategy[Case], number: int, count: int) -> list[Case]:
    """At most `count` cases: hypothesis makes none twice."""
    found: list[Case] = []

    @seed(number)
    @settings(
        max_examples=count,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(strategy)
    def collect(case: Case) -> None:
        found.append(case)

    collect()
    return found[-count:]
