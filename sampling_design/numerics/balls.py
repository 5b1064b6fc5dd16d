"""Ball arithmetic: the only door to python-flint (extra `rigorous`).

A number is a ball (midpoint, radius) that certainly holds the value; a double becomes a ball of radius zero. So
"certainly positive" here is a theorem about the doubles that were given. Floats enter as guesses only: a guessed bound
is proven by the pivots of L D L' in balls.

Linear matrix flows Y' = A Y + Y A' + S, and what they certainly stay below over a stretch: on a step of length h, Y
lies below its chord plus (h^2/8) sup |e^{As}|^2 r I, where Y'' >= -r I at the step's start: Y'' itself only turns with
e^{As}. The error is of second order, and a convex stretch costs nothing. Likewise below its end plus h N, where
N >= -Y' all along: a stretch along which Y rises costs nothing either.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from functools import cached_property
from importlib import import_module
from itertools import pairwise
from types import ModuleType
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import numpy.typing as npt

from sampling_design.errors import MissingExtraError
from sampling_design.numerics.branch_and_bound import all_proven
from sampling_design.records.arrays import Array
from sampling_design.records.budget import Budget

if TYPE_CHECKING:
    from flint import arb, arb_mat

Ball: TypeAlias = "arb"
Matrix: TypeAlias = "arb_mat"

BITS = 160  # Working precision: 53 bits of the doubles, and a hundred against cancellation and the growth of radii
BLOCK = 16
"""States up to which pivots are taken one by one; larger matrices are eliminated by blocks, whose products and
solutions are the library's."""
SLACKS = (1e-13, 1e-10, 1e-6)
"""By how much of a matrix's size a guessed eigenvalue is raised before it is proven; the first nearly always does."""


def flint() -> ModuleType:
    """Return the library, loaded on first use. Raises MissingExtraError if python-flint is not installed."""
    try:
        return sys.modules.get("flint") or import_module("flint")  # asked for with every number
    except ImportError:
        raise MissingExtraError("python-flint", "rigorous") from None


@contextmanager
def precision(bits: int = BITS) -> Iterator[None]:
    """Work with `bits` bits inside the block."""
    context = flint().ctx
    before = context.prec
    context.prec = bits
    try:
        yield
    finally:
        context.prec = before


def ball(x: float) -> Ball:
    """Return the double x as a ball of radius zero."""
    made: Ball = flint().arb(float(x))
    return made


def rational(x: Fraction) -> Ball:
    """Return a rational number as a ball."""
    made: Ball = flint().arb(x.numerator) / x.denominator
    return made


def matrix(X: npt.ArrayLike) -> Matrix:
    """Return doubles (m, n) as a matrix of balls of radius zero."""
    owned = np.asarray(X, dtype=np.float64)
    made: Matrix = flint().arb_mat(*owned.shape, owned.ravel().tolist())
    return made


def stacked(rows: Sequence[Sequence[Ball]], columns: int = 0) -> Matrix:
    """Return rows of balls as a matrix; `columns` says how many there are where there is no row."""
    made: Matrix = flint().arb_mat(rows) if rows and rows[0] else matrix(np.zeros((len(rows), columns)))
    return made


def symmetric(X: npt.ArrayLike) -> Matrix:
    """Return the symmetric part of X, all that the form x'Xx knows of it, without rounding."""
    M = matrix(X)
    return (M + M.transpose()) * ball(0.5)


def identity(n: int) -> Matrix:
    """Return I."""
    return matrix(np.eye(n))


def floats(M: Matrix) -> Array:
    """Return the midpoints as doubles: guesses, no proof."""
    count = M.nrows() * M.ncols()
    return np.fromiter(map(float, M.entries()), np.float64, count).reshape(M.nrows(), M.ncols())


def definite(M: Matrix) -> bool | None:
    """Say of a symmetric matrix: positive definite (True), not even semidefinite (False), or not decided (None)."""
    if M.nrows() > BLOCK:
        corner, side, rest = _quarters(M)
        found, carried = definite(corner), _solved(corner, side)
        if not found or carried is None:
            return None if found else found
        return definite(rest - side.transpose() * carried)
    rows = M.tolist()
    for k, row in enumerate(rows):
        pivot = row[k]
        if not pivot > 0:
            return False if pivot < 0 else None
        below = [other[k] for other in rows[k + 1 :]]
        for i, head in enumerate(below, k + 1):
            factor = head / pivot
            rows[i][k + 1 : i + 1] = [x - factor * y for x, y in zip(rows[i][k + 1 : i + 1], below, strict=False)]
    return True


