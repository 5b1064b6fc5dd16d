"""Bound of the schedules in a small box, exact to second order, by windows that follow their samples.

The windows that matter begin or end at a sample s_j and move with it, and so do the states at which they are judged:
with x the state at the instant of another sample s_a (the last one in the window, where the plant grows), every
schedule has, for any psd V,

    sigma^2 <= Q/K,   Q = sum over its samples of <V, G(s_i - s_a)>,   K = <V, e^{A'(s_j - s_a)} e^{A(s_j - s_a)}>

and so for any geometric mean of several windows: log sigma^2 <= sum of mu_m (log Q_m - log K_m), sum of mu_m = 1.
Growth at the rate r of the fastest mode is a linear function of the times there, exactly: what is left is expanded
about the middle of the box, with log Q <= log Q_0 + (Q/Q_0 - 1): a constant, a slope that the multipliers of the
linearised program (and of the spacing) balance, a Hessian, and a remainder of third order that is bounded. In a wide
box of a plant that grows, the rest is bounded by its extremes instead: what remains is the growth, which is linear.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from sampling_design.design.bounds.derivatives import largest_derivatives
from sampling_design.design.bounds.tied_windows import SAME, MeasurementTerms, growth_rate, terms_of, tied_windows
from sampling_design.design.bounds.weak_duality import rooted
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.gram import EPS, ROUNDING_MARGIN
from sampling_design.numerics import conic_programs
from sampling_design.numerics.linalg import expm_batch, right_directions
from sampling_design.records.arrays import Array, Index, Mask

_TOLERANCE = 1e-6  # asked of the solver; the bound is true whatever it answers
_LEAST_SHARE = 1e-14  # of a nominal Gram matrix: directions that are seen less are scaled as if it were that much
_MOST_WINDOWS, _SUBSPACE = 24, 6  # in the linearised program: the least seen windows, and directions of each
_LEAST_SEEN = 0.02  # of K in W + K: a window that sees fifty times as much in the middle does not matter
_LEAST_RATIO = 1e-12  # of the sigma^2 aimed at: what a window sees in the middle at least
_AGAINST = 2  # rounds in which samples are moved against what a window sees least
_NOTHING = 1e-200  # of what windows see: a sigma^2 aimed at that is less is 0
_WIDER = 0.05  # of the largest entry: how much the width of a zone speaks for a cut beside its share of the Hessian
_PLACES = 9  # of a lag's range at which a form is looked at for its extremes
_NORMS_SAY_LITTLE = 30.0  # times what is seen: where the norms of states are more, they say little
_MOST_CHANGE = 0.5  # of a window's own state, relative: more, and its logarithm is not bounded


def relax_local(
    problem: DesignProblem, zones: Array, sigma: float, seconds: float | None = None
) -> tuple[Index, Array, Array, int] | None:
    """Multipliers of the program linearised about the middle of the box, for a sigma near which the bound shall be.

    Windows that matter, roots of their multipliers in the scaled basis, those of the spacing, and where to cut. None
    where no window of it sees as little as that, the aim is 0, or the solver finds nothing.
    """
    sigma2, half = sigma**2, (zones[:, 1] - zones[:, 0]) / 2
    every = tied_windows(problem, zones)
    terms = terms_of(problem, zones, every)
    observed = _observed_rows(problem, terms, _against(problem, terms, len(every), sigma2))
    grams, slopes, own, own_slopes = _linear(problem, terms, len(every), observed)
    if not sigma2 > _NOTHING * float(np.abs(grams).max()):
        return None  # what is aimed at is nothing beside what is seen: there is no scale to be linear in
    _, least_eigenvalues_of = _balanced(grams / sigma2, own)
    order = np.argsort(-least_eigenvalues_of, kind="stable")[:_MOST_WINDOWS]
    posed = np.sort(order[least_eigenvalues_of[order] >= _LEAST_SEEN])
    moved = np.flatnonzero(half > 0)
    if not posed.size:
        return None
    each = np.maximum(1 / least_eigenvalues_of[posed] - 1, _LEAST_RATIO)  # sigma^2 in the middle, of what is aimed at
    grams, slopes = grams[posed] / (sigma2 * each[:, None, None]), slopes[posed] / (sigma2 * each[:, None, None, None])
    own, own_slopes = own[posed], own_slopes[posed]
    T, _ = _balanced(grams, own)
    left = np.swapaxes(T, 1, 2)
    W = left @ (grams + (np.log(each)[:, None, None] - 1) * own) @ T
    K = left @ own @ T
    D = left[:, None] @ (slopes - own_slopes)[:, moved] @ T[:, None] * half[moved, None, None]
    order_rows, room = _spacing(problem, zones)
    rows = np.vstack([np.eye(moved.size), -np.eye(moved.size), order_rows[:, moved] * half[moved]])
    limits = np.concatenate([np.ones(2 * moved.size), np.maximum(room, 0.0)])
    blocks: list[tuple[str, Array, Array]] = [("nonnegative", np.hstack([rows, np.zeros((len(rows), 1))]), limits)]
    for m in range(posed.size):
        blocks.append(
            (
                "psd",
                np.hstack([-conic_programs.svec(D[m]).T, conic_programs.svec(K[m])[:, None]]),
                conic_programs.svec(W[m]),
            )
        )
    cost = np.append(np.zeros(moved.size), -1.0)
    found = conic_programs.solve_cone_program(cost, blocks, tolerance=_TOLERANCE, iterations=60, budget=seconds)
    values, vectors = np.linalg.eigh(np.nan_to_num(np.array(found.z[1:])))
    roots = T @ (vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])
    nu = np.maximum(np.nan_to_num(found.z[0][2 * moved.size :]), 0.0)
    if not float(np.linalg.norm(roots)) > 0:
        return None
    windows = every[posed]
    if growth_rate(problem) > 0:
        unobserved = [_without_last_sample(problem, roots, move) for move in problem.moves]
        tried = [roots, *(each for each in unobserved if each is not None)]
        roots = min(tried, key=lambda each: local_bound(problem, zones, windows, each, nu))
    expanded = _expansion(problem, zones, windows, roots)
    H = np.zeros((len(half), len(half))) if expanded is None else expanded[2] * half[:, None] * half
    index = int(np.argmax(np.abs(H).sum(axis=1) + _WIDER * max(float(np.abs(H).max()), 1e-9) * half / half.max()))
    return windows, roots, nu, index


def _without_last_sample(problem: DesignProblem, roots: Array, move: Array) -> Array | None:
    """The same multipliers less what the last sample of their window sees, moved; None where nothing is left."""
    C = problem.rows.C @ move
    unobserved = right_directions(C)[1][len(C) :]
    left = unobserved.T @ (unobserved @ roots)
    return left if float(np.linalg.norm(left, axis=(1, 2)).min(initial=0.0)) > 0 else None


def _against(problem: DesignProblem, terms: MeasurementTerms, count: int, sigma2: float) -> Index:
    """Which move of each term leaves its window with the least that is seen: all alike, or each against a state."""
    found = []
    for each in range(len(problem.moves)):
        moved = np.full(terms.lag.shape, each)
        for _ in range(_AGAINST if len(problem.moves) > 1 else 0):
            grams, _, own, _ = _linear(problem, terms, count, _observed_rows(problem, terms, moved))
            T, least = _balanced(grams / max(sigma2, _NOTHING), own)
            found.append((least, moved))
            moved = _least_observed(problem, terms, T[..., -1:])
    if not found:
        return np.zeros(terms.lag.shape, dtype=np.intp)
    best = np.argmax([least for least, _ in found], axis=0)
    return np.asarray(np.array([moved for _, moved in found])[best[terms.window], np.arange(terms.lag.size)])


def _least_observed(problem: DesignProblem, terms: MeasurementTerms, roots: Array) -> Index:
    """Which move of each term shows least of the roots F_m of its window's multiplier, at the middle of the box."""
    if len(problem.moves) == 1:
        return np.zeros(terms.lag.shape, dtype=np.intp)
    F = expm_batch(problem.rows.A, terms.lag) @ roots[terms.window]
    observed = (problem.rows.C @ problem.moves)[:, None] * terms.weights[:, : len(problem.rows.C), None]
    return np.asarray(np.argmin(np.sum((observed @ F) ** 2, axis=(2, 3)), axis=0))


