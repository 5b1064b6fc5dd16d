"""A bound that no admissible schedule over all real times can beat, from multipliers by weak duality.

For psd Z_m with sum <Z_m, I> = 1 and any window starts a_m, every schedule has
sigma^2 <= sum_m <Z_m, W(a_m)> = sum over its samples of g(s), g(s) = sum <Z_m, G(s - a_m)> over the
windows (a_m, a_m + T] that hold s. The sum is maximised over all admissible times: g is bounded on
time cells (chord plus second-order remainder), the cells are chosen by dynamic programming.

Where samples may be early or late, a window holds real times, and any of them that the tolerance allows will do: of
each window each sample is early, late or on time, whichever shows <Z_m, G> least near where it is planned.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sampling_design.design.bounds.derivatives import change_of_bend, remainder_of_bend
from sampling_design.design.problem.design_problem import ON_AN_END, DesignProblem
from sampling_design.design.problem.feasible import without_hours
from sampling_design.design.problem.gram import lags
from sampling_design.numerics.linalg import AT_ONCE, expm_batch, rows_ahead
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.kept import kept

CELLS, CELLS_PER_RATE = 1200, 48.0
"""Time cells per period at least, and per |A| P: the remainder of a cell is of second order in |A| times its width."""

NARROWER = 1e-11
"""Relative: cells are that much narrower than the spacing, so that rounding never decides on which side of a jump one
ends."""

_JUST_AFTER = 1e-9  # of the period: windows that start where something opens, or other outputs close, are moved by it
_NODE = 0.5  # |A| times the distance of the nodes to which multipliers are carried
_DECIDED = 960  # times per period, at most, at which it is decided anew whether a sample is early or late
_LOOSE = 1e-7  # of the highest peak: pieces whose remainder may be worth more are looked at to a higher order
_FAMILIES = 16  # of first cells in a cycle: more would be exact, at a cost that grows with the spacing


@dataclass(frozen=True, eq=False)
class DualProfile:
    """g per output at both ends of every piece of [0, period], and a bound on -g'' inside (never negative).

    `beside` (2, pieces): whether what holds just before a piece, and just after it, may hold at its very end.
    """

    edges: Array
    left: Array
    right: Array
    bend: Array
    beside: Mask


def profile(problem: DesignProblem, starts: Array, Z: Array, edges: Array) -> DualProfile:
    """Evaluate g on the pieces between `edges`, which must hold every jump of g.

    With Y(u) = sum e^{A(u-a_m)} Z_m e^{A'(u-a_m)} over the windows that hold the piece, g = CYC' inside it. What
    rounding may take from g, as a share of its highest peak, is added to both ends.
    """
    rows, period = problem.rows, problem.period
    left, middle = edges[:-1], (edges[:-1] + edges[1:]) / 2
    jumps, apart = jump_times(problem, starts), _apart(rows.A, period)
    anew = max(apart, period / _DECIDED)
    turns = np.arange(0.0, period, anew) if problem.late else np.zeros(0)  # whether early or late is decided anew
    bases = np.unique(np.clip(np.concatenate([jumps, problem.breakpoints, turns]), 0.0, period))
    home = np.clip(np.searchsorted(bases, middle) - 1, 0, bases.size - 1)
    used, home = np.unique(home, return_inverse=True)
    ends = np.append(bases, period)
    Y0 = _multipliers_over(problem, starts, Z, bases[used], (bases[used] + ends[used + 1]) / 2)
    since, width = left - bases[used][home], np.diff(edges)
    g_left, g_right, bend = _along_pieces(rows.A, rows.C, Y0, home, since, width, apart, _LOOSE)
    rounded = rows.rounding * float(np.max([g_left, g_right], initial=0.0))
    return DualProfile(edges, g_left + rounded, g_right + rounded, bend, _beside(problem, starts, edges))


def _apart(A: Array, period: float) -> float:
    """The distance of the nodes to which multipliers are carried."""
    norm = float(np.linalg.norm(A, 2))
    return period if norm == 0.0 else _NODE / max(norm, float(np.linalg.norm(A, 1)) / 2)


@kept
def _along_pieces(
    A: Array, C: Array, Y0: Array, home: Index, since: Array, width: Array, apart: float, at_most: float
) -> tuple[Array, Array, Array]:
    """g at both ends of pieces that begin `since` after their `home`, where Y is Y0, and bounds on -g'' inside.

    g'' = C(AAY + 2AYA' + YA'A')C', and |g'''| <= |C|^2 e^{2|A|h} |third derivative of Y|. Where the outputs see little
    of a large Y, that is far too much, and the derivatives up to a higher order are worked out one by one. Y is carried
    to nodes, a few to each unit of 1/|A|; on the pieces between them rows Ce^{Au} alone are worked out, n times as
    cheap. All counts of samples ask for the same.
    """
    norm, ahead = float(np.linalg.norm(A, 2)), np.floor(since / apart)  # nodes from the base, for each piece
    place = np.stack([home.astype(float), ahead])
    (base, count), node = np.unique(place, axis=1, return_inverse=True)
    node = node.reshape(-1)
    Y = Y0[base.astype(np.intp)]
    for part in _parts(len(Y), A.size):
        step = expm_batch(A, count[part] * apart)
        Y[part] = step @ Y[part] @ np.swapaxes(step, 1, 2)
    begin = since - ahead * apart
    with np.errstate(over="ignore"):  # a piece so wide that nothing is known of it has an infinite roof
        growth = np.exp(2 * norm * (begin + width))[:, None] * np.sum(C**2, axis=1)
    c, end = rows_ahead(C, A, begin), rows_ahead(C, A, begin + width)
    first = c @ A
    products = np.concatenate([c, first, end], axis=1)
    for part in _parts(len(products), A.size):
        products[part] = products[part] @ Y[node[part]]
    weighted, of_first, of_end = np.split(products, 3, axis=1)
    bend = 2 * np.sum(weighted * (first @ A) + of_first * first, axis=2)
    g_left, g_right = np.sum(weighted * c, axis=2), np.sum(of_end * end, axis=2)
    high = float(np.max([g_left, g_right], initial=0.0))
    sharpness = remainder_of_bend(A, Y, 3, node, width, growth)
    loose = np.any(sharpness * (width**2 / 8)[:, None] > at_most * high, axis=1)
    if loose.any():
        finer = change_of_bend(A, c[loose], Y, node[loose], width[loose], growth[loose])
        sharpness[loose] = np.minimum(sharpness[loose], finer)
    return g_left, g_right, np.maximum(-bend, 0.0) + sharpness


def _parts(count: int, size: int) -> list[slice]:
    """So many matrices of that size, few at once."""
    together = AT_ONCE // size + 1
    return [slice(low, low + together) for low in range(0, count, together)]


def _beside(problem: DesignProblem, starts: Array, edges: Array) -> Mask:
    """Whether what holds just before each piece, and just after it, may hold at its very end.

    Not where nothing is allowed there: the closing time itself is not allowed, and the opening time is not seen by
    windows [b, b + T) that end there.
    """
    there = problem.mask((edges[:-1] + edges[1:]) / 2).any(axis=1)
    ends = starts[~problem.closes(starts)] + problem.window
    away = np.mod(ends - edges[:-1, None] + problem.period / 2, problem.period) - problem.period / 2
    ended = np.any(np.abs(away) <= ON_AN_END * problem.period, axis=1)
    return np.stack([np.roll(there, 1) | ended, np.roll(there, -1)])


def roofs(g: DualProfile, mask: Mask, prices: Array | None = None) -> Array:
    """Upper bounds of g on the closed pieces, summed over the outputs measured there; both limits count at an end.

    What holds beside a piece counts only where it may hold at its end (`DualProfile.beside`).

    With `prices` per output each measurement costs that much, and the best choice of outputs counts.
    """
    rest = (np.diff(g.edges) ** 2 / 8)[:, None] * g.bend
    before, after = (
        best_choice(side + rest, mask, prices) for side in (np.roll(g.right, 1, 0), np.roll(g.left, -1, 0))
    )
    own = [best_choice(side + rest, mask, prices) for side in (g.left, g.right)]
    return np.asarray(np.max([*own, *np.where(g.beside, [before, after], -np.inf)], axis=0))


def best_choice(values: Array, mask: Mask, prices: Array | None) -> Array:
    """Most that a sample can bring by the outputs (last axis) that are there, at least one, less their prices."""
    if prices is None:
        return np.asarray(np.sum(values * mask, axis=-1))
    net = np.where(mask, values - prices, -np.inf)
    return np.asarray(np.where(np.any(net > 0, axis=-1), np.sum(np.maximum(net, 0.0), axis=-1), np.max(net, axis=-1)))


def jump_times(problem: DesignProblem, starts: Array) -> Array:
    """Where g jumps: window starts and window ends, in [0, period)."""
    return np.unique(np.mod(np.concatenate([starts, starts + problem.window]), problem.period))


def clear_of_ends(problem: DesignProblem, starts: Array) -> Array:
    """Window starts, those beside a time at which all outputs close on it, to the last bit (`DesignProblem.closes`).

    Those on another time at which some close or open come just after it: there rounding would decide, and a bound has
    to count what might be seen.
    """
    if problem.breakpoints.size == 2:  # nothing ever closes
        return starts
    apart = np.mod(starts[:, None] - problem.breakpoints + problem.period / 2, problem.period) - problem.period / 2
    on = np.any(np.abs(apart) <= ON_AN_END * problem.period, axis=1) & ~problem.closes(starts)
    moved = problem.on_closings(starts, ON_AN_END * problem.period)
    return np.asarray(moved + np.where(on, _JUST_AFTER * problem.period, 0.0))


def _forms(C: Array, Y: Array) -> Array:
    return np.asarray(np.einsum("pi,sij,pj->sp", C, Y, C))


def _multipliers_over(problem: DesignProblem, starts: Array, Z: Array, at: Array, inside: Array) -> Array:
    """Y at the times `at`, over the windows that hold the times `inside` (same piece)."""
    n = problem.plant.n_states
    count = int(np.ceil(problem.window / problem.period - 1e-9))
    base = np.mod(inside[:, None] - starts[None, :], problem.period)
    r = base[..., None] + problem.period * np.arange(count)
    piece, window, cycle = np.nonzero((r <= problem.window) & (np.trace(Z, axis1=1, axis2=2) > 0)[None, :, None])
    Y = np.zeros((at.size, n, n))
    back = expm_batch(problem.rows.A, inside - at)
    for part in _parts(piece.size, n * n):
        i, m = piece[part], window[part]
        E = expm_batch(problem.rows.A, r[i, m, cycle[part]] - (inside[i] - at[i]))
        np.add.at(Y, i, _moved(problem, E @ Z[m] @ np.swapaxes(E, 1, 2), back[i]))
    return Y


def _moved(problem: DesignProblem, Y: Array, ahead: Array | None = None) -> Array:
    """The multipliers Y (N, n, n) moved as far as each sample may be early or late, that way in which C shows least.

    With `ahead` (N, n, n) it is looked at that much later.
    """
    if len(problem.moves) == 1:
        return Y
    C = problem.rows.C if ahead is None else problem.rows.C @ ahead
    observed = C @ problem.moves[:, None]
    least = problem.moves[np.argmin(np.sum((observed @ Y) * observed, axis=(2, 3)), axis=0)]
    return np.asarray(least @ Y @ np.swapaxes(least, 1, 2))


def value_at(problem: DesignProblem, starts: Array, Z: Array, times: Array) -> Array:
    """g per output exactly at `times`, shape (N, p); a window end within rounding counts as inside."""
    r, inside = lags(times[:, None], starts[None, :], problem.window, problem.period, problem.closes(starts))
    i, m, cycle = np.nonzero(inside)
    E = expm_batch(problem.rows.A, r[i, m, cycle])
    Y = np.zeros((times.size, *Z.shape[1:]))
    np.add.at(Y, i, _moved(problem, E @ Z[m] @ np.swapaxes(E, 1, 2)))
    return _forms(problem.rows.C, Y)


@dataclass(frozen=True, eq=False)
class TimeCells:
    """Time cells of one width h from `start` to `stop`; samples in admissible cells differ by at least `apart`."""

    start: float
    stop: float
    width: float
    apart: int

    @property
    def edges(self) -> Array:
        """Ends of the cells; the last cell may be shorter."""
        count = max(1, int(np.ceil((self.stop - self.start) / self.width - 1e-9)))
        return np.append(self.start + self.width * np.arange(count), self.stop)


def cells(problem: DesignProblem, start: float, stop: float, fine: float = np.inf) -> TimeCells:
    """Cells, `fine` at most, whose width divides the spacing: times a spacing apart lie `apart` cells apart."""
    fine = min(fine, problem.period / cell_count(problem))
    parts = int(np.ceil(problem.spacing / fine - 1e-9)) if problem.spacing >= fine else 0
    return TimeCells(start, stop, problem.spacing * (1 - NARROWER) / parts if parts else fine, parts)


def cell_count(problem: DesignProblem) -> int:
    """Cells per period at least."""
    rate = float(np.linalg.norm(problem.rows.A, 2)) * problem.period
    return int(np.clip(CELLS_PER_RATE * rate, CELLS, 40 * CELLS))


def cell_values(found: TimeCells, edges: Array, values: Array) -> Array:
    """Largest value of the pieces that overlap each cell."""
    ends = found.edges
    middle = (edges[:-1] + edges[1:]) / 2
    inside = (middle > ends[0]) & (middle < ends[-1])
    place = np.clip(np.searchsorted(ends, middle[inside]) - 1, 0, ends.size - 2)
    result = np.full(ends.size - 1, -np.inf)
    np.maximum.at(result, place, values[inside])
    return result


def best_chain(values: Array, apart: int, most: int) -> Array:
    """best[j] = largest sum of j cell values, cells at least `apart` apart, j = 0..most."""
    best = np.full(most + 1, -np.inf)
    best[0] = 0.0
    layer = values
    for j in range(1, most + 1):
        if j > 1:
            layer = _with_cell(values, _before(layer, apart))
        best[j] = np.max(layer, initial=-np.inf)
    return best


def best_cycle(values: Array, apart: int, count: int, period_cells: float) -> float:
    """Largest sum of `count` cell values around the circle, the wrap included; `period_cells` = period/width.

    Only a first cell near the start bars cells near the end; such first cells are treated in families, each as
    late as its last member, which never lowers the sum.
    """
    size = values.size
    near = min(apart, size)
    marks = np.unique(np.linspace(0, near, min(near, _FAMILIES) + 1).astype(np.intp))  # families of first cells
    layer = np.full((marks.size, size), -np.inf)
    for row, (a, b) in enumerate(pairwise([*marks, size])):
        layer[row, a:b] = values[a:b]
    for _ in range(count - 1):
        layer = _with_cell(values, _before(layer, apart))
    last = np.append(marks[1:] + period_cells - apart - 1e-9, size)
    layer = np.where(np.arange(size) < last[:, None], layer, -np.inf) if count > 1 else layer
    return float(layer.max())


def best_layers(layers: list[Array], arc: TimeCells, high: float) -> float:
    """Largest sum of one cell value per layer, successive cells `arc.apart` apart and at most `high` in time."""
    reach = max(int(np.floor(high / arc.width + 1e-9)) + 1, arc.apart)
    best = layers[0]
    for values in layers[1:]:
        best = _with_cell(values, reachable(best, arc.apart, reach))
    return float(best.max())


def reachable(layer: Array, nearest: int, farthest: int) -> Array:
    """Maximum over the cells `nearest` to `farthest` cells earlier."""
    from scipy.ndimage import maximum_filter1d

    if farthest >= layer.size:
        return _before(layer, nearest)
    size = farthest - nearest + 1
    padded = np.concatenate([np.full(farthest, -np.inf), layer])
    run = maximum_filter1d(padded, size, mode="constant", cval=-np.inf, origin=-(size // 2))
    return np.asarray(run[: layer.size])


def _with_cell(values: Array, before: Array) -> Array:
    """A cell more: what is barred (-inf) stays so beside a cell of which nothing is known (inf)."""
    with np.errstate(invalid="ignore"):
        total = values + before
    total[np.isnan(total)] = -np.inf
    return total


def _before(layer: Array, apart: int) -> Array:
    """Running maximum up to `apart` cells earlier, along the last axis."""
    run = np.maximum.accumulate(layer, axis=-1)
    if apart == 0:
        return run
    shifted = np.full_like(run, -np.inf)
    shifted[..., apart:] = run[..., : max(run.shape[-1] - apart, 0)]
    return shifted


def placed_bound(problem: DesignProblem, starts: Array, Z: Array, price: float = 0.0) -> float:
    """Bound sigma of every schedule that meets the requirement, forbidden and fixed times included.

    A schedule that costs at most L has sum g <= price L + sum (g - price cost), for any price >= 0.
    """
    return bound_by_price(problem, starts, Z)(price)


def bound_by_price(problem: DesignProblem, starts: Array, Z: Array) -> Callable[[float], float]:
    """`placed_bound` of any price: what does not depend on it is worked out once."""
    arcs = _arcs(problem)
    grid = np.concatenate([np.zeros(0), *(a.edges for a in arcs)])
    edges = piece_edges(problem.period, np.concatenate([jump_times(problem, starts), grid, problem.breakpoints]))
    mask = problem.mask((edges[:-1] + edges[1:]) / 2)
    g, spare = profile(problem, starts, Z, edges), problem.samples - problem.fixed.size
    there = problem.mask(problem.fixed) if spare else problem.measured(problem.fixed)
    at_fixed = value_at(problem, starts, Z, problem.fixed)

    def bound(price: float) -> float:
        prices = problem.costs * price if price > 0 and problem.costs is not None else None
        spent = 0.0 if prices is None else price * problem.cost_limit
        values = np.where(mask.any(axis=1), roofs(g, mask, prices), -np.inf)
        if not problem.fixed.size:
            cycle = arcs[0]
            sums = cell_values(cycle, edges, values)
            total = best_cycle(sums, cycle.apart, problem.samples, problem.period / cycle.width)
            return rooted(problem, spent + total)
        best = np.append(0.0, np.full(spare, -np.inf))
        turned = np.append(edges, edges[1:] + problem.period), np.tile(values, 2)
        for arc in arcs:
            if arc.stop > arc.start:
                best = _joined(best, best_chain(cell_values(arc, *turned), arc.apart, spare))
        return rooted(problem, spent + float(best_choice(at_fixed, there, prices).sum() + best[spare]))

    return bound


def alone_bound(problem: DesignProblem, starts: Array, Z: Array) -> float:
    """Bound sigma of every schedule of one sample a period, whatever it measures; windows count from the sample."""
    if problem.samples != 1:
        return np.inf
    values = value_at(without_hours(problem), starts, Z, np.zeros(1))
    return rooted(problem, float((values if problem.chosen is None else values * problem.chosen).sum()))


def _arcs(problem: DesignProblem) -> list[TimeCells]:
    """Stretches for free samples: the whole circle, or what lies between fixed times, up to two periods."""
    if not problem.fixed.size:
        return [cells(problem, 0.0, problem.period)]
    ends = np.append(problem.fixed[1:], problem.fixed[0] + problem.period)
    tiny = 1e-12 * problem.period
    pairs = [(a + problem.spacing - tiny, b - problem.spacing + tiny) for a, b in zip(problem.fixed, ends, strict=True)]
    return [cells(problem, a, b) for a, b in pairs if b > a]


def piece_edges(period: float, points: Array) -> Array:
    """Sorted distinct piece ends in [0, period], points of later periods brought back."""
    points = np.where(points > period, points - period, points)
    points = np.unique(np.concatenate([[0.0, period], points[(points > 0) & (points < period)]]))
    keep = np.append(np.diff(points) > 1e-13 * period, True)
    keep[0] = True
    return np.asarray(points[keep])


def _joined(one: Array, other: Array) -> Array:
    """Best sums over two stretches together: max-plus convolution."""
    result = np.full(one.size, -np.inf)
    for j in range(one.size):
        result[j:] = np.maximum(result[j:], one[j] + other[: one.size - j])
    return result


def rooted(problem: DesignProblem, total: float) -> float:
    """sigma from a bound on sigma^2, with the allowance for rounding."""
    return np.inf if np.isnan(total) else float(np.sqrt(max(total, 0.0)) * (1 + problem.rows.rounding))
