"""Branch and bound over cells: depth first where all must be proven, best first where a least value is bracketed.

A cell is whatever its owner makes of it: an interval with a state, a box of parameters. Cells that numpy judges side by
side are a batch, a named tuple of arrays with one row for each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Generic, Protocol, Self, TypeVar

import numpy as np

from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.budget import ENDLESS, Budget

Cell = TypeVar("Cell")


def all_proven(
    cells: Iterable[Cell],
    parts_of: Callable[[Cell], Iterable[Cell] | None],
    budget: Budget = ENDLESS,
    price: float = 0.0,
) -> bool:
    """Whether every cell is proven, by itself or by all parts that it is cut into, depth first.

    Parameters
    ----------
    cells : iterable
        Together what is to be proven.
    parts_of : callable
        Nothing (an empty sequence) for a cell that is proven, else the parts that are open in its place, the last of
        which is next; None where it can neither be proven nor cut, which ends the search.
    price : float
        Of a cell, in operations of about a microsecond, for budgets that count them.

    Returns
    -------
    bool
        False says that nothing is proven, not that it is wrong.

    Raises
    ------
    BudgetSpentError
        Once the budget is spent.
    """
    pending = list(cells)
    while pending:
        budget.check(price)
        parts = parts_of(pending.pop())
        if parts is None:
            return False
        pending += parts
    return True


def within(rtol: float) -> Callable[[Array, Array], Mask]:
    """A bound is enough where it is at most a share `rtol` below the best value, which is not negative."""
    return lambda bound, best: np.asarray(bound >= (1 - rtol) * best)


class CellBatch(Protocol):
    """Cells side by side."""

    def take(self, index: Index | Mask) -> Self:
        """Those of some rows."""

    def joined(self, *others: Self) -> Self:
        """These and others, in this order."""


Batch = TypeVar("Batch", bound=CellBatch)
JudgeCells = Callable[[Batch], tuple[Array, Array] | None]
CutCells = Callable[[Batch, Array], tuple[Batch, Index] | None]


class LeastOverCells(Generic[Batch]):
    """The least of some values over all points of some cells, bracketed: best first.

        min(closed_at, bound of the open cells, best)  <=  least value  <=  best

    Parameters
    ----------
    cells : CellBatch
        Together where the points are.
    bound : Array (N, R)
        What the values of each cell are certainly not below.
    enough : callable
        Whether a bound (N, R) is enough, given the best values (R,): a cell closes where it is for all of them.
    budget : Budget
    together : int
        Cells judged in one step, those with the least bounds.
    most : int
        Cells after which the search ends as it does with its budget.
    begin : callable, optional
        Bounds of cells as they are made; else they inherit that of what they were cut from, and so they do where it is
        larger.

    Attributes
    ----------
    best : Array (R,)
        Least values that were met.
    closed_at : Array (R,)
        Least bounds of cells that were closed.
    judged : int
        Cells that were judged.
    """

    def __init__(
        self,
        cells: Batch,
        bound: Array,
        enough: Callable[[Array, Array], Mask],
        budget: Budget = ENDLESS,
        *,
        together: int = 1,
        most: float = np.inf,
        begin: Callable[[Batch], Array] | None = None,
    ) -> None:
        self.cells, self.bound, self.enough, self.budget = cells, np.asarray(bound, dtype=np.float64), enough, budget
        self.together, self.most, self.begin = together, most, begin
        self.best = np.full(self.bound.shape[1], np.inf)
        self.closed_at = np.full(self.bound.shape[1], np.inf)
        self.judged = 0
        self.closed: list[Batch] = []
        """Cells whose bounds were enough."""

    @property
    def lower(self) -> Array:
        """What no value is below."""
        found: Array = np.minimum(self.closed_at, self.best)
        return np.asarray(np.minimum(found, self.bound.min(axis=0, initial=np.inf)), dtype=np.float64)

    def attain(self, values: Array) -> Index:
        """Take values that are attained at one point; the places of those that are less than any before."""
        less = np.flatnonzero(values < self.best)
        self.best[less] = values[less]
        return less

    def run(self, judge: JudgeCells[Batch], cut: CutCells[Batch], stop: Callable[[], bool] = lambda: False) -> str:
        """Judge and cut until nothing is open, and say why it ended.

        Parameters
        ----------
        judge : callable
            Bounds (n, R) of some cells, and what `cut` is given of each; None ends the search. It calls `attain`.
        cut : callable
            The parts of cells, and which cell each is a part of; None where one can be cut no further.
        stop : callable
            Called before every step; true ends the search.

        Returns
        -------
        str
            "closed", "budget" (after one step at least), "stopped" by `judge` or `stop`, "small" where a cell could not
            be cut, or "interrupted": what was proven before that step stands. An interrupt before anything was judged
            or met is raised.
        """
        status = ""
        while not status:
            before, closed = (self.cells, self.bound.copy(), self.closed_at, self.judged), len(self.closed)
            try:
                status = self._stepped(judge, cut, stop)
            except KeyboardInterrupt:
                self.cells, self.bound, self.closed_at, self.judged = before
                del self.closed[closed:]
                if not self.judged and not np.isfinite(self.best).any():  # nothing is known yet
                    raise
                status = "interrupted"
        return status

    def _stepped(self, judge: JudgeCells[Batch], cut: CutCells[Batch], stop: Callable[[], bool]) -> str:
        """One step: why the search ends, or nothing."""
        self._close()
        if not len(self.bound):
            return "closed"
        if stop():
            return "stopped"
        spent = self.budget.over or self.judged + min(self.together, len(self.bound)) > self.most
        if self.judged and spent:
            return "budget"
        near, rest = self._nearest()
        some = self.cells.take(near)
        found = judge(some)
        if found is None:
            return "stopped"
        self.judged += len(near)
        self.bound[near] = np.fmax(found[0], self.bound[near])
        open_ = ~self._done(self.bound[near])
        self.closed_at = np.minimum(self.closed_at, self.bound[near][~open_].min(axis=0, initial=np.inf))
        if not open_.all():
            self.closed.append(some.take(~open_))
        parts = cut(some.take(open_), found[1][open_]) if open_.any() else None
        if parts is None:
            left = np.concatenate([near[open_], rest])
            self.cells, self.bound = self.cells.take(left), self.bound[left]
            return "small" if open_.any() else ""
        made, parents = parts
        bound = self.bound[near][open_][parents]
        bound = bound if self.begin is None else np.fmax(self.begin(made), bound)
        self.cells, self.bound = made.joined(self.cells.take(rest)), np.concatenate([bound, self.bound[rest]])
        return ""

    def _done(self, bound: Array) -> Mask:
        return np.asarray(np.all(self.enough(bound, self.best), axis=1))

    def _close(self) -> None:
        """Leave out what need not be looked at."""
        done = self._done(self.bound)
        if done.any():
            self.closed_at = np.minimum(self.closed_at, self.bound[done].min(axis=0))
            self.closed.append(self.cells.take(done))
            self.cells, self.bound = self.cells.take(~done), self.bound[~done]

    def _nearest(self) -> tuple[Index, Index]:
        """The cells with the least bounds, and the others."""
        least = self.bound.min(axis=1)
        order = np.argsort(least, kind="stable") if self.together > 1 else np.array([np.argmin(least)])
        near = order[: self.together]
        rest = np.ones(len(least), dtype=bool)
        rest[near] = False
        return near, np.flatnonzero(rest)
