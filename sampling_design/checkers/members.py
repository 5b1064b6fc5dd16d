"""Which matrices a model holds, and whether all of them are positive: each least eigenvalue with a bound of rounding.

A box of parameters and a list of vertices are both B + sum x_k M_k: x between the corners of a box, or shares that sum
to one. A matrix that fails is named by its parameters. The plant that stands in the file is a member of every model: of
a box since its numbers lie in their ranges, of others since it is proven beside them.

What a sample shows, for every C of a model: P(tau) + C'R~C - P(0) > 0 where a sample may come.

C'R~C is convex in C, so that corners do not decide. From below it is bounded by its tangents: for any K, and K = R~B

    C'R~C >= C'K + K'C - K'R~^-1 K = C'R~B + B'R~C - B'R~B,

which is linear in C, so that the corners of a set decide where one B serves all of it. Where none does the set is
halved, which leaves a fourth of what is lost: in the end nothing. Refuted is only what fails for a C of the model.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from .inclusion_file import Box, Inclusion, Parameter, Region, Vertices
from .numbers import EPS
from .outcome import Refused, Undecided, WorkLimit
from .regions import Cells, Parts
from .strict import Array, Index, Mask

EIGENVALUES = 8  # those of an (n, n) matrix M are computed to within this times n eps |M|_F
MOST_PARAMETERS = 10  # of a box whose corners are tried one by one; beyond that multipliers are needed


def bounds(form: Array, terms: Array, radius: Array | None = None) -> Parts:
    """Lower and upper bounds of the least eigenvalue of each matrix, relative to the size of its diagonal's terms."""
    d = np.sqrt(np.einsum("kii->ki", terms))
    d = np.where(d > 0, d, 1.0)
    scale = d[:, :, None] * d[:, None, :]
    M, m = form / scale, form.shape[-1]
    values = np.linalg.eigvalsh(M).min(axis=1, initial=np.inf)  # of no rows, of a plant without disturbances: none
    rounding = EPS * (
        (m + 16) * np.linalg.norm(terms / scale, axis=(1, 2)) + EIGENVALUES * m * np.linalg.norm(M, axis=(1, 2))
    )
    if radius is not None:
        rounding = rounding + np.linalg.norm(radius / scale, axis=(1, 2))
    rounding = np.where(np.isfinite(rounding), rounding, np.inf)
    return values - rounding, values + rounding


def least(
    name: str, form: Array, terms: Array, times: Array | None = None, radius: Array | None = None, who: str = ""
) -> float:
    """The least slack of matrices that are all members of the claim; Refused or Undecided where one is not positive.

    `who` says of which plant they are.
    """
    below, above = bounds(form, terms, radius)
    k = int(np.argmin(above))
    when = None if times is None else float(times[k])
    at = "" if when is None else f" at tau = {when:.6g}"
    if above[k] < 0:
        what = f"{name} fails by {-above[k]:.3g} of the size of its terms{at}{who}"
        raise Refused(name, what, float(above[k]), when)
    k = int(np.argmin(below))
    if not below[k] > 0:
        when = None if times is None else float(times[k])
        raise Undecided(name, f"{name} could not be decided: it is tight or nearly so", float(below[k]), when)
    return float(below[k])


@dataclass(frozen=True)
class Members:
    """All base + sum_k x_k parts[k], x in the hull of the rows of `points` (V, d)."""

    base: Array
    parts: Array
    points: Array
    model: Box | Vertices | Region
    acting: tuple[Parameter, ...]

    def at(self, points: Array) -> Parts:
        """The matrices at some points, and the rounding of each entry."""
        size = np.abs(self.base) + np.tensordot(np.abs(points), np.abs(self.parts), 1)
        exact = self.model.kind == "vertices" and np.all((points == 0) | (points == 1))
        rounding = 0.0 if exact else (len(self.parts) + 4) * EPS
        return self.base + np.tensordot(points, self.parts, 1), rounding * size

    def rows(self, measured: Mask) -> "Members":
        """Those rows alone."""
        return replace(self, base=self.base[measured], parts=self.parts[:, measured])

    def name(self, point: Array) -> str:
        """Which plant it is, in words."""
        if self.acting:
            values = (f"{each.name} = {each.nominal + x:.6g}" for each, x in zip(self.acting, point, strict=True))
            return f" where {', '.join(values)}"
        if self.model.kind == "box":
            return ""
        last = len(point) - 1
        shares = (f"{x:.6g} of {f'vertex {k}' if k < last else 'the centre'}" for k, x in enumerate(point) if x)
        return f" where the plant is {', '.join(shares) or 'the centre'}"

    def halves(self, points: Array) -> Iterator[Array]:
        """Two hulls that together hold that of some points: a box is halved, or the longest side of a simplex."""
        if self.model.kind == "box":
            low, high = points.min(axis=0), points.max(axis=0)
            k = int(np.argmax((high - low) * np.sqrt(np.square(self.parts).sum(axis=(1, 2)))))
            middle = low[k] / 2 + high[k] / 2
            for ends in ((low[k], middle), (middle, high[k])):
                sides = np.stack([low, high], axis=1)
                sides[k] = ends
                yield np.array(list(product(*sides)))
            return
        M = self.at(points)[0]
        far = np.square(M[:, None] - M[None]).sum(axis=(2, 3))
        i, j = divmod(int(np.argmax(far)), len(points))
        for one in (i, j):
            other = points.copy()
            other[one] = points[i] / 2 + points[j] / 2
            yield other


