"""Lower bounds of sigma over all spaced schedules and every plant of a box, in ball arithmetic (extra `rigorous`).

The proof is that of `worst_case_cells.py`: sigma of the corners of a cell, proven as in `worst_case/balls.py`, and what
the rows of all plants of the cell are beside those of its middle, to first order and beyond, in metrics of `box/`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sampling_design.numerics.balls import Ball, ball, flint, frobenius, identity, largest, matrix, positive_part
from sampling_design.numerics.branch_and_bound import all_proven
from sampling_design.observability.sigma_bracket import ProvenSigma
from sampling_design.observability.windows.balls import SHAVES, nearest_proven
from sampling_design.observability.worst_case.balls import prove_worst_sigma
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array
from sampling_design.records.budget import Budget
from sampling_design.schedules.jitter import ON_TIME, TimingTolerance
from sampling_design.schedules.spaced_windows import SpacedWindows
from sampling_design.uncertain.box.balls import BallBox, CellMetric, largest_over
from sampling_design.uncertain.box.expansion import BoxCells
from sampling_design.uncertain.box.model import BoxModel
from sampling_design.uncertain.observability.worst_case_cells import SigmaOfOne, parts_of, points_of

SMALLEST = 2.0**-20  # cells below this share of the box are not halved further
UP = 1 + 2.0**-50  # covers the rounding of one double


def prove_worst_over_box(
    model: BoxModel,
    family: SpacedWindows,
    guess: float,
    rtol: float,
    cells: list[BoxCells],
    one: SigmaOfOne,
    seconds: float,
    late: TimingTolerance = ON_TIME,
) -> ProvenSigma:
    """Prove a lower bound of sigma over a box and all schedules of a family: see `nearest_proven`.

    Floats believe it of `cells`, which together are the box; `one` is sigma of one plant in floats with its worst
    times, to a tolerance `rtol`, from which its proof begins.
    """

    def begin(clock: Budget) -> Callable[[float], bool]:
        box, known = BallBox(model), dict[tuple[float, ...], float]()

        def reaches(u: Array, plant: Plant, needed: float) -> bool:
            clock.check()
            at = tuple(u.tolist())
            if known.get(at, 0.0) < needed < np.inf:
                found = one(plant, rtol, np.inf)
                left = clock.left
                if found.lower >= needed:
                    proof = prove_worst_sigma(plant, family, needed * UP, found.witness, left, (0.0,), late)
                    known[at] = proof.lower
            return known.get(at, 0.0) >= needed

        def proves(mu: float) -> bool:
            def proven(cell: BoxCells) -> list[BoxCells] | None:
                points = points_of(cell)
                plants = [model.plant.at(model.values(u)) for u in points]
                needed = _needed(box, cell, (points, plants), (family, late), mu)
                if all(reaches(u, plant, needed) for u, plant in zip(points, plants, strict=True)):
                    return []
                small = cell.half.max(initial=0.0) < SMALLEST
                return None if small else parts_of(model, cell, family).each()

            return all_proven([cell for part in cells for cell in part.each()], proven, clock)

        return proves

    return nearest_proven(guess, seconds, begin, shaves=SHAVES[:1])


def _needed(
    box: BallBox,
    one: BoxCells,
    judged: tuple[Array, list[Plant]],
    rule: tuple[SpacedWindows, TimingTolerance],
    mu: float,
) -> float:
    """What sigma of the plants by which a cell is judged must be for sigma >= mu all over it; infinity if unknown."""
    least, points = np.inf, judged[0]
    cell, off_A, off_C = box.cell(one.u[0], one.half[0]), flint().arb(0), flint().arb(0)
    for u, plant in zip(*judged, strict=True):
        exact, (A, C) = box.cell(u, 0 * u), box.balanced(matrix(plant.A), matrix(plant.C))
        off_A, off_C = off_A.max(frobenius(exact.A - A)), off_C.max(frobenius(exact.C - C))
    for metric in box.metrics(cell, rule[0].window):
        spread = _pulse_sizes(box, metric, (off_A, off_C), *rule)
        if spread is not None:
            first, second = spread
            corners = ((second + mu) ** 2 + first * first).sqrt() + second
            found = corners if len(points) > 1 else first + second + mu
            least = min(least, float(found.upper()) * UP)
    return least


def _pulse_sizes(
    box: BallBox, metric: CellMetric, off: tuple[Ball, Ball], family: SpacedWindows, late: TimingTolerance
) -> tuple[Ball, Ball] | None:
    """At least |sum +-O_k| and |X| over a cell, in one metric; `off`: the rounding of the plants that are judged."""
    eye = identity(box.n)
    rounded = largest_over(eye * (largest(metric.W) * off[0] * off[0]), metric.W)
    output_moved = largest_over(eye * (off[1] * off[1]), metric.W)
    there = largest_over(metric.W, box.unit.transpose() * box.unit)
    if rounded is None or output_moved is None or there is None:
        return None
    norms = metric.norms
    lost = replace(norms, moved=rounded.sqrt(), output_moved=output_moved.sqrt())
    both = replace(norms, moved=norms.moved + lost.moved, output_moved=norms.output_moved + lost.output_moved)
    first, second, rate = flint().arb(0), flint().arb(0), positive_part(norms.rate)
    for j in range(family.count):
        t = positive_part(ball(family.window) - ball(family.spacing) * j) + ball(max(late.early)) + ball(max(late.late))
        first += norms.rows(t, rate)[0] ** 2
        second += (lost.rows(t, rate)[0] + both.rows(t, rate)[1]) ** 2
    first, second = (part * len(late.early) for part in (first, second))  # outputs read at times of their own
    return (first * there).sqrt().upper(), (second * there).sqrt().upper()
