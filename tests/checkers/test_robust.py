"""Positive definite however far it is moved: against all corners, one by one."""

from itertools import product

import numpy as np
import pytest

from sampling_design.checkers.inclusion import definite_robustly


def drawn(rng, count, directions, m, scale):
    root = rng.normal(size=(count, m, m)) * 10.0 ** rng.uniform(-4, 4, m)[:, None]
    form = root @ np.swapaxes(root, 1, 2)
    moves = np.array([root @ np.diag(rng.normal(size=m)) @ np.swapaxes(root, 1, 2) for _ in range(directions)])
    return form, scale * moves.reshape(directions, count, m, m)


def judged(form, moves, radius):
    terms = np.abs(form) + np.abs(moves).sum(axis=0) + radius
    return definite_robustly(form, terms, moves, radius)[0]


def corners_hold(form, moves):
    signs = np.array(list(product((-1.0, 1.0), repeat=len(moves)))).reshape(2 ** len(moves), len(moves))
    d = np.sqrt(np.einsum("kii->ki", form))
    scaled = (form[None] + np.tensordot(signs, moves, 1)) / (d[:, :, None] * d[:, None, :])
    return np.linalg.eigvalsh(scaled)[..., 0].min(axis=0)


@pytest.mark.parametrize("scale", [0.0, 0.1, 0.3, 1.0])
def test_what_is_proven_holds_at_every_corner(scale):
    form, moves = drawn(np.random.default_rng(0), 30, 5, 4, scale)
    left, least = judged(form, moves, np.zeros_like(form)), corners_hold(form, moves)
    assert np.all(least[left > 0] > 0)
    assert np.all(left[least > 1e-6] > 0)  # and nothing that is clearly true is left open
    if scale:
        assert scale > 0.1 or (left > 0).any()
    else:
        assert (left > 0.99).all()


def test_radii_and_numbers_that_are_not_finite_prove_nothing():
    form, moves = drawn(np.random.default_rng(1), 3, 2, 3, 0.01)
    radius = np.zeros_like(form)
    radius[0] = 2 * np.abs(form[0])
    moves[0, 1, 0, 0] = np.inf
    left = judged(form, moves, radius)
    assert left[0] == -1
    assert left[1] == -1
    assert left[2] > 0
    assert judged(-form[2:], moves[:, 2:], 0 * form[2:])[0] == -1


def test_a_region_holds_a_state_exactly_when_a_linear_program_finds_one():
    from scipy.optimize import linprog

    from sampling_design.checkers.half_spaces import holds_a_point

    rng, found = np.random.default_rng(0), [0, 0]
    for _ in range(60):
        n, m = int(rng.integers(1, 5)), int(rng.integers(1, 8))
        rows, offsets = rng.integers(-3, 4, (m, n)).astype(float), rng.integers(-4, 5, m).astype(float)
        low = np.where(rng.random(n) < 0.5, -np.inf, rng.integers(-3, 1, n))
        high = np.where(rng.random(n) < 0.5, np.inf, rng.integers(0, 4, n))
        expected = linprog(np.zeros(n), rows, offsets, bounds=np.column_stack([low, high])).status == 0
        for scale in (1.0, 1e-12, 1e12):
            assert holds_a_point(scale * low, scale * high, rows, scale * offsets) is expected
        found[expected] += 1
    assert min(found) > 10
    assert holds_a_point(np.ones(1), np.full(1, np.inf), np.ones((1, 1)), np.array([np.nextafter(1.0, 0.0)])) is False


def test_a_question_of_too_many_half_spaces_is_left_open(monkeypatch):
    from sampling_design.checkers import half_spaces

    monkeypatch.setattr(half_spaces, "MOST_ENTRIES", 0)
    assert half_spaces.holds_a_point(np.zeros(1), np.ones(1), np.ones((1, 1)), np.ones(1)) is None
