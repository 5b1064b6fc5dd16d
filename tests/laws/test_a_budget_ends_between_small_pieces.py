"""Law: a budget ends between pieces that are small, and no bound that it cuts short claims what more seconds refute.

The clock counts pieces of work (flows, values, judged choices, integrated gaps), so that no machine's speed enters.
"""

from __future__ import annotations

import contextlib
import time

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.accuracy import limit
from sampling_design.certificates.compare import contraction
from sampling_design.certificates.exact import proof, riccati
from sampling_design.certificates.exact.window_gains import WindowSet
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.positions import worst_sigma2
from sampling_design.design.search import costs
from sampling_design.design.search.local_search import FoundSchedule
from sampling_design.errors import UndecidedError
from sampling_design.numerics import conic_programs
from sampling_design.numerics.balls import BallFlow
from sampling_design.observability.worst_case import spaced_search
from sampling_design.observability.worst_case.spaced_rows import SpacedRows
from sampling_design.records.budget import ENDLESS, Budget
from sampling_design.uncertain.accuracy import accuracy_over_box, accuracy_varying
from sampling_design.uncertain.existence import existence_over_box
from sampling_design.uncertain.inclusion.program import InclusionProgram
from sampling_design.uncertain.observability import bracket_varying
from sampling_design.uncertain.observability.bracket_varying import kept_flows
from sampling_design.uncertain.observability.window_sigma_over_box import WindowsOverBox
from sampling_design.uncertain.plants import time_varying
from sampling_design.uncertain.plants.time_varying import TimeVaryingPlant
from tests.cases import few

UNEVEN = sd.PeriodicSchedule([0.7, 1.0, 0.4])
OSCILLATOR = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
S = np.array([[1.0, 0.3], [-0.2, 1.0]])
GROWING = sd.Plant(np.linalg.solve(S, np.diag([9.0, 0.0]) @ S), [[1.0, 0.4]])
"""Doubles lose what it shows within ten units of time; balls do not."""


