"""A budget ends by the one clock, with its work, with what it is a part of, or where it is stopped."""

import pickle

import numpy as np
import pytest

from sampling_design.checkers.outcome import WorkLimit
from sampling_design.records import budget
from sampling_design.records.budget import ENDLESS, Budget, BudgetSpentError


@pytest.fixture
def clock(monkeypatch):
    """The one clock, set by hand."""
    at = {"perf_counter": 100.0, "time": 1.7e9}
    for name in at:
        monkeypatch.setattr(budget.time, name, lambda name=name: at[name])
    return at


def test_seconds_are_those_of_the_clock(clock):
    given = Budget(8.0)
    clock["perf_counter"] += 6.0
    assert (given.spent, given.left, given.over) == (6.0, 2.0, False)
    assert given.seconds_left() == 2.0
    assert given.seconds_left(3.0) == 3.0
    assert given.seconds_left(0.1, 0.25) == 0.5
    given.check()
    clock["perf_counter"] += 2.5
    assert (given.left, given.over) == (0.0, True)
    with pytest.raises(BudgetSpentError, match="the budget ran out"):
        given.check()


@pytest.mark.parametrize("given", [ENDLESS, Budget(), Budget(np.inf), Budget().share(0.5)])
def test_without_an_end_a_solver_is_given_none(given):
    assert not given.over
    assert given.left == np.inf
    assert given.seconds_left(1.0, 0.5) is None


def test_a_share_is_of_what_is_left_and_ends_with_the_whole(clock):
    whole = Budget(8.0)
    clock["perf_counter"] += 4.0
    part, late = whole.share(0.5), whole.share(1.0)
    assert (part.seconds, late.seconds) == (2.0, 4.0)
    clock["perf_counter"] += 2.5
    assert part.over
    assert not whole.over
    whole.stop()
    assert late.over
    assert late.left == 0.0


def test_what_is_counted_is_the_same_under_any_clock(clock):
    whole = Budget(1.0, counted=True)
    part = whole.share(0.5)
    part.add((0.25, 0.125), 2.0)
    clock["perf_counter"] += 1e9
    assert (part.spent, part.left, part.over) == (0.5, 0.0, False)
    part.spend(0.125)
    assert part.over
    assert (whole.spent, whole.over) == (0.625, False)
    whole.extend(0.5, 1.0, firm=True)
    whole.spend(1.875)
    assert (whole.limit, whole.spent, whole.left) == (2.5, 2.5, 0.0)
    with pytest.raises(BudgetSpentError, match="it does not fit into what is left"):
        whole.spend(0.125)
    assert whole.spent == 2.5
    whole.stop()
    whole.spend(0.125)
    assert whole.over


def test_nothing_is_counted_of_what_the_clock_measures(clock):
    given = Budget(1.0)
    given.add((10.0, 1.0), 5.0)
    assert (given.spent, given.over) == (0.0, False)


def test_work_ends_it_beside_the_seconds(clock):
    given = Budget(1.0, work=WorkLimit(10.0))
    given.check(10.0 - 1e-9)
    assert not given.over
    with pytest.raises(BudgetSpentError, match="the work ran out"):
        given.check(1.0)
    assert given.over


@pytest.mark.parametrize("wait", [0.0, 3.0, -5.0])  # a wall clock that is set back takes nothing
def test_it_goes_on_where_it_is_sent(clock, wait):
    given = Budget(8.0)
    clock["perf_counter"] += 2.0
    sent = pickle.dumps(given)
    clock["perf_counter"], clock["time"] = 7.0, clock["time"] + wait
    assert pickle.loads(sent).spent == pytest.approx(2.0 + max(wait, 0.0))
    counted = Budget(8.0, counted=True)
    counted.spend(3.0)
    assert pickle.loads(pickle.dumps(counted)).left == 5.0