def _linear(
    problem: DesignProblem, terms: MeasurementTerms, count: int, observed: Array
) -> tuple[Array, Array, Array, Array]:
    """Gram matrices of the windows and of their own states, and their slopes by each sample's time."""
    A, n, k = problem.rows.A, problem.plant.n_states, problem.samples
    E = expm_batch(A, terms.lag)
    grams, own = np.zeros((count, n, n)), np.zeros((count, n, n))
    slopes, own_slopes = np.zeros((count, k, n, n)), np.zeros((count, k, n, n))
    for total, change, used in ((grams, slopes, ~terms.own), (own, own_slopes, terms.own)):
        y, dy = observed[used] @ E[used], observed[used] @ A @ E[used]
        gram = np.swapaxes(y, 1, 2) @ y
        part = np.swapaxes(y, 1, 2) @ dy
        part = part + np.swapaxes(part, 1, 2)
        m, i, a = terms.window[used], terms.first[used], terms.second[used]
        np.add.at(total, m, gram)
        np.add.at(change, (m, i), part)
        np.add.at(change, (m, a), -part)
    return grams, slopes, own, own_slopes


def _balanced(grams: Array, own: Array) -> tuple[Array, Array]:
    """Congruences in which W + K is the identity, and the largest eigenvalue of K then: 1/2 where W is K somewhere."""
    values, vectors = np.linalg.eigh(grams + own)
    floor = _LEAST_SHARE * np.maximum(values[:, -1:], np.finfo(float).tiny)
    scale = vectors / np.sqrt(np.maximum(values, floor))[:, None, :]
    inner = np.swapaxes(scale, 1, 2) @ own @ scale
    shares, turned = np.linalg.eigh(inner)
    kept = min(shares.shape[1], _SUBSPACE)
    return scale @ turned[..., -kept:], shares[:, -1]


