"""Lower bounds of sigma over all spaced schedules and every plant of a box, in ball arithmetic (extra `rigorous`).

The proof is that of `worst_case_cells.py`: sigma of the corners of a cell, proven as in `worst_case/balls.py`, and what
the rows of all plants of the cell are beside those of its middle, to first order and beyond, in metrics of `box/`.
"""

from __future__ import annotations

import time

import numpy as np
import numpy.typing as npt

from sampling_design.numerics.ball_flow import OutOfTime, TimeBudget
from sampling_design.numerics.balls import (
    Ball,
    ball,
    flint,
    frobenius,
    identity,
    largest,
    matrix,
    positive_part,
    precision,
)
from sampling_design.observability.windows.balls import SHAVES, ProvenSigma
from sampling_design.observability.worst_case.balls import prove_worst_sigma
from sampling_design.plants.plant import Plant
from sampling_design.schedules.spaced_windows import SpacedWindows
from sampling_design.uncertain.box.balls import BallBox, CellMetric, beyond_first_in_balls, largest_over
from sampling_design.uncertain.box.expansion import BoxCells
from sampling_design.uncertain.box.model import BoxModel
from sampling_design.uncertain.observability.worst_case_cells import SigmaOfOne, parts_of, points_of

Array = npt.NDArray[np.float64]

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
    clock, mu = TimeBudget(seconds), guess * (1 - SHAVES[0])
    box, pending = BallBox(model), [part.take(np.array([k])) for part in cells for k in range(len(part.s))]
    known = dict[tuple[float, ...], float]()
    try:
        while pending:
            cell = pending.pop()
            points = points_of(cell)
            plants = [model.plant.at(model.values(u)) for u in points]
            needed = _needed(box, cell, (points, plants), family, mu)
            for u, plant in zip(points, plants, strict=True):
                clock.check()
                at = tuple(u.tolist())
                if known.get(at, 0.0) < needed < np.inf:
                    lower, _, worst = one(plant, rtol, np.inf)
                    left = max(0.0, clock.end - time.monotonic())
                    if lower >= needed:
                        known[at] = prove_worst_sigma(plant, family, needed * UP, worst, left, (0.0,)).lower
                if not known.get(at, 0.0) >= needed:
                    break
            else:
                continue
            clock.check()
            if cell.half.max(initial=0.0) < SMALLEST:
                return ProvenSigma(0.0, 0.0, "rounding")
            parts = parts_of(model, cell, family)
            pending += [parts.take(np.array([k])) for k in range(len(parts.s))]
    except OutOfTime:
        return ProvenSigma(0.0, 0.0, "budget")
    return ProvenSigma(mu, 0.0, "closed")


def _needed(box: BallBox, one: BoxCells, judged: tuple[Array, list[Plant]], family: SpacedWindows, mu: float) -> float:
    """What sigma of the plants by which a cell is judged must be for sigma >= mu all over it; infinity if unknown."""
    least, points = np.inf, judged[0]
    with precision():
        cell, off_A, off_C = box.cell(one.u[0], one.half[0]), flint().arb(0), flint().arb(0)
        for u, plant in zip(*judged, strict=True):
            exact, (A, C) = box.cell(u, 0 * u), box.balanced(matrix(plant.A), matrix(plant.C))
            off_A, off_C = off_A.max(frobenius(exact.A - A)), off_C.max(frobenius(exact.C - C))
        for metric in box.metrics(cell, family.window):
            spread = _spread(box, metric, (off_A, off_C), family)
            if spread is not None:
                first, second = spread
                corners = ((second + mu) ** 2 + first * first).sqrt() + second
                found = corners if len(points) > 1 else first + second + mu
                least = min(least, float(found.upper()) * UP)
    return least


def _spread(
    box: BallBox, metric: CellMetric, off: tuple[Ball, Ball], family: SpacedWindows
) -> tuple[Ball, Ball] | None:
    """At least |sum +-O_k| and |X| over a cell, in one metric; `off`: the rounding of the plants that are judged."""
    eye = identity(box.n)
    rounded = largest_over(eye * (largest(metric.W) * off[0] * off[0]), metric.W)
    shown = largest_over(eye * (off[1] * off[1]), metric.W)
    there = largest_over(metric.W, box.unit.transpose() * box.unit)
    if rounded is None or shown is None or there is None:
        return None
    rounded, shown = rounded.sqrt(), shown.sqrt()
    first, second = flint().arb(0), flint().arb(0)
    for j in range(family.count):
        t = positive_part(ball(family.window) - ball(family.spacing) * j)
        grown, along = (positive_part(metric.rate) * t).exp(), metric.moved * t
        beyond = beyond_first_in_balls(along + rounded * t)
        off_first = metric.seen * (rounded * t) + shown
        rest = metric.seen * beyond + (metric.shown + shown) * (along + rounded * t + beyond) + off_first
        first += (grown * (metric.seen * along + metric.shown)) ** 2
        second += (grown * rest) ** 2
    return (first * there).sqrt().upper(), (second * there).sqrt().upper()
