"""The search: shares of the allowed time and back, and kicks that leave a local optimum."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

import sampling_design as sd
from sampling_design import Plant
from sampling_design.design.bounds.relaxation import relax_placed
from sampling_design.design.problem.canonical import canonical
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.gram import ScaledRows
from sampling_design.design.problem.positions import worst_sigma2
from sampling_design.design.search import local_search
from sampling_design.design.search.fedorov_exchange import (
    at_shares,
    is_admissible,
    packed,
    refined,
    repaired,
    shares_of,
)
from sampling_design.design.search.local_search import _kick, _ranked, _Refinement, search
from sampling_design.numerics.linalg import expm_batch
from sampling_design.records.budget import ENDLESS
from tests.cases import few
from tests.oracles.design import is_allowed, random_schedule

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])


def problem(**changes):
    plant = Plant(np.kron(np.diag([1.0, 1.7]), [[0.0, 1.0], [-1.0, 0.0]]), [[1.0, 0.0, 1.0, 0.0]])
    given = {"window": 6.0, "period": 6.0, "spacing": 0.2, "samples": 7}
    none = {"forbidden": np.zeros((0, 2)), "fixed": np.zeros(0), "available": (None,)}
    return DesignProblem(**({"plant": plant} | given | none | changes))


@pytest.mark.parametrize("forbidden", [np.zeros((0, 2)), np.array([[0.0, 1.0], [2.5, 3.0]])])
def test_spread_and_shares_undo_each_other(forbidden):
    case = problem(forbidden=forbidden)
    shares = np.sort((np.arange(7) + np.random.default_rng(1).uniform(0.2, 0.8, 7)) / 7)
    times = at_shares(case, shares)
    assert is_admissible(case, times)
    np.testing.assert_allclose(shares_of(case, times), shares, atol=1e-9)


@pytest.mark.long
def test_kicks_leave_a_poor_local_optimum():
    case = problem(forbidden=np.array([[i, i + 0.55] for i in range(6)]), samples=10, spacing=0.1)
    poor = packed(case)
    poor, value = refined(case, poor, float(worst_sigma2(case, poor[None, :])[0]), steps=100)
    run = _Refinement(case, ENDLESS, np.inf, poor, value, [])
    _kick(run, np.random.default_rng(0), 20)
    assert run.value > 1.01 * value
    assert run.value == pytest.approx(worst_sigma2(case, run.best[None, :])[0])
    assert is_admissible(case, run.best)
    assert {trial.start for trial in run.trials} == {"kick"}
    over = _Refinement(case, ENDLESS, np.sqrt(value) * (1 - 1e-9), poor, value, [])
    _kick(over, np.random.default_rng(0), 20)
    assert over.trials == []  # as good as the bound already


def test_what_is_told_of_a_search_rises(monkeypatch):
    """The share that is done never goes back, nor does sigma: kicks come after what is not kicked."""
    told = []
    monkeypatch.setattr(local_search, "KICKS", 2)
    case = problem(plant=OSCILLATOR, forbidden=np.array([[0.0, 0.55]]), samples=3, spacing=0.1)
    search(case, relax_placed(case), np.random.default_rng(0), 2, progress=lambda *one: told.append(one))
    shares, values = np.transpose(told)
    assert np.all(np.diff(shares) >= 0)
    assert 0.5 < shares[-1] <= 1
    assert np.all(np.diff(values) >= 0)


@pytest.mark.long
def test_fixed_samples_are_never_kicked():
    case = problem(fixed=np.array([1.0, 4.0]))
    found = search(case, relax_placed(case), np.random.default_rng(0), starts=1)
    assert {1.0, 4.0} <= set(found.times.tolist())
    every = problem(fixed=np.arange(7) * 0.8)
    assert len(search(every, relax_placed(every), np.random.default_rng(0), starts=1).trials) <= 4


def test_sigma_alone_is_sigma_whatever_the_states_and_their_scales():
    for count, scale in ((4, 1.0), (7, 1.0), (7, 1e5)):  # eight states, fourteen, and fourteen in unlike units
        A = np.kron(np.diag(1.0 + 0.7 * np.arange(count)), [[0.0, 1.0], [-1.0, 0.0]])
        units = np.append(scale, np.ones(2 * count - 1))
        rows = ScaledRows(Plant(A * units[:, None] / units, np.tile([[1.0, 0.0]], count) / units), 6.0)
        seen = np.random.default_rng(1).normal(size=(5, 3 * count, 2 * count))
        grams = np.swapaxes(seen, 1, 2) @ seen
        np.testing.assert_allclose(rows.least_sigma2(grams), rows.least(grams)[0], rtol=1e-9)


@pytest.mark.parametrize("name", ["oscillator", "satellite", "triple_integrator"])
def test_rows_and_flows_between_nodes_are_exponentials(name):
    """The fourth derivative times h^4/384 is what cubics lose: 2049 nodes leave eleven digits here."""
    plant = sd.named_plant(name)
    size = float(np.linalg.norm(plant.A, 2))
    rows = ScaledRows(plant, 4.0 / size)
    for shape in ((), (5,), (3, 4), (2, 0)):
        r = np.random.default_rng(1).uniform(0.0, rows.window, shape)
        r.ravel()[:2] = (0.0, rows.window)[: r.size]
        flows = expm_batch(rows.A, r.ravel()).reshape(*shape, *rows.A.shape)
        np.testing.assert_allclose(rows.flows(r), flows, rtol=0, atol=1e-11 * max(1.0, np.abs(flows).max(initial=0.0)))
        np.testing.assert_allclose(rows.rows(r), rows.C @ flows, rtol=0, atol=1e-11)


@pytest.mark.parametrize("growth", [0.0, 1e-4])
def test_rows_and_flows_are_exponentials_however_often_the_plant_turns(growth):
    """A window of 1e4 s holds 1600 turns, one to 1.3 nodes: nothing lies on a cubic between them."""
    rows = ScaledRows(Plant([[0.0, 1.0], [-1.0, growth]], [[1.0, 0.0]]), 1e4)
    r = np.random.default_rng(1).uniform(0.0, rows.window, (3, 4))
    flows = rows.R @ rows.plant.transition(r.ravel()) @ rows.S
    np.testing.assert_allclose(rows.flows(r).reshape(flows.shape), flows, rtol=0, atol=1e-9 * np.abs(flows).max())
    np.testing.assert_allclose(rows.rows(r).reshape(-1, 1, 2), rows.C @ flows, rtol=0, atol=1e-9)


@pytest.mark.long
def test_a_window_of_many_turns_is_designed_to_its_bound():
    asked = sd.Requirement(window=1e4, samples=4, spacing=1.0)
    design = sd.design_schedule(sd.named_plant("oscillator"), asked, starts=1, branches=0)
    assert design.gap < 1e-3  # rows read off cubics led to 3.9 %


def test_a_schedule_that_sees_more_than_was_said_is_refined():
    """The worst window is looked at whatever sigma was handed on: of other routes, by rounding, it may be less."""
    case = problem()
    times = np.array([0.0, 0.8, 1.7, 2.7, 3.3, 4.2, 5.1])
    assert refined(case, times, 0.0)[1] > float(worst_sigma2(case, times[None])[0])


def test_fewer_kicks_are_tried_of_many_samples(monkeypatch):
    tried = []

    def nothing_gained(case, times, value, **_):
        tried.append(case.samples)
        return times, value

    def led_nowhere(case, *_):
        tried.append(-case.samples)

    monkeypatch.setattr(local_search, "refined", nothing_gained)
    monkeypatch.setattr(local_search, "smoothed", led_nowhere)
    units = np.array([1.0, 2.0, 1.0, 2.0])
    for samples in (4, 96):
        turning = problem(samples=samples, spacing=0.05, window=12.0, period=12.0)
        stretching = replace(turning, plant=Plant(turning.plant.A * units[:, None] / units, turning.plant.C / units))
        times = at_shares(turning, (np.arange(samples) + 0.5) / samples)
        for case in (turning, stretching):
            _kick(_Refinement(case, ENDLESS, np.inf, times, 1e9, []), np.random.default_rng(0), 100)
    assert tried.count(4) == 12
    assert 0 < tried.count(96) <= 4
    assert tried.count(-4) == local_search._CHEAPER * 12
    assert 0 < tried.count(-96) <= local_search._CHEAPER * 4


def test_starts_that_tie_keep_their_order_whatever_rounding_says():
    assert _ranked(np.array([1 - 1e-12, 0.5, 1.0, 0.7])).tolist() == [0, 2, 3, 1]
    assert _ranked(np.array([1 - 1e-6, 0.5, 1.0, 0.7])).tolist() == [2, 0, 3, 1]
    assert _ranked(np.array([0.0, -1e-20, 0.0])).tolist() == [0, 2, 1]


def test_even_samples_of_an_oscillator_begin_half_a_gap_after_the_origin():
    """Moved at will they are as good: the first start that was found stays."""
    oscillator = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    found = sd.design_schedule(oscillator, sd.Requirement(window=2 * np.pi, samples=4, spacing=0.1))
    np.testing.assert_allclose(found.schedule.times, np.pi / 4 + np.pi / 2 * np.arange(4), rtol=1e-9)


NIGHT = np.array([[0.0, 1.0], [4.0, 6.0]])


@pytest.mark.parametrize(
    ("wished", "moved"),
    [
        ([1.5, 2.0, 3.9], [1.5, 2.0, 3.9]),  # nothing is in the way
        ([1.5, 2.0, 4.1], [1.5, 2.0, 4.0]),  # to the nearer side of the night
        ([0.8, 2.0, 3.5], [1.0, 2.0, 3.5]),
        ([1.5, 3.9, 3.95], [1.5, 3.75, 3.95]),  # two at closing: the earlier one gives way, neither waits for morning
        ([1.0, 1.1, 3.9], [1.0, 1.2, 3.9]),
    ],
)
def test_times_are_repaired_to_the_nearest_allowed_ones_either_way(wished, moved):
    case = problem(forbidden=NIGHT, samples=3)
    found = repaired(case, np.array(wished))
    assert is_admissible(case, found)
    assert np.abs(found - wished).sum() <= np.abs(np.array(moved) - wished).sum() + 1e-7


@pytest.mark.long
def test_repairs_are_near_the_least_that_all_choices_of_a_grid_move():
    rng, grid = np.random.default_rng(2), np.arange(0.0, 6.0, 0.1)
    for fixed in (np.zeros(0), np.array([2.5])):
        case = problem(forbidden=NIGHT, samples=3, spacing=0.7, fixed=fixed)
        free = grid[case.mask(grid).any(axis=1)]
        choices = np.array([t for t in combinations(free, 3) if is_admissible(case, np.array(t))])
        for _ in range(20):
            wished = np.sort(np.append(fixed, rng.uniform(0.0, 6.0, 3 - fixed.size)))
            found = repaired(case, wished)
            assert is_admissible(case, found)
            assert turned_cost(found, wished) <= 2 * min(turned_cost(t, wished) for t in choices) + 0.3


def turned_cost(times, wished):
    """By how much times are moved from those wished for, whichever of them goes where around the period."""
    turns = [np.mod(np.roll(times, i) - wished + 3.0, 6.0) - 3.0 for i in range(times.size)]
    return min(np.abs(turn).sum() for turn in turns)


def test_no_repair_is_found_where_there_is_no_room():
    assert repaired(problem(forbidden=NIGHT, samples=3, spacing=2.0), np.array([1.0, 2.0, 3.0])) is None
    assert repaired(problem(samples=3), np.array([1.0, 2.0])) is None


def test_periods_begin_where_the_longest_closed_time_ends_and_move_along_with_it():
    case = problem(forbidden=np.array([[0.0, 1.0], [2.0, 2.5], [5.0, 6.0]]))
    assert case.origin == 1.0
    assert 2.0 - 1e-7 < case.shut <= 2.0
    assert problem(available=(np.array([[1.0, 4.0], [4.0, 5.0]]),)).shut == pytest.approx(2.0)
    assert problem(forbidden=np.array([[0.5, 2.5], [3.5, 4.0]])).origin == 2.5
    assert problem(fixed=np.array([0.5, 1.0, 4.0])).origin == 0.5
    assert problem(fixed=np.array([0.2, 4.7, 5.2])).origin == 4.7
    assert problem().origin == 0.0
    repeated = np.array([[0.5, 1.0], [2.5, 3.0], [4.5, 5.0]])
    assert problem(forbidden=repeated).origin == 1.0
    assert canonical(problem(forbidden=repeated)).inside.origin == 0.0


@pytest.mark.parametrize(
    ("closed", "opening"), [([[4.0, 6.0]], 0.0), ([[0.3, 2.3]], 2.3), ([[0.0, 0.7], [4.7, 6.0]], 0.7)]
)
def test_a_sample_fits_where_an_opening_and_a_fixed_time_leave_the_spacing_just_so(closed, opening):
    case = problem(forbidden=np.array(closed), samples=2, spacing=1.3, fixed=np.array([opening + 1.3]))
    for posed, begin in ((case, opening), (canonical(case).inside, 0.0)):
        found = repaired(posed, np.sort(np.array([begin + 0.03, posed.fixed[0]])))
        assert np.abs(found - begin).min() < 1e-9
        assert is_admissible(posed, found)


def trials(*sigmas):
    return [local_search.SearchTrial("random", 0.0, sigma) for sigma in sigmas]


def test_kicks_end_where_all_that_was_refined_ends_alike(monkeypatch):
    tried = []

    def the_same_again(case, times, value, **_):
        tried.append(1)
        return times, 4.0

    monkeypatch.setattr(local_search, "refined", the_same_again)
    case = problem(samples=4, spacing=0.05, window=12.0, period=11.0)
    assert case.orthogonal_flow is None
    times = at_shares(case, (np.arange(4) + 0.5) / 4)
    for found, most in ((trials(*[2.0] * 11), 0), (trials(*[2.0] * 8), 2 * 3), (trials(1.0, 1.5, 1.8, 2.0), 2 * 12)):
        tried.clear()
        _kick(_Refinement(case, ENDLESS, np.inf, times, 4.0, found), np.random.default_rng(0), 100)
        assert len(tried) == most  # a first refinement and a second one for each kick


def test_after_a_heat_bath_kicks_end_where_they_begin_near_the_bound(monkeypatch):
    tried = []
    monkeypatch.setattr(local_search, "refined", lambda case, times, *_, **__: tried.append(1) or (times, 4.0))
    case = problem(samples=4, spacing=0.05, window=12.0, period=11.0)
    times = at_shares(case, (np.arange(4) + 0.5) / 4)
    for near, bound, kicked in (
        (local_search._BATHED_NEAR, 2.1, 0),
        (local_search._BATHED_NEAR, 2.2, 1),
        (None, 2.1, 1),
    ):
        tried.clear()
        run = _Refinement(case, ENDLESS, bound, times, 4.0, trials(1.0, 1.5, 1.8, 2.0))
        run.near = near or run.near
        _kick(run, np.random.default_rng(0), 1)
        assert bool(tried) == bool(kicked)


def test_the_share_of_starts_that_lead_to_other_optima():
    def share(*sigmas, abandoned=0):
        return _Refinement(
            problem(), ENDLESS, np.inf, np.zeros(4), 4.0, trials(*sigmas), abandoned=abandoned
        ).other_optima

    assert share(2.0) == 1.0
    assert share(*[2.0] * 8, 2.00001) == 2 / 72
    assert share(*[2.0] * 8, 1.9) == 6 / 72
    assert share(*[2.0] * 8, abandoned=1) == 6 / 72


INTEGRATORS = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])


@pytest.mark.parametrize(("window", "period"), [(1.0, 5.0), (2.5, 2.0)])
def test_schedules_that_miss_a_state_are_told_apart_by_how_long_they_do(window, period):
    hours = problem(plant=INTEGRATORS, window=window, period=period, spacing=0.1, samples=4)
    rng = np.random.default_rng(0)
    for times in (random_schedule(rng, period, 0.1, 4) for _ in range(5)):
        starts = (np.arange(4000) + 0.5) * period / 4000
        every = (times[:, None] + period * np.arange(4)).ravel()
        held = np.sum((every > starts[:, None]) & (every <= starts[:, None] + window), axis=1)
        graded = worst_sigma2(hours, times[None], graded=True)[0]
        if np.all(held >= 2):
            assert graded == worst_sigma2(hours, times[None])[0] > 0
        else:  # two samples show position and velocity, and one does not
            assert graded == pytest.approx(-np.mean(held < 2), abs=4e-3)


@pytest.mark.parametrize("closed", few([[[3.83, 4.3], [4.56, 4.8]], [[2.54, 2.77], [3.95, 4.32]]], 1))
def test_where_random_schedules_see_no_state_others_are_led_until_they_do(closed):
    hours = problem(plant=INTEGRATORS, window=1.0, period=5.0, spacing=0.1, samples=11, forbidden=np.array(closed))
    found = search(hours, relax_placed(hours), np.random.default_rng(1), starts=1)
    assert found.sigma > 0
    assert "restart" in {trial.start for trial in found.trials}
    assert is_allowed(found.times, 5.0, 0.1, closed)
