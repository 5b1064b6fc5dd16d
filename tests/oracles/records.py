"""What a record leaves possible of a row: one linear program over the start and a disturbance, constant on cells.

Nothing here knows the code it judges: no gains, no coordinates, no recursion over costates. Every state, and every
integral of one, is an affine map of the unknowns. The ends lie inside the exact ones, as cells are coarse.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.linalg import expm
from scipy.optimize import linprog


class WholeRecord:
    """x' = Ax + Bu + Gw between increasing `marks`, w constant on `cells` equal cells of each gap.

    `inputs` = [(t, u), ...]: u holds from t on, 0 before the first. Maps have a column for each unknown (the first
    state less `centre`, then w cell by cell) and a last one for what is fixed.
    """

    def __init__(self, A, B, C, D, G, marks, centre, inputs=(), cells=16):
        self.C, self.D, self.inputs = C, D, inputs
        n, q = G.shape
        self.width = n + (len(marks) - 1) * cells * q
        x, total, fed = np.zeros((n, self.width + 1)), np.zeros((n, self.width + 1)), np.zeros(B.shape[1])
        x[:, :n], x[:, -1] = np.eye(n), centre
        self.state, self.integral, self.fed = {marks[0]: x}, {marks[0]: total}, {marks[0]: fed}
        at = n
        for a, b in pairwise(marks):
            u, h = self.input(a), (b - a) / cells
            force = np.hstack([G, (B @ u)[:, None]])
            joint = np.zeros((2 * n + q + 1,) * 2)  # state, force, integral of the state
            joint[:n, :n], joint[:n, n : n + q + 1], joint[n + q + 1 :, :n] = A, force, np.eye(n)
            flow = expm(joint * h)
            for _ in range(cells):
                total = total + flow[n + q + 1 :, :n] @ x
                total[:, at : at + q] += flow[n + q + 1 :, n : n + q]
                total[:, -1] += flow[n + q + 1 :, n + q]
                x = flow[:n, :n] @ x
                x[:, at : at + q] += flow[:n, n : n + q]
                x[:, -1] += flow[:n, n + q]
                at += q
            fed = fed + u * (b - a)
            self.state[b], self.integral[b], self.fed[b] = x, total, fed

    def input(self, t):
        """The input in force at t."""
        return next((np.asarray(u) for s, u in reversed(self.inputs) if s <= t), np.zeros(self.D.shape[1]))

    def row(self, t, i, since=None):
        """Output i at t, or its mean from `since` on."""
        if since is None:
            found, u = self.C[i] @ self.state[t], self.input(t)
        else:
            found = self.C[i] @ (self.integral[t] - self.integral[since]) / (t - since)
            u = (self.fed[t] - self.fed[since]) / (t - since)
        found = found.copy()
        found[-1] += self.D[i] @ u
        return found

    def ends(self, c, t, rows, bounds):
        """Least and largest c'x(t); rows = [(map, lower, upper), ...], bounds a pair for each unknown; None if none."""
        sides = [(m, high) for m, _, high in rows if high < np.inf] + [
            (-m, -low) for m, low, _ in rows if low > -np.inf
        ]
        left = np.array([m[:-1] for m, _ in sides]).reshape(-1, self.width)
        right = np.array([limit - m[-1] for m, limit in sides])
        size = np.abs(left).max(axis=1)
        size = np.where(size > 0, size, 1.0)
        target = c @ self.state[t]

        def solved(cost):
            return linprog(cost, A_ub=left / size[:, None], b_ub=right / size, bounds=bounds, method="highs")

        if solved(np.zeros(self.width)).status == 2:
            return None
        low, high = solved(target[:-1]), solved(-target[:-1])
        return (
            -np.inf if low.status in (2, 3) else low.fun + target[-1],
            np.inf if high.status in (2, 3) else target[-1] - high.fun,
        )
