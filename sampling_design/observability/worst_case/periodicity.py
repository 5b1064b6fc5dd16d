"""Plants whose rows repeat: windows of many periods hold no schedule that a window of few does not."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction

from sampling_design.plants.plant import Plant
from sampling_design.schedules.spaced_windows import SpacedWindows

MOST_STATES = 12  # states up to which products in fractions are formed: a few thousand of them

ROUNDED_UP = 1 + 1e-9
"""By which a period, and with it a window, is lengthened: a longer one holds every schedule of a shorter one."""


def exact_period(plant: Plant) -> float | None:
    """Return an upper bound on P with e^{AP} = I exactly, at most 1e-9 above it; None where none is proven.

    Notes
    -----
    *Claim.* If A^3 = -c A with c > 0, the eigenvalues are 0 and +-i sqrt(c), without Jordan blocks, so that
    P = 2 pi/sqrt(c). *Method.* In fractions: doubles are fractions, nothing is rounded.
    """
    n = plant.n_states
    if not 0 < n <= MOST_STATES:
        return None
    A = [[Fraction(value) for value in row] for row in plant.A.tolist()]
    cube = _product(_product(A, A), A)
    at = next(((i, j) for i in range(n) for j in range(n) if A[i][j]), None)
    if at is None:
        return None
    i, j = at
    c = -cube[i][j] / A[i][j]
    if c <= 0 or any(cube[i][j] != -c * A[i][j] for i in range(n) for j in range(n)):
        return None
    period = 2 * math.pi / math.sqrt(float(c)) * ROUNDED_UP if 0 < float(c) < math.inf else math.inf
    return period if math.isfinite(period) else None


def within_periods(plant: Plant, family: SpacedWindows) -> SpacedWindows:
    """Return the family in the shortest window that is known to hold samples of all its phases.

    Notes
    -----
    *Claim.* With period P, the first sample can be moved into [0, P) and every gap be shortened by whole periods to
    less than spacing + P, at the same rows. So k P + (k - 1) spacing is long enough, whatever the window.
    """
    period = exact_period(plant)
    if period is None:
        return family
    enough = family.count * period + (family.count - 1) * family.spacing
    return replace(family, window=enough) if enough < family.window else family


def _product(A: list[list[Fraction]], B: list[list[Fraction]]) -> list[list[Fraction]]:
    columns = list(zip(*B, strict=True))
    return [[sum((a * b for a, b in zip(row, column, strict=True)), Fraction(0)) for column in columns] for row in A]
