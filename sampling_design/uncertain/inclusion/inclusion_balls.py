"""Certificates for inclusions in ball arithmetic: the inequalities of P(tau) for every plant of a model.

Corners of a box are formed in balls, without any rounding that is not counted. A nonlinear plant's program is
evaluated, with its derivatives, in balls over cells of the region, by another route than the checkers' intervals; where
the balls of a cell leave an inequality open, the corners of its Jacobian are tried, and then the cell is halved.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from sampling_design.certificates.form.claims import RESOLUTION
from sampling_design.certificates.rigorous.ball_problem import dissipation, positive_definite
from sampling_design.certificates.rigorous.dissipation_balls import decided
from sampling_design.checkers.cover import judge
from sampling_design.checkers.inclusion import FLOW, SUBJECT, Flow, broken
from sampling_design.checkers.inclusion_file import Inclusion, moved
from sampling_design.checkers.members import JUMP
from sampling_design.checkers.outcome import Refused, Undecided, Verdict, holds
from sampling_design.numerics.balls import Ball, Matrix, ball, definite, floats, matrix, stacked, symmetric
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.budget import Budget
from sampling_design.uncertain.inclusion.region_balls import JacobianCells, mid, split_columns

Jumps = list[tuple[Matrix, Matrix, float]]
PRICE = 200
"""Work, about microseconds, of one inequality, beside that of its size."""
MOST_SETS = 2000  # sets of C that are tried for one sample


def inclusion(c: Inclusion, clock: Budget) -> Verdict:
    """Prove all inequalities of a certificate for an inclusion.

    Raises Refused if one of them certainly fails, or nothing is certain at this precision.
    """
    judge(c.family, c.graph)
    name = f"{FLOW}, {JUMP}"
    if not c.plant.n:
        return holds(name, 1.0, SUBJECT)
    w, P = c.weights, [symmetric(M) for M in c.P]
    P1, P2, Qw, R, Qv = (symmetric(M) for M in (w.P1, w.P2, w.Qw, w.R, w.Qv))
    for key, M in (("P1", P1), ("Qw", Qw), ("R", R), ("Qv", Qv)):
        positive_definite(key, M)
    low = P1 * (ball(1.0) + ball(w.margin))
    slacks = [decided("(1 + margin) P1 < P(tau)", M - low, diagonal(M)) for M in P]
    slacks += [decided("P(tau) < P2", P2 - M, diagonal(P2)) for M in P]
    top = P1 * ball(w.lam)
    slacks.append(decided("(1 - 1e-3) P2 < lam P1", top - P2 * (ball(1.0) - ball(RESOLUTION)), diagonal(top)))
    Rt = R * (R + Qv).solve(Qv)
    slacks.append(jumps(c, P, Rt, clock))
    slacks.append(flows(c, P, Qw, clock))
    return holds(name, min(slacks), SUBJECT)


def diagonal(M: Matrix) -> list[Ball]:
    """The sizes of the entries on the diagonal."""
    return [abs(M[i, i]) for i in range(M.nrows())]


# --- members of a box or a list --------------------------------------------------------------------------------------


def members(c: Inclusion, keys: str) -> Iterator[list[Matrix]]:
    """The matrices of these keys at every vertex of the model that moves them, and of the file's own plant."""
    if c.model.kind != "box":
        yield [matrix(getattr(c.plant, key)) for key in keys]
        if c.model.kind == "vertices":
            yield from ([matrix(getattr(c.model, key)[k]) for key in keys] for k in range(len(c.model.A)))
        return
    acting = [each for each in c.model.parameters if any(getattr(each, key).any() for key in keys)]
    for ends in product(*(sorted({each.low, each.high}) for each in acting)):
        found = [matrix(getattr(c.plant, key)) for key in keys]
        for each, end in zip(acting, ends, strict=True):
            by = ball(end) - ball(each.nominal)
            found = [M + matrix(getattr(each, key)) * by for M, key in zip(found, keys, strict=True)]
        yield found


def ends_of(c: Inclusion, P: list[Matrix]) -> list[tuple[Matrix, Matrix, float]]:
    """P, slope and tau at both ends of every piece."""
    found = []
    for i in c.pieces.tolist():
        slope = (P[i + 1] - P[i]) / (ball(c.nodes[i + 1]) - ball(c.nodes[i]))
        found += [(P[i], slope, float(c.nodes[i])), (P[i + 1], slope, float(c.nodes[i + 1]))]
    return found


