"""Sigma over every window for all real sample times within a tolerance d of the planned ones.

A real window [s, s + T] holds every sample that was planned in [s + d, s + T - d], and perhaps no other. With c its
planned row for the state y at some instant, a sample that comes e late, |e| <= d, has the row c e^{Ae}, and

    |c e^{Ae} y| >= |c y| - v_1 - ... - v_N,    v_j = d^j/j! |cA^j y| for j < N,  v_N = d^N/N! e^{d|A|} |cA^N| |y|.

Squared and added up over the window's samples, with (u - v)^2 >= (1 - k) u^2 - (1/k - 1) v^2 for every 0 < k < 1 and
(v_1 + ... + v_N)^2 <= sum of v_j^2/q_j for q_1 + ... + q_N = 1, that is y'My for one matrix M: whatever the times are,
the window sees no less than the rows L' with LL' = M. They move with the window's start as the rows of samples do.
The least eigenvalue of M is concave in k, which is sought by sections.

Where the plant grows much within a window, v_N and the rounding of squares would hide what the window sees least. So y
is taken in other coordinates: with O = Q S V' the singular values of the planned rows and D = min(S/s_n, `_SPREAD`),
they are D^{-1} S V' y, and the rows are Q D there. And rows that are shortened see less: those far longer than sigma
lose more to v_j than they hold of what is seen least. They are tried at most `_LENGTHS` times as long as sigma, where
that proves more.
"""

from __future__ import annotations

import numpy as np

from sampling_design.observability.windows.pieces import Pieces, WindowWitness
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Mask
from sampling_design.schedules.jitter import TimingTolerance

MOST_TRIED = 24
"""Windows in which late and early samples are tried for the attained bound: those that see least without them."""
_TURNS = 6  # how often the least seen state and the times that it sees least are sought in turn
_ORDERS = 8  # N: terms below it count with what the state shows, that of it with the state's size
_LEAST_SHARE = 1e-3  # of q, however small a term is
_FACTORS = (1e-7, 0.9)  # k lies between
_SECTIONS = 14  # of log k: the last ones differ by two per cent
_GOLDEN = (5**0.5 - 1) / 2  # what a section leaves
_SPREAD = 1e3  # rows see the strongest direction at most that many times as well as the weakest
_INEXACT = 1e-6  # share of what is lost that is left to the rounding of A in these coordinates
_LENGTHS = (1e4, 1e3, 1e2)  # of sigma
_ENOUGH = 0.95  # of sigma on time: where more is left, no row is shortened
_MOST_LOST = 1e100  # of rows of size one: beyond it nothing is left of them
_GAIN = 1e-9  # relative: by less sigma does not fall in a turn
_EPS = float(np.finfo(float).eps)


def rows_of_any_time(rows: Array, A: Array, tolerance: Array) -> Array:
    """Return rows (m, n, n) that see no more than `rows` (m, k, n) at times up to `tolerance` (k,) away, or zero."""
    sizes = 2.0 ** np.frexp(np.abs(rows).max(axis=(1, 2), initial=0.0))[1]  # squares of rows / sizes are numbers
    rows = rows / sizes[:, None, None]
    held, sigma, lengths = _rows_as_they_are(rows, A, tolerance), _least(rows), np.linalg.norm(rows, axis=2)
    kept = _least(held)
    for most in _LENGTHS:
        poor = np.flatnonzero((kept < _ENOUGH * sigma) & (lengths.max(axis=1, initial=0.0) > most * sigma))
        if poor.size:
            shorter = np.minimum(1.0, most * sigma[poor, None] / np.maximum(lengths[poor], np.finfo(float).tiny))
            tried = _rows_as_they_are(rows[poor] * shorter[..., None], A, tolerance)
            found = _least(tried)
            better = found > kept[poor]
            held[poor[better]], kept[poor[better]] = tried[better], found[better]
    return np.asarray(held * sizes[:, None, None])


def _least(rows: Array) -> Array:
    return np.asarray(np.linalg.svd(rows, compute_uv=False)[:, -1])


