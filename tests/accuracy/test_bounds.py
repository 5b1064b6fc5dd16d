"""Sets about a centre, by rows and by a root: what they say of a row is what a program of all their points says."""

import numpy as np
import pytest
from scipy.optimize import linprog

from sampling_design.accuracy.bounds import BoundedSet, InitialSet

HALVES = ([0.5, 2.0, 3.0], [0.5, 0.0, 3.0], [0.0, 0.0, 0.0], [0.5, np.inf, 0.0], [np.inf] * 3)
ROWS = np.array([[1.0, -2.0, 0.5], [1.0, 0.0, 0.0], [0.0, 0.0, -3.0]])


def largest(row, half):
    found = linprog(-row, bounds=[(-h if np.isfinite(h) else None, h if np.isfinite(h) else None) for h in half])
    return np.inf if found.status == 3 else -found.fun


@pytest.mark.parametrize("half", HALVES, ids=str)
def test_a_box_by_rows_says_what_a_linear_program_says(half):
    half = np.array(half)
    found = InitialSet.box(half)
    assert [found.support(row, 1.0) for row in ROWS] == pytest.approx([largest(row, half) for row in ROWS])
    assert found.whole == bool(np.isfinite(half).all())
    assert found.exact.tolist() == (half == 0).tolist()
    assert np.allclose(np.abs(found.free()).sum(axis=1), np.isinf(half))
    point = np.where(np.isfinite(half), half, 7.0)
    assert found.excess(point / 4) == pytest.approx(0.25 if np.any(np.isfinite(half) & (half > 0)) else 0.0)
    assert np.isinf(found.excess(np.ones(3))) == bool(np.any(half == 0))


def test_a_ball_and_a_box_by_a_root_hold_what_their_points_reach():
    root, rng = np.array([[1.0, 0.5], [0.0, 2.0]]), np.random.default_rng(3)
    points = rng.standard_normal((4000, 2))
    for ball, size in ((True, np.linalg.norm(points, axis=1)), (False, np.abs(points).max(axis=1))):
        found = BoundedSet(np.zeros(2), root, ball)
        reached = points / size[:, None] @ root.T
        for row in ([1.0, 0.0], [0.3, -0.7]):
            most = float(np.max(reached @ row))
            assert 0.98 * found.support(np.array(row)) <= most <= found.support(np.array(row)) * (1 + 1e-12)
        assert found.half_widths == pytest.approx([found.support(row) for row in np.eye(2)])


def test_coordinates_change_nothing_of_a_set():
    half, change = np.array([0.5, 0.0, 3.0]), np.array([[2.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 4.0]])
    plain, moved = InitialSet.box(half), InitialSet.box(half).scaled(change, np.ones(3), 1e-9)
    for row in ROWS:
        assert moved.support(change.T @ row, 1.0) == pytest.approx(plain.support(row, 1.0), abs=1e-8)
