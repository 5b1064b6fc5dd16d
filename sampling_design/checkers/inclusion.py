"""Claim "inclusion": weights that hold for every plant of a model, for all gaps in a range and every window start.

P(tau), tau the time since the last sample, is linear between its nodes. It proves, for the very doubles in the file,

1. flow: [-(P' + A'P + PA + eta P), -PG; -G'P, Qw] > 0 at both ends of every piece, for every (A, G) of the model;
2. jump: P(tau) + C'R~C - P(0) > 0 at every node in [shortest, longest], for every C of the model;
3. (1 + margin) P1 < P(tau) < P2 at every node, and (1 - 1e-3) P2 < lam P1.

Flow is linear in P, P' and (A, G), so that both ends of a piece and the corners of a box decide. Jump is linear in P;
C'R~C is at least C'R~C0 + C0'R~C - C0'R~C0, which is linear in C, with C0 the plant's. A nonlinear plant: its region is
cut into cells, whose Jacobians lie between the ends that interval arithmetic gives (`programs.py`), until each is
proven; the difference of two of its trajectories has a mean of such Jacobians. Each least eigenvalue is found in
floats with a bound of all rounding, relative to the size of its terms.
"""

from collections.abc import Callable
from itertools import product

import numpy as np

from .inclusion_file import INCLUSION, Box, Inclusion, Parameter, Region, Vertices, inclusion, moved
from .numbers import EPS, RESOLUTION, SAFE, symmetric
from .outcome import Proven, Refused, Undecided, holds
from .parts import Claim
from .robust import definite_robustly
from .slopes import Parts, enclosed
from .strict import Array, Mask
from .work import Work

FLOW = "[P' + A'P + PA + eta P, PG; G'P, -Qw] < 0"
JUMP = "P(0) < P(tau) + C'R~C"
EIGENVALUES = 8  # those of an (n, n) matrix M are computed to within this times n eps |M|_F
BELOW = 1e-10  # share by which R~ is taken smaller than its floats, so that its own inequality has room
MOST_PARAMETERS = 10  # of a box whose corners are tried one by one; beyond that multipliers are needed
CORNERS = 6  # directions of a cell's Jacobian whose corners are tried; the others are a perturbation
MORE_CORNERS, FEW = 10, 16  # the same where no more than so many cells are judged at once
SMALL = 1e-3  # share of the widest direction below which one is left to the perturbation
MOST_MATRICES = 1_500_000  # matrices of one proof over cells
BATCH = 40_000


def prove(c: Inclusion) -> tuple[str, float]:
    """Prove all inequalities; return what was proven and the least relative slack."""
    name = f"{FLOW}, {JUMP}"
    if not c.plant.n:
        return name, 1.0
    w, P = c.weights, (c.P + np.swapaxes(c.P, 1, 2)) / 2
    for key, M in (("P1", w.P1), ("P2", w.P2), ("Qw", w.Qw), ("R", w.R), ("Qv", w.Qv), *(("P(tau)", X) for X in c.P)):
        symmetric(key, M, np.sqrt(np.abs(np.diag(M))))
    P1, P2, Qw, R, Qv = ((M + M.T) / 2 for M in (w.P1, w.P2, w.Qw, w.R, w.Qv))
    plain(P, *(c.plant.A, c.plant.C, c.plant.G), *(P1, P2, Qw, R, Qv))
    slack = 1.0
    for key, M in (("P1 > 0", P1), ("Qw > 0", Qw), ("R > 0", R), ("Qv > 0", Qv)):
        slack = min(slack, least(key, M[None], np.abs(M)[None]))
    low, top = (1 + w.margin) * P1, w.lam * P1
    slack = min(slack, least("(1 + margin) P1 < P(tau)", P - low, np.abs(P) + np.abs(low), c.nodes))
    slack = min(slack, least("P(tau) < P2", P2 - P, np.abs(P) + np.abs(P2), c.nodes))
    share = (1 - RESOLUTION) * P2
    slack = min(slack, least("(1 - 1e-3) P2 < lam P1", (top - share)[None], (np.abs(top) + np.abs(share))[None]))
    Rt = together(R, Qv)
    return name, min(slack, jumps(c, P, Rt), flows(c, P, Qw))


