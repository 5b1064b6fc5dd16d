"""Claim "interval": gains bound what rows of the state may be, given what was read.

For gains lambda let g be c at t, run back by g' = -A'g, less row'lambda at each reading. Then for every trajectory
    c'x(t) = sum lambda row x + g(s)'x(s) + int g'(Bu + Gw),
so that with |row x - y| <= size, x(s) = centre + root a and w = w_centre + w_root a
    c'x(t) <= sum lambda y + g(s)'centre + int g'(Bu + G w_centre)
              + |root'g(s)| + int |w_root'G'g| + sum |lambda| size.
Costates at readings are integers (`long_numbers`): over many gaps doubles would lose them, or the bound of their error.
Every other number is kept with a bound of its error, and integrals of norms lie between panels' chords: |p| is below
its chord plus (s - a)(b - s)/2 sup|p''|; where that shows that p keeps its sign, int |p| = |int p|.

Over many gaps that bound must not grow as products of |e^{A'h}| do: what a step is off by is carried back by one flow,
e^{A's}, whose largest entries are known for all s of the record.

Nothing is known of a start without a root: then g(s) must be 0. Gains near those of the file make it so; by how much
more they may cost is added; those of the first readings will do, or more of them where they do not. A state that drives
neither a wanted row nor a reading has g = 0 whatever the gains. What is read as a mean is a row of a longer state: x
and its integral, 0 at `since`.
"""

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import numpy as np

from .interval_file import INTERVAL, OfInterval, of_interval
from .long_numbers import UNIT, doubles, largest_flow, long, long_flow, product
from .numbers import EPS, safe
from .outcome import Refused, Undecided, Verdict, WorkLimit, holds
from .parts import Claim
from .strict import Array, Mask

PANEL = 1 / 128  # length of a panel times |A|, at most
LEAST_PANELS = 64  # of one gap
TERMS = 14  # of e^M, |M| <= 1/128: the rest is below 1e-36
MOST_PANELS = 2**14  # of one gap
MOST_HELD = 2_000_000  # numbers of one array of costates: more questions are worked out one part after the other
FIRST, MORE = 4, 8  # readings for each state with which an open start is tried to be closed; then so many times more
KEPT = 5  # times as many are kept of gaps that may come again
LONG = 2  # microseconds of a product of rationals
STEPS = 30  # microseconds of a flow in integers, over the cube of its size
INEQUALITY = "c'x(t) <= sum lambda y + b(lambda)"
SUBJECT = "every row and every trajectory within the bounds"
LOOSE = 1 + 1e-9  # covers the rounding of bounds themselves, which are sums of positive terms
HALF = 0.5
# shares of the largest gain, as rows cost, above which that of a one-sided row may change, too; tried in turn
PLAYS = (1e-5, 1e-8, 0.0)


@dataclass
class Columns:
    """Costates (N, k), a bound of their errors, and what their functionals come to; one column for each question."""

    most: Array  # (N, N), of |e^{A's}|
    long: Array  # integers
    lost: Array  # the errors of all steps so far, each where it was made
    exact: Array  # sum lambda y + g'centre + int g'(Bu + G centre)
    doubt: Array  # of it
    disturbance: Array  # int |w_root'G'g| at most
    least: Array  # and at least
    noise: Array

    @property
    def g(self) -> Array:
        """Costates as doubles."""
        return doubles(self.long)

    @property
    def off(self) -> Array:
        """Bounds of the errors of the integers."""
        return self.most @ self.lost * LOOSE

    @property
    def wrong(self) -> Array:
        """Bounds of the errors of the doubles."""
        return (self.off + EPS * np.abs(self.g)) * LOOSE


def prove(c: OfInterval, work: WorkLimit | None = None) -> Verdict:
    """Prove every end (or the contradiction); the slack is relative to the width."""
    backward = BackwardRecursion(c, WorkLimit(math.inf) if work is None else work)
    every = c.gains.shape[2]
    while True:
        try:
            return proven(c, backward)
        except Undecided:
            if backward.singles in (0, every):
                raise
            backward.singles = min(MORE * backward.singles, every)


