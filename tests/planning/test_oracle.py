"""How a choice of samples is judged: at the worst time of every gap, against disturbances that turn with the plant."""

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.planning import discrete_plant as room
from sampling_design.planning.accuracy_oracle import LONGEST, QUARTERS, SETTLED, AccuracyOracle, GridSpan
from sampling_design.planning.adversary_program import GridWindow
from sampling_design.planning.discrete_plant import discretize
from sampling_design.planning.problem import pose_plan
from sampling_design.planning.proven_choice import accuracy_of
from sampling_design.planning.search import PlanSearch
from sampling_design.records.budget import Budget
from tests.cases import few
from tests.counted_clock import Counted

BODY = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], states=["position", "velocity"], outputs=["y"])
DRIFT = sd.Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], states=["position", "velocity"], outputs=["y"])


def posed(plant, period, grid, at, w_bound=0.02):
    """The problem of a plant's position, and the choice of these steps."""
    terms = {"w_bound": w_bound, "sensors": {"y": {"noise_bound": 0.2}}}
    problem = pose_plan(plant, sd.PlanRequirement({"position": 0.5}, period=period, grid=grid, **terms))
    chosen = np.zeros_like(problem.allowed)
    chosen[at] = True
    return problem, chosen


def test_the_worst_time_of_a_gap_is_found_between_its_quarters():
    problem, chosen = posed(BODY, 6.4, 0.2, [0, 26])
    oracle = AccuracyOracle(problem, discretize(problem))
    oracle.back = 128
    window = oracle._window(chosen, GridSpan(0, 0, 26), 128)
    found = max(oracle.ratios_at(window, 0, 0, 26).values())
    every = [oracle.reach(window, offset, 0) for offset in range(27)]
    assert found == max(every)
    assert max(every[round(26 * i / QUARTERS)] for i in range(QUARTERS + 1)) < 0.99 * found
    few = oracle.ratios_at(window, 0, 0, 26, above=3 * found)  # far below what is asked
    assert len(few) == QUARTERS + 1


def test_a_disturbance_turns_with_the_plant_in_long_gaps(monkeypatch):
    problem, chosen = posed(BODY, 40.0, 0.5, [0, 34])
    proof = accuracy_of(problem, chosen)
    proven = float(proof.upper[0]) / 0.5
    judged = AccuracyOracle(problem, discretize(problem)).judge(chosen)[0]
    assert 0.97 * proven <= judged <= proven
    monkeypatch.setattr(room, "TURN", np.inf)
    assert AccuracyOracle(problem, discretize(problem)).judge(chosen)[0] < 0.9 * proven


def test_a_window_of_many_cells_is_put_together_without_writing_out_what_is_empty():
    discrete = discretize(posed(BODY, 6.4, 0.1, [0])[0])
    knots = np.arange(0, 12_000, 4)
    window = GridWindow(discrete, knots, np.zeros((knots.size, 1), dtype=bool), np.ones((knots.size, 1)))
    assert window.entries < 60 * knots.size


def test_the_past_is_followed_until_it_adds_nothing_and_no_farther():
    problem, chosen = posed(DRIFT, 8.0, 0.5, [0, 3], 0.002)
    oracle = AccuracyOracle(problem, discretize(problem))
    oracle.back = begun = 4  # enough for samples at every step, of which most are left out
    worst = oracle.judge(chosen)[0]
    search = PlanSearch(problem, oracle)
    found = search.deepened(chosen, worst, np.inf)
    assert found > worst * (1 + SETTLED)
    kept = oracle.back
    assert kept > begun
    assert search.pool.trajectories
    oracle.back = 8 * kept
    assert oracle.judge(chosen)[0] <= found * (1 + 3 * SETTLED)
    oracle.back = kept
    assert search.deepened(chosen, found, np.inf) == pytest.approx(found, rel=SETTLED)
    assert oracle.back == kept
    assert search.deepened(chosen, found, found / 2) == found