def plain(*matrices: Array) -> None:
    """Undecided if numbers are so large or small that products leave the range of doubles."""
    sizes = np.abs(np.concatenate([M.ravel() for M in matrices]))
    if np.any(~np.isfinite(sizes) | (sizes > SAFE[1] ** 0.5) | ((sizes != 0) & (sizes < SAFE[0] ** 0.5))):
        raise Undecided("range", "some numbers are too large or too small for an honest check in doubles")


def together(R: Array, Qv: Array) -> Array:
    """A matrix that is certainly at most (R^-1 + Qv^-1)^-1: X with [[R - X, -X], [-X, Qv - X]] >= 0."""
    X = R @ np.linalg.solve(R + Qv, Qv)
    X = (1 - BELOW) * (X + X.T) / 2
    size = np.abs(X)
    least(
        "R~",
        np.block([[R - X, -X], [-X, Qv - X]])[None],
        np.block([[abs(R) + size, size], [size, abs(Qv) + size]])[None],
    )
    return np.asarray(X)


def bounds(form: Array, terms: Array, radius: Array | None = None) -> Parts:
    """Lower and upper bounds of the least eigenvalue of each matrix, relative to the size of its diagonal's terms."""
    d = np.sqrt(np.einsum("kii->ki", terms))
    d = np.where(d > 0, d, 1.0)
    scale = d[:, :, None] * d[:, None, :]
    M, m = form / scale, form.shape[-1]
    values = np.linalg.eigvalsh(M)[:, 0]
    rounding = EPS * (
        (m + 16) * np.linalg.norm(terms / scale, axis=(1, 2)) + EIGENVALUES * m * np.linalg.norm(M, axis=(1, 2))
    )
    if radius is not None:
        rounding = rounding + np.linalg.norm(radius / scale, axis=(1, 2))
    rounding = np.where(np.isfinite(rounding), rounding, np.inf)
    return values - rounding, values + rounding


def least(name: str, form: Array, terms: Array, times: Array | None = None, radius: Array | None = None) -> float:
    """The least slack of matrices that are all members of the claim; Refused or Undecided where one is not positive."""
    below, above = bounds(form, terms, radius)
    k = int(np.argmin(above))
    when = None if times is None else float(times[k])
    at = "" if when is None else f" at tau = {when:.6g}"
    if above[k] < 0:
        raise Refused(name, f"{name} fails by {-above[k]:.3g} of the size of its terms{at}", float(above[k]), when)
    k = int(np.argmin(below))
    if not below[k] > 0:
        when = None if times is None else float(times[k])
        raise Undecided(name, f"{name} could not be decided: it is tight or nearly so", float(below[k]), when)
    return float(below[k])


# --- the members of a box or a list ----------------------------------------------------------------------------------


def corners(c: Inclusion, base: Array, part: Callable[[Parameter], Array]) -> Parts:
    """Values of one matrix at all corners of a box that differ, and the rounding of each entry."""
    assert isinstance(c.model, Box)
    acting = [each for each in c.model.parameters if part(each).any() and each.low < each.high]
    if len(acting) > MOST_PARAMETERS:
        raise Undecided("corners", f"{len(acting)} parameters have too many corners: the file has no multipliers")
    ends = np.array(list(product(*((each.low - each.nominal, each.high - each.nominal) for each in acting))))
    ends = ends.reshape(2 ** len(acting), len(acting))
    parts = np.array([part(each) for each in acting]).reshape(len(acting), *base.shape)
    size = np.abs(base) + np.tensordot(np.abs(ends), np.abs(parts), 1)
    return base + np.tensordot(ends, parts, 1), (len(acting) + 4) * EPS * size


