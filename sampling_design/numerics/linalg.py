"""Small dense linear algebra in batches: e^{At}, discounted Gramians, roots, singular values.

Everything works on stacks (N, n, n) so that no caller loops over times. Scales and an order of the states that suit a
matrix whatever its units: what every decision is made in.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.kept import kept

ROUNDS = 40  # of reweighted least squares: enough for the median of what the couplings ask of the scales
LARGEST_LOGARITHM = 700.0  # of a double, with room
FARTHEST = 1000.0  # |log2| of a scale: beyond, numbers end


class Balance(NamedTuple):
    """Scales d, an order of the states, and the norm of diag(d)^-1 A diag(d) without what couples components."""

    d: Array
    order: Index
    speed: float


@kept
def balance(A: Array, C: Array | None = None) -> Balance:
    """Return scales d (powers of two) and an order of the states, with B = diag(d)^-1 A diag(d) of moderate entries.

    In that order B is block upper triangular, one block for each set of states that drive each other.

    Notes
    -----
    *Method.* States that drive each other (a strong component of the graph of A) are balanced by themselves: the
    scales of least norm are unique there. Between components a coupling can be scaled to any size, and plain
    balancing runs away with it; here the couplings are brought as near as they can be (their logarithms in the
    median) to the largest norm of a component, to 1 where all of these vanish. So d follows a change of units, up to
    the factor of two that powers of two leave. Sets of states that share no coupling at all are scaled against
    each other by what the rows of C show of them, where C is given.
    """
    from scipy.linalg.lapack import dgebal
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    n = A.shape[0]
    d = np.ones(n)
    if not A.any():
        return Balance(_scaled_by_outputs(A, C, d), np.arange(n), 0.0)
    top = int(np.floor(np.log2(np.max(np.abs(A)))))
    moderate = np.ldexp(A, -top)  # neither 1e200 nor 1e-200 squared is a number
    count, part = connected_components(csr_array(A != 0), directed=True, connection="strong")
    speed = np.zeros(count)
    for k in range(count):
        block = np.flatnonzero(part == k)
        inner = moderate[np.ix_(block, block)]
        if block.size > 1:
            inner, _, _, d[block], _ = dgebal(inner, scale=1, permute=0)
        speed[k] = np.linalg.norm(inner)
    fastest = float(np.ldexp(np.linalg.norm(speed), top)) if top < 1000 else np.inf
    if count == 1:
        return Balance(d, np.arange(n), fastest)
    with np.errstate(divide="ignore"):
        entries = np.log2(np.abs(A)) - np.log2(d)[:, None] + np.log2(d)
        goal = np.log2(speed.max()) + top if speed.max() > 0 else 0.0
    size = np.full((count, count), -np.inf)
    np.maximum.at(size, (part[:, None], part), entries)
    np.fill_diagonal(size, -np.inf)
    d *= np.exp2(np.rint(_between(size - goal))[part])
    return Balance(
        _scaled_by_outputs(A, C, d), np.argsort(_depth(np.isfinite(size))[part] * count + part, kind="stable"), fastest
    )


def balanced(A: Array, d: Array) -> Array:
    """Return diag(d)^-1 A diag(d) for powers of two d: without rounding, and 0 stays 0 however far d reaches."""
    power = np.log2(d).astype(int)
    return np.ldexp(A, np.where(A != 0, power - power[:, None], 0))


def balanced_rows(C: Array, d: Array) -> Array:
    """Return C diag(d), each row divided by a power of two that makes its largest entry about 1."""
    power = np.log2(d).astype(int)
    reach = np.where(C != 0, np.frexp(C)[1] + power, -(2**20))
    top = np.max(reach, axis=1, initial=-(2**20), keepdims=True)
    return np.ldexp(C, np.where(C != 0, np.clip(power - top, -4000, 4000), 0))


def _scaled_by_outputs(A: Array, C: Array | None, d: Array) -> Array:
    """Scales d times one factor for each set of states that no coupling leaves, by the size of C diag(d) there."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    count, part = connected_components(csr_array(A != 0), directed=False)
    if C is None or count < 2 or not C.any():
        return d
    size = np.full((len(C), count), -np.inf)
    with np.errstate(divide="ignore"):
        np.maximum.at(size, (np.arange(len(C))[:, None], part), np.log2(np.abs(C)) + np.log2(d))
    finite = np.isfinite(size)
    size = np.where(finite, size, 0.0)
    outputs, factors = np.zeros(len(C)), np.zeros(count)
    for _ in range(ROUNDS):  # alternating means: least squares of the logarithms, which no unit changes
        factors = -np.sum(np.where(finite, size + outputs[:, None], 0.0), axis=0) / np.maximum(finite.sum(axis=0), 1)
        outputs = -np.sum(np.where(finite, size + factors, 0.0), axis=1) / np.maximum(finite.sum(axis=1), 1)
    return np.asarray(d * np.exp2(np.rint(np.clip(factors, -FARTHEST, FARTHEST)))[part])


