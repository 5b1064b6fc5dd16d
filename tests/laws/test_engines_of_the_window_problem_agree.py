"""Closed form, active set, interior point and the readable reference find one and the same minimiser."""

import numpy as np
import pytest

from sampling_design import Plant
from sampling_design.estimators.convex_set import ConvexSet
from sampling_design.estimators.least_distance import active_set, conic, infeasibility
from sampling_design.estimators.mhe import MovingHorizonEstimator
from sampling_design.estimators.reference import solve_reference
from sampling_design.estimators.smoother import solve_banded
from sampling_design.estimators.square_root import solve_square_root

FOUR = np.array([[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1], [0, 0, -4, -0.1]], float)
PLANTS = {
    "four states": Plant(FOUR, [[1.0, 0.0, 1.0, 0.0]]),
    "force noise": Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], G=[[0.0], [1.0]]),
    "unreached mode": Plant([[-0.2, 0.0], [0.0, 0.1]], [[1.0, 1.0]], G=[[0.0], [1.0]]),
    "unstable, two outputs": Plant([[0.5, 1.0], [-1.0, 0.5]], np.eye(2)),
}
SETS = {
    "x": lambda n, p, q: {"x_set": (np.full(n, -0.3), np.full(n, 0.3))},
    "x between": lambda n, p, q: {"x_set": (np.full(n, -0.3), np.full(n, 0.3)), "check_spacing": 0.35},
    "v and y": lambda n, p, q: {
        "v_set": (np.full(p, -0.4), np.full(p, 0.4)),
        "y_set": (np.full(p, -0.6), np.full(p, 0.6)),
    },
    "w": lambda n, p, q: {"w_set": (np.full(q, -0.2), np.full(q, 0.2))},
    "constant w": lambda n, p, q: {"w_set": (np.full(q, -0.2), np.full(q, 0.2)), "w_model": "constant"},
    "x ball": lambda n, p, q: {"x_set": ConvexSet.ball(0.4, dimension=n)},
    "w ball": lambda n, p, q: {"w_set": ConvexSet.ball(0.15, dimension=q)},
}


def windows(plant, options, seed=0):
    """Windows whose constraints are active, with the estimator that made them."""
    n, p, q = plant.n_states, plant.n_outputs, plant.n_disturbances
    rng = np.random.default_rng(seed)
    mhe = MovingHorizonEstimator(plant, horizon=6.0, eta=0.2, **SETS[options](n, p, q))
    kept, solve = [], mhe._solve

    def spy(window):
        found = solve(window)
        if found.engine not in ("banded", "square root"):
            kept.append((window, found))
        return found

    mhe._solve = spy
    t = 0.0
    for _ in range(14):
        t += rng.uniform(0.3, 1.2)
        mhe.update(t, rng.normal(size=p))
    return mhe, kept


@pytest.mark.parametrize("name", PLANTS)
@pytest.mark.parametrize("options", SETS)
def test_on_every_window(name, options):
    mhe, kept = windows(PLANTS[name], options)
    assert kept, "no constraint was active: the test would say nothing"
    cones = "ball" in options
    for window, found in kept[::3]:
        free = solve_square_root(window)
        problem = mhe.constraints.least_distance(window, free.nodes, free.kernel())
        points = [conic(problem)] if problem.cones else [conic(problem), active_set(problem)]
        for point in points:
            assert infeasibility(problem, point.z) < 1e-9
            square = float(point.z @ point.z)
            assert square - point.dual < 1e-11 * max(1.0, square)
            assert np.max(np.abs(point.z - points[0].z)) < 1e-8
            nodes = free.nodes + problem.T @ point.z
            assert np.max(np.abs(nodes - found.nodes)) < 1e-8 * max(1.0, np.max(np.abs(nodes)))
        assert found.status == "ok"
        assert found.dual <= found.cost
    window, found = kept[-1]
    reference = solve_reference(window, mhe.constraints, free)
    # the modelling library's solver stops near 1e-5 where there are norm balls; its cost is good to 1e-7
    tolerance = 1e-4 if cones else 1e-8
    assert np.max(np.abs(reference.nodes - found.nodes)) < tolerance * max(1.0, np.max(np.abs(found.nodes)))
    assert reference.cost == pytest.approx(found.cost, rel=1e-6 if cones else 1e-8)
    assert found.dual <= reference.cost * (1 + 1e-6)


@pytest.mark.parametrize("name", PLANTS)
def test_with_cones_the_point_meets_the_optimality_conditions(name):
    """Stationary to 1e-8: minus z is a combination, with the right signs, of the gradients of what is active."""
    from scipy.optimize import nnls

    for options in ("x ball", "w ball"):
        mhe, kept = windows(PLANTS[name], options, seed=1)
        for window, _ in kept[::4]:
            free = solve_square_root(window)
            problem = mhe.constraints.least_distance(window, free.nodes, free.kernel())
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
    mhe = MovingHorizonEstimator(plant, horizon=20.0, eta=0.1)
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
        a, b = one.kernel(), two.kernel()
        assert np.max(np.abs(a.gains - b.gains)) < 1e-9
        for S, Z in zip(a.roots, b.roots, strict=True):
            assert np.max(np.abs(S @ S.T - Z @ Z.T)) < 1e-9 * max(1.0, np.max(np.abs(Z @ Z.T)))


def test_a_tiny_gap_among_long_ones_takes_the_route_that_keeps_its_digits():
    plant = PLANTS["four states"]
    mhe = MovingHorizonEstimator(plant, horizon=20.0, eta=0.1)
    engines = [mhe.update(t, [0.3]).engine for t in (1.0, 2.0, 2.0 + 1e-7, 3.0)]
    assert engines[:2] == ["banded", "banded"]
    assert engines[-1] == "square root"
