"""Sigma over every window for all real sample times within a tolerance d of the planned ones.

A real window [s, s + T] holds every sample that was planned in [s + d, s + T - d], and perhaps no other. With c its
planned row for the state y at some instant, a sample that comes e late, |e| <= d, has the row c e^{Ae}, and

    |c e^{Ae} y| >= |c y| - v_1 - ... - v_N,    v_j = d^j/j! |cA^j y| for j < N,  v_N = d^N/N! e^{d|A|} |cA^N| |y|.

Squared and added up over the window's samples, with (u - v)^2 >= (1 - k) u^2 - (1/k - 1) v^2 for every 0 < k <= 1 and
(v_1 + ... + v_N)^2 <= sum of v_j^2/q_j for q_1 + ... + q_N = 1, that is y'My for one matrix M: whatever the times are,
the window sees no less than the rows L' with LL' = M. They move with the window's start as the rows of samples do.

Each sample has a k and shares q of its own. The least eigenvalue of M is concave in them, and over X with trace 1 it is
dual to the largest <M, X>, where k = v/u and q = v_j/v for the sizes u and v_j in the mean over X. So they are sought
by turns: X on the central path, mu (M - t)^{-1}, of the mean of the M so far, and of X the factors. All of them prove,
and so does a mean.

Where the plant grows much within a window, v_N and the rounding of squares would hide what the window sees least. So y
is taken in other coordinates: with O = Q S V' the singular values of the planned rows and D = min(S/s_n, `_SPREAD`),
they are D^{-1} S V' y, and the rows are Q D there. A sample that shows less of X than its time may change has k = 1: it
is left out, and takes nothing from what others show.
"""

from __future__ import annotations

import numpy as np

from sampling_design.numerics.linalg import right_directions
from sampling_design.observability.windows.pieces import WindowPieces, WindowWitness
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Mask
from sampling_design.schedules.jitter import TimingTolerance

MOST_TRIED = 24
"""Windows in which late and early samples are tried for the attained bound: those that see least without them."""
_TURNS = 6  # how often the least observed state and the times that it sees least are sought in turn
_ORDERS = 8  # N: terms below it count with what the state shows, that of it with the state's size
_LEAST_SHARE = 1e-3  # of q, however small a term is
_FACTORS = (1e-7, 0.9)  # k lies between
_SECTIONS = 14  # of log k: the last ones differ by two per cent
_GOLDEN = (5**0.5 - 1) / 2  # what a section leaves
_SPREAD = 1e2  # rows see the strongest direction at most that many times as well as the weakest
_LEAST_FACTOR = 1e-7  # of k
_TURNS_OF_FACTORS, _MORE_TURNS = 16, 60  # in which k and q are sought; where less than `_ENOUGH` was left of sigma^2
_ENOUGH = 0.7  # where less is left, more turns find up to half as much again
_STEP = 0.3  # share of the last M in the mean
_CENTRAL = (0.3, 0.01)  # n mu in the first and the last turn, of sigma^2 on time
_GROUPS = 24  # of samples of a window, and of each output that comes by itself
_NUMBERS = 4_000_000  # of rows and their derivatives at a time
_MOST_LOST, _MOST_MOVED = 1e100, 1e50  # of rows of size one: beyond them nothing is left of them, or of a sample
_NEWTON = 5  # steps to t: the fourth leaves 1e-9
_GAIN = 1e-9  # relative: by less sigma does not fall in a turn
_EPS = float(np.finfo(float).eps)


