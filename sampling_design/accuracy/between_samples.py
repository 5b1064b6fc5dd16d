"""Between samples: rho(c; t_i + d) = rho(Phi(d)'c; t_i) + int_0^d h_W(G'Phi(s)'c) ds, for all real d.

rho(.; t_i) is a norm, and Phi(d)'c is bounded on a grid of offsets by directions. On a panel it lies on the chord of
its ends but for a rest of at most h^2/8 sup|A'^2 Phi'c|, whose norm directions bound too.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from sampling_design.accuracy.bounded_directions import BoundedDirections
from sampling_design.accuracy.sampled_system import SampledSystem
from sampling_design.numerics.linalg import expm_batch, forced_flow
from sampling_design.records.arrays import Array
from sampling_design.records.kept import kept

NEGLIGIBLE = 1e-4
"""A row counts as 0 below this share of what disturbance and noise of a period make of it (`state_scales`), if
adversaries attain less than so much of that again: what nothing drives and what decays is known exactly in the end, no
relative tolerance closes the bracket of a 0, and a solver leaves its last digits."""

GRID = (64, 2048)  # least and largest number of panels of a gap on which the profile stands
FINENESS = 0.1  # length of such a panel times the pace of A in scaled coordinates


@dataclass(frozen=True, eq=False)
class RowBetweenSamples:
    """One wanted row after sample j, on a grid of offsets d."""

    d: Array  # (N+1,)
    mu: Array  # mu, bend, (N+1, n): Phi(d)'c and its second derivative, in the coordinates of z_j
    bend: Array
    third: Array  # (N, n): on each panel, bounds on the entries of its third derivative
    above: Array  # above, below, (N+1,): bounds on int_0^d h_W(G'Phi(s)'c) ds
    below: Array
    slope: Array  # (N,): on each panel, a bound on |d/ds h_W(G'Phi(s)'c)|

    @np.errstate(over="ignore", invalid="ignore")
    def bound(self, directions: BoundedDirections) -> tuple[Array, Array]:
        """Return bounds on rho at the nodes (N+1,) and all along the panels (N,): infinite where one overflows."""
        h = float(self.d[-1] - self.d[0]) / (self.d.size - 1)
        nodes = directions.bound(self.mu) + self.above
        turn = directions.bound(self.bend)
        drift = self.third @ np.abs(directions.basis) @ directions.reach
        if h == 0:  # a schedule that ends with a sample
            return nodes, np.maximum(nodes[1:], nodes[:-1])
        sag = h * h / 8 * (np.maximum(turn[1:], turn[:-1]) + h / 2 * drift + self.slope)
        panels = np.maximum(nodes[1:], nodes[:-1]) + sag
        return np.where(np.isnan(nodes), np.inf, nodes), np.where(np.isnan(panels), np.inf, panels)

    def since(self, offset: float) -> RowBetweenSamples:
        """The panels that end later than an offset, or the last one."""
        first = min(int(np.searchsorted(self.d[1:], offset, side="right")), self.d.size - 2)
        if first <= 0:
            return self
        nodes = (self.d, self.mu, self.bend, self.third, self.above, self.below, self.slope)
        return RowBetweenSamples(*(values[first:] for values in nodes))


@dataclass(eq=False)
class RowSearch:
    """One row over the whole schedule: where it was solved and an adversary sought, and the bracket.

    By nodes of the system, of those after which it is judged, in order of time.
    """

    row: Array
    opened: dict[int, RowBetweenSamples]
    nodes: dict[int, Array]  # bounds at the offsets of each gap
    panels: dict[int, Array]  # bounds all along its panels
    solved: dict[int, dict[int, int]]  # offsets at which the program was solved, with the samples back that it took
    tried: set[tuple[int, int]] = field(default_factory=set)  # where an adversary was sought
    combined: set[tuple[int, int]] = field(default_factory=set)  # where gains of directions were put together
    lower: float = 0.0
    upper: float = np.inf
    worst: tuple[int, int] = (0, 0)
    closed: bool = False
    size: float = 0.0  # what disturbance and noise of a period make of the row
    _tops: dict[int, tuple[Array, float, int]] = field(default_factory=dict)

    def top(self, j: int) -> tuple[float, int]:
        """The highest bound on gap j and its panel, looked for where it was bounded anew since."""
        nodes, panels = self.nodes[j], self.panels[j]
        if j not in self._tops or self._tops[j][0] is not panels:
            ends = np.where(np.isfinite(nodes), nodes, 0.0)  # what is not known at all does not count
            high = np.where(np.isfinite(panels), panels, np.maximum(ends[1:], ends[:-1]))
            k = int(np.argmax(high))
            self._tops[j] = panels, float(high[k]), k
        return self._tops[j][1:]

    def slack(self, j: int) -> tuple[float, int]:
        """By how much the bound on gap j may be loose at an offset not solved: its ratio to what the nearest say."""
        top, solved = np.where(np.isfinite(self.nodes[j]), self.nodes[j], 0.0), sorted(self.solved[j])
        left = np.setdiff1d(np.arange(top.size), solved)
        if not left.size or not top.any():
            return 1.0, 0
        sure = np.interp(left, solved, top[solved]) if solved else np.zeros(left.size)
        ratio = np.divide(top[left], sure, out=np.full(left.size, np.inf), where=sure > 0)
        best = int(np.argmax(np.where(top[left] > 0, ratio, 0.0)))
        return float(ratio[best]), int(left[best])

    @property
    def idle(self) -> bool:
        """Whether adversaries attain nothing."""
        return bool(self.tried) and self.lower <= NEGLIGIBLE**2 * self.size


Integrals: TypeAlias = tuple[Array, Array, Array, Array, Array]
KnownIntegrals: TypeAlias = dict[tuple[float, float], Integrals]


@np.errstate(over="ignore", invalid="ignore")  # of what overflows, `bound` says that it bounds nothing
def open_row(
    system: SampledSystem,
    j: int,
    row: Array,
    until: float | None = None,
    known: KnownIntegrals | None = None,
    least: int = GRID[0],
) -> RowBetweenSamples:
    """Return one row (n,) of x after node j, while no more is known than there, or until some time.

    `known` keeps what is the same for this row after all samples with gaps of one length; `least` panels at least.
    """
    begin, end = system.judged[j][2:4] if until is None else (0.0, until)
    known = {} if known is None else known
    d = _grid(speed_of(system), begin, end, least)
    if (begin, end) not in known:
        known[begin, end] = _open_integrals(system, d, row)
    A, (above, below, propagated, middle, slope) = system.A, known[begin, end]
    L = system.L[j]
    third = middle[:, None] * np.linalg.norm(L, axis=0)
    return RowBetweenSamples(d, propagated @ L, propagated @ (A @ A) @ L, third, above, below, slope)


def speed_of(system: SampledSystem) -> float:
    """As fast as which the panels of a system's gaps take its plant to be."""
    return system.pace if system.speed is None else system.speed


