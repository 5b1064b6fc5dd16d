"""What readings of uncertain times say by themselves of an unknown start: a box about a trajectory that fits them.

Let xi be a trajectory with the given inputs, x = xi + d, and a reading be of C x(t) + F + v, where its time adds F, a
part F_xi that lies in a known interval and a part F_d that is linear in d and w. Every reading then says

    |C d(t_j)| <= V_j + |F_d,j|,    V_j: its residual at xi, the widest that F_xi allows, and the noise.

Let g_j(u) bound |F_d,j| where |C d(t_j)| <= V_j + u_j for all j. The value of a program is concave in its right-hand
sides and 0 at 0, so that g(a u) <= a g(u) for a >= 1. If g(u) < u, no d has a = max |F_d,j|/u_j >= 1: at that reading
a u_j <= g_j(a u) < a u_j. So |F_d,j| <= u_j for all of them, and the program bounds d at the start.

What a reading whose time is known only to lie in an interval says of one time t in it, by what is known of x(t).

    y(s) - v = C x(s) + D u(s) = C x(t) + D u(t) + F(s - t),    F(e) = C (e^{Ae} - I) x(t) + inputs + w meanwhile

F lies between bounds for every e and every x(t) that earlier readings leave possible: the reading, less these bounds,
is one of C x(t) + D u(t) that lies between two ends.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sampling_design.accuracy.bounds import BoundedSet
from sampling_design.accuracy.gap_table import DisturbanceQuadrature, GapTable
from sampling_design.accuracy.readings import CensoredReading, Readings, RecordRow, RowReading, input_at
from sampling_design.accuracy.record_program import RecordProgram
from sampling_design.errors import ArgumentError
from sampling_design.numerics.linalg import balance, balanced, expm_batch, extrapolated
from sampling_design.plants.clusters import balanced_schur
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array

PANELS = (4, 32)  # least and largest number of panels of a stretch on which inputs are constant

FINENESS = 4.0
"""Panels of a stretch over the root of its length times |A|: what chords lose is then a thirtieth of the whole."""

ROUNDED = 1e-11  # share of its terms that is added to a bound for the rounding of flows
Known = Callable[[Array], tuple[Array, Array]]  # lower and upper ends (r,) of rows (r, n) of x(t)


def resolved(
    unread: Readings,
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
        sides = [TimeShift(unread, t, output, end, before) for output, span in spans for end in span]
    rows = np.concatenate([side.rows[:, :-1] for side in sides])
    asked, plant = np.flatnonzero(rows.any(axis=1)), unread.plant
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

    def __init__(self, unread: Readings, t: float, output: int, end: float, before: bool):
        plant, disturbance, inputs = unread.plant, unread.disturbance, unread.inputs
        C, D, n = plant.C[output], plant.D[output], plant.n_states
        sign = 1.0 if end >= t else -1.0
        base, last = (np.append(C, float(D @ input_at(inputs, at, plant.n_inputs, before))) for at in (t, end))
        times = [at for at, _ in inputs if min(t, end) < at < max(t, end)]
        edges = [t, *(times if sign > 0 else times[::-1]), end]
        rate, flow = balanced_schur(plant.A).speed, np.eye(n + 1)
        rows, sizes, self._bends = [base - base], [np.zeros(n + 1)], list[Array]()

        def node(row: Array, flow: Array, bend: Array) -> None:
            rows.append(row @ flow - base)
            sizes.append(np.abs(row) @ np.abs(flow) + np.abs(base))
            self._bends.append(bend)

        for a, b in pairwise(edges):
            u = input_at(inputs, (a + b) / 2, plant.n_inputs)
            longer = np.zeros((n + 1, n + 1))
            longer[:n, :n], longer[:n, n] = plant.A, plant.B @ u + plant.G @ disturbance.centre
            count = int(np.clip(np.ceil(FINENESS * np.sqrt(rate * abs(b - a))), *PANELS))
            step, row = abs(b - a) / count, np.append(C, float(D @ u))
            d = balance(longer).d
            even = longer / d[:, None] * d
            # over half a panel, |e^{As} - I| <= e^{|A|s} - I entry by entry
            half, grown = (expm_batch(M, step / 2)[0] * d[:, None] / d for M in (sign * even, np.abs(even)))
            bend = step**2 / 8 * (row @ longer @ longer)
            node(row, flow, np.zeros(n + 1))  # a jump of D u
            for _ in range(count):
                middle = half @ flow
                flow = half @ middle
                node(row, flow, np.abs(bend @ middle) @ grown)
        if not np.array_equal(row, last):  # a jump at the end itself
            node(last, flow, np.zeros(n + 1))
        self.rows, self._sizes = np.array(rows), np.array(sizes)
        self.rows = self.rows if np.isfinite(self._sizes).all() else np.full_like(self.rows, np.inf)
        self._moved = self._driven(plant, disturbance, C, abs(end - t), sign)

    @staticmethod
    def _driven(plant: Plant, disturbance: BoundedSet, C: Array, length: float, sign: float) -> float:
        """What w adds over the whole side at most: int h_W(G'e^{A's}C') ds."""
        G = plant.G @ disturbance.root
        if length == 0 or not G.any():
            return 0.0
        table = GapTable.suited(sign * plant.A, G, np.zeros(0), [])
        return DisturbanceQuadrature(table, [table.open(length)]).integral((C * table.D)[None], disturbance.ball)

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


