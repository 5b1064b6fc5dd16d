"""What a reading whose time is known only to lie in an interval says of one time t in it, by what is known of x(t).

    y(s) - v = C x(s) + D u(s) = C x(t) + D u(t) + F(s - t),    F(e) = C (e^{Ae} - I) x(t) + inputs + w meanwhile

F lies between bounds for every e and every x(t) that earlier readings leave possible: the reading, less these bounds,
is one of C x(t) + D u(t) that lies between two ends.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from sampling_design.accuracy.gap_table import DisturbanceQuadrature, GapTable
from sampling_design.accuracy.readings import CensoredReading, DisturbanceSet, input_at
from sampling_design.errors import ArgumentError
from sampling_design.numerics.balancing import balance
from sampling_design.numerics.linalg import expm_batch
from sampling_design.plants.grouping import balanced_schur
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array

PANELS = (4, 32)  # least and largest number of panels of a stretch on which inputs are constant

FINENESS = 4.0
"""Panels of a stretch over the root of its length times |A|: what chords lose is then a thirtieth of the whole."""

ROUNDED = 1e-11  # share of its terms that is added to a bound for the rounding of flows
Known = Callable[[Array], tuple[Array, Array]]  # lower and upper ends (r,) of rows (r, n) of x(t)


def resolved(
    plant: Plant,
    disturbance: DisturbanceSet,
    inputs: Sequence[tuple[float, Array]],
    t: float,
    censored: tuple[CensoredReading, ...],
    known: Known,
    before: bool = False,
    waiting: bool = False,
) -> tuple[CensoredReading, ...]:
    """Return readings of uncertain times as what they say of t, a time in each; the others as they are.

    D u is that from t on; `before`: an input that jumps at a time enters there as it was before. `waiting`: later
    readings may tell what one says of which nothing is known yet. Else raises ArgumentError if nothing that is known
    bounds how far an output may move meanwhile.
    """
    stamped = [each for each in censored if each.stamp is not None]
    if not stamped:
        return censored
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is not finite, and bounds nothing
        spans = [(each.output, each.span) for each in stamped if each.span is not None]
        sides = [
            TimeShift(plant, disturbance, inputs, t, output, end, before) for output, span in spans for end in span
        ]
    rows = np.concatenate([side.rows[:, :-1] for side in sides])
    asked = np.flatnonzero(rows.any(axis=1))
    low, high = np.zeros(len(rows)), np.zeros(len(rows))
    box = np.zeros(plant.n_states)
    if not np.isfinite(rows).all():
        low[:], high[:], asked = -np.inf, np.inf, asked[:0]
    if asked.size:
        found = known(np.concatenate([rows[asked], np.eye(plant.n_states)]))
        if any(np.isnan(ends).any() for ends in found):  # the data contradict the bounds: no reading says any more
            return nothing_said(censored)
        low[asked], high[asked] = (ends[: asked.size] for ends in found)
        box = np.maximum(np.abs(found[0]), np.abs(found[1]))[asked.size :]
    ends, at = [], 0
    for side in sides:
        own = slice(at, at + len(side.rows))
        ends.append(side.between(low[own], high[own], box))
        at += len(side.rows)
    least = {id(each): min(ends[2 * k][0], ends[2 * k + 1][0]) for k, each in enumerate(stamped)}
    most = {id(each): max(ends[2 * k][1], ends[2 * k + 1][1]) for k, each in enumerate(stamped)}
    return tuple(
        _between(plant, each, least[id(each)], most[id(each)], waiting) if each.stamp else each for each in censored
    )


def nothing_said(censored: tuple[CensoredReading, ...]) -> tuple[CensoredReading, ...]:
    """Readings of uncertain times as saying nothing, as where what is known contradicts itself; others as they are."""
    return tuple(each if each.stamp is None else each._replace(lower=-np.inf, upper=np.inf) for each in censored)


def _between(plant: Plant, read: CensoredReading, least: float, most: float, waiting: bool) -> CensoredReading:
    stamp = read.stamp
    assert stamp is not None
    if np.isinf(least) and np.isinf(most) and stamp.first < stamp.last and not waiting:
        raise ArgumentError(
            f"`t` = ({stamp.first!r}, {stamp.last!r}) is uncertain, and nothing that is known by then bounds how far "
            f"{plant.outputs.names[read.output]} may move meanwhile: give `initial_error`, or the time."
        )
    return read._replace(lower=stamp.lower - most, upper=stamp.upper - least)


class TimeShift:
    """F from t on to an end of the interval, after or before it: at nodes by rows of (x(t), 1), in between by bends."""

    def __init__(
        self,
        plant: Plant,
        disturbance: DisturbanceSet,
        inputs: Sequence[tuple[float, Array]],
        t: float,
        output: int,
        end: float,
        before: bool,
    ):
        C, D, n = plant.C[output], plant.D[output], plant.n_states
        sign = 1.0 if end >= t else -1.0
        base, last = (np.append(C, float(D @ input_at(inputs, at, plant.n_inputs, before))) for at in (t, end))
        times = [at for at, _ in inputs if min(t, end) < at < max(t, end)]
        edges = [t, *(times if sign > 0 else times[::-1]), end]
        rate, flow = balanced_schur(plant.A).speed, np.eye(n + 1)
        rows, sizes, self._bends = [base - base], [np.zeros(n + 1)], list[Array]()
        for a, b in pairwise(edges):
            u = input_at(inputs, (a + b) / 2, plant.n_inputs)
            longer = np.zeros((n + 1, n + 1))
            longer[:n, :n], longer[:n, n] = plant.A, plant.B @ u + plant.G @ disturbance.centre
            count = int(np.clip(np.ceil(FINENESS * np.sqrt(rate * abs(b - a))), *PANELS))
            step, row = abs(b - a) / count, np.append(C, float(D @ u))
            d = balance(longer).d
            even = longer / d[:, None] * d
            # over half a panel, |e^{As} - I| <= e^{|A|s} - I entry by entry
            half, spread = (expm_batch(M, step / 2)[0] * d[:, None] / d for M in (sign * even, np.abs(even)))
            bend = step**2 / 8 * (row @ longer @ longer)
            rows.append(row @ flow - base)
            sizes.append(np.abs(row) @ np.abs(flow) + np.abs(base))
            self._bends.append(np.zeros(n + 1))  # a jump of D u
            for _ in range(count):
                middle = half @ flow
                flow = half @ middle
                self._bends.append(np.abs(bend @ middle) @ spread)
                rows.append(row @ flow - base)
                sizes.append(np.abs(row) @ np.abs(flow) + np.abs(base))
        if not np.array_equal(row, last):  # a jump at the end itself
            rows.append(last @ flow - base)
            sizes.append(np.abs(last) @ np.abs(flow) + np.abs(base))
            self._bends.append(np.zeros(n + 1))
        self.rows, self._sizes = np.array(rows), np.array(sizes)
        self.rows = self.rows if np.isfinite(self._sizes).all() else np.full_like(self.rows, np.inf)
        self._moved = self._driven(plant, disturbance, C, abs(end - t), sign)

    @staticmethod
    def _driven(plant: Plant, disturbance: DisturbanceSet, C: Array, length: float, sign: float) -> float:
        """What w adds over the whole side at most: int h_W(G'e^{A's}C') ds."""
        G = plant.G @ disturbance.root
        if length == 0 or not G.any():
            return 0.0
        table = GapTable.suited(sign * plant.A, G, np.zeros(0), [])
        return DisturbanceQuadrature([table.open(length)]).integral((C * table.D)[None], disturbance.ball)

    def between(self, low: Array, high: Array, box: Array) -> tuple[float, float]:
        """Return bounds on F, given those of its rows at the nodes and the size of each state."""
        size = np.append(box, 1.0)
        rest = _total(self._sizes, size) * ROUNDED if self.rows.any() else np.zeros(len(low))
        fixed = self.rows[:, -1]
        low, high = low + fixed - rest, high + fixed + rest
        bend = _total(np.array(self._bends).reshape(-1, len(size)), size)
        least = np.min(np.minimum(low[1:], low[:-1]) - bend, initial=0.0)
        most = np.max(np.maximum(high[1:], high[:-1]) + bend, initial=0.0)
        return float(least - self._moved), float(most + self._moved)


def _total(rows: Array, size: Array) -> Array:
    """|rows| size, where nothing times infinity is nothing."""
    return np.asarray(np.multiply(rows, size, where=rows > 0, out=np.zeros_like(rows)).sum(axis=1))
