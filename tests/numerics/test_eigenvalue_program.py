"""Weights by which the least eigenvalue is largest: every bracket is feasible and holds a general solver's."""

import numpy as np
import pytest

from sampling_design.numerics import conic_programs
from sampling_design.numerics.eigenvalue_program import MixedMatrices, brackets


def mixed(rows, group):
    """The program in which the weights of each group sum to one."""
    members = (group == np.arange(group.max() + 1)[:, None]).astype(float)
    none = np.zeros((0, group.size))
    first = (1 / members.sum(axis=1))[group]
    return MixedMatrices(rows, first, members, np.ones(len(members)), none, none[:, 0], np.eye(rows.shape[-1]))


def drawn(seed, groups=(4, 1, 3), matrices=3, outputs=2, n=4):
    """Rows of each choice in each matrix, and the choices' groups."""
    group = np.repeat(np.arange(len(groups)), groups)
    return np.random.default_rng(seed).normal(size=(matrices, group.size, outputs, n)), group


def solved(program):
    """The optimum by a general solver."""
    rows, _, equal, sums, bounded, limits, roof = program
    M, N = rows.shape[:2]
    grams = conic_programs.svec(np.swapaxes(rows, -1, -2) @ rows)
    of_x = np.vstack([bounded, -np.eye(N)])
    blocks = [
        ("zero", np.hstack([equal, np.zeros((len(equal), 1))]), sums),
        ("nonnegative", np.hstack([of_x, np.zeros((len(of_x), 1))]), np.append(limits, np.zeros(N))),
    ]
    roof = conic_programs.svec(roof)
    blocks += [("psd", np.hstack([-grams[m].T, roof[:, None]]), np.zeros(roof.size)) for m in range(M)]
    return conic_programs.solve_cone_program(np.append(np.zeros(N), -1.0), blocks, tolerance=1e-10).x[-1]


@pytest.mark.parametrize("seed", range(4))
def test_every_bracket_is_feasible_and_holds_the_optimum(seed):
    rows, group = drawn(seed)
    best = solved(mixed(rows, group))
    for found in brackets(mixed(rows, group)):
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
    *_, last = brackets(mixed(rows, group))
    assert (last.t, last.total) == pytest.approx((least, least), rel=1e-6)


@pytest.mark.parametrize("size", [1e-12, 1e12])
def test_units_of_the_rows_change_its_unit_alone(size):
    rows, group = drawn(6)
    for one, other in zip(brackets(mixed(rows, group)), brackets(mixed(size * rows, group)), strict=False):
        assert (other.t / size**2, other.total / size**2) == pytest.approx((one.t, one.total), rel=1e-5, abs=1e-7)


def test_what_no_row_holds_leaves_nothing():
    rows, group = drawn(7)
    rows[1, ..., 0] = 0.0
    *_, last = brackets(mixed(rows, group))
    assert last.t <= 0 <= last.total <= 1e-5 * np.sum(rows**2)


@pytest.mark.parametrize("outputs", [1, 2, 5])
@pytest.mark.parametrize("limit", [0.5, 1.0])
def test_limits_of_weights_that_the_first_ones_exceed_are_made_up_for(outputs, limit):
    """Four samples among twelve times: at most one in three that follow each other, less than half of one at first."""
    rng = np.random.default_rng(outputs)
    rows, one, crowd = rng.normal(size=(3, 12, outputs, 4)), np.ones((1, 12)), sum(np.eye(12, k=k) for k in range(3))
    unit = np.eye(4) + 0.1 * np.ones((4, 4))
    early = -np.eye(1, 12)  # the first time is taken by half a sample at least
    limits = np.append(limit * np.full(12, 3.0), -0.5)
    program = MixedMatrices(rows, np.full(12, 1 / 3), one, np.array([4.0]), np.vstack([crowd, early]), limits, unit)
    best = solved(program)
    found = list(brackets(program))
    assert found[0].t == -np.inf
    assert all(each.t <= best * (1 + 1e-7) and best <= each.total * (1 + 1e-7) for each in found)
    last = found[-1]
    assert last.total - last.t <= 1e-6 * best
    assert np.all(program.bounded @ last.x <= limits + 1e-9)
    W = np.einsum("mjpa,j,mjpb->mab", rows, last.x, rows)
    assert np.linalg.eigvalsh(W - last.t * unit).min() > -1e-9 * best
    assert np.sum(last.Z * unit) == pytest.approx(1.0, abs=1e-9)
