"""Hours that repeat, every day say: relaxations of one repetition, and starts whose hours go on evenly."""

import numpy as np
import pytest

from sampling_design import Plant, Requirement, design_schedule
from sampling_design.design.bounds.evidence import first_bound, placed_part
from sampling_design.design.bounds.relaxation import relax_placed, repeating, rows_at, solve_relaxation
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.positions import worst_sigma2
from sampling_design.design.search.fedorov_exchange import at_shares, is_admissible
from sampling_design.design.search.rotations import rotated
from sampling_design.plants import library
from sampling_design.records.budget import Budget


def hours(repeats, *closed):
    """The same closed hours in each of some repetitions of length 1."""
    return np.array([[d + a, d + b] for d in range(repeats) for a, b in closed])


def problem(repeats=3, samples=7, closed=((0.3, 0.55),), **changes):
    plant = Plant(np.kron(np.diag([1.0, 2.3]), [[0.0, 1.0], [-1.0, 0.0]]), [[1.0, 0.0, 1.0, 0.0]])
    length = float(repeats)
    none = {"forbidden": hours(repeats, *closed), "fixed": np.zeros(0), "available": (None,)}
    given = {"window": length, "period": length, "spacing": 0.15, "samples": samples}
    return DesignProblem(plant, **(given | none | changes))


def gauge():
    """Eleven tidal states, thirty daylight readings a month, in days."""
    plant = library.tidal_gauge()
    closed = hours(30, (0.0, 7 / 24), (19 / 24, 1.0))
    none = {"fixed": np.zeros(0), "available": (None,)}
    return DesignProblem(Plant(24.0 * plant.A, plant.C), 30.0, 30.0, 5 / 24, 30, closed, **none)


def test_one_repetition_is_worth_all_of_them():
    """Without the symmetry, windows and weights in every repetition for themselves: the same value."""
    case = problem()
    found = relax_placed(case)
    starts = np.arange(24) / 8
    mask = case.mask(found.times)
    rows = rows_at(case, found.times, starts, mask)
    ahead = np.mod(found.times - found.times[:, None] + 1e-9, case.period) < case.spacing
    whole = solve_relaxation(case, found.times, starts, rows, (1.0 * ahead, np.ones(found.times.size)), 7.0)
    assert found.value <= whole.value * (1 + 1e-4)  # it knows more windows
    assert found.value == pytest.approx(whole.value, rel=0.01)
    shares = np.einsum("mij,ij->m", found.Z, case.rows.N) * case.rows.unit
    for values in (found.weights, shares):
        np.testing.assert_allclose(values.reshape(3, -1), np.tile(values[: values.size // 3], (3, 1)), rtol=1e-9)
    assert shares.sum() == pytest.approx(1.0)
    assert found.weights.sum() == pytest.approx(7.0)


def test_the_bound_is_tight_where_one_hour_is_best():
    """An oscillator of four days, a sample a day: half of what is seen is of either state, and none sees more."""
    plant = Plant(np.array([[0.0, 1.0], [-1.0, 0.0]]) * np.pi / 2, [[1.0, 0.0]])
    asked = Requirement(window=4.0, period=4.0, spacing=0.5, samples=4, forbidden=hours(4, (0.2, 0.6)))
    design = design_schedule(plant, asked, starts=1, branches=0)
    assert design.sigma == pytest.approx(np.sqrt(2), rel=2e-3)
    assert design.sigma <= np.sqrt(2) <= design.upper_bound * (1 + 1e-9)
    assert design.gap < 2e-3


def test_ends_that_a_shift_rounds_are_not_lost():
    """Daylight opens at 7/24 of every day, which no double is: without that hour the gauge is seen 5 % less."""
    case = gauge()
    found = relax_placed(case)
    hour = np.mod(found.times, 1.0)[found.weights > 0.1] * 24
    assert np.any(np.abs(hour - 7.0) < 1e-5)
    assert np.any(np.abs(hour - 19.0) < 1e-5)
    assert (
        placed_part(case, found, budget=Budget(-1.0)).value <= np.sqrt(found.value) * 1.001
    )  # sharp between grid times too
    alone = [t for t in rotated(case, found, 4, share=0.03) if is_admissible(case, t)]
    assert len(alone) == 4
    reached = np.sqrt(worst_sigma2(case, np.array(alone)).max())
    assert 0.85 * np.sqrt(found.value) < reached < np.sqrt(found.value)
    rng = np.random.default_rng(0)
    drawn = np.array([t for t in (at_shares(case, rng.uniform(size=30)) for _ in range(12)) if t is not None])
    assert np.sqrt(worst_sigma2(case, drawn).max()) < 0.8 * reached


def test_nothing_repeats_where_one_day_is_unlike_the_others():
    case = problem()
    assert repeating(case)
    assert not repeating(problem(forbidden=np.append(case.forbidden, [[2.7, 2.8]], axis=0)))
    assert not repeating(problem(forbidden=np.zeros((0, 2))))  # turned at will
    assert not repeating(problem(fixed=np.array([0.1])))


def test_no_time_for_a_relaxation_leaves_a_true_bound():
    case = problem()
    found = relax_placed(case, seconds=0.0)
    assert found.record.status == "budget"
    assert first_bound(case, found, budget=Budget(-1.0)).value >= np.sqrt(relax_placed(case).value) * (1 - 1e-6)


def test_rotations_of_more_samples_than_days_and_of_fewer():
    for repeats, samples in ((3, 7), (9, 4)):
        case = problem(repeats, samples)
        found = rotated(case, relax_placed(case), 3, share=0.02)
        assert found
        assert all(is_admissible(case, times) for times in found)
        values = worst_sigma2(case, np.array(found), inner=0)
        assert np.all(np.diff(values) < 0)


def test_rotations_share_samples_among_days_whatever_a_day_is_called():
    days = problem(4, 6)
    hours = DesignProblem(
        Plant(days.plant.A / 24, days.plant.C), 96.0, 96.0, 3.6, 6, 24 * days.forbidden, np.zeros(0), (None,)
    )
    for case, day in ((days, 1.0), (hours, 24.0)):
        for times in rotated(case, relax_placed(case), 3, share=0.02):
            counts = np.bincount(np.floor(times / day).astype(int), minlength=4)
            assert sorted(counts) == [1, 1, 2, 2]
