"""Samples drawn anew over the hours of all days: what windows see of each place, and where that leads."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy.linalg import expm

from sampling_design import Plant, design_schedule
from sampling_design.design.bounds.relaxation import relax_placed, unsolved
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.orthogonal_flow import squares
from sampling_design.design.problem.positions import worst_sigma2
from sampling_design.design.search import heat_bath, local_search
from sampling_design.design.search.fedorov_exchange import is_admissible
from sampling_design.design.search.heat_bath import HeatBath, annealed, places
from sampling_design.design.search.rotations import rotated
from sampling_design.records.budget import Budget
from tests.benchmarks.design_bounds import PROBLEMS
from tests.cases import few

TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])
A = np.zeros((5, 5))
A[:2, :2], A[2:4, 2:4] = TURN, 2.3 * TURN
Q = np.linalg.qr(np.random.default_rng(1).normal(size=(5, 5)))[0]
MIXED = Plant(Q @ A @ Q.T, np.random.default_rng(2).normal(size=(2, 5)))  # two oscillators and a constant, two outputs
ALONE = Plant(A, [[1.0, 0.0, 1.0, 0.0, 1.0]])


def hours(repeats, *closed):
    """The same closed hours in each of some repetitions of length 1."""
    return np.array([[d + a, d + b] for d in range(repeats) for a, b in closed])


def problem(plant, repeats, samples, **changes):
    """Open for seven tenths of each repetition."""
    length = float(repeats)
    given = {"window": length, "period": length, "spacing": 0.15, "samples": samples}
    none = {"fixed": np.zeros(0), "available": (None,) * plant.n_outputs}
    return DesignProblem(plant, **(given | {"forbidden": hours(repeats, (0.3, 0.6))} | none | changes))


def plain(case, times, begin):
    """The Gram matrix of the window that begins at a time, seen from there, term by term."""
    W = np.zeros((case.plant.n_states,) * 2)
    for t, used in zip(times, case.mask(times), strict=True):
        for cycle in range(-4, 5):
            lag = t + cycle * case.period - begin
            if -1e-9 < lag < case.window - 1e-9:
                row = case.plant.C[used] @ expm(case.plant.A * lag)
                W += row.T @ row
    return W


def seen_of_all(bath, others):
    """What is seen of all places, by a bath that remembers nothing."""
    anew = HeatBath(bath.problem, bath.orthogonal_flow, bath.places, bath.unit)
    return anew.least_eigenvalues(others, *map(squares, bath.rows(others)), np.arange(bath.places.size))


def half_of_the_time(repeats):
    return (None, np.array([[d, d + 0.65] for d in range(repeats)]))


@pytest.mark.parametrize(
    ("plant", "available", "window"),
    few(
        [
            (*case, window)
            for case in [(ALONE, (None,)), (MIXED, (None, None)), (MIXED, half_of_the_time(4))]
            for window in [4.0, 8.0]
        ],
        *(0, 3, 4),
    ),
)
def test_what_is_seen_of_a_place_is_newtons_step_towards_the_least_eigenvalue_of_every_window(plant, available, window):
    case = problem(plant, 4, 7, window=window, available=available)
    rng = np.random.default_rng(3)
    spots = np.sort(np.array([d + h for d in range(4) for h in (0.0, 0.13, 0.29, 0.6, 0.71, 0.93)]))
    bath = HeatBath(case, case.orthogonal_flow, spots, unit=2.0)
    others = np.sort(rng.choice(spots, 6, replace=False) + 0.003)
    seen = seen_of_all(bath, others)
    assert seen.shape == (spots.size, 7)
    t = min(np.linalg.eigvalsh(plain(case, others, a))[0] for a in others) - heat_bath._BELOW * 2.0
    for place, found in zip(spots, seen, strict=True):
        times = np.sort(np.append(others, place))
        grams = [plain(case, times, a) for a in times]
        stepped = [t + 1 / np.trace(np.linalg.inv(W - t * np.eye(5))) for W in grams]
        np.testing.assert_allclose(np.sort(found), np.sort(stepped), rtol=1e-9)
        assert np.all(np.sort(found) <= np.sort([np.linalg.eigvalsh(W)[0] for W in grams]) * (1 + 1e-9))


def test_of_one_state_the_step_is_the_eigenvalue_itself():
    case = problem(Plant([[0.0]], [[2.0]]), 3, 5)
    bath = HeatBath(case, case.orthogonal_flow, np.array([0.1, 0.7, 1.1, 2.9]), unit=1.0)
    others = np.array([0.0, 0.2, 1.2, 2.2])
    np.testing.assert_allclose(seen_of_all(bath, others), 20.0, rtol=1e-12)


@pytest.mark.parametrize("plant", few([ALONE, MIXED], 0))
def test_the_best_of_all_arrangements_is_found(plant):
    """Six samples over three hours of five days, all 5005 arrangements looked at, begun at one that sees half of it."""
    case = problem(plant, 5, 6)
    spots = np.sort(np.array([d + h for d in range(5) for h in (0.05, 0.27, 0.8)]))
    every = np.array([spots[list(chosen)] for chosen in combinations(range(15), 6)])
    values = worst_sigma2(case, every)
    best = float(values.max())
    bath = HeatBath(case, case.orthogonal_flow, spots, unit=best)
    start = every[int(np.argsort(values)[values.size // 20])]
    found = bath.run(start, np.random.default_rng(4), steps=1500)
    reached = worst_sigma2(case, np.array([times for _, times in found])).max()
    assert reached == pytest.approx(best, rel=1e-9)
    assert float(worst_sigma2(case, start[None])[0]) < 0.5 * best


def drawn_anew(bath, times, rng, steps):
    """The schedule after each step, every one judged anew, from the same numbers drawn."""
    heats = heat_bath._WARM * (heat_bath._COOL / heat_bath._WARM) ** (np.arange(steps) / steps) / times.size
    for heat in heats:
        others = np.delete(times, rng.integers(times.size))
        free = bath.room(others).all(axis=0)
        seen = seen_of_all(bath, others)[free] / bath.unit
        soft = -np.log(np.exp(-heat_bath._SHARPNESS * seen).sum(axis=1)) / heat_bath._SHARPNESS
        odds = np.cumsum(np.exp((soft - soft.max()) / heat))
        place = int(np.searchsorted(odds, rng.uniform() * odds[-1], side="right"))
        times = np.sort(np.append(others, bath.places[free][place]))
        yield seen.min(axis=1)[place], times


@pytest.mark.parametrize("remembered", [20, 2000])
def test_a_run_draws_what_it_would_draw_if_every_step_were_judged_anew(monkeypatch, remembered):
    case, judged, own = problem(ALONE, 5, 6), [], HeatBath.least_eigenvalues
    spots = np.sort(np.array([d + h for d in range(5) for h in (0.05, 0.27, 0.8)]))
    start = spots[[0, 1, 4, 7, 10, 13]]
    bath = HeatBath(case, case.orthogonal_flow, spots, unit=1.0)
    plainly = max(drawn_anew(bath, start, np.random.default_rng(9), 150), key=lambda one: one[0])
    monkeypatch.setattr(heat_bath, "_REMEMBERED", remembered)
    monkeypatch.setattr(HeatBath, "least_eigenvalues", lambda *given: judged.append(1) or own(*given))
    value, times = bath.run(start, np.random.default_rng(9), steps=150)[0]
    assert value == pytest.approx(plainly[0], rel=1e-9)
    np.testing.assert_array_equal(times, plainly[1])
    assert len(judged) < 150


@pytest.mark.parametrize("lately", [1, 3])
def test_the_worst_window_is_found_whichever_were_the_worst_before(monkeypatch, lately):
    """Schedules that follow each other by chance, so that other windows become the worst again and again."""
    monkeypatch.setattr(heat_bath, "_LATELY", lately)
    case, rng, counts = problem(MIXED, 4, 7), np.random.default_rng(5), []
    spots, own = np.sort(rng.uniform(size=9)), np.linalg.eigvalsh
    bath = HeatBath(case, case.orthogonal_flow, spots, unit=1.0)
    monkeypatch.setattr(np.linalg, "eigvalsh", lambda W: counts.append(len(W)) or own(W))
    for _ in range(40):
        others = np.sort(rng.choice(spots, 6, replace=False))
        roots = rng.normal(size=(6, 5, 7))
        W = roots @ roots.transpose(0, 2, 1)
        assert bath.least(others, W) == pytest.approx(own(W)[:, 0].min(), rel=heat_bath._TIED)
        assert len(bath._lately) <= lately
    assert 6 in counts
    assert min(counts) < 6


@pytest.mark.long
@pytest.mark.parametrize(
    ("repeats", "samples", "spacing"), few([(3, 7, 0.32), (6, 12, 0.3), (9, 4, 0.6), (5, 5, 0.9)], 2)
)
def test_nothing_inadmissible_comes_out_and_the_best_start_is_beaten_or_kept(repeats, samples, spacing):
    case = problem(ALONE, repeats, samples, spacing=spacing)
    found = relax_placed(case)
    starts = rotated(case, found, 2, share=0.05)
    assert starts
    led = annealed(case, found, starts, np.random.default_rng(5))
    assert led
    assert all(is_admissible(case, times) for times in led)
    again = annealed(case, found, starts, np.random.default_rng(5))
    np.testing.assert_array_equal(np.array(led), np.array(again))


def test_places_are_the_hours_that_weigh_on_every_day_and_all_of_them_are_open():
    case = problem(ALONE, 6, 9)
    found = relax_placed(case)
    spots = places(case, found)
    assert case.mask(spots).all()
    np.testing.assert_allclose(np.diff(spots.reshape(6, -1), axis=0), 1.0, atol=1e-5)
    assert spots.size // 6 <= heat_bath._HOURS
    heavy = np.mod(found.times[found.weights >= 0.5 * found.weights.max()], 1.0)
    assert np.all(np.abs(heavy[:, None] - spots).min(axis=1) < 1e-5)


def test_none_where_flow_or_relaxation_do_not_serve_or_a_run_would_be_too_long(monkeypatch):
    case = problem(ALONE, 3, 7)
    found, rng = relax_placed(case), np.random.default_rng(6)
    starts = rotated(case, found, 1, share=0.05)
    assert annealed(case, found, starts, rng)
    assert annealed(case, unsolved(case, found.times, found.starts), starts, rng) == []
    assert annealed(case, found, starts, rng, budget=Budget(0.0)) == []
    assert annealed(problem(ALONE, 3, 1), found, starts, rng) == []
    growing = Plant(A + 0.1 * np.eye(5), ALONE.C)
    assert annealed(problem(growing, 3, 7), found, starts, rng) == []
    monkeypatch.setattr(heat_bath, "_WORK", 1000)
    assert annealed(case, found, starts, rng) == []


@pytest.mark.long
def test_it_is_asked_once_for_the_best_that_differ_and_only_where_something_is_left_to_gain(monkeypatch):
    """Three starts share two runs; where all that was led on ended alike, there is one."""
    case = problem(ALONE, 3, 7)
    found, asked, kept, led = relax_placed(case), [], [], local_search._led

    def counted(*given):
        asked.append(given[2])
        return annealed(*given)

    def watched(run, *given):
        result = led(run, *given)
        kept.append([times for _, times in run.good])
        return result

    monkeypatch.setattr(local_search, "KICKS", 0)  # what comes after it
    monkeypatch.setattr(local_search, "annealed", counted)
    monkeypatch.setattr(local_search, "_led", watched)
    most, sizes = -(-3 // local_search._STARTS_PER_BATH), set()
    for seed in (8, 11):
        asked.clear(), kept.clear()
        best = local_search.search(case, found, np.random.default_rng(seed), starts=3)
        assert is_admissible(case, best.times)
        (begun,) = asked
        np.testing.assert_array_equal(begun, kept[0][:most])
        sizes.add(len(begun))
        values = worst_sigma2(case, np.array(begun))
        assert np.all(-np.diff(values) > local_search._ALIKE * values[1:])
    assert sizes == {1, most} == {1, 2}
    asked.clear()
    local_search.search(case, found, np.random.default_rng(8), starts=3, enough=0.9 * best.sigma)
    local_search.search(replace(case, forbidden=np.zeros((0, 2))), found, np.random.default_rng(8), starts=1)
    assert asked == []


def test_a_schedule_without_room_stays_where_it_is():
    """Six samples as far apart as six can be: from any place but its own each one would be too near to another."""
    case = problem(ALONE, 6, 6, spacing=1.0)
    bath = HeatBath(case, case.orthogonal_flow, np.arange(6) + 0.25, unit=1.0)
    assert bath.run(np.arange(6) + 0.1, np.random.default_rng(7), steps=30) == []


@pytest.mark.long
@pytest.mark.parametrize("name", ["tidal gauge, the same in metres", "tidal gauge, 30 by daylight"])
def test_thirty_daylight_readings_come_within_four_hundredths_of_the_bound(name):
    """One reading a day, its hour going on evenly, ended at 4.7 and 5.4 hundredths; days with two or none end below."""
    plant, requirement = PROBLEMS[name]
    design = design_schedule(plant, requirement, starts=3, branches=0)
    assert design.gap < 0.04
    assert np.diff(design.schedule.times).min() >= 5.0
    assert np.all((np.mod(design.schedule.times, 24) >= 7) & (np.mod(design.schedule.times, 24) < 19))
