"""Bounds and constraint sets together, as an interval may take them for granted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sampling_design.accuracy.readings import DisturbanceSet, RowReading
from sampling_design.errors import ArgumentError
from sampling_design.estimators.constraints.convex_set import ConvexSet
from sampling_design.estimators.constraints.window_constraints import WindowConstraints
from sampling_design.estimators.online.evidence import EstimateAssumptions, SetBounds

INSIDE = 1e-12  # share of a box by which a ball may stand out of it and still be taken for what is known


def common(name: str, known: DisturbanceSet, chosen: ConvexSet | None) -> DisturbanceSet:
    """Return a set that holds what a bound and a constraint set have in common: a ball within both, else a box.

    Raises ArgumentError if they have nothing in common.
    """
    if chosen is None:
        return known
    reach = np.linalg.norm(known.root, axis=1) if known.ball else np.abs(known.root).sum(axis=1)
    lower, upper = chosen.bounding_box()
    lower, upper = np.maximum(lower, known.centre - reach), np.minimum(upper, known.centre + reach)
    if np.any(lower > upper):
        raise ArgumentError(f"`{name}_bound` and `constraints.{name}` must have something in common, got none.")
    balls = [known] if known.ball else []
    for part in chosen.round_balls:
        back = part.inverse()
        if back is not None:
            balls.append(DisturbanceSet(part.centre, part.radius * back, True))
    slack = INSIDE * (upper - lower)
    for one in balls:
        reach = np.linalg.norm(one.root, axis=1)
        if np.all(one.centre - reach >= lower - slack) and np.all(one.centre + reach <= upper + slack):
            return one
    return DisturbanceSet((lower + upper) / 2, np.diag((upper - lower) / 2), False)


def one_sided(chosen: ConvexSet | None) -> tuple[RowReading, ...]:
    """Return the linear inequalities of a set of states: its box (that of its balls, too) and its half-spaces."""
    if chosen is None:
        return ()
    (lower, upper), identity = chosen.bounding_box(), np.eye(chosen.dimension)
    found = [RowReading(row, float(bound), 0.0, True) for row, bound in zip(identity, upper, strict=True)]
    found += [RowReading(-row, -float(bound), 0.0, True) for row, bound in zip(identity, lower, strict=True)]
    found += [RowReading(row, float(bound), 0.0, True) for row, bound in zip(chosen.rows, chosen.offsets, strict=True)]
    return tuple(row for row in found if np.isfinite(row.y))


def narrowed(found: EstimateAssumptions, sets: WindowConstraints) -> EstimateAssumptions:
    """Return assumptions with constraint sets for x, v and w; one for the measured output says nothing new."""
    noise = common("v", DisturbanceSet(found.noise.centre, np.diag(found.noise.size), found.noise.ball), sets.v)
    size = np.linalg.norm(noise.root, axis=1)
    straight = bool(np.all(noise.root == np.diag(size))) if noise.root.shape == (size.size,) * 2 else False
    noise_bound = SetBounds(noise.centre, size, noise.ball and straight)
    return replace(
        found, disturbance=common("w", found.disturbance, sets.w), noise=noise_bound, state=one_sided(sets.x)
    )
