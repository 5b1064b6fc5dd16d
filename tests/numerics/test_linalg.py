"""Small linear algebra against 50-digit arithmetic, adaptive quadrature and plain definitions."""

import tracemalloc
from fractions import Fraction
from itertools import pairwise

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings

from sampling_design.numerics import linalg
from tests import strategies


def exact_exponential(A, t):
    with mpmath.workdps(50):
        return np.array(mpmath.expm(mpmath.matrix(A.tolist()) * mpmath.mpf(float(t))).tolist(), dtype=float)


def relative(found, expected):
    return np.linalg.norm(found - expected) / np.linalg.norm(expected)


@settings(max_examples=20)
@given(strategies.defective_plants(largest=4))
def test_exponential_agrees_with_fifty_digits(plant):
    times = np.array([0.0, 0.3, 2.0, 5.0])
    for t, found in zip(times, linalg.expm_batch(plant.A, times), strict=True):
        # squaring loses at most the growth of the powers: |A| t eps cond
        size = np.linalg.norm(plant.A) * t
        assert relative(found, exact_exponential(plant.A, t)) <= 1e-13 * max(1.0, size) * np.exp(min(size, 6.0))


def test_exponential_of_an_oscillator_over_many_turns():
    A = np.array([[0.0, 1.0], [-1.0, 0.0]])
    times = np.linspace(0.0, 200.0, 9)
    for t, found in zip(times, linalg.expm_batch(A, times), strict=True):
        assert relative(found, exact_exponential(A, t)) <= 1e-12


@pytest.mark.parametrize("longest", [0.0, 1e-3, 0.9, 40.0])
def test_rows_ahead_are_those_of_the_exponential(longest):
    rng = np.random.default_rng(4)
    for A in (rng.normal(size=(5, 5)) / 4, np.zeros((5, 5)), 1e6 * np.eye(5, k=1)):
        C, times = rng.normal(size=(2, 5)), longest / max(1.0, np.linalg.norm(A, 1)) * np.linspace(0, 1, 7)
        assert linalg.rows_ahead(C, A, times) == pytest.approx(C @ linalg.expm_batch(A, times), rel=1e-13, abs=1e-13)
    assert linalg.rows_ahead(C, A, np.zeros(0)).shape == (0, 2, 5)


def test_rows_of_many_long_times_hold_few_matrices_at_once():
    A, C, times = np.diag(np.arange(12.0)), np.ones((1, 12)), np.linspace(0.0, 1.0, 40_000)
    linalg.rows_ahead(C, A, times[:2])
    tracemalloc.start()
    found = linalg.rows_ahead(C, A, times)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_allclose(found, np.exp(times[:, None, None] * np.arange(12.0)), rtol=1e-13)
    assert most < 40_000 * 144 * 8


def test_exponential_runs_backwards():
    A = np.array([[0.3, 1.0], [0.0, -0.2]])
    forth, back = linalg.expm_batch(A, [1.7, -1.7])
    np.testing.assert_allclose(forth @ back, np.eye(2), atol=1e-14)


def test_exponential_edges():
    assert linalg.expm_batch(np.zeros((0, 0)), [1.0]).shape == (1, 0, 0)
    assert linalg.expm_batch(np.eye(2), []).shape == (0, 2, 2)
    np.testing.assert_array_equal(linalg.expm_batch(np.zeros((2, 2)), [1.0, 5.0]), np.stack([np.eye(2)] * 2))
    np.testing.assert_array_equal(linalg.expm_batch(np.ones((2, 2)), [0.0])[0], np.eye(2))


@pytest.mark.parametrize("eta", [0.0, 0.7])
@pytest.mark.parametrize("A", [[[0.0, 1.0], [0.0, 0.0]], [[0.2, 1.0], [-1.0, 0.2]], [[-100.0, 3.0], [0.0, -0.01]]])
def test_discounted_flow_agrees_with_quadrature(A, eta):
    A, N = np.array(A), np.array([[2.0, 0.5], [0.5, 1.0]])
    gaps = np.array([0.05, 1.3])
    nodes, weights = np.polynomial.legendre.leggauss(24)
    flows, W = linalg.discounted_flow(A, N, gaps, eta)
    for h, flow, found in zip(gaps, flows, W, strict=True):
        expected = np.zeros((2, 2))
        edges = np.linspace(0.0, h, 60)
        for a, b in pairwise(edges):
            for x, w in zip((a + b) / 2 + (b - a) / 2 * nodes, (b - a) / 2 * weights, strict=True):
                E = exact_float_exponential(A, x)
                expected += w * np.exp(eta * x) * E @ N @ E.T
        assert relative(found, expected) <= 1e-12
        assert relative(flow, exact_exponential(A, h)) <= 1e-12
        assert np.all(np.linalg.eigvalsh(found) > 0)


def exact_float_exponential(A, t):
    """Closed form for 2 x 2 matrices (Putzer), independent of what is judged."""
    mean = np.trace(A) / 2
    B = A - mean * np.eye(2)
    root = np.sqrt(complex(-np.linalg.det(B)))
    sinch = t if abs(root * t) < 1e-12 else (np.sinh(root * t) / root).real
    return np.exp(mean * t) * (np.cosh(root * t).real * np.eye(2) + sinch * B)


