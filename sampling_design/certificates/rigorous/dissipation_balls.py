"""Detectability certificates in ball arithmetic: P > 0 and the dissipation inequality, by the pivots of L D L'.

    N = [[c_y C'C - A'P - PA - (1 + margin) eta P, -PG], [-G'P, c_w I]] > 0

Floats guess the least eigenvalue and its direction in units where the terms of each diagonal entry have size one; balls
prove the slack, or evaluate the form along the direction.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import numpy.typing as npt

from sampling_design._ball_flow import Clock
from sampling_design._balls import Ball, Matrix, ball, definite, flint, floats, identity, matrix, symmetric
from sampling_design._record import short
from sampling_design.certificates.rigorous.ball_problem import (
    REFUTED,
    UNDECIDED,
    Decision,
    Unproven,
    positive,
    reading,
)
from sampling_design.checkers.strict import Tree

Array = npt.NDArray[np.float64]

INEQUALITY = "[[A'P + PA + (1 + margin) eta P - c_y C'C, PG], [G'P, -c_w I]] < 0"
SHARES = (0.999, 0.5, 1e-3)
"""Parts of the guessed least eigenvalue that are tried as a proven slack, the largest first."""


def detectability(data: Tree, clock: Clock) -> Decision:
    """Prove P > 0 and the dissipation inequality; return the inequality, for what, and its slack relative to its terms.

    Raises
    ------
    Unproven
        If one of them certainly fails (with amount and direction), or nothing is certain at this precision.
    """
    clock.check()
    with reading():
        c = numbers(data)
    if not c.n:
        return Decision(INEQUALITY, "a plant without states", 1.0)
    form, sizes = negative(c)
    decided("P > 0", c.P, [abs(c.P[i, i]) for i in range(c.n)])
    return Decision(INEQUALITY, "every state and disturbance", decided(INEQUALITY, form, sizes))


def numbers(data: Tree) -> SimpleNamespace:
    """The numbers of the file as balls of radius zero; P by its symmetric part."""
    plant = data["plant"]["matrices"]
    n, p = len(plant["A"]), len(plant["C"])
    G = np.asarray(plant.get("G", np.eye(n)), dtype=np.float64)
    c = SimpleNamespace(n=n, A=matrix(np.reshape(plant["A"], (n, n))), C=matrix(np.reshape(plant["C"], (p, n))))
    c.G = matrix(np.reshape(G, (n, G.shape[-1] if n else 0)))
    c.P = symmetric(np.reshape(data["P"], (n, n)))
    c.eta, c.c_w, c.c_y = (ball(positive(name, data[name])) for name in ("eta", "c_w", "c_y"))
    margin = float(data["margin"])
    if not 0 <= margin < np.inf:
        raise Unproven(REFUTED, "margin >= 0", f"margin must not be negative, got {data['margin']!r}")
    c.rate = (1 + ball(margin)) * c.eta
    return c


def negative(c: SimpleNamespace) -> tuple[Matrix, list[Ball]]:
    """N, and for each diagonal entry the sum of the sizes of its terms."""
    drift, seen, off = c.A.transpose() * c.P, c.C.transpose() * c.C * c.c_y, c.P * c.G
    corner, q = seen - drift - drift.transpose() - c.P * c.rate, c.G.ncols()
    rows = [[*corner.tolist()[i], *(-off[i, k] for k in range(q))] for i in range(c.n)]
    rows += [[*(-off[i, k] for i in range(c.n)), *(c.c_w if k == j else ball(0.0) for j in range(q))] for k in range(q)]
    sizes = []
    for i in range(c.n):
        drifts = [abs(c.A[j, i]) * abs(c.P[j, i]) for j in range(c.n)]
        sizes.append(sum(drifts, ball(0.0)) * 2 + seen[i, i] + c.rate * abs(c.P[i, i]))
    return flint().arb_mat(rows), [*sizes, *([c.c_w] * q)]


def decided(name: str, form: Matrix, sizes: list[Ball]) -> float:
    """Return a proven slack of form > 0 relative to `sizes`; Unproven where there is none."""
    roots, n = [(size if size > 0 else ball(1.0)).sqrt() for size in sizes], len(sizes)
    M = flint().arb_mat([[form[i, j] / roots[i] / roots[j] for j in range(n)] for i in range(n)])
    values, vectors = np.linalg.eigh(floats(M))
    for slack in [share * float(values[0]) for share in SHARES if values[0] > 0] + [0.0]:
        if definite(M - identity(n) * ball(slack)):
            return slack
    found = downhill(M)
    if found is None:
        raise Unproven(UNDECIDED, name, f"{name} could not be decided: it is tight or nearly so")
    value, z = found
    guess = matrix(vectors[:, :1])
    quotient = (guess.transpose() * M * guess)[0, 0] / (guess.transpose() * guess)[0, 0]
    if quotient < value:
        value, z = quotient, vectors[:, 0]
    along = z / np.array([float(root) for root in roots])
    amount, along = float(value.upper()), (along / np.linalg.norm(along)).tolist()
    reason = f"{name} fails by {-amount:.3g}, an eigenvalue relative to the size of its terms, along {short(along, 3)}"
    raise Unproven(REFUTED, name, reason, amount=amount, direction=along)


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
