"""Least sums along non-decreasing grid paths: dynamic programming, many problems at once.

A schedule with k samples at least `spacing` apart is tau_i = u_i + (i - 1) spacing with slacks
0 <= u_1 <= ... <= u_k <= S. In slacks the spacing is gone: what is left is the order, and the best
order-preserving path through k rows of costs is a running minimum per row.
"""

from __future__ import annotations

import numpy as np

from sampling_design.records.arrays import Array, Integers

_FEW = 128  # numbers below which a step of one's own costs more than numpy's accumulation of them


def least_path(cost: Array) -> Integers:
    """Return for each of B problems the non-decreasing path (B, k) of least sum through `cost` (B, k, N)."""
    length = cost.shape[2]
    total, choices = cost[:, 0], []
    for i in range(1, cost.shape[1]):
        running = np.minimum.accumulate(total, axis=1)
        choices.append(np.maximum.accumulate(np.where(total <= running, np.arange(length), 0), axis=1))
        total = cost[:, i] + running
    path = [np.argmin(total, axis=1)]
    for choice in reversed(choices):
        path.append(np.take_along_axis(choice, path[-1][:, None], axis=1)[:, 0])
    return np.stack(path[::-1], axis=1)


def sums_so_far(cost: Array, start: Integers) -> Array:
    """Return the least sum of a path that ends at each point, its own cost included.

    Parameters
    ----------
    cost : (k, W, B, c) array
        c problems for each of B sets of windows; point w of row i is grid point start[b, i] + w. The points come
        first, so that every step is one over all problems.
    start : (B, k) array
        Where the windows begin, non-decreasing along i.

    Returns
    -------
    (k, W, B, c) array
    """
    total = np.empty_like(cost)
    total[0] = cost[0]
    for i in range(1, len(cost)):
        np.add(cost[i], _shifted(so_far(total[i - 1], np.minimum), start[:, i] - start[:, i - 1]), out=total[i])
    return total


def sums_to_go(cost: Array, start: Integers, end: Array | float = 0.0) -> Array:
    """Return the least sum of a path that begins at each point, its own cost left out; shapes as for `sums_so_far`.

    `end` (W, B, c) is what ending at each point of the last row costs besides.
    """
    total = np.zeros_like(cost)
    total[-1] += end
    for i in range(len(cost) - 2, -1, -1):
        running = so_far((cost[i + 1] + total[i + 1])[::-1], np.minimum)[::-1]
        total[i] = _shifted(running, start[:, i] - start[:, i + 1])
    return total


def so_far(values: Array, take: np.ufunc) -> Array:
    """The running `take`, np.minimum or np.maximum, of `values` along their first axis."""
    if values[0].size < _FEW:
        return np.asarray(take.accumulate(values, axis=0))
    found = np.empty_like(values)
    found[0] = values[0]
    for w in range(1, len(values)):
        take(found[w - 1], values[w], out=found[w])
    return found


def _shifted(values: Array, shift: Integers) -> Array:
    """`values` (W, B, c) read at w + shift[b], held constant beyond the ends (a running minimum is constant there)."""
    if not shift.any():
        return values
    width, sets, problems = values.shape
    place = np.clip(np.arange(width)[:, None] + shift, 0, width - 1) * sets + np.arange(sets)
    return np.asarray(np.take(values.reshape(-1, problems), place, axis=0))
