"""Bound of the schedules in a box of zones, where the flow turns states and stretches none, by their order alone.

Seen from time 0, window m, which begins just before sample m, holds the samples from m on, and those before it a period
later: a sum in which each sample has its own term, wherever its zone and those of others overlap. For psd Z_m with
sum <Z_m, I> = 1 every schedule has

    sigma^2 <= sum over its samples of q_i(s_i),   q_i(t) = <sum_{m<=i} Z_m, E(t)> + <sum_{m>i} Z_m, E(t + P)>,

E(t) the Gram matrix of a sample at t and whole periods after it, as often as the window holds them; so it is at most
the sum of what each q_i is at most in its zone. The best Z belong to weights of every sample on its zone, by which the
least eigenvalue of all windows is largest (`eigenvalue_program`).
"""

from __future__ import annotations

from math import comb

import numpy as np

from sampling_design.design.bounds.weak_duality import rooted
from sampling_design.design.bounds.zones import MARGIN, Cut
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.gram import EPS, MANY_STATES, ROUNDING_MARGIN
from sampling_design.design.problem.orthogonal_flow import OrthogonalFlowWindows, squares
from sampling_design.numerics.eigenvalue_program import EigenvalueBracket, MixedMatrices, brackets
from sampling_design.records.arrays import Array, Index
from sampling_design.records.budget import Budget

_APART = 1.1  # radians of the fastest quadratic form between two points of a zone: the bound looks between them
_CELL = 0.09  # radians between two times at which q is evaluated for the bound
_LOOSE, _ORDERS = 1e-4, 9  # of q: more is not left to what derivatives are at most, up to the eighth
_NEAR = 3e-3  # relative: a relaxation that is not below its aim ends when it is known so well
_CONVERGED = 1e-3  # relative: and any other
_SHARE = 1e-6  # of a sample that lies on either side of a cut, at least


def flow_of(problem: DesignProblem) -> OrthogonalFlowWindows | None:
    """The windows that follow from the order of samples alone, of many states; None where more decides what they see.

    Of few states boxes become so small that what is left of them to second order (`local_bound`) says more.
    """
    alike = problem.is_shift_invariant and not problem.late and not problem.is_costly
    return problem.orthogonal_flow if alike and problem.plant.n_states > MANY_STATES else None


def relax_ordered(
    problem: DesignProblem, flow: OrthogonalFlowWindows, zones: Array, aim: float, budget: Budget
) -> tuple[Array, Cut]:
    """Multipliers (k, n, n) for schedules in `zones`, near a sigma that is aimed at, and where to cut next."""
    points = _OrderedPoints(flow, zones)
    found: EigenvalueBracket | None = None
    for found in brackets(points.program):
        left = found.total - found.t
        if budget.over or left <= _CONVERGED * abs(found.t) or (found.t > aim**2 and left <= _NEAR * found.t):
            break
        if found.total <= aim**2 and ordered_bound(problem, flow, found.Z, zones) <= aim:
            break
    assert found is not None
    return found.Z, points.cut(found)


class _OrderedPoints:
    """Times in the zones, each sample's own, and what windows that begin no later, or later, see of it there."""

    def __init__(self, flow: OrthogonalFlowWindows, zones: Array) -> None:
        self.zones = zones
        self.times, self.owner = _grid(zones, _APART / flow.fastest)
        repeats = [_rows(flow, self.times + r * flow.period) for r in range(flow.repeats + 1)]
        self.measured = np.stack([np.concatenate(repeats[:-1], axis=1), np.concatenate(repeats[1:], axis=1)])
        after = np.arange(len(zones))[:, None] > self.owner
        self.rows = self.measured[after.astype(np.intp), np.arange(self.owner.size)]

    @property
    def program(self) -> MixedMatrices:
        """Each sample has its own weights, which sum to one."""
        members = (self.owner == np.arange(len(self.zones))[:, None]).astype(float)
        first = (1 / members.sum(axis=1))[self.owner]
        none, n = np.zeros((0, self.owner.size)), self.rows.shape[-1]
        return MixedMatrices(self.rows, first, members, np.ones(len(members)), none, none[:, 0], np.eye(n))

    def cut(self, found: EigenvalueBracket) -> Cut:
        """The sample whose early and late shares differ most for the windows that matter, and its mean time.

        The relaxation gains from mixing schedules what the least eigenvalue is concave: were sample i early in one half
        of them and late in the other, their Gram matrices would differ by D, and the mean of both lies above them by
        <Z, D W^-1 D> to second order.
        """
        k, width = len(self.zones), self.zones[:, 1] - self.zones[:, 0]
        grams = squares(self.measured)
        parts = found.x[:, None] * (self.owner[:, None] == np.arange(k))  # (points, k)
        means = parts.T @ self.times
        at = np.clip(means, self.zones[:, 0] + MARGIN * width, self.zones[:, 1] - MARGIN * width)
        late = parts * (self.times[:, None] >= at)
        shares = np.stack([late.sum(axis=0), (parts - late).sum(axis=0)])
        safe = np.maximum(shares, _SHARE)
        apart = np.einsum("sjab,ji->siab", grams, late / safe[0] - (parts - late) / safe[1])
        n = grams.shape[-1]
        W = np.einsum("mjpa,j,mjpb->mab", self.rows, found.x, self.rows, optimize=True)
        W += EPS * float(np.trace(W, axis1=1, axis2=2).max()) * np.eye(n)
        D = apart[(np.arange(k)[:, None] > np.arange(k)).astype(np.intp), np.arange(k)]  # (windows, samples, n, n)
        gains = np.einsum("miab,miba->i", found.Z[:, None] @ D, np.linalg.solve(W[:, None], D))
        gains = np.where(shares.min(axis=0) > _SHARE, gains * shares[0] * shares[1], 0.0)
        place = int(np.argmax(gains)) if gains.max() > 0 else int(np.argmax(width))
        return Cut(place, float(at[place]), float(width[place]))


