"""What a bound rests on, against exact arithmetic: badly conditioned plants, bad coordinates, growth."""

from math import comb

import mpmath
import numpy as np
import pytest

from sampling_design import Plant
from sampling_design.design.bounds.derivatives import change_of_bend, largest_derivatives
from sampling_design.design.bounds.evidence import BoundPart
from sampling_design.design.bounds.local_bound import _rounding
from sampling_design.design.bounds.weak_duality import cell_count, piece_edges, profile, roofs, value_at
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.gram import ROUNDING
from sampling_design.numerics.linalg import expm_batch
from sampling_design.plants import library
from tests.cases import few
from tests.oracles.filters import matrix


def turned(plant, condition):
    """The same plant in random coordinates of that condition number."""
    n = plant.n_states
    M = np.linalg.qr(np.random.default_rng(1).normal(size=(n, n)))[0] * np.logspace(0, np.log10(condition), n)
    return Plant(np.linalg.solve(M.T, (M @ plant.A).T).T, np.linalg.solve(M.T, plant.C.T).T)


def peaks(g):
    """At every edge the larger of the two one-sided limits of a profile, summed over outputs."""
    left, right = np.sum(g.left, axis=1), np.sum(g.right, axis=1)
    return np.maximum(np.append(right[-1], right), np.append(left, left[0]))


def spiral_and_oscillator(growth):
    """Growth over a window of one turn, seen together with what does not grow."""
    A = np.zeros((4, 4))
    A[:2, :2] = growth / (2 * np.pi) * np.eye(2) + [[0.0, 1.0], [-1.0, 0.0]]
    A[2:, 2:] = [[0.0, 2.0], [-2.0, 0.0]]
    return Plant(A, [[1.0, 0.0, 1.0, 0.0]])


INTEGRATORS = Plant(np.eye(8, k=1), np.eye(1, 8))
CLOSE = Plant(np.kron(np.diag([1.0, 1.1, 1.2]), [[0.0, 1.0], [-1.0, 0.0]]), np.tile([[1.0, 0.0]], 3))
PLANTS = {
    "eight integrators": (INTEGRATORS, 4.0),
    "eight integrators, hardly seen": (INTEGRATORS, 0.1),
    "eight integrators, turned": (turned(INTEGRATORS, 10.0), 4.0),
    "close frequencies in bad coordinates": (turned(CLOSE, 1e8), 6.3),
    "close frequencies in hopeless coordinates": (turned(CLOSE, 1e14), 6.3),
    "growth e^100 beside an oscillator": (spiral_and_oscillator(100.0), 6.3),
    "the same, turned": (turned(spiral_and_oscillator(100.0), 10.0), 6.3),
    "many turns": (Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]), 1e4),
    "gauge": (library.tidal_gauge(), 720.0),
}


def posed(name):
    plant, T = PLANTS[name]
    none = np.zeros((0, 2))
    return DesignProblem(plant, T, T, 0.05 * T, 4, none, np.zeros(0), (None,) * plant.n_outputs)


