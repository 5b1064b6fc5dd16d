"""Lower bounds of sigma over all spaced schedules and every plant of a box, in ball arithmetic (extra `rigorous`).

In each cell sigma of one plant, proven as in `worst_case/balls.py`, less what the rows of the others differ from its
rows: |C(theta) e^{A(theta) r} z - C e^{A r} z| <= e^{mu r} (seen (e^{e r} - 1) + shown e^{e r}) |z|_W, 0 <= r <= T.
"""

from __future__ import annotations

import time

import numpy as np

from sampling_design._ball_flow import Clock, OutOfTime
from sampling_design._balls import Ball, ball, flint, frobenius, identity, largest, matrix, positive_part, precision
from sampling_design.observability.box.balls import BallBox, BallCell, Metric, largest_over
from sampling_design.observability.box.expansion import BoxCells
from sampling_design.observability.box.model import BoxModel
from sampling_design.observability.windows.balls import SHAVES, ProvenSigma
from sampling_design.observability.worst_case.balls import prove_worst_sigma
from sampling_design.observability.worst_case.cells_over_box import SigmaOfOne, parts_of
from sampling_design.plants.plant import Plant
from sampling_design.schedules.spaced_windows import SpacedWindows

SMALLEST = 2.0**-20
"""Cells below this share of the box are not halved further."""
UP = 1 + 2.0**-50
"""Covers the rounding of one double."""


def prove_worst_over_box(
    model: BoxModel,
    family: SpacedWindows,
    guess: float,
    rtol: float,
    cells: list[BoxCells],
    one: SigmaOfOne,
    seconds: float,
) -> ProvenSigma:
    """Prove a lower bound of sigma over a box and all schedules of a family, as near to `guess` as can be.

    Parameters
    ----------
    model : BoxModel
    family : SpacedWindows
        Window, count and spacing are the doubles that the theorem is about.
    guess : float
        What floats believe.
    rtol : float
        Tolerance of the search of one plant, whose worst times the proof begins with.
    cells : list of BoxCells
        Of which floats believe it; together the box.
    one : callable
        Sigma of one plant in floats, with its worst times.
    seconds : float
        Budget.

    Returns
    -------
    ProvenSigma
        lower = 0 where nothing is proven in time.

    Raises
    ------
    MissingExtraError
        If python-flint is not installed.
    """
    flint()
    if not 0 < guess < np.inf:
        return ProvenSigma(guess, 0.0, "closed")
    clock, mu = Clock(seconds), guess * (1 - SHAVES[0])
    box, pending = BallBox(model), [part.take(np.array([k])) for part in cells for k in range(len(part.s))]
    try:
        while pending:
            clock.check()
            cell = pending.pop()
            centre = model.plant.at(model.values(cell.u[0]))
            needed = mu + _spread(box, cell, centre, family)
            if needed < np.inf:
                lower, _, worst = one(centre, rtol, np.inf)
                left = max(0.0, clock.end - time.monotonic())
                if lower >= needed and prove_worst_sigma(centre, family, needed * UP, worst, left, (0.0,)).lower:
                    continue
            clock.check()
            if cell.half.max(initial=0.0) < SMALLEST:
                return ProvenSigma(0.0, 0.0, "rounding")
            parts = parts_of(model, cell, family)
            pending += [parts.take(np.array([k])) for k in range(len(parts.s))]
    except OutOfTime:
        return ProvenSigma(0.0, 0.0, "budget")
    return ProvenSigma(mu, 0.0, "closed")


def _spread(box: BallBox, one: BoxCells, centre: Plant, family: SpacedWindows) -> float:
    """At least |O(theta) - O(centre)| over a cell, for any k times in the window; infinity where nothing is proven."""
    least = np.inf
    with precision():
        exact = box.cell(one.u[0], one.half[0])
        A, C = box.balanced(matrix(centre.A), matrix(centre.C))
        cell = BallCell(A, C, exact.parts_A, exact.parts_C)
        off_A, off_C = frobenius(exact.A - A), frobenius(exact.C - C)
        for metric in box.metrics(cell, family.window):
            found = _spread_in(box, metric, (off_A, off_C), family)
            least = least if found is None else min(least, float(found) * UP)
    return least


def _spread_in(box: BallBox, metric: Metric, off: tuple[Ball, Ball], family: SpacedWindows) -> Ball | None:
    """The same in one metric; `off`: by how much the centre's doubles are beside the middle of the cell."""
    eye = identity(box.n)
    rounded = largest_over(eye * (largest(metric.W) * off[0] * off[0]), metric.W)
    shown = largest_over(eye * (off[1] * off[1]), metric.W)
    there = largest_over(metric.W, box.unit.transpose() * box.unit)
    if rounded is None or shown is None or there is None:
        return None
    T = ball(family.window)
    along = (metric.moved + rounded.sqrt()) * T
    row = metric.seen * along.expm1() + (metric.shown + shown.sqrt()) * along.exp()
    whole = (positive_part(metric.rate) * T).exp() * row * (there * family.count).sqrt()
    return whole.upper()