def ordered_bound(problem: DesignProblem, flow: OrthogonalFlowWindows, Z: Array, zones: Array) -> float:
    """Bound sigma of every schedule whose samples lie in `zones`, by psd Z (k, n, n) whose traces sum to one."""
    earlier, C = np.cumsum(Z, axis=0), problem.plant.C
    times, owner = _grid(zones, _CELL / flow.fastest)
    turned = flow.fastest * flow.period * (flow.repeats + 1)
    lost = 4 * flow.stretch + ROUNDING_MARGIN * C.shape[1] * EPS * (1 + turned)  # of rows, as a share of their size
    total = 0.0
    for i in range(len(zones)):
        pair = earlier[i], earlier[-1] - earlier[i]
        high = sum(float(np.linalg.norm(Y, 2)) for Y in pair) * flow.repeats * float(np.sum(C**2))
        total += _highest(flow, pair, times[owner == i], high) + high * lost
    return rooted(problem, total)


def _highest(flow: OrthogonalFlowWindows, pair: tuple[Array, Array], times: Array, high: float) -> float:
    """What q is at most between `times` of even steps h, for the multipliers of its two terms; never above `high`.

    It exceeds both ends of a step by at most h^2/8 max(-q''), each derivative changes by at most h/2 times the most of
    the next, and q holds no frequency beyond w, twice the fastest mode's, so that the j-th is at most w^j `high`
    (Bernstein). As many are worked out as it takes until what is left is nothing beside q.
    """
    h, w = float(times[-1] - times[0]) / max(times.size - 1, 1), flow.fastest
    rows = [_rows(flow, times + r * flow.period) for r in range(flow.repeats + 1)]
    chains = [[np.concatenate(each, axis=1)] for each in (rows[:-1], rows[1:])]
    weighted = [[c[0] @ Y] for c, Y in zip(chains, pair, strict=True)]
    top = float(np.max(_derivative(chains, weighted, 0)))
    most: list[float] = []  # of -q'', and of the sizes of the derivatives after it
    for order in range(2, _ORDERS):
        for chain, weights, Y in zip(chains, weighted, pair, strict=True):
            while len(chain) <= order:
                chain.append(chain[-1] @ flow.skew)
                weights.append(chain[-1] @ Y)
        values = _derivative(chains, weighted, order)
        most.append(max(float(np.max(-values)), 0.0) if order == 2 else float(np.max(np.abs(values))))
        left = (h / 2) ** (order - 1) * w ** (order + 1) * high
        if left * h**2 / 8 <= _LOOSE * top:
            break
    rest = sum((h / 2) ** place * each for place, each in enumerate(most)) + left
    return top + h**2 / 8 * rest


def _derivative(chains: list[list[Array]], weighted: list[list[Array]], order: int) -> Array:
    """The derivative of q of that order, from those of the rows, by Leibniz's rule."""
    parts = [
        comb(order, i) * np.sum(weights[i] * chain[order - i], axis=(1, 2))
        for chain, weights in zip(chains, weighted, strict=True)
        for i in range(order + 1)
    ]
    return np.asarray(sum(parts))


def _rows(flow: OrthogonalFlowWindows, times: Array) -> Array:
    return flow.rows(times, np.ones((times.size, len(flow.outputs)), dtype=bool))


def _grid(zones: Array, apart: float) -> tuple[Array, Index]:
    """Times at most that far apart in every zone, its ends included, and whose they are."""
    counts = np.where(zones[:, 1] > zones[:, 0], np.ceil((zones[:, 1] - zones[:, 0]) / apart), 0).astype(int) + 1
    grid = [np.linspace(a, b, count) for (a, b), count in zip(zones, counts.tolist(), strict=True)]
    return np.concatenate(grid), np.repeat(np.arange(len(zones)), counts)