def few_directions(problem):
    """Roots of rank one in the scaled basis: the state that is seen best, the least seen one, and some between."""
    every = np.linalg.svd(problem.rows.R)[2]
    return [problem.rows.carried(x[None, :, None]) for x in (every[0], every[len(every) // 2], every[-1])]


def exactly(problem, roots, lag):
    """In 80 digits: the state x = R^-1 F, and Cx and x after `lag`; the squares of their lengths."""
    plant = problem.plant
    with mpmath.workdps(80):
        x = mpmath.lu_solve(matrix(problem.rows.R), matrix(roots))
        later = mpmath.expm(matrix(plant.A) * mpmath.mpf(lag), method="taylor") * x
        return [sum(v**2 for v in part) for part in (x, matrix(plant.C) * later, later)]


@pytest.mark.parametrize("name", few(PLANTS, 0, 4))
def test_multipliers_are_worth_what_they_say_and_see_no_more(name):
    problem = posed(name)
    lags = np.array([0.1, 0.6]) * problem.window
    for F in few_directions(problem):
        worth, seen = zip(*(exactly(problem, F[0], lag)[:2] for lag in lags), strict=True)
        found = value_at(problem, np.zeros(1), F @ np.swapaxes(F, 1, 2), lags).sum(axis=1)
        assert worth[0] >= 1
        short = max(true - mpmath.mpf(value) for true, value in zip(seen, found, strict=True))
        assert short <= 2 * problem.rows.rounding * max(seen)


@pytest.mark.parametrize("name", PLANTS)
def test_what_rounding_may_take_from_a_form_covers_what_it_takes(name):
    problem = posed(name)
    rows, lag = problem.rows, -0.4 * problem.window
    E = expm_batch(rows.A, [lag])
    for F in few_directions(problem):
        for C, true in zip((rows.C, rows.S), exactly(problem, F[0], lag)[1:], strict=True):
            value = np.array([np.sum((C @ E[0] @ F[0]) ** 2)])
            allowed = _rounding(rows.A, C[None], E, F, value, np.array([lag]))
            assert abs(mpmath.mpf(float(value[0])) - true) <= allowed[0]


def test_the_allowance_is_as_small_as_ever_where_nothing_cancels():
    for name in ("gauge", "growth e^100 beside an oscillator", "many turns"):
        assert posed(name).rows.rounding == ROUNDING
    assert ROUNDING < posed("eight integrators").rows.rounding < 1e-6


def test_weights_that_rounding_swallows_prove_nothing():
    hardly = Plant([[0.0, 1e20], [-1e-20, 0.0]], [[1e-20, 0.0]])  # x1 in a unit in which 1 is next to nothing
    problem = DesignProblem(hardly, 6.0, 6.0, 0.1, 4, np.zeros((0, 2)), np.zeros(0), (None,))
    assert not np.isfinite(problem.rows.carried(np.eye(2)[None])).any()
    for weights, proves in ((np.eye(2), False), (np.diag([1.0, 0.0]), True)):
        value = BoundPart("placed", np.zeros(1), weights[None], np.zeros((0, 2))).value_for(problem)
        assert np.isfinite(value) == proves


@pytest.mark.parametrize("name", few(PLANTS, 0, 1))
def test_roofs_cover_what_is_seen_inside_their_pieces(name):
    problem = posed(name)
    T, rng = problem.window, np.random.default_rng(4)
    edges = piece_edges(T, np.linspace(0.0, T, cell_count(problem) + 1))
    places = rng.integers(edges.size - 1, size=3)
    lags = edges[places] + rng.uniform(size=3) * np.diff(edges)[places]
    for F in few_directions(problem):
        seen = roofs(profile(problem, np.zeros(1), F @ np.swapaxes(F, 1, 2), edges), problem.mask(edges[:-1]))
        for place, lag in zip(places, lags, strict=True):
            assert exactly(problem, F[0], lag)[1] <= mpmath.mpf(float(seen[place]))


def test_roofs_are_near_where_outputs_see_little_of_a_large_state():
    problem = posed("eight integrators")
    edges = piece_edges(problem.period, np.linspace(0.0, problem.window, cell_count(problem) + 1))
    for F in few_directions(problem):
        g = profile(problem, np.zeros(1), F @ np.swapaxes(F, 1, 2), edges)
        # |C|^2 |Y'''| alone would be worth hundreds of times the highest peak of the state that is seen least
        assert roofs(g, problem.mask(edges[:-1])).max() <= 1.001 * peaks(g).max()


def test_derivatives_of_a_form_are_bounded_over_its_reach_and_near():
    problem = posed("eight integrators")
    A, C, reach = problem.rows.A, problem.rows.C, 0.02 * problem.window
    E = expm_batch(A, 0.8 * problem.window + reach * np.array([0.0, *np.linspace(-1.0, 1.0, 21)]))
    for F in few_directions(problem):
        most = largest_derivatives(A, C[None], (E[0] @ F[0])[None], np.array([reach]))[:, 0]
        y = [C @ np.linalg.matrix_power(A, i) @ E[1:] @ F[0] for i in range(4)]
        for p in range(4):
            true = abs(sum(comb(p, i) * np.sum(y[i] * y[p - i], axis=(1, 2)) for i in range(p + 1))).max()
            assert true <= most[p] * (1 + 1e-6)
            assert most[p] <= 40 * true  # norms alone: more than a million times


def test_what_has_no_derivative_has_none_however_long_the_reach_is():
    """A shift by 1e6 at most: y = 1 stays so, where a bound of the growth by norms is e^(2e6)."""
    A, C = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[[1.0, 0.0]]])
    most = largest_derivatives(A, C, np.array([[[1.0], [0.0]]]), np.array([1e6]))[:, 0]
    assert most.tolist() == [1.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("decades", [-18, 18])
def test_derivatives_are_numbers_in_all_units_of_time(decades):
    problem, rng = posed("eight integrators"), np.random.default_rng(1)
    unit = 2.0 ** (3 * decades)
    A, C, width = problem.rows.A + np.eye(8), problem.rows.C, np.array([0.01, 0.02]) * problem.window
    F, rows = rng.standard_normal((2, 8, 1)), np.stack([problem.rows.C, 0.0 * problem.rows.C])
    growth = np.array([[2.0, 0.0], [3.0, 0.0]])  # an output that observes nothing has no derivatives
    given = (F @ np.swapaxes(F, 1, 2), np.arange(2), width / unit, growth)
    here = change_of_bend(A, rows, given[0], given[1], width, growth)
    assert np.array_equal(change_of_bend(A * unit, rows, *given), here * unit**2)
    assert np.all(here[0] > 0)
    most = largest_derivatives(A * unit, np.stack([C, C]), F, width / unit)
    assert np.array_equal(most, largest_derivatives(A, np.stack([C, C]), F, width) * unit ** np.arange(4)[:, None])