def cholesky(M: Matrix) -> Matrix | None:
    """Return L with M = LL', or None where M is not certainly positive definite."""
    n = M.nrows()
    if n > BLOCK:
        corner, side, rest = _quarters(M)
        first = cholesky(corner)
        across = None if first is None else _solved(first, side)
        last = None if across is None else cholesky(rest - across.transpose() * across)
        if first is None or across is None or last is None:
            return None
        above = [[*row, *[flint().arb(0)] * last.nrows()] for row in first.tolist()]
        below = zip(across.transpose().tolist(), last.tolist(), strict=True)
        return stacked([*above, *([*a, *b] for a, b in below)])
    rows, L = M.tolist(), [[flint().arb(0)] * n for _ in range(n)]
    for k in range(n):
        if not rows[k][k] > 0:
            return None
        root = rows[k][k].sqrt()
        for i in range(k, n):
            L[i][k] = rows[i][k] / root
        for i in range(k + 1, n):
            for j in range(k + 1, i + 1):
                rows[i][j] -= L[i][k] * L[j][k]
    return stacked(L)


def _quarters(M: Matrix) -> tuple[Matrix, Matrix, Matrix]:
    """The blocks of a symmetric matrix, cut in the middle: first corner, the side to its right, last corner."""
    rows, k = M.tolist(), M.nrows() // 2
    parts = ([row[:k] for row in rows[:k]], [row[k:] for row in rows[:k]], [row[k:] for row in rows[k:]])
    first, side, last = map(stacked, parts)
    return first, side, last


def _solved(M: Matrix, right: Matrix) -> Matrix | None:
    """M^-1 right; None where M may be singular."""
    try:
        found: Matrix = M.solve(right)
    except ZeroDivisionError:
        return None
    return found


def frobenius(M: Matrix) -> Ball:
    """Return an exact number that is at least |M|_F."""
    return (M * M.transpose()).trace().upper().sqrt().upper()


def largest(M: Matrix) -> Ball:
    """Return an exact number that is at least the largest eigenvalue of a symmetric matrix, hardly above it."""
    n, guess = M.nrows(), floats(M)
    if np.isfinite(guess).all():
        size = float(np.abs(guess).max(initial=0.0))
        top = float(np.linalg.eigvalsh(guess)[-1])
        for slack in SLACKS:
            bound = ball(top + slack * max(size, 1e-300))
            if definite(bound * identity(n) - M):
                return bound
    return frobenius(M)


def spectral(M: Matrix) -> Ball:
    """Return an exact number that is at least |M|_2."""
    square = largest(M.transpose() * M)
    return (square if square > 0 else square * 0).sqrt().upper()


def raised(M: Matrix) -> Matrix:
    """Return a symmetric matrix, of hardly any radius, that is certainly at least M: radii no longer pile up."""
    middle = ((M + M.transpose()) * ball(0.5)).mid()
    return middle + frobenius(M - middle) * identity(M.nrows())


def lowered(M: Matrix) -> Matrix:
    """Return a symmetric matrix, of hardly any radius, that is certainly at most M."""
    return -raised(-M)


def positive_part(x: Ball) -> Ball:
    """Return an exact number that is at least max(x, 0)."""
    return x.upper() if x > 0 else flint().arb(0).max(x).upper()


FLOOR = 1e-6  # least share of one part beside the other: what couples them by rounding counts 1/sqrt(this) times
APART = 1e-6  # relative gap of two speeds from which on they are told apart
WORST_CONDITION = 1e6
"""Modal coordinates worse than this are not used to bound |e^{As}|: the logarithmic norm does better."""
HALVINGS = 50  # most halvings of a step: what is left then is below the resolution of a double
AT_ONCE = 2
"""Most halvings of a chord between two looks at it: where rounding, not its length, rules a bound, more make nodes for
nothing (a random plant of nine states took twice the work with 4)."""