def flows(c: Inclusion, P: list[Matrix], Qw: Matrix, clock: Budget) -> float:
    """The flow condition for every member."""
    eta, every = ball(c.weights.eta), ends_of(c, P)
    if c.multipliers is not None:
        return multiplied(c, every, Qw, clock)
    slack = 1.0
    for A, G in members(c, "AG"):
        for p, slope, tau in every:
            clock.check(PRICE + (c.plant.n + len(c.weights.Qw)) ** 3)
            slack = min(slack, decided(FLOW, *dissipation(p, slope, A, G, Qw, eta), tau))
    if c.model.kind != "nonlinear":
        return slack

    def slacks(A: Matrix, G: Matrix) -> Iterator[Matrix]:
        return (dissipation(p, slope, A, G, Qw, eta)[0] for p, slope, _ in every)

    return JacobianCells(c, c.model, clock).prove(FLOW, lambda M, _: slacks(*split_columns(M, c.plant.n)), True)


def multiplied(c: Inclusion, every: list[tuple[Matrix, Matrix, float]], Qw: Matrix, clock: Budget) -> float:
    """The flow condition with multipliers; see `checkers/inclusion.py`."""
    assert c.model.kind == "box"
    assert c.multipliers is not None
    n, q = c.plant.n, Qw.nrows()
    middle, columns, chosen = matrix(np.hstack([c.plant.A, c.plant.G])), [], []
    for each in c.model.parameters:
        M = np.hstack([each.A, each.G])
        middle += matrix(M) * ((ball(each.low) - ball(each.nominal) + ball(each.high) - ball(each.nominal)) / 2)
        half = (ball(each.high) - ball(each.low)) / 2
        for k in moved(each):
            columns.append(matrix(M[:, [k]]) * half)
            chosen.append(k)
    A, G = split_columns(middle, n)
    eta, slack, m = ball(c.weights.eta), 1.0, len(columns)
    for (p, slope, tau), weights in zip(every, c.multipliers.reshape(len(every), m), strict=True):
        clock.check(PRICE + (n + q + m) ** 3)
        flow, sizes = dissipation(p, slope, A, G, Qw, eta)
        form = flow.tolist()
        for k, z in enumerate(chosen):
            form[z][z] -= ball(weights[k])
            sizes[z] += ball(weights[k])
        sides = [(p * column).entries() for column in columns]
        rows = [[*form[i], *(-side[i] if i < n else ball(0.0) for side in sides)] for i in range(n + q)]
        for k, side in enumerate(sides):
            own = [ball(weights[k]) if j == k else ball(0.0) for j in range(m)]
            rows.append([*(-side[i] if i < n else ball(0.0) for i in range(n + q)), *own])
        try:
            slack = min(slack, decided(FLOW, stacked(rows), [*sizes, *map(ball, weights)], tau))
        except Refused as error:
            raise multipliers_fail(c, error) from None
    return slack


def multipliers_fail(c: Inclusion, error: Refused) -> Refused:
    """What it says of the claim that multipliers do not prove it: refuted only with a corner that breaks it."""
    flow = Flow(c, (c.P + np.swapaxes(c.P, 1, 2)) / 2, (c.weights.Qw + c.weights.Qw.T) / 2)
    try:
        broken(c, flow)
    except Refused as found:
        return Refused(FLOW, found.reason, amount=found.amount)
    return Undecided(FLOW, f"{FLOW} could not be decided: these multipliers do not prove it", error.amount, error.time)


def jumps(c: Inclusion, P: list[Matrix], Rt: Matrix, clock: Budget) -> float:
    """The jump condition for every member: tangents from below, as in `checkers/members.py`."""
    slack = 1.0
    for pattern in sorted(set(map(tuple, c.measured.tolist()))):
        measured = np.array(pattern, bool)
        Y = of_some(Rt, measured)
        every = [
            (P[i], P[j], float(c.nodes[i]))
            for i, j, row in zip(c.later, c.base, c.measured, strict=True)
            if np.array_equal(row, measured)
        ]
        if not measured.any():
            for later, base, tau in every:
                slack = min(slack, decided(JUMP, later - base, diagonal(later + base), tau))
            continue
        sets = OutputSets(c, measured)
        slack = min([slack, *(sets.over(jump, Y, clock) for jump in every)])
        if c.model.kind == "nonlinear":
            rows = np.flatnonzero(measured).tolist()

            def forms(
                C: Matrix, B: Matrix, Y: Matrix = Y, every: Jumps = every, rows: list[int] = rows
            ) -> Iterator[Matrix]:
                kept, about = (stacked([M.tolist()[k] for k in rows]) for M in (C, B))
                information = tangent(kept, about, Y)
                return (later - base + information for later, base, _ in every)

            JacobianCells(c, c.model, clock).prove(JUMP, forms, False)
            slack = 0.0
    return slack