def proven(c: OfInterval, backward: "BackwardRecursion") -> Verdict:
    """The same with so many readings to close an open start."""
    if c.factors is not None:
        return holds(INEQUALITY, contradiction(c, backward), SUBJECT)
    targets = np.array([sign * row for row in c.rows for sign in (1.0, -1.0)])
    gains = c.gains.reshape(len(targets), -1)
    stated = [end for low, high in c.ends for end in (high, None if low is None else -low)]
    chosen = [k for k, end in enumerate(stated) if end is not None]
    if not chosen:
        return holds(INEQUALITY, 1.0, SUBJECT)
    most, least = backward.run(targets[chosen], gains[chosen]).ends()
    slack, said = 1.0, np.array([stated[k] for k in chosen], dtype=np.float64)
    for k, end, high, low in zip(chosen, said, most, least, strict=True):
        if high <= end:
            scale = max(abs(end), abs(high), 1e-300)
            slack = min(slack, float((end - high) / scale))
            continue
        side, name = ("upper", "lower")[k % 2], k // 2
        reason = f"the gains prove the {side} end of row {name} only up to {abs(high):.9g}, {abs(end):.9g} is stated"
        if low > end:
            raise Refused(INEQUALITY, reason, float((end - low) / max(abs(low), abs(end))))
        raise Undecided(INEQUALITY, f"{reason}: rounding is as large as what is left")
    return holds(INEQUALITY, slack, SUBJECT)


def contradiction(c: OfInterval, backward: "BackwardRecursion") -> float:
    """Prove that all bounds, that on w alone and that on v alone would have to be so many times as large."""
    assert c.factors is not None
    names = list(c.factors)
    gains = np.array([c.factors[name][1] for name in names])
    found = backward.run(np.zeros((len(names), c.plant.n)), gains)
    slack = math.inf
    for k, name in enumerate(names):
        stated = c.factors[name][0]
        start, w, v, readings = found.start[k], found.disturbance[k], found.noise[k], found.readings[k]
        fixed = {"all": 0.0, "w": start + v, "v": start + w}[name]
        grown = {"all": start + w + v, "w": w, "v": v}[name]
        if not np.isfinite(fixed + grown + readings):
            raise Undecided(INEQUALITY, f"the factor of {name} could not be decided: its start is not closed")
        needed, doubt = -readings - fixed, found.ends()[0][k] - found.least[k]
        most = (
            stated * grown * LOOSE if grown > 0 and stated > 0 else 0.0
        )  # where the bound is 0, any factor leaves it so
        if stated > 0 and not (needed > 0 and needed >= most):  # what is not above 0 contradicts nothing
            sentence = f"the gains do not prove that {name} must grow by the factor {stated:.6g}"
            refused = needed + doubt < 0.99 * (most - stated * doubt)
            raise (Refused if refused else Undecided)(INEQUALITY, sentence)
        if name == "all" and not stated > 1:
            raise Refused(INEQUALITY, "a factor of at most 1 is no contradiction")
        slack = min(slack, float(needed / most) - 1 if most > 0 else 1.0)
    return slack if math.isfinite(slack) else 1.0


@dataclass
class RowBound:
    """What some gains come to: their known part with its doubt added, and the three bounds."""

    readings: Array
    least: Array
    start: Array
    disturbance: Array
    noise: Array

    def ends(self) -> tuple[Array, Array]:
        """The proven ends, and what they are at least."""
        return self.readings + self.start + self.disturbance + self.noise, self.least