TURNS = 24
"""Times that a bound on what uncertain times add is sought."""
MORE = 0.02
"""Share by which a bound is above what it must be more than."""
FARTHEST = 1e6
"""Beyond so many times what times add at least, nothing is sought."""


class _RowLimit(NamedTuple):
    """|C d(t)| <= size + what its time adds, by the sides of its interval; none of a reading whose time is known."""

    t: float
    output: int
    size: float
    sides: tuple[TimeShift, ...]


def start_of_dated(
    unread: Readings, samples: Sequence[RecordRow], noise: tuple[Array, Array], before: bool = False
) -> BoundedSet | None:
    """Return the box of the state at the start that the readings prove; None if they prove none.

    `noise`: the sizes (N, p) and the middles of what is added to each reading; `before` as in `resolved`.
    """
    plant, inputs, disturbance = unread.plant, unread.inputs, unread.disturbance
    flows = _flows(unread, [item.t for item in samples])
    x = _fitted(unread, samples, flows, noise, before)
    here = replace(unread, disturbance=replace(disturbance, root=np.zeros_like(disturbance.root)))
    still = replace(disturbance, centre=np.zeros(plant.n_disturbances))
    unknown = BoundedSet.of("initial_error", None, plant.states.names)
    apart = Readings.unread(plant, still, unknown, unread.begin)  # of d, which nothing else drives
    censored: list[_RowLimit] = []
    for item, M, size, middle in zip(samples, flows, *noise, strict=True):
        xi = M @ np.append(x, 1.0)
        for i in np.flatnonzero(np.isfinite(item.y) & np.isfinite(size)).tolist():
            censored.append(_RowLimit(item.t, i, abs(item.y[i] - middle[i] - plant.C[i] @ xi) + size[i], ()))
        for each in item.censored:
            if (
                each.stamp is None
                or each.since is not None
                or not np.isfinite([*each.stamp[2:], size[each.output]]).all()
            ):
                continue
            i, (first, last, low, high) = each.output, each.stamp
            known = [TimeShift(here, item.t, i, end, before) for end in (first, last)]
            least, most = _ends(known, partial(_at, xi), np.abs(xi))
            off = middle[i] + float(plant.D[i] @ input_at(inputs, item.t, plant.n_inputs, before)) + plant.C[i] @ xi
            moves = tuple(TimeShift(apart, item.t, i, end, before) for end in (first, last))
            censored.append(_RowLimit(item.t, i, max(abs(low - off - most), abs(high - off - least)) + size[i], moves))
    found = _bounded(apart, censored)
    return None if found is None else BoundedSet.box(x, found)


def _bounded(apart: Readings, censored: Sequence[_RowLimit]) -> Array | None:
    """How large each entry of d may be at the start; None where nothing bounds it."""
    before, tried = np.zeros(len(censored)), np.zeros(len(censored))
    for _ in range(TURNS):
        program = _program(apart, censored, tried)
        boxes = {t: _box(program, t) for t in {each.t for each in censored}}
        found = np.array([_adds(each, boxes[each.t]) for each in censored])
        if not np.isfinite(found).all():
            return None
        if np.all((tried >= found * (1 + MORE / 2)) | (found == 0)):
            box = _box(program, apart.begin)
            return box if np.isfinite(box).all() else None
        before, tried = tried, extrapolated(before, tried, found) * (1 + MORE)
        if np.any(tried > FARTHEST * (np.max([each.size for each in censored]) + 1e-300)):
            return None
    return None


