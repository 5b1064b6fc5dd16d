"""Claim "inclusion": weights that hold for every plant of a model, on every schedule of a family, from every start.

P(tau), tau the time since the last sample, is linear between its nodes. It proves, for the very doubles in the file,

1. flow: [-(P' + A'P + PA + eta P), -PG; -G'P, Qw] > 0 at both ends of every piece, for every (A, G) of the model;
2. jump: P(tau) + C'R~C - P(0) > 0 at every node where a sample may come, for every C of the model (`jumps.py`);
3. (1 + margin) P1 < P(tau) < P2 at every node, and (1 - 1e-3) P2 < lam P1.

Each word of the schedules' graph has a P(tau) of its own, and `cover.py` derives that every schedule is a path in it.
Flow is linear in P, P' and (A, G), so that both ends of a piece and the corners of a box decide. A nonlinear plant: its
region is cut into cells, whose Jacobians lie between the ends that interval arithmetic gives (`programs.py`), until
each is proven; the difference of two of its trajectories has a mean of such Jacobians. Each least eigenvalue is found
in floats with a bound of all rounding, relative to the size of its terms. Refuted is what some member breaks, shown.

Are matrices positive definite however far they are moved in given directions?

    F + sum_d s_d F_d + R > 0 for all |s_d| <= 1 and all R with |R| <= radius entrywise

A congruence with any W decides it as well: where W'(...)W > 0, W is regular and (...) > 0. With W about F^-1/2 the
first is about I, and what a direction takes from it is |W'F_d W| at most, |.| of a symmetric matrix that of its
eigenvalues. Signs of the widest directions are tried one after the other, and a branch ends where what those that are
left can take leaves it positive.
"""

from contextlib import suppress
from dataclasses import replace

import numpy as np

from .cover import judge
from .inclusion_file import INCLUSION, Inclusion, inclusion, moved
from .members import JUMP, Members, bounds, joint, least, prove_jumps, together
from .numbers import EPS, RESOLUTION, safe
from .outcome import MOST_WORK, Refused, Undecided, Verdict, WorkLimit, holds
from .parts import Claim
from .regions import Cells, Parts
from .strict import Array, Mask

EIGENVALUES = 8  # those of an (m, m) matrix M are computed to within this times m eps |M|_F
MOST_BRANCHES = 1 << 13  # signs that are open at once for one matrix


def definite_robustly(form: Array, terms: Array, moves: Array, radius: Array) -> tuple[Array, int]:
    """A lower bound of what is left of I for each matrix (-1 where nothing is proven), and how many were tried.

    `form` (K, m, m), its directions `moves` (D, K, m, m), `radius` (K, m, m); `terms` bounds the sizes of all terms
    that any entry was summed from, directions included.
    """
    count, m = form.shape[:2]
    left = np.full(count, -1.0)
    d = np.sqrt(np.maximum(np.einsum("kii->ki", form), 0.0))
    fine = np.isfinite(form).all(axis=(1, 2)) & np.isfinite(radius).all(axis=(1, 2)) & (d > 0).all(axis=1)
    fine &= np.isfinite(moves).all(axis=(0, 2, 3)) & np.isfinite(terms).all(axis=(1, 2))
    if not fine.any():
        return left, 0
    at = np.flatnonzero(fine)
    form, terms, moves, radius, d = form[at], terms[at], moves[:, at], radius[at], d[at]
    values, vectors = np.linalg.eigh(form / (d[:, :, None] * d[:, None, :]))
    W = vectors / np.sqrt(np.maximum(values, EPS))[:, None, :] / d[:, :, None]
    Wt, size = np.swapaxes(W, 1, 2), np.abs(W)
    X = Wt @ form @ W
    Y = Wt @ moves @ W
    X, Y = (X + np.swapaxes(X, 1, 2)) / 2, (Y + np.swapaxes(Y, 2, 3)) / 2
    rounding = (8 * m + 2 * len(moves) + 40) * EPS * terms + radius * (1 + 16 * m * EPS)
    lost = np.linalg.norm(np.swapaxes(size, 1, 2) @ rounding @ size, axis=(1, 2)) * (1 + 16 * m * EPS)
    own, axes = np.linalg.eigh(Y)
    norms = np.abs(own).max(axis=2, initial=0.0)
    order = np.argsort(-norms.max(axis=1, initial=0.0))
    taken = (axes * np.abs(own)[:, :, None, :]) @ np.swapaxes(axes, 2, 3)  # |Y|, and the rounding of the eigenvalues
    taken = taken + (64 * m * EPS * norms)[:, :, None, None] * np.eye(m)
    found, spent = branched(X, Y[order], taken[order], lost, values[:, 0] > 0)
    left[at] = found
    return left, spent


