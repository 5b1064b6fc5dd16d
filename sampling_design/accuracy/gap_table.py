"""Gaps in fixed coordinates, remembered by length: transition, disturbance on panels, disturbance on cells.

A gap that was met once costs nothing again, and gaps of a record that are new are made together. What is integrated
for many columns at once keeps the flow at all its panels (`PropagatedGap`). A record has thousands of gaps, each
integrated for one column: these keep the doubled flows (`RecordGap`), and columns are run along the panels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from sampling_design.numerics.filtering import propagate
from sampling_design.numerics.linalg import discounted_flow, expm_batch, forced_flow
from sampling_design.plants.clusters import balanced_schur
from sampling_design.records.arrays import Array, Index

PANEL = 0.03125
"""Length of a panel of the quadrature times |A|: its bound is then loose by less than one in ten thousand."""

PANELS = (16, 4096)  # least and largest number of panels of a gap, powers of two

MANY, JOINED = 256, 4
"""Panels from which on so many become one where integrals are only sizes of what a filter forgets: of stiff plants."""

LONGEST = 0.1  # share of |A| that counts for the length of panels in any case

FINER = 4
"""Panels after the last sample are so many times shorter: there is one gap only, and nothing hides what it loses."""

LOSS = 2e-2  # share of the curvature that coarse cells may lose: gains are second order in it, and more cells cost time
CELLS = 2  # least number of coarse cells of a gap
FINER_CELLS = (1, 2, 4, 16)  # so many times more cells on each level than on the first
SUM_HELD = 8 * float(np.finfo(float).eps)  # relative error of a flow over a panel, for each state and panel before it
REMEMBERED = 1024  # gaps that are kept
AT_ONCE = 2**17
"""Numbers along the panels of a gap that are made at once: what a cache does not hold costs over twice as much,
where a fast mode asks for thousands of panels."""

STACKED = 2**11  # numbers of a gap's panels up to which many gaps are integrated over together
GROWN = 1e70  # growth over a period beyond which sizes are not followed: its square is a number still, in any units


@dataclass(frozen=True, eq=False)
class PropagatedGap:
    """One gap; s runs back from its end."""

    step: float  # length of a panel
    propagated: Array  # propagated, bend, (N+1, n, q): e^{As}G and e^{As}A^2G at the ends of the panels
    bend: Array
    third: Array  # (N,): on each panel a bound on |e^{As}A^3G|

    @cached_property
    def _quadrature(self) -> tuple[Array, Array, Array, Array, float]:
        """(e^{As}G)' and (e^{As}A^2G)' of all panel ends below each other, and what `integral` weighs them by."""
        N, d = self.third.size, self.step
        both = (np.swapaxes(X, 1, 2).reshape(-1, X.shape[1]) for X in (self.propagated, self.bend))
        propagated, bend = map(np.ascontiguousarray, both)
        ends, inner = np.full(N + 1, d), np.full(N, d**3 / 12)
        ends[[0, -1]] = d / 2
        return propagated, bend, ends, inner, float(d**4 / 24 * self.third.sum())

    def integral(self, g: Array, ball: bool) -> Array:
        """Return an upper bound on int h_W(G'e^{A's} g) ds for each column of g (n, k), for all real s.

        On a panel |p| lies below its chord plus (s-a)(b-s)/2 sup|p''|; sup|p''| is at most that at the ends plus half
        a panel times sup|p'''|.
        """
        (count, _, q), k = self.propagated.shape, g.shape[1]
        most = max(min(AT_ONCE // (count * max(q, 1)), k), 1)
        room = np.empty((3, count * q * most))  # fresh memory for each part would cost more than what is done in it
        parts = [self._integral(g[:, i : i + most], ball, room) for i in range(0, k, most)]
        return np.concatenate(parts) if parts else np.zeros(0)

    def _integral(self, g: Array, ball: bool, room: Array) -> Array:
        (count, _, q), k = self.propagated.shape, g.shape[1]
        propagated, curved, ends, inner, rest = self._quadrature
        p, bend, larger = room[:, : count * q * k].reshape(3, count * q, k)
        np.matmul(propagated, g, out=p)
        np.matmul(curved, g, out=bend)
        more = rest * np.linalg.norm(g, axis=0)
        if ball:
            stacks = (X.reshape(count, q, k) for X in (p, bend))
            size, curve = (np.sqrt(np.einsum("cqk,cqk->ck", X, X)) for X in stacks)
            return np.asarray(ends @ size + inner @ np.maximum(curve[1:], curve[:-1]) + more)
        size, curve = (np.abs(X, out=X).reshape(count, q * k) for X in (p, bend))
        sharpest = np.maximum(curve[1:], curve[:-1], out=larger.reshape(count, q * k)[1:])
        total = ends @ size + inner @ sharpest
        return np.asarray(total.reshape(q, k).sum(axis=0) + math.sqrt(q) * more)

    @cached_property
    def coarser(self) -> PropagatedGap:
        """The gap on panels `JOINED` times as long, where there are `MANY`: what bounds its integrals is larger."""
        if self.third.size <= MANY or self.third.size % JOINED:
            return self
        ends = (self.propagated[::JOINED], self.bend[::JOINED])
        third = self.third.reshape(-1, JOINED).max(axis=1)
        return replace(self, step=self.step * JOINED, propagated=ends[0], bend=ends[1], third=third)


class GapIntegrals:
    """What `integral` says of columns over many gaps, a few of each: those of as few panels all at once."""

    def __init__(self, gaps: Sequence[PropagatedGap]):
        self._gaps = gaps
        shapes = [gap.propagated.shape if gap.propagated.size <= STACKED else (0, 0, 0) for gap in gaps]
        self._kinds = [shape for shape in dict.fromkeys(shapes) if shape[0]]
        self._kind = np.array([self._kinds.index(shape) if shape[0] else -1 for shape in shapes])
        self._place, self._stacks = np.zeros(len(gaps), dtype=np.intp), list[tuple[Array, ...]]()
        for kind in range(len(self._kinds)):
            own = np.flatnonzero(self._kind == kind)
            self._place[own] = np.arange(own.size)
            parts = zip(*(gaps[i]._quadrature for i in own.tolist()), strict=True)
            self._stacks.append(tuple(map(np.array, parts)))

    def over(self, at: Index, g: Array, ball: bool) -> Array:
        """Those of columns g (K, n, k), over a gap each."""
        found, k = np.empty((len(g), g.shape[2])), g.shape[2]
        for kind in np.unique(self._kind[at]).tolist():
            own = np.flatnonzero(self._kind[at] == kind)
            count, _, q = self._kinds[kind] if kind >= 0 else (0, 0, 0)
            at_once = AT_ONCE // max(count * q * k, 1)
            if kind < 0 or not at_once:
                found[own] = [self._gaps[at[i]].integral(g[i], ball) for i in own.tolist()]
                continue
            for some in np.split(own, range(at_once, own.size, at_once)):
                propagated, curved, ends, inner, rest = (part[self._place[at[some]]] for part in self._stacks[kind])
                stacks = ((X @ g[some]).reshape(some.size, count, q, k) for X in (propagated, curved))
                size, curve = (
                    np.sqrt(np.einsum("gcqk,gcqk->gck", X, X)) if ball else np.abs(X).reshape(some.size, count, q * k)
                    for X in stacks
                )
                total = ends[:, None] @ size + inner[:, None] @ np.maximum(curve[:, 1:], curve[:, :-1])
                more = rest[:, None] * np.linalg.norm(g[some], axis=1) * (1.0 if ball else math.sqrt(q))
                found[some] = (total[:, 0] if ball else total.reshape(some.size, q, k).sum(axis=1)) + more
        return found


@dataclass(frozen=True, eq=False)
class RecordGap:
    """One gap of a record; s runs back from its end."""

    step: float  # length of a panel
    doubled: Array  # (log2 N + 1, n, n): e^{As} for s of 1, 2, 4, ..., N panels
    forced: Array  # (n, q): int e^{As}G ds over the first panel
    third: Array  # (N,): on each panel a bound on |e^{As}A^3G|
    held: Array  # (N,): error of int e^{As}G ds over each panel
    marks: Array  # (N,): where each panel lies among coarse cells of one size
    _cells: dict[int, Array] = field(default_factory=dict, repr=False)

    @property
    def F(self) -> Array:
        """(n, n)."""
        return np.asarray(self.doubled[-1])

    def cells(self, level: int) -> Array:
        """Return int e^{As}G ds (m, n, q) over cells on which an adversary's w is constant, finer with the level."""
        if level not in self._cells:
            n = len(self.forced)
            with np.errstate(over="ignore", invalid="ignore"):
                flows = run_along(np.broadcast_to(self.doubled, (n, *self.doubled.shape)), np.eye(n))
                self.cut(level, np.swapaxes(flows[:, :-1] @ self.forced, 0, 1))
        return self._cells[level]

    def cut(self, level: int, pieces: Array) -> None:
        """Keep the cells of a level, made of int e^{As}G ds (N, n, q) over the panels."""
        count = min(max(CELLS, float(np.ceil(self.marks[-1]))) * FINER_CELLS[level], float(self.marks.size))
        cell = np.minimum(self.marks / max(self.marks[-1], 1e-300) * count, count - 1).astype(int)
        self._cells[level] = np.add.reduceat(pieces, np.flatnonzero(np.diff(cell, prepend=-1)), axis=0)


def run_along(doubled: Array, g: Array) -> Array:
    """Return g'e^{As} (J, N+1, n) at the ends of N panels, for g (J, n) and flows over 1, 2, 4, ..., N of them."""
    J, n = g.shape
    found = np.empty((J, 2 ** (doubled.shape[1] - 1) + 1, n))
    found[:, 0] = g
    for j in range(doubled.shape[1]):
        known = 2**j
        more = found[:, known : 2 * known]
        np.matmul(found[:, : more.shape[1]], doubled[:, j], out=more)
    return found


def pace(A: Array) -> float:
    """As fast as which panels take e^{As} to be.

    What they lose goes with A^2: where A is far from normal, |A| is many times as much. They stay below 1/|A|, or
    nearly so, since the third derivative is followed along a panel by |A| alone.
    """
    return max(math.sqrt(np.linalg.norm(A @ A, 2)), float(np.linalg.norm(A, 2)) * LONGEST)


def cell_rate(M: Array, bend: Array, loss: float) -> Array:
    """Cells per time so short that delta^2/24 |M''|/|M| <= loss, along stacks of M and M'' (..., n, m)."""
    size, curve = (np.linalg.norm(X, axis=(-2, -1)) for X in (M, bend))
    return np.asarray(np.sqrt(np.divide(curve, size, out=np.zeros_like(size), where=size > 0) / (24 * loss)))


def state_scales(F: Array, W: Array, rows: list[Array]) -> Array:
    """Diagonal D: between what w reaches and what samples see of each state over a period.

    Of what neither does: what is seen of it in later periods, or what others bring into it.
    """
    n = F.shape[1]
    flow, covariance = np.eye(n), np.zeros((n, n))
    observed, later, reach = np.zeros((3, n))
    for period in range(n):
        for H, step, reached in zip(rows, F, W, strict=True):
            energy = np.sum((H @ flow) ** 2, axis=0)
            observed, later = (observed, later + energy) if period else (observed + energy, later)
            if max(np.abs(flow).max(), np.sqrt(np.abs(covariance).max())) * max(np.abs(step).max(), 1.0) > GROWN:
                break  # what has grown so far says nothing more of sizes, and would overflow
            flow = step @ flow
            covariance = covariance if period else propagate(covariance, step, reached)
        reach = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        if not period and np.all((reach > 0) | (observed > 0)):
            break
    observed = np.sqrt(np.where((reach > 0) | (observed > 0), observed, later))
    with np.errstate(divide="ignore", invalid="ignore"):
        both = np.sqrt(reach / observed)
    D = np.where(
        (reach > 0) & (observed > 0), both, np.where(observed > 0, 1 / np.where(observed > 0, observed, 1), reach)
    )
    for _ in range(n):
        D = np.where(D > 0, D, np.abs(F).max(axis=0, initial=0.0) @ D)
    return np.asarray(np.where(D > 0, D, 1.0))


class GapTable:
    """Gaps in coordinates x = D x~, for the disturbance G w with w in the unit ball or box."""

    def __init__(self, A: Array, G: Array, D: Array):
        self.D, self.A, self.G = D, A * D / D[:, None], G / D[:, None]
        n = len(self.A)
        self._size = float(np.linalg.norm(self.A, 2)) if n else 0.0
        self._second = self.A @ (self.A @ self.G)
        self._third = self.A @ self._second
        self.driven = np.hstack([self.G, self._second])
        self._known: dict[float, RecordGap] = {}
        self._cut: dict[float, PropagatedGap] = {}
        self._open: tuple[float, RecordGap] | None = None

    @classmethod
    def suited(cls, A: Array, G: Array, lengths: Array, rows: list[Array]) -> GapTable:
        """Return a table whose coordinates even out the units of a record: its gaps, and the rows measured after each.

        `rows` are in units of their noise.
        """
        balance = balanced_schur(A).d
        moved, driven = A * balance / balance[:, None], G / balance[:, None]
        if not lengths.size:
            return cls(A, G, balance)
        with np.errstate(over="ignore", invalid="ignore"):
            F, W = discounted_flow(moved, driven @ driven.T, lengths)
        D = state_scales(F, W * float(np.mean(lengths)), [H * balance for H in rows])
        return cls(A, G, balance * D)

    def open(self, length: float) -> RecordGap:
        """Return the gap after the last sample of a record."""
        if self._open is None or self._open[0] != length:
            number = min(int(self._number(np.array([length]))[0]) * FINER, PANELS[1])
            with np.errstate(over="ignore", invalid="ignore"):
                self._open = length, self._make_alike(np.array([length]), number)[length]
        return self._open[1]

    def get(self, lengths: Sequence[float]) -> list[RecordGap]:
        """Return the gaps of a record, of these lengths."""
        missing = [h for h in dict.fromkeys(lengths) if h not in self._known]
        if missing:
            if len(self._known) + len(missing) > REMEMBERED:
                self._known.clear()
                missing = list(dict.fromkeys(lengths))
            with np.errstate(over="ignore", invalid="ignore"):
                self._make(np.array(missing))
        return [self._known[h] for h in lengths]

    @cached_property
    def _pace(self) -> float:
        return pace(self.A)

    def cut(self, length: float, panel: float) -> PropagatedGap:
        """Return one gap, whose panels times its pace are at most so long; all that are asked for so have one size."""
        if length not in self._cut:
            number = int(np.clip(np.ceil(self._pace * length / panel), *PANELS))
            number += -number % JOINED if number > MANY else 0
            with np.errstate(over="ignore", invalid="ignore"):
                _, _, propagated, bend, third = self._panels(np.array([length]), number)
            self._cut[length] = PropagatedGap(length / number, propagated[0], bend[0], third[0])
        return self._cut[length]

    def _make(self, lengths: Array) -> None:
        numbers = self._number(lengths)
        for number in np.unique(numbers):
            self._known.update(self._make_alike(lengths[numbers == number], int(number)))

    def _number(self, lengths: Array) -> Index:
        """Panels of each gap, a power of two."""
        wanted = np.clip(np.ceil(self._size * lengths / PANEL), *PANELS)
        return np.asarray(np.exp2(np.ceil(np.log2(wanted))), dtype=np.intp)

    def _panels(self, lengths: Array, number: int) -> tuple[Array, Array, Array, Array, Array]:
        """Flows at the ends of so many panels, flow and response over the first, then what a `PropagatedGap` keeps."""
        n, step = len(self.A), lengths / number
        first = forced_flow(self.A, self.G, step)
        E = np.empty((lengths.size, number + 1, n, n))
        E[:, 0], E[:, 1] = np.eye(n), first[:, :, :n]
        known = 1
        while known < number:
            more = min(known, number - known)
            np.matmul(E[:, known, None], E[:, 1 : more + 1], out=E[:, known + 1 : known + more + 1])
            known += more
        middle = expm_batch(self.A, step / 2) @ self._third
        third = np.linalg.norm(E[:, :-1] @ middle[:, None], axis=(2, 3)) * np.exp(self._size * step / 2)[:, None]
        return E, first, E @ self.G, E @ self._second, third

    def _make_alike(self, lengths: Array, number: int) -> dict[float, RecordGap]:
        """Gaps of a record with equally many panels, a power of two."""
        n, made = len(self.A), dict[float, RecordGap]()
        most = max(AT_ONCE // (number * max(n, 1) ** 2), 1)
        for some in (lengths[i : i + most] for i in range(0, lengths.size, most)):
            E, first, propagated, bend, third = self._panels(some, number)
            doubled, step = E[:, 2 ** np.arange(number.bit_length())], some / number
            inner = E[:, :-1] @ first[:, None, :, n:]
            held = (n + number) * SUM_HELD * np.linalg.norm(inner, axis=(2, 3))
            marks, forced = self._marks(propagated, bend, step), first[:, :, n:].copy()
            for k, h in enumerate(some.tolist()):
                made[h] = RecordGap(float(step[k]), doubled[k], forced[k], third[k], held[k], marks[k])
                made[h].cut(0, inner[k])
        return made

    def _marks(self, propagated: Array, bend: Array, step: Array) -> Array:
        """Middles of panels, counted in cells so short that delta^2/24 |M''|/|M| <= LOSS."""
        rate = cell_rate(propagated, bend, LOSS)
        panels = (rate[:, 1:] + rate[:, :-1]) / 2 * step[:, None]
        total = panels.sum(axis=1, keepdims=True)
        fine = (total > 0) & np.isfinite(total)
        panels = np.where(fine, panels, 1 / panels.shape[1])
        return np.asarray(np.cumsum(panels, axis=1) - panels / 2)


class DisturbanceQuadrature:
    """`PropagatedGap.integral` of one column for each of many gaps of a record; those of as many panels are stacked."""

    def __init__(self, table: GapTable, gaps: Sequence[RecordGap]):
        counts, names = [gap.third.size for gap in gaps], ("step", "doubled", "forced", "third", "held")
        self._driven = table.driven
        self._groups = []
        for count in sorted(set(counts)):
            at = [k for k, own in enumerate(counts) if own == count]
            self._groups.append((at, [np.array([getattr(gaps[k], name) for k in at]) for name in names]))

    def integral(self, g: Array, ball: bool) -> float:
        """Return a bound on the sum over gaps j of int h_W(G'e^{A's} g_j) ds for g (J, n), for all real times.

        Infinite where a flow overflows. A component that keeps its sign along a panel: the integral of the flow.
        """
        total = float(self.each(g, ball).sum())
        return total if np.isfinite(total) else np.inf

    def each(self, g: Array, ball: bool) -> Array:
        """Return the bounds (J,) that `integral` adds up."""
        found = np.zeros(len(g))
        with np.errstate(over="ignore", invalid="ignore"):
            for at, parts in self._groups:
                most = max(AT_ONCE // (parts[-1].shape[1] * sum(self._driven.shape)), 1)
                for i in range(0, len(at), most):
                    some = slice(i, i + most)
                    found[at[some]] = self._integral(g[at[some]], ball, [part[some] for part in parts])
        return found

    def _integral(self, g: Array, ball: bool, parts: list[Array]) -> Array:
        d, doubled, forced, third, held = parts
        along, d = run_along(doubled, g), d[:, None]
        p, curved = np.split(along @ self._driven, 2, axis=2)
        size = np.linalg.norm(g, axis=1)[:, None]
        steep = np.where(size > 0, third * size, 0.0)  # the bound may be infinite
        if ball and p.shape[2] > 1:
            value, curve = np.sqrt((p * p).sum(axis=2)), np.sqrt((curved * curved).sum(axis=2))
            sup = np.maximum(curve[:, 1:], curve[:, :-1]) + d / 2 * steep
            return np.asarray((d / 2 * (value[:, 1:] + value[:, :-1]) + d**3 / 12 * sup).sum(axis=1))
        d, lost = d[:, :, None], (held * size)[:, :, None]
        value, curve = np.abs(p), np.abs(curved)
        sup = np.maximum(curve[:, 1:], curve[:, :-1]) + d / 2 * steep[:, :, None]
        above = d / 2 * (value[:, 1:] + value[:, :-1]) + d**3 / 12 * sup
        flow = np.abs(along[:, :-1] @ forced) + lost
        one_sign = p[:, 1:] * p[:, :-1] > 0
        one_sign &= d * np.minimum(value[:, 1:], value[:, :-1]) > d**3 / 8 * sup + lost
        return np.asarray(np.where(one_sign, np.minimum(flow, above), above).sum(axis=(1, 2)))


class RecordCells:
    """Cells of a record's gaps on each level, finer than on the last only where those let an adversary lose something.

    Of thousands of gaps only the latest say much of a row: no others become finer.
    """

    def __init__(self, gaps: Sequence[RecordGap], quadrature: DisturbanceQuadrature, ball: bool):
        self._gaps, self._quadrature, self._ball = gaps, quadrature, ball
        self._refined: dict[int, Index] = {}

    def _levels(self, level: int) -> Index:
        return self._refined.get(level, np.full(len(self._gaps), level))

    def of(self, level: int) -> list[Array]:
        """Return the cells of each gap."""
        return [gap.cells(k) for gap, k in zip(self._gaps, self._levels(level).tolist(), strict=True)]

    def refine(self, level: int, before: int, costates: Array, short: float, spared: float) -> None:
        """Make the cells of a level finer than those before, but for gaps that lose at most `spared` together.

        All of them where what cells lose is not what an adversary falls `short` of.
        """
        cells, known = self.of(before), self._levels(before)
        if not cells:
            return
        counts = [len(own) for own in cells]
        with np.errstate(over="ignore", invalid="ignore"):
            pulls = np.einsum("mnq,mn->mq", np.concatenate(cells), np.repeat(costates, counts, axis=0))
            attained = np.linalg.norm(pulls, ord=2 if self._ball else 1, axis=1)
            lost = self._quadrature.each(costates, self._ball)
            lost = np.maximum(lost - np.add.reduceat(attained, np.cumsum([0, *counts[:-1]])), 0.0)
        order = np.argsort(lost)
        finer = order[~(np.cumsum(lost[order]) <= (spared if lost.sum() > short / 2 else -1.0))]
        self._refined.setdefault(level, known.copy())[finer] = level
