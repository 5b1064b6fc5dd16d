"""A worst state lies within the slab that the first sample leaves it, and the slab is no wider than it must be."""

import numpy as np
import pytest
from scipy.linalg import expm

from sampling_design import Plant
from sampling_design.observability.worst_case.spaced_rows import SpacedRows
from sampling_design.observability.worst_case.spaced_tables import SphereTables


def tables_of(A, C, window, count, spacing):
    rows = SpacedRows(Plant(A, C), window, count, spacing)
    return rows, SphereTables(rows, np.linspace(0.0, rows.slack, count), 1e-4)


def eigenpair(A, C, times):
    """The least lambda of a schedule, and its state at the first sample, slow and plain."""
    G = sum(expm(A * t).T @ C.T @ C @ expm(A * t) for t in times)
    values, vectors = np.linalg.eigh(G)
    return values[0], expm(A * times[0]) @ vectors[:, 0]


def test_states_in_a_box_are_no_longer_than_is_said_and_hardly_shorter():
    rng = np.random.default_rng(4)
    for n in (2, 3, 5):
        A, C = rng.normal(size=(n, n)) / np.sqrt(n), rng.normal(size=(1, n))
        rows, tables = tables_of(A, C, 3.0, n + 1, 0.1)
        centre, half = rng.uniform(-1, 1, (1, n)), rng.uniform(0, 0.05, (1, n))
        said = float(tables.slabs(centre, half, 1.0)[0, 0] * tables.slab[0])
        z = centre + half * np.vstack([rng.uniform(-1, 1, (200, n)), np.sign(rng.normal(size=(50, n)))])
        starts = np.append(rng.uniform(0, rows.slack, 40), [0.0, rows.slack])
        true = max(np.linalg.norm(z @ (expm(-A * u) @ tables.basis).T, axis=1).max() for u in starts)
        assert true <= said * (1 + 1e-12)
        assert said <= 1.3 * true


@pytest.mark.parametrize("seed", range(12))
def test_the_worst_state_of_any_schedule_lies_in_its_slab(seed):
    rng = np.random.default_rng(seed)
    n, p = int(rng.integers(2, 6)), int(rng.integers(1, 3))
    A, C, k = rng.normal(size=(n, n)) / np.sqrt(n), rng.normal(size=(p, n)), n + 1
    rows, tables = tables_of(A, C, 3.0, k, 0.1)
    assert tables.slab.size == min(n, p)
    for _ in range(20):
        times = rows.times(np.sort(rng.uniform(0, rows.slack, k)))
        lam, x = eigenpair(A, C, times)
        z = np.linalg.solve(tables.basis, x)
        most = tables.slabs(z[None], np.zeros((1, n)), lam)[0]
        assert np.all(np.abs(z[: tables.slab.size]) <= most)


def test_the_slab_is_tight_where_the_first_sample_is_the_only_one():
    # one sample that measures both states: what it sees of the worst one is sqrt(lambda) of its length
    C = np.array([[1.0, 0.0], [0.0, 0.5]])
    rows, tables = tables_of(np.zeros((2, 2)), C, 2.0, 1, 0.1)
    lam, x = eigenpair(rows.A, C, [0.7])
    z = np.linalg.solve(tables.basis, x)
    most = tables.slabs(z[None], np.zeros((1, 2)), lam)[0]
    assert np.max(np.abs(z) / most) == pytest.approx(1.0, rel=1e-9)
    narrower = tables.slabs(z[None], np.zeros((1, 2)), lam / 1.01)[0]
    assert np.any(np.abs(z) > narrower)


def test_states_that_grow_too_fast_between_two_looks_have_no_slab():
    A = np.array([[0.0, 900.0], [-1 / 900.0, 0.0]])
    _, tables = tables_of(A, np.array([[1.0, 0.0]]), 12.0, 3, 0.1)
    assert tables.pulled
    assert tables.slab.size == 0


@pytest.mark.parametrize("seed", range(6))
def test_no_sample_next_to_a_knot_sees_less_than_is_said_of_any_state_of_a_box(seed):
    rng = np.random.default_rng(seed)
    n, p = int(rng.integers(2, 5)), int(rng.integers(1, 3))
    A, C = rng.normal(size=(n, n)), rng.normal(size=(p, n))
    rows, tables = tables_of(A, C, 3.0, 3, 0.1)
    cells = 4 * tables.least_cells
    at_all = np.broadcast_to(np.arange(cells + 1), (1, 3, cells + 1))
    table, _, at = tables.at(cells, at_all)
    centre, half = rng.uniform(-1, 1, (1, n)), np.full((1, n), 0.02)
    said = table.least_observed(centre, half, at)[0]
    knots = tables.knot(cells, np.arange(cells + 1))
    z = centre + half * np.vstack([rng.uniform(-1, 1, (60, n)), np.sign(rng.normal(size=(20, n)))])
    loose = []
    for i, w in zip(rng.integers(0, 3, 40), rng.integers(0, cells + 1, 40), strict=True):
        times = np.linspace(knots[max(w - 1, 0)], knots[min(w + 1, cells)], 9) + rows.offsets[i]
        true = min(np.linalg.norm(z @ (C @ expm(A * t) @ tables.basis).T, axis=1).min() for t in times)
        assert said[i, w] <= true + 1e-12
        loose.append(true - said[i, w])
    # one output alone is looked at, and slopes are taken at their steepest: near, not exact
    assert np.median(loose) <= 0.5 * np.abs(said).max()


@pytest.mark.parametrize("seed", range(8))
def test_no_time_of_a_schedule_is_ruled_out_for_its_own_worst_state(seed):
    rng = np.random.default_rng(seed)
    n, k = int(rng.integers(2, 5)), 4
    rows, tables = tables_of(rng.normal(size=(n, n)) / np.sqrt(n), rng.normal(size=(1, n)), 3.0, k, 0.1)
    cells = tables.least_cells
    table, _, at = tables.at(cells, np.broadcast_to(np.arange(cells + 1), (1, k, cells + 1)))
    knots, ruled_out = tables.knot(cells, np.arange(cells + 1)), 0
    for _ in range(10):
        slacks = np.sort(rng.uniform(0, rows.slack, k))
        slacks -= slacks[0]  # the state is taken at the first sample
        lam, x = eigenpair(rows.A, rows.C, rows.times(slacks))
        z = np.linalg.solve(tables.basis, x)[None]
        dead = table.least_observed(z, np.zeros((1, n)), at)[0] > np.sqrt(lam) * tables.longest(z, np.zeros((1, n)))[0]
        w = np.clip(np.searchsorted(knots, slacks), 0, cells)
        assert not dead[np.arange(k), w].any()
        assert not dead[np.arange(k), np.maximum(w - 1, 0)].any()
        ruled_out += dead.sum()
    assert ruled_out > 0
