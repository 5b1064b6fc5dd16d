"""Least paths against enumeration, with and without windows, and chords that stay below their curves."""

from itertools import combinations_with_replacement

import numpy as np
import pytest

from sampling_design import Plant
from sampling_design.observability.worst_case.spaced_rows import SpacedRows
from sampling_design.observability.worst_case.spaced_search import least_path, sums_so_far, sums_to_go
from sampling_design.observability.worst_case.spaced_sphere import around
from sampling_design.observability.worst_case.spaced_tables import SphereTables


def least_through(cost, i, point):
    """Least sum of a non-decreasing path through `point` of row i, by enumeration; cost maps (row, point)."""
    count = 1 + max(r for r, _ in cost)
    points = sorted({p for _, p in cost})
    sums = [
        sum(cost.get((r, p), np.inf) for r, p in enumerate(pick))
        for pick in combinations_with_replacement(points, count)
        if pick[i] == point
    ]
    return min(sums)


@pytest.mark.parametrize(("count", "length"), [(1, 4), (2, 5), (4, 5)])
def test_least_path_is_the_least_of_all(count, length):
    cost = np.random.default_rng(count).uniform(-1, 1, (6, count, length))
    paths = least_path(cost)
    for b in range(6):
        found = sum(cost[b, i, j] for i, j in enumerate(paths[b]))
        best = min(
            sum(cost[b, i, j] for i, j in enumerate(p)) for p in combinations_with_replacement(range(length), count)
        )
        assert np.all(np.diff(paths[b]) >= 0)
        assert found == pytest.approx(best)


def test_windows_may_begin_anywhere_and_both_directions_meet():
    rng, width = np.random.default_rng(5), 3
    start = np.array([[0, 0, 2], [1, 4, 5], [0, 3, 3]])
    cost = rng.uniform(0, 1, (3, width, 3, 2))
    through = sums_so_far(cost, start) + sums_to_go(cost, start)
    for b in range(3):
        for c in range(2):
            known = {(i, int(start[b, i]) + w): cost[i, w, b, c] for i in range(3) for w in range(width)}
            for (i, point), _ in known.items():
                expected = least_through(known, i, point)
                assert through[i, point - start[b, i], b, c] == pytest.approx(expected)


@pytest.mark.parametrize("cells", [2, 7, 32])
@pytest.mark.parametrize("seed", range(4))
def test_curves_never_sink_below_their_lowered_chords(cells, seed, monkeypatch):
    rng = np.random.default_rng(seed)
    plant = Plant(rng.normal(size=(3, 3)) * 2, rng.normal(size=(2, 3)))
    rows = SpacedRows(plant, 3.0, 2, 0.4)
    monkeypatch.setattr(SphereTables, "first_cells", lambda self: cells)
    tables = SphereTables(rows, np.array([0.0, 1.0]), 1e-4)
    cells = tables.least_cells
    point = np.broadcast_to(np.arange(cells + 1), (1, 2, cells + 1))
    table, _, at = tables.at(cells, point)
    z, d = rng.normal(size=3), rng.normal(size=3) * 0.3
    X = (np.outer(z, z + d) + np.outer(z + d, z)) / 2
    value, bent = (part[0].transpose(0, 2, 1) @ (z + d) for part in table.against(z[None], at)[:2])
    here = at[0, :, :-1]
    sink = np.maximum(bent[:, :-1], bent[:, 1:]) * table.eighth[here]
    low = value - around(np.maximum(sink + table.beyond[here] * np.linalg.norm(X, "nuc"), 0.0), -1)
    knots, fine = tables.knot(cells, np.arange(cells + 1)), np.linspace(0, rows.slack, 40 * cells + 1)
    for i in range(2):
        seen = rows.at(fine + rows.offsets[i]) @ tables.basis
        curve = np.einsum("tpa,ab,tpb->t", seen, X, seen)
        assert np.all(curve >= np.interp(fine, knots, low[i]) - 1e-12 * np.abs(curve).max())


@pytest.mark.parametrize("seed", range(4))
def test_states_carried_back_are_no_larger_than_said_for_any_start(seed):
    rng = np.random.default_rng(seed)
    plant = Plant(rng.normal(size=(3, 3)) * 2, rng.normal(size=(2, 3)))
    rows = SpacedRows(plant, 2.0, 2, 0.4)
    tables = SphereTables(rows, np.array([0.3, 1.0]), 1e-4)
    assert tables.pulled
    starts, y, c = tables.starts(16), rng.normal(size=3), rng.normal(size=3)
    value = starts.norm @ c @ y
    bend = (starts.bend @ c @ y).max() + starts.beyond * np.linalg.norm(y) * np.linalg.norm(c)
    knots, fine = np.linspace(0, rows.slack, 17), np.linspace(0, rows.slack, 600)
    flow = plant.transition(-fine) @ tables.basis
    curve = np.einsum("tij,j->ti", flow, y) * np.einsum("tij,j->ti", flow, c)
    above = np.interp(fine, knots, value) + max(bend, 0.0) * starts.eighth
    assert np.all(curve.sum(axis=1) <= above + 1e-12 * np.abs(above).max())


def test_finer_grids_hold_the_same_rows_whole_or_in_part(monkeypatch):
    plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    rows = SpacedRows(plant, 4.0, 3, 1e-3)
    whole, part = (SphereTables(rows, np.zeros(3), 1e-4) for _ in range(2))
    part._whole = 0
    cells = 8 * whole.least_cells
    point = np.array([[[0, 0], [5, 6], [cells - 1, cells]], [[0, 0], [7, 8], [5, 6]]])
    for one, other in zip(whole.at(cells, point)[:1], part.at(cells, point)[:1], strict=True):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a[whole.at(cells, point)[2]], b[part.at(cells, point)[2]])