def _program(apart: Readings, censored: Sequence[_RowLimit], added: Array) -> RecordProgram:
    """The program of trajectories that read zero within the sizes and what is added to them."""
    rows: dict[float, tuple[RowReading, ...]] = {apart.begin: ()}
    for each, more in zip(censored, added.tolist(), strict=True):
        rows[each.t] = (
            *rows.get(each.t, ()),
            RowReading(apart.plant.C[each.output], 0.0, each.size + more, output=each.output),
        )
    return RecordProgram(apart.reading(sorted(rows.items())))


def _at(x: Array, rows: Array) -> tuple[Array, Array]:
    return rows @ x, rows @ x


def _box(program: RecordProgram, t: float) -> Array:
    return np.array([up.value for up, _ in program.solve(t, np.eye(program.readings.plant.n_states))])


def _adds(reading: _RowLimit, box: Array) -> float:
    """What a time adds at most to a reading of d, of which a box is known."""
    if not reading.sides:
        return 0.0
    return float(np.max(np.abs(_ends(reading.sides, lambda rows: (-np.abs(rows) @ box, np.abs(rows) @ box), box))))


def _ends(sides: Sequence[TimeShift], known: Callable[[Array], tuple[Array, Array]], box: Array) -> tuple[float, float]:
    """Between what the sides of an interval lie, by what is known of rows of the state."""
    with np.errstate(invalid="ignore"):
        found = [side.between(*known(side.rows[:, :-1]), box) for side in sides]
    least, most = min(low for low, _ in found), max(high for _, high in found)
    return (least, most) if np.isfinite([least, most]).all() else (-np.inf, np.inf)


def _flows(unread: Readings, times: Sequence[float]) -> list[Array]:
    """M (n, n + 1) for each time: x(t) = M (x(start), 1) with the inputs and the disturbance's middle."""
    plant, inputs, now = unread.plant, unread.inputs, unread.begin
    n, flow, found = plant.n_states, np.eye(plant.n_states + 1), list[Array]()
    for t in times:
        marks = [now, *(s for s, _ in inputs if now < s < t), t]
        for a, b in pairwise(marks):
            longer = np.zeros((n + 1, n + 1))
            u = input_at(inputs, (a + b) / 2, plant.n_inputs)
            longer[:n, :n], longer[:n, n] = plant.A, plant.B @ u + plant.G @ unread.disturbance.centre
            d = balance(longer).d
            flow = (expm_batch(balanced(longer, d), b - a)[0] * d[:, None] / d) @ flow
        now = t
        found.append(flow[:n])
    return found


def _fitted(
    unread: Readings, samples: Sequence[RecordRow], flows: Sequence[Array], noise: tuple[Array, Array], before: bool
) -> Array:
    """The start of the trajectory that fits the readings best, those of uncertain times in the middle of these.

    Each counts in units of its noise, so that no unit of an output changes it.
    """
    plant, rows, ends = unread.plant, [], []
    for item, M, own, middle in zip(samples, flows, *noise, strict=True):
        fed = plant.D @ input_at(unread.inputs, item.t, plant.n_inputs, before)
        read = {i: item.y[i] for i in np.flatnonzero(np.isfinite(item.y)).tolist()}
        read |= {
            e.output: (e.stamp.lower + e.stamp.upper) / 2 - fed[e.output] for e in item.censored if e.stamp is not None
        }
        for i, y in read.items():
            if np.isfinite(y):
                row, scale = plant.C[i] @ M, own[i] if own[i] > 0 else plant.outputs.scales[i]
                rows.append(row[:-1] / scale)
                ends.append((y - middle[i] - row[-1]) / scale)
    if not rows:
        return np.zeros(plant.n_states)
    A = np.array(rows)
    size = np.linalg.norm(A, axis=0)
    size = np.where(size > 0, size, 1.0)
    return np.asarray(np.linalg.lstsq(A / size, np.array(ends), rcond=None)[0] / size)
