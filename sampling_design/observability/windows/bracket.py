"""The search behind `window_sigma`: every piece of window positions is bounded, then halved until closed.

On a piece O(s) = O(b) e^{A(b-s)}, so that 1/sigma(s) = |F(s)| with F(s) = e^{-A(b-s)} O(b)^+ and F'' = A^2 F.
An upper bound on a norm is what follows, and norms are convex.

Where states count in units far apart, rounding that is small in one is large in another. Then x = D z, D powers of two
that balance A and C, and 1/sigma = |D F_z|: exponentials round in z alone, and |D A_z^4 F_z| <= |D| |A_z^4| |F_z|.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.numerics.linalg import right_directions
from sampling_design.observability.windows.pieces import WindowPieces, WindowWitness
from sampling_design.observability.windows.timing import least_observed, rows_of_any_time
from sampling_design.plants.clusters import balanced_schur
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Integers, Mask
from sampling_design.records.budget import Budget, Progress

# relative error granted to C e^{A tau}, of |C||e^{A tau}|, for tau |A| up to 200 and in proportion beyond;
# the tests of the exponentials hold them to it against 50-digit arithmetic
ALLOWANCE = 1e-12
_FIRST_CUTS = 4  # intervals per piece to begin with: enough for a picture; one where less was found elsewhere
_MOST_NODES = 2_000_000  # evaluations after which a search without a budget ends as well
_CHUNK = 2_000_000  # numbers per batch, so that long windows with many samples fit into memory
LARGEST = 1e130  # of entries of A^2, C and e^{A T}: products of them are still numbers
_EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class WindowBracket:
    """What the search found, in window starts; `status` as in `WindowSigma`, `growth` of a state by itself."""

    lower: float
    status: str
    witness: WindowWitness
    pieces: WindowPieces
    nodes: Array
    sigma: Array
    owner: Integers
    piece_lower: Array
    growth: float = 1.0
    shares: Array | None = None  # as of `least_observed`, at the witness


def require_moderate(plant: Plant) -> None:
    """Raise if products of the plant's entries are no numbers.

    Raises ArgumentError if the largest entry of A, squared, or of C leaves the range.
    """
    for name, matrix, most in (("A", plant.A, np.sqrt(LARGEST)), ("C", plant.C, LARGEST)):
        largest = float(np.max(np.abs(matrix), initial=0.0))
        if largest > most:
            raise ArgumentError(
                f"`plant` must have entries of {name} up to {most:.0e} here, got {largest:.3g}. Give it in other units."
            )


class _PieceRows:
    """The pseudo-inverse of each piece at its right end, F, carried to any other position; in states z, x = D z.

    Only F's singular vectors are held: of hundreds of states they are most of what a search takes.
    """

    def __init__(self, plant: Plant, pieces: WindowPieces, D: Array | None = None) -> None:
        self.balanced, n = D is not None, plant.n_states
        self.D = np.ones(n) if D is None else D
        plant = plant if D is None else Plant(plant.A * D / D[:, None], plant.C * D)
        self.plant, self.pieces = plant, pieces
        self.A2 = plant.A @ plant.A
        self.fourth = float(np.linalg.norm(self.A2 @ self.A2, 2))
        half = (plant.A + plant.A.T) / 2
        growth = np.linalg.eigvalsh(half)
        self.forward, self.backward = max(0.0, float(growth[-1])), max(0.0, -float(growth[0]))
        singular, self.right, size, self.growth = self._references()
        self.zero = singular[:, -1] <= n * _EPS * singular[:, 0]
        safe = np.where(self.zero, 1.0, singular[:, -1])
        self.spread = np.where(self.zero[:, None], 1.0, singular)
        self.singular = np.where(self.zero[:, None], 0.0, singular)
        span = float(np.max(pieces.right - pieces.left)) + float(np.ptp(pieces.times)) if len(pieces.times) else 0.0
        self.grade = ALLOWANCE * max(1.0, float(np.linalg.norm(plant.A, 1)) * span / 200)
        self.kept = np.maximum(0.0, 1 - 3 * self.grade * size / safe)

    def _references(self) -> tuple[Array, Array, Array, float]:
        """Singular values, right vectors, rounding size of each O at its piece's right end; the largest |e^{A tau}|."""
        pieces, n, p = self.pieces, self.plant.n_states, self.plant.n_outputs
        count = pieces.stop - pieces.first
        most = max(1, -(-n // p), int(count.max(initial=0)))
        singular, right, size = np.zeros((len(pieces), n)), np.zeros((len(pieces), n, n)), np.zeros(len(pieces))
        growth = 1.0
        step = max(1, _CHUNK // (most * n * max(n, p)))
        for low in range(0, len(pieces), step):
            part = slice(low, low + step)
            index = pieces.first[part, None] + np.arange(most)
            there = index < pieces.stop[part, None]
            index = np.where(there, index, 0)
            tau = (
                np.where(there, pieces.times[index] - pieces.right[part, None], 0.0)
                if len(pieces.times)
                else there * 0.0
            )
            with np.errstate(over="ignore", invalid="ignore"):
                flow = self.plant.transition(tau.ravel()).reshape(*tau.shape, n, n)
            if not np.max(np.abs(flow), initial=0.0) < LARGEST:
                raise ArgumentError(
                    f"`window` must be short enough for e^(A T) to be a number, and its square, got {pieces.window!r}: "
                    "its unstable modes overflow. Refer sigma to a shorter window."
                )
            # of the diagonal, which no unit of a state changes
            own = np.abs(np.diagonal(flow, axis1=-2, axis2=-1)).max(axis=-1, initial=0.0)
            growth = max(growth, float(np.max(np.where(there, own, 0.0), initial=0.0)))
            weight = there[..., None] & (True if pieces.mask is None else pieces.mask[index])
            rows = np.where(weight[..., None], self.plant.C @ flow, 0.0)
            if late := pieces.timing_tolerance:
                stacked = rows_of_any_time(rows, self.plant.A, late.radii)
            else:
                stacked = np.asarray(np.linalg.qr(rows.reshape(len(tau), -1, n), mode="r"))
            singular[part], right[part] = right_directions(stacked)
            # no square of an entry of C/c or flow/f overflows, nor do all underflow
            c, f = (np.abs(each).max(initial=np.finfo(float).tiny) for each in (self.plant.C, flow))
            squares = np.sum(np.where(weight, np.sum((self.plant.C / c) ** 2, axis=1), 0.0), axis=-1)
            size[part] = c * f * np.sqrt(np.sum(squares * np.sum((flow / f) ** 2, axis=(-1, -2)), axis=-1))
        return singular, right, size, growth

    def at(self, owner: Integers, start: Array) -> tuple[Array, Array, Array]:
        """|D F| = 1/sigma, and upper bounds on |D A^2 F| and on |F|, at window starts on the pieces `owner`."""
        value, second, plain = np.empty((3, start.size))
        for part in self._parts(start.size):
            with np.errstate(over="ignore", invalid="ignore"):
                flow = self.plant.transition(start[part] - self.pieces.right[owner[part]])
                held = np.swapaxes(self.right[owner[part]], 1, 2) / self.spread[owner[part], None]
                F = flow @ held
                sound = np.isfinite(F).all(axis=(1, 2)) & ~self.zero[owner[part]]
                F = np.where(sound[:, None, None], F, 0.0)
                D = self.D[:, None]
                value[part] = np.where(sound, np.linalg.norm(D * F, 2, axis=(1, 2)), np.inf)
                second[part] = np.where(sound, np.linalg.norm(D * (self.A2 @ F), axis=(1, 2)), np.inf)
                plain[part] = np.where(sound, np.linalg.norm(F, axis=(1, 2)), np.inf)
                if self.balanced:  # what of it is rounding
                    terms = np.linalg.norm(flow, axis=(1, 2)) * np.linalg.norm(held, axis=(1, 2))
                    value[part] += self.grade * self.D.max() * terms
                    second[part] += self.grade * np.linalg.norm(D * self.A2) * terms
        return value, second, plain

    def below_rounding(self, owner: Integers, start: Array, value: Array) -> Mask:
        """Where sigma = 1/value lies below n eps |O(s)|."""
        size = np.empty(start.size)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            for part in self._parts(start.size):
                O = self.singular[owner[part], :, None] * self.right[owner[part]]
                back = O @ self.plant.transition(self.pieces.right[owner[part]] - start[part])
                largest = np.abs(back).max(axis=(1, 2), initial=np.finfo(float).tiny)  # its square may overflow
                size[part] = np.linalg.norm(back / largest[:, None, None], axis=(1, 2)) * largest
            return np.asarray(self.plant.n_states * _EPS * size >= 1 / value)

    def _parts(self, count: int) -> Iterator[slice]:
        """Yield slices of so many window starts that are looked at together."""
        step = max(1, _CHUNK // self.plant.n_states**2)
        yield from (slice(low, low + step) for low in range(0, count, step))

    def ceiling(self, h: Array, ends: tuple[Array, ...]) -> Array:
        """Proven upper bound on |D F| over intervals of length h with what `at` says of a and of b."""
        fa, fb, ga, gb, pa, pb = ends
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            q = h * h / 8
            slack = 1 - q * q * self.fourth
            # |F| grows from either end at most by the logarithmic norm: highest where the two bounds cross
            total = max(self.forward + self.backward, 1e-300)
            a, b = (pa, pb) if self.balanced else (fa, fb)
            x = np.clip((np.log(b / a) + self.backward * h) / total, 0.0, h)
            first = np.minimum(a * np.exp(self.forward * x), b * np.exp(self.backward * (h - x)))
            # |F| <= chord + q sup|A^2 F|, and the same for A^2 F with |A^4 F| <= |A^4| |F|
            chord = np.maximum(fa, fb) + q * np.maximum(ga, gb)
            if self.balanced:
                return np.asarray(np.nan_to_num(chord + q * q * self.D.max() * self.fourth * first, nan=np.inf))
            second = np.where(slack > 0, chord / slack, np.inf)
        found = np.fmin(second, first)
        return np.where(np.isnan(found), np.inf, found)  # inf - inf: nothing is bounded there


class _BracketSearch:
    """Open intervals, all nodes so far, and the least proven bound of the closed ones."""

    def __init__(self, pieced: _PieceRows, rtol: float, reached: float) -> None:
        self.pieced, self.rtol = pieced, rtol
        left, right = pieced.pieces.left, pieced.pieces.right
        cuts = _FIRST_CUTS if reached == np.inf else 1
        owner = np.repeat(np.arange(left.size), cuts + 1)
        part = np.tile(np.arange(cuts + 1) / cuts, left.size)
        start = np.clip(left[owner] + part * (right - left)[owner], left[owner], right[owner])
        start[part == 1] = right
        value, second, plain = pieced.at(owner, start)
        self.nodes, self.values, self.owners = [start], [value], [owner]
        self.zero = pieced.below_rounding(owner, start, plain if pieced.balanced else value)
        inner = np.flatnonzero(part < 1)
        self.owner, self.a, self.b = owner[inner], start[inner], start[inner + 1]
        self.ends = tuple(each[at] for each in (value, second, plain) for at in (inner, inner + 1))
        self.piece_lower = np.full(left.size, np.inf)
        with np.errstate(divide="ignore"):
            self.top = max(float(value.max()), float(1 / np.float64(reached)))
        self.total, self.evaluations = float(np.sum(right - left)), start.size

    def close(self) -> None:
        """Take out the intervals whose bound is good enough for the bracket."""
        ceiling = self.pieced.ceiling(self.b - self.a, self.ends)
        lower = self.pieced.kept[self.owner] / ceiling
        middle = (self.a + self.b) / 2
        done = (lower >= (1 - 0.99 * self.rtol) / self.top) | (middle <= self.a) | (middle >= self.b)
        # nothing to gain by halving: only the allowance for rounding keeps such an interval open
        done |= ceiling <= (1 + 0.1 * self.rtol) * np.maximum(self.ends[0], self.ends[1])
        np.minimum.at(self.piece_lower, self.owner[done], lower[done])
        self.lower_open = lower[~done]
        self.owner, self.a, self.b = self.owner[~done], self.a[~done], self.b[~done]
        self.ends = tuple(each[~done] for each in self.ends)

    def halve(self) -> None:
        """Evaluate the middle of every open interval and cut there."""
        middle = (self.a + self.b) / 2
        between = self.pieced.at(self.owner, middle)
        f = between[0]
        self.nodes.append(middle)
        self.values.append(f)
        self.owners.append(self.owner)
        self.top, self.evaluations = max(self.top, float(f.max())), self.evaluations + middle.size
        self.a, self.b = np.concatenate([self.a, middle]), np.concatenate([middle, self.b])
        pairs = ((self.ends[2 * k], self.ends[2 * k + 1], inner) for k, inner in enumerate(between))
        self.ends = tuple(np.concatenate(half) for a, b, inner in pairs for half in ((a, inner), (inner, b)))
        self.owner = np.concatenate([self.owner, self.owner])

    def run(self, seconds: float, progress: Progress | None) -> str:
        """Halve until nothing is open or the budget is spent; an interrupt leaves what was proven before its step."""
        budget, status = Budget(seconds), ""
        self.close()
        while self.owner.size and not status:
            if budget.over or self.evaluations > _MOST_NODES:
                status = "budget"
                break
            before = {name: copy(value) for name, value in vars(self).items()}
            try:
                self.halve()
                self.close()
                if progress is not None:
                    open_part = float(np.sum(self.b - self.a)) / max(self.total, 1e-300)
                    progress(1 - open_part, f"sigma over windows: {self.owner.size} intervals open")
            except KeyboardInterrupt:
                vars(self).update(before)
                status = "interrupted"
        np.minimum.at(self.piece_lower, self.owner, self.lower_open)
        return status or "closed"


def bracket_sigma(
    plant: Plant,
    pieces: WindowPieces,
    rtol: float,
    seconds: float,
    progress: Progress | None,
    reached: float = np.inf,
    counted: int | None = None,
) -> WindowBracket:
    """Bracket the least sigma over all pieces; `seconds` may be infinite.

    Where a sigma was `reached` elsewhere, what is certainly not below it is not looked at closely. Where only the first
    `counted` states count, what is attained is of these, and what is proven of all, which is no more.
    """
    if plant.n_states == 0:
        return _nothing_to_see(pieces)
    require_moderate(plant)
    whole = Budget(seconds)
    counted = plant.n_states if counted is None else counted
    found = _searched(plant, pieces, rtol, seconds, progress, reached, counted)
    hidden = found.status in ("rounding", "below rounding")
    D = balanced_schur(plant.A, plant.C).d if hidden else np.ones(1)
    if np.ptp(D) == 0:
        return found
    other = _searched(plant, pieces, rtol, max(seconds - whole.spent, 0.0), progress, reached, counted, D)
    if other.lower <= found.lower:
        return found
    return replace(other, witness=found.witness) if found.witness.sigma <= other.witness.sigma else other


def _searched(
    plant: Plant,
    pieces: WindowPieces,
    rtol: float,
    seconds: float,
    progress: Progress | None,
    reached: float,
    counted: int,
    D: Array | None = None,
) -> WindowBracket:
    """The bracket from one search, in states z where x = D z."""
    short = too_few(pieces, plant.n_states, plant.n_outputs)
    search = _BracketSearch(_PieceRows(plant, pieces, D), rtol, reached)
    if short is not None:
        status, g, start = "too few samples", short, (pieces.left[short] + pieces.right[short]) / 2
    elif search.zero.any():
        i = int(np.argmax(np.where(search.zero, search.values[0], -1.0)))
        status, g, start = "below rounding", int(search.owners[0][i]), float(search.nodes[0][i])
    else:
        status = search.run(seconds, progress)
        values = np.concatenate(search.values)
        i = int(np.argmax(values))
        g, start = int(np.concatenate(search.owners)[i]), float(np.concatenate(search.nodes)[i])
    if status in ("too few samples", "below rounding"):
        search.close()
        np.minimum.at(search.piece_lower, search.owner, search.lower_open)
    return _bracket(plant, search, status, g, start, reached, counted)


def _bracket(
    plant: Plant, search: _BracketSearch, status: str, g: int, start: float, reached: float, counted: int
) -> WindowBracket:
    """The result, with the witness evaluated afresh from its own rows."""
    pieces = search.pieced.pieces
    counted = plant.n_states if status in ("too few samples", "below rounding") else counted  # of what is hidden, all
    direction, upper, shares = least_observed(_rows(plant, pieces, g, start), counted)
    lower = min(float(search.piece_lower.min()), upper)
    if status in ("too few samples", "below rounding"):
        lower = 0.0
    elif status == "closed" and lower < (1 - search.rtol) * min(upper, reached):
        status = "rounding"
    owner, nodes = np.concatenate(search.owners), np.concatenate(search.nodes)
    order = np.lexsort((nodes, owner))
    with np.errstate(divide="ignore"):
        sigma = 1 / np.concatenate(search.values)
    return WindowBracket(
        lower=lower, status=status, witness=pieces.witness(g, start, direction, upper), pieces=pieces,
        nodes=nodes[order], sigma=sigma[order], owner=owner[order], piece_lower=search.piece_lower,
        growth=search.pieced.growth, shares=shares,
    )  # fmt: skip


def _rows(plant: Plant, pieces: WindowPieces, g: int, start: float) -> Array:
    """Rows C e^{A(tau - start)} of the samples on piece g."""
    rows = plant.C @ plant.transition(pieces.samples(g) - start)
    mask = pieces.measured(g)
    return rows.reshape(-1, plant.n_states) if mask is None else rows[mask]


def too_few(pieces: WindowPieces, states: int, outputs: int) -> int | None:
    """The piece with fewest measurements, where these are fewer than the states."""
    if pieces.mask is None:
        count = outputs * (pieces.stop - pieces.first)
    else:
        total = np.concatenate([[0], np.cumsum(pieces.mask.sum(axis=1))])
        count = total[pieces.stop] - total[pieces.first]
    g = int(np.argmin(count))
    return g if count[g] < states else None


def _nothing_to_see(pieces: WindowPieces) -> WindowBracket:
    """A plant without states: sigma is the least over no direction, infinity."""
    infinite = np.full(len(pieces), np.inf)
    owner = np.arange(len(pieces))
    return WindowBracket(
        lower=np.inf, status="no states", witness=pieces.witness(0, float(pieces.left[0]), np.zeros(0), np.inf),
        pieces=pieces, nodes=pieces.left, sigma=infinite, owner=owner, piece_lower=infinite,
    )  # fmt: skip