def joint(c: Inclusion) -> Parts:
    """(A, G) side by side at all vertices of the model, with their rounding."""
    if isinstance(c.model, Vertices):
        M = np.concatenate([c.model.A, c.model.G], axis=2)
        return M, 0 * M
    return corners(c, np.hstack([c.plant.A, c.plant.G]), lambda each: np.hstack([each.A, each.G]))


def outputs(c: Inclusion) -> Parts:
    """C at all vertices of the model, with its rounding."""
    if isinstance(c.model, Vertices):
        return c.model.C, 0 * c.model.C
    return corners(c, c.plant.C, lambda each: each.C)


# --- flow ------------------------------------------------------------------------------------------------------------


def pieces(c: Inclusion, P: Array) -> tuple[Array, Array, Array, Array]:
    """P at both ends of every piece, its slope there, the size of the slope's terms, and tau."""
    h = np.diff(c.nodes)[:, None, None]
    slope, size = np.diff(P, axis=0) / h, (np.abs(P[1:]) + np.abs(P[:-1])) / h
    both = np.stack([P[:-1], P[1:]], axis=1).reshape(-1, *P.shape[1:])
    taus = np.stack([c.nodes[:-1], c.nodes[1:]], axis=1).ravel()
    return both, np.repeat(slope, 2, axis=0), np.repeat(size, 2, axis=0), taus


def flow_forms(P: Array, slope: Array, size: Array, A: Array, G: Array, Qw: Array, eta: float) -> Parts:
    """The matrices of 1 for P (K, n, n) and A, G of the same stack, and the sizes of their terms."""
    drift, off = P @ A, -(P @ G)
    corner = -(slope + drift + np.swapaxes(drift, 1, 2) + eta * P)
    dabs = np.abs(P) @ np.abs(A)
    terms = size + dabs + np.swapaxes(dabs, 1, 2) + eta * np.abs(P)
    Q = np.broadcast_to(Qw, (len(P), *Qw.shape))
    oabs = np.abs(P) @ np.abs(G)
    form = np.concatenate([np.concatenate([corner, off], 2), np.concatenate([np.swapaxes(off, 1, 2), Q], 2)], 1)
    sizes = np.concatenate(
        [np.concatenate([terms, oabs], 2), np.concatenate([np.swapaxes(oabs, 1, 2), np.abs(Q)], 2)], 1
    )
    return form, sizes


def spread(P: Array, E: Array, EG: Array) -> Array:
    """Bounds of the entries by which `flow_forms` changes where A and G are off by at most E and EG."""
    drift, off, q = np.abs(P) @ E, np.abs(P) @ EG, EG.shape[-1]
    corner = drift + np.swapaxes(drift, 1, 2)
    zero = np.zeros((len(P), q, q))
    return np.concatenate([np.concatenate([corner, off], 2), np.concatenate([np.swapaxes(off, 1, 2), zero], 2)], 1)