def _between(size: Array) -> Array:
    """Logarithms of the scales of components: sum of |size[i, j] + s[j] - s[i]| about least over the couplings."""
    to, by = np.nonzero(np.isfinite(size))
    demand = size[to, by]
    rows = np.zeros((to.size, len(size)))
    rows[np.arange(to.size), to] += 1.0
    rows[np.arange(to.size), by] -= 1.0
    weight: Array = np.ones(to.size)
    s: Array = np.zeros(len(size))
    for _ in range(ROUNDS if to.size else 0):
        s = np.asarray(np.linalg.lstsq(rows * weight[:, None], demand * weight, rcond=None)[0], dtype=np.float64)
        weight = 1 / np.sqrt(np.maximum(np.abs(rows @ s - demand), 1e-3))
    return np.clip(s, -FARTHEST, FARTHEST)


def _depth(driven: Mask) -> Index:
    """How many couplings lead from a component to the last one that it drives: drivers come after the driven."""
    depth = np.zeros(len(driven), dtype=np.intp)
    for _ in range(len(driven)):
        depth = np.max(np.where(driven, 1 + depth[:, None], depth[None, :]), axis=0, initial=0)
    return depth


def chain_speed(A: Array, G: Array, C: Array, w: Array, v: Array) -> float:
    """Return max_k (|C A^(k-1) G w| / (k! v))^(1/k) [1/time], k = 1, ..., n: how soon w moves an output by v > 0.

    Chains of integrators have no rate of their own: only what drives and what measures them says how fast they are.
    It is 0 if w moves no output. Sizes are summed as logarithms, since powers of A leave the doubles.
    """
    noise = np.broadcast_to(v, len(C))
    rows, noise = C[noise > 0], np.log(noise[noise > 0])
    power, total, fastest = G * w, 0.0, -np.inf
    for k in range(1, len(A) + 1):
        size = float(np.max(np.abs(power), initial=0.0))
        if size == 0:
            break
        power, total = power / size, total + math.log(size)
        with np.errstate(divide="ignore"):  # the logarithm of what is not moved
            reached = np.log(np.sum(np.abs(rows @ power), axis=1)) - noise
        fastest = max(fastest, (total + float(np.max(reached, initial=-np.inf)) - math.lgamma(k + 1)) / k)
        power = A @ power
    return math.exp(min(fastest, LARGEST_LOGARITHM))


_TAYLOR_DEGREE = 18  # with the radius below, to rounding
_TAYLOR_RADIUS = 1.0  # |A t / 2^s|_1 at which 18 terms leave a remainder below eps/4
SHORT = 0.25  # |A_eta h|_1 up to which the terms of `gramian_terms` leave a remainder far below eps
_REFINEMENTS = 20  # of a solve, at most: each brings what the condition number leaves of 16 digits
_GRAMIAN_DEGREE = 16  # likewise, of its integral
BITS = 40  # binary digits that a search keeps: far above rounding, far below what it can tell apart
KEPT_ENTRIES = 4096  # numbers of the largest answer that is kept: all of them stay below 5 MB
AT_ONCE = 1_000_000  # numbers of matrices of which only products with rows or sums are wanted
_BALANCED_FROM = 2.0**20  # |A_eta h|_1 from which the states are balanced first


