"""A filter's steps against the information form in sixty digits, one by one and in stacks."""

import mpmath
import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from sampling_design.numerics import filtering

ORDINARY = np.ones(3)
GRADED = np.array([1e-12, 1.0, 1e12])


def case(seed, sizes, p, exact=1.0, n=3):
    """A covariance of condition 1e2 in units of `sizes`, and p rows in units of their noise."""
    rng = np.random.default_rng(seed)
    root = (np.eye(n) + rng.normal(size=(n, n)) / 4) * sizes[:, None]
    return root @ root.T, exact * rng.normal(size=(p, n)) / sizes, root


def in_digits(Y, rows):
    """(Y^-1 + H'H)^-1 and the gain, that times H', with sixty digits."""
    with mpmath.workdps(60):
        H = mpmath.matrix(rows.tolist())
        after = mpmath.inverse(mpmath.inverse(mpmath.matrix(Y.tolist())) + H.T * H)
        gain = after * H.T
        return tuple(np.array(M.tolist(), dtype=float) for M in (after, gain))


CASES = [(0, ORDINARY, 1, 1.0), (1, ORDINARY, 5, 1.0), (2, GRADED, 2, 1.0), (3, ORDINARY, 2, 1e4), (4, GRADED, 4, 1e2)]


@pytest.mark.parametrize(("seed", "sizes", "p", "exact"), CASES)
def test_a_sample_leaves_what_the_information_form_leaves(seed, sizes, p, exact):
    Y, rows, root = case(seed, sizes, p, exact)
    after, gain = in_digits(Y, rows)
    size, lost = np.sqrt(np.diag(Y)), 1e-14 * exact
    found, own = filtering.update_with_gain(Y, rows)
    for each in (found, filtering.measurement_update(Y, rows)):
        np.testing.assert_array_equal(each, each.T)
        assert np.all(np.abs(each - after) <= lost * np.outer(size, size))
    unit = size[:, None] / np.maximum(np.linalg.norm(rows * size, axis=1), 1)
    assert np.all(np.abs(own - gain) <= 10 * lost * exact * unit)
    by_root, step, half = filtering.root_update(root, rows, np.eye(p))
    smaller = np.sqrt(np.diag(after))
    assert np.all(np.abs(by_root @ by_root.T - after) <= 1e-11 * np.outer(smaller, smaller))
    assert np.all(np.abs(step - gain) <= 10 * lost * exact * unit)
    innovation = rows @ Y @ rows.T + np.eye(p)
    np.testing.assert_allclose(half @ innovation @ half.T, np.eye(p), atol=1e-7)


def test_stacks_step_as_each_does_alone():
    cases = [case(seed, ORDINARY, 2) for seed in range(4)]
    Y, rows = np.array([c[0] for c in cases]), np.array([c[1] for c in cases])
    rows[1, 1] = 0.0  # what is not measured
    F, x = np.random.default_rng(5).normal(size=(2, 4, 3, 3))
    found, moved = filtering.joint_update(filtering.propagate(Y, F, Y), rows, x)
    for k in range(4):
        alone, own = filtering.joint_update(filtering.propagate(Y[k], F[k], Y[k]), rows[k][: 1 if k == 1 else 2], x[k])
        np.testing.assert_allclose(found[k], alone, rtol=1e-13, atol=1e-14)
        np.testing.assert_allclose(moved[k], own, rtol=1e-12, atol=1e-13)


def test_estimates_move_by_the_gain():
    Y, rows, _ = case(6, ORDINARY, 2)
    x, y = np.random.default_rng(6).normal(size=(3, 4)), np.random.default_rng(7).normal(size=(2, 4))
    gain = in_digits(Y, rows)[1]
    np.testing.assert_allclose(filtering.joint_update(Y, rows, x, y)[1], x + gain @ (y - rows @ x), rtol=1e-12)
    np.testing.assert_allclose(filtering.joint_update(Y, rows, x)[1], x - gain @ rows @ x, rtol=1e-12)