LogExpansion: TypeAlias = tuple[float, Array, Array, float]
"""(constant, slope, H, remainder): log sigma^2 <= constant + slope'd + d'Hd/2 + remainder for moves d of the box."""


def _rounding(A: Array, C: Array, E: Array, roots: Array, value: Array, lag: Array) -> Array:
    """What |C E F|^2 = `value` may be wrong by, E = e^{At}: to first order in eps, with a margin."""
    summed = np.linalg.norm(np.abs(C) @ np.abs(E) @ np.abs(roots), axis=(-2, -1))
    lost = ROUNDING_MARGIN * len(A) * EPS * (1 + float(np.linalg.norm(A, 1)) * np.abs(lag)) * summed
    return np.asarray((2 * np.sqrt(value) + lost) * lost)


def _forms(problem: DesignProblem, terms: MeasurementTerms, roots: Array) -> tuple[Array, Array, Array, Array, Array]:
    """<V, G> per term without growth: value, two derivatives, bounds of derivatives 0 to 3 over the box, rounding.

    A window's own state is worth its value at least, what is measured at most: rounding is on the safe side, as is the
    last, what it may take from the derivatives.
    """
    rows, n = problem.rows, problem.plant.n_states
    A = rows.A - growth_rate(problem) * np.eye(n)
    E = expm_batch(A, terms.lag)
    F = E @ roots[terms.window]
    AF = A @ F
    AAF = A @ AF
    Y = F @ np.swapaxes(F, 1, 2)
    first = A @ Y + Y @ A.T
    second = A @ first + first @ A.T
    third = A @ second + second @ A.T
    with np.errstate(over="ignore"):
        spread = np.exp(2 * float(np.linalg.norm(A, 2)) * terms.reach)
    C = _observed_rows(problem, terms, _least_observed(problem, terms, roots))
    y, dy, ddy = C @ F, C @ AF, C @ AAF
    value = np.einsum("spr,spr->s", y, y)
    rounded = _rounding(A, C, E, roots[terms.window], value, terms.lag)
    value = np.maximum(np.where(terms.own, value - rounded, value + rounded), 0.0)
    change = 2 * np.einsum("spr,spr->s", y, dy)
    bend = 2 * np.einsum("spr,spr->s", dy, dy) + 2 * np.einsum("spr,spr->s", y, ddy)
    size = np.einsum("spn,spn->s", C, C) * spread
    most = size * np.stack([np.linalg.norm(M, axis=(1, 2)) for M in (Y, first, second, third)])
    if np.sum(most[0]) > _NORMS_SAY_LITTLE * np.sum(value):
        most = np.minimum(most, largest_derivatives(A, C, F, terms.reach))
    most[0] = np.minimum(most[0], value + most[1] * terms.reach)
    most = np.where((terms.reach > 0) | (np.arange(4)[:, None] == 0), most, 0.0)
    turned = float(np.linalg.norm(A, 2)) * terms.reach
    return value, change, bend, most, 2 * rounded * turned * (1 + turned)


def _observed_rows(problem: DesignProblem, terms: MeasurementTerms, moved: Index) -> Array:
    """What each term shows of a state, as rows of one number: outputs, or the whole state of a window's own term.

    Outputs are those of the sample `moved` by one of the problem's moves: of early or late samples any will do.
    """
    height, (S, C) = terms.weights.shape[1], (problem.rows.S, problem.rows.C)
    own, least_eigenvalues_of = (np.vstack([rows, np.zeros((height - len(rows), rows.shape[1]))]) for rows in (S, C))
    least_eigenvalues_of = (least_eigenvalues_of @ problem.moves)[moved]
    return np.asarray(np.where(terms.own[:, None, None], own, least_eigenvalues_of) * terms.weights[..., None])