def branched(X: Array, Y: Array, taken: Array, lost: Array, begin: Mask) -> tuple[Array, int]:
    """The least of what is left over all signs, found by branching; -1 where it is not positive."""
    m = X.shape[-1]
    least, failed, spent = np.full(len(X), np.inf), ~begin, 0
    rest = np.concatenate([np.cumsum(taken[::-1], axis=0)[::-1], np.zeros((1, *X.shape))])
    lost = lost + 4 * len(Y) * EPS * np.linalg.norm(rest[0], axis=(1, 2))
    owner, at = np.flatnonzero(begin), X[begin]
    for k in range(len(Y) + 1):
        if not len(owner):
            break
        spent += len(owner)
        bound, after = (np.linalg.eigvalsh(M)[:, 0] for M in (at, at - rest[k][owner]))
        room = EIGENVALUES * m * EPS * (np.linalg.norm(at, axis=(1, 2)) + np.linalg.norm(rest[k], axis=(1, 2))[owner])
        bound, after = bound - room - lost[owner], after - room - lost[owner]
        done = after > 0
        np.minimum.at(least, owner[done], after[done])
        failed[owner[bound <= 0]] = True  # no branch below it can be better in its middle
        going = ~done & ~failed[owner]
        if k == len(Y):
            failed[owner[going]] = True
            break
        owner, at = owner[going], at[going]
        crowded = np.bincount(owner, minlength=len(X)) > MOST_BRANCHES
        failed |= crowded
        keep = ~crowded[owner]
        owner, at = owner[keep], at[keep]
        step = Y[k][owner]
        owner, at = np.concatenate([owner, owner]), np.concatenate([at + step, at - step])
    return np.where(failed | ~np.isfinite(least), -1.0, least), spent


FLOW = "[P' + A'P + PA + eta P, PG; G'P, -Qw] < 0"
SUBJECT = "every plant of the model, every schedule of the family and every real window start"
TURNS = 20  # of the search for a corner where multipliers fail


def prove(c: Inclusion, work: WorkLimit | None = None) -> Verdict:
    """Prove all inequalities."""
    name = f"{FLOW}, {JUMP}"
    work = WorkLimit(MOST_WORK) if work is None else work
    judge(c.family, c.graph)
    if not c.plant.n:
        return holds(name, 1.0, SUBJECT)
    w, P = c.weights, (c.P + np.swapaxes(c.P, 1, 2)) / 2
    P1, P2, Qw, R, Qv = ((M + M.T) / 2 for M in (w.P1, w.P2, w.Qw, w.R, w.Qv))
    safe(P, *(c.plant.A, c.plant.C, c.plant.G), *(P1, P2, Qw, R, Qv), power=4)
    slack = 1.0
    for key, M in (("P1 > 0", P1), ("Qw > 0", Qw), ("R > 0", R), ("Qv > 0", Qv)):
        slack = min(slack, least(key, M[None], np.abs(M)[None]))
    low, top = (1 + w.margin) * P1, w.lam * P1
    slack = min(slack, least("(1 + margin) P1 < P(tau)", P - low, np.abs(P) + np.abs(low), c.nodes))
    slack = min(slack, least("P(tau) < P2", P2 - P, np.abs(P) + np.abs(P2), c.nodes))
    share = (1 - RESOLUTION) * P2
    slack = min(slack, least("(1 - 1e-3) P2 < lam P1", (top - share)[None], (np.abs(top) + np.abs(share))[None]))
    Rt = together(R, Qv)
    slack = min(slack, prove_jumps(c, P, Rt, work), flows(c, P, Qw, work))
    return holds(name, slack, SUBJECT)


