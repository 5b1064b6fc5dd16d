"""Windows in more digits than doubles have: what doubles can follow is the same, and what they cannot is right."""

from __future__ import annotations

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, Schedule
from sampling_design.certificates.exact import precise
from sampling_design.certificates.exact.canonical import canonical
from sampling_design.certificates.exact.given_weights import weights_of
from sampling_design.certificates.exact.precise import PreciseWindows, precisely_chosen
from sampling_design.certificates.exact.riccati import supremum
from sampling_design.certificates.exact.window_gains import WindowSet
from sampling_design.certificates.exact.window_problem import window_problem
from sampling_design.checkers.outcome import WorkLimit
from sampling_design.errors import SolverError, UndecidedError
from sampling_design.numerics.balls import ball, definite, floats, matrix, precision
from tests.benchmarks.bench_certify_random import drawn
from tests.oracles.riccati import settled

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, -0.1]], [[1.0, 0.0]])
UNEVEN = PeriodicSchedule([0.7, 1.6])
P2 = np.array([[1.0, 0.3], [0.3, 2.0]])


def inside(plant, schedule):
    return canonical(plant, schedule, weights_of(plant, None, None, None))


def both(schedule, eta=0.3):
    """The windows in many digits, and those in doubles."""
    canon = inside(OSCILLATOR, schedule)
    problem = window_problem(canon.plant, canon.schedule, P2, *canon.weights, eta)
    plain = WindowSet.of(window_problem(canon.plant, canon.schedule, np.eye(2), *canon.weights, eta))
    return PreciseWindows(canon, eta, WorkLimit(np.inf)), plain, problem


@pytest.mark.parametrize("schedule", [UNEVEN, Schedule([0.5, 1.3, 2.9, 3.4])], ids=["periodic", "finite"])
def test_what_doubles_follow_is_the_same(schedule):
    precisely, plain, problem = both(schedule)
    anywhere, at_samples = precisely.peaks(P2)
    exact = supremum(problem)
    assert exact[0].value * 0.98 <= anywhere <= exact[0].value * (1 + 1e-6)
    assert exact[1].value * 0.98 <= at_samples <= exact[1].value * (1 + 1e-6)
    assert precisely.looked(P2).value == pytest.approx(plain.looked(P2).value, abs=0.02)
    size = np.array([1.0, 3.0])
    assert precisely.least_floor(size) == pytest.approx(plain.least_floor(size), rel=0.02)


def test_the_long_run_of_a_condition_of_1e33_is_right():
    """Three integrators in a row, growing and turning modes behind two gauges: each entry, and what is best known."""
    plant, schedule = drawn(331)
    canon = inside(plant, schedule)
    found = PreciseWindows(canon, 0.3, WorkLimit(np.inf))
    problem = window_problem(canon.plant, canon.schedule, np.eye(plant.n_states), *canon.weights, 0.3)
    exact = settled(problem.A.tolist(), problem.noise.tolist(), problem.rows.tolist(), problem.gaps.tolist(), 0.3)
    for Y, true in zip(found.cycle, exact, strict=True):
        assert floats(Y) == pytest.approx(true, rel=1e-4, abs=0)
    values = np.linalg.eigvalsh(floats(found.cycle[0]))
    assert values[0] < 1e-15 * values[-1]  # doubles cannot even hold it
    for row in problem.rows[0]:
        with precision(precise.BITS):
            seen = matrix(row[None]) * found.cycle[0] * matrix(row[:, None])
        assert 0 < float(seen[0, 0]) <= 1  # what a sample has just shown is known as well as it shows it


def test_a_gain_in_doubles_would_leave_far_more():
    """Why gains are taken in balls: in some direction that of doubles leaves ten times what a sample could."""
    plant, schedule = drawn(331)
    with precision(precise.BITS):
        found = PreciseWindows(inside(plant, schedule), 0.3, WorkLimit(np.inf))
        frame, after = found.frame, found.times.after(0)
        before = frame.flow.step(found.cycle[0], found.times.gaps[after]).mid()
        best = frame.sampled(before, after)
        assert definite(best * ball(1 + 1e-9) - frame.with_gain(before, after, frame.gain(before, after))) is True
        Y, C, V = floats(before), floats(frame.rows[after]), floats(frame.noises[after])
        rounded = matrix(np.linalg.solve(C @ Y @ C.T + V, C @ Y).T)
        assert definite(best * 10 - frame.with_gain(before, after, rounded)) is False


def test_what_settles_nowhere_says_so():
    blind = Plant(np.diag([0.1, 0.2]), [[1.0, 0.0]])
    with pytest.raises(SolverError, match="did not settle: the schedule is on the edge of what can be certified"):
        PreciseWindows(inside(blind, PeriodicSchedule([1.0])), 0.3, WorkLimit(np.inf))


def test_an_indefinite_weight_is_none():
    with pytest.raises(np.linalg.LinAlgError, match="P2 is not positive definite"):
        both(UNEVEN)[0].peaks(np.diag([1.0, -1.0]))


def test_a_search_that_has_used_its_work_looks_at_no_further_rate(monkeypatch):
    tried = list[float]()

    def fails(problem, choice, *rest):
        tried.append(choice.eta)
        raise UndecidedError("undecided: the proof is made to fail")

    monkeypatch.setattr(precise, "_proven", fails)
    weights, inner = weights_of(OSCILLATOR, None, None, None), inside(OSCILLATOR, UNEVEN)
    for work, whole, rates in ((1.0, 1e7, 1), (1e6, 1e7, 3), (1e6, 0.0, 0)):
        monkeypatch.setattr(precise, "PRECISE_WORK", work)
        tried.clear()
        with pytest.raises(UndecidedError, match="no proof closes in more digits than doubles have either"):
            precisely_chosen((OSCILLATOR, UNEVEN, weights), inner, (0.1, 0.3), None, 3.0, WorkLimit(whole))
        assert len(tried) == rates + 1  # and a fast one, whose work is its own
        assert tried[-1] * inner.time == pytest.approx((0.1 * 0.3**3) ** 0.25)


@pytest.mark.long
@pytest.mark.parametrize(("seed", "bounds", "most"), [(739, (0.06, 2.9), 10), (31306, (0.0447, 2.68), 31)])
def test_a_fast_rate_is_proven_where_the_proofs_before_it_have_used_all_work(seed, bounds, most):
    """Two integrators, three nearly equal slow modes, units 1e22 apart: at slower rates no window settles soon.

    Likewise a triple mode that grows, an integrator and an oscillator behind one output.
    """
    plant, schedule = drawn(seed)
    made = precisely_chosen(
        (plant, schedule, weights_of(plant, None, None, None)),
        inside(plant, schedule),
        bounds,
        None,
        3.0,
        WorkLimit(0),
    )
    assert made.verify().passed
    assert made.horizon().minimum < most * schedule.gaps[0]


@pytest.mark.parametrize("without", ["the extra", "work for a proof"])
def test_what_cannot_be_proven_is_undecided(without, monkeypatch):
    if without == "the extra":
        monkeypatch.setattr(precise, "find_spec", lambda name: None)
    else:
        monkeypatch.setattr(precise, "PRECISE_PROOF", 1.0)
    weights = weights_of(OSCILLATOR, None, None, None)
    with pytest.raises(UndecidedError, match="no proof closes in more digits than doubles have either"):
        precisely_chosen(
            (OSCILLATOR, UNEVEN, weights), inside(OSCILLATOR, UNEVEN), (0.3, 0.3), 0.3, 3.0, WorkLimit(1e7)
        )
