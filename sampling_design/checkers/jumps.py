"""What a sample shows, for every C of a model: P(tau) + C'R~C - P(0) > 0 where a sample may come.

C'R~C is convex in C, so that corners do not decide. From below it is bounded by its tangents: for any K, and K = R~B

    C'R~C >= C'K + K'C - K'R~^-1 K = C'R~B + B'R~C - B'R~B,

which is linear in C, so that the corners of a set decide where one B serves all of it. Where none does the set is
halved, which leaves a fourth of what is lost: in the end nothing. Refuted is only what fails for a C of the model.
"""

import numpy as np

from .inclusion_file import Inclusion, Region
from .members import Members, bounds, least, outputs
from .outcome import Refused, Undecided
from .regions import Cells
from .slopes import Parts
from .strict import Array, Index, Mask
from .work import WorkLimit

JUMP = "P(0) < P(tau) + C'R~C"
BELOW = 1e-10  # share by which R~ is taken smaller than its floats, so that its own inequality has room
MOST_SETS = 20_000  # sets of C that are tried for one pattern of outputs
PRICE = 4  # work of one matrix, in microseconds


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


def of_some(X: Array, measured: Mask) -> Array:
    """A matrix that is certainly at most ((X^-1) restricted to what is seen)^-1: Y with X - E'YE > 0."""
    if measured.all():
        return X
    off = X[np.ix_(measured, ~measured)]
    Y = X[np.ix_(measured, measured)] - off @ np.linalg.solve(X[np.ix_(~measured, ~measured)], off.T)
    Y = (1 - BELOW) * (Y + Y.T) / 2
    full = np.zeros_like(X)
    full[np.ix_(measured, measured)] = Y
    least("R~", (X - full)[None], (np.abs(X) + np.abs(full))[None])
    return np.asarray(Y)


def prove_jumps(c: Inclusion, P: Array, Rt: Array, work: WorkLimit) -> float:
    """Prove all of them; return the least slack."""
    slack = 1.0
    for pattern in sorted(set(map(tuple, c.jumps.measured.tolist()))):
        measured = np.array(pattern, bool)
        at = np.flatnonzero((c.jumps.measured == measured).all(axis=1))
        later, base = P[c.jumps.later[at]], P[c.jumps.base[at]]
        jump = Jump(later - base, np.abs(later) + np.abs(base), c.nodes[c.jumps.later[at]], of_some(Rt, measured))
        if not measured.any():
            slack = min(slack, least(f"{JUMP} without C'R~C", jump.gained, jump.sizes, jump.taus))
        elif c.model.kind == "nonlinear":
            slack = min(slack, over_region(c, c.model, P, jump, measured, work))
        else:
            found = outputs(c)
            slack = min(slack, over_set(found.rows(measured), jump, work))
    return slack


class Jump:
    """P(tau) - P(0) for all samples that measure the same outputs, and what these weigh."""

    def __init__(self, gained: Array, sizes: Array, taus: Array, Rt: Array) -> None:
        self.gained, self.sizes, self.taus, self.Rt = gained, sizes, taus, Rt

    def forms(self, C: Array, EC: Array, B: Array, some: Index | None = None) -> tuple[Array, Array, Array]:
        """The forms for each C (K, p, n), off by EC, and the tangent at B of the same stack: (K, samples, n, n)."""
        Rt, size = self.Rt, np.abs(self.Rt)
        turned, aside = np.swapaxes(C, 1, 2), np.abs(np.swapaxes(B, 1, 2))
        cross, large = turned @ Rt @ B, np.abs(turned) @ size @ np.abs(B)
        own, same = np.swapaxes(B, 1, 2) @ Rt @ B, aside @ size @ np.abs(B)
        reduction = cross + np.swapaxes(cross, 1, 2) - own
        terms = large + np.swapaxes(large, 1, 2) + same
        off = np.swapaxes(EC, 1, 2) @ size @ np.abs(B)
        off = off + np.swapaxes(off, 1, 2)
        gained, sizes = (X if some is None else X[some] for X in (self.gained, self.sizes))
        shape = (len(C), *gained.shape)
        return gained + reduction[:, None], sizes + terms[:, None], np.broadcast_to(off[:, None], shape)

    def bounds(self, C: Array, EC: Array, B: Array, some: Index | None = None) -> Parts:
        """Lower and upper bounds of the least eigenvalues, (K, samples)."""
        parts = self.forms(C, EC, B, some)
        below, above = bounds(*(X.reshape(-1, *X.shape[2:]) for X in parts))
        return below.reshape(parts[0].shape[:2]), above.reshape(parts[0].shape[:2])


def over_set(found: Members, jump: Jump, work: WorkLimit) -> float:
    """The least slack over all C of a box or a list."""
    slack, spent = 1.0, 0
    every: list[tuple[Array, Index]] = [(found.points, np.arange(len(jump.gained)))]
    while every:
        points, some = every.pop()
        spent += 1
        work.spend(PRICE * 3 * len(points) * len(some))
        C, EC = found.at(points)
        below, above = jump.bounds(C, EC, C, some)
        k, i = np.unravel_index(int(np.argmin(above)), above.shape)
        if above[k, i] < 0:
            amount, tau = float(above[k, i]), float(jump.taus[some[i]])
            what = f"{JUMP} fails by {-amount:.3g} of the size of its terms at tau = {tau:.6g}{found.name(points[k])}"
            raise Refused(JUMP, what, amount, tau)
        weakest = int(np.argmin(below.min(axis=1)))
        best = below.min(axis=0) if len(points) == 1 else np.full(len(some), -np.inf)
        for B in [C[weakest], C.mean(axis=0)] if len(points) > 1 else []:
            best = np.maximum(best, jump.bounds(C, EC, np.broadcast_to(B, C.shape), some)[0].min(axis=0))
        slack = min(slack, float(best[best > 0].min(initial=1.0)))
        rest = some[~(best > 0)]
        if not rest.size:
            continue
        if len(points) == 1 or spent > MOST_SETS or work.over:
            amount, tau = float(best.min()), float(jump.taus[some[int(np.argmin(best))]])
            raise Undecided(JUMP, f"{JUMP} could not be decided: it is tight or nearly so", amount, tau)
        every += [(half, rest) for half in found.halves(points)]
    return slack


def over_region(c: Inclusion, region: Region, P: Array, jump: Jump, measured: Mask, work: WorkLimit) -> float:
    """The least slack over all Jacobians of the outputs in the region."""

    def judge(C: Array, EC: Array, B: Array, _: Array) -> Parts:
        below, above = jump.bounds(C[:, measured], EC[:, measured], B[:, measured])
        return below.min(axis=1), above.min(axis=1)

    return Cells(c, region, P, work).prove(JUMP, judge, False, len(jump.gained))
