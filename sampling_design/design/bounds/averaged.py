"""The bound from windows that follow every sample, averaged over the samples of a period as origins.

With d_i the distance from a sample to its i-th follower, averages over origins of any f_i(d_i) obey two
laws. The mean of d_i is i P/k, so that a tilt mu_i (d_i - i P/k) may be added. And followers i and k - i
come in pairs d and P - d, so that g may be replaced by its mirror mean. Every schedule that may be turned
(see `zones`) then has sigma^2 <= g(0) + max over chains d_1 < ... < d_{k-1} of the sum of
g(d_i) + mu_i (d_i - i P/k): exact for even spacing where g is concave enough, which the tilt allows.
"""

from __future__ import annotations

import numpy as np

from sampling_design.design.bounds.relaxation import JUST_BESIDE, TOLERANCE, Relaxation, feasible_multipliers, grams_at
from sampling_design.design.bounds.weak_duality import (
    TimeCells,
    best_layers,
    cell_values,
    cells,
    jump_times,
    peaks,
    piece_edges,
    profile,
    rooted,
    value_at,
)
from sampling_design.design.bounds.zones import follower_zones, widest_gap
from sampling_design.design.problem.numbers import DesignProblem
from sampling_design.numerics import conic_programs
from sampling_design.records.arrays import Array, Index

_VARIABLES = 240  # grid points over all followers, about: each follower gets its share
_STARTS = 24  # window starts after the origin


def relax_averaged(problem: DesignProblem, zones: Array) -> tuple[Relaxation, Array]:
    """Maximise t over the laws of the followers' distances; multipliers and the tilt mu (k-1,)."""
    rows, k, P = problem.rows, problem.samples, problem.period
    half = k // 2
    zone = follower_zones(problem, zones)[:half].copy()
    if k % 2 == 0:
        zone[-1, 1] = P / 2
    count = int(np.clip(_VARIABLES // max(half, 1), 8, 40))
    times = np.concatenate([np.linspace(a, b, count) for a, b in zone])
    owner = np.repeat(np.arange(1, half + 1), count)
    starts = np.append(P * (1 - JUST_BESIDE), np.arange(_STARTS) * (P / _STARTS))
    every = np.ones((times.size, problem.plant.n_outputs), dtype=bool)
    pair = grams_at(problem, times, starts, every) + grams_at(problem, P - times, starts, every)
    pair[:, 2 * owner == k] /= 2
    anchor = grams_at(problem, np.zeros(1), starts, every[:1]).sum(axis=1)
    tilted = half - (k % 2 == 0)
    belongs = (owner[None, :] == np.arange(1, half + 1)[:, None]).astype(float)
    last = np.zeros((half, 1))
    blocks: list[tuple[str, Array, Array]] = [("zero", np.hstack([belongs, last]), np.ones(half))]
    if tilted:
        means = np.hstack([belongs * times / P, last])[:tilted]
        blocks.append(("zero", means, np.arange(1, tilted + 1) / k))
    blocks.append(("nonnegative", -np.eye(times.size, times.size + 1), np.zeros(times.size)))
    roof = conic_programs.svec(rows.N)[:, None]
    for m in range(starts.size):
        blocks.append(("psd", np.hstack([-conic_programs.svec(pair[m]).T, roof]), conic_programs.svec(anchor[m])))
    cost = np.zeros(times.size + 1)
    cost[-1] = -1.0
    found = conic_programs.solve_cone_program(cost, blocks, tolerance=TOLERANCE)
    Z, mass = feasible_multipliers(problem, found.z[len(blocks) - starts.size :])
    tilt = np.zeros(k - 1)
    if tilted:  # the multiplier of a mean serves follower i and, mirrored, follower k - i
        tilt[:tilted] = -np.nan_to_num(found.z[1]) / (2 * P * mass)
        tilt[k - 1 - tilted :] = -tilt[:tilted][::-1]
    weights = np.clip(np.nan_to_num(found.x[:-1]), 0.0, None)
    return Relaxation(times, weights, starts, Z, found.x[-1] / rows.unit, found.record), tilt


def averaged_bound(problem: DesignProblem, starts: Array, Z: Array, tilt: Array, zones: Array) -> float:
    """Bound sigma of every schedule whose samples lie in `zones` after the one that is turned to 0."""
    k, P = problem.samples, problem.period
    alone = float(value_at(problem, starts, Z, np.zeros(1)).sum())
    if k == 1:
        return rooted(problem, alone)
    zone = follower_zones(problem, zones)
    width = cells(problem, 0.0, P)
    arc = TimeCells(float(zone[0, 0]), float(zone[-1, 1]), width.width, width.apart)
    marks = np.concatenate([jump_times(problem, starts), arc.edges])
    edges = piece_edges(P, np.concatenate([marks, P - marks]))
    g = profile(problem, starts, Z, edges)
    bend, top = np.sum(g.bend, axis=1), peaks(g)
    middle = (edges[:-1] + edges[1:]) / 2
    mirrored = np.clip(np.searchsorted(edges, P - middle) - 1, 0, edges.size - 2)
    top = (top + top[_nearest(edges, P - edges)]) / 2
    rest = np.diff(edges) ** 2 / 16 * (bend + bend[mirrored])
    layers = []
    for i, (a, b) in enumerate(zone):
        centre = (i + 1) * P / k
        tilted = top + tilt[i] * (edges - centre)
        roof = np.maximum(tilted[:-1], tilted[1:]) + rest
        inside = (edges[1:] >= a) & (edges[:-1] <= b)
        layers.append(cell_values(arc, edges, np.where(inside, roof, -np.inf)))
    return rooted(problem, alone + best_layers(layers, arc, widest_gap(problem, zones)))


def _nearest(edges: Array, wanted: Array) -> Index:
    """Index of the edge nearest to each wanted time."""
    after = np.clip(np.searchsorted(edges, wanted), 1, edges.size - 1)
    return np.asarray(np.where(wanted - edges[after - 1] <= edges[after] - wanted, after - 1, after))