def _rows_as_they_are(rows: Array, A: Array, tolerance: Array) -> Array:
    """The same of rows of size one at most, as they are."""
    n, d = rows.shape[2], float(tolerance.max(initial=0.0))
    if np.all(tolerance == d):  # only their squares count
        rows, tolerance = np.asarray(np.linalg.qr(rows, mode="r")), np.full(n, d)
    Q, seen, right = np.linalg.svd(rows, full_matrices=False)
    shown = seen[:, -1] > n * _EPS * seen[:, 0]
    seen = np.where(shown[:, None], seen, 1.0)
    kept = np.minimum(seen / seen[:, -1:], _SPREAD)
    into, back = (seen / kept)[:, :, None] * right, np.swapaxes(right, 1, 2) / (seen / kept)[:, None, :]
    with np.errstate(over="ignore", invalid="ignore"):
        turned = into @ A @ back
        size = np.linalg.norm(A) * np.linalg.norm(into, axis=(1, 2)) * np.linalg.norm(back, axis=(1, 2))
        off = 8 * n * _EPS * d * size
        off = off * np.exp(d * np.linalg.norm(turned, axis=(1, 2)) + off) * np.linalg.norm(kept, axis=1)
        lost = lost_to_time(Q * kept[:, None], turned, tolerance[:, None]) / (1 - _INEXACT)
        lost = lost + (off**2 / _INEXACT)[:, None, None] * np.eye(n)
        lost[~shown] = np.inf
    return np.asarray(rows_without(Q * kept[:, None], lost) @ into)


def rows_without(rows: Array, lost: Array) -> Array:
    """Return rows (m, n, n) that see no more than `rows` (m, k, n) changed by any E with E'E <= `lost`, or zero.

    Squares of their entries are numbers.
    """
    n, count = rows.shape[2], max(rows.shape[1:])
    W = np.swapaxes(rows, 1, 2) @ rows
    with np.errstate(over="ignore", invalid="ignore"):
        bounded = np.isfinite(lost).all(axis=(1, 2)) & (np.abs(lost).max(axis=(1, 2), initial=0.0) < _MOST_LOST)
    lost = np.where(bounded[:, None, None], lost, 0.0)
    rounding = 8 * n * count * _EPS * (np.trace(W, axis1=1, axis2=2) + np.trace(lost, axis1=1, axis2=2))

    def kept_by(log_k: Array) -> Array:
        k = np.exp(log_k)[:, None, None]
        M = (1 - k) * W - (1 / k - 1) * lost - (1 + 1 / k) * rounding[:, None, None] * np.eye(n)
        return np.asarray((M + np.swapaxes(M, 1, 2)) / 2)

    low, high = (np.full(len(rows), np.log(end)) for end in _FACTORS)
    ends = [high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)]
    least = [np.linalg.eigvalsh(kept_by(k))[:, 0] for k in ends]
    for _ in range(_SECTIONS):
        left = least[0] >= least[1]  # the best is not above the second of the two
        low, high = np.where(left, low, ends[0]), np.where(left, ends[1], high)
        kept, known = np.where(left, ends[0], ends[1]), np.where(left, least[0], least[1])
        tried = np.where(left, high - _GOLDEN * (high - low), low + _GOLDEN * (high - low))
        found = np.linalg.eigvalsh(kept_by(tried))[:, 0]
        ends = [np.where(left, tried, kept), np.where(left, kept, tried)]
        least = [np.where(left, found, known), np.where(left, known, found)]
    values, vectors = np.linalg.eigh(kept_by(np.where(least[0] >= least[1], ends[0], ends[1])))
    root = np.sqrt(np.maximum(values, 0.0))[:, :, None] * np.swapaxes(vectors, 1, 2)
    held = (values[:, 0] > 0) & bounded
    return np.asarray(np.where(held[:, None, None], root, 0.0))


