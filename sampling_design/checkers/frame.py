"""The recursion of Y = Pi^-1 in coordinates where a target is I, with a bound on all rounding: the claim is Y <= I.

    Y' = A Y + Y A' + eta Y + G Qw^-1 G',    at a sample  Y+ = Y - Y C'(C Y C' + V)^-1 C Y,    V = R^-1 + Qv^-1

The recursion is monotone, so rounding is paid by making Y larger: each step bounds what it may have lost entry by entry
(a stiff direction must not spoil the others), and adds a diagonal matrix that is at least as large. With any gain K the
sample's Joseph form (I-KC) Y (I-KC)' + K V K' is no smaller than Y+, so that the gain needs no error bound. Beside Y
runs a band E, Y - E <= true Y <= Y: an inequality fails only where Y - E exceeds I. "wrong" bounds the sizes of the
errors of a matrix, entry by entry.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from .numbers import EPS, Problem
from .outcome import MOST_WORK, Undecided, WorkLimit
from .strict import Array, Index, Mask

APART = 1e-6  # relative gap of two speeds from which on they are told apart
DOUBLINGS = 40  # that the price of a flow holds: a gap of 1e12 time constants; more are paid one by one
FLOOR = 1e-6  # of the larger one of two parts: what couples them by rounding counts 1/sqrt(this) times


def turned(M: Array) -> Array:
    """Transpose of each matrix of a stack."""
    return np.swapaxes(M, -1, -2)


def size(M: Array) -> Array:
    """Frobenius norm of each matrix of a stack."""
    return np.asarray(np.sqrt(np.einsum("...ij,...ij->...", M, M)))


def dominating(wrong: Array) -> Array:
    """A diagonal matrix D with M <= D for every symmetric M whose entries are at most `wrong` (a symmetric stack).

    With any e > 0 the sums over j of wrong_ij e_i/e_j do; e is near the roots of the diagonal.
    """
    top = np.maximum(wrong.max(axis=(-2, -1), initial=0.0), 1e-300)[..., None]
    diagonal = np.einsum("...ii->...i", wrong)
    e = np.sqrt(
        np.maximum(np.maximum(diagonal, wrong.max(axis=-1, initial=0.0) ** 2 / top), np.fmax(1e-30 * top, 1e-290))
    )
    return np.asarray(((wrong / e[..., None, :]).sum(axis=-1) * e)[..., None] * np.eye(wrong.shape[-1]) * (1 + 1e-9))


def largest(U: Array, limit: float = 0.0) -> Array:
    """An upper bound of the largest eigenvalue of each matrix: exact to rounding unless it is below `limit` already."""
    n = U.shape[-1]
    mean = np.trace(U, axis1=-2, axis2=-1) / n
    spread = np.maximum(np.einsum("...ij,...ij->...", U, U) / n - mean**2, 0.0)
    bound = np.asarray(mean + np.sqrt((n - 1) * spread))
    close = ~(bound < limit)
    bound[close] = np.linalg.eigvalsh(U[close])[..., -1]
    return np.asarray(bound + 4 * n * EPS * size(U))


def least(U: Array) -> Array:
    """A lower bound of the least eigenvalue of each matrix."""
    return np.asarray(np.linalg.eigvalsh(U)[..., 0] - 4 * U.shape[-1] * EPS * size(U))


def leading(A: Array, k: int) -> Array:
    """An orthonormal basis of the real space of the k fastest modes of A."""
    values, vectors = np.linalg.eig(A)
    fast = vectors[:, np.argsort(-np.abs(values), kind="stable")[:k]]
    return np.linalg.svd(np.hstack([fast.real, fast.imag]))[0][:, :k]


def apart(basis: Array) -> Array:
    """An orthonormal basis of what is orthogonal to all columns of `basis`."""
    return np.linalg.svd(basis)[0][:, basis.shape[1] :]


def risen(X: Array) -> Array:
    """e^X - I of a stack of matrices of norm at most 1, by the (8, 8) Pade approximant (right to 1e-18)."""
    term = bottom = np.broadcast_to(np.eye(X.shape[-1]), X.shape)
    odd = np.zeros(X.shape)
    for k in range(1, 9):
        term = term @ X * ((9 - k) / (k * (17 - k)))
        bottom, odd = bottom + (-1) ** k * term, odd + (2 * term if k % 2 else 0.0)
    return np.asarray(np.linalg.solve(bottom, odd), dtype=np.float64)


@dataclass
class Flows:
    """F and W of Y -> F Y F' + W for a stack of durations, and bounds on their entries' errors."""

    F: Array
    W: Array
    wrong_F: Array
    wrong_W: Array

    def __getitem__(self, index: int | Index) -> "Flows":
        return Flows(self.F[index], self.W[index], self.wrong_F[index], self.wrong_W[index])


@dataclass
class Split:
    """Coordinates z, x = `basis` z, in which the first `fast` states decay on their own, and the rest on its own.

    V D V' e^{2 rate s} stays above e^{As} V D V' e^{A's} for D = diag(d_1 I, d_2 I), d_1, d_2 >= FLOOR max(d_1, d_2).
    `inverse` is that of the basis but for `lost`, relative to the root of a trace.
    """

    basis: Array
    inverse: Array
    fast: int
    rate: float
    lost: float

    def above(self, N: Array) -> Array:
        """V D V' >= N, N psd, which may be carried along: N <= 2 diag(N_11, N_22) in its own coordinates."""
        X, V, k = self.inverse, self.basis, self.fast
        parts = np.maximum(np.einsum("ia,...ab,ib->...i", X, N, X), 0.0)
        whole = np.sqrt(np.einsum("...ii->...", N))[..., None]
        roots = np.sqrt(np.stack([parts[..., :k].sum(axis=-1), parts[..., k:].sum(axis=-1)], axis=-1))
        d = 2 * (roots + self.lost * whole) ** 2
        d = np.maximum(d, FLOOR * d.max(axis=-1, keepdims=True))
        rounding = 4 * (len(V) + 2) * EPS * d.max(axis=-1) * float(size(V)) ** 2
        sides = np.repeat(d, [k, len(V) - k], axis=-1)
        return np.asarray((V * sides[..., None, :]) @ V.T + rounding[..., None, None] * np.eye(len(V)))


class Frame:
    """Plant and weights in coordinates where `target` is I, for samples that measure the `patterns` of outputs."""

    def __init__(
        self, problem: Problem, target: Array, inequality: str, patterns: Mask, work: WorkLimit | None = None
    ) -> None:
        self.problem, self.inequality, self.n, self.I = problem, inequality, problem.n, np.eye(problem.n)
        self.work = WorkLimit(MOST_WORK) if work is None else work
        try:
            self.L = L = np.linalg.cholesky(target)
        except np.linalg.LinAlgError:
            raise self.undecided("its left side is nearly singular") from None
        self.inverse = inverse = np.linalg.inv(L)
        n, l, i = self.n, np.abs(L), np.abs(inverse)
        # L L' is the target but for this, in the coordinates where the target is I
        self.one = 1 - (n + 6) * EPS * float(size(i @ l @ l.T @ i.T))
        self.A = L.T @ np.linalg.solve(L, problem.A.T).T + problem.eta / 2 * self.I
        self.wrong_A = (4 * n + 8) * EPS * (l.T @ np.abs(problem.A) @ i.T @ l.T @ i.T) + EPS * problem.eta * self.I
        self.S = L.T @ problem.S @ L
        self.wrong_S = (2 * n + 6) * EPS * (l.T @ np.abs(problem.S) @ l)
        self.start, self.start_band = (part[0] for part in self.inverse_of(problem.P2[None]))
        self.rows, self.wrong_rows, self.loose = self.whitened(patterns)
        self.square, self.bend = self.A @ self.A, self.A @ self.S + self.S @ self.A.T
        self.sizes, wrong = np.abs(self.A), self.wrong_A + 2 * n * EPS * np.abs(self.A)
        self.wrong, self.wrong_square = wrong, wrong @ self.sizes + self.sizes @ wrong
        bent = wrong @ np.abs(self.S) + self.sizes @ self.wrong_S
        self.bent, self.wrong_bend = bent + bent.T, 2 * float(size(bent))
        self.speed = float(np.linalg.norm(self.sizes + self.wrong)) * (1 + 1e-9)
        self.known: dict[float, tuple[Array, Array, Array, Array]] = {}
        doubts = (self.wrong_A, self.wrong_S, self.start_band, self.wrong_rows, self.loose)
        if not (self.one > 0.5 and all(np.isfinite(doubt).all() for doubt in doubts)):
            raise self.undecided("its coordinates are too ill-conditioned for doubles")

    def undecided(self, why: str) -> Undecided:
        """What to raise where floats can say neither yes nor no."""
        return Undecided(self.inequality, f"{self.inequality} could not be decided: {why}")

    def spend(self, matrices: int) -> None:
        """Count one round of operations on so many matrices; undecided where it is more than was allowed."""
        self.work.spend(150 + matrices * (1 + min(self.n, self.n**2 / 4)))  # microseconds, measured up to n = 40
        if self.work.over:
            raise self.undecided("it takes more work than one check may do")

    def inverse_of(self, P: Array) -> tuple[Array, Array]:
        """Y = L' P^-1 L of a stack of P, from above, and its band.

        Y = Z'Z with M Z = L and M M' = P but for what the factor lost: P^-1 itself would lose the condition twice.
        """
        try:
            M = np.linalg.cholesky(P)
        except np.linalg.LinAlgError:
            raise self.undecided("a weight is nearly singular") from None
        m, inverse = np.abs(M), np.abs(np.linalg.inv(M)) * (1 + 1e-3)
        loose = (self.n + 6) * EPS * size(inverse @ m @ turned(m) @ turned(inverse))[..., None, None]
        if not np.all(loose < 1 / 4):
            raise self.undecided("a weight is too ill-conditioned for doubles")
        Z = np.linalg.solve(M, np.broadcast_to(self.L, P.shape))
        z, rest = np.abs(Z), np.abs(M @ Z - self.L)
        wrong = inverse @ (rest + (self.n + 4) * EPS * (m @ np.abs(Z) + np.abs(self.L)))
        both = turned(wrong) @ (z + wrong)
        lost = dominating(both + turned(both) + (self.n + 4) * EPS * (turned(z) @ z))
        Y = (turned(Z) @ Z + lost) * (1 + 2 * loose)
        return Y, 2 * lost + 4 * loose * Y

    def whitened(self, patterns: Mask) -> tuple[Array, Array, Array]:
        """C in units where V = I for each pattern (unused rows 0); bounds of the rows' errors; of V, relative."""
        problem, l, i = self.problem, np.abs(self.L), np.abs(self.inverse)
        rows, lost = (np.zeros((len(patterns), problem.C.shape[0], self.n)) for _ in range(2))
        loose = np.zeros(len(patterns))
        for k, mask in enumerate(patterns):
            m = int(mask.sum())
            if not m:
                continue
            V = problem.V[np.ix_(mask, mask)]
            try:
                root = np.linalg.cholesky(V)
            except np.linalg.LinAlgError:
                raise self.undecided("R and Qv are nearly singular") from None
            r, back = np.abs(root), np.abs(np.linalg.inv(root))
            wrong = (m + 4) * EPS * float(size(back @ r @ r.T @ back.T))  # root root' is V but for this
            rows[k, :m] = np.linalg.solve(root, np.linalg.solve(self.L, problem.C[mask].T).T) / np.sqrt(1 + wrong)
            lost[k, :m] = (4 * self.n + 4 * m + 8) * EPS * (back @ r @ back @ np.abs(problem.C[mask]) @ i.T @ l.T @ i.T)
            loose[k] = 2 * wrong + 2 * problem.loose * float(np.linalg.norm(back)) ** 2
        return rows, lost, loose

    @cached_property
    def drive(self) -> float:
        """A bound of the largest eigenvalue of S."""
        return float(largest(self.S) + size(self.wrong_S))

    @cached_property
    def rates(self) -> tuple[float, float, float]:
        """alpha, mu >= 0 and k with |e^{As}| <= min(k e^{alpha s}, e^{mu s})."""
        lost = float(size(self.wrong_A) + 8 * self.n * EPS * size(self.A))
        mu = max(float(np.linalg.eigvalsh(self.A + self.A.T)[-1]) / 2 + lost, 0.0)
        poles, modes = np.linalg.eig(self.A)
        skew = float(np.linalg.cond(modes))
        if not skew < 1e12:
            return mu, mu, 1.0
        # A = modes diag(poles) modes^-1 + a remainder, which moves the rate by k times its norm at most
        remainder = np.linalg.solve(modes, self.A @ modes) - np.diag(poles)
        moved = float(np.linalg.norm(remainder)) + skew * lost
        return max(float(poles.real.max()) + moved, 0.0), mu, skew * (1 + 1e-3)

    def growth(self, step: Array) -> Array:
        """ln of a bound of |e^{As}| for all s up to a step."""
        alpha, mu, k = self.rates
        return np.asarray(np.minimum(np.log(k) + alpha * step, mu * step))

    @cached_property
    def split(self) -> Split | None:
        """What is fast and decays apart from what is slow: covariances carried so know two speeds, not one."""
        speeds, found = np.sort(np.abs(np.linalg.eigvals(self.A)))[::-1], []
        for k in range(1, self.n):
            if speeds[k] < speeds[k - 1] * (1 - APART):
                basis = np.hstack([leading(self.A, k), apart(leading(self.A.T, k))])
                found.append(self.split_by(basis, k))
        best = min(found, key=lambda split: split.rate, default=None)
        return best if best is not None and np.isfinite(best.rate) else None

    def split_by(self, V: Array, k: int) -> Split:
        """The split whose first k columns are fast, with the rate that it bears; infinity where there is none."""
        X = np.asarray(np.linalg.pinv(V), dtype=np.float64)
        x, v, one = float(size(X)), float(size(V)), np.eye(self.n)
        short = float(size(X @ V - one)) + 2 * self.n * EPS * x * v
        if not short < 1e-3:
            return Split(V, X, k, np.inf, np.inf)
        B = X @ self.A @ V
        rates = [float(np.linalg.eigvalsh(part + part.T)[-1]) / 2 for part in (B[:k, :k], B[k:, k:])]
        coupled = float(size(B[:k, k:]) + size(B[k:, :k]))
        wrong = x * v * ((4 * self.n * EPS + 2 * short) * float(size(self.A)) + float(size(self.wrong_A)))
        rate = max(*rates, 0.0) + 1.01 * (coupled + wrong) / np.sqrt(FLOOR) + 8 * self.n * EPS * float(size(B))
        return Split(V, X, k, rate, 2 * short * x + 2 * float(np.sqrt((self.n + 2) * EPS)) * x)

    # --- between samples ---

    def flow(self, durations: npt.ArrayLike) -> Flows:
        """The flows of these durations; one that came before is remembered."""
        asked, which = np.unique(np.ravel(durations), return_inverse=True)
        if new := [h for h in asked.tolist() if h not in self.known]:
            self.spend(4 * len(new))
            found = self.doubled(np.array(new))
            parts = (found.F, found.W, found.wrong_F, found.wrong_W)
            self.known.update(zip(new, zip(*parts, strict=True), strict=True))
        columns = list(zip(*[self.known[h] for h in asked.tolist()], strict=True)) or [(), (), (), ()]
        return Flows(*(np.reshape(part, (-1, self.n, self.n)) for part in columns))[which]

    def doubled(self, h: Array, source: tuple[Array, Array] | None = None) -> Flows:
        """F and W by the exponential of Van Loan's block on a short step, then doubling; S is the `source` if given.

        D = F - I is doubled, D <- 2 D + D D, which keeps the slow modes of a stiff plant right.
        """
        S, wrong_S = source or (self.S, self.wrong_S)
        n, norm = self.n, np.fmax(np.linalg.norm(self.A, 1), 1e-300)
        doublings = np.maximum(0, np.ceil(np.log2(np.maximum(2 * h * norm, 1e-300)))).astype(int)
        if beyond := int(np.maximum(doublings - DOUBLINGS, 0).sum()):
            self.spend(4 * beyond)
        scale = np.fmax(np.linalg.norm(S, 1), 1e-300) / norm
        step = np.ldexp(h, -doublings)[:, None, None]
        X = np.block([[-self.A, S / scale], [0 * self.A, self.A.T]]) * step
        E, D = risen(X), risen(self.A.T * step)
        # a column of either, which is a row of D, is right to rounding relative to its size
        row, column = (64 * n * EPS * np.sqrt(np.einsum("kij,kij->kj", M, M)) for M in (D, E[:, :, n:]))
        D = turned(D).copy()
        W = scale * (E[:, :n, n:] + D @ E[:, :n, n:])
        x = step * self.sizes
        more, short = self.I + x + x @ x, step * self.wrong
        wrong_D = row[:, :, None] + more @ short @ more
        wrong = wrong_S + short @ np.abs(S) + np.abs(S) @ turned(short)
        wrong_W = 2 * scale * (column[:, None, :] + column[:, :, None]) + step * (more @ wrong @ turned(more))
        for s in range(int(doublings.max(initial=0))):
            k = doublings > s
            d, F = np.abs(D[k]), self.I + D[k]
            wrong_W[k] = self.doubt(np.abs(W[k]), wrong_W[k], F, wrong_D[k])
            wrong_D[k] = (
                np.abs(F) @ wrong_D[k] + wrong_D[k] @ (np.abs(F) + wrong_D[k]) + EPS * ((n + 2) * d @ d + 3 * d)
            )
            W[k], D[k] = W[k] + F @ W[k] @ turned(F), 2 * D[k] + D[k] @ D[k]
        F = self.I + D
        return Flows(F, (W + turned(W)) / 2, wrong_D + EPS * np.abs(F), wrong_W)

    def doubt(self, w: Array, wrong: Array, F: Array, wrong_F: Array) -> Array:
        """Error bounds of W + F W F'."""
        f = np.abs(F) + wrong_F
        both = wrong_F @ w @ turned(f)
        return wrong + f @ wrong @ turned(f) + both + turned(both) + (2 * self.n + 4) * EPS * (w + f @ w @ turned(f))

    def along(self, Y: Array, flows: Flows) -> tuple[Array, Array]:
        """F Y F' + W from above, and what was added to make it so."""
        f, y = np.abs(flows.F) + flows.wrong_F, np.abs(Y)
        both = flows.wrong_F @ y @ turned(f)
        wrong = both + turned(both) + (2 * self.n + 4) * EPS * (f @ y @ turned(f) + np.abs(flows.W))
        wrong = wrong + (flows.wrong_W + turned(flows.wrong_W)) / 2
        lost = dominating((wrong + turned(wrong)) / 2)
        return flows.F @ Y @ turned(flows.F) + flows.W + lost, lost

    def moved(self, Y: Array, durations: npt.ArrayLike) -> Array:
        """Y after each duration, from above."""
        return self.along(Y, self.flow(durations))[0]

    def curvature(self, Y: Array, step: Array) -> Array:
        """A bound of (d^2/8) |Y''| over the step d that begins at Y."""
        second = self.square @ Y + 2 * self.A @ Y @ self.A.T + Y @ self.square.T + self.bend
        y = np.abs(Y)
        lost = 2 * size(self.wrong_square @ y) + 4 * size(self.wrong @ y @ self.sizes.T) + self.wrong_bend
        flow = np.exp(np.minimum(self.growth(step), 300)) * (1 + 1e-6)
        return np.asarray((step * flow) ** 2 / 8 * (size(second) + lost))

    def risen_to(self, top: Array, step: Array) -> Array:
        """A bound of the largest eigenvalue along steps from Y <= `top` I on: e^{2 mu d} (top + d |S|)."""
        grown = np.exp(np.minimum(2 * self.rates[1] * step, 600)) * (1 + 1e-6)
        return np.asarray(grown * (top + step * self.drive))

    def invariant_bound(self) -> float | None:
        """A number s <= 1, if one is found, such that Y <= s I at the start and ever after, with samples or without.

        Where s (A + A') + S <= 0 the flow takes s I below itself at once, and so for ever, with all that lies below it.
        """
        doubt = self.wrong + self.wrong.T
        for s in (float(largest(self.start)), self.one):
            M = s * (self.A + self.A.T) + self.S
            wrong = s * doubt + self.wrong_S + 4 * EPS * (np.abs(M) + np.abs(self.S))
            if largest(self.start) <= s <= self.one and largest(M + dominating((wrong + wrong.T) / 2)) <= 0:
                return s
        return None

    def slope(self, Y: Array) -> Array:
        """A psd matrix N with -Y' <= N: what falls in Y, and the rounding."""
        first, y = self.A @ Y + Y @ self.A.T + self.S, np.abs(Y)
        wrong = self.wrong @ y
        return self.fallen(first, wrong + turned(wrong) + self.wrong_S + 2 * EPS * (np.abs(first) + np.abs(self.S)))

    def fallen(self, M: Array, wrong: Array) -> Array:
        """A psd matrix that is at least -M for the true M, which is within `wrong` of this one."""
        M = dominating((wrong + turned(wrong)) / 2) - (M + turned(M)) / 2
        values, vectors = np.linalg.eigh(M)
        rounding = 16 * self.n * EPS * size(M)[..., None]
        return np.asarray((vectors * (np.maximum(values, 0.0) + rounding)[..., None, :]) @ turned(vectors))

    def carried(self, N: Array, step: Array) -> Array:
        """A matrix that stays above e^{As} N e^{A's}, N psd, for all s up to the step: N itself where that is short."""
        total = np.einsum("...ii->...", N)
        grown = np.exp(np.minimum(2 * self.growth(step), 600)) * (1 + 1e-6)
        near = np.expm1(np.minimum(2 * self.speed * step, 600)) * (1 + 1e-6)
        short = near < grown
        rest = np.where(short, near, grown) * total
        found = np.where(short, 1 + 1e-9, 0.0)[..., None, None] * N + rest[..., None, None] * self.I
        if self.split is not None:
            other = (
                self.split.above(N) * np.exp(np.minimum(2 * self.split.rate * step, 600))[..., None, None] * (1 + 1e-6)
            )
            less = np.einsum("...ii->...", other) < np.einsum("...ii->...", found)
            found = np.where(less[..., None, None], other, found)
        return np.asarray(found)

    def covered(self, Y: Array, later: Array, step: Array, limit: float) -> Array:
        """A bound of the largest eigenvalue along the step from Y to `later`, `limit` being what it should keep.

        Y(s) <= Y(d) + d N with N >= -Y' all along, which costs nothing where Y rises; else, likewise with N >= -Y'',
        Y(s) <= chord + (d^2/8) N, which costs nothing where it is convex.
        """
        d = step[..., None, None] * (1 + 1e-9)
        found = largest(later + d * self.carried(self.slope(Y), step), limit)
        rest = np.flatnonzero(~(found <= limit))
        if rest.size:
            Y, later, d = Y[rest], later[rest], d[rest]
            bulge = d**2 / 8 * self.carried(self.bending(Y), step[rest])
            found[rest] = np.fmin(found[rest], np.maximum(largest(Y + bulge, limit), largest(later + bulge, limit)))
        return found

    def bending(self, Y: Array) -> Array:
        """A psd matrix N with -Y'' <= N."""
        y, half = np.abs(Y), self.square @ Y + self.A @ Y @ self.A.T
        wrong = self.wrong_square @ y + self.wrong @ y @ self.sizes.T
        wrong = 2 * (wrong + turned(wrong)) + 2 * self.bent + 4 * EPS * (np.abs(half) + turned(np.abs(half)))
        return self.fallen(half + turned(half) + self.bend, wrong)

    # --- at samples ---

    def gain(self, Y: Array, at: int | np.intp | Index) -> Array:
        """Nearly the best gain of a sample, one row after the other: outputs of any sizes may stand side by side."""
        C = self.rows[at]
        columns: list[Array] = []
        for k in range(C.shape[-2]):
            c = C[..., k, :, None]
            cross = Y @ c
            column = cross / (1 + turned(c) @ cross)
            left = self.I - column * turned(c)
            columns = [left @ other for other in columns] + [column]
            if k + 1 < C.shape[-2]:
                Y = left @ Y @ turned(left) + column * turned(column)
        return np.concatenate([np.zeros((*Y.shape[:-1], 0)), *columns], axis=-1)

    def after(self, Y: Array, at: int | np.intp | Index, K: Array) -> tuple[Array, Array, Array]:
        """Y after sample `at` with gain K, from above; I - KC; and what was added."""
        C, k, y = self.rows[at], np.abs(K), np.abs(Y)
        left, p = self.I - K @ C, C.shape[-2]
        wrong_left = k @ self.wrong_rows[at] + (p + 2) * EPS * (k @ np.abs(C) + self.I)
        both = wrong_left @ y @ turned(np.abs(left) + wrong_left)
        sizes = np.abs(left) @ y @ turned(np.abs(left)) + k @ turned(k)
        lost = dominating(both + turned(both) + (2 * self.n + p + 4) * EPS * sizes)
        return left @ Y @ turned(left) + K @ turned(K) + lost, left, lost

    def band_after(self, E: Array, Y: Array, at: int | np.intp | Index, K: Array, left: Array, lost: Array) -> Array:
        """The band after that sample: the gain's distance from the best one and the looseness of V enter here."""
        C = self.rows[at]
        c, y, k = np.abs(C), np.abs(Y), np.abs(K)
        M, sizes = np.eye(C.shape[-2]) + C @ Y @ turned(C), np.eye(C.shape[-2]) + c @ y @ turned(c)
        # K is right but for a residual of its equation K M = Y C', M >= I: of second order
        rounding = 4 * (self.n + C.shape[-2]) * EPS * (size(k @ sizes) + size(y @ turned(c)))
        short = size(K @ M - Y @ turned(C)) + rounding
        # it is that of V, not of the true V: nothing is known from below where that may be much smaller
        loose = np.where(self.loose[at] < 1 / 4, self.loose[at], np.inf)
        more = size(K) ** 2 * loose + 2 * (short + size(K) * loose) ** 2
        # the gain is that of Y, not of the true Y: of second order in E
        twice = 1 + size(E) * size(C) ** 2
        return np.asarray(
            twice[..., None, None] * (left @ E @ turned(left)) + 2 * lost + more[..., None, None] * self.I
        )