# --- flow ------------------------------------------------------------------------------------------------------------


def flow_block(P: Array, slope: Array | float, M: Array, Q: Array, eta: float, sign: int = -1) -> Array:
    """[[s (P' + A'P + PA + eta P), s PG], [s G'P, Q]], s = -1, for stacks of P and of M = (A, G) side by side.

    For s = 1 and the sizes of all numbers, the sum of the sizes of its terms.
    """
    n = P.shape[-1]
    led = sign * (P @ M)
    drift = led[..., :n]
    corner = sign * slope + drift + np.swapaxes(drift, 1, 2) + sign * eta * P
    return bordered(corner, led[..., n:], np.broadcast_to(Q, (len(P), *Q.shape)))


def bordered(corner: Array, side: Array, rest: Array) -> Array:
    """[[corner, side], [side', rest]] of stacks."""
    return np.concatenate(
        [np.concatenate([corner, side], axis=2), np.concatenate([np.swapaxes(side, 1, 2), rest], axis=2)], axis=1
    )


class Flow:
    """The matrices of 1 at both ends of every piece: P and tau there, its slope, and the size of the slope's terms."""

    def __init__(self, c: Inclusion, P: Array, Qw: Array) -> None:
        i, j = c.pieces, c.pieces + 1
        h = (c.nodes[j] - c.nodes[i])[:, None, None]
        self.c, self.Qw, self.P = c, Qw, np.stack([P[i], P[j]], axis=1).reshape(-1, *P.shape[1:])
        self.taus = np.stack([c.nodes[i], c.nodes[j]], axis=1).ravel()
        self.slope = np.repeat((P[j] - P[i]) / h, 2, axis=0)
        self.size = np.repeat((np.abs(P[j]) + np.abs(P[i])) / h, 2, axis=0)

    def forms(self, M: Array, E: Array, more: Array | float = 0.0) -> tuple[Array, Array, Array]:
        """The matrices for (A, G) side by side, known to within E: ends of pieces for each M (K, n, n + q).

        Also the sizes of their terms, where M and E may be `more`, and how far E moves each entry.
        """
        every, Qw, eta = (len(M), 1, 1), self.Qw, self.c.weights.eta
        P, slope, size = (np.tile(X, every) for X in (self.P, self.slope, self.size))
        M, E, top = (np.repeat(X, len(self.P), axis=0) for X in (M, E, np.abs(M) + more))
        p, none = np.abs(P), np.zeros_like(Qw)
        terms = flow_block(p, size, top, np.abs(Qw), eta, 1)
        return flow_block(P, slope, M, Qw, eta), terms, flow_block(p, 0.0, E, none, 0.0, 1)

    def slacks(self, M: Array, E: Array, middle: Array) -> Parts:
        """Bounds of the least slack at each M."""
        del middle
        below, above = (part.reshape(len(M), -1).min(axis=1) for part in bounds(*self.forms(M, E)))
        return below, above

    def robust(self, M: Array, E: Array, moving: Array) -> tuple[Array, int]:
        """What is left at each M, moved by any shares of `moving` (D, K, n, n + q), and how many were tried."""
        form, terms, radius = self.forms(M, E, E + np.abs(moving).sum(axis=0))
        stack, none = np.tile(self.P, (len(M), 1, 1)), np.zeros_like(self.Qw)
        moves = [flow_block(stack, 0.0, np.repeat(D, len(self.P), axis=0), none, 0.0) for D in moving]
        left, spent = definite_robustly(form, terms, np.array(moves).reshape(len(moving), *form.shape), radius)
        return left.reshape(len(M), -1).min(axis=1), spent