def test_noise_that_is_correlated_counts_by_its_root():
    Y, rows, _ = case(8, ORDINARY, 2)
    noise = np.array([[2.0, 1.5], [1.5, 3.0]])
    S = rows @ Y @ rows.T + noise
    expected = Y - Y @ rows.T @ np.linalg.solve(S, rows @ Y)
    np.testing.assert_allclose(
        filtering.measurement_update(Y, filtering.whitened(rows, noise)), expected, rtol=1e-12, atol=1e-13
    )


def test_over_a_gap_noise_joins():
    Y, F, _ = case(9, ORDINARY, 3)
    found = filtering.propagate(Y, F, np.diag([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(found, F @ Y @ F.T + np.diag([1.0, 2.0, 3.0]), rtol=1e-13)
    np.testing.assert_array_equal(found, found.T)


@pytest.mark.parametrize("sizes", [[1.0, 1.0], [1e-9, 1e9], [1e9, 1e-9]])
def test_a_triangle_keeps_small_columns(sizes):
    root = np.array([[1.0, 0.5, 0.2, 0.1], [0.3, 1.0, 0.4, 0.7]]) * np.repeat(sizes, 2)
    T = filtering.triangle(root)
    np.testing.assert_array_equal(np.triu(T, 1), 0)
    with mpmath.workdps(60):
        R = mpmath.matrix(root.tolist())
        expected = float(mpmath.det(R * R.T))
    assert (T[0, 0] * T[1, 1]) ** 2 == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("sizes", [ORDINARY, GRADED])
def test_maps_in_turn_are_their_steps(sizes):
    rng = np.random.default_rng(11)
    Y = case(10, sizes, 1)[0]
    flows = rng.normal(size=(2, 3, 3)) * sizes[:, None] / sizes
    rows = [case(seed, sizes, 2)[1] for seed in (11, 12)]
    maps = [filtering.CovarianceMap(F, H.T @ H, Y) for F, H in zip(flows, rows, strict=True)]
    stepped = Y
    for F, H in zip(flows, rows, strict=True):
        stepped = filtering.propagate(filtering.measurement_update(stepped, H), F, Y)
    size = np.sqrt(np.diag(stepped))
    for found in (maps[1](maps[0](Y)), maps[0].then(maps[1])(Y)):
        assert np.all(np.abs(found - stepped) <= 1e-12 * np.outer(size, size))


@pytest.mark.parametrize("sizes", [ORDINARY, GRADED])
@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_after_a_long_time_the_covariance_is_that_of_the_pencil(sizes, unit):
    """scipy takes the extended pencil; and the equation holds to the last digits, with a filter that is stable."""
    rng = np.random.default_rng(13)
    A = rng.normal(size=(3, 3)) * sizes[:, None] / sizes
    C, W = unit * rng.normal(size=(2, 3)) / sizes, np.diag([1.0, 2.0, 0.3]) * np.outer(sizes, sizes) / unit**2
    found = filtering.stationary_covariance(A, C, W)
    np.testing.assert_array_equal(found, found.T)
    by_pencil, size = solve_continuous_are(A.T, C.T, W, np.eye(2)), np.sqrt(np.diag(found))
    assert np.all(np.abs(found - by_pencil) <= 1e-8 * np.outer(size, size))
    terms = np.array([A @ found, found @ A.T, W, -found @ C.T @ C @ found]) / np.outer(size, size)
    assert np.abs(terms.sum(axis=0)).max() <= 1e-13 * np.abs(terms).sum(axis=0).max()
    assert np.linalg.eigvals((A - found @ C.T @ C) * sizes / sizes[:, None]).real.max() < 0


@pytest.mark.parametrize(
    ("A", "C", "W", "words"),
    [
        ([[0.0, 1.0], [-1.0, 0.0]], [[0.0, 0.0]], np.zeros((2, 2)), "no n modes that decay"),
        ([[0.5]], [[1e200]], [[1.0]], "leaves double precision"),
        ([[0.5, 0.0], [0.0, -1.0]], [[0.0, 1.0]], np.eye(2), "Singular matrix|leaves double precision"),
    ],
)
def test_a_covariance_that_never_settles_is_refused(A, C, W, words):
    with pytest.raises(np.linalg.LinAlgError, match=words):
        filtering.stationary_covariance(*map(np.array, (A, C, W)))
