"""A budget binds: what takes one in the room of certificates ends within 1.5 times it plus 2 s, with what it has."""

from __future__ import annotations

import numpy as np
import pytest

from sampling_design import GapRange, PeriodicSchedule, Plant, certify, robustness
from sampling_design.certificates.exact.efforts import SearchEffort
from sampling_design.certificates.exact.weight_choice import WeightSearch
from sampling_design.checkers.outcome import WorkLimit
from sampling_design.errors import UndecidedError
from sampling_design.numerics import conic_programs
from sampling_design.records.budget import Budget
from tests.cases import few
from tests.counted_clock import Counted

WIDE = Plant(
    np.diag([0.05, -0.3, 0.0, -1.0]) + np.diag([1.0, 0.5, 0.2], 1), [[1.0, 0.5, 0.2, 1.0], [0.0, 1.0, 0.0, 1.0]]
)
SCHEDULE = PeriodicSchedule([0.7, 1.0, 0.4])


@pytest.mark.parametrize("budget", few([0.05, 0.2, 0.5], 0))
def test_robustness_ends_in_time(budget):
    planned = certify(WIDE, SCHEDULE, eta=0.2, P2=np.eye(4))
    with Counted().running() as clock:
        found = robustness(WIDE, planned, budget=budget)
    assert clock.read() <= 1.5 * budget + 2
    assert not found.closed
    assert found.radius == 0 or found.jittered.verify().passed


def test_a_verdict_in_balls_ends_in_time():
    planned = certify(WIDE, SCHEDULE, eta=0.2, P2=np.eye(4))
    with Counted().running() as clock:
        assert planned.verify(rigorous=True, budget=0.3).verdict in ("proven", "undecided")
    assert clock.read() <= 1.5 * 0.3 + 2


@pytest.mark.parametrize("alone", [False, True])
def test_all_that_follows_a_search_looks_at_the_clock(alone):
    """Looks, checks and proofs in balls, of the first choices and of later ones, are over when the seconds are."""
    late = []
    first = SearchEffort(WorkLimit(1e9, stop=lambda: bool(late)), alone=alone)
    parts = [part for each in (first, first.later()) for part in (each.looks, each.floats, each.balls, each.whole)]
    parts += [first.check(), first.check_in_balls(), first.looks.share(1.0)]
    assert not any(part.over for part in parts)
    late.append("over")
    assert all(part.over for part in parts)


def test_a_search_that_is_late_judges_one_shape_more(monkeypatch):
    """A shape is many windows followed: of a large plant, seconds for each of ten that nothing could prove any more."""
    judged, judge = [], WeightSearch.judged
    monkeypatch.setattr(WeightSearch, "judged", lambda *given, **how: judged.append(given) or judge(*given, **how))
    monkeypatch.setattr(Budget, "over", property(lambda _: bool(judged)))  # spent as soon as one is
    with pytest.raises(UndecidedError, match="no certificate was proven within `budget`"):
        certify(WIDE, SCHEDULE, budget=1.0)
    assert 1 <= len(judged) <= 3  # a guess, and that one to the last digit


@pytest.mark.parametrize(
    ("limit", "value", "why"),
    [
        ("MOST_NUMBERS", 1e3, "would take more memory than a gigabyte. Certify rows of the state"),
        ("SETTING_UP", 1.0, "no certificate was proven within the budget"),
    ],
)
def test_a_program_that_memory_or_time_does_not_hold_is_not_posed(limit, value, why, monkeypatch):
    """Forty states took fifteen gigabytes and minutes for a budget of a second: nothing is handed to the solver."""
    monkeypatch.setattr(conic_programs, limit, value)
    monkeypatch.setattr(conic_programs, "solve_cone_program", lambda *given, **how: pytest.fail("it was posed"))
    with pytest.raises(UndecidedError, match=why):
        certify(WIDE, GapRange(0.3, 0.5), eta=0.2, budget=5.0)


def test_programs_are_judged_by_the_scalings_of_their_cones():
    """m^2 numbers for each cone of m = n(n+1)/2 entries, which are what a solver of that kind holds."""
    assert conic_programs.too_large([820] * 17) is None
    refused = conic_programs.too_large([820] * 18)
    assert refused.status == conic_programs.TOO_LARGE
    assert refused.details == {"numbers": 18 * 820.0**2}
    assert conic_programs.too_large([820], budget=0.1) is None
    assert conic_programs.too_large([820] * 10, budget=0.1).status == conic_programs.NO_TIME
    assert conic_programs.too_large([300], budget=0.0) is None