def flows(c: Inclusion, P: Array, Qw: Array) -> float:
    """Prove 1; return the least slack."""
    both, slope, size, taus = pieces(c, P)
    if isinstance(c.model, Region):

        def judge(A: Array, EA: Array, G: Array, EG: Array) -> Parts:
            k, m = len(A), len(both)
            stack = np.tile(both, (k, 1, 1))
            A, EA, G, EG = (np.repeat(X, m, axis=0) for X in (A, EA, G, EG))
            form, terms = flow_forms(
                stack, np.tile(slope, (k, 1, 1)), np.tile(size, (k, 1, 1)), A, G, Qw, c.weights.eta
            )
            below, above = bounds(form, terms, spread(stack, EA, EG))
            return below.reshape(k, m).min(axis=1), above.reshape(k, m).min(axis=1)

        def robust(M: Array, E: Array, moving: Array) -> tuple[Array, int]:
            k, m, n = len(M), len(both), c.plant.n
            stack, none = np.tile(both, (k, 1, 1)), np.zeros((k * m, n, n))
            slopes, sizes = (np.tile(X, (k, 1, 1)) for X in (slope, size))
            M, E = np.repeat(M, m, axis=0), np.repeat(E, m, axis=0)
            D = np.repeat(moving, m, axis=1)
            top = np.abs(M) + E + np.abs(D).sum(axis=0)
            form, _ = flow_forms(stack, slopes, sizes, M[:, :, :n], M[:, :, n:], Qw, c.weights.eta)
            _, terms = flow_forms(stack, slopes, sizes, top[:, :, :n], top[:, :, n:], Qw, c.weights.eta)
            moves = [flow_forms(stack, none, none, d[:, :, :n], d[:, :, n:], 0 * Qw, 0.0)[0] for d in D]
            stacked = np.array(moves).reshape(len(D), *form.shape)
            left, spent = definite_robustly(form, terms, stacked, spread(stack, E[:, :, :n], E[:, :, n:]))
            return left.reshape(k, m).min(axis=1), spent

        return Cells(c, c.model, P).prove(FLOW, judge, True, len(both), robust)
    if c.multipliers is not None:
        return multiplied(c, both, slope, size, taus, Qw)
    slack = 1.0
    n = c.plant.n
    for M, E in zip(*joint(c), strict=True):
        stacks = [np.broadcast_to(X, (len(both), *X.shape)) for X in (M[:, :n], E[:, :n], M[:, n:], E[:, n:])]
        form, terms = flow_forms(both, slope, size, stacks[0], stacks[2], Qw, c.weights.eta)
        slack = min(slack, least(FLOW, form, terms, taus, spread(both, stacks[1], stacks[3])))
    return slack


def multiplied(c: Inclusion, both: Array, slope: Array, size: Array, taus: Array, Qw: Array) -> float:
    """Prove 1 with multipliers: p_k = delta_k z_k, |delta_k| <= 1, for every column z_k that a parameter moves.

    (x, w)'N(A0, G0)(x, w) - 2 x'P sum_k l_k p_k + sum_k m_k (p_k^2 - z_k^2) > 0, m_k >= 0, N at the middle of the box.
    """
    assert isinstance(c.model, Box)
    assert c.multipliers is not None
    n, q = c.plant.n, c.plant.G.shape[1]
    middle, rounding = np.hstack([c.plant.A, c.plant.G]), 0.0
    columns: list[Array] = []
    chosen: list[int] = []
    off = np.abs(middle)
    for each in c.model.parameters:
        M = np.hstack([each.A, each.G])
        to = (each.low - each.nominal) / 2 + (each.high - each.nominal) / 2
        half = np.nextafter((each.high - each.low) / 2, np.inf) * (1 + 4 * EPS) + 4 * EPS * abs(to)
        middle, off = middle + to * M, off + (abs(to) + half) * np.abs(M)
        for k in moved(each):
            columns.append(half * M[:, k])
            chosen.append(k)
    rounding = (len(c.model.parameters) + 8) * EPS
    A, G = middle[:, :n], middle[:, n:]
    stack = [np.broadcast_to(X, (len(both), *X.shape)) for X in (A, rounding * off[:, :n], G, rounding * off[:, n:])]
    form, terms = flow_forms(both, slope, size, stack[0], stack[2], Qw, c.weights.eta)
    L, lam = np.array(columns).reshape(-1, n).T, c.multipliers.reshape(len(both), -1)
    m = L.shape[1]
    side, top = np.zeros((len(both), n + q, m)), np.zeros((len(both), n + q, n + q))
    side[:, :n], sides = -(both @ L), np.zeros_like(side)
    sides[:, :n] = np.abs(both) @ np.abs(L)
    for k, z in enumerate(chosen):
        top[:, z, z] += lam[:, k]
    corner = np.einsum("ki,ij->kij", lam, np.eye(m))
    full = np.concatenate(
        [np.concatenate([form - top, side], 2), np.concatenate([np.swapaxes(side, 1, 2), corner], 2)], 1
    )
    sizes = np.concatenate(
        [np.concatenate([terms + top, sides], 2), np.concatenate([np.swapaxes(sides, 1, 2), corner], 2)], 1
    )
    radius = np.zeros_like(full)
    radius[:, : n + q, : n + q] = spread(both, stack[1], stack[3])
    return least(FLOW + " with multipliers", full, sizes, taus, radius)


