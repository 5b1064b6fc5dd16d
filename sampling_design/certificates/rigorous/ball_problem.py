"""The numbers of a certificate file as balls of radius zero, and the coordinates in which a target matrix is I."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sampling_design.checkers.numbers import exact_inner
from sampling_design.checkers.outcome import Refused, Undecided
from sampling_design.checkers.parts import Plant, Weights
from sampling_design.checkers.schedule_file import Times
from sampling_design.numerics import balls
from sampling_design.numerics.balls import Ball, BallFlow, Matrix, ball, matrix
from sampling_design.records.arrays import Array, Mask


class StatedInequality(NamedTuple):
    """What a file states: target <= Pi(t), its name, and whether for sample starts only."""

    target: Matrix
    name: str
    samples_only: bool


def positive_definite(name: str, M: Matrix) -> None:
    """Raise Refused unless M is certainly positive definite."""
    answer = balls.definite(M)
    if not answer:
        kind, word = (Refused, "is not") if answer is False else (Undecided, "is not certainly")
        raise kind(f"{name} > 0", f"{name} {word} positive definite")


def in_units(form: Matrix, sizes: list[Ball]) -> Matrix:
    """A form in units in which entries of the size of `sizes` on its diagonal become 1."""
    roots, n = [(size if size > 0 else ball(1.0)).sqrt() for size in sizes], len(sizes)
    return balls.stacked([[form[i, j] / roots[i] / roots[j] for j in range(n)] for i in range(n)])


def proven_slack(M: Matrix, shares: tuple[float, ...]) -> float | None:
    """A proven s >= 0 with M >= s I: the first of these shares of the guessed least eigenvalue that is, or None."""
    guess = float(np.linalg.eigvalsh(balls.floats(M))[0])
    tried = [*((share * guess for share in shares) if guess > 0 else ()), 0.0]
    return next((slack for slack in tried if balls.definite(M - balls.identity(M.nrows()) * ball(slack))), None)


def dissipation(P: Matrix, slope: Matrix, A: Matrix, G: Matrix, Qw: Matrix, rate: Ball) -> tuple[Matrix, list[Ball]]:
    """[-(slope + A'P + PA + rate P), -PG; -G'P, Qw], and the sum of the sizes of the terms of each diagonal entry."""
    n, q, drift, off = P.nrows(), Qw.nrows(), P * A, P * G
    corner = slope + drift + drift.transpose() + P * rate
    rows = [[*(-corner[i, j] for j in range(n)), *(-off[i, k] for k in range(q))] for i in range(n)]
    rows += [[*(-off[i, k] for i in range(n)), *(Qw[k, j] for j in range(q))] for k in range(q)]
    sizes = []
    for i in range(n):
        drifts = sum((abs(A[j, i]) * abs(P[j, i]) for j in range(n)), ball(0.0))
        sizes.append(abs(slope[i, i]) + 2 * drifts + abs(rate * P[i, i]))
    return balls.stacked(rows), [*sizes, *(Qw[k, k] for k in range(q))]


class BallWeights:
    """Plant and weights of a certificate: A, C, S = G Qw^-1 G', V = R^-1 + Qv^-1, P2, eta; forms by symmetric part."""

    def __init__(self, plant: Plant, weights: Weights) -> None:
        self.n, self.p = plant.n, len(plant.C)
        self.A, self.C = matrix(plant.A), plant.C
        self.P2, R, Qv = balls.symmetric(weights.P2), balls.symmetric(weights.R), balls.symmetric(weights.Qv)
        for name, form in (("P2", self.P2), ("R", R), ("Qv", Qv)):
            positive_definite(name, form)
        self.V = R.inv() + Qv.inv()
        self.eta = weights.eta
        self.S = noise(plant.G, weights.Qw)

    @cached_property
    def prior(self) -> Matrix:
        """P2^-1."""
        return self.P2.inv()


def noise(G: Array, Qw: Array) -> Matrix:
    """Return G Qw^-1 G', in rational numbers; Qw may be singular where it does not drive the plant."""
    exact, n = balls.flint().fmpq, G.shape[0]
    doubled = [[exact(*x.as_integer_ratio()) for x in row] for row in Qw.tolist()]
    form = [
        [(x + y) / 2 for x, y in zip(row, turned, strict=True)]
        for row, turned in zip(doubled, zip(*doubled, strict=True), strict=True)
    ]
    drive = [[exact(*x.as_integer_ratio()) for x in column] for column in G.T.tolist()]
    product = exact_inner(drive, form, [[exact(0)] * n for _ in range(n)])
    return balls.stacked([list(map(balls.flint().arb, row)) for row in product])


class BallTimes:
    """When and what a schedule measures: gaps before each sample, reach of a window start, measured outputs."""

    def __init__(self, times: Times) -> None:
        self.periodic, self.measured = times.periodic, times.measured
        stated = [ball(number) for number in times.stated.tolist()]
        if self.periodic:
            self.gaps, self.first = stated, ball(times.first)
        else:
            self.first = stated[0]
            self.gaps = [self.first, *(b - a for a, b in pairwise(stated))]
        self.N = len(self.gaps)
        self.times = [self.first]
        for gap in self.gaps[1:]:
            self.times.append(self.times[-1] + gap)
        self.period = sum(self.gaps[1:], self.gaps[0])
        self.reach = [self.gaps[0].max(self.first), *self.gaps[1:]]

    def after(self, i: int) -> int:
        """The sample after sample i of the period."""
        return (i + 1) % self.N


class BallFrame:
    """The recursion of Y = Pi^-1 in coordinates where the target is I: the claim is Y <= I.

    `patterns` says which outputs each kind of sample measures.
    """

    def __init__(self, weights: BallWeights, patterns: Iterable[Mask], target: Matrix, inequality: str) -> None:
        L = balls.cholesky(target)
        if L is None:
            raise Undecided(inequality, f"{inequality}: the left side is not certainly positive definite")
        self.weights, self.n, self.inequality = weights, weights.n, inequality
        self.L, Lt = L, L.transpose()
        A = Lt * L.solve(weights.A.transpose()).transpose() + ball(weights.eta) * balls.identity(self.n) / 2
        self.flow = BallFlow(A, Lt * weights.S * L)
        self.start = Lt * weights.prior * L
        turned = L.solve(matrix(weights.C).transpose()).transpose().tolist()
        self.rows, self.noises = [], []
        for measured in patterns:
            at = np.flatnonzero(measured).tolist()
            self.rows.append(balls.stacked([turned[j] for j in at]))
            self.noises.append(balls.stacked([[weights.V[i, j] for j in at] for i in at]))
        self.identity = balls.identity(self.n)

    def gain(self, Y: Matrix, i: int) -> Matrix:
        """The best gain at sample i, a midpoint: any gain gives a bound, this one hardly more than the least.

        Not in doubles: where Y holds directions 1e16 times better known than others, their gain would drown.
        """
        CY = self.rows[i] * Y
        made: Matrix = (CY * self.rows[i].transpose() + self.noises[i]).solve(CY).transpose().mid()
        return made

    def with_gain(self, Y: Matrix, i: int, gain: Matrix) -> Matrix:
        """Y after sample i with that gain: at least what the best gain leaves (Joseph's form)."""
        left = self.identity - gain * self.rows[i]
        made: Matrix = left * Y * left.transpose() + gain * self.noises[i] * gain.transpose()
        return made

    def sampled(self, Y: Matrix, i: int) -> Matrix | None:
        """Y after sample i, exactly; None where what is measured there has no certain variance.

        It is the least that any gain leaves, and so monotone, only where that variance is positive: a lower bound of Y
        that rounding has made indefinite has no least, and the formula would give something above Y.
        """
        C = self.rows[i]
        CY = C * Y
        variance = CY * C.transpose() + self.noises[i]
        if not balls.definite(variance):
            return None
        made: Matrix = Y - CY.transpose() * variance.solve(CY)
        return made


class ScheduleFrame(BallFrame):
    """The same, with the schedule that it runs along."""

    def __init__(self, weights: BallWeights, schedule: BallTimes, target: Matrix, inequality: str) -> None:
        super().__init__(weights, schedule.measured, target, inequality)
        self.schedule = schedule
