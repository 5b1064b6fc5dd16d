"""Flows put together from pieces, against 60-digit arithmetic and against the flow over the whole gap at once."""

import mpmath
import numpy as np
import pytest

import sampling_design as sd
from sampling_design.estimators.gap_flows.composed_flow import FEW, ComposedFlow
from sampling_design.estimators.gap_flows.cost_weights import build_weights
from sampling_design.estimators.gap_flows.flows import FlowTable, lower_band
from sampling_design.numerics.linalg import discounted_flow
from tests.cases import few

PLANTS = {
    "oscillator": [[0.0, 1.0], [-1.0, 0.0]],
    "triple integrator": np.diag([1.0, 1.0], 1),
    "nothing moves": np.zeros((2, 2)),
    "unstable": [[0.5, 1.0], [-1.0, 0.5]],
    "stable for this rate at most": -np.eye(2),
    "four states": [[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1], [0, 0, -4, -0.1]],
    "fast and slow": [[-100.0, 3.0], [0.0, -0.01]],
}
GAPS = (0.0, 1e-6, 0.013, 0.25, 1.3, 7.7, 20.0)


def noise(n):
    G = np.random.default_rng(n).normal(size=(n, n - 1))
    return G @ G.T


def exact(A, N, eta, h):
    """F, E, W by block exponentials in 60 digits more than they lose."""
    n = len(A)
    with mpmath.workdps(60 + int(2 * np.linalg.norm(A, 1) * h)):
        plant, intensity, one = mpmath.matrix(A.tolist()), mpmath.matrix(N.tolist()), mpmath.eye(n)
        shifted = plant + mpmath.mpf(eta) / 2 * one
        steps, loan = mpmath.zeros(2 * n), mpmath.zeros(2 * n)
        steps[:n, :n], steps[:n, n:] = plant, one
        loan[:n, :n], loan[:n, n:], loan[n:, n:] = -shifted, intensity, shifted.T
        steps, loan = (mpmath.expm(M * mpmath.mpf(h), method="taylor") for M in (steps, loan))
        found = (steps[:n, :n], steps[:n, n:], loan[n:, n:].T * loan[:n, n:])
        return [np.array(M.tolist(), dtype=float) for M in found]


def off(found, expected):
    return np.linalg.norm(found - expected) / (np.linalg.norm(expected) or 1.0)


@pytest.mark.parametrize("eta", few([0.0, 2.0], 1))
@pytest.mark.parametrize("name", few(PLANTS, *(k for k, name in enumerate(PLANTS) if name != "four states")))
def test_agrees_with_sixty_digits(name, eta):
    A = np.array(PLANTS[name], float)
    gaps = [h for h in GAPS if np.linalg.norm(A, 1) * h < 200]
    flow = ComposedFlow(A, noise(len(A)), eta)
    found = zip(*flow.over(gaps), strict=True)
    assert len(gaps) > FEW  # so that pieces are put together; a few gaps are products of their own
    for h, matrices in zip(gaps, found, strict=True):
        for one, alone, other in zip(matrices, flow.over([h]), exact(A, noise(len(A)), eta, h), strict=True):
            assert off(one, other) < 5e-14
            assert off(alone[0], other) < 5e-14
        for W in (matrices[2], flow.over([h])[2][0]):
            np.testing.assert_array_equal(W, W.T)


@pytest.mark.parametrize("rate", [1e-1, 1e4, 1e8])
def test_a_stiff_plant_over_gaps_of_many_sizes(rate):
    """As exact as the flow at once, which loses |A|h eps: compared at what both keep."""
    A, N = np.array([[-rate, 0.3 * rate], [0.0, -0.1]]), np.eye(2)
    gaps = [1e-9, 1e-3, 0.7, 5.0, 90.0]
    flow = ComposedFlow(A, N, 0.05)
    F, _, W = flow.over(gaps)
    kept = 1e-14 * max(10.0, rate * 90.0)
    for h, one, two, plain, gramian in zip(gaps, F, W, *discounted_flow(A, N, gaps, 0.05), strict=True):
        (alone,), _, (spread,) = flow.over([h])
        assert max(off(one, plain), off(alone, plain)) < kept, h
        assert max(off(two, gramian), off(spread, gramian)) < kept, h
        assert min(np.linalg.eigvalsh(two)[0], np.linalg.eigvalsh(spread)[0]) > 0
    assert np.isfinite(F).all()


