"""With constraints the estimate is the limit of fine grids with explicit w and v, approached at order 2."""

from itertools import product

import numpy as np
import pytest

from sampling_design import Constraints, Plant
from sampling_design.estimators.constraints.convex_set import ConvexSet
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.estimators.mhe import MovingHorizonEstimator
from tests.cases import few
from tests.oracles.estimators import fine_grid

A = np.array([[0.0, 1.0], [-1.0, 0.0]])
C, G, ETA = np.array([[1.0, 0.0]]), np.eye(2), 0.6
WEIGHTS = {"P2": np.diag([2.0, 1.0]), "Qw": np.diag([3.0, 1.5]), "R": [[8.0]], "Qv": [[5.0]]}
TIMES, YS = [0.6, 1.5, 2.3, 3.4], [[0.9], [-0.2], [-1.3], [-0.1]]
PRIOR = np.array([0.3, -0.2])


def cases():
    box = np.array([0.45, 0.5])
    row = np.array([[1.0, 1.0]])

    def in_box(x, w, v):
        return [bound for node in x for bound in (node <= box, node >= -box)]

    def in_ball(x, w, v):
        import cvxpy as cp

        return [cp.norm(node) <= 0.6 for node in x]

    def in_half_space(x, w, v):
        return [row @ node <= 0.35 for node in x]

    def small_v(x, w, v):
        return [bound for noise in v for bound in (noise <= 0.03, noise >= -0.03)]

    def small_y(x, w, v):
        return [
            bound
            for node, noise in zip(x[1:], v, strict=True)
            for bound in (C @ node + noise <= 0.5, C @ node + noise >= -0.5)
        ]

    return {
        "box": ({"constraints": Constraints(x=(-box, box))}, in_box),
        "ball": ({"constraints": Constraints(x=ConvexSet.ball(0.6, dimension=2))}, in_ball),
        "half-space": ({"constraints": Constraints(x=ConvexSet.halfspaces(row, [0.35]))}, in_half_space),
        "noise": ({"constraints": Constraints(v=(-0.03, 0.03))}, small_v),
        "output": ({"constraints": Constraints(y=(-0.5, 0.5))}, small_y),
    }


@pytest.mark.parametrize(("name", "cost"), few(product(cases(), ("certificate", "paper")), 0, 5))
def test_order_two(name, cost):
    options, constrain = cases()[name]
    mhe = MovingHorizonEstimator(
        Plant(A, C, G=G), horizon=9.0, cost=CostFunction(eta=ETA, form=cost, **WEIGHTS), prior=PRIOR, **options
    )
    free = MovingHorizonEstimator(
        Plant(A, C, G=G), horizon=9.0, cost=CostFunction(eta=ETA, form=cost, **WEIGHTS), prior=PRIOR
    )
    for t, y in zip(TIMES, YS, strict=True):
        estimate, without = mhe.update(t, y), free.update(t, y)
    assert estimate.engine in ("active set", "conic")
    assert np.max(np.abs(estimate.x - without.x)) > 0.01
    errors = []
    for steps in (3, 6, 12):
        x, value = fine_grid(
            A,
            C,
            G,
            WEIGHTS["P2"],
            WEIGHTS["Qw"],
            WEIGHTS["R"],
            WEIGHTS["Qv"],
            ETA,
            PRIOR,
            0.0,
            TIMES,
            YS,
            steps,
            twice=cost == "paper",
            constrain=constrain,
        )
        errors.append([np.max(np.abs(x - estimate.x)), abs(value - estimate.cost)])
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert np.all(np.abs(orders - 2) < 0.3)
    assert errors[-1][0] < 2e-3


@pytest.mark.parametrize("kind", ["box", "ball"])
def test_a_constant_disturbance_within_bounds_is_the_grid_of_one_cell_a_gap(kind):
    """With w constant over each gap the problem is the grid's own with one cell; the discount there is at mid-cell."""
    bound = 0.12
    chosen = (-bound, bound) if kind == "box" else ConvexSet.ball(bound, dimension=2)
    mhe = MovingHorizonEstimator(
        Plant(A, C, G=G),
        horizon=9.0,
        cost=CostFunction(eta=1e-9, **WEIGHTS),
        prior=PRIOR,
        constraints=Constraints(w=chosen, w_model="constant"),
    )

    def constrain(x, w, v):
        import cvxpy as cp

        if kind == "box":
            return [w <= bound, w >= -bound]
        return [cp.norm(w[:, k]) <= bound for k in range(w.shape[1])]

    for t, y in zip(TIMES, YS, strict=True):
        estimate = mhe.update(t, y)
    x, value = fine_grid(
        A,
        C,
        G,
        WEIGHTS["P2"],
        WEIGHTS["Qw"],
        WEIGHTS["R"],
        WEIGHTS["Qv"],
        1e-9,
        PRIOR,
        0.0,
        TIMES,
        YS,
        1,
        constrain=constrain,
    )
    assert np.max(np.abs(estimate.x - x)) < 1e-5
    assert estimate.cost == pytest.approx(value, rel=1e-6)
