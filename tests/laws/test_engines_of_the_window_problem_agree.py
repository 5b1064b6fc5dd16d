"""Closed form, active set, interior point and the readable reference find one and the same minimiser, to 1e-8.

The unit is the posterior standard deviation of each state at each node: what the data leave open, whatever the scale.
"""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from sampling_design import Constraints, Plant
from sampling_design.errors import ArgumentError
from sampling_design.estimators.constraints.constraints import WindowConstraints
from sampling_design.estimators.constraints.convex_set import ConvexSet
from sampling_design.estimators.constraints.qp import active_set, conic, infeasibility, solve_constrained
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.estimators.mhe import MovingHorizonEstimator
from sampling_design.estimators.window.smoother import solve_banded, solve_square_root
from tests.cases import few
from tests.oracles.windows import solve_reference

AGREED = 1e-8
FOUR = np.array([[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1], [0, 0, -4, -0.1]], float)
PLANTS = {
    "four states": Plant(FOUR, [[1.0, 0.0, 1.0, 0.0]]),
    "force noise": Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], G=[[0.0], [1.0]]),
    "unreached mode": Plant([[-0.2, 0.0], [0.0, 0.1]], [[1.0, 1.0]], G=[[0.0], [1.0]]),
    "unstable, two outputs": Plant([[0.5, 1.0], [-1.0, 0.5]], np.eye(2)),
}


def both(k, size):
    return np.full(k, -size), np.full(k, size)


def box(k, size):
    return ConvexSet.box(*both(k, size))


def slab(k, size):
    """Half-spaces, the second stated twice and so never independent of the third."""
    ones = np.ones(k)
    return ConvexSet.halfspaces(np.vstack([ones, -ones, -2 * ones]), [size, 0.8 * size, 1.6 * size])


def ball(k, size):
    return ConvexSet.ball(size, dimension=k)


SETS = {
    "x box": lambda n, p, q: {"constraints": Constraints(x=both(n, 0.3))},
    "x box, check points": lambda n, p, q: {"constraints": Constraints(x=both(n, 0.3), check_spacing=0.35)},
    "x half-spaces": lambda n, p, q: {"constraints": Constraints(x=slab(n, 0.3))},
    "x ball": lambda n, p, q: {"constraints": Constraints(x=ball(n, 0.4))},
    "x ball, check points": lambda n, p, q: {"constraints": Constraints(x=ball(n, 0.4), check_spacing=0.35)},
    "x ellipsoid in a box": lambda n, p, q: {
        "constraints": Constraints(x=ConvexSet.ball(0.4, shape=np.diag(1 + 0.5 * np.arange(n))) & box(n, 0.25))
    },
    "v and y boxes": lambda n, p, q: {"constraints": Constraints(v=both(p, 0.4), y=both(p, 0.6))},
    "v half-spaces, y ball": lambda n, p, q: {"constraints": Constraints(v=slab(p, 0.5), y=ball(p, 0.7))},
    "v ball": lambda n, p, q: {"constraints": Constraints(v=ball(p, 0.3))},
    "w box": lambda n, p, q: {"constraints": Constraints(w=both(q, 0.2))},
    "w ball": lambda n, p, q: {"constraints": Constraints(w=ball(q, 0.15))},
    "w ball in a box": lambda n, p, q: {"constraints": Constraints(w=ball(q, 0.2) & box(q, 0.15))},
    "constant w, half-spaces": lambda n, p, q: {
        "constraints": Constraints(w=slab(q, 0.15) & box(q, 0.3), w_model="constant")
    },
    "all": lambda n, p, q: {"constraints": Constraints(x=ball(n, 0.5), v=both(p, 1.2), y=ball(p, 1.0), w=both(q, 0.6))},
}


def windows(plant, options, seed):
    """Windows of random lengths, weights, gaps and data (some missing), with the estimator that made them."""
    n, p, q = plant.n_states, plant.n_outputs, plant.n_disturbances
    rng = np.random.default_rng(seed)
    horizon, cost = (
        rng.uniform(2.0, 6.0),
        CostFunction(eta=rng.uniform(0.0, 0.5), form=("certificate", "paper")[seed % 2]),
    )
    mhe = MovingHorizonEstimator(plant, horizon=horizon, cost=cost, **SETS[options](n, p, q))
    kept, solve = [], mhe._solve

    def spy(window):
        kept.append((window, solve(window)))
        return kept[-1][1]

    mhe._solve = spy
    t = 0.0
    for _ in range(12):
        t += rng.uniform(0.2, 1.2)
        y = rng.normal(size=p) * rng.choice([0.3, 1.0, 2.0])
        if p > 1 and rng.random() < 0.3:
            y[rng.integers(p)] = np.nan
        mhe.update(t, y)
    return mhe, [(window, found) for window, found in kept if found.engine not in ("banded", "square root")]


