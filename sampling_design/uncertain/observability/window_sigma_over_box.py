"""Sigma over every real position of a sliding window and every plant of a box of constant parameters.

Its lower bound may be proven in ball arithmetic (extra `rigorous`): as in `box/branching.py`, cell by cell, with
everything in it a ball, rows and their derivatives from one exponential, the rest in metrics of `box/balls.py`. With
O(d) = O_0 + sum d_k O_k + X, |X z|^2 <= rest z'Wz, and a window that begins s after the cell's middle, |s| <= h,

    |O(d) z|^2   >=  z'((1 - t)(O_0'O_0 + sum d_k (O_0'O_k + O_k'O_0)) - (1/t - 1) rest W) z,
    |e^{A(d) s} z|  <=  max of |(I +- A h) z|  +  beyond |z|_W,

so that corners of d and both signs decide, by the pivots of L D L' of one matrix each.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import partial
from itertools import product

import numpy as np

from sampling_design.numerics.balls import Ball, Matrix, ball, definite, floats, identity, matrix, rational, stacked
from sampling_design.numerics.branch_and_bound import all_proven
from sampling_design.numerics.linalg import symmetrise
from sampling_design.observability.alignment import align
from sampling_design.observability.sigma_bracket import (
    NO_STATES,
    ProvenSigma,
    SigmaBracket,
    coordinates_of,
    in_balls,
    uninterrupted,
)
from sampling_design.observability.windows.balls import exact_times, nearest_proven, needed_slack, piece_ends
from sampling_design.observability.windows.bracket import require_moderate
from sampling_design.observability.windows.pieces import WindowPieces
from sampling_design.observability.windows.window_record import checked_pieces
from sampling_design.observability.windows.window_sigma import left_of_sigma
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.budget import Budget, Progress
from sampling_design.records.record import Claim, above, below, short
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule
from sampling_design.uncertain.box.balls import BallBox, BallCell
from sampling_design.uncertain.box.branching import (
    BALL_ROOM,
    REASONS,
    TOGETHER,
    UNOBSERVABLE,
    BoxBounds,
    branch,
    halved,
    least_sigma,
)
from sampling_design.uncertain.box.model import BoxCells, BoxModel, CellNorms, at_parameters
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant

RTOL = 0.01  # default width of the bracket, relative
WIDER = 2.5  # times that: brackets of what late and lost samples leave, which say how steep the ground is
BESIDE, LEAST_BESIDE = 10.0, 1.0  # times what the bracket took, of so many seconds: what late and lost samples may take


@dataclass(frozen=True, eq=False, repr=False)
class WindowSigmaOverBox(SigmaBracket):
    """Bounds on the least sigma over all real positions of a window and all plants of a box.

    Attributes
    ----------
    lower : float
        Proven for every plant of the box and every real position.
    upper : float
        Attained by the plant `worst` in the window that begins at `window_start`.
    worst : mapping
        Values of the parameters.
    window_start : float [time]
    samples : (k,) array [time]
        In that window.
    status : str
        "closed", "unobservable" (the plant `worst` is not seen, as nearly as a descent can tell), "too few samples",
        "budget", "rounding" or "no states".
    cells : int
        How many cells of parameters and positions were judged.
    from_time : float [time]
        As for `WindowSigma`: every window that begins then or later is covered.
    coordinates : str
        Which both bounds refer to: "scaled" where the plant has scales, else "physical".
    rigorous : bool
        Whether `lower` was proven in ball arithmetic: a theorem about the doubles of plant, parameters and times.
    slack : float [time]
        With `rigorous`: as for `WindowSigma`, zero unless samples leave and arrive within rounding of each other.
    """

    worst: Mapping[str, float]
    window_start: float
    samples: Array
    window: float
    cells: int
    plant: UncertainPlant
    from_time: float = field(default=0.0, kw_only=True)
    slack: float = field(default=0.0, kw_only=True)

    _answers = (
        "the least sigma of every plant of a box, over every window of {window} {time_unit} along a schedule, from "
        "{from_time} {time_unit} on",
        "{_grounds}",
        SigmaBracket._good,
        SigmaBracket._balls.format(at="the plant `.worst`"),
    )
    _table = {
        "worst plant": "{worst:or the nominal plant}",
        "worst window begins": "{window_start} {time_unit}",
        "samples in it": "{samples.size}",
        "status": "{status}, {cells} cells",
    }
    _plain = (
        "lower upper worst window_start samples closed status window from_time rtol cells rigorous slack time_unit "
        "coordinates deviations claim"
    )

    @property
    def time_unit(self) -> str:
        """Unit of all times."""
        return self.plant.time_unit

    @property
    def sees_every_plant(self) -> bool | None:
        """Whether every plant of the box is seen in every window: proven, refuted by `worst`, or None (not decided)."""
        if self.lower > 0:
            return True
        return False if self.status in ("unobservable", "too few samples") else None

    @property
    def claim(self) -> Claim:
        """What `lower` claims, and on what grounds."""
        balls = ", in ball arithmetic" if self.rigorous else ""
        return Claim(
            f"sigma_n(O_s e^(-A(t-T))) >= {below(self.lower)} for every plant of the box and every real window end "
            f"t >= T + {short(self.from_time)}, T = {short(self.window)}",
            theorem="Theorem 14, hypothesis, for each plant of the box" + balls,
            assumptions=("constant parameters in their ranges", "the sample times are exact"),
        )

    def explain(self) -> str:
        """Say what was proven, and which plant is worst."""
        where = f"The worst plant has {at_parameters(self.worst)}, in the window from {short(self.window_start)}"
        if self.status == "no states":
            return NO_STATES
        if self.status == "too few samples":
            return f"{where}: {self.samples.size} samples are too few, and sigma is 0."
        if self.status == "unobservable":
            return (
                f"Not every plant of the box is observable: {where[0].lower()}{where[1:]} sigma is {above(self.upper)}."
            )
        length = f"{short(self.window)} {self.time_unit}"
        proven = f"Sigma is at least {below(self.lower)} for every plant of the box, over every window of {length}"
        return self._concluded(f"{proven} ({self._grounds})", where, REASONS)


def window_sigma_over_box(
    plant: UncertainPlant,
    schedule: Schedule | PeriodicSchedule,
    window: float,
    rtol: float | None = None,
    budget: float | None = None,
    progress: Progress | None = None,
    rigorous: bool = False,
    start: float | None = None,
) -> WindowSigmaOverBox:
    """Bound sigma over all positions of a window and all plants of a box: see `window_sigma`."""
    aligned = align(plant.nominal, schedule)
    pieces, tolerance, seconds = checked_pieces(aligned, window, start, RTOL if rtol is None else rtol, budget)
    require_moderate(plant.nominal)
    model, clock = BoxModel.of(plant, "window_sigma", pieces.window), Budget(seconds)
    best = _searched(WindowsOverBox(model, pieces), tolerance, seconds, progress)
    found = WindowSigmaOverBox(
        lower=best.lower, upper=best.upper, worst=model.values(best.u), window_start=best.s,
        samples=pieces.samples(best.piece), status=best.status, window=pieces.window, rtol=tolerance, cells=best.cells,
        plant=plant, from_time=pieces.start, coordinates=coordinates_of(plant.nominal),
    )  # fmt: skip
    left = min(clock.left, BESIDE * max(clock.spent, LEAST_BESIDE))
    if rigorous:
        proof = prove_over_box(WindowsOverBox(model, pieces), aligned, found.lower, seconds)
        found = replace(in_balls(found, proof, BALL_ROOM), slack=proof.slack)
    wide = min(WIDER * tolerance, 0.5)
    least, lost = partial(_least, model, wide), partial(_lost, model, wide, len(aligned))
    beside = partial(
        left_of_sigma, aligned, window, least, lost, plant.time_unit, sigma=found.lower, start=start, seconds=left
    )
    return replace(found, beside=beside)


def _least(model: BoxModel, rtol: float, pieces: WindowPieces, seconds: float, _: float) -> tuple[float, float]:
    """Proven sigma of pieces for all real times within their tolerance, and the least such bound of one plant."""
    found = uninterrupted(_searched(WindowsOverBox(model, pieces), rtol, seconds, None))
    return found.lower, found.upper


def _lost(model: BoxModel, rtol: float, samples: int, pieces: WindowPieces, limit: Budget) -> tuple[float, int]:
    """Proven sigma if any one sample is lost, and whose loss leaves what is attained: all in one search."""
    asked = WindowsOverBox(model, pieces, losing=True)
    found = uninterrupted(_searched(asked, rtol, limit.left, None))
    return found.lower, int(asked.lost[found.piece]) % samples


def _searched(asked: WindowsOverBox, rtol: float, seconds: float, progress: Progress | None) -> BoxBounds:
    """The bracket over the box and all pieces."""
    model, pieces = asked.model, asked.pieces
    if not model.n:
        return BoxBounds(np.inf, np.inf, model.start, float(pieces.left[0]), 0, "no states", 0)
    few = asked.too_few()
    if few is not None:
        return BoxBounds(0.0, 0.0, model.start, float(pieces.left[few]), few, "too few samples", 0)
    ends = (pieces.left, pieces.right)
    value = None if pieces.timing_tolerance else asked.value
    return branch(asked.cells(), asked.judge, value, asked.unobservable, rtol, seconds, ends, progress)


class WindowsOverBox:
    """Sigma of the windows of one schedule, for cells of a box."""

    def __init__(
        self, model: BoxModel, pieces: WindowPieces, *, losing: bool = False, unobservable_share: float = UNOBSERVABLE
    ) -> None:
        """With `losing` every piece once for each of its samples, without that: of the number `lost`."""
        copies = np.maximum(pieces.stop - pieces.first, 0) if losing else np.ones(len(pieces), dtype=np.intp)
        piece = np.repeat(np.arange(len(pieces)), copies)
        self.lost = pieces.first[piece] + np.arange(piece.size) - np.repeat(np.cumsum(copies) - copies, copies)
        if losing:
            left, right, first, stop = pieces.left[piece], pieces.right[piece], pieces.first[piece], pieces.stop[piece]
            pieces = replace(pieces, left=left, right=right, first=first, stop=stop)
        self.model, self.pieces, self.unobservable_share = model, pieces, unobservable_share
        self.times, self.measured = _padded(pieces, len(model.C))
        if losing:
            self.measured[np.arange(len(pieces)), self.lost - pieces.first] = False

    def too_few(self) -> int | None:
        """A piece with fewer measurements than states."""
        few = np.flatnonzero(self.measured.sum(axis=(1, 2)) < self.model.n)
        return int(few[0]) if few.size else None

    def cells(self) -> BoxCells:
        """The whole box, once for each piece."""
        pieces, count = self.pieces, len(self.pieces)
        box = np.zeros((count, self.model.m))
        half = (pieces.right - pieces.left) / 2 + pieces.tolerance
        return BoxCells(box, box + 1, (pieces.left + pieces.right) / 2, half, np.arange(count))

    def judge(self, cells: BoxCells) -> tuple[Array, Array, Array]:
        """Lower bounds, values at the centres, and what each direction matters; for all times that pieces allow."""
        piece, late = cells.piece, self.pieces.timing_tolerance.radius
        times = self.times[piece] - cells.s[:, None]
        return least_sigma(self.model, cells, times, self.measured[piece], late)

    def value(self, u: Array, s: float, piece: int) -> float:
        """Sigma of one plant and window."""
        return float(np.linalg.svd(self._rows(u, s, piece) / self.model.unit, compute_uv=False)[self.model.n - 1])

    def unobservable(self, u: Array, s: float, piece: int) -> bool:
        """Whether one plant has a direction that its window does not show, in whatever units."""
        least = np.linalg.svd(self._rows(u, s, piece), compute_uv=False)[self.model.n - 1]
        return bool(least <= self.unobservable_share * np.linalg.norm(self.model.C))

    def _rows(self, u: Array, s: float, piece: int) -> Array:
        """The rows of one plant and window, in balanced coordinates."""
        plant, at = self.model.balanced_at(u), self.pieces.samples(piece) - s
        return np.asarray((plant.C @ plant.transition(at))[self.measured[piece][: at.size]])


def _padded(pieces: WindowPieces, outputs: int) -> tuple[Array, Mask]:
    """Sample times (P, N) of every piece and what is measured (P, N, p), filled up with what is not."""
    count = pieces.stop - pieces.first
    most = max(1, int(count.max(initial=0)))
    index = pieces.first[:, None] + np.arange(most)
    there = index < pieces.stop[:, None]
    if not len(pieces.times):
        return np.zeros(there.shape), np.zeros((*there.shape, outputs), dtype=bool)
    index = np.where(there, index, 0)
    mask = np.ones((len(pieces.times), outputs), dtype=bool) if pieces.mask is None else pieces.mask
    return pieces.times[index], there[..., None] & mask[index]


FALSE = 1e-9  # a plant this far below the claim, relative, ends the attempt
SMALLEST = 2.0**-40  # cells below this share of the box and of their piece are not halved further


def prove_over_box(
    over_box: WindowsOverBox, schedule: Schedule | PeriodicSchedule, guess: float, seconds: float
) -> ProvenSigma:
    """Prove a lower bound of sigma over a box and all real window positions: see `nearest_proven`.

    The floats of `over_box` choose the cells and prove nothing; the doubles of its schedule are what is proven.
    """
    exact = exact_times(schedule, over_box.pieces)
    slack = needed_slack(schedule, over_box.pieces, exact)
    return nearest_proven(
        guess, seconds, lambda clock: WindowCells(over_box, schedule, exact, clock).proves, slack=slack
    )


class WindowCells:
    """Cells of parameters and window starts; a start is a dyadic share of its piece, so that no cell is rounded."""

    def __init__(
        self, over_box: WindowsOverBox, schedule: Schedule | PeriodicSchedule, exact: list[Fraction], clock: Budget
    ) -> None:
        self.over_box, self.clock, self.box = over_box, clock, BallBox(over_box.model)
        pieces = over_box.pieces
        self.ends = [piece_ends(schedule, pieces, g) for g in range(len(pieces))]
        self.times = [exact[pieces.first[g] : pieces.stop[g]] for g in range(len(pieces))]
        self.signs = list(product((-1, 1), repeat=self.box.m))

    def proves(self, mu: float) -> bool:
        """Whether sigma >= mu is proven for all plants and positions."""
        pieces, m = self.over_box.pieces, self.box.m
        count = len(pieces)
        wide = np.array([float(right > left) for left, right in self.ends])
        whole = np.zeros((count, m))
        start = BoxCells(whole, whole + 1, np.zeros(count), wide, np.arange(count))

        def parts_of(some: BoxCells) -> list[BoxCells] | None:
            lower, centre, effect = self.over_box.judge(self._in_time(some))
            if np.any(centre < mu * (1 - FALSE)):
                return None
            open_ = np.array(
                [not (lower[k] >= mu and self._cell(some.take(np.array([k])), mu)) for k in range(len(lower))]
            )
            left = some.take(open_)
            if np.maximum(left.half.max(axis=1, initial=0.0), left.h).min(initial=np.inf) < SMALLEST:
                return None
            return halved(left, effect[open_]).split(TOGETHER)

        return all_proven(start.split(TOGETHER), parts_of, self.clock)

    def _in_time(self, cells: BoxCells) -> BoxCells:
        """The same with window starts in time, as floats."""
        pieces = self.over_box.pieces
        left, right = pieces.left[cells.piece], pieces.right[cells.piece]
        half = (right - left) / 2
        return cells._replace(s=(left + right) / 2 + half * cells.s, h=half * cells.h + pieces.tolerance)

    def _cell(self, one: BoxCells, mu: float) -> bool:
        """Whether sigma >= mu is proven on a cell."""
        self.clock.check()
        g = int(one.piece[0])
        left, right = self.ends[g]
        half = (right - left) / 2
        middle = left + half + half * Fraction(float(one.s[0]))
        h = rational(half * Fraction(float(one.h[0])))
        cell = self.box.cell(one.u[0], one.half[0])
        after = [rational(t - middle) for t in self.times[g]]
        G, slopes = self._gram(cell, self.times[g], middle, self.over_box.pieces.measured(g))
        eye = identity(self.box.n)
        moved = [self.box.unit * (eye + cell.A * h * sign) for sign in ((1, -1) if h > 0 else (1,))]
        starts = [X.transpose() * X for X in moved]
        found = [
            (float(_approximate_loss(floats(G), floats(W), rest)), W, norms, whole, rest)
            for W, norms, whole in self.box.metrics(cell, max([float(r) for r in after], default=0.0))
            for rest in [_rest(norms, after)]
        ]
        if not found:
            return False
        _, W, norms, whole, rest = min(found, key=lambda each: each[0])
        beyond = (whole * norms.turned(h)).upper()
        corners = [sum((S * sign for S, sign in zip(slopes, signs, strict=True)), G) for signs in self.signs]
        return _hold(corners, starts, (W, rest, beyond), ball(mu))

    def _gram(
        self, cell: BallCell, times: list[Fraction], middle: Fraction, mask: Mask | None
    ) -> tuple[Matrix, list[Matrix]]:
        """O_0'O_0 and O_0'O_k + O_k'O_0: rows [C, C_1, ..] e^{block r}, the block A with the A_k beside it."""
        n, m = self.box.n, self.box.m
        zero = matrix(np.zeros((n, n)))
        block = _beside([cell.A, *cell.parts_A])
        for k in range(1, m + 1):
            block += _beside([zero] * k + [cell.A] + [zero] * (m - k))
        B, rows = stacked(block), stacked(_beside([cell.C, *cell.parts_C]))
        total, at = matrix(np.zeros((len(block), len(block)))), middle
        flows: dict[Fraction, Matrix] = {}
        for i, t in enumerate(times):
            if t - at not in flows:
                flows[t - at] = (B * rational(t - at)).exp()
            rows, at = rows * flows[t - at], t
            seen = stacked([row for j, row in enumerate(rows.tolist()) if mask is None or mask[i, j]])
            total = total + seen.transpose() * seen
        upper = total.tolist()[:n]
        parts = [stacked([row[k * n : (k + 1) * n] for row in upper]) for k in range(m + 1)]
        return parts[0], [X + X.transpose() for X in parts[1:]]