def split_bases(A: Array) -> Iterator[tuple[Array, int]]:
    """Yield bases V of a fast and of a slow invariant space of A, and the first one's size, for each gap of speeds."""
    from scipy.linalg import schur, solve_sylvester

    speeds = np.sort(np.abs(np.linalg.eigvals(A)))[::-1]
    for k in np.flatnonzero(speeds[1:] < speeds[:-1] * (1 - APART)) + 1:
        edge = float(speeds[k - 1] + speeds[k]) / 2
        T, Q, fast = schur(A, output="real", sort=lambda x, y=0.0, edge=edge: np.hypot(x, y) > edge)
        if fast == k:
            X = solve_sylvester(T[:k, :k], -T[k:, k:], -T[:k, k:])
            yield np.hstack([Q[:, :k], np.linalg.qr(Q[:, :k] @ X + Q[:, k:])[0]]), int(k)


class DecoupledCoordinates:
    """Coordinates z, x = V z, of two parts that hardly know of each other: the first `fast` states, and the rest.

    V D V' e^{2 rate s} stays above e^{As} V D V' e^{A's} for D = diag(d_1 I, d_2 I), d_1, d_2 >= FLOOR max(d_1, d_2).
    """

    def __init__(self, A: Matrix, V: Array, fast: int) -> None:
        basis = matrix(V)
        inverse = basis.inv()
        rows = (inverse * A * basis).tolist()
        own, coupled = [], ball(0.0)
        for i, j in ((slice(0, fast), slice(fast, None)), (slice(fast, None), slice(0, fast))):
            part = stacked([row[i] for row in rows[i]])
            own.append(largest((part + part.transpose()) * ball(0.5)))
            coupled += frobenius(stacked([row[j] for row in rows[i]]))
        self.rate = (max(*own, ball(0.0)) + coupled / ball(FLOOR).sqrt()).upper()
        parts, across = (slice(0, fast), slice(fast, None)), basis.transpose().tolist()
        heads = [stacked(inverse.tolist()[part]) for part in parts]
        spans = [stacked(across[part]) for part in parts]
        self.sizes = [head.transpose() * head * ball(2.0) for head in heads]  # of a part: trace(N sizes)
        self.spans = [span.transpose() * span for span in spans]

    def above(self, N: Matrix) -> Matrix:
        """V D V' >= N, N psd, which may be carried along: N <= 2 diag(N_11, N_22) in its own coordinates."""
        d = [positive_part((N * size).trace()) for size in self.sizes]
        least = (max(d) * ball(FLOOR)).upper()
        made: Matrix = max(d[0], least) * self.spans[0] + max(d[1], least) * self.spans[1]
        return made


