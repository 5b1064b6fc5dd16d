"""The rows C e^{A tau} of k samples, spaced, in one window, addressed by their slacks."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.numerics.linalg import product_quotient, smallest_singular
from sampling_design.numerics.modal_flow import exponential
from sampling_design.observability.windows.bracket import ALLOWANCE
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Integers
from sampling_design.schedules.jitter import ON_TIME, TimingTolerance
from sampling_design.schedules.spaced_windows import SpacedWindows

MOST_STATES = 12  # states up to which products in fractions are formed: a few thousand of them

ROUNDED_UP = 1 + 1e-9
"""By which a period, and with it a window, is lengthened: a longer one holds every schedule of a shorter one."""


def exact_period(plant: Plant) -> float | None:
    """Return an upper bound on P with e^{AP} = I exactly, at most 1e-9 above it; None where none is proven.

    Notes
    -----
    *Claim.* If A^3 = -c A with c > 0, the eigenvalues are 0 and +-i sqrt(c), without Jordan blocks, so that
    P = 2 pi/sqrt(c). *Method.* In fractions: doubles are fractions, nothing is rounded.
    """
    n = plant.n_states
    if not 0 < n <= MOST_STATES:
        return None
    A = [[Fraction(value) for value in row] for row in plant.A.tolist()]
    cube = _product(_product(A, A), A)
    at = next(((i, j) for i in range(n) for j in range(n) if A[i][j]), None)
    if at is None:
        return None
    i, j = at
    c = -cube[i][j] / A[i][j]
    if c <= 0 or any(cube[i][j] != -c * A[i][j] for i in range(n) for j in range(n)):
        return None
    period = 2 * math.pi / math.sqrt(float(c)) * ROUNDED_UP if 0 < float(c) < math.inf else math.inf
    return period if math.isfinite(period) else None


def within_periods(plant: Plant, family: SpacedWindows) -> SpacedWindows:
    """Return the family in the shortest window that is known to hold samples of all its phases.

    Notes
    -----
    *Claim.* With period P, the first sample can be moved into [0, P) and every gap be shortened by whole periods to
    less than spacing + P, at the same rows. So k P + (k - 1) spacing is long enough, whatever the window.
    """
    period = exact_period(plant)
    if period is None:
        return family
    enough = family.count * period + (family.count - 1) * family.spacing
    return replace(family, window=enough) if enough < family.window else family


def _product(A: list[list[Fraction]], B: list[list[Fraction]]) -> list[list[Fraction]]:
    columns = list(zip(*B, strict=True))
    return [[sum((a * b for a, b in zip(row, column, strict=True)), Fraction(0)) for column in columns] for row in A]


_EPS = float(np.finfo(float).eps)
_SURVEY = 128  # times at which the plant is looked at to choose coordinates; no bound rests on them
_PAIRED = 33  # times, of which each may follow each: where a rounding of A is looked at
_MARGIN = 8.0  # what the first order of rounding is taken times
_GOLDEN = (np.sqrt(5.0) - 1) / 2  # spreads those times evenly and in step with no oscillation
_LEAST_SLACK = 1e-9  # of the window, where samples move: more schedules than there are, so that cells have a width


class OutputGroup(NamedTuple):
    """Outputs that are read at one time, within `radius` of `lag` after what was planned.

    `C` (p, n) are their rows.
    """

    outputs: Integers
    C: Array
    lag: float
    radius: float

    def moves(self, cells: int) -> Array:
        """Even moves from the earliest time to the latest; one where there is nothing to move."""
        return self.radius * np.linspace(-1.0, 1.0, cells + 1) if self.radius else np.zeros(1)


def output_groups(C: Array, late: TimingTolerance) -> list[OutputGroup]:
    """The outputs that are read together: all, or where they fall apart each that moves, and those that do not."""
    each = np.arange(len(C))
    lags, radii = max(late.early) + (np.array(late.late) - late.early) / 2, late.radii
    if not late.apart:
        return [OutputGroup(each, C, float(lags[0]), float(radii[0]))]
    still = [each[radii == 0]] if np.any(radii == 0) else []
    return [OutputGroup(i, C[i], float(lags[i[0]]), float(radii[i[0]])) for i in (*still, *each[radii > 0][:, None])]


class SpacedRows:
    """A plant observed k times within [0, T], at least epsilon apart.

        tau_i = u_i + (i - 1) epsilon,    0 <= u_1 <= ... <= u_k <= S = T - (k - 1) epsilon

    These are times as they are planned, from when the earliest reading of a first sample may begin the window. Outputs
    of group g of sample i are read at tau_i + lag_g + e_gi with any |e_gi| <= radius_g; without a tolerance at tau_i.

    Raises ArgumentError if e^{A tau} overflows within the window.

    Parameters
    ----------
    plant : Plant
    window, spacing : float
        T and epsilon.
    count : int
        k.
    late : TimingTolerance
        How early or late the outputs may be read.

    Attributes
    ----------
    slack : float
        S; 0 where only one schedule is admissible.
    offsets : (k,) array
        (i - 1) epsilon.
    groups : list of OutputGroup
    middle : (p, n) array
        C e^{A lag}: what outputs show at the middle of their times.
    survey : (N p, n) array
        Rows over the whole window, weighted to the size of k samples.
    grade : float
        Relative error granted to C e^{A tau}, of |C||e^{A tau}|.
    astray : float, optional
        Where A and C were worked out in coordinates `within` which all is seen alike: what their own rounding may do to
        |C e^{A tau} z|. The error of entries is then granted entry by entry, since what is large is hardly seen there.
    """

    def __init__(
        self, plant: Plant, window: float, count: int, spacing: float, late: TimingTolerance = ON_TIME
    ) -> None:
        self.A, self.C, self.n, self.p = plant.A, plant.C, plant.n_states, plant.n_outputs
        self.plant, self.window, self.count, self.late = plant, window, count, late
        self.spacing, self.offsets = spacing, spacing * np.arange(count)
        self.groups, whole = output_groups(plant.C, late), window + late.span
        self.lags, self.moving = np.array([group.lag for group in self.groups]), bool(late)
        slack = window - float(self.offsets[-1])
        self.slack = slack if slack > 8 * _EPS * window else 0.0
        if self.moving and self.slack < _LEAST_SLACK * window:
            self.slack = _LEAST_SLACK * window
            self.window = float(self.offsets[-1]) + self.slack
        with np.errstate(over="ignore", invalid="ignore"):
            flow = plant.transition(whole * np.append((np.arange(_SURVEY) * _GOLDEN) % 1.0, 1.0))
            size = float(np.linalg.norm(self.C)) * float(np.max(np.linalg.norm(flow, axis=(1, 2)), initial=0.0))
        if not np.isfinite(size**4):
            raise ArgumentError(
                f"`family.window` = {window:.6g} is too long for this plant: e^(A t) overflows within it. "
                "Split off the fast unstable modes or use a shorter window."
            )
        self.survey = np.concatenate(self.C @ flow) * np.sqrt(count / (_SURVEY + 1))
        self.grade = ALLOWANCE * max(1.0, float(np.abs(self.A).sum(axis=0).max(initial=0.0)) * whole / 200)
        self.astray: float | None = None
        self.middle = self.at(np.zeros(1))[0] if self.moving else self.C

    def times(self, slacks: Array) -> Array:
        """Planned times (..., k) of slacks (..., k), within [0, T]."""
        return np.minimum(slacks + self.offsets, self.window)

    def readings(self, times: Array, moves: Array | float = 0.0) -> Array:
        """When each group is read (..., G), of planned times (...) and moves (..., G)."""
        return np.asarray(times[..., None] + self.lags + moves)

    def read(self, group: OutputGroup, times: Array) -> Array:
        """Rows of a group C e^{A t}, shape (*times.shape, p, n)."""
        rows = exponential(self.plant.A).rows(group.C, times.ravel())
        return rows.reshape(*times.shape, *group.C.shape)

    def at(self, times: Array, moves: Array | float = 0.0) -> Array:
        """Rows of planned times, shape (*times.shape, p, n), group by group."""
        when = self.readings(times, moves)
        rows = [self.read(group, when[..., g]) for g, group in enumerate(self.groups)]
        return rows[0] if len(rows) == 1 else np.concatenate(rows, axis=-2)

    def observed(self, slacks: Array, moves: Array | float = 0.0) -> Array:
        """The matrices O (B, k p, n) of schedules (B, k) and their moves (B, k, G)."""
        return self.at(self.times(slacks), moves).reshape(slacks.shape[0], -1, self.n)

    def moved(self, times: Array, cells: int) -> list[Array]:
        """For each group its rows at so many cells of its moves, (*times.shape, q, p, n)."""
        return [self.read(group, times[..., None] + group.lag + group.moves(cells)) for group in self.groups]

    def least_observed(self, moved: list[Array], directions: Array, cells: int) -> tuple[Array, Array]:
        """The least |C e^{At} x|^2 (..., D) of rows `moved`, for directions (D, n), and its moves (..., D, G)."""
        least, picked = [], []
        for group, rows in zip(self.groups, moved, strict=True):
            outputs = (rows.reshape(-1, self.n) @ directions.T).reshape(*rows.shape[:-1], len(directions))
            size = np.sum(outputs**2, axis=-2)
            best = np.argmin(size, axis=-2)
            least.append(np.take_along_axis(size, best[..., None, :], axis=-2)[..., 0, :])
            picked.append(group.moves(cells)[best])
        return np.asarray(sum(least[1:], start=least[0])), np.stack(picked, axis=-1)

    def grid(self, cells: int) -> tuple[Array, Array]:
        """Slacks j S/cells, and the times (k, cells + 1) that each sample can take there."""
        slacks = self.slack * np.arange(cells + 1) / cells
        return slacks, self.times(slacks[:, None]).T

    def coordinates(self, worst: Array | None = None, moves: Array | float = 0.0) -> tuple[Array, Array]:
        """Return L and its inverse, x = L z: a survey of the window, and the schedule `worst`, see all z alike.

        An unobservable direction is scaled as if it were seen n eps of the best seen one.
        """
        stacked = self.survey if worst is None else np.vstack([self.survey, self.observed(worst[None], moves)[0]])
        _, singular, right = np.linalg.svd(stacked, full_matrices=False)
        scale = np.maximum(singular, max(self.n * _EPS * float(singular[0]), 1e-300))
        return right.T / scale, scale[:, None] * right

    def within(self, inverse: Array) -> tuple[SpacedRows, Array] | None:
        """The same rows of z = R x, R triangular with |Rx| = |inverse x|, and R^-1; None where e^{At} overflows there.

        Worked out in doubled precision: what grows within the window and is seen well costs the others no digits.
        """
        R, eye = np.asarray(np.linalg.qr(inverse, mode="r")), np.eye(self.n)
        with np.errstate(over="ignore", invalid="ignore"):
            A, C, back = (product_quotient(P, Q, R) for P, Q in ((R, self.A), (self.C, eye), (eye, eye)))
            try:
                inner = SpacedRows(Plant(A, C), self.window, self.count, self.spacing, self.late)
            except ArgumentError:
                return None
        inner.astray = inner._turned_by(_EPS * (np.abs(A) + _EPS * np.linalg.cond(R) * np.abs(A).max(axis=1)[:, None]))
        return inner, back

    def _turned_by(self, error: Array) -> float:
        """How far C e^{At} z may be moved, |z| = 1, if entries of A are off by `error`: to first order, with a margin.

        By at most t C e^{A(t-s)} error e^{As} for some s.
        """
        whole = self.window + self.late.span
        times = np.linspace(0.0, whole, _PAIRED)
        flow = np.abs(self.plant.transition(times))
        seen = np.abs(self.C) @ flow if self.n else np.zeros((_PAIRED, self.p, 0))
        later = np.linalg.norm(error @ flow, axis=2)
        both = np.linalg.norm(np.einsum("apn,bn->abp", seen, later), axis=2)
        return _MARGIN * whole * float(both[np.add.outer(times, times) <= whole * (1 + 1e-9)].max())

    def blur(self, flow: Array) -> Array:
        """How far rounding can move |C e^{A tau} z|, |z| = 1, for each e^{A tau} of `flow` (N, n, n)."""
        if self.astray is None:
            return np.asarray(self.grade * float(np.linalg.norm(self.C)) * np.linalg.norm(flow, axis=(1, 2)))
        return np.asarray(self.grade * np.linalg.norm(np.abs(self.C) @ np.abs(flow), axis=(1, 2)) + self.astray)

    def rounding(self, slacks: Array, moves: Array | float = 0.0) -> float:
        """How far rounding in the exponentials can move sigma of one schedule (k,).

        No further than it moves rows of x. Where it moves those of z = R x by d, and they see every z by s |z| at
        least, the truth is within d/s of min |Oz|/|x|, since |Ox| >= s |z|; from there to what rows of x say is known.
        """
        of_x, found = self._blurred(slacks, moves), self.within(self.coordinates(slacks, moves)[1])
        if found is None or of_x == 0.0:
            return of_x
        inner, back = found
        seen = np.asarray(np.linalg.qr(inner.observed(slacks[None], moves)[0], mode="r"))
        least, sigma = (float(smallest_singular(r)) for r in (seen, self.observed(slacks[None], moves)[0]))
        if least <= 0.0 or len(seen) < self.n:
            return of_x
        of_z = 1 / float(np.linalg.norm(np.linalg.solve(seen.T, back.T), 2))
        return min(of_x, abs(sigma - of_z) + inner._blurred(slacks, moves) / least * of_z)

    def _blurred(self, slacks: Array, moves: Array | float) -> float:
        """How far it moves the rows of one schedule."""
        return float(np.linalg.norm(self.blur(self.plant.transition(self.readings(self.times(slacks), moves).ravel()))))

    def counts_as_zero(self, sigma: float, slacks: Array, moves: Array | float = 0.0) -> bool:
        """Whether sigma of this schedule cannot be distinguished from 0."""
        if sigma <= self.n * _EPS * float(np.linalg.norm(self.observed(slacks[None], moves))):
            return True
        return sigma <= self._blurred(slacks, moves) and sigma <= self.rounding(slacks, moves)