def members(
    c: Inclusion, base: Array, part: Callable[[Parameter], Array], stack: Callable[[Vertices], Array]
) -> Members:
    """The matrices of one kind in a model that is a box or a list; of a nonlinear plant that at the centre alone."""
    if c.model.kind == "nonlinear":
        return Members(base, np.zeros((0, *base.shape)), np.zeros((1, 0)), c.model, ())
    if c.model.kind == "vertices":
        found = np.concatenate([stack(c.model), base[None]])
        return Members(np.zeros_like(base), found, np.eye(len(found)), c.model, ())
    acting = tuple(each for each in c.model.parameters if part(each).any() and each.low < each.high)
    if len(acting) > MOST_PARAMETERS:
        raise Undecided("corners", f"{len(acting)} parameters have too many corners: the file has no multipliers")
    ends = list(product(*((each.low - each.nominal, each.high - each.nominal) for each in acting)))
    parts = np.array([part(each) for each in acting]).reshape(len(acting), *base.shape)
    return Members(base, parts, np.array(ends).reshape(2 ** len(acting), len(acting)), c.model, acting)


def joint(c: Inclusion) -> Members:
    """(A, G) side by side."""
    return members(
        c,
        np.hstack([c.plant.A, c.plant.G]),
        lambda each: np.hstack([each.A, each.G]),
        lambda model: np.concatenate([model.A, model.G], axis=2),
    )


def outputs(c: Inclusion) -> Members:
    """C."""
    return members(c, c.plant.C, lambda each: each.C, lambda model: model.C)


JUMP = "P(0) < P(tau) + C'R~C"
BELOW = 1e-10  # share by which R~ is taken smaller than its floats, so that its own inequality has room
MOST_SETS = 20_000  # sets of C that are tried for one pattern of outputs
AT_ONCE = 16  # of these looked at together: more cost less each, and come later to an end that one of them decides
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
    for pattern in sorted(set(map(tuple, c.measured.tolist()))):
        measured = np.array(pattern, bool)
        at = np.flatnonzero((c.measured == measured).all(axis=1))
        later, base = P[c.later[at]], P[c.base[at]]
        jump = Jump(later - base, np.abs(later) + np.abs(base), c.nodes[c.later[at]], of_some(Rt, measured))
        if not measured.any():
            slack = min(slack, least(f"{JUMP} without C'R~C", jump.gained, jump.sizes, jump.taus))
        else:
            slack = min(slack, over_set(outputs(c).rows(measured), jump, work))
            if c.model.kind == "nonlinear":
                slack = min(slack, over_region(c, c.model, P, jump, measured, work))
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
    every = {tuple(range(len(jump.gained))): [found.points]}  # sets of C, by the samples that are still open there
    while every:
        samples, held = every.popitem()
        if len(held) > AT_ONCE:
            every[samples] = held[:-AT_ONCE]
        sets, some = np.stack(held[-AT_ONCE:]), np.array(samples)
        count, corners = sets.shape[:2]
        spent += count
        work.spend(PRICE * 3 * count * corners * len(some))
        C, EC = found.at(sets.reshape(count * corners, -1))
        below, above = (X.reshape(count, corners, -1) for X in jump.bounds(C, EC, C, some))
        s, k, i = np.unravel_index(int(np.argmin(above)), above.shape)
        if above[s, k, i] < 0:
            amount, tau = float(above[s, k, i]), float(jump.taus[some[i]])
            name = found.name(sets[s, k])
            what = f"{JUMP} fails by {-amount:.3g} of the size of its terms at tau = {tau:.6g}{name}"
            raise Refused(JUMP, what, amount, tau)
        best = below[:, 0]
        if corners > 1:
            each, weakest = C.reshape(count, corners, *C.shape[1:]), below.min(axis=2).argmin(axis=1)
            tangents = np.concatenate([each[np.arange(count), weakest], each.mean(axis=1)])
            B = np.repeat(tangents, corners, axis=0)
            under = jump.bounds(np.concatenate([C, C]), np.concatenate([EC, EC]), B, some)[0]
            best = under.reshape(2, count, corners, -1).min(axis=2).max(axis=0)
        slack = min(slack, float(best[best > 0].min(initial=1.0)))
        for points, own in zip(sets, best, strict=True):
            rest = some[~(own > 0)]
            if not rest.size:
                continue
            if corners == 1 or spent > MOST_SETS or work.over:
                amount, tau = float(own.min()), float(jump.taus[some[int(np.argmin(own))]])
                raise Undecided(JUMP, f"{JUMP} could not be decided: it is tight or nearly so", amount, tau)
            every.setdefault(tuple(rest.tolist()), []).extend(found.halves(points))
    return slack


def over_region(c: Inclusion, region: Region, P: Array, jump: Jump, measured: Mask, work: WorkLimit) -> float:
    """The least slack over all Jacobians of the outputs in the region."""

    def judge(C: Array, EC: Array, B: Array) -> Parts:
        below, above = jump.bounds(C[:, measured], EC[:, measured], B[:, measured])
        return below.min(axis=1), above.min(axis=1)

    return Cells(c, region, P, work).prove(JUMP, judge, False, len(jump.gained))