class BallFlow:
    """Y' = A Y + Y A' + S, with S psd, over any duration: Y -> F Y F' + W, in balls."""

    def __init__(self, A: Matrix, S: Matrix) -> None:
        self.A, self.S, self.n = A, S, A.nrows()
        self.undriven = all(entry == 0 for entry in S.entries())
        self.At, self.square = A.transpose(), A * A
        self.constant = A * S + S * self.At
        self.identity = identity(self.n)
        self._kept: dict[object, tuple[Matrix, Matrix]] = {}
        self._reach: dict[object, Ball] = {}
        self.norm = frobenius(A).upper()
        self.size = float(self.norm)

    @cached_property
    def growths(self) -> list[tuple[Ball, Ball]]:
        """(kappa, mu) with |e^{As}| <= kappa e^{mu s}, from the symmetric part of A and from modal coordinates."""
        modal = self._modal()
        return [(ball(1.0), largest((self.A + self.At) * ball(0.5))), *([] if modal is None else [modal])]

    @cached_property
    def split(self) -> DecoupledCoordinates | None:
        """What is fast apart from what is slow, if anything is."""
        return self._decoupled()

    def _modal(self) -> tuple[Ball, Ball] | None:
        """(kappa, mu) with |e^{As}| <= kappa e^{mu s} from real modal coordinates, guessed in floats."""
        guess = floats(self.A)
        if not self.n or not np.isfinite(guess).all():
            return None
        try:
            values, vectors = np.linalg.eig(guess)
        except np.linalg.LinAlgError:
            return None
        keep = values.imag >= 0
        parts = [v.real for v in vectors.T[keep]] + [v.imag for v in vectors.T[values.imag > 0]]
        V = np.array(parts).T
        V = V / np.linalg.norm(V, axis=0)
        if V.shape != guess.shape or not np.linalg.cond(V) < WORST_CONDITION:
            return None
        X = matrix(V)
        inverse = X.inv()
        B = inverse * self.A * X
        return (spectral(X) * spectral(inverse)).upper(), largest((B + B.transpose()) * ball(0.5))

    def _decoupled(self) -> DecoupledCoordinates | None:
        """What is fast apart from what is slow, guessed in floats: what is carried so knows two speeds, not one."""
        guess, best = floats(self.A), None
        if self.n < 2 or not np.isfinite(guess).all():
            return None
        try:
            bases = [found for found in split_bases(guess) if np.linalg.cond(found[0]) < WORST_CONDITION]
        except np.linalg.LinAlgError:
            return None
        for V, fast in bases:
            made = DecoupledCoordinates(self.A, V, fast)
            if best is None or made.rate < best.rate:
                best = made
        return best

    def over(self, duration: Ball) -> tuple[Matrix, Matrix]:
        """Return F = e^{Ah} and W = int_0^h e^{As} S e^{A's} ds: a block exponential on h/2^k, then k doublings."""
        key = (duration.mid().man_exp(), duration.rad().man_exp())
        if key not in self._kept:
            doublings = max(0, int(np.ceil(np.log2(max(float(duration) * self.size, 1e-300)))) + 1)
            F, W = self._short_flow(duration / 2**doublings)
            for _ in range(doublings):
                W, F = W if self.undriven else W + F * W * F.transpose(), F * F
            self._kept[key] = F, W
        return self._kept[key]

    def _short_flow(self, h: Ball) -> tuple[Matrix, Matrix]:
        n = self.n
        if self.undriven:
            return (self.A * h).exp() if n else self.A, self.S
        first, noise, last = ((M * h).tolist() for M in (-self.A, self.S, self.At))
        rows = [[*a, *s] for a, s in zip(first, noise, strict=True)] + [[*[ball(0.0)] * n, *a] for a in last]
        E = stacked(rows).exp().tolist()
        F = stacked([row[n:] for row in E[n:]]).transpose()
        return F, F * stacked([row[n:] for row in E[:n]])

    def step(self, Y: Matrix, duration: Ball) -> Matrix:
        """Return Y after `duration`."""
        F, W = self.over(duration)
        stepped = F * Y * F.transpose()
        return stepped if self.undriven else stepped + W

    def second(self, Y: Matrix) -> Matrix:
        """Return Y''."""
        part = self.square * Y + self.A * Y * self.At
        return part + part.transpose() + self.constant

    def slope(self, Y: Matrix) -> Matrix:
        """Return Y'."""
        part = self.A * Y
        return part + part.transpose() + self.S

    def carried(self, N: Matrix, duration: Ball) -> Matrix:
        """A matrix that stays above e^{As} N e^{A's}, N psd, over [0, duration]: N itself where that is short."""
        total = sum((N[i, i] for i in range(self.n)), 0 * duration)
        grown = self.reach(duration) * 8 / duration**2
        near = (2 * self.norm * duration).expm1().upper()
        found = N + near * total * self.identity if near < grown else grown * total * self.identity
        if self.split is None:
            return found
        other = self.split.above(N) * (2 * self.split.rate * duration).exp().upper()
        return other if np.trace(floats(other)) < np.trace(floats(found)) else found

    def reach(self, duration: Ball) -> Ball:
        """Return an exact number that is at least (h^2/8) sup |e^{As}|^2 over [0, h]."""
        key = (duration.mid().man_exp(), duration.rad().man_exp())
        if key not in self._reach:
            bounds = [k * k * (2 * mu * duration).exp() if mu > 0 else k * k for k, mu in self.growths]
            flow = min((b.upper() for b in bounds), key=float)
            self._reach[key] = (flow * duration * duration / 8).upper()
        return self._reach[key]


