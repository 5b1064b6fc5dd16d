"""Newton's method on a window: what it says is what IPOPT says, and it says nothing where it cannot know."""

from itertools import product

import casadi
import numpy as np
import pytest

from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.nonlinear import newton, window_search
from sampling_design.nonlinear.collocation import Collocation, OutlierRejection, WindowSolver
from sampling_design.nonlinear.mhe import NonlinearMovingHorizonEstimator
from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.nonlinear.nlp import WindowProgram
from sampling_design.nonlinear.window_forms import WindowData
from sampling_design.plants.plant import Signals
from tests.cases import few
from tests.nonlinear.test_mhe import PENDULUM, PRIOR, SIZES, estimator, position, record, swing

TIMES = [0.0, 0.5, 1.0, 2.0, 2.5, 3.0, 4.2, 4.3]
CASES = {
    "free": ({}, {}, {"newton"}),
    "bounded w": ({"disturbances": (-0.02, 0.02)}, {}, {"newton"}),
    "bounded v": ({"noises": (-0.05, 0.05)}, {}, {"newton"}),
    "bounded x": ({"states": ([-9.0, -0.55], [9.0, 9.0])}, {}, {"ipopt"}),
    "bounded y": ({"outputs": ([-9.0], [1.05])}, {}, {"ipopt"}),
    "robust": ({}, {"outliers": OutlierRejection(huber=1.5)}, {"newton"}),
}


def both_ways(monkeypatch, plant, options):
    """Estimates, costs, last windows and engines with Newton's method and without it."""
    found = []
    for near in (WindowProgram.near, lambda *_: None):
        monkeypatch.setattr(WindowProgram, "near", near)
        scheme = estimator(plant, solver=WindowSolver(1e-11), **options)
        estimates = [scheme.update(t, y) for t, y in record(TIMES, noise=0.3)]
        assert {estimate.status for estimate in estimates} == {"ok"}
        found.append((estimates, scheme.window))
    return found


@pytest.mark.parametrize("case", few(list(CASES), 1))
def test_newton_says_what_ipopt_says(monkeypatch, case):
    bounds, options, engines = CASES[case]
    (quick, window), (slow, same) = both_ways(monkeypatch, PENDULUM.with_bounds(**bounds), options)
    assert engines <= {estimate.engine for estimate in quick}
    assert {estimate.engine for estimate in slow} == {"ipopt"}
    assert np.array([e.x for e in quick]) == pytest.approx(np.array([e.x for e in slow]), abs=1e-6)
    assert [e.cost for e in quick] == pytest.approx([e.cost for e in slow], rel=1e-7)
    for key in ("z", "w", "v"):
        assert getattr(window.point, key) == pytest.approx(getattr(same.point, key), abs=2e-6)
        force, known = (getattr(found.bound_multipliers, key) for found in (window, same))
        assert force == pytest.approx(known, abs=1e-5)
    assert window.row_multipliers == pytest.approx(same.row_multipliers, abs=1e-5)
    if case == "bounded w":
        assert np.count_nonzero(np.abs(window.point.w) == 0.02) > 2  # exactly at its bound


def test_a_saddle_is_no_solution():
    square = NonlinearPlant(lambda x, u, w: [w[0]], lambda x, u, v: [x[0] ** 2 + v[0]], {**SIZES, "states": 1})
    edges = np.arange(3.0)
    scheme = NonlinearMovingHorizonEstimator(
        square, horizon=3.0, cost=CostFunction(P2=[[0.1]], R=[[10.0]]), collocation=Collocation(w_step=1.0)
    )
    shown = np.ones((3, 1))
    data = WindowData(edges, np.zeros((3, 0)), np.zeros((2, 0)), shown, shown, np.zeros(1), np.array([[0.3]]))
    still = scheme.search.guess(edges, np.zeros((3, 1)))
    assert scheme.program.near(data, still) is None  # all slopes are 0 there
    solution, _ = scheme.program.near(data, scheme.search.guess(edges, np.ones((3, 1))))
    assert solution.nodes == pytest.approx(shown, abs=0.05)
    flat = data._replace(y=-shown)  # nothing pulls away from 0 then
    solution, _ = scheme.program.near(flat, still)
    assert solution.nodes == pytest.approx(0.0, abs=1e-9)
    assert solution.iterations == 1