def test_a_long_flow_in_uneven_units_is_that_in_even_ones():
    A, N = np.array([[-0.7, 1.5], [-1.25, 0.7]]), np.array([[2.0, 0.5], [0.5, 1.0]])
    d = np.exp2([26.0, -13.0])
    gaps = np.array([3e4, 2e7, 9e10])
    flow, W = linalg.discounted_flow(A, N, gaps, 1e-12)
    again, V = linalg.discounted_flow(A * d[:, None] / d, N * d[:, None] * d, gaps, 1e-12)
    assert np.array_equal(again / d[:, None] * d, flow)
    assert np.array_equal(V / d[:, None] / d, W)
    assert np.linalg.norm(flow, axis=(1, 2)) == pytest.approx([np.linalg.norm(flow[0])] * 3, rel=1.0)


def test_discounted_flow_edges():
    flow, W = linalg.discounted_flow(np.zeros((0, 0)), np.zeros((0, 0)), [1.0])
    assert flow.shape == W.shape == (1, 0, 0)
    flow, W = linalg.discounted_flow(np.eye(1), np.eye(1), [0.0])
    np.testing.assert_array_equal(flow, [[[1.0]]])
    np.testing.assert_array_equal(W, [[[0.0]]])


def test_root_of_a_singular_matrix():
    F = np.array([[1.0], [2.0], [-1.0]])
    L = linalg.psd_root(F @ F.T)
    assert L.shape == (3, 1)
    np.testing.assert_allclose(L @ L.T, F @ F.T, atol=1e-14)
    assert linalg.psd_root(np.zeros((2, 2))).shape == (2, 0)
    stack = linalg.psd_root(np.stack([np.diag([1.0, 0.0]), np.eye(2)]))
    np.testing.assert_allclose(stack @ np.swapaxes(stack, 1, 2), np.stack([np.diag([1.0, 0.0]), np.eye(2)]), atol=1e-15)


def test_a_wide_matrix_has_smallest_singular_value_zero():
    """E20: one row for two states proves nothing, although its only singular value is one."""
    row = np.array([[0.6, 0.8]])
    assert np.min(np.linalg.svd(row, compute_uv=False)) == pytest.approx(1.0)  # the printed version
    assert linalg.smallest_singular(row) == 0.0
    assert linalg.smallest_singular(np.eye(2)) == 1.0
    assert linalg.smallest_singular(np.zeros((3, 0))) == np.inf
    np.testing.assert_array_equal(linalg.smallest_singular(np.stack([np.eye(2), 0 * np.eye(2)])), [1.0, 0.0])


def test_generalised_maximum_is_the_least_factor():
    rng = np.random.default_rng(0)
    F, G = rng.standard_normal((2, 4, 4))
    P, Q = F @ F.T, G @ G.T + np.eye(4)
    c = linalg.generalised_max(P, Q)
    assert np.linalg.eigvalsh(c * (1 + 1e-10) * Q - P)[0] >= 0
    assert np.linalg.eigvalsh(c * (1 - 1e-10) * Q - P)[0] < 0
    assert linalg.generalised_max(np.zeros((0, 0)), np.zeros((0, 0))) == -np.inf


def test_symmetrise():
    np.testing.assert_array_equal(linalg.symmetrise(np.array([[0.0, 2.0], [0.0, 1.0]])), [[0.0, 1.0], [1.0, 1.0]])


def fractions(matrix):
    return np.vectorize(Fraction, otypes=[object])(matrix)


@pytest.mark.parametrize("scale", [1e-40, 1.0, 1e40])
def test_product_is_exact_but_for_one_rounding_where_everything_cancels(scale):
    rng = np.random.default_rng(2)
    P, Q = rng.normal(size=(3, 6)) * scale, rng.normal(size=(6, 4))
    P[:, 3:] = -P[:, :3] * (1 + 1e-14)
    Q[3:] = Q[:3]
    exact = fractions(P) @ fractions(Q)
    assert np.all(np.abs(fractions(linalg.product(P, Q)) - exact) <= 2.0**-52 * np.abs(exact))
    assert np.any(np.abs(fractions(P @ Q) - exact) > 1e-6 * np.abs(exact))


@pytest.mark.parametrize("condition", [1.0, 1e8, 1e14])
def test_product_quotient_keeps_its_digits(condition):
    rng = np.random.default_rng(6)
    U, V = (np.linalg.qr(rng.normal(size=(5, 5)))[0] for _ in range(2))
    R = np.linalg.qr(U * np.geomspace(1.0, 1 / condition, 5) @ V, mode="r")
    A = rng.normal(size=(5, 5))
    with mpmath.workdps(60):
        exact = mpmath.matrix(R.tolist()) * mpmath.matrix(A.tolist()) * mpmath.inverse(mpmath.matrix(R.tolist()))
        exact = np.array(exact.tolist(), dtype=float)
    found = linalg.product_quotient(R, A, R)
    assert np.all(np.abs(found - exact).max(axis=1) <= 1e-15 * np.abs(exact).max(axis=1))
