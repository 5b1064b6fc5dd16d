"""Sigma over every window for all real sample times within a tolerance d of the planned ones.

A real window [s, s + T] holds every sample that was planned in [s + d, s + T - d], and perhaps no other. With c its
planned row for the state y at some instant, a sample that comes e late, |e| <= d, has the row c e^{Ae}, and

    |c e^{Ae} y| >= |c y| - (d |cAy| + d^2/2 |cA^2 y| + d^3/6 e^{d|A|} |cA^3| |y|).

Squared and added up over the window's samples, with (u - v)^2 >= (1 - k) u^2 - (1/k - 1) v^2 for every 0 < k < 1 and
(v_1 + v_2 + v_3)^2 <= sum of v_i^2/q_i for q_1 + q_2 + q_3 = 1, that is y'My for one matrix M: whatever the times are,
the window sees no less than the rows L' with LL' = M. They move with the window's start as the rows of samples do.
"""

from __future__ import annotations

import numpy as np

from sampling_design.observability.windows.pieces import Pieces, WindowWitness
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Mask

MOST_TRIED = 24
"""Windows in which late and early samples are tried for the attained bound: those that see least without them."""
_TURNS = 6  # how often the least seen state and the times that it sees least are sought in turn
_SHARES = (0.9, 0.08, 0.02)  # q of the terms of first to third order: what is small gets little
_FACTORS = np.geomspace(1e-7, 0.9, 60)  # k: the best one is taken
_GAIN = 1e-9  # relative: by less sigma does not fall in a turn
_EPS = float(np.finfo(float).eps)


def rows_of_any_time(rows: Array, A: Array, tolerance: float) -> Array:
    """Return (m, n, n) rows that see no more than `rows` (m, n, n) at times up to `tolerance` away; zero if nothing."""
    n, (first, second, third) = len(A), _SHARES
    W = np.swapaxes(rows, 1, 2) @ rows
    one, two, three = rows @ A, rows @ A @ A, rows @ A @ A @ A
    terms = [np.swapaxes(term, 1, 2) @ term for term in (one, two)]
    last = np.sum(three**2, axis=(1, 2)) * (tolerance**3 / 6) ** 2 * np.exp(2 * tolerance * np.linalg.norm(A, 2))
    lost = tolerance**2 / first * terms[0] + tolerance**4 / 4 / second * terms[1]
    lost = lost + (last / third)[:, None, None] * np.eye(n)
    rounding = 8 * n * n * _EPS * (np.trace(W, axis1=1, axis2=2) + np.trace(lost, axis1=1, axis2=2))
    result, best = np.zeros_like(rows), np.zeros(len(rows))
    for k in _FACTORS:
        M = (1 - k) * W - (1 / k - 1) * lost - ((1 + 1 / k) * rounding)[:, None, None] * np.eye(n)
        values, vectors = np.linalg.eigh((M + np.swapaxes(M, 1, 2)) / 2)
        better = values[:, 0] > best
        best = np.where(better, values[:, 0], best)
        root = np.sqrt(np.maximum(values, 0.0))[:, :, None] * np.swapaxes(vectors, 1, 2)
        result = np.where(better[:, None, None], root, result)
    return result


def moved_window(plant: Plant, pieces: Pieces, g: int, start: float) -> WindowWitness:
    """Return a window along real times of its samples at which it sees little: they and a state are sought in turn."""
    planned, mask = pieces.samples(g), pieces.measured(g)
    places = np.array([-1.0, 0.0, 1.0]) * pieces.timing_tolerance
    times, kept = planned, None
    for _ in range(_TURNS):
        rows = _rows(plant, times - start, mask)
        full = np.vstack([rows, np.zeros((max(0, plant.n_states - len(rows)), plant.n_states))])
        _, singular, right = np.linalg.svd(full)
        if kept is not None and not singular[-1] < kept.sigma * (1 - _GAIN):
            break
        kept = WindowWitness(start + pieces.window, "at", times, right[-1], float(singular[-1]))
        shown = [_rows(plant, planned + e - start, mask) @ right[-1] for e in places]
        sizes = np.linalg.norm(np.reshape(shown, (places.size, planned.size, plant.n_outputs)), axis=2)
        times = planned + places[np.argmin(sizes, axis=0)]
    assert kept is not None  # the first turn keeps one
    return kept


def _rows(plant: Plant, lags: Array, mask: Mask | None) -> Array:
    """C e^{A lag}, zero where an output is not measured."""
    rows = plant.C @ plant.transition(lags)
    return np.reshape(rows if mask is None else rows * mask[..., None], (-1, plant.n_states))