class BackwardRecursion:
    """Costates from t back to the start, in states of powers of two of the given sizes."""

    def __init__(self, c: OfInterval, work: WorkLimit):
        self.c, self.work = c, work
        n = c.plant.n
        means = dict.fromkeys(one.row.tobytes() for some in c.readings for one in some if one.since is not None)
        self.means = list(means)
        size = n + len(self.means)
        self.singles = min(FIRST * n, c.gains.shape[2]) if c.root is None else 0
        self.changes = [t for t, _ in c.inputs]
        rows = [(k, one) for k, some in enumerate(c.readings) for one in some]
        kinds = [(k, one.row.tobytes(), one.since, one.below) for k, one in rows]
        first = {kind: j for j, kind in reversed(list(enumerate(kinds)))}
        # a row that was read twice at one time shows no more of the start
        self.order = np.array(sorted(range(len(kinds)), key=lambda j: first[kinds[j]] != j), dtype=np.intp)
        self.begin: dict[float, list[int]] = {}  # integrals that are 0 at a time
        for _, one in rows:
            if one.since is not None:
                self.begin.setdefault(one.since, []).append(n + self.means.index(one.row.tobytes()))
        self.d = np.exp2(np.round(np.log2(c.scales)))
        A = np.zeros((size, size))
        A[:n, :n] = c.plant.A
        for k, key in enumerate(self.means):
            A[n + k, :n] = np.frombuffer(key)
        self.A = A * self.d / self.d[:, None]
        G = c.plant.G @ c.w_root
        self.G = np.zeros((size, G.shape[1]))
        self.G[:n] = G / self.d[:n, None]
        lost = (c.plant.G.shape[1] + 2) * EPS * (np.abs(c.plant.G) @ np.abs(c.w_root))
        self.wrong_G = np.zeros_like(self.G)
        self.wrong_G[:n] = lost / self.d[:n, None]
        self.known: dict[Fraction, tuple[Array, Array, Array, Array, Array, float]] = {}
        self.held = 0  # numbers of these
        self.size = float(np.linalg.norm(self.A, 2)) * LOOSE
        root = np.zeros(0) if c.root is None else c.root / self.d[:n, None]
        # what underflows in units that a file states would be lost: nothing may
        every = [c.rows, *(one.row for _, one in rows)]
        safe(self.d, c.plant.A, G, *every)
        safe(self.A, self.G, root, *(row * self.d[:n] for row in every))

    def run(self, targets: Array, gains: Array) -> RowBound:
        """What gains (k, R) for targets (k, n) come to; a column each for the first rows where the start is open."""
        c, n, count, at = self.c, self.c.plant.n, *gains.shape
        g, zero = np.zeros((len(self.A), count + self.singles)), np.zeros(count + self.singles)
        g[:n, :count] = (targets * self.d[:n]).T
        most = np.eye(len(self.A))
        self.spend(STEPS * n**3)
        most[:n, :n] = largest_flow(self.A[:n, :n].T, Fraction(c.t) - Fraction(c.times[0]))
        columns = Columns(most, *long(g), *(zero.copy() for _ in range(5)))
        self.touched = self.driving(np.any(g != 0, axis=1))
        every = np.vstack([gains, np.zeros((self.singles, at))])
        every[range(count, len(every)), self.order[: self.singles]] = -1.0
        self.fly(columns, c.times[-1], c.t)
        for k in range(len(c.times) - 1, -1, -1):
            at -= len(c.readings[k])
            self.read(columns, k, every[:, at : at + len(c.readings[k])])
            if k:
                self.fly(columns, c.times[k - 1], c.times[k])
                self.reset(columns, k - 1)
        return self.begun(columns, gains)

    def read(self, columns: Columns, k: int, gains: Array) -> None:
        """Take the readings of one time out."""
        c, n = self.c, self.c.plant.n
        squares = np.zeros(len(gains))
        for one, gain in zip(c.readings[k], gains.T, strict=True):
            row = [Fraction(0)] * len(self.A)
            if one.since is None:
                row[:n] = map(Fraction, (one.row * self.d[:n]).tolist())
            else:
                place = n + self.means.index(one.row.tobytes())
                row[place] = Fraction(float(self.d[place])) / (Fraction(c.times[k]) - Fraction(one.since))
            if one.below and np.any(gain[: gain.size - self.singles] < 0):
                raise Refused(INEQUALITY, f"a gain of a one-sided reading at {c.times[k]:.9g} is negative")
            some = np.flatnonzero(gain)
            self.spend(LONG * some.size * len(row))
            taken, cut = long([[share * x for x in map(Fraction, gain[some].tolist())] for share in row])
            columns.long[:, some] -= taken
            columns.lost[:, some] += cut
            columns.exact += gain * one.y
            columns.doubt += 2 * EPS * (np.abs(gain * one.y) + np.abs(columns.exact))
            if one.below or not c.together:
                columns.noise += np.abs(gain) * one.size * LOOSE
            else:
                squares += (gain * one.size) ** 2
        columns.noise += np.sqrt(squares) * LOOSE

    def spend(self, work: float) -> None:
        """Count what is about to be done; undecided where that is more than was allowed."""
        self.work.spend(work)
        if self.work.over:
            raise Undecided(INEQUALITY, "it takes more work than one check may do")

    def driving(self, wanted: Mask) -> Mask:
        """Which entries of the costates may differ from 0: of states that drive what is wanted or read."""
        found, size = wanted.copy(), self.c.plant.n
        for one in (one for some in self.c.readings for one in some):
            found[:size] |= one.row != 0
        while not np.array_equal(more := found | (self.A[found] != 0).any(axis=0), found):
            found = more
        return found

    def reset(self, columns: Columns, k: int) -> None:
        """Integrals that begin at a time are 0 there."""
        for place in self.begin.get(self.c.times[k], []):
            columns.long[place], columns.lost[place] = 0, 0.0

    def fly(self, columns: Columns, a: float, b: float) -> None:
        """From b back to a, piece by piece of the input."""
        edges = [a, *self.changes[bisect_right(self.changes, a) : bisect_left(self.changes, b)], b]
        for left, right in reversed(list(pairwise(edges))):
            if right > left:
                last = bisect_right(self.changes, left) - 1
                u = self.c.inputs[last][1] if last >= 0 else np.zeros(self.c.plant.B.shape[1])
                self.piece(columns, Fraction(right) - Fraction(left), u)

    def piece(self, columns: Columns, length: Fraction, u: Array) -> None:
        """Over a length with a constant input, in panels."""
        h = float(length)
        panels = 2 ** math.ceil(math.log2(max(self.size * h / PANEL, LEAST_PANELS)))
        if panels > MOST_PANELS:
            raise Undecided(INEQUALITY, f"a gap of {h:.6g} is too long for this check")
        self.spend(panels * columns.lost.size * len(self.A) / 50 + STEPS * len(self.A) ** 3)
        d = h / panels
        if length not in self.known:
            held = 2 * (panels + 1) * self.A.size
            if self.held + held > KEPT * MOST_HELD:
                self.known, self.held = {}, 0
            self.held += held
            self.known[length] = *flows(self.A.T, d, panels), *long_flow(self.A.T, length)
        E, wrong_E, mean, wrong_mean, whole, wrong_whole = self.known[length]
        g, wrong, n = columns.g, columns.wrong, self.c.plant.n
        brought = np.abs(doubles(whole))
        brought[:n, :n] = np.eye(n)  # what `most` carries
        lost = brought @ columns.lost + wrong_whole * (np.abs(g) + columns.off).sum(axis=0)
        some = (columns.long != 0).any(axis=0) | columns.lost.any(axis=0)  # nothing at all stays nothing
        columns.long, columns.lost = product(whole, columns.long), (lost + UNIT * some) * LOOSE
        for first in range(0, g.shape[1], step := max(1, MOST_HELD // E[:, 0].size)):
            part = slice(first, first + step)
            path = E @ g[:, part]
            doubts = (np.abs(E) + wrong_E) @ wrong[:, part]
            doubts += (wrong_E + len(self.A) * EPS * np.abs(E)) @ np.abs(g[:, part])
            self.integrate(columns, part, path, doubts, (mean, wrong_mean), d)
            self.force(columns, part, path, doubts, (mean, wrong_mean), u)

    def force(
        self, columns: Columns, part: slice, path: Array, doubts: Array, means: tuple[Array, Array], u: Array
    ) -> None:
        """Add int g'(Bu + G centre) over the panels, with its doubt."""
        c, n, (mean, wrong_mean) = self.c, self.c.plant.n, means
        force = np.zeros(len(self.A))
        force[:n] = (c.plant.B @ u + c.plant.G @ c.w_centre) / self.d[:n]
        if not np.any(force):
            return
        sizes = np.zeros(len(self.A))
        sizes[:n] = (np.abs(c.plant.B) @ np.abs(u) + np.abs(c.plant.G) @ np.abs(c.w_centre)) / self.d[:n]
        total, around = path[:-1].sum(axis=0), np.abs(path[:-1]).sum(axis=0)
        loss = (len(path) + 4 * len(mean) + len(u) + len(c.w_centre)) * EPS
        columns.exact[part] += force @ (mean @ total)
        columns.doubt[part] += LOOSE * (
            np.abs(force) @ (wrong_mean @ around + np.abs(mean) @ doubts[:-1].sum(axis=0))
            + 2 * loss * (sizes @ (np.abs(mean) @ around))
            + EPS * np.abs(columns.exact[part])
        )

    def integrate(
        self, columns: Columns, part: slice, path: Array, doubts: Array, means: tuple[Array, Array], d: float
    ) -> None:
        """Add int |G'g| over the panels, from above and from below."""
        if not self.G.shape[1]:
            return
        G, a, size = self.G.T, self.A.T, np.abs(path) + doubts
        p = G @ path
        off = np.abs(G) @ doubts + self.wrong_G.T @ size + 2 * len(a) * EPS * (np.abs(G) @ size)
        bend = G @ a @ a @ path
        rough = np.abs(G) @ np.abs(a) @ np.abs(a)
        off_bend = rough @ doubts + 16 * len(a) * EPS * (rough @ size) + self.wrong_G.T @ np.abs(a) @ np.abs(a) @ size
        cubed = float(np.linalg.norm(rough @ np.abs(a)))
        steep = cubed * math.exp(self.size * d) * np.linalg.norm(size[:-1], axis=1) * (1 if self.c.w_ball else 2)
        if self.c.w_ball and len(G) > 1:
            p, curve = (np.linalg.norm(X, axis=1, keepdims=True) for X in (p, bend))
            off, off_bend = (np.linalg.norm(X, axis=1, keepdims=True) for X in (off, off_bend))
            turn, exact = np.linalg.norm(G @ (path[1:] + path[:-1]), axis=1, keepdims=True), np.full((1, 1, 1), np.inf)
        else:
            curve, turn = np.abs(bend), np.abs(p[1:] + p[:-1])
            mean, wrong_mean = means
            less, more = np.abs(mean) @ size[:-1], wrong_mean @ size[:-1] + np.abs(mean) @ doubts[:-1]
            exact = np.abs(G @ (mean @ path[:-1])) + np.abs(G) @ (more + 4 * len(a) * EPS * less)
            exact += self.wrong_G.T @ (less + more)
        value = np.abs(p)
        curve = np.maximum(curve[1:] + off_bend[1:], curve[:-1] + off_bend[:-1]) + d / 2 * steep[:, None]
        bulge = d**3 / 12 * curve
        above = d / 2 * (value[1:] + value[:-1] + off[1:] + off[:-1]) + bulge
        # of what keeps its sign along a panel the integral is that of the flow
        steady = (p[1:] * p[:-1] > 0) & (np.minimum(value[1:] - off[1:], value[:-1] - off[:-1]) > d**2 / 8 * curve)
        columns.disturbance[part] += LOOSE * np.where(steady, np.minimum(exact, above), above).sum(axis=(0, 1))
        below = (d / 2 * (turn - off[1:] - off[:-1]) - bulge).sum(axis=1)
        columns.least[part] += np.maximum(below, 0.0).sum(axis=0) / LOOSE

    def begun(self, columns: Columns, gains: Array) -> RowBound:
        """Add what is known of the start, or close it where nothing is."""
        c, n = self.c, self.c.plant.n
        rest, wrong = columns.g[:n], columns.wrong[:n]
        centre = c.centre / self.d[:n]
        readings = columns.exact + centre @ rest
        size = np.abs(centre) @ np.abs(rest) + np.abs(readings)
        doubt = columns.doubt + np.abs(centre) @ wrong + (n + 4) * EPS * size
        doubt *= LOOSE
        if c.root is not None:
            root = c.root / self.d[:n, None]
            value = np.abs(root.T @ rest)
            off = np.abs(root.T) @ (wrong + 2 * n * EPS * np.abs(rest))
            if c.start_ball:
                start, lost = np.linalg.norm(value, axis=0), np.linalg.norm(off, axis=0)
            else:
                start, lost = value.sum(axis=0), off.sum(axis=0)
            least = readings - doubt + np.maximum(start - lost, 0) + columns.least + columns.noise / LOOSE**2
            return RowBound(readings + doubt, least, (start + lost) * LOOSE, columns.disturbance, columns.noise)
        return self.closed(columns, gains, readings, doubt)

    def closed(self, columns: Columns, gains: Array, readings: Array, doubt: Array) -> RowBound:
        """Change the gains a little, so that nothing of the start is left: the single rows say what that may cost."""
        at, count = np.flatnonzero(self.touched[: self.c.plant.n]), len(gains)
        rows, wrong = columns.g[at, count:], columns.wrong[:, count:][at]
        size = np.abs(columns.g[at, :count]) + columns.wrong[:, :count][at]
        more = np.zeros(count)
        if not size.any():
            return self.found(columns, readings, doubt, more)
        below = np.array([one.below for some in self.c.readings for one in some], dtype=bool)
        below, gains = below[self.order[: self.singles]], gains[:, self.order[: self.singles]]
        # in units of what a row costs, so that the change is a cheap one
        price = np.abs(readings[count:]) + doubt[count:] + columns.disturbance[count:] + columns.noise[count:]
        spent, todo = gains * price, np.ones(count, dtype=bool)
        for play in PLAYS if below.any() else PLAYS[-1:]:
            usable = ~below | (spent > play * np.abs(spent).max(axis=1, initial=0.0)[:, None])
            for which in np.unique(usable[todo], axis=0):
                own = np.flatnonzero(todo & (usable == which).all(axis=1))
                change = changes(rows, wrong, np.where(which, 1 / np.maximum(price, 1e-300), 0.0), size[:, own])
                if change is not None:
                    fits = (gains[own] >= change.T)[:, below & which].all(axis=1)
                    more[own[fits]] = ((price @ change) * LOOSE)[fits]
                    todo[own[fits]] = False
        if todo.any():
            raise Undecided(INEQUALITY, "nothing is known of the start, and the readings do not show it well enough")
        return self.found(columns, readings, doubt, more)

    @staticmethod
    def found(columns: Columns, readings: Array, doubt: Array, more: Array) -> RowBound:
        """What the questions come to where gains that leave nothing cost so much more."""
        k = len(more)
        least = readings[:k] - doubt[:k] + columns.least[:k] + columns.noise[:k] / LOOSE**2 - more
        return RowBound(readings[:k] + doubt[:k] + more, least, 0 * more, columns.disturbance[:k], columns.noise[:k])


def changes(rows: Array, wrong: Array, weight: Array, size: Array) -> Array | None:
    """Return bounds (R, k) on changes of gains that leave nothing of rests |rest| <= size (n, k); None where none are.

    rows (n, R) are known up to `wrong`; where a weight is 0 a gain stays.
    """
    back = weight[:, None] * np.linalg.pinv(rows * weight) if weight.any() else np.zeros((rows.shape[1], len(rows)))
    left = np.abs(np.eye(len(rows)) - rows @ back) + (len(weight) + 4) * EPS * (np.abs(rows) @ np.abs(back))
    left += wrong @ np.abs(back)
    norm = float(np.linalg.norm(left, np.inf)) * LOOSE
    if not norm < HALF:
        return None
    return np.asarray(np.abs(back) @ size + np.abs(back).sum(axis=1)[:, None] * (norm / (1 - norm)) * size.max(axis=0))


def flows(a: Array, d: float, panels: int) -> tuple[Array, Array, Array, Array]:
    """e^{a k d} for k = 0 to `panels`, a power of two, and int_0^d e^{a s} ds, |a d| <= 1/128; with error bounds."""
    n, M = len(a), a * d
    term = total = around = size = np.eye(n)
    mean, mean_size = np.eye(n), np.eye(n)
    for k in range(1, TERMS):
        term, size = term @ M / k, size @ np.abs(M) / k
        total, around = total + term, around + size
        mean, mean_size = mean + term / (k + 1), mean_size + size / (k + 1)
    E, wrong = np.empty((panels + 1, n, n)), np.zeros((panels + 1, n, n))
    E[0], E[1], wrong[1] = np.eye(n), total, 4 * (n + TERMS) * EPS * around * LOOSE + 1e-30
    known = 1
    while known < panels:
        first, lost, more, less = E[known], wrong[known], E[1 : known + 1], wrong[1 : known + 1]
        sizes = np.abs(first)
        E[known + 1 : 2 * known + 1] = first @ more
        made = sizes @ less + lost @ (np.abs(more) + less) + (n + 2) * EPS * (sizes @ np.abs(more))
        wrong[known + 1 : 2 * known + 1] = made * LOOSE
        known *= 2
    return E, wrong, mean * d, (4 * (n + TERMS) * EPS * mean_size * LOOSE + 1e-30) * d


CLAIM = Claim(INTERVAL, of_interval, prove)