def expm_batch(A: Array, times: npt.ArrayLike) -> Array:
    """Return e^{A t} for every t in `times`, shape (N, n, n); A real or complex.

    Taylor polynomials of one matrix are one matrix product: the powers of A are shared by all times, so
    that only the scalar coefficients differ; then repeated squaring. Many times share their squarings:
    e^{A t} = e^{A k h} e^{A r} with few different k and |r| <= h/2.
    """
    t = np.atleast_1d(np.asarray(times, dtype=np.float64))
    if t.size * A.size <= KEPT_ENTRIES:  # four of five times the same gaps of the same plant are asked for again
        found = _kept_exponentials(A, t.ravel())
        if np.isfinite(found).all():  # what overflows does so again, with the warning of each call
            return found.copy()
    return _exponentials(A, t)


def _exponentials(A: Array, t: Array) -> Array:
    n = A.shape[0]
    if n == 0 or t.size == 0:
        return np.zeros((t.size, n, n), dtype=A.dtype)
    norm = float(np.linalg.norm(A, 1))
    if norm == 0.0:
        return np.broadcast_to(np.eye(n, dtype=A.dtype), (t.size, n, n)).copy()
    h = np.exp2(np.floor(np.log2(1 / norm)))  # a power of two: k h is exact
    if np.abs(t).max() * norm > _TAYLOR_RADIUS:
        k, place = np.unique(np.rint(t / h), return_inverse=True)
        if 4 * k.size <= t.size:
            return _squared(A, norm, k * h)[place] @ _squared(A, norm, t - k[place] * h)
    return _squared(A, norm, t)


_kept_exponentials = kept(_exponentials)


def _squared(A: Array, norm: float, t: Array) -> Array:
    """e^{A t}: a Taylor polynomial at t/2^s, squared s times; `norm` = |A|_1 > 0."""
    n = A.shape[0]
    size = np.maximum(np.abs(t) * norm / _TAYLOR_RADIUS, 1e-300)
    squarings = np.maximum(0, np.ceil(np.log2(size))).astype(int)
    terms = exponential_terms(A, norm, _TAYLOR_DEGREE + 1)
    coefficients = np.ones((len(terms), t.size))
    coefficients[1:] = np.ldexp(t * norm, -squarings)
    np.multiply.accumulate(coefficients, axis=0, out=coefficients)
    result = (coefficients.T @ terms.reshape(len(terms), -1)).reshape(-1, n, n)
    for s in range(int(squarings.max())):
        todo = np.flatnonzero(squarings > s)
        if todo.size == t.size:
            result = result @ result
        else:
            part = result[todo]
            result[todo] = part @ part
    return np.asarray(result)


def right_directions(rows: Array) -> tuple[Array, Array]:
    """Return the singular values of rows (..., R, n) and all n right singular vectors, as rows, (..., n, n).

    Of many rows the left ones, R^2 numbers, are not made.
    """
    _, sizes, right = np.linalg.svd(rows, full_matrices=rows.shape[-2] < rows.shape[-1])
    return sizes, right