def flows(c: Inclusion, P: Array, Qw: Array, work: WorkLimit) -> float:
    """Prove 1; return the least slack."""
    flow = Flow(c, P, Qw)
    if c.multipliers is not None:
        return multiplied(c, flow)
    slack = at_corners(joint(c), flow)
    if c.model.kind == "nonlinear":
        slack = min(slack, Cells(c, c.model, P, work).prove(FLOW, flow.slacks, True, len(flow.P), flow.robust))
    return slack


def at_corners(found: Members, flow: Flow) -> float:
    """The least slack of 1 over some members."""
    slack = 1.0
    for point in found.points:
        form, terms, radius = flow.forms(*found.at(point[None]))
        slack = min(slack, least(FLOW, form, terms, flow.taus, radius, found.name(point)))
    return slack


def multiplied(c: Inclusion, flow: Flow) -> float:
    """Prove 1 with multipliers: p_k = delta_k z_k, |delta_k| <= 1, for every column z_k that a parameter moves.

    (x, w)'N(A0, G0)(x, w) - 2 x'P sum_k l_k p_k + sum_k m_k (p_k^2 - z_k^2) > 0, m_k >= 0, N at the middle of the box.
    """
    assert c.model.kind == "box"
    assert c.multipliers is not None
    n, q = c.plant.n, c.plant.G.shape[1]
    middle = np.hstack([c.plant.A, c.plant.G])
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
    rounding = (len(c.model.parameters) + 8) * EPS * off
    form, terms, inner = flow.forms(middle[None], rounding[None])
    L, lam = np.array(columns).reshape(-1, n).T, c.multipliers.reshape(len(flow.P), -1)
    m = L.shape[1]
    side, top = np.zeros((len(flow.P), n + q, m)), np.zeros_like(form)
    side[:, :n], sides = -(flow.P @ L), np.zeros_like(side)
    sides[:, :n] = np.abs(flow.P) @ np.abs(L)
    for k, z in enumerate(chosen):
        top[:, z, z] += lam[:, k]
    corner = np.einsum("ki,ij->kij", lam, np.eye(m))
    full, radius = bordered(form - top, side, corner), bordered(inner, 0 * side, 0 * corner)
    try:
        return least(f"{FLOW} with multipliers", full, bordered(terms + top, sides, corner), flow.taus, radius)
    except Refused as error:  # the multipliers fail, which says nothing of the members: is there one that does?
        broken(c, flow)
        reason = f"{FLOW} could not be decided: these multipliers do not prove it"
        raise Undecided(FLOW, reason, error.amount, error.time) from None


def broken(c: Inclusion, flow: Flow) -> None:
    """Refused at a corner of a box where 1 fails, sought by turns of the worst direction and the signs it asks for."""
    assert c.model.kind == "box"
    n, acting = c.plant.n, tuple(each for each in c.model.parameters if each.low < each.high)
    parts = np.array([np.hstack([each.A, each.G]) for each in acting])
    ends = np.array([[each.low - each.nominal, each.high - each.nominal] for each in acting])
    found = Members(np.hstack([c.plant.A, c.plant.G]), parts, np.zeros((0, len(acting))), c.model, acting)
    point = ends.mean(axis=1)
    for _ in range(TURNS):
        form, terms, _ = flow.forms(*found.at(point[None]))
        d = np.sqrt(np.maximum(np.einsum("kii->ki", terms), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(form / d[:, :, None] / d[:, None, :])
        k = int(np.argmin(values[:, 0]))
        v = vectors[k, :, 0] / d[k]
        gains = -2 * np.einsum("i,dij,j->d", flow.P[k] @ v[:n], parts, v)
        other = np.where(gains > 0, ends[:, 0], ends[:, 1])
        if np.array_equal(other, point):
            break
        point = other
    with suppress(Undecided):
        at_corners(replace(found, points=point[None]), flow)


CLAIM = Claim(INCLUSION, inclusion, prove)
