"""Least paths against enumeration, with and without windows, and chords that stay below their curves."""

from itertools import combinations_with_replacement

import numpy as np
import pytest

from sampling_design import Plant
from sampling_design.observability.worst_case.spaced_paths import least_path, sums_so_far, sums_to_go
from sampling_design.observability.worst_case.spaced_rows import SpacedRows
from sampling_design.observability.worst_case.spaced_tables import Tables


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
    cost = rng.uniform(0, 1, (3, 3, 2, width))
    through = sums_so_far(cost, start) + sums_to_go(cost, start)
    for b in range(3):
        for c in range(2):
            known = {(i, int(start[b, i]) + w): cost[b, i, c, w] for i in range(3) for w in range(width)}
            for (i, point), _ in known.items():
                expected = least_through(known, i, point)
                assert through[b, i, c, point - start[b, i]] == pytest.approx(expected)


@pytest.mark.parametrize("cells", [2, 7, 32])
@pytest.mark.parametrize("seed", range(4))
def test_curves_never_sink_below_their_lowered_chords(cells, seed):
    rng = np.random.default_rng(seed)
    plant = Plant(rng.normal(size=(3, 3)) * 2, rng.normal(size=(2, 3)))
    rows = SpacedRows(plant, 3.0, 2, 0.4)
    tables = Tables(rows, np.array([0.0, 1.0]), 1e-4)
    table = tables.at(cells)
    z, d = rng.normal(size=3), rng.normal(size=3) * 0.3
    X = np.outer(z, z) + np.outer(d, z) + np.outer(z, d)
    form = tables.triangle(X)
    nuclear = np.linalg.norm(X, "nuc")
    value = table.gram[:, 1:-1] @ form
    bend = table.bend @ form
    bent = np.maximum.reduce([bend[:, :-2], bend[:, 1:-1], bend[:, 2:]])
    low = value - np.maximum(bent + table.beyond * nuclear, 0.0)
    knots, fine = np.linspace(0, rows.slack, cells + 1), np.linspace(0, rows.slack, 40 * cells + 1)
    for i in range(2):
        seen = rows.at(fine + rows.offsets[i]) @ tables.basis
        curve = np.einsum("tpa,ab,tpb->t", seen, X, seen)
        assert np.all(curve >= np.interp(fine, knots, low[i]) - 1e-12 * np.abs(curve).max())