class Pieces:
    """How many pieces were begun, and a clock that shows that."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.count, self.seconds, self.patch = 0, 1.0, monkeypatch
        monkeypatch.setattr(time, "perf_counter", lambda: self.count * self.seconds)

    def of(self, owner: object, name: str, size=lambda *given, **named: 1) -> None:
        """Count every call of one function of a class or module."""
        before = getattr(owner, name)

        def counted(*given: object, **named: object) -> object:
            self.count += size(*given, **named)
            return before(*given, **named)

        self.patch.setattr(owner, name, counted)


@pytest.fixture
def pieces(monkeypatch):
    return Pieces(monkeypatch)


@pytest.mark.parametrize("rigorous", [False, True])
def test_what_balls_had_no_time_for_is_undecided_and_not_zero(pieces, rigorous):
    """A spent budget closed the bracket at zero, where more seconds proved a sigma that is positive."""
    pieces.of(BallFlow, "over")
    pieces.seconds = 0.1
    answers = {}
    for most in (2, 10, 10_000):
        begun = pieces.count
        budget = most * pieces.seconds
        answers[most] = sd.window_sigma(GROWING, sd.PeriodicSchedule([2.5]), 10.0, rigorous=rigorous, budget=budget)
        assert pieces.count - begun <= most + 4
    whole = answers.pop(10_000)
    assert whole.closed
    assert whole.lower > 0
    for found in answers.values():
        assert (found.lower, found.closed, found.status) == (0.0, False, "budget")
        assert "nothing is proven" in str(found).lower()


def test_windows_in_balls_take_a_few_products_each(pieces):
    """Windows share what they overlap: twice as many samples in each cost twice as much in all, and not four times."""
    schedule = sd.PeriodicSchedule(np.random.default_rng(1).uniform(0.4, 0.6, 12))
    pieces.of(BallFlow, "over")
    spent = []
    for window in (6.0, 12.0):
        begun = pieces.count
        assert sd.window_sigma(OSCILLATOR, schedule, window, rtol=0.1, rigorous=True).rigorous
        spent.append(pieces.count - begun)
    assert spent[1] < 2 * spent[0]


def test_descents_over_a_box_end_with_the_budget(pieces):
    box = sd.UncertainPlant(OSCILLATOR, [sd.UncertainParameter("k", -0.2, 0.2, A=[[0.0, 0.0], [-1.0, 0.0]])])
    for name in ("value", "judge"):
        pieces.of(WindowsOverBox, name)
    for budget in (0.0, 5.0, 50.0):
        begun = pieces.count
        found = sd.window_sigma(box, UNEVEN, 4.0, rtol=1e-6, budget=budget)
        assert pieces.count - begun <= budget + 4
        assert (found.status, found.closed) == ("budget", False)
        assert 0 <= found.lower <= found.upper


def test_what_samples_measure_is_chosen_within_the_budget(pieces, monkeypatch):
    """Choices were judged by the hundred between two looks at the clock: forty states took ten seconds."""
    monkeypatch.setattr(costs, "_TOGETHER", 1)
    pieces.of(costs, "worst_sigma2", lambda problem, times, *given, **named: len(times))
    plant, prices = sd.Plant(np.diag([-0.1, 0.2]) + np.diag([1.0], 1), np.eye(2) + 0.3), np.array([1.0, 1.3])
    given = (6.0, 6.0, 0.3, 8, np.zeros((0, 2)), np.zeros(0), (None, None))
    problem = DesignProblem(plant, *given, costs=prices, cost_limit=10.0)
    times, met = np.arange(0.0, 6.0, 0.75), []
    for budget in (0.0, 30.0, 1e6):
        begun = pieces.count
        used = costs.thinned(problem, times, Budget(budget))
        assert pieces.count - begun <= budget + 2
        assert np.sum(used @ prices) <= 10.0
        assert used.any(axis=1).all()
        met.append(float(worst_sigma2(problem, times[None], used=used[None])[0]))
    assert max(met) == met[-1] > 0


@pytest.mark.parametrize("zones", few([None, [(0.2, 0.5), (1.1, 1.6)]], 1))
def test_a_limit_says_something_of_every_row_however_early_it_ends(pieces, zones):
    """Each row had a system of its own, even once no time was left: eight seconds, and zeros but for one row."""
    rng = np.random.default_rng(6)
    plant = sd.Plant(rng.standard_normal((6, 6)) / 2 - np.eye(6), rng.standard_normal((2, 6)))
    asked = {"w_bound": 0.1, "v_bound": 0.1, "zones": zones, "period": zones and 2.0}
    pieces.of(limit, "periodic_system")
    pieces.of(limit.GainSearch, "oppose")
    spent = sd.accuracy.accuracy_limit(plant, budget=1e-3, **asked)
    assert pieces.count <= 14  # steps that settle, one system, one adversary for all six rows
    assert (spent.closed, spent.verify()) == (False, True)
    whole = sd.accuracy.accuracy_limit(plant, rtol=0.2, **asked)
    assert np.all(spent.lower > 0)
    assert np.all(spent.lower <= whole.lower * 1.2)


def test_accuracy_along_a_varying_plant_ends_at_the_times_that_it_looked_at(pieces, swing):
    """All times were looked at, whatever was left: thirteen seconds of fourteen states for a third of one."""
    asked = {"w_bound": 0.1, "v_bound": 0.1}
    schedule = sd.Schedule(np.arange(0.0, 4.1, 0.5))
    whole = sd.guaranteed_accuracy(swing, schedule, **asked)
    pieces.of(accuracy_varying._CellProgram, "bracket")
    for budget in (1.0, 20.0):
        begun = pieces.count
        found = sd.guaranteed_accuracy(swing, schedule, budget=budget, **asked)
        assert pieces.count - begun <= budget + 3  # two rows, and finer cells of one
        assert not found.closed.any()
        for t in found.times:
            same, all_same = found.times == t, whole.times == t
            assert np.all(found.lower[:, same].min(axis=1) <= whole.upper[:, all_same].max(axis=1) * (1 + 1e-9))
            assert np.all(found.upper[:, same].max(axis=1) * (1 + 1e-9) >= whole.lower[:, all_same].min(axis=1))
    assert whole.closed.all()


def test_all_plants_of_a_box_are_bounded_before_its_corners_are_looked_at(pieces):
    """Corners took the seconds in which every plant could be bounded, and what was left of them proved nothing."""
    box = sd.UncertainPlant(OSCILLATOR, [sd.UncertainParameter("k", -0.01, 0.01, A=[[0.0, 0.0], [-1.0, 0.0]])])
    asked = {"w_bound": [0.1, 0.1], "v_bound": [0.1]}
    pieces.of(accuracy_over_box, "bracket_of_rows")
    spent = sd.guaranteed_accuracy(box, UNEVEN, rtol=1e-3, budget=1.5, **asked)
    assert pieces.count == 2  # the plant in the middle, and all about it
    assert not spent.closed.any()
    nominal = sd.guaranteed_accuracy(OSCILLATOR, UNEVEN, **asked)
    assert np.all(nominal.lower <= spent.upper)
    assert np.all(spent.lower > 0)
    assert np.all(spent.lower <= spent.upper)


def test_a_spent_budget_thins_one_start_and_enumerates_no_choice(monkeypatch):
    """Of prices the search went through all starts, and every choice of what samples measure, when time was over."""
    monkeypatch.setattr(costs, "_promising", lambda *given: pytest.fail("choices were enumerated"))
    begun = []
    monkeypatch.setattr(costs, "thinned", lambda *given, thinned=costs.thinned: begun.append(1) or thinned(*given))
    plant = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], np.eye(2) + 0.3)
    given = (6.0, 6.0, 0.3, 8, np.zeros((0, 2)), np.zeros(0), (None, None))
    problem = DesignProblem(plant, *given, costs=np.array([1.0, 1.3]), cost_limit=10.0)
    found = FoundSchedule(np.arange(0.0, 6.0, 0.75), 0.0, (), True)
    best, chosen = costs.affordable(problem, found, costs.relax_costly(problem, 0.0), Budget(-1.0))
    assert len(begun) <= 2  # before and after the times were refined
    assert best.sigma > 0
    assert np.sum(chosen @ problem.costs) <= 10.0


def test_maps_of_windows_are_followed_within_the_budget(pieces):
    """A radius took a second and a half between two looks: twenty states, windows side by side."""
    made = sd.certify(OSCILLATOR, UNEVEN, eta=0.3, P2=np.eye(2))
    pieces.of(contraction, "joint_update")
    whole = sd.certificates.least_contracting(made)
    assert whole > 0
    assert pieces.count > 20
    for budget in (0.5, 5.0, 20.0):
        begun = pieces.count
        with pytest.raises(UndecidedError, match="not every length was tried within `budget` = "):
            sd.certificates.least_contracting(made, budget=budget)
        assert pieces.count - begun <= budget + 1


@pytest.fixture(scope="module")
def swing():
    return TimeVaryingPlant(lambda t: [[0.0, 1.0], [-1 - 0.5 * np.cos(t), 0.0]], lambda t: [[1.0, 0.0]], horizon=16.0)


def test_every_gap_of_a_varying_plant_is_integrated_once(pieces, swing):
    times = np.arange(0.0, 6.1, 0.5)
    pieces.of(TimeVaryingPlant, "transitions")
    flows, whole = kept_flows(swing), swing.transitions(times)
    for _ in range(2):
        kept = flows(tuple(times.tolist()), ENDLESS)
        for key in ("F", "C", "errors", "proven"):
            assert np.array_equal(getattr(kept, key), getattr(whole, key))
    assert pieces.count == times.size  # the whole, and each gap


def test_windows_of_a_varying_plant_that_nobody_looked_at_are_not_proven(pieces):
    knots = np.linspace(0.0, 16.0, 9)
    stack = [[[0.0, 1.0], [-1 - 0.5 * np.cos(t), 0.0]] for t in knots]
    table = TimeVaryingPlant.from_table(knots, stack, [[[1.0, 0.0]]] * 9)
    schedule = sd.Schedule(np.arange(0.0, 16.1, 0.5))
    whole = sd.window_sigma(table, schedule, 4.0)
    pieces.of(time_varying, "_series")
    for budget in (0.0, 3.0, 40.0, 150.0):
        begun = pieces.count
        found = sd.window_sigma(table, schedule, 4.0, budget=budget)
        assert pieces.count - begun <= budget + 2
        assert (found.status, found.closed) == ("budget", False)
        assert found.lower <= whole.lower <= whole.upper <= found.upper
        assert ("none is attained yet" in str(found)) == np.isinf(found.upper) == (budget < 40)
    assert whole.lower > 0 == found.lower


def test_functions_of_a_varying_plant_are_followed_within_the_budget(pieces):
    looked = []
    plant = TimeVaryingPlant(lambda t: looked.append(t) or [[0.0, 1.0], [-1 - 0.5 * np.cos(t), 0.0]],
                             lambda t: [[1.0, 0.0]], horizon=16.0)  # fmt: skip
    pieces.patch.setattr(time, "perf_counter", lambda: len(looked))
    for budget, status in ((20.0, "budget"), (3000.0, "sampled")):
        begun = len(looked)
        found = sd.window_sigma(plant, sd.Schedule(np.arange(0.0, 16.1, 0.5)), 4.0, budget=budget)
        assert len(looked) - begun <= 1.1 * budget + 60  # growth is looked at between what was evaluated by then
        assert (found.lower, found.status) == (0.0, status)


def test_gains_over_a_box_end_with_the_budget(pieces):
    """A filter of four hundred periods was run for every cell, thirty-two of them between two looks at the clock."""
    box = sd.UncertainPlant(OSCILLATOR, [sd.UncertainParameter("k", -0.3, 0.6, A=[[0.0, 0.0], [-1.0, 0.0]])])
    for name in ("update_with_gain", "judged"):
        pieces.of(existence_over_box, name)
    schedule = sd.PeriodicSchedule([2.7])
    whole = sd.uncertain.largest_box(box, schedule, eta=0.1, budget=1e6)
    assert whole.closed
    assert pieces.count > 200
    for budget in (1.0, 30.0):
        begun = pieces.count
        found = sd.uncertain.largest_box(box, schedule, eta=0.1, budget=budget)
        assert pieces.count - begun <= budget + 3
        assert found.share <= whole.refuted
        begun = pieces.count
        with pytest.raises(UndecidedError, match="exists for every plant of the box"):
            sd.certificate_exists(box, sd.PeriodicSchedule([2.5]), 0.1, budget=budget)
        assert pieces.count - begun <= budget + 3


def test_no_two_times_of_a_varying_plant_are_nearer_than_events_are_told_apart(swing, monkeypatch):
    """An integrator refuses an interval of two roundings, and with it the search."""
    asked, before = [], bracket_varying.VaryingSearch.before
    monkeypatch.setattr(
        bracket_varying.VaryingSearch, "before", lambda *given: asked.append((given[1].at, given[2])) or before(*given)
    )
    found = sd.window_sigma(swing, sd.Schedule(np.arange(0.0, 8.1, 1.0)), 7.9, rtol=1e-15)
    assert found.status == "sampled"
    assert min(late - early for late, early in asked) > 16 * np.finfo(float).eps * 8.0


@pytest.mark.parametrize(
    ("limit", "value", "why"),
    [("MOST_NUMBERS", 1e2, "was proven at rate"), ("SETTING_UP", 1.0, "within `budget` = 5 s")],
)
def test_a_program_of_an_inclusion_that_is_too_large_is_not_posed(limit, value, why, monkeypatch):
    """Blocks of forty states took fifteen seconds before the solver was asked whether it could hold them."""
    monkeypatch.setattr(conic_programs, limit, value)
    monkeypatch.setattr(InclusionProgram, "_flow", lambda *given: pytest.fail("it was posed"))
    varying = sd.UncertainPlant(
        OSCILLATOR, [sd.UncertainParameter("k", -0.1, 0.1, A=[[0.0, 0.0], [-1.0, 0.0]])], varying=True
    )
    with pytest.raises(UndecidedError, match=why):
        sd.uncertain.certify_inclusion(varying, UNEVEN, eta=0.1, budget=5.0)


def test_a_late_search_follows_few_windows(pieces):
    """The first scale that is allowed will do: ten more were tried for one digit of a shape that is judged anyway."""
    pieces.of(WindowSet, "looked")
    pieces.seconds = 0.1
    assert sd.certify(OSCILLATOR, UNEVEN, eta=0.3, budget=0.5).verify().passed
    assert pieces.count <= 4


def test_a_window_that_is_followed_alone_ends_with_the_budget(pieces, monkeypatch):
    """Where all together take too much work the highest is followed for four times as many samples: for 3 s more."""
    monkeypatch.setattr(proof, "LOOK_WORK", 1e5)
    pieces.of(riccati, "_may_still_grow")
    pieces.seconds = 1e-3
    slow = sd.Plant([[-0.004, 0.013], [-0.013, -0.004]], [[0.01, 0.0]])
    with contextlib.suppress(UndecidedError):
        sd.certify(slow, sd.PeriodicSchedule([1.0]), eta=0.02, P2=1e-3 * np.eye(2), budget=0.4)
    assert 350 < pieces.count < 410


@pytest.mark.parametrize("most", [1, 20_000])
def test_the_table_of_a_search_for_worst_times_has_a_size(most, monkeypatch):
    """Forty states with late readings asked for nine gigabytes."""
    sizes, moved = [], SpacedRows.moved
    monkeypatch.setattr(spaced_search, "_TABLE", most)

    def noted(*given):
        table = moved(*given)
        sizes.append(sum(part.size for part in table))
        return table

    monkeypatch.setattr(SpacedRows, "moved", noted)
    fast = sd.Plant([[0.0, 90.0], [-90.0, 0.0]], [[1.0, 0.0]])
    found = sd.worst_case_sigma(fast, sd.SpacedWindows(4.0, 3, 0.5), rng=0, budget=0.0)
    least = 3 * (spaced_search.LEAST_CELLS + 1) * 2
    assert sizes[0] <= max(1.5 * most, least)
    assert 0 <= found.lower <= found.upper


def test_a_box_that_no_time_is_left_for_is_not_descended_in(pieces):
    entries = {"k": (-0.9, 2.0, [[0.0, 0.0], [-1.0, 0.0]]), "d": (-0.3, 0.3, [[0.0, 0.0], [0.0, 1.0]])}
    box = sd.UncertainPlant(
        OSCILLATOR, [sd.UncertainParameter(k, low, high, A=A) for k, (low, high, A) in entries.items()]
    )
    asked = {"window": 3.0, "at_least": 0.4}
    for name in ("value", "judge"):
        pieces.of(WindowsOverBox, name)
    whole = sd.uncertain.largest_box(box, sd.PeriodicSchedule([1.4]), budget=1e6, **asked)
    assert whole.closed
    assert pieces.count > 50
    for budget in (1.0, 20.0):
        begun = pieces.count
        found = sd.uncertain.largest_box(box, sd.PeriodicSchedule([1.4]), budget=budget, **asked)
        assert pieces.count - begun <= budget + 6
        assert found.share <= whole.refuted
        assert not found.closed
