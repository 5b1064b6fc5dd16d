"""What any bounded w does over a gap lies in the set that bounds on w are turned into; and the set is not loose."""

from itertools import product

import numpy as np
import pytest

from sampling_design import Plant
from sampling_design.estimators.constraints.convex_set import ConvexSet
from sampling_design.estimators.constraints.disturbance import DisturbanceReach
from sampling_design.estimators.gap_flows.cost_weights import CostFunction, build_weights
from sampling_design.estimators.gap_flows.flows import FlowTable
from tests.cases import few
from tests.oracles.estimators import input_integral, transition

PLANTS = {
    "double integrator": ([[0, 1], [0, 0]], [[0], [1]]),
    "fast oscillator": ([[0, 6], [-6, 0]], np.eye(2)),
    "stiff": ([[-40, 3], [0, 0.2]], np.eye(2)),
    "chain, one noise": ([[0, 1, 0], [0, 0, 1], [-1, -2, 0.3]], [[0], [0], [1]]),
    "no noise on one state": ([[-0.2, 0], [0, 0.1]], [[0], [1]]),
}
CELLS = 200


def displacements(A, G, h, eta, draw, rng, count):
    """Displacements d of random and bang-bang w, constant on fine cells."""
    step = h / CELLS
    F, Gam = transition(A, step), input_integral(A, G, step)
    powers = [np.eye(A.shape[0])]
    for _ in range(CELLS):
        powers.append(F @ powers[-1])
    kernel = np.array([powers[CELLS - 1 - k] @ Gam for k in range(CELLS)])
    for _ in range(count):
        direction = rng.normal(size=A.shape[0])
        push = np.einsum("kij,i->kj", kernel, direction)
        yield np.einsum("kij,kj->i", kernel, draw(push, rng))


@pytest.mark.parametrize(("name", "eta", "h"), few(product(PLANTS, [0.0, 0.7], [0.05, 0.8, 2.5]), *range(0, 30, 5)))
def test_box_and_ball(name, eta, h):
    A, G = (np.array(M, float) for M in PLANTS[name])
    q = G.shape[1]
    rng = np.random.default_rng(1)
    plant = Plant(A, np.eye(A.shape[0]), G=G)
    weights = build_weights(plant, None, CostFunction(Qw=np.diag(rng.uniform(0.5, 2.0, q)), eta=eta))
    table = FlowTable(weights)
    (flow, _) = flows = table.get([h, h / 3])  # where the two share a grid each gets its own part of it
    low, high = -rng.uniform(0.2, 1.0, q), rng.uniform(0.5, 2.0, q)

    def in_box(push, rng):
        return np.where(push > 0, high, low) if rng.random() < 0.8 else rng.uniform(low, high, size=push.shape)

    def in_ball(push, rng):
        length = np.linalg.norm(push, axis=1, keepdims=True)
        return 0.7 * push / np.where(length > 0, length, 1.0)

    box, _ = DisturbanceReach(table, ConvexSet.box(low, high)).over(flows)
    alone, _ = DisturbanceReach(table, ConvexSet.box(low, high)).over([flow, flow])
    np.testing.assert_allclose([box.lower, box.upper], [alone.lower, alone.upper], rtol=1e-12)
    (ball,) = DisturbanceReach(table, ConvexSet.ball(0.7, dimension=q)).over([flow])
    reach = 0.0
    for d in displacements(A, G, h, eta, in_box, rng, 60):
        omega = flow.whiten @ d
        assert np.allclose(flow.root @ omega, d, atol=1e-7 * max(1.0, np.max(np.abs(d))))
        assert box.contains(omega, 1e-9)
    for row in range(A.shape[0]):
        # the disturbance that drives one entry of omega furthest reaches the box almost
        step = h / CELLS
        Gam = input_integral(A, G, step)
        w = [np.where(flow.whiten[row] @ transition(A, (k + 0.5) * step) @ G > 0, high, low) for k in range(CELLS)]
        omega = sum(flow.whiten @ transition(A, k * step) @ Gam @ w[k] for k in range(CELLS))
        if np.any(flow.whiten[row]):
            assert box.contains(omega, 1e-9)
            reach = max(reach, abs(box.upper[row] - omega[row]) / (box.upper[row] - box.lower[row]))
    assert reach < 0.03
    for d in displacements(A, G, h, eta, in_ball, rng, 60):
        assert ball.contains(flow.whiten @ d, 1e-9)


def test_half_spaces_bound_through_their_bounding_box():
    plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    weights = build_weights(plant, None, CostFunction())
    triangle = ConvexSet.halfspaces([[-1.0, 0.0], [0.0, -1.0], [1.0, 1.0]], [0.0, 0.0, 1.0])
    table = FlowTable(weights)
    (flow,) = table.get([1.0])
    found = DisturbanceReach(table, triangle).over([flow])[0]
    square = DisturbanceReach(table, ConvexSet.box([0.0, 0.0], [1.0, 1.0])).over([flow])[0]
    assert np.allclose(found.lower, square.lower, atol=1e-5)
    assert np.allclose(found.upper, square.upper, atol=1e-5)
    assert np.all(found.upper >= square.upper - 1e-12)


def test_a_ball_within_a_box_uses_both():
    plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    table = FlowTable(build_weights(plant, None, CostFunction()))
    (flow,) = table.get([1.0])
    disc = ConvexSet.ball(1.0, dimension=2)
    sets = (disc & ConvexSet.box([-0.2, -3.0], [0.2, 3.0]), ConvexSet.box([-0.2, -1.0], [0.2, 1.0]), disc)
    both, box, ball = (DisturbanceReach(table, chosen).over([flow])[0] for chosen in sets)
    assert np.allclose([both.lower, both.upper], [box.lower, box.upper])
    assert both.balls[0].radius == ball.balls[0].radius