def test_what_is_at_its_bound_is_moved_there_and_kept():
    """Against the map itself: a free entry stays, one at its bound is its move, times the 1 before it."""
    rng = np.random.default_rng(2)
    L, M, side = rng.normal(size=(3, 3, 6)), rng.normal(size=(3, 6, 6)), np.array([[1, 0], [0, -1], [0, 0]])
    M, moves, T = M + M.transpose(0, 2, 1), rng.normal(size=(3, 2)) * (side != 0), np.zeros((3, 6, 6))
    for k, i in product(range(3), range(4)):
        T[k, i, i] = 1.0
    for k, i in product(range(3), range(2)):
        T[k, 4 + i, 4 + i], T[k, 4 + i, 3] = side[k, i] == 0, moves[k, i]
    kept = np.array([np.diag([0, 0, 0, 0, *row]) for row in side != 0])
    np.testing.assert_allclose(newton._at_bounds(L, side, moves), L @ T, atol=1e-14)
    expected = T.transpose(0, 2, 1) @ M @ T + kept
    np.testing.assert_allclose(newton._both_at_bounds(M, side, moves), expected, atol=1e-14)


def test_what_is_not_finite_is_not_near():
    scheme = estimator()
    edges = np.arange(3.0)
    shown = np.full((3, 1), 1e300)
    data = WindowData(edges, np.zeros((3, 0)), np.zeros((2, 0)), shown, shown * 0 + 1, np.zeros(2), np.eye(2))
    assert scheme.program.near(data, scheme.search.guess(edges, np.zeros((3, 2)))) is None


def one_interval(shown, plant_bounds=None):
    """An integrator over one interval, whose output is 0 at the end: cost z0^2 + w^2 + shown(x, v)^2 + 2 v^2."""
    plant = NonlinearPlant(lambda x, u, w: [w[0]], lambda x, u, v: [shown(x[0], v[0])], {**SIZES, "states": 1})
    scheme = NonlinearMovingHorizonEstimator(
        plant.with_bounds(**(plant_bounds or {})),
        horizon=1.0,
        cost=CostFunction(P2=[[0.5]], Qw=[[0.5]], R=[[1.0]], Qv=[[1.0]]),
        collocation=Collocation(w_step=1.0),
    )
    zero, mask = np.zeros((2, 1)), np.array([[0.0], [1.0]])
    data = WindowData(np.arange(2.0), np.zeros((2, 0)), np.zeros((1, 0)), zero, mask, np.zeros(1), np.eye(1))
    return scheme, data


def test_a_step_onto_a_maximum_finds_no_solution():
    def shown(x, v):  # the cost is 100 + 8 (-x^2 / 2 + x^3 - x^4 / 4), least over the start and w; convex at 1.5
        return (100 - 4.5 * x**2 + 8 * x**3 - 2 * x**4) ** 0.5 + 1e-3 * v**2

    scheme, data = one_interval(shown)
    assert scheme.program.near(data, scheme.search.guess(data.edges, np.full((2, 1), 1.5))) is None


def test_a_bound_without_a_multiplier_hides_no_descent():
    scheme, data = one_interval(lambda x, v: 2.0 - v**2, {"noises": (0.0, 5.0)})
    guess = scheme.search.guess(data.edges, np.zeros((2, 1)))
    forced = guess.bound_multipliers._replace(v=np.array([[0.0], [-1.0]]))
    assert scheme.program.near(data, guess._replace(bound_multipliers=forced)) is None  # v = 1 costs 3, v = 0 costs 4


def test_a_solution_of_newton_that_the_noise_does_not_explain_is_looked_for_elsewhere():
    """The output shows x = 0.5 and x = -1 alike; only as they decay is the prior's one proven wrong."""
    plant = NonlinearPlant(
        lambda x, u, w: [-0.3 * x[0] + w[0]], lambda x, u, v: [x[0] ** 2 + 0.5 * x[0] + v[0]], {**SIZES, "states": 1}
    )
    truth, found = 0.5 * np.exp(-0.3 * np.arange(3.0)), {}
    for starts in (0, 4):
        scheme = NonlinearMovingHorizonEstimator(
            plant,
            horizon=9.0,
            prior=[-1.0],
            cost=CostFunction(P2=[[0.5]], Qw=[[1e5]], R=[[1e4]], Qv=[[1e4]]),
            collocation=Collocation(1.0),
            solver=WindowSolver(starts=starts),
        )
        estimates = [scheme.update(float(t), [x**2 + 0.5 * x]) for t, x in enumerate(truth)]
        found[starts] = [
            (float(e.x[0]), e.engine, run.attempts) for e, run in zip(estimates, scheme.solves, strict=True)
        ]
    assert found[0][1][0] < 0.0
    assert found[0][1][1:] == ("newton", 1)
    assert found[4][1] == (pytest.approx(truth[1], abs=1e-3), "ipopt", 2)
    assert found[4][2] == (pytest.approx(truth[2], abs=1e-3), "newton", 1)


def test_what_newton_tried_in_vain_counts_as_time(monkeypatch):
    now = [0.0]

    def in_vain(*_):
        now[0] += 7.0

    monkeypatch.setattr(WindowProgram, "near", in_vain)
    monkeypatch.setattr(window_search, "processor_seconds", lambda: now[0])
    scheme = estimator()
    for t, y in record(TIMES[:4]):
        scheme.update(t, y)
    assert [run.seconds > 7.0 for run in scheme.solves] == [False, True, False, True]  # the third is a pause