def _expansion(problem: DesignProblem, zones: Array, windows: Index, roots: Array) -> LogExpansion | None:
    """The geometric mean of all windows about the middle of the box, for V_m = F_m F_m' in the scaled basis.

    Windows weigh as much as their own state does in the middle. None where too little is known of the logarithms.
    """
    k, M, rate = problem.samples, len(windows), growth_rate(problem)
    half = (zones[:, 1] - zones[:, 0]) / 2
    terms = terms_of(problem, zones, windows)
    value, change, bend, most, rounded = _forms(problem, terms, roots)
    states = terms.states(M)
    K, K_lag = value[states], terms.lag[states]
    with np.errstate(divide="ignore"):
        size = np.where(terms.own, -np.inf, np.log(value) + 2 * rate * terms.lag)
    leading = np.array([_largest(size, terms.window == m) for m in range(M)])
    lead, lead_lag = terms.first[leading], terms.lag[leading]
    other = (terms.first != lead[terms.window]) & ~terms.own
    apart = 2 * rate * (half[terms.first] + half[lead[terms.window]]) * other
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        factor = np.where(terms.own, 0.0, np.exp(2 * rate * (terms.lag - lead_lag[terms.window])))
        Q = np.bincount(terms.window, factor * value, M)
        # a window's own state weighs with its growth, relative to the others
        weight = K * np.exp(2 * rate * (K_lag - K_lag.max()))
        mu = weight / weight.sum()
        used = mu > 0
        share = np.where(terms.own, -mu[terms.window] / K[terms.window], mu[terms.window] / Q[terms.window] * factor)
        share = np.where(used[terms.window], share, 0.0)
        powers = np.stack([most[p] * terms.reach**p * apart ** (3 - p) for p in range(4)])
        rest = np.array([1.0, 3.0, 3.0, 1.0]) @ powers * np.exp(apart) / 6 + rounded
        changed = np.abs(change) * terms.reach + np.abs(bend) * terms.reach**2 / 2 + rest
        Y = (changed / value)[states]
        constant = mu[used] @ (np.log(Q) - np.log(K) + 2 * rate * (lead_lag - K_lag))[used]
        remainder = float(np.sum(np.abs(share) * np.where(terms.own & (terms.reach == 0), 0.0, rest)))
    if not (np.all(np.isfinite(mu)) and np.isfinite(constant) and np.isfinite(remainder)) or np.any(
        Y[used] > _MOST_CHANGE
    ):
        return None
    remainder += float(mu[used] @ (Y[used] ** 2 / (2 * (1 - Y[used]))))
    slope, hessian = np.zeros(k), np.zeros((k, k))
    np.add.at(slope, lead, 2 * rate * mu)
    np.add.at(slope, windows[:, 0], -2 * rate * mu)
    i, a, b = terms.first, terms.second, lead[terms.window]
    lagged = np.eye(k)[i] - np.eye(k)[a]
    grown = 2 * rate * (np.eye(k)[i] - np.eye(k)[b]) * ~terms.own[:, None]
    slope += (share * change) @ lagged + (share * value) @ grown
    hessian += np.einsum("s,si,sj->ij", share * bend, lagged, lagged)
    crossed = np.einsum("s,si,sj->ij", share * change, lagged, grown)
    hessian += crossed + crossed.T + np.einsum("s,si,sj->ij", share * value, grown, grown)
    return float(constant), slope, hessian, remainder


def _extremes(problem: DesignProblem, terms: MeasurementTerms, roots: Array) -> tuple[Array, Array]:
    """Bounds below and above of the forms without growth, over the ranges of the lags: values and second order."""
    rows, n = problem.rows, problem.plant.n_states
    A = rows.A - growth_rate(problem) * np.eye(n)
    at = terms.low + np.linspace(0.0, 1.0, _PLACES)[:, None] * (terms.high - terms.low)
    E = expm_batch(A, at.ravel()).reshape(*at.shape, n, n)
    F = E @ roots[terms.window]
    C = _observed_rows(problem, terms, _least_observed(problem, terms, roots))
    AF = A @ F
    y, dy, ddy = C @ F, C @ AF, C @ A @ AF
    value = np.sum(y**2, axis=(2, 3))
    bend = 2 * np.sum(dy**2 + y * ddy, axis=(2, 3))
    width = (terms.high - terms.low) / (_PLACES - 1)
    Y = F @ np.swapaxes(F, 2, 3)
    for _ in range(3):
        Y = A @ Y + Y @ A.T
    with np.errstate(over="ignore"):
        spread = np.exp(2 * float(np.linalg.norm(A, 2)) * width)
    third = np.einsum("spn,spn->s", C, C) * np.max(np.linalg.norm(Y, axis=(2, 3)), axis=0) * spread * width
    third = np.where(width > 0, third, 0.0)
    rest, rounded = width**2 / 8, _rounding(A, C, E, roots[terms.window], value, at)
    low = (value - rounded).min(axis=0) - rest * (np.maximum(bend.max(axis=0), 0.0) + third)
    high = (value + rounded).max(axis=0) + rest * (np.maximum(-bend.min(axis=0), 0.0) + third)
    return low, high