def _grid(speed: float, begin: float, end: float, least: int = GRID[0]) -> Array:
    number = int(np.clip(np.ceil(speed * (end - begin) / FINENESS), least, GRID[1]))
    return np.linspace(begin, end, (number if end > begin else 1) + 1)


@kept
def _over_panel(A: Array, G: Array, step: float) -> tuple[Array, Array, Array]:
    """e^{A step}, e^{A step/2} A^3 and int_0^step e^{As}G ds."""
    over = forced_flow(A, G, [step])[0]
    return over[:, : len(A)], expm_batch(A, [step / 2])[0] @ (A @ A @ A), over[:, len(A) :]


def _along(row: Array, ahead: Array, count: int) -> Array:
    """Rows c'`ahead`^k (count, n) by doubling, with as few roundings as squaring has."""
    rows = row[None]
    while len(rows) < count:
        rows, ahead = np.vstack([rows, rows @ ahead]), ahead @ ahead
    return rows[:count]


def _open_integrals(system: SampledSystem, d: Array, row: Array) -> Integrals:
    """Bounds on int_0^d h_W(G'Phi(s)'c) ds from above and below, rows c'Phi(d), and bounds per panel.

    The bounds are those on |c'Phi A^3| and on the slope of h_W.
    """
    A, G, first = system.A, system.G, row * system.D
    step = float(d[-1] - d[0]) / (d.size - 1)
    ahead, turned, driven = _over_panel(A, G, step)
    propagated = _along(first @ expm_batch(A, d[:1])[0] if d[0] else first, ahead, d.size)
    p, first, bend = propagated @ G, propagated @ (A @ G), propagated @ (A @ A @ G)
    middle = np.linalg.norm(propagated[:-1] @ turned, axis=1) * np.exp(system.size * step / 2)
    third = middle * np.linalg.norm(G, 2)
    mean = propagated[:-1] @ driven
    if system.bounds.w_ball:
        value, curve, least = np.linalg.norm(p, axis=1), np.linalg.norm(bend, axis=1), np.linalg.norm(mean, axis=1)
        curve = np.maximum(curve[1:], curve[:-1]) + step / 2 * third
        tilt = np.linalg.norm(first, axis=1)
    else:
        value, least = np.abs(p).sum(axis=1), np.abs(mean).sum(axis=1)
        curve = np.maximum(np.abs(bend[1:]), np.abs(bend[:-1])).sum(axis=1) + G.shape[1] * step / 2 * third
        tilt = np.abs(first).sum(axis=1)
    most = step / 2 * (value[1:] + value[:-1]) + step**3 / 12 * curve
    slope = np.maximum(tilt[1:], tilt[:-1]) + step / 2 * curve
    before = _grid(speed_of(system), 0.0, float(d[0]))
    until = [np.zeros(1)] * 2 if d[0] == 0 else _open_integrals(system, before, row)[:2]
    sums = (first[-1] + np.append(0.0, np.cumsum(x)) for first, x in zip(until, (most, least), strict=True))
    return (*sums, propagated, middle, np.asarray(slope))
