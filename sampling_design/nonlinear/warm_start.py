"""A solved window moved to the next one: the same trajectory, disturbances and multipliers at the same times."""

from __future__ import annotations

import numpy as np

from sampling_design.nonlinear.window_records import ProgramPoint, WindowSolution
from sampling_design.records.arrays import Array, Index, Mask

SAME_NODE = 1e-9  # two nodes closer than this share of the window are one


def open_loop_guess(edges: Array, states: Array, points: Array, sizes: tuple[int, int, int]) -> WindowSolution:
    """Return w = 0, v = 0 and the trajectory through the scaled `states` at the edges; sizes of w, v and y."""
    K, n, degree = edges.size - 1, states.shape[1], points.size
    q, r, p = sizes
    zero = ProgramPoint(np.zeros(n), np.zeros((K + 1, r)), np.zeros((K, q)), np.zeros((K, degree, n)))
    point = zero._replace(z0=states[0], z=_at(edges, states, _collocation_times(edges, points)))
    rows, outputs = np.zeros((K, degree * n)), np.zeros((K + 1, p))
    return WindowSolution(
        edges=edges,
        point=point,
        bound_multipliers=zero,
        row_multipliers=rows,
        output_multipliers=outputs,
        cost=np.nan,
        status="solver failed",
        message="not solved",
        iterations=0,
        seconds=0.0,
    )


def moved(previous: WindowSolution, guess: WindowSolution, points: Array, before: Array) -> WindowSolution:
    """Return `guess` with all that `previous` knows about the times they share, multipliers included.

    Beyond the end of `previous` the guess is kept. `points` are the collocation points of the guess, `before` those of
    `previous`; where they differ, the multipliers of the intervals are left out.
    """
    old, new = previous.edges, guess.edges
    node, same = _same_nodes(old, new)
    piece, inside = _shared_pieces(old, new)
    times = _collocation_times(new, points)
    known = np.concatenate([old[:1], _collocation_times(old, before).ravel()])
    path = np.vstack([previous.point.z0[None], previous.point.z.reshape(-1, previous.point.z0.size)])
    late = times > old[-1]
    alike = points.size == before.size
    point = ProgramPoint(
        _at(known, path, new[:1])[0] if new[0] <= old[-1] else guess.point.z0,
        _rows_where(previous.point.v, node, same),
        _rows_where(previous.point.w, piece, inside),
        np.where(late[:, :, None], guess.point.z, _at(known, path, times)),
    )
    force = previous.bound_multipliers
    bound = ProgramPoint(
        np.zeros_like(force.z0),
        _rows_where(force.v, node, same),
        _rows_where(force.w, piece, inside),
        _rows_where(force.z, piece, inside) if alike else guess.bound_multipliers.z,
    )
    return guess._replace(
        point=point,
        bound_multipliers=bound,
        row_multipliers=_rows_where(previous.row_multipliers, piece, inside) if alike else guess.row_multipliers,
        output_multipliers=_rows_where(previous.output_multipliers, node, same),
    )


def _rows_where(rows: Array, index: Index, chosen: Mask) -> Array:
    """Return rows[index] where chosen, else 0."""
    result = np.zeros((index.size, *rows.shape[1:]))
    result[chosen] = rows[index[chosen]]
    return result


def _shared_pieces(old: Array, new: Array) -> tuple[Index, Mask]:
    """For each new piece the old one that holds its middle, and whether there is one."""
    middle = (new[:-1] + new[1:]) / 2
    return np.searchsorted(old, middle) - 1, (middle > old[0]) & (middle < old[-1])


def _same_nodes(old: Array, new: Array) -> tuple[Index, Mask]:
    """For each new node the nearest old one, and whether it is the same."""
    right = np.clip(np.searchsorted(old, new), 0, old.size - 1)
    left = np.clip(right - 1, 0, old.size - 1)
    nearest = np.where(np.abs(new - old[left]) < np.abs(new - old[right]), left, right)
    length = max(float(new[-1] - new[0]), float(old[-1] - old[0]))
    return nearest, np.abs(old[nearest] - new) <= SAME_NODE * length


def _collocation_times(edges: Array, points: Array) -> Array:
    return edges[:-1, None] + np.diff(edges)[:, None] * points


def _at(times: Array, states: Array, wanted: Array) -> Array:
    """Return the states (len(times), n) at `wanted`, linear in between, constant beyond the ends."""
    return np.stack([np.interp(wanted, times, states[:, i]) for i in range(states.shape[1])], axis=-1)