def apart(one, two, free):
    """Largest difference of two minimisers in posterior standard deviations."""
    maps = free.spread.maps()
    return np.max(np.abs(one.nodes - two.nodes) / np.sqrt(np.einsum("jik,jik->ji", maps, maps)))


@pytest.mark.long
@pytest.mark.parametrize("name", PLANTS)
@pytest.mark.parametrize("options", SETS)
def test_on_every_window(name, options):
    """Every third active window by every engine, from both closed forms; the last one by the reference."""
    kept = []
    for seed in range(3):
        mhe, found = windows(PLANTS[name], options, seed)
        kept += [(mhe.constraints, window, solution) for window, solution in found]
    assert kept, "no constraint was active: the test would say nothing"
    for constraints, window, found in kept[::3]:
        free = solve_square_root(window)
        problem = constraints.demands(window, free).pose()
        assert found.status == "ok"
        assert found.dual <= found.cost
        for solve in [conic] if problem.cones else [conic, active_set]:
            point = solve(problem)
            assert point.excess == infeasibility(problem, point.z) < 1e-9
            assert abs(point.gap) < 1e-11
            other = replace(free, nodes=free.nodes + free.spread.states(point.z[: free.nodes.size]))
            assert apart(other, found, free) < AGREED
    constraints, window, found = kept[-1]
    free = solve_square_root(window)
    for engine in ["conic"] if constraints.has_balls else ["conic", "active set"]:
        assert apart(solve_constrained(window, constraints, free, engine), found, free) < AGREED
    reference = solve_reference(window, constraints, free)
    assert apart(reference, found, free) < AGREED
    assert reference.cost == pytest.approx(found.cost, rel=1e-10)
    assert found.dual <= reference.cost * (1 + 1e-10)


@pytest.mark.parametrize(
    ("name", "first", "second"),
    few(product(PLANTS, ["box", "ball"], ["half-space", "ball", "same"]), 0, 16),
)
def test_where_a_constraint_touches_without_pushing(name, first, second):
    """A second set whose edge goes exactly through the minimiser changes nothing: multipliers are 0, or not unique."""
    plant = PLANTS[name]
    n = plant.n_states
    chosen = box(n, 0.3) if first == "box" else ball(n, 0.4)
    mhe, found = windows(plant, "x box", seed=2)
    window, _ = found[-1]
    free = solve_square_root(window)
    alone = solve_constrained(window, WindowConstraints(mhe.table, Constraints(x=chosen)), free)
    assert alone.status == "ok"
    direction = np.cos(np.arange(n) + 1.0)
    touching = {
        "half-space": ConvexSet.halfspaces(direction[None], [np.max(alone.nodes @ direction)]),
        "ball": ConvexSet.ball(np.max(np.linalg.norm(alone.nodes - direction, axis=1)), centre=direction),
        "same": chosen,
    }[second]
    constraints = WindowConstraints(mhe.table, Constraints(x=chosen & touching))
    assert apart(solve_constrained(window, constraints, free), alone, free) < AGREED
    assert apart(solve_constrained(window, constraints, free, "conic"), alone, free) < AGREED
    assert apart(solve_reference(window, constraints, free), alone, free) < AGREED


@pytest.mark.parametrize("name", PLANTS)
def test_with_cones_the_point_meets_the_optimality_conditions(name):
    """Stationary to 1e-8: minus z is a combination, with the right signs, of the gradients of what is active."""
    from scipy.optimize import nnls

    for options in ("x ball", "w ball"):
        mhe, kept = windows(PLANTS[name], options, seed=1)
        for window, _ in kept[::4]:
            problem = mhe.constraints.demands(window, solve_square_root(window)).pose()
            z = conic(problem).z
            active = [
                M.T @ (M @ z + c)
                for M, c, r in problem.cones
                if abs(np.linalg.norm(M @ z + c) - r) < 1e-7 * max(r, 1e-3)
            ]
            assert active
            scale = np.linalg.norm(active, axis=1)
            _, residual = nnls(np.array(active).T / scale, -z)
            assert residual < 1e-8 * max(1.0, np.linalg.norm(z))