PAIR = NonlinearPlant(swing, lambda x, u, v: [x[0] + v[0], x[1] + v[1]], {**SIZES, "inputs": 1, "outputs": 2})
TINY = 1e-12


def small_swing(x, u, w):
    return [TINY * rate for rate in swing([x[0] / TINY, x[1] / TINY], u, [w[0] / TINY])]


NAMES = {"states": ("angle", "rate"), "disturbances": ("push",), "outputs": ("y",)}
SMALL = NonlinearPlant(
    small_swing,
    position,
    SIZES,
    signals={key: Signals(own, scales=TINY * np.ones(len(own))) for key, own in NAMES.items()},
)
HOLES = [[0.4, 0.1], [0.2, np.nan], [np.nan, -0.6], [0.1, np.nan], [-0.3, -0.9], [40.0, 0.3]]
BOUNDED = {"states": (-0.3, 0.3), "noises": (-0.1, 0.1), "disturbances": (-0.1, 0.1)}
AWKWARD = {
    "holes and an outlier": (PAIR, {}),
    "a gate": (PAIR, {"outliers": OutlierRejection(gate=4.0)}),
    "v at its bounds": (PAIR.with_bounds(noises=(-0.05, 0.05)), {}),
    "w at its bounds": (PENDULUM.with_bounds(disturbances=(-0.02, 0.02)), {}),
    "w has one bound": (PENDULUM.with_bounds(disturbances=(-0.01, np.inf)), {}),
    "w is fixed": (PENDULUM.with_bounds(disturbances=(0.0, 0.0)), {}),
    "x at its bounds": (PENDULUM.with_bounds(states=([-9.0, -0.75], [9.0, 9.0])), {}),
    "nothing meets the bounds": (PENDULUM.with_bounds(**BOUNDED), {"prior": [0.2, 0.2]}),
    "seconds from 1970 on": (PENDULUM.with_bounds(disturbances=(-0.02, 0.02)), {"prior_time": 1.7e9}),
    "1e-12": (SMALL.with_bounds(disturbances=(-0.02 * TINY, 0.02 * TINY)), {"prior": np.array(PRIOR) * TINY}),
    "a robust loss": (PENDULUM.with_bounds(noises=(-0.1, 0.1)), {"outliers": OutlierRejection(huber=1.5)}),
}


def require_accepted(program, data, solution):
    """What Newton's method says is feasible and costs what it says, and IPOPT stays there."""
    lower, upper = program.boxes
    low, high = program._row_bounds(data)
    x, given = program._pack(solution.point), np.concatenate(list(program._columns(data).values()))
    problem = program._problem
    cost, rows = casadi.Function("problem", [problem["x"], problem["p"]], [problem["f"], problem["g"]])(x, given)
    rows = np.array(rows).ravel()
    assert np.all((lower <= x) & (x <= upper))
    assert np.all((low - 1e-8 <= rows) & (rows <= high + 1e-8))
    assert float(cost) == pytest.approx(solution.cost, rel=1e-9, abs=1e-12)
    again = program.solve(data, solution, warm=True)
    assert again.status == "ok"
    assert again.cost == pytest.approx(solution.cost, rel=1e-6)
    assert again.nodes == pytest.approx(solution.nodes, abs=1e-5)


@pytest.mark.parametrize(("case", "changes"), few(product(AWKWARD, [(6, 18), (0, 2)]), 0, 7))
def test_what_newton_says_ipopt_accepts(monkeypatch, case, changes):
    """In every window that Newton's method answers; with (0, 2) interior points alone say which bounds are active."""
    plant, options = AWKWARD[case]
    for name, value in zip(("BY_SIGNS", "MOST_CHANGES"), changes, strict=True):
        monkeypatch.setattr(newton, name, value)
    answered, near = [], WindowProgram.near

    def kept(program, data, guess):
        found = near(program, data, guess)
        if found is not None:
            answered.append((program, data, found[0]))
        return found

    monkeypatch.setattr(WindowProgram, "near", kept)
    begin, unit, p = options.get("prior_time", 0.0), TINY if case == "1e-12" else 1.0, plant.n_outputs
    weights = {"P2": np.diag([2.0, 0.5]), "Qw": [[3.0]], "R": 40.0 * np.eye(p), "Qv": 15.0 * np.eye(p)}
    scheme = estimator(plant, {key: np.array(weight) / unit**2 for key, weight in weights.items()}, **options)
    rows = [y for _, y in record(TIMES, noise=0.3)] if p == 1 else HOLES
    for t, y in zip(TIMES, rows, strict=False):
        scheme.update(begin + t, unit * np.array(y))
    for program, data, solution in answered:
        require_accepted(program, data, solution)
    assert bool(answered) == (case != "nothing meets the bounds")