def of_some(X: Matrix, measured: Mask) -> Matrix:
    """((X^-1) restricted to what is measured)^-1."""
    if measured.all() or not measured.any():
        return X
    own, other = np.flatnonzero(measured).tolist(), np.flatnonzero(~measured).tolist()
    rows = X.tolist()

    def part(left: list[int], right: list[int]) -> Matrix:
        return stacked([[rows[i][j] for j in right] for i in left])

    return part(own, own) - part(own, other) * part(other, other).solve(part(other, own))


def tangent(C: Matrix, B: Matrix, Y: Matrix) -> Matrix:
    """C'YB + B'YC - B'YB, at most C'YC."""
    cross = C.transpose() * Y * B
    return cross + cross.transpose() - B.transpose() * Y * B


class OutputSets:
    """The C of a box or a list: sets of them, named by their points, that are halved; that of the file's own plant."""

    def __init__(self, c: Inclusion, measured: Mask) -> None:
        self.c, self.measured, self.corners = c, measured, c.plant.C[None]
        if c.model.kind != "box":
            if c.model.kind == "vertices":
                self.corners = np.concatenate([c.model.C, self.corners])
            self.acting, self.points = [], np.eye(len(self.corners))
            return
        self.acting = [each for each in c.model.parameters if each.C.any()]
        corners = list(product(*(sorted({each.low, each.high}) for each in self.acting)))
        self.points = np.array(corners).reshape(len(corners), len(self.acting))

    def at(self, point: Array) -> Matrix:
        """The rows of C that are measured."""
        if self.c.model.kind == "box":
            found = matrix(self.c.plant.C[self.measured])
            for each, value in zip(self.acting, point.tolist(), strict=True):
                found += matrix(each.C[self.measured]) * (ball(value) - ball(each.nominal))
            return found
        parts = (matrix(C[self.measured]) * ball(x) for C, x in zip(self.corners, point.tolist(), strict=True))
        first = next(parts)
        return sum(parts, first)

    def halves(self, points: Array, found: Array) -> list[Array]:
        """Two sets that together are one: along the side of a box, or of a simplex, that moves C most."""
        far = np.square(found[:, None] - found[None]).sum(axis=(2, 3))
        i, j = divmod(int(np.argmax(far)), len(points))
        if self.c.model.kind != "box":
            first, second = points.copy(), points.copy()
            first[i] = second[j] = points[i] / 2 + points[j] / 2
            return [first, second]
        low, high = points.min(axis=0), points.max(axis=0)
        sizes = [float(np.abs(each.C[self.measured]).max(initial=0.0)) for each in self.acting]
        k = int(np.argmax((high - low) * np.array(sizes)))
        middle = low[k] / 2 + high[k] / 2
        sides = [sorted({a, b}) for a, b in zip(low.tolist(), high.tolist(), strict=True)]
        return [np.array(list(product(*(pair if i == k else own for i, own in enumerate(sides)))))
                for pair in ([low[k], middle], [middle, high[k]])]  # fmt: skip

    def over(self, jump: tuple[Matrix, Matrix, float], Y: Matrix, clock: Budget) -> float:
        """A proven slack of one sample; Unproven where there is none."""
        later, base, tau = jump
        gained, slack, every, spent = later - base, 1.0, [self.points], 0
        while every:
            clock.check((PRICE + self.c.plant.n**3) * len(every[-1]))
            points = every.pop()
            spent += 1
            Cs = [self.at(point) for point in points]
            exact = [gained + tangent(C, C, Y) for C in Cs]
            sizes = [later + base + tangent(C, C, Y) for C in Cs]
            if len(points) == 1:
                slack = min(slack, decided(JUMP, exact[0], diagonal(sizes[0]), tau))
                continue
            least = [float(np.linalg.eigvalsh(floats(M))[0]) for M in exact]
            weakest = int(np.argmin(least))
            if definite(exact[weakest]) is False:
                raise Refused(JUMP, f"{JUMP} fails by {-least[weakest]:.3g}", amount=least[weakest], time=tau)
            found = np.array([floats(C) for C in Cs])
            for B in (mid(Cs[weakest]), matrix(found.mean(axis=0))):
                if all(definite(gained + tangent(C, B, Y)) is True for C in Cs):
                    slack = 0.0
                    break
            else:
                if spent > MOST_SETS:
                    raise Undecided(JUMP, f"{JUMP} could not be decided: it is tight or nearly so", time=tau)
                every += self.halves(points, found)
        return slack
