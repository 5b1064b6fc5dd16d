"""Detectability certificates in ball arithmetic: P > 0 and the dissipation inequality, by the pivots of L D L'.

    N = [[c_y C'C - A'P - PA - (1 + margin) eta P, -PG], [-G'P, c_w I]] > 0

Floats guess the least eigenvalue and its direction in units where the terms of each diagonal entry have size one; balls
prove the slack, or evaluate the form along the direction.
"""

from __future__ import annotations

import numpy as np

from sampling_design.certificates.rigorous.ball_problem import dissipation, in_units, proven_slack
from sampling_design.checkers.detectability import INEQUALITY, Detectability
from sampling_design.checkers.outcome import Refused, Undecided, Verdict, holds
from sampling_design.numerics.balls import Ball, Matrix, ball, floats, identity, matrix, symmetric
from sampling_design.records.arrays import Array
from sampling_design.records.budget import Budget
from sampling_design.records.record import short

SHARES = (0.999, 0.5, 1e-3)  # parts of the guessed least eigenvalue that are tried as a proven slack, the largest first


def detectability(c: Detectability, clock: Budget) -> Verdict:
    """Prove P > 0 and the dissipation inequality; the slack is relative to its terms.

    Raises Refused if one of them certainly fails (with amount and direction), or nothing is certain at this precision.
    """
    clock.check()
    if not c.plant.n:
        return holds(INEQUALITY, 1.0, "a plant without states")
    P = symmetric(c.P)
    A, C = matrix(c.plant.A), matrix(c.plant.C)
    supply, bound = C.transpose() * C * ball(c.c_y), identity(c.plant.G.shape[1]) * ball(c.c_w)
    form, sizes = dissipation(P, -supply, A, matrix(c.plant.G), bound, (1 + ball(c.margin)) * ball(c.eta))
    decided("P > 0", P, [abs(P[i, i]) for i in range(c.plant.n)])
    return holds(INEQUALITY, decided(INEQUALITY, form, sizes), "every state and disturbance")


def decided(
    name: str, form: Matrix, sizes: list[Ball], when: float | None = None, shares: tuple[float, ...] = SHARES
) -> float:
    """Return a proven slack of form > 0 relative to `sizes`.

    Raises Refused if it certainly fails, at the time `when` if it is about one, or there is none at this precision.
    """
    M = in_units(form, sizes)
    slack = proven_slack(M, shares)
    if slack is not None:
        return slack
    values, vectors = np.linalg.eigh(floats(M))
    witness = downhill(M)
    if witness is None:
        raise Undecided(name, f"{name} could not be decided: it is tight or nearly so", float(values[0]), when)
    value, z = witness
    guess = matrix(vectors[:, :1])
    quotient = (guess.transpose() * M * guess)[0, 0] / (guess.transpose() * guess)[0, 0]
    if quotient < value:
        value, z = quotient, vectors[:, 0]
    along = z / np.array([np.sqrt(float(size)) if size > 0 else 1.0 for size in sizes])
    amount, along = float(value.upper()), (along / np.linalg.norm(along)).tolist()
    reason = f"{name} fails by {-amount:.3g}, an eigenvalue relative to the size of its terms, along {short(along, 3)}"
    raise Refused(name, reason, amount, when, direction=along)


def downhill(M: Matrix) -> tuple[Ball, Array] | None:
    """z and z'Mz/z'z, certainly negative, from the first pivot of L D L' that is; None where there is none."""
    rows, X = M.tolist(), identity(M.nrows()).tolist()
    for k, row in enumerate(rows):
        if not row[k] > 0:
            return (row[k] / sum(x * x for x in X[k]), np.array([float(x) for x in X[k]])) if row[k] < 0 else None
        for i in range(k + 1, len(rows)):
            factor = rows[i][k] / row[k]
            rows[i] = [a - factor * b for a, b in zip(rows[i], row, strict=True)]
            X[i] = [a - factor * b for a, b in zip(X[i], X[k], strict=True)]
    return None
