"""The least scale of a shape of P2 that keeps the noise gain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import brentq

from sampling_design.certificates.exact.window_gains import Look, WindowConditions
from sampling_design.numerics.linalg import symmetrise
from sampling_design.records.arrays import Array

EXACT, COARSE = 1e-8, 0.05  # width to which the scale of a shape is found, at the end and while rates are compared
PAST, LEAST_SLOPE = 1.2, 0.02
"""How far past the scale that the slope so far promises the next one is tried, and how small that slope may be."""
WIDEST = 200.0  # scales of a shape are looked for between e^-200 and e^200 times the first guess


def rounded(Y: Array, share: float, prior: Array) -> Array:
    """Y with so much more of every state's own variance: of a condition of about n/share at most.

    A state of no variance, which decays and which nothing drives, has that share of a diagonal `prior`.
    """
    own = np.diagonal(Y)
    return symmetrise(Y + share * np.diag(np.where(own > 0, own, np.diagonal(prior))))


@dataclass(frozen=True, eq=False)
class RateWindows:
    """The windows of one rate, and what the noise budget asks of P1 there: P1 >= B/budget, B = b b'."""

    windows: WindowConditions
    b: Array
    mean: Array

    def least(self, P: Array) -> float:
        """ln of the least eigenvalue of (P, B)."""
        half = solve_triangular(self.b, np.linalg.cholesky(P), lower=True)
        return 2 * float(np.log(np.linalg.svd(half, compute_uv=False)[-1]))

    def driven(self, roundness: float) -> list[Array]:
        """The inverse of what the disturbance alone leaves, twice as much where the budget asks for the most.

        None where it is not definite in doubles: it is one guess among others.
        """
        left: Array = np.asarray(np.mean(self.windows.long_run(np.zeros_like(self.mean)), axis=0), dtype=float)
        try:
            shape = symmetrise(np.asarray(np.linalg.inv(rounded(left, roundness, np.zeros_like(left)))))
            return [shape + np.exp(self.least(shape)) * symmetrise(self.b @ self.b.T)]
        except np.linalg.LinAlgError:
            return []

    def scaled(
        self,
        shape: Array,
        budget: float,
        width: float = EXACT,
        late: Callable[[], bool] = lambda: False,
        below: float = np.inf,
    ) -> tuple[Array, float] | None:
        """The shape at the least scale that the budget allows, and ln lam there; None where none does.

        lam(c)/c falls with the scale c and lam(c) rises, so the least scale is the one on the budget. It is met to
        within the factor e^`width`, from above. ln lam rises at most as fast as ln c, so what is left of the budget is
        the least step towards it, and its slope so far tells the next. Once it is `late`, a scale that the budget
        allows does. None, too, where ln lam is not `below` a value: where it is as much at a smaller scale.
        """
        least, allowed = self.least(shape), float(np.log(budget))
        looks: dict[float, Look] = {}

        @cache
        def value(log_scale: float) -> float:
            at = min(looks, key=lambda known: abs(known - log_scale), default=None)
            if at is None or not abs(at - log_scale) <= looks[at].reach:
                looks[log_scale] = self.windows.looked(np.exp(log_scale) * shape)
                return looks[log_scale].value
            return looks[at].along(log_scale - at)

        def excess(log_scale: float) -> float:
            return value(log_scale) - log_scale - least - allowed

        left, near = excess(0.0), 0.0
        if left > 0 and value(0.0) >= below:
            return None
        direction, step = (1.0 if left > 0 else -1.0), PAST * abs(left) + width
        while (excess(far := direction * min(abs(near) + step, WIDEST)) > 0) == (direction > 0):
            if not abs(near) + step < WIDEST:  # neither where nothing is a number
                return None
            if direction > 0 and value(far) >= below:
                return None
            slope = max((abs(left) - abs(excess(far))) / step, LEAST_SLOPE)
            near, left = far, excess(far)
            step = max(PAST * abs(left) / slope, 2 * step)  # where lam rises as fast as c, no slope tells how far
        low, high = sorted((near, far))
        if value(low) >= below:
            return None
        if late():
            return np.exp(high) * shape, excess(high) + high + least + allowed
        last = float(brentq(excess, low, high, xtol=width, rtol=1e-12)) + 2 * width
        return np.exp(last) * shape, value(last)