# --- jump ------------------------------------------------------------------------------------------------------------


def jumps(c: Inclusion, P: Array, Rt: Array) -> float:
    """Prove 2; return the least slack."""
    inside = (c.nodes >= c.shortest) & (c.nodes <= c.longest)
    later, taus, C0 = P[inside], c.nodes[inside], c.plant.C

    def forms(C: Array, EC: Array) -> tuple[Array, Array, Array]:
        cross, size = np.swapaxes(C, 1, 2) @ Rt @ C0, np.abs(np.swapaxes(C, 1, 2)) @ np.abs(Rt) @ np.abs(C0)
        own = C0.T @ Rt @ C0
        seen = cross + np.swapaxes(cross, 1, 2) - own
        terms = size + np.swapaxes(size, 1, 2) + np.abs(C0.T) @ np.abs(Rt) @ np.abs(C0)
        off = np.swapaxes(EC, 1, 2) @ np.abs(Rt) @ np.abs(C0)
        count, m = len(C), len(later)
        seen, terms, off = (np.repeat(X, m, axis=0) for X in (seen, terms, off + np.swapaxes(off, 1, 2)))
        form = np.tile(later - P[0], (count, 1, 1)) + seen
        return form, np.tile(np.abs(later) + np.abs(P[0]), (count, 1, 1)) + terms, off

    if isinstance(c.model, Region):

        def judge(C: Array, EC: Array, _: Array, __: Array) -> Parts:
            below, above = bounds(*forms(C, EC))
            return below.reshape(len(C), -1).min(axis=1), above.reshape(len(C), -1).min(axis=1)

        return Cells(c, c.model, P).prove(JUMP, judge, False, len(later))
    C, EC = outputs(c)
    form, terms, off = forms(C, EC)
    return least(JUMP, form, terms, np.tile(taus, len(C)), off)


# --- the cells of a nonlinear plant's region -------------------------------------------------------------------------