def test_what_is_remembered_changes_nothing_but_rounding():
    A, rng = np.array(PLANTS["four states"], float), np.random.default_rng(0)
    worn = ComposedFlow(A, np.eye(4), 0.3)
    for h in 10 ** rng.uniform(-3, 2, 40):
        one, other = worn.over([h, 0.4, 17.0]), ComposedFlow(A, np.eye(4), 0.3).over([h])
        assert all(off(a[0], b[0]) < 1e-13 for a, b in zip(one, other, strict=True))


def test_pieces_beyond_all_numbers_do_no_harm():
    """The last piece remembered on the way to e^{600} is e^{1008}."""
    F, E, W = ComposedFlow(np.array([[1.0]]), np.array([[1e-300]]), 0.0).over([600.0])
    assert F[0, 0, 0] == pytest.approx(np.exp(600.0), rel=1e-11)
    assert E[0, 0, 0] == pytest.approx(np.exp(600.0), rel=1e-11)
    assert W[0, 0, 0] == pytest.approx(np.exp(1200.0 - 300 * np.log(10.0)) / 2, rel=1e-11)


@pytest.mark.parametrize("units", [1.0, 1e-12, 1e12])
def test_gaps_of_a_batch_are_those_of_one_by_one(units):
    """Costs between nodes and arrivals of a prior."""
    rng = np.random.default_rng(5)
    S = np.diag(units ** np.array([0.0, 1.0, 0.5]))
    A = S @ np.array([[0.0, 1.0, 0.0], [-2.0, -0.1, 0.3], [0.0, 0.0, 0.4]]) @ np.linalg.inv(S)
    plant = sd.Plant(A, np.array([[1.0, 0.0, 0.0]]), G=S[:, 1:])
    weights = build_weights(plant, None, sd.CostFunction(eta=0.3, P2=np.linalg.inv(S @ S)))
    prior = weights.prior_root @ weights.prior_root.T
    gaps = rng.uniform(0.05, 3.0, 40).tolist()
    alone, batch = FlowTable(weights), FlowTable(weights)
    batch.known(gaps)
    batch.prepare(gaps, gaps, prior)
    for gap in gaps:
        one, many = alone.one(gap), batch.one(gap)
        found, made = one.arrival_information(prior), many.arrival_information(prior)
        (information, band), (alike, _) = made, found
        assert in_own_units(information, alike) < 1e-9
        np.testing.assert_array_equal(band, lower_band(information, 3)[0])
        if one.joint is None:
            assert many.joint is None
        else:
            assert in_own_units(many.joint, one.joint) < 1e-9
            np.testing.assert_array_equal(many.band, lower_band(many.joint, 3))
            assert many.loose == pytest.approx(one.loose, rel=1e-9)


def test_what_loses_digits_is_left_alone_in_a_batch():
    """Six integrators in a row: no W of theirs is inverted. What overflows is not, either."""
    plant = sd.Plant(np.diag(np.ones(5), 1), np.eye(6)[:1], G=np.eye(6)[:, 5:])
    weights = build_weights(plant, None, sd.CostFunction(eta=0.3))
    table, prior = FlowTable(weights), np.eye(6)
    table.known([0.5, 2.0, 3000.0])
    table.prepare([0.5, 2.0, 3000.0], [2.0, 3000.0], prior)
    assert all(table.one(gap).joint is None for gap in (0.5, 2.0))
    assert (table.one(2.0).arrival_information(prior) is None) == (
        FlowTable(weights).one(2.0).arrival_information(prior) is None
    )
    with np.errstate(over="ignore", invalid="ignore"):
        assert table.one(3000.0).arrival_information(prior) is None


def in_own_units(found, expected):
    """The largest difference, in units of the diagonal."""
    size = np.sqrt(np.diag(expected))
    return np.max(np.abs(found - expected) / np.outer(size, size))