class FlowNode:
    """A moment of a flow: Y there, what it certainly stays below, and how far it can bulge over the next chord."""

    def __init__(self, flow: BallFlow, Y: Matrix, top: Callable[[Matrix], Ball]) -> None:
        self.flow, self.Y, self.top = flow, Y, top(Y)
        self._second: Matrix | None = None
        self._falling: tuple[Matrix, Matrix] | None = None
        self._sag: Ball | None = None

    def bulges(self, duration: Ball) -> Iterator[Ball]:
        """Yield bounds of Y over its chord, as a multiple of I: first by norms, then by the least eigenvalue of Y''."""
        reach = self.flow.reach(duration)
        if self._second is None:
            self._second = self.flow.second(self.Y)
        if self._sag is None:
            yield reach * frobenius(self._second)
            self._sag = positive_part(largest(-self._second))
        yield reach * self._sag

    def bounds(self, right: FlowNode, duration: Ball, top: Callable[[Matrix], Ball], slope: Ball) -> Iterator[Ball]:
        """Yield bounds of `top` along the step to `right`, the cheap ones first."""
        ends = max(self.top, right.top)
        for bulge in self.bulges(duration):
            yield ends + slope * bulge
        if self._falling is None:
            assert self._second is not None
            self._falling = fallen(self.flow.slope(self.Y)), fallen(self._second)
        yield top(right.Y + duration * self.flow.carried(self._falling[0], duration))
        bend = duration**2 / 8 * self.flow.carried(self._falling[1], duration)
        yield top(self.Y + bend).max(top(right.Y + bend))

    def after(self, duration: Ball, top: Callable[[Matrix], Ball]) -> FlowNode:
        """The node `duration` later."""
        return FlowNode(self.flow, self.flow.step(self.Y, duration), top)


def fallen(M: Matrix) -> Matrix:
    """A psd matrix that is at least -M: its negative part, guessed in floats."""
    guess, n = floats(M), M.nrows()
    parts = matrix(np.zeros((n, n)))
    if n and np.isfinite(guess).all():
        values, vectors = np.linalg.eigh((guess + guess.T) / 2)
        half = matrix(vectors * np.sqrt(np.maximum(-values, 0.0)))
        parts = half * half.transpose()
    return parts + positive_part(largest(-(M + parts))) * identity(n)


Chord = tuple[FlowNode, FlowNode, Ball, int]


def highest(
    flow: BallFlow,
    Y: Matrix,
    duration: Ball,
    clock: Budget,
    top: Callable[[Matrix], Ball] = largest,
    slope: Ball | None = None,
    limit: Ball | None = None,
) -> Ball | None:
    """Return a number <= `limit` (1 by default) that `top` stays below along the whole flow, or None if none is proven.

    `top(Y)` must be convex along chords, monotone, and rise by at most `slope` r when Y rises by r I.
    """
    slope, limit = ball(1.0) if slope is None else slope, ball(1.0) if limit is None else limit
    left = FlowNode(flow, Y, top)
    right = left.after(duration, top)
    if not (left.top <= limit and right.top <= limit):
        return None
    reached = max(left.top, right.top)

    def parts_of(chord: Chord) -> list[Chord] | None:
        nonlocal reached
        left, right, length, depth = chord
        least = float("inf")
        for bound in left.bounds(right, length, top, slope):
            if (upper := bound.upper()) <= limit:
                reached = max(reached, upper)
                return []
            least = min(least, float(upper))
        times = _halvings(least, float(max(left.top, right.top)), float(limit))
        if depth + times > HALVINGS:
            return None
        length, nodes = length / 2**times, [left]
        while len(nodes) < 2**times:
            nodes.append(nodes[-1].after(length, top))
            if not nodes[-1].top <= limit:
                return None
        pairs = pairwise([*nodes, right])
        return [(node, following, length, depth + times) for node, following in pairs][::-1]

    return reached if all_proven([(left, right, duration, 0)], parts_of, clock, 150 + flow.n**3) else None


def _halvings(bound: float, ends: float, limit: float) -> int:
    """How often to halve a chord whose bound is too high: what a bound adds to the ends falls with its square."""
    room, added = limit - ends, bound - ends
    if not 0 < room < added < np.inf:
        return 1
    return int(np.clip(np.ceil(np.log2(added / room) / 2), 1, AT_ONCE))