class Cells:
    """The region of a nonlinear plant, halved until the Jacobians of every cell are proven."""

    def __init__(self, c: Inclusion, region: Region, P: Array) -> None:
        self.c, self.region = c, region
        self.n = c.plant.n
        root = np.sqrt(np.einsum("kii->i", P) / len(P))
        self.x = root
        rate = np.abs(np.diag(c.plant.A)) + c.weights.eta + 1 / c.longest
        self.pace = np.sqrt(rate)
        self.push = np.sqrt(np.diag(c.weights.Qw))
        self.sight = 1 / np.sqrt(1 / np.diag(c.weights.R) + 1 / np.diag(c.weights.Qv))

    def prove(
        self,
        name: str,
        judge: Callable[[Array, Array, Array, Array], Parts],
        of_f: bool,
        each: int,
        robust: Callable[[Array, Array, Array], tuple[Array, int]] | None = None,
    ) -> float:
        """Prove that `judge` is positive for every Jacobian in the region; return the least slack.

        `judge` takes A, its radius, G, its radius (C and its radius twice for outputs) and bounds a relative slack.
        """
        low = np.concatenate([self.region.low[key] for key in ("x", "u", "w")])[None]
        high = np.concatenate([self.region.high[key] for key in ("x", "u", "w")])[None]
        slack, spent = 1.0, 0
        while len(low):
            inside = self.inside(low, high)
            low, high = low[inside], high[inside]
            if not len(low):
                break
            M, E, moving = self.spread(low, high, of_f)
            good = np.zeros(len(low), bool)
            most = BATCH if robust is None else max(1, BATCH // (8 * each))
            for first in range(0, len(low), most):
                part = slice(first, first + most)
                parts = M[part], E[part], moving[:, part]
                if robust is None:
                    good[part], spent, slack = self.judged(parts, judge, of_f, each, spent, slack)
                    continue
                left, tried = robust(*parts)
                good[part], spent = left > 0, spent + tried
                slack = min(slack, float(left[left > 0].min(initial=1.0)))
            if good.all():
                break
            low, high = low[~good], high[~good]
            self.refute(name, low, high, judge, of_f)
            if spent > MOST_MATRICES:
                raise Undecided(name, f"{name} could not be decided: {len(low)} cells of the region are left")
            low, high = self.halved(name, low, high, of_f)
        return slack

    def inside(self, low: Array, high: Array) -> Mask:
        """Cells that are not certainly outside of the half-spaces."""
        found = np.ones(len(low), bool)
        for row, offset in zip(self.region.rows, self.region.offsets, strict=True):
            ends = np.where(row > 0, low[:, : self.n] * row, np.where(row < 0, high[:, : self.n] * row, 0.0))
            room = (self.n + 2) * EPS * (np.abs(ends).sum(axis=1) + abs(offset))
            found &= ~(ends.sum(axis=1) - room > offset)
        return found

    def jacobians(self, low: Array, high: Array, of_f: bool) -> Parts:
        """Middles and radii of (A, G) side by side, or of C, over each cell."""
        M, E, moving = self.spread(low, high, of_f)
        return M, E + np.abs(moving).sum(axis=0)

    def spread(self, low: Array, high: Array, of_f: bool) -> tuple[Array, Array, Array]:
        """Middles, radii, and matrices of which any multiples in [-1, 1] may be added; see `slopes.py`."""
        return enclosed(self.region, low, high, of_f)

    def effect(self, E: Array, of_f: bool) -> Array:
        """Sizes of the radii in units in which the diagonals of what is proven are about 1."""
        if not of_f:
            return np.asarray(E * self.sight[:, None] / self.x)
        left, right = self.x / self.pace, np.concatenate([self.x * self.pace, self.push])
        return np.asarray(E * left[:, None] / right)

    def judged(
        self,
        parts: tuple[Array, Array, Array],
        judge: Callable[[Array, Array, Array, Array], Parts],
        of_f: bool,
        each: int,
        spent: int,
        slack: float,
    ) -> tuple[Mask, int, float]:
        """Which cells are proven; the corners of the widest directions, and the others as a perturbation."""
        M, E, moving = parts
        finite = np.isfinite(E).all(axis=(1, 2)) & np.isfinite(moving).all(axis=(0, 2, 3))
        good = np.zeros(len(M), bool)
        if not finite.any():
            return good, spent, slack
        E, M, moving = E[finite], M[finite], moving[:, finite]
        worth = np.array([self.effect(np.abs(D), of_f).max() for D in moving])
        order = np.argsort(-worth)
        most = CORNERS if len(M) > FEW else MORE_CORNERS
        wide = [int(k) for k in order[:most] if worth[k] > SMALL * worth.max(initial=0.0)]
        others = [k for k in range(len(moving)) if k not in wide]
        signs = np.array(list(product((-1.0, 1.0), repeat=len(wide)))).reshape(2 ** len(wide), len(wide))
        size = np.abs(moving[wide]).sum(axis=0)
        off = E + np.abs(moving[others]).sum(axis=0) + np.where(size > 0, EPS * (len(wide) + 2) * (np.abs(M) + size), 0)
        least_of = np.full(len(M), np.inf)
        for sign in signs:
            at = M + np.tensordot(sign, moving[wide], 1)
            spent += each * len(M)
            for first in range(0, len(M), max(1, BATCH // each)):
                part = slice(first, first + max(1, BATCH // each))
                below, _ = judge(*self.split(at[part], off[part], of_f))
                least_of[part] = np.minimum(least_of[part], below)
        good[finite] = least_of > 0
        kept = least_of[least_of > 0]
        return good, spent, min(slack, float(kept.min(initial=1.0)))

    def split(self, M: Array, E: Array, of_f: bool) -> tuple[Array, Array, Array, Array]:
        """A, its radius, G, its radius; or C and its radius, twice."""
        return (M[:, :, : self.n], E[:, :, : self.n], M[:, :, self.n :], E[:, :, self.n :]) if of_f else (M, E, M, E)

    def refute(
        self, name: str, low: Array, high: Array, judge: Callable[[Array, Array, Array, Array], Parts], of_f: bool
    ) -> None:
        """Refused if the inequality fails at the Jacobian in the middle of some cell that lies in the region."""
        with np.errstate(invalid="ignore"):
            at = np.where(np.isfinite(low) & np.isfinite(high), low / 2 + high / 2, np.clip(0.0, low, high))
        at = at[:64]
        held = np.all(self.region.rows @ at[:, : self.n].T <= self.region.offsets[:, None], axis=0)
        if not held.any():
            return
        M, E = self.jacobians(at[held], at[held], of_f)
        fine = np.isfinite(E).all(axis=(1, 2))
        if not fine.any():
            return
        _, above = judge(*self.split(M[fine], E[fine], of_f))
        k = int(np.argmin(above))
        if above[k] < 0:
            x = at[held][fine][k, : self.n]
            where = ", ".join(f"{v:.6g}" for v in x)
            amount, reason = float(above[k]), f"{name} fails by {-above[k]:.3g} of its terms at x = [{where}]"
            raise Refused(name, reason, amount, direction=x.tolist())

    @staticmethod
    def finite(low: Array, high: Array) -> Mask:
        """Sides of cells that can be halved."""
        found: Mask = np.isfinite(low) & np.isfinite(high) & (low < high)
        return found

    def halved(self, name: str, low: Array, high: Array, of_f: bool) -> Parts:
        """Both halves of each cell, along the side that narrows the Jacobian most."""
        best, side = np.full(len(low), np.inf), np.full(len(low), -1)
        sides = [j for j in range(low.shape[1]) if np.any(self.finite(low, high)[:, j])]
        pairs = []
        for j in sides:
            finite = self.finite(low, high)[:, j]
            middle = np.where(finite, low[:, j] / 2 + high[:, j] / 2, 0.0)
            left, right = high.copy(), low.copy()
            left[:, j], right[:, j] = np.where(finite, middle, high[:, j]), np.where(finite, middle, low[:, j])
            pairs += [(low, left), (right, high)]
        if pairs:
            lows, highs = (np.concatenate([pair[k] for pair in pairs]) for k in (0, 1))
            size = np.minimum(self.effect(self.jacobians(lows, highs, of_f)[1], of_f), 1e100)
            costs = np.square(size).sum(axis=(1, 2)).reshape(len(sides), 2, len(low)).sum(axis=1)
            for j, cost in zip(sides, costs, strict=True):
                better = self.finite(low, high)[:, j] & (cost < best)
                best, side = np.where(better, cost, best), np.where(better, j, side)
        if np.any(side < 0):
            raise Undecided(name, f"{name} could not be decided: a cell of the region cannot be halved")
        rows = np.arange(len(low))
        middle = low[rows, side] / 2 + high[rows, side] / 2
        left, right = high.copy(), low.copy()
        left[rows, side], right[rows, side] = middle, middle
        return np.concatenate([low, right]), np.concatenate([left, high])


def proven(c: Inclusion, work: Work) -> Proven:
    """The proof, and what it proves in words."""
    return holds(*prove(c), "every plant of the model, all gaps in the range and every real window start")


CLAIM = Claim(INCLUSION, inclusion, proven)