def forced_flow(A: Array, B: Array, times: npt.ArrayLike) -> Array:
    """Return e^{A t} and int_0^t e^{A s} B ds side by side, (N, n, n + q), for every t in `times`; A (n, n), B (n, q).

    Real, or complex as A is.

    Columns of B far beyond A would be squared so often that beside 1 nothing is left of A: they are followed smaller.
    """
    n, q = B.shape
    joint, longest = np.zeros((n + q, n + q), dtype=A.dtype), float(np.abs(times).max(initial=0.0))
    most = max(float(np.abs(A).sum(axis=0).max(initial=0.0)), 1 / longest if longest > 0 else 0.0)
    columns = np.abs(B).sum(axis=0)
    large = (columns > most) & np.isfinite(columns) & (most > 0)
    unit = np.exp2(np.ceil(np.log2(columns / (most or 1.0), out=np.zeros(q), where=large)))  # nothing is rounded
    joint[:n, :n], joint[:n, n:] = A, B / unit
    flow = expm_batch(joint, times)[:, :n]
    flow[:, :, n:] *= unit
    return flow


def rows_ahead(C: Array, A: Array, times: Array) -> Array:
    """Return C e^{A t} (N, p, n) for many times t >= 0; short ones cost no exponential of their own."""
    norm = float(np.linalg.norm(A, 1))
    if norm * float(np.max(times, initial=0.0)) > _TAYLOR_RADIUS:
        parts = np.split(times, range(AT_ONCE // A.size + 1, times.size, AT_ONCE // A.size + 1))
        return np.concatenate([C @ expm_batch(A, part) for part in parts])
    terms = C @ exponential_terms(A, norm or 1.0, _TAYLOR_DEGREE + 1)
    powers = np.vander(times * (norm or 1.0), _TAYLOR_DEGREE + 1, increasing=True)
    return np.asarray((powers @ terms.reshape(_TAYLOR_DEGREE + 1, -1)).reshape(-1, *C.shape))


@kept
def exponential_terms(A: Array, norm: float, count: int = _GRAMIAN_DEGREE) -> Array:
    """Return (A/norm)^k / k! for k < `count`: e^{A h} is their sum with factors (norm h)^k."""
    terms = np.empty((count, *A.shape), dtype=A.dtype)
    terms[0], unit = np.eye(A.shape[0]), A / norm
    for k in range(1, count):
        terms[k] = terms[k - 1] @ unit / k
    return terms


@kept
def gramian_terms(shifted: Array, noise: Array, norm: float) -> Array:
    """Return N_k/(k+1)! with N_0 = N = `noise`, N_{k+1} = (A_eta N_k + N_k A_eta')/norm, A_eta = `shifted`.

    Their sum with factors h (norm h)^k is int_0^h F_s N F_s' ds, F_s = e^{A_eta s}, as long as |A_eta h| <= SHORT.
    """
    terms = np.empty((_GRAMIAN_DEGREE, *noise.shape))
    current = np.array(noise, dtype=np.float64)
    for k in range(_GRAMIAN_DEGREE):
        terms[k] = current = current / (k + 1)
        current = (shifted @ current + current @ shifted.T) / norm
    return terms


def discounted_flow(A: Array, noise: Array, gaps: npt.ArrayLike, eta: float = 0.0) -> tuple[Array, Array]:
    """Return e^{A h} and W_h for every gap h, both (N, n, n).

    W_h = int_0^h e^{eta s} e^{A s} N e^{A' s} ds with N = `noise` (n, n) symmetric psd, eta >= 0.

    Notes
    -----
    *Method.* With A_eta = A + (eta/2) I the integrand is F_s N F_s', F_s = e^{A_eta s}. A short
    Taylor step gives W over h/2^s, and doubling W_{2h} = W_h + F_h W_h F_h' brings it to h: every
    term is psd and nothing overflows before F itself does, which Van Loan's block exponential
    cannot say for stiff plants.
    """
    h = np.atleast_1d(np.asarray(gaps, dtype=np.float64))
    if h.size * A.size <= KEPT_ENTRIES:
        F, W = _kept_flows(A, noise, h.ravel(), float(eta))
        if np.isfinite(F).all() and np.isfinite(W).all():
            return F.copy(), W.copy()
    return _flows(A, noise, h, eta)


def _flows(A: Array, noise: Array, h: Array, eta: float) -> tuple[Array, Array]:
    n = A.shape[0]
    if n == 0 or h.size == 0:
        return expm_batch(A, h), np.zeros((h.size, n, n))
    if np.linalg.norm(A, 1) * float(np.abs(h).max()) > _BALANCED_FROM:
        d = balance(A).d  # each doubling doubles the rounding: in balanced coordinates there are fewest
        plain, W = _flow_and_gramian(A * d / d[:, None], noise / d / d[:, None], h, eta)
        return plain / d * d[:, None], W * d * d[:, None]
    return _flow_and_gramian(A, noise, h, eta)


_kept_flows = kept(_flows)


def _flow_and_gramian(A: Array, noise: Array, h: Array, eta: float) -> tuple[Array, Array]:
    """What `discounted_flow` returns, in the coordinates given."""
    n, plain = len(A), expm_batch(A, h)
    shifted = A + (eta / 2) * np.eye(n)
    norm = max(float(np.linalg.norm(shifted, 1)), 1e-300)
    doublings = np.maximum(0, np.ceil(np.log2(np.maximum(h * norm / SHORT, 1e-300)))).astype(int)
    step = np.ldexp(h, -doublings)
    terms = gramian_terms(shifted, noise, norm)
    coefficients = np.vander(step * norm, len(terms), increasing=True) * step[:, None]
    W = (coefficients @ terms.reshape(len(terms), -1)).reshape(-1, n, n)
    F = expm_batch(shifted, step)
    for s in range(int(doublings.max())):
        todo = np.flatnonzero(doublings > s)
        if todo.size == h.size:
            W = W + F @ W @ np.swapaxes(F, 1, 2)
            F = F @ F
        else:
            part = F[todo]
            W[todo] = W[todo] + part @ W[todo] @ np.swapaxes(part, 1, 2)
            F[todo] = part @ part
    return plain, (W + np.swapaxes(W, 1, 2)) / 2


def product_quotient(P: Array, Q: Array, R: Array) -> Array:
    """Return X with X R = P Q, R upper triangular: each row to a few units in the last place of its largest entry.

    A solve alone loses as many digits as the condition number of R has; residuals in doubled precision bring them
    back as long as that number stays below 1/eps (iterative refinement, Higham 2002, chapter 12).
    """
    X = _divided(P @ Q, R)
    scale, last = np.linalg.norm(X, axis=1), np.inf
    for _ in range(_REFINEMENTS):
        step = _divided(product(np.hstack([P, -X]), np.vstack([Q, R])), R)
        size = float(np.max(np.linalg.norm(step, axis=1) / positive_or_one(scale), initial=0.0))
        if not size < last / 2:  # a step that brings nothing more, or no number
            break
        X, last = X + step, size
    return np.asarray(X)


def _divided(B: Array, R: Array) -> Array:
    from scipy.linalg import solve_triangular

    return np.asarray(solve_triangular(R, B.T, trans=1, check_finite=False).T)


def product(P: Array, Q: Array) -> Array:
    """Return P Q as if worked out in doubled precision and rounded once, (m, k) times (k, n).

    Compensated sums of exact products (Dot2; Ogita, Rump and Oishi 2005): an entry is wrong by eps/2 of itself and
    (k eps)^2 of what |P| |Q| holds there.
    """
    total, rest = np.zeros((2, len(P), Q.shape[1]))
    (a, b), (c, d) = _halves(P), _halves(Q)
    for k in range(len(Q)):
        p, q = P[:, k, None], Q[None, k]
        term, high, low = p * q, a[:, k, None], b[:, k, None]
        lost = low * d[k] - (((term - high * c[k]) - low * c[k]) - high * d[k])
        larger = total + term
        back = larger - total
        rest += (total - (larger - back)) + (term - back) + lost
        total = larger
    return np.asarray(total + rest)


def _halves(matrix: Array) -> tuple[Array, Array]:
    """Two parts of 26 bits whose sum is the matrix: their products are exact (Veltkamp)."""
    _, exponent = np.frexp(matrix)
    high = np.ldexp(np.rint(np.ldexp(matrix, 26 - exponent)), exponent - 26)
    return high, matrix - high


def psd_root(matrix: Array) -> Array:
    """Return L (..., n, r) with L L' = `matrix`, r its numerical rank over the whole stack.

    Eigenvalues below n eps times the largest count as zero; works where a Cholesky factor does not exist.
    """
    n = matrix.shape[-1]
    values, vectors = np.linalg.eigh(matrix)
    top = np.max(np.abs(values), axis=-1, initial=0.0, keepdims=True)
    kept = np.where(values > n * np.finfo(float).eps * top, values, 0.0)
    rank = int(np.max(np.sum(kept > 0, axis=-1), initial=0))
    return (vectors * np.sqrt(kept)[..., None, :])[..., n - rank :]


def smallest_singular(matrix: Array) -> Array:
    """Return the n-th singular value of (..., N, n) matrices: 0 where N < n (never numpy's min for wide ones)."""
    n = matrix.shape[-1]
    if n == 0:
        return np.full(matrix.shape[:-2], np.inf)
    if matrix.shape[-2] < n:
        return np.zeros(matrix.shape[:-2])
    return np.asarray(np.linalg.svd(matrix, compute_uv=False)[..., n - 1], dtype=np.float64)


def eigenvalue_bound(Y: Array) -> Array:
    """A bound from above of the largest eigenvalue of each symmetric matrix, from its trace and its Frobenius norm."""
    n = Y.shape[-1]
    mean = np.trace(Y, axis1=-2, axis2=-1) / n
    spread = np.maximum(np.einsum("...ij,...ij->...", Y, Y) / n - mean**2, 0.0)
    return np.asarray(mean + np.sqrt((n - 1) * spread))


def generalised_max(P: Array, Q: Array) -> float:
    """Return lambda_max(P, Q), the least c with P <= c Q; Q positive definite.

    Solved through the Cholesky factor of Q, so that neither matrix is inverted. -inf for n = 0.
    """
    if P.shape[-1] == 0:
        return -np.inf
    L = np.linalg.cholesky(Q)
    half = np.linalg.solve(L, P)
    full = np.linalg.solve(L, np.swapaxes(half, -1, -2))
    return float(np.max(np.linalg.eigvalsh((full + np.swapaxes(full, -1, -2)) / 2)))


def quadratic(z: Array, weight: Array) -> Array:
    """Return z'Wz of each of a stack of vectors."""
    return np.asarray(np.einsum("...i,ij,...j->...", z, weight, z))


def symmetrise(matrix: Array) -> Array:
    """Return (M + M')/2 for a stack of matrices."""
    total: Array = matrix + matrix.swapaxes(-1, -2)
    total /= 2
    return total


def cut(numbers: npt.ArrayLike) -> Array:
    """Return numbers with `BITS` binary digits."""
    part, exponent = np.frexp(np.asarray(numbers, dtype=np.float64))
    return np.asarray(np.ldexp(np.rint(np.ldexp(part, BITS)), exponent - BITS))


def positive_or_one(values: Array) -> Array:
    """Return the values, 1 in place of those that are not positive: what a row is divided by."""
    return np.where(values > 0, values, 1.0)


def extrapolated(before: Array, tried: Array, found: Array) -> Array:
    """Return where a map that took `tried` (after `before`) to `found` may come to rest, by its slowest entry (Aitken).

    Never less than what was tried, and twice the step where steps do not shrink.
    """
    step, last = found - tried, tried - before
    ratio = float(np.max(np.divide(step, last, out=np.zeros_like(step), where=last > 0), initial=0.0))
    return np.asarray(np.maximum(tried, tried + step * (1 / (1 - ratio) if 0 < ratio < 1 else 2.0)))


def products(matrices: Array, vectors: Array) -> Array:
    """Return one product (K, n) of each matrix (K, n, m) and its vector (K, m)."""
    return np.asarray(np.matmul(matrices, vectors[:, :, None])[:, :, 0])