def lost_to_time(rows: Array, A: Array, d: float | Array) -> Array:
    """(m, n, n): sum of v_j^2/q_j as quadratic forms of the state, each q_j in proportion to its term.

    Of rows (m, k, n), one A or one for each of m.
    """
    n, terms, each = A.shape[-1], list[Array](), rows
    size = np.linalg.norm(A, 2, axis=(-2, -1))[..., None, None]
    for order in range(1, _ORDERS + 1):
        each = each @ A * (d / order)
        if order == _ORDERS:
            grown = np.where(each == 0, 0.0, each * np.exp(d * size))  # 0 however much e^{d|A|} is
            terms.append(np.sum(grown**2, axis=(1, 2))[:, None, None] * np.eye(n))
        else:
            terms.append(np.swapaxes(each, 1, 2) @ each)
    sizes = np.sqrt([np.trace(term, axis1=1, axis2=2) for term in terms])
    sizes = np.maximum(sizes, _LEAST_SHARE * np.maximum(sizes.sum(axis=0), np.finfo(float).tiny))
    shares = sizes / sizes.sum(axis=0)
    return np.asarray(sum(term / q[:, None, None] for term, q in zip(terms, shares, strict=True)))


def middle_rows(plant: Plant, late: TimingTolerance) -> Plant:
    """The plant whose outputs show at the centre of a sample what each shows at the middle of its own real times."""
    if not late.apart:
        return plant
    return Plant(plant.A, np.einsum("pi,pij->pj", plant.C, plant.transition(late.offsets)))


def moved_window(plant: Plant, pieces: Pieces, g: int, start: float) -> WindowWitness:
    """Return a window along real times of its samples at which it sees little: they and a state are sought in turn."""
    centres, mask, late, n = pieces.samples(g), pieces.measured(g), pieces.timing_tolerance, plant.n_states
    if late.apart:  # outputs that come nearly on time may be in it where others may be out
        centres, mask = pieces.times, _surely_held(pieces, g, start)
        inside = mask.any(axis=1)
        centres, mask = centres[inside], mask[inside]
    apart = np.zeros((centres.size, plant.n_outputs if late.apart else 1))
    places = [apart - late.back, apart, apart + late.forward]  # each (k, 1), or (k, p) where outputs fall apart
    moves, kept = apart + late.offsets, None
    for _ in range(_TURNS):
        times = centres[:, None] + moves
        rows = _rows(plant, times - start, mask).reshape(-1, n)
        full = np.vstack([rows, np.zeros((max(0, n - len(rows)), n))])
        _, singular, right = np.linalg.svd(full)
        if kept is not None and not singular[-1] < kept.sigma * (1 - _GAIN):
            break
        held = times if mask is None or not late.apart else times[mask]
        kept = WindowWitness(start + pieces.window, "at", np.unique(held), right[-1], float(singular[-1]))
        seen = np.array([_rows(plant, centres[:, None] + e - start, mask) @ right[-1] for e in places])
        seen /= max(float(np.abs(seen).max(initial=0.0)), np.finfo(float).tiny)
        size = np.abs(seen) if late.apart else np.linalg.norm(seen, axis=2, keepdims=True)
        best = np.argmin(size, axis=0)
        moves = np.choose(best, places)
    assert kept is not None  # the first turn keeps one
    return kept


def _surely_held(pieces: Pieces, g: int, start: float) -> Mask:
    """(K, p): which outputs of which samples are read in the window that starts there, whenever they are read.

    All of those on its piece, also where that is a point and only the half-open window holds them.
    """
    late, tiny = pieces.timing_tolerance, pieces.tolerance
    first, last = pieces.times[:, None] - late.back, pieces.times[:, None] + late.forward
    held = (first > start + tiny) & (last < start + pieces.window - tiny)
    held[pieces.first[g] : pieces.stop[g]] = True
    return held if pieces.mask is None else held & pieces.mask


def _rows(plant: Plant, lags: Array, mask: Mask | None) -> Array:
    """(k, p, n): C e^{A lag}, of lags (k, 1) or one for each output (k, p); zero where an output is not measured."""
    flow = plant.transition(np.ravel(lags)).reshape(*lags.shape, plant.n_states, plant.n_states)
    rows = np.einsum("pi,kpij->kpj", plant.C, np.broadcast_to(flow, (len(lags), plant.n_outputs, *flow.shape[2:])))
    return np.asarray(rows if mask is None else rows * mask[..., None])