def _beside(blocks: list[Matrix]) -> list[list[Ball]]:
    """The rows of matrices that stand side by side."""
    return [[x for part in row for x in part] for row in zip(*(M.tolist() for M in blocks), strict=True)]


def _rest(norms: CellNorms[Ball], after: list[Ball]) -> Ball:
    """At least |X z|^2 over z'Wz: what the rows of all samples are beyond the first order."""
    total = ball(0.0)
    for r in after:
        _, row = norms.rows(abs(r), norms.rate if r >= 0 else norms.size)
        total += row * row
    made: Ball = total.upper()
    return made


def _approximate_loss(G: Array, W: Array, rest: Ball) -> float:
    """How much the rest takes away, about."""
    try:
        return float(rest) * float(np.trace(np.linalg.solve(G, W)))
    except np.linalg.LinAlgError:
        return np.inf


def _hold(corners: list[Matrix], starts: list[Matrix], lost: tuple[Matrix, Ball, Ball], mu: Ball) -> bool:
    """Whether mu |e^{As} z| <= |O z| at every corner and both ends; floats choose how the losses are shared."""
    W, rest, beyond = lost
    metric, square = floats(W), (1 / mu) ** 2
    for M in corners:
        for S in starts:
            z = _worst(floats(M), floats(S))
            if z is None:
                return False
            seen, start, size = (float(z @ X @ z) for X in (floats(M), floats(S), metric))
            t = ball(float(np.clip(np.sqrt(float(rest) * size / seen), 1e-14, 0.5))) if rest > 0 else ball(0.0)
            form = M * (1 - t)
            if rest > 0:
                form = form - W * ((1 / t - 1) * rest)
            form = form * square
            if beyond > 0:
                k = ball(float(np.clip(float(beyond) * np.sqrt(size / start), 1e-14, 1e14)))
                form = form - S * (1 + k) - W * ((1 + 1 / k) * beyond * beyond)
            else:
                form = form - S
            if not definite(form):
                return False
    return True


def _worst(M: Array, S: Array) -> Array | None:
    """The z that S makes largest beside M, or None where M is not certainly positive."""
    try:
        root = np.linalg.inv(np.linalg.cholesky(symmetrise(M)))
    except np.linalg.LinAlgError:
        return None
    return np.asarray(root.T @ np.linalg.eigh(symmetrise(root @ S @ root.T))[1][:, -1])
