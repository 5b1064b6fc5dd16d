"""Cells of a box of plants for the worst schedule: what sigma at their corners says of every plant inside.

With O(d) = O_0 + sum d_k O_k + X, |d_k| <= 1, |sum +-O_k| <= first and |X| <= second, for every x and every schedule

    |O_0 x + sum d_k O_k x|^2  >=  |O_0 x|^2 + 2 sum d_k (O_0 x)'(O_k x),

which is least at a corner c, where it is |O_0 x + sum c_k O_k x|^2 - |sum c_k O_k x|^2. So, on the whole cell,

    sigma  >=  sqrt((least sigma of the corners - second)^2 - first^2) - second,

off by second order. Where there are too many corners the centre stands for them: sigma of it - first - second.

Where states have units far apart the same is better said in balanced coordinates z, as a share of what each x shows:
with sigma_z of the corners there and f = first_z/sigma_z, g = second_z/sigma_z, |z| <= |O z|/sigma_z gives

    sigma  >=  (sqrt((1 - g)^2 - f^2) - g) (least sigma of the corners),   (1 - f - g) sigma for the centre.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sampling_design.observability.worst_case.worst_case_sigma import WorstCaseSigma
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array
from sampling_design.schedules.jitter import ON_TIME, TimingTolerance
from sampling_design.schedules.spaced_windows import SpacedWindows
from sampling_design.uncertain.box.branching import halved
from sampling_design.uncertain.box.expansion import UP, BoxCells, bases, norms_in, signs
from sampling_design.uncertain.box.model import BoxModel

SigmaOfOne = Callable[[Plant, float, float], WorstCaseSigma]
"""Sigma of a plant, to a tolerance, in so many seconds."""

MOST_CORNERS = 4  # parameters up to which cells are judged by their corners
WIDE = 10.0  # units this far apart, in balanced coordinates, are told by what sigma is there
FINER = 0.25  # share of the tolerance that the bracket of each single plant may take


def parts_of(model: BoxModel, cell: BoxCells, family: SpacedWindows) -> BoxCells:
    """Both halves of a cell, along the parameter that moves the rows most."""
    effect = np.zeros((1, model.m + 1))
    effect[:, :-1] = np.linalg.norm(model.parts_A, axis=(1, 2)) * family.window * cell.half
    effect[:, :-1] += np.linalg.norm(model.parts_C, axis=(1, 2)) * cell.half
    return halved(cell, effect)


def points_of(cell: BoxCells) -> Array:
    """The plants (P, m) by which a cell is judged: its corners, or its centre where there are too many."""
    u, half = cell.u[0], cell.half[0]
    if u.size > MOST_CORNERS:
        return np.asarray(cell.u)
    return np.asarray(u + signs(u.size) * half)


def least_over(
    model: BoxModel,
    cell: BoxCells,
    family: SpacedWindows,
    least: float,
    balanced: float = 0.0,
    late: TimingTolerance = ON_TIME,
) -> float:
    """At most sigma of every plant of a cell and any k times in the window; `least`: of the plants of `points_of`.

    `balanced` is at most their sigma in balanced coordinates; 0 where it is not known.
    """
    A, C = model.at(cell.u)
    ends, found = latest(family, late), 0.0
    for T in bases(A, C, np.array([family.window])):
        inverse = np.linalg.inv(T).astype(complex)
        norms, _, _ = norms_in(model, cell, A, C, T, inverse)
        with np.errstate(over="ignore", invalid="ignore"):
            rows = norms.rows(ends[None], np.maximum(norms.rate, 0.0))
            first, second = (UP * float(np.linalg.norm(part)) for part in rows)
            own, there = (float(np.linalg.norm(X, 2, axis=(1, 2))[0]) for X in (inverse, inverse / model.unit))
            shares = [left(least, there * first, there * second, cell.u.shape[1])]
            if balanced > 0:
                shares.append(least * left(1.0, own * first / balanced, own * second / balanced, cell.u.shape[1]))
        found = max(found, *(share for share in shares if np.isfinite(share)), 0.0)
    return found


def left(least: float, first: float, second: float, parameters: int) -> float:
    """What is left of the least sigma of the points of a cell, all over it."""
    if parameters > MOST_CORNERS:
        return least - first - second
    return float(np.sqrt(max(max(least - second, 0.0) ** 2 - first**2, 0.0)) - second)


def latest(family: SpacedWindows, late: TimingTolerance = ON_TIME) -> Array:
    """By when each sample is taken at the latest, once for each output where these are read at times of their own."""
    planned = np.maximum(family.window - family.spacing * np.arange(family.count), 0.0)
    return np.asarray(np.repeat(planned + late.span, len(late.early)) * UP)
