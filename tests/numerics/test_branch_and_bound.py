"""Cells are proven or cut, depth first; brackets of a least value hold and close, best first, however they end."""

from itertools import product
from typing import NamedTuple

import numpy as np
import pytest

from sampling_design.numerics.branch_and_bound import LeastOverCells, all_proven, within
from sampling_design.records.budget import Budget, BudgetSpentError
from tests.cases import few


class Intervals(NamedTuple):
    low: np.ndarray
    high: np.ndarray

    def take(self, index):
        return Intervals(self.low[index], self.high[index])

    def joined(self, *others):
        return Intervals(*(np.concatenate(parts) for parts in zip(self, *others, strict=True)))


WHOLE = Intervals(np.array([0.0]), np.array([10.0]))


def halves(cells, effect):
    middle = (cells.low + cells.high) / 2
    parts = Intervals(np.concatenate([cells.low, middle]), np.concatenate([middle, cells.high]))
    return parts, np.tile(np.arange(len(middle)), 2)


def waves(rng):
    """Positive sums of waves with their slopes' bounds, (R,), and the least of each on a fine grid."""
    size, speed, at = rng.uniform(0.2, 1.0, (2, 3)), rng.uniform(0.5, 4.0, (2, 3)), rng.uniform(0, 6.0, (2, 3))

    def value(t):
        return np.sum(size * (1.1 + np.sin(speed * np.asarray(t)[..., None, None] + at)), axis=-1)

    return value, np.sum(size * speed, axis=1), value(np.linspace(0.0, 10.0, 20001)).min(axis=0)


def searched(rng, together=1, budget=None, most=np.inf, rtol=1e-3, look=lambda: False):
    value, slope, least = waves(rng)

    def judge(cells):
        middle = (cells.low + cells.high) / 2
        found = value(middle)
        for each in found:
            search.attain(each)
        return found - slope * (cells.high - cells.low)[:, None] / 2, np.zeros(len(middle))

    search = LeastOverCells(WHOLE, np.full((1, 2), -np.inf), within(rtol), Budget(budget), together=together, most=most)
    return search, search.run(judge, halves, look), least


@pytest.mark.parametrize(("seed", "together"), few(product([0, 1, 2], [1, 4, 1000]), 0, 1, 5, 8))
def test_a_closed_bracket_holds_the_least_of_each_value(seed, together):
    search, status, least = searched(np.random.default_rng(seed), together)
    assert status == "closed"
    assert np.all(search.lower <= least)
    assert np.all(search.best >= least - 1e-6)
    assert np.all(search.lower >= (1 - 1e-3) * search.best)
    covered = sorted((low, high) for part in search.closed for low, high in zip(*part, strict=True))
    ends = np.array(covered)
    assert ends[0, 0] == 0.0
    assert ends[-1, 1] == 10.0
    assert np.array_equal(ends[1:, 0], ends[:-1, 1])  # what is closed is the whole, each point once


@pytest.mark.parametrize("most", [1, 7, 30])
def test_what_ends_early_is_still_a_bracket(most):
    for search, status, least in (
        searched(np.random.default_rng(5), most=most),
        searched(np.random.default_rng(5), look=iter([False] * most + [True]).__next__),
    ):
        assert status in ("budget", "stopped")
        assert search.judged == most
        assert np.all(search.lower <= least)
        assert np.all(search.best >= least - 1e-6)
        left = search.cells.joined(*search.closed)
        assert np.sum(left.high - left.low) == 10.0
    more = searched(np.random.default_rng(5), most=most + 20)[0]
    assert np.all(more.lower >= search.lower)  # more work never loosens a bound


def test_without_any_time_one_step_is_done():
    search, status, least = searched(np.random.default_rng(5), budget=-1.0)
    assert (status, search.judged) == ("budget", 1)
    assert np.all(np.isfinite(search.best))
    assert np.all(search.lower <= least)


def test_the_best_cell_is_next():
    one, _, _ = searched(np.random.default_rng(3))
    level, _, _ = searched(np.random.default_rng(3), together=1000)
    assert one.judged < level.judged


def test_cells_that_cannot_be_cut_or_judged_end_the_search():
    search = LeastOverCells(WHOLE, np.zeros((1, 1)), within(0.1))
    search.attain(np.array([1.0]))
    assert search.run(lambda cells: (np.array([[0.5]]), np.zeros(1)), lambda cells, effect: None) == "small"
    assert search.lower == 0.5
    assert search.run(lambda cells: None, halves) == "stopped"
    assert np.array_equal(search.cells.high, WHOLE.high)


def test_bounds_of_cells_as_they_are_made_count_where_they_are_larger():
    search = LeastOverCells(WHOLE, np.zeros((1, 1)), within(0.1), most=1, begin=lambda cells: cells.low[:, None])
    search.run(lambda cells: (np.array([[2.0]]), np.zeros(1)), halves)
    assert search.bound.ravel().tolist() == [2.0, 5.0]
    assert search.attain(np.array([3.0])).tolist() == [0]
    assert search.attain(np.array([3.0])).tolist() == []


def test_depth_first_every_cell_is_proven_or_cut():
    seen = []

    def parts_of(cell):
        low, high = cell
        seen.append(cell)
        if high - low <= 1.0 or high <= 4.0:
            return []
        middle = (low + high) / 2
        return [(low, middle), (middle, high)]

    assert all_proven([(0.0, 4.0), (4.0, 8.0)], parts_of)
    assert seen == [(4.0, 8.0), (6.0, 8.0), (7.0, 8.0), (6.0, 7.0), (4.0, 6.0), (5.0, 6.0), (4.0, 5.0), (0.0, 4.0)]
    assert all_proven([], parts_of)
    assert not all_proven([(0.0, 8.0)], lambda cell: None if cell[1] == 2.0 else [(0.0, cell[1] / 2)])
    with pytest.raises(BudgetSpentError, match="the budget ran out"):
        all_proven([(0.0, 8.0)], parts_of, Budget(-1.0))