def rows_of_any_time(rows: Array, A: Array, tolerance: Array) -> Array:
    """Return rows (m, n, n) that see no more than `rows` (m, k, p, n) at times up to `tolerance` away, or zero.

    It is of each of the p outputs, or one of all, which share the time of each of the k samples then; k p is n or more.
    """
    sizes = 2.0 ** np.frexp(np.abs(rows).max(axis=(1, 2, 3), initial=0.0))[1]  # squares of rows / sizes are numbers
    grouped = _grouped(rows / sizes[:, None, None, None], tolerance.size)
    together = grouped.shape[3]
    d, grouped = np.repeat(tolerance, grouped.shape[2] * together), grouped.reshape(len(rows), -1, rows.shape[3])
    step = max(1, _NUMBERS // (_ORDERS * grouped.shape[1] * grouped.shape[2]))
    parts = [_rows_of_size_one(grouped[low : low + step], A, d, together) for low in range(0, len(rows), step)]
    return np.asarray(np.concatenate(parts) * sizes[:, None, None])


def _grouped(rows: Array, apart: int) -> Array:
    """The rows (m, apart, groups, rows of a group, n): of samples beyond `_GROUPS` several have one k, and n rows."""
    m, count, p, n = rows.shape
    each = -(-count // _GROUPS)
    rows = np.concatenate([rows, np.zeros((m, -count % each, p, n))], axis=1)
    grouped = np.swapaxes(rows.reshape(m, -1, apart, p // apart, n), 1, 2).reshape(m, apart, -1, each * p // apart, n)
    return np.asarray(np.linalg.qr(grouped, mode="r") if each > 1 and grouped.shape[3] > n else grouped)


def _rows_of_size_one(rows: Array, A: Array, d: Array, together: int) -> Array:
    """The same of rows of size one at most."""
    m, _, n = rows.shape
    Q, singular, right = np.linalg.svd(rows, full_matrices=False)
    resolved = singular[:, -1] > n * _EPS * singular[:, 0]
    singular = np.where(resolved[:, None], singular, 1.0)
    kept = np.minimum(singular / singular[:, -1:], _SPREAD)
    into, back = (singular / kept)[:, :, None] * right, np.swapaxes(right, 1, 2) / (singular / kept)[:, None, :]
    terms = [Q * kept[:, None]]
    with np.errstate(over="ignore", invalid="ignore"):
        turned = into @ A @ back
        size = np.linalg.norm(A) * np.linalg.norm(into, axis=(1, 2)) * np.linalg.norm(back, axis=(1, 2))
        off = 8 * n * _EPS * d * size[:, None]  # of A in these coordinates
        off = off * np.exp(d * np.linalg.norm(turned, axis=(1, 2))[:, None] + off) * np.linalg.norm(terms[0], axis=2)
        for order in range(1, _ORDERS + 1):
            terms.append(terms[-1] @ turned * (d[:, None] / order))
        last = np.linalg.norm(terms.pop(), axis=2)
        growth = np.exp(d * np.linalg.norm(turned, 2, axis=(1, 2))[:, None])
        last = np.where(last == 0, 0.0, last * growth) + off  # 0 however much e^{d|A|} is
        samples = np.stack(terms, axis=1).reshape(m, _ORDERS, -1, together, n)
        rest = np.linalg.norm(last.reshape(m, -1, together), axis=2)
        moderate = np.abs(samples).max(axis=(1, 3, 4)) + rest < _MOST_MOVED  # no NaN is
    samples = np.where(moderate[:, None, :, None, None], samples, 0.0)
    rest = np.where(moderate, rest, 0.0)
    X = (1 / kept**2)[:, :, None] * np.eye(n)
    least, M = _best_factors(samples, rest, X, _TURNS_OF_FACTORS)
    poor = np.flatnonzero(resolved & (least < _ENOUGH))
    if poor.size:
        again, other = _best_factors(samples[poor], rest[poor], X[poor], _MORE_TURNS)
        better = again > least[poor]
        M[poor[better]] = other[better]
    return np.asarray(np.where(resolved[:, None, None], _root(M), 0.0) @ into)


def _best_factors(samples: Array, rest: Array, X: Array, turns: int) -> tuple[Array, Array]:
    """Return the largest least eigenvalue of M that was found (m,), and M (m, n, n).

    `samples` (m, N, s, p, n) are the rows of s samples, then those of v_1 to v_{N-1}; `rest` (m, s) times |y| is v_N.
    """
    m, orders, _, p, n = samples.shape
    flat, size = samples.reshape(m, -1, n), np.sum(samples**2, axis=(3, 4))
    rounding = 8 * n * flat.shape[1] / orders * _EPS
    rest = rest + np.sqrt(rounding * size.sum(axis=1))  # of what is squared here
    X = X / np.trace(X, axis1=1, axis2=2)[:, None, None]
    best, found, mean = np.full(m, -np.inf), np.zeros((m, n, n)), np.zeros((m, n, n))
    for turn in range(turns):
        form = np.maximum(np.sum((samples @ X[:, None, None]) * samples, axis=(3, 4)), 0.0)
        v = np.sqrt(np.concatenate([form[:, 1:], rest[:, None] ** 2], axis=1))
        v = np.maximum(v, _LEAST_SHARE * np.maximum(v.sum(axis=1, keepdims=True), np.finfo(float).tiny))
        total = v.sum(axis=1)
        k = np.clip(total / np.maximum(np.sqrt(form[:, 0]), np.finfo(float).tiny), _LEAST_FACTOR, 1.0)
        lost = ((1 / k - 1) * total)[:, None] / v
        weight = np.concatenate([(1 - k)[:, None], -lost[:, :-1]], axis=1)
        M = np.swapaxes(flat, 1, 2) @ (flat * np.repeat(weight.reshape(m, -1), p, axis=1)[..., None])
        less = np.sum(lost[:, -1] * rest**2, axis=1) + rounding * np.sum(np.abs(weight) * size, axis=(1, 2))
        M = (M + np.swapaxes(M, 1, 2)) / 2 - less[:, None, None] * np.eye(n)
        mean = mean + (_STEP if turn else 1.0) * (M - mean)
        values, vectors = np.linalg.eigh(mean)
        for tried, least in ((M, np.linalg.eigvalsh(M)[:, 0]), (mean, values[:, 0])):
            better = least > best
            best, found[better] = np.where(better, least, best), tried[better]
        mu = _CENTRAL[0] * (_CENTRAL[1] / _CENTRAL[0]) ** (turn / (turns - 1)) / n
        X = (vectors * _central(values, mu)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    return best, found


def _central(values: Array, mu: float) -> Array:
    """mu/(values - t) (m, n) with t below all of them so that they add up to one."""
    above, t = values - values[:, :1], np.full((len(values), 1), mu)
    for _ in range(_NEWTON):  # of one over the sum, which grows and is concave: from below, and never beyond
        each = mu / (above + t)
        total = each.sum(axis=1, keepdims=True)
        t = t + mu * total * (total - 1) / np.sum(each**2, axis=1, keepdims=True)
    return np.asarray(mu / (above + t))


def _root(M: Array) -> Array:
    """Rows L' with LL' = M, zero where M is not positive definite."""
    values, vectors = np.linalg.eigh(M)
    root = np.sqrt(np.maximum(values, 0.0))[:, :, None] * np.swapaxes(vectors, 1, 2)
    return np.asarray(np.where((values[:, 0] > 0)[:, None, None], root, 0.0))


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

    def rows_left(log_k: Array) -> Array:
        k = np.exp(log_k)[:, None, None]
        M = (1 - k) * W - (1 / k - 1) * lost - (1 + 1 / k) * rounding[:, None, None] * np.eye(n)
        return np.asarray((M + np.swapaxes(M, 1, 2)) / 2)

    low, high = (np.full(len(rows), np.log(end)) for end in _FACTORS)
    ends = [high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)]
    least = [np.linalg.eigvalsh(rows_left(k))[:, 0] for k in ends]
    for _ in range(_SECTIONS):
        left = least[0] >= least[1]  # the best is not above the second of the two
        low, high = np.where(left, low, ends[0]), np.where(left, ends[1], high)
        kept, known = np.where(left, ends[0], ends[1]), np.where(left, least[0], least[1])
        tried = np.where(left, high - _GOLDEN * (high - low), low + _GOLDEN * (high - low))
        found = np.linalg.eigvalsh(rows_left(tried))[:, 0]
        ends = [np.where(left, tried, kept), np.where(left, kept, tried)]
        least = [np.where(left, found, known), np.where(left, known, found)]
    best = rows_left(np.where(least[0] >= least[1], ends[0], ends[1]))
    return np.asarray(np.where(bounded[:, None, None], _root(best), 0.0))


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


def least_observed(rows: Array, counted: int) -> tuple[Array, float, Array]:
    """Return the state that rows O (k, n) show least of its first `counted` entries, sigma of these, and shares (n,).

    sigma = min |O x| / |x_1, ..., x_counted|; the shares are sigma sqrt((O'O)^-1_ii), infinite without full rank.
    """
    n = rows.shape[1]
    R = rows if len(rows) <= n else np.asarray(np.linalg.qr(rows, mode="r"))
    singular, right = right_directions(R)
    if len(rows) < n or not singular[-1] > 0:
        return (right[-1], 0.0, np.full(n, np.inf))
    F = right.T * (singular[-1] / singular)  # O^+ but for a turn and its size
    if counted == n:
        return (right[-1], float(singular[-1]), np.linalg.norm(F, axis=1))
    _, size, turned = np.linalg.svd(F[:counted], full_matrices=False)
    x = F @ turned[0]
    return (x / np.linalg.norm(x), float(singular[-1] / size[0]), np.linalg.norm(F, axis=1) / size[0])


def moved_window(plant: Plant, pieces: WindowPieces, g: int, start: float, counted: int) -> WindowWitness:
    """Return a window along real times of its samples at which it sees little of the first `counted` states.

    They and a state are sought in turn.
    """
    centres, mask, late, n = pieces.samples(g), pieces.measured(g), pieces.timing_tolerance, plant.n_states
    if late.apart:  # outputs that come nearly on time may be in it where others may be out
        centres, mask = pieces.times, _surely_inside(pieces, g, start)
        inside = mask.any(axis=1)
        centres, mask = centres[inside], mask[inside]
    apart = np.zeros((centres.size, plant.n_outputs if late.apart else 1))
    moves = [apart - late.back, apart, apart + late.forward]  # each (k, 1), or (k, p) where outputs fall apart
    places, times, kept = centres[:, None] + np.array(moves), centres[:, None] + (apart + late.offsets), None
    shown = np.array([_rows(plant, place - start, mask) for place in places])
    rows = _rows(plant, times - start, mask)
    for _ in range(_TURNS):
        x, sigma, _ = least_observed(rows.reshape(-1, n), counted)
        if kept is not None and not sigma < kept.sigma * (1 - _GAIN):
            break
        sampled = times if mask is None or not late.apart else times[mask]
        kept = WindowWitness(start + pieces.window, "at", np.unique(sampled), x, sigma)
        outputs = shown @ x
        outputs /= max(float(np.abs(outputs).max(initial=0.0)), np.finfo(float).tiny)
        size = np.abs(outputs) if late.apart else np.linalg.norm(outputs, axis=2, keepdims=True)
        best = np.argmin(size, axis=0)[None]
        times = np.take_along_axis(places, best, axis=0)[0]
        rows = np.take_along_axis(shown, best[..., None], axis=0)[0]
    assert kept is not None  # the first turn keeps one
    return kept


def starts_tried(pieces: WindowPieces, g: int, start: float) -> list[float]:
    """The start of a window on piece g, and those next to it at which it is sure of no output of an earlier sample, or
    of a later one: outputs that come nearly on time may be in it where others may be out."""
    late = pieces.timing_tolerance
    if not late.apart:
        return [start]
    earlier, later = (
        pieces.times[: pieces.first[g]] - late.back.min(),
        pieces.times[pieces.stop[g] :] + late.forward.min(),
    )
    low = np.clip(np.max(earlier, initial=-np.inf), start, pieces.right[g])
    high = np.clip(np.min(later, initial=np.inf) - pieces.window, pieces.left[g], start)
    return [float(each) for each in np.unique([start, low, high])]


def _surely_inside(pieces: WindowPieces, g: int, start: float) -> Mask:
    """(K, p): which outputs of which samples are read in the window that starts there, whenever they are read.

    All of those on its piece, also where that is a point and only the half-open window holds them.
    """
    late, tiny = pieces.timing_tolerance, pieces.tolerance
    first, last = pieces.times[:, None] - late.back, pieces.times[:, None] + late.forward
    inside = (first > start + tiny) & (last < start + pieces.window - tiny)
    inside[pieces.first[g] : pieces.stop[g]] = True
    return inside if pieces.mask is None else inside & pieces.mask


def _rows(plant: Plant, lags: Array, mask: Mask | None) -> Array:
    """(k, p, n): C e^{A lag}, of lags (k, 1) or one for each output (k, p); zero where an output is not measured."""
    flow = plant.transition(np.ravel(lags)).reshape(*lags.shape, plant.n_states, plant.n_states)
    rows = np.einsum("pi,kpij->kpj", plant.C, np.broadcast_to(flow, (len(lags), plant.n_outputs, *flow.shape[2:])))
    return np.asarray(rows if mask is None else rows * mask[..., None])