@pytest.mark.parametrize("name", ["four states", "unstable, two outputs"])
def test_both_closed_forms(name):
    plant = PLANTS[name]
    rng = np.random.default_rng(2)
    mhe = MovingHorizonEstimator(plant, horizon=20.0, cost=CostFunction(eta=0.1))
    kept, solve = [], mhe._solve
    mhe._solve = lambda window: kept.append(window) or solve(window)
    t = 0.0
    for _ in range(30):
        t += rng.uniform(0.3, 1.2)
        y = rng.normal(size=plant.n_outputs)
        if plant.n_outputs > 1 and rng.random() < 0.4:
            y[0] = np.nan
        mhe.update(t, y)
    for window in kept[::5]:
        one, two = solve_banded(window), solve_square_root(window)
        assert one is not None
        assert np.max(np.abs(one.nodes - two.nodes)) < 1e-10
        assert np.max(np.abs(one.covariance - two.covariance)) < 1e-10 * np.max(two.covariance)
        assert one.cost == pytest.approx(two.cost, rel=1e-10)
        a, b = one.spread, two.spread
        assert np.max(np.abs(a.gains - b.gains)) < 1e-9
        for S, Z in zip(a.roots, b.roots, strict=True):
            assert np.max(np.abs(S @ S.T - Z @ Z.T)) < 1e-9 * max(1.0, np.max(np.abs(Z @ Z.T)))
        for found in (one.spread, two.spread):
            z, g = rng.normal(size=window.reference.size), rng.normal(size=(3, window.reference.size))
            T = found.maps().reshape(z.size, z.size)
            own = np.matmul(found.maps(), np.swapaxes(found.maps(), 1, 2))
            assert np.max(np.abs(found.covariances() - own)) < 1e-10 * np.max(np.abs(own))
            assert np.max(np.abs(found.states(z).ravel() - T @ z)) < 1e-10
            assert np.max(np.abs(found.rows(g) - g @ T)) < 1e-10


def test_a_tiny_gap_among_long_ones_takes_the_route_that_keeps_its_digits():
    plant = PLANTS["four states"]
    mhe = MovingHorizonEstimator(plant, horizon=20.0, cost=CostFunction(eta=0.1))
    engines = [mhe.update(t, [0.3]).engine for t in (1.0, 2.0, 2.0 + 1e-7, 3.0)]
    assert engines[:2] == ["banded", "banded"]
    assert engines[-1] == "square root"


@pytest.mark.parametrize(("name", "options"), few(product(PLANTS, SETS), 0, 9))
def test_the_problem_as_written_is_the_one_that_is_solved(name, options):
    """`problem` of any of the last samples costs what its estimate says, and ends where that is.

    To the digits of the solver that is asked: twelve of a quadratic program, eight under balls.
    """
    mhe, _ = windows(PLANTS[name], options, seed=1)
    asked, same = (1e-8, 1e-6) if mhe.constraints.has_balls else (1e-12, 1e-9)
    nodes = [node for node in mhe.state.nodes[1:] if node.t >= mhe.state.last.t - mhe.horizon][::2]
    for node in nodes:
        problem = mhe.problem(node.t)
        assert problem.is_dpp()
        value = problem.solve(solver="CLARABEL", **dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), asked))
        assert node.status == "ok"
        assert value == pytest.approx(node.cost, rel=same)
        last = max((key for key in problem.var_dict if key[0] == "x"), key=lambda key: int(key[1:]))
        deviation = np.sqrt(np.diag(node.Y))
        assert np.max(np.abs(problem.var_dict[last].value - node.x) / deviation) < np.sqrt(same)
    assert len(nodes) > 1


def test_the_parameters_of_the_problem_are_the_data():
    """Another value of y there is another value of y in the record; windows end within the last horizon."""
    plant, kept = PLANTS["four states"], Constraints(x=both(4, 0.3))
    mhe, other = (
        MovingHorizonEstimator(plant, horizon=3.0, cost=CostFunction(eta=0.1), constraints=kept) for _ in "ab"
    )
    with pytest.raises(ArgumentError, match="`problem` is of a sample of the last horizon, and there is none"):
        mhe.problem()
    for t in (0.6, 1.9, 2.4):
        mhe.update(t, [0.5])
        other.update(t, [0.5 if t < 2 else -0.4])
    problem = mhe.problem()
    problem.param_dict["y3"].value = [-0.4]
    assert problem.solve(solver="CLARABEL") == pytest.approx(other.problem().solve(solver="CLARABEL"), rel=1e-7)
    assert problem.value == pytest.approx(other.state.last.cost, rel=1e-7)
    mhe.update(6.0, [0.1])
    for t in (2.4, 3.0, 0.0, 7.0):
        with pytest.raises(ArgumentError, match="`t` must be the time of a sample of the last horizon"):
            mhe.problem(t)