def test_a_short_past_refutes_and_what_held_is_not_judged_twice(monkeypatch):
    monkeypatch.setattr("sampling_design.planning.adversary_program.MANY", 100)
    problem, chosen = posed(BODY, 6.4, 0.2, [0, 26], w_bound=[0.02, 0.02])
    oracle = AccuracyOracle(problem, discretize(problem))
    oracle.back = 32 * 16
    worst, attacks = oracle.judge(chosen)
    assert len(attacks) == 2
    solved, reach = [], oracle.reach
    monkeypatch.setattr(oracle, "reach", lambda window, *rest: solved.append(len(window.knots)) or reach(window, *rest))
    refuted, found = oracle.judge(chosen, above=0.5 * worst)
    assert 0.5 * worst < refuted <= worst * (1 + 1e-3)
    assert all(attack.reach > 0.5 * worst for attack in found)
    assert max(solved) <= 4  # a sixteenth of the past
    held, _ = oracle.judge(chosen, above=1.01 * worst)
    assert held == pytest.approx(worst, rel=1e-3)
    assert max(solved) > 30
    solved.clear()
    assert oracle.judge(chosen, above=1.01 * worst)[0] == held
    assert not solved
    assert oracle.judge(chosen, above=0.9 * worst)[0] > 0.9 * worst  # another question: judged anew
    assert solved


@pytest.mark.parametrize("plant", [BODY, DRIFT])
def test_what_a_window_solved_bounds_other_rows_and_leaves_out_no_worst_time(plant):
    problem, chosen = posed(plant, 6.4, 0.2, [0, 26])
    oracle = AccuracyOracle(problem, discretize(problem))
    rows = np.random.default_rng(1).normal(size=(40, 2))

    def window():
        return oracle._window(chosen, GridSpan(0, 0, 26), 128)

    solved = window()
    assert np.isinf(solved.at_most(rows)).all()
    assert np.isfinite(solved.reach(rows[0]))
    assert np.isinf(solved.at_most(rows)).all()  # one direction of two states
    reached = [solved.reach(row) for row in rows[:3]]
    bound = solved.at_most(rows)
    assert bound[:3] == pytest.approx(reached, rel=1e-6)
    fresh = window()
    assert all(fresh.reach(row) <= most * (1 + 1e-6) for row, most in zip(rows, bound, strict=True))
    full = oracle.ratios_at(window(), 0, 0, 26)
    worst = max(full.values())
    for share in (0.5, 0.9, 1.0):
        again = oracle.ratios_at(solved, 0, 0, 26, known=share * worst)
        assert max(again.values(), default=0.0) == pytest.approx(worst, rel=1e-5) or share == 1.0
        assert all(full[offset] == pytest.approx(value, rel=1e-5) for offset, value in again.items() if offset in full)
    assert len(oracle.ratios_at(solved, 0, 0, 26, known=worst * 1.01)) < len(full)


@pytest.mark.parametrize("steps", few([20, 60], 0))
def test_what_a_judgment_takes_is_counted(steps):
    """Its windows and trajectories, too, of which a choice with as many gaps as steps has as many."""
    problem, chosen = posed(BODY, 8.0, 8.0 / steps, np.arange(1, steps))
    oracle = AccuracyOracle(problem, discretize(problem))
    oracle.back = 2 * steps
    with Counted(6e-7).running() as clock:  # as long as it takes
        oracle._judged(chosen, np.inf, False)
    assert clock.read() <= 1.5 * oracle.work.spent


def test_once_the_work_is_spent_a_choice_is_judged_in_its_longest_gaps(monkeypatch):
    problem, chosen = posed(BODY, 8.0, 0.4, np.r_[0, 3:20])
    seen, whole = [], AccuracyOracle(problem, discretize(problem))
    gap = AccuracyOracle._gap
    monkeypatch.setattr(AccuracyOracle, "_gap", lambda self, chosen, span, *more: seen.append(span.length) or
                        gap(self, chosen, span, *more))  # fmt: skip
    worst = whole.judge(chosen)[0]
    assert len(seen) == 18
    assert seen[:2] == [3, 1]
    seen.clear()
    oracle = AccuracyOracle(problem, discretize(problem), Budget(1e-3, counted=True))
    oracle.back = whole.back
    assert oracle.judge(chosen)[0] == pytest.approx(worst, rel=1e-6)
    assert seen == [3] + (LONGEST - 1) * [1]
