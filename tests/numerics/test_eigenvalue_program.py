"""Weights by which the least eigenvalue is largest: every bracket is feasible and holds a general solver's."""

import numpy as np
import pytest

from sampling_design.numerics import conic_programs
from sampling_design.numerics.eigenvalue_program import brackets


def drawn(seed, groups=(4, 1, 3), matrices=3, outputs=2, n=4):
    """Rows of each choice in each matrix, and the choices' groups."""
    group = np.repeat(np.arange(len(groups)), groups)
    return np.random.default_rng(seed).normal(size=(matrices, group.size, outputs, n)), group


def solved(rows, group):
    """The optimum by a general solver."""
    M, N, _, n = rows.shape
    grams = conic_programs.svec(np.swapaxes(rows, -1, -2) @ rows)
    members = (group == np.arange(group.max() + 1)[:, None]).astype(float)
    blocks = [
        ("zero", np.hstack([members, np.zeros((len(members), 1))]), np.ones(len(members))),
        ("nonnegative", np.hstack([-np.eye(N), np.zeros((N, 1))]), np.zeros(N)),
    ]
    roof = conic_programs.svec(np.eye(n))
    blocks += [("psd", np.hstack([-grams[m].T, roof[:, None]]), np.zeros(roof.size)) for m in range(M)]
    return conic_programs.solve_cone_program(np.append(np.zeros(N), -1.0), blocks, tolerance=1e-10).x[-1]


@pytest.mark.parametrize("seed", range(4))
def test_every_bracket_is_feasible_and_holds_the_optimum(seed):
    rows, group = drawn(seed)
    best = solved(rows, group)
    for found in brackets(rows, group):
        W = np.einsum("mjpa,j,mjpb->mab", rows, found.x, rows)
        q = np.einsum("mjpa,mab,mjpb->j", rows, found.Z, rows)
        assert np.all(found.x >= 0)
        assert np.allclose(np.bincount(group, found.x), 1.0, rtol=1e-12)
        assert np.linalg.eigvalsh(W).min() >= found.t - 1e-9 * best
        assert np.linalg.eigvalsh(found.Z).min() > 0
        assert np.trace(found.Z, axis1=1, axis2=2).sum() == pytest.approx(1.0, abs=1e-9)
        assert sum(q[group == g].max() for g in range(3)) <= found.total * (1 + 1e-9)
        assert found.t <= best * (1 + 1e-7)
        assert best <= found.total * (1 + 1e-7)
    assert found.total - found.t <= 1e-6 * best


def test_without_a_choice_it_is_the_least_eigenvalue():
    rows, group = drawn(5, groups=(1, 1, 1, 1))
    least = np.linalg.eigvalsh(np.einsum("mjpa,mjpb->mab", rows, rows)).min()
    *_, last = brackets(rows, group)
    assert (last.t, last.total) == pytest.approx((least, least), rel=1e-6)


@pytest.mark.parametrize("size", [1e-12, 1e12])
def test_units_of_the_rows_change_its_unit_alone(size):
    rows, group = drawn(6)
    for one, other in zip(brackets(rows, group), brackets(size * rows, group), strict=False):
        assert (other.t / size**2, other.total / size**2) == pytest.approx((one.t, one.total), rel=1e-5, abs=1e-7)


def test_what_no_row_holds_leaves_nothing():
    rows, group = drawn(7)
    rows[1, ..., 0] = 0.0
    *_, last = brackets(rows, group)
    assert last.t <= 0 <= last.total <= 1e-5 * np.sum(rows**2)