def _wide_expansion(problem: DesignProblem, zones: Array, windows: Index, roots: Array) -> LogExpansion | None:
    """The geometric mean with growth as it is and everything else at its extremes: no Hessian, no remainder."""
    k, M, rate = problem.samples, len(windows), growth_rate(problem)
    half = (zones[:, 1] - zones[:, 0]) / 2
    terms = terms_of(problem, zones, windows)
    least, most = _extremes(problem, terms, roots)
    states = terms.states(M)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        size = np.where(terms.own, -np.inf, np.log(most) + 2 * rate * terms.lag)
        leading = np.array([_largest(size, terms.window == m) for m in range(M)])
        lead = leading[terms.window]
        same = terms.first == terms.first[lead]
        apart = terms.lag - terms.lag[lead]
        change = np.where(same, 0.0, half[terms.first] + half[terms.first[lead]])
        farthest = np.where(apart < 0, np.minimum(apart + change, -problem.spacing), apart + change)
        ahead = np.where(terms.own, 0.0, np.exp(2 * rate * np.where(same, apart, farthest)))
        Q = np.bincount(terms.window, np.where(most > 0, ahead * most, 0.0), M)
        K, lag = least[states], terms.lag[states]
        mu = np.maximum(K, 0.0) * np.exp(2 * rate * (lag - lag.max()))
        mu = mu / mu.sum()
        used = mu > 0
        constant = float(mu[used] @ (np.log(Q) - np.log(K) + 2 * rate * (terms.lag[leading] - lag))[used])
    if not np.isfinite(constant):
        return None
    slope = np.zeros(k)
    np.add.at(slope, terms.first[leading], 2 * rate * mu)
    np.add.at(slope, windows[:, 0], -2 * rate * mu)
    return constant, slope, np.zeros((k, k)), 0.0


def _largest(size: Array, within: Mask) -> int:
    return int(np.argmax(np.where(within, size, -np.inf)))


def _spacing(problem: DesignProblem, zones: Array) -> tuple[Array, Array]:
    """Rows D and room b >= 0 with D d <= b for every move d that keeps the spacing, in the zones as far as it can."""
    k, P = problem.samples, problem.period
    middle = zones.mean(axis=1)
    gaps = np.diff(np.append(middle, middle[0] + P))
    eye = np.eye(k)
    return eye - np.roll(eye, 1, axis=1), gaps - problem.spacing * (1 - SAME)


def local_bound(problem: DesignProblem, zones: Array, windows: Index, roots: Array, nu: Array) -> float:
    """Bound sigma of every schedule whose samples lie in `zones`, by psd multipliers F F' and spacing's `nu` >= 0."""
    values = [_value(problem, zones, _expansion(problem, zones, windows, roots), nu)]
    if growth_rate(problem) > 0:
        values.append(_value(problem, zones, _wide_expansion(problem, zones, windows, roots), nu))
    return min(values)


def _value(problem: DesignProblem, zones: Array, found: LogExpansion | None, nu: Array) -> float:
    """The most that an expansion says sigma can be in the box."""
    if found is None:
        return np.inf
    constant, slope, hessian, remainder = found
    half = (zones[:, 1] - zones[:, 0]) / 2
    D, room = _spacing(problem, zones)
    H = hessian * half[:, None] * half
    crossed = np.abs(H - np.diag(np.diagonal(H))).sum() + np.maximum(np.diagonal(H), 0.0).sum()
    widest = max(float(np.linalg.eigvalsh((H + H.T) / 2)[-1]), 0.0) * int(np.sum(half > 0))
    linear = float(np.abs(slope - D.T @ nu) @ half + nu @ room)
    with np.errstate(over="ignore"):
        return rooted(problem, float(np.exp(constant + linear + min(crossed, widest) / 2 + remainder)))
