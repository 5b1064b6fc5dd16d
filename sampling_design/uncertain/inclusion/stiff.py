"""Programs of a stiff plant: rates from below one to millions per gap.

What a fast state may weigh falls with its rate, so that the entries of P differ by as many decades as the rates do. Two
things bring the numbers back to about 1. The flow condition F > 0 is posed in the coordinates of its own size, as
N^-1/2 F N^-1/2 with N the size of A + A' (a congruence: nothing is changed but what a solver sees). And the coordinates
of P are found in turns: the slackest P under a bound, then the coordinates in which it is about I, then again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from sampling_design.records.arrays import Array
from sampling_design.records.evidence import SolverRecord
from sampling_design.uncertain.inclusion.members import InclusionPlants
from sampling_design.uncertain.inclusion.program import (
    InclusionData,
    InclusionProgram,
    InclusionSolution,
    flow_scale,
    flow_slacks,
    in_coordinates,
    jump_slacks,
    worst_violated,
)

Posing = Callable[[Array], tuple[InclusionData, Array]]
Solver = Callable[[InclusionProgram], tuple[Array | None, float, SolverRecord]]

TURNS = 6  # turns in which coordinates are found
SLACK_ENOUGH = 0.2  # slack, relative to the terms of the flow condition, from which on another turn gains little
ROUNDS = 12
JOINING = 8
"""Members that join at once, and how often."""
STAGES = ((0.0, False), (0.3, False), (1.0, False), (1.0, True))
"""Coordinates are found first for members near their middle, then for those that begin, then for all that join."""
DRAWN, LEAST_DRAWN = 0.6, 0.92
"""Power of lambda that is asked for in the next turn; where that is not there, its root, up to the last one."""
LEAST_SLACK = 0.05
"""A P(tau) of less slack is not drawn together further: its proof would need cells that are too small."""


def fitted(
    search: InclusionPlants, posing: Posing, T: Array, solve: Solver, share: float, join: bool
) -> tuple[InclusionSolution, float, Array] | None:
    """Solve for the members chosen, drawn to their mean; those that the solution violates join until none does.

    The solution, in coordinates where its bound W, with W <= P <= lambda W, is I; its slack; and the coordinates where
    the mean of its P is I.
    """
    for _ in range(ROUNDS):
        if search.budget.over:
            return None
        posed, _T = posing(T)
        posed = drawn(search, posed, share)
        some = replace(posed, dynamics=posed.dynamics[search.chosen] if share else posed.dynamics[:1],
                       outputs=posed.outputs[:, search.chosen_outputs])  # fmt: skip
        program = InclusionProgram(some, search.budget.seconds_left())
        x, slack, record = solve(program)
        if x is None:
            return None
        P = program.matrices(x)
        if not np.all(np.linalg.eigvalsh(P)[:, 0] > 0):
            return None
        if join:
            bad = worst_violated(flow_slacks(posed, P), search.chosen, JOINING)
            hidden = worst_violated(jump_slacks(posed, P, program.gains(x)), search.chosen_outputs, JOINING)
            added = adversaries(search, posed, P, T)
            if len(added):
                count = len(search.members.dynamics)
                everyone = np.concatenate([search.members.dynamics, added])
                search.members = search.members._replace(dynamics=everyone)
                bad += range(count, len(everyone))
            search.chosen, search.chosen_outputs = (
                sorted({*search.chosen, *bad}),
                sorted({*search.chosen_outputs, *hidden}),
            )
            if bad or hidden:
                continue
        root, W = np.linalg.cholesky(np.mean(P, axis=0)), program.bound(x)
        own = np.asarray(root if W is None else np.linalg.cholesky(W), dtype=np.float64)
        gains = np.zeros((0, 0, 0))
        found = InclusionSolution(some.turned(own), in_coordinates(P, own), T @ own, None, gains, record)
        return found, slack, T @ root
    return None


def drawn(search: InclusionPlants, posed: InclusionData, share: float) -> InclusionData:
    """Members drawn to their mean by a share, and pushed outwards by the search's inflation."""
    if search.hull is not None and share == 1:  # whose directions are inflated instead
        return posed
    middle = posed.dynamics.mean(axis=0)
    return replace(posed, dynamics=middle + share * (1 + search.inflation) * (posed.dynamics - middle))


def adversaries(search: InclusionPlants, posed: InclusionData, P: Array, T: Array) -> Array:
    """Corners of the hull's cells at which the flow condition fails most, found by turns of vector and signs."""
    if search.hull is None:
        return np.zeros((0, *search.members.dynamics.shape[1:]))
    n, scale = posed.n, flow_scale(posed)
    both, slope = posed.slopes(P)
    far = (1 + search.inflation) * search.hull.moves
    M, D = (search.moved(X, T)[..., None, :, :] for X in (search.hull.middle, far))

    def forms(X: Array) -> Array:
        drift, off = both @ X[..., :n], -(both @ X[..., n:])
        corner = -(drift + np.swapaxes(drift, -1, -2))
        empty = np.zeros((*off.shape[:-2], off.shape[-1], off.shape[-1]))
        full = np.concatenate(
            [np.concatenate([corner, off], -1), np.concatenate([np.swapaxes(off, -1, -2), empty], -1)], -2
        )
        return np.asarray(scale.T @ full @ scale)

    still = np.zeros((len(both), n + posed.Qw.shape[0], n + posed.Qw.shape[0]))
    still[:, :n, :n], still[:, n:, n:] = -(slope + posed.eta * both), posed.Qw
    F, FD = scale.T @ still @ scale + forms(M), forms(D)
    values, vectors = np.linalg.eigh(F)
    signs = np.zeros(FD.shape[:3])
    for _ in range(TURNS):
        v = vectors[..., 0]
        signs = np.where(np.einsum("dkeij,kei,kej->dke", FD, v, v) > 0, -1.0, 1.0)
        values, vectors = np.linalg.eigh(F + np.einsum("dke,dkeij->keij", signs, FD))
    least = values[..., 0]
    found: dict[tuple[int, bytes], Array] = {}
    for at in np.argsort(least, axis=None)[: 4 * JOINING]:
        k, e = np.unravel_index(at, least.shape)
        if least[k, e] < 0 and len(found) < JOINING:
            sign = signs[:, k, e]
            found[int(k), sign.tobytes()] = search.hull.middle[k] + np.tensordot(sign, far[:, k], 1)
    return np.array(list(found.values())).reshape(len(found), *search.hull.middle.shape[1:])


def solve_stiff(search: InclusionPlants, eta: float, pieces: int, narrow: bool) -> InclusionSolution | None:
    """A P(tau) of large slack, or the narrowest that leaves some."""

    def posing(T: Array) -> tuple[InclusionData, Array]:
        return search.inner(eta, pieces, T)

    best: InclusionSolution | None = None
    T = search.inner(eta, pieces)[1]
    for share, join in STAGES:
        before = 0.0
        for _ in range(TURNS):
            found = fitted(search, posing, T, InclusionProgram.slackest, share, join)
            if found is None:
                return None
            best, slack, T = found
            if slack > SLACK_ENOUGH or slack < 1.2 * before:
                break
            before = slack
    power = DRAWN
    while narrow and best is not None and best.lam > 1.05 and power < LEAST_DRAWN:
        ratio = float(best.lam**power)
        found = fitted(search, posing, T, partial(InclusionProgram.within, ratio=ratio), 1.0, True)
        if found is None or found[1] < LEAST_SLACK or not found[0].lam < 0.98 * best.lam:
            power = float(np.sqrt(power))
        else:
            best, _, T = found
    return best
