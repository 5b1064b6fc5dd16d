"""A start of which nothing is known: gains must leave nothing of it, or it makes every bound infinite.

Responses that are bounded for all times before: they may have gone on for ever, within the bounds on w and noise.

x(t - s) = Re sum_m X_m c_m e^{-mu_m s},  w = Re sum_m W_m c_m e^{-mu_m s},  (mu_m - A) X_m = G W_m,  Re mu_m >= 0:
|C_i x(t - s)| <= sum_m |C_i X_m| |c_m|  and  |w_k(t - s)| <= sum_m |W_km| |c_m|  for all s >= 0
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sampling_design.accuracy.bounds import SignalBounds
from sampling_design.accuracy.undetectable import output_scales, unobservable_directions
from sampling_design.numerics.cone_table import ConeTable
from sampling_design.plants.clusters import eigenvalue_clusters
from sampling_design.plants.grouping import balanced_schur
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Complex, Mask

LASTS = 1e-12
"""Share of |A| below which a mode does not decay, and within which a direction is an eigenvector: rounding alone."""

AMONG = 1e-9
"""A state is that of a lasting response if what is left of it, balanced, is below this share of it: rounding alone."""


EVENED = 40
"""Rounds in which the steady disturbance that hides a mode best is sought; its largest ratio then is right to
percents, and what is attained is evaluated with it as it is."""


@dataclass(frozen=True, eq=False)
class LastingResponses:
    """All that modes which do not decay span, each with a disturbance at its own rate, or none, that hides it.

    Where nothing drives a mode, the states that are driven may make up for what outputs show of it.
    """

    scale: Array  # (n,): of the states; balances A
    modes: Complex  # (n, m): X in that scale
    # (p, m): what outputs show of each at most, in units of the least noise that a sample of the period bounds them by
    output_sizes: Array
    w_sizes: Array  # (q, m): W, in units of the bounds
    v_ball: bool  # whether the noise of a sample is bounded in the Euclidean norm
    w_ball: bool  # whether w is
    undriven: bool  # whether a mode is beyond the reach of w

    @classmethod
    def of(cls, plant: Plant, bounds: SignalBounds) -> LastingResponses:
        """Return those of a plant."""
        balance = balanced_schur(plant.A).d
        rate = float(np.linalg.norm(plant.A * balance / balance[:, None], 2))
        scale = output_scales(plant, 1 / rate if rate > 0 else 1.0)
        A, n = plant.A * scale / scale[:, None], plant.n_states
        G, C = plant.G * bounds.w / scale[:, None], plant.C * scale
        size, v, undriven = float(np.linalg.norm(A, 2)), bounds.v.min(axis=0), False
        modes = [np.zeros((n, 0), dtype=np.complex128)]
        steady = [np.zeros((bounds.w.size, 0), dtype=np.complex128)]
        for cluster in eigenvalue_clusters(A):
            value = complex(cluster.value)
            if value.real >= -LASTS * size:
                left, sizes, right = np.linalg.svd(value * np.eye(n) - A)
                none = sizes <= LASTS * n * size
                own = right[none].conj().T
                own[np.abs(own) < LASTS] = 0.0
                across = left[:, none].conj().T  # what is seen of the mode itself
                free = _null_space(across @ G, float(np.linalg.norm(G)))  # w that do not drive it
                undriven |= free.shape[1] > G.shape[1] - own.shape[1]
                moved = right[~none].conj().T @ (left[:, ~none].conj().T @ (G @ free) / sizes[~none, None])
                moved -= own @ np.linalg.lstsq(across @ own, across @ moved)[0]
                W = _steady(C @ own, C @ moved, free, bounds)
                modes.append(own + moved @ W)
                steady.append(free @ W)
        X, W = np.hstack(modes), np.hstack(steady)
        shown = np.abs(C @ X)
        shown[(v == 0)[:, None] & (shown <= LASTS * n * (np.abs(C) @ np.abs(X)))] = 0.0
        with np.errstate(divide="ignore"):
            output_sizes = np.divide(shown, v[:, None], out=np.zeros_like(shown), where=shown > 0)
        return cls(scale, X, output_sizes, np.abs(W), bounds.v_ball, bounds.w_ball, undriven)

    def _shares(self, x: Array) -> Complex:
        return np.asarray(np.linalg.lstsq(self.modes, (x / self.scale).astype(complex))[0])

    def nearest(self, x: Array) -> Array:
        """The state of a lasting response that is nearest to x."""
        return np.asarray(self.scale * (self.modes @ self._shares(x)).real)

    def strongest(self, row: Array) -> Array:
        """The state of a lasting response, within the bounds at all times before, with about the largest row'x."""
        from scipy.optimize import linprog

        reached, every = (row * self.scale) @ self.modes, np.vstack([self.output_sizes, self.w_sizes])
        finite = np.isfinite(every).all(axis=0)
        sizes, every = np.abs(reached) * finite, np.where(finite, every, 0.0)
        largest = every.max(axis=0, initial=0.0)
        unit = np.where(largest > 0, largest, 1.0)
        with np.errstate(over="ignore"):
            aims = sizes * (largest > 0) / unit
        if not 0 < aims.max(initial=0.0) < np.inf:
            return np.zeros(row.size)
        # shares of the largest: a solver takes 1e20 for infinite, and what is far below 1 for nothing
        found = linprog(
            -aims / aims.max(),
            A_ub=every / unit,
            b_ub=np.ones(len(every)),
            bounds=[(0.0, float(s > 0)) for s in largest],
        )
        if found.x is None:  # sizes too far apart for a solver: any state will do, and rest is one
            return np.zeros(row.size)
        return np.asarray(self.scale * (self.modes @ (found.x / unit * np.exp(-1j * np.angle(reached)))).real)

    @property
    def columns(self) -> int:
        """How many variables of a program stand for a response."""
        return 3 * int(self.modes.shape[1])

    def _units(self) -> tuple[Array, Mask]:
        """(m,) the most that outputs and w show of each, and which are bounded by it at all."""
        largest = np.vstack([self.output_sizes, self.w_sizes]).max(axis=0, initial=0.0)
        usable = np.isfinite(largest) & (largest > 0)
        return np.where(usable, largest, 1.0), usable

    def begin(self, table: ConeTable, at: int, change: Array) -> None:
        """Let the first variables of a program, z = change x, be the state of a response whose variables begin at `at`.

        These are sizes, real parts and imaginary parts of the shares.
        """
        units, usable = self._units()
        X = change * self.scale @ np.where(usable, self.modes / units, 0.0)
        n, m = X.shape
        table.add(np.zeros(n), (0, np.eye(n)), (at + m, np.hstack([-X.real, X.imag])))

    def pose(self, table: ConeTable, at: int) -> None:
        """Let the shares be no larger than their sizes, and these within the bounds at all times before."""
        units, usable = self._units()
        m = units.size
        for k in range(m):
            table.put(np.arange(3), at + k + m * np.arange(3), -np.ones(3))
            table.more(np.zeros(3))
            table.end("second order")
        for sizes, ball in ((self.output_sizes, self.v_ball), (self.w_sizes, self.w_ball)):
            rows = np.where(usable, sizes, 0.0) / units
            for part in [rows] if ball else rows[:, None]:
                table.ball(at, part)

    def excess(self, x: Array) -> float:
        """By which factor that through x may exceed the bounds at any time before; infinite if none is."""
        shares = self._shares(x)
        z = x / self.scale
        if np.linalg.norm(z - self.modes @ shares) > AMONG * np.linalg.norm(z):
            return np.inf
        with np.errstate(invalid="ignore"):
            v, w = (
                np.where(np.abs(shares) > 0, each * np.abs(shares), 0.0).sum(axis=1)
                for each in (self.output_sizes, self.w_sizes)
            )
        both = ((v, self.v_ball), (w, self.w_ball))
        return max(float(np.linalg.norm(each) if ball else np.max(each, initial=0.0)) for each, ball in both)


def _null_space(M: Array | Complex, size: float) -> Complex:
    """Orthonormal columns that M (k, q) makes nothing of, but for rounding of entries of a size."""
    _, sizes, right = np.linalg.svd(M)
    return np.asarray(right[np.count_nonzero(sizes > LASTS * max(M.shape) * size) :].conj().T, dtype=np.complex128)


def _steady(own: Complex, moved: Complex, free: Complex, bounds: SignalBounds) -> Complex:
    """(k, m): by column the u with about the least of |own + moved u| / v and |free u|, by whichever is the largest.

    Lawson's weights; rows of exact sensors show nothing, where that can be.
    """
    v, count, k = bounds.v.min(axis=0), own.shape[1], moved.shape[1]
    found = np.zeros((k, count), dtype=np.complex128)
    exact, some = v == 0, (v > 0) & np.isfinite(v)
    if not k:
        return found
    inner = _null_space(moved[exact], float(np.linalg.norm(moved[exact])))
    rows = np.vstack([moved[some] / v[some, None], free])
    seen, q = int(some.sum()), len(free)
    groups = np.zeros(seen, dtype=int) if bounds.v_ball else np.arange(seen)
    groups = np.append(groups, seen + (np.zeros(q, dtype=int) if bounds.w_ball else np.arange(q)))
    for m in range(count):
        first = np.linalg.lstsq(moved[exact], -own[exact, m])[0] if exact.any() else np.zeros(k)
        given = np.concatenate([own[some, m] / v[some], np.zeros(q)]) + rows @ first
        weights, least = np.ones(seen + q), np.inf
        for _ in range(EVENED):
            root = np.sqrt(weights[groups])
            u = np.linalg.lstsq(root[:, None] * rows @ inner, -root * given)[0]
            left = np.sqrt(np.bincount(groups, np.abs(given + rows @ inner @ u) ** 2, minlength=seen + q))
            if left.max() < least:
                least, found[:, m] = left.max(), first + inner @ u
            total = float(weights @ left)
            if total == 0:
                break
            weights = weights * left / total
    return found


CHANGED = 1e-11  # share of the gains, in units of the noise, that may be changed to take away what they leave: rounding
SETTLED = 1e-14  # share of them from which on a change is the last one

ROUNDS = 6
"""Changes of gains, at most: one may end the gain of a one-sided row at 0, and the next does without that row."""

PLAYS = (1e-5, 1e-8, 0.0)
"""Shares of the largest gain above which that of a one-sided row may change; the next where one leaves a rest. A
solver's zeros are no zeros, and to make much of them costs much."""

LEFT = 1e-12
"""What no such change takes away must be below this share of the terms that it is a difference of: rounding."""

CUT = 1e-13  # singular values below this share of the largest say nothing: rounding
NEAR = 10.0  # a trajectory that comes so near to readings, in units of their errors, is near enough

UNKNOWN = 1e-6
"""Share of a target, run back to the start, in directions that are not seen, from which on it is unbounded."""


class FreeStart:
    """What rows say of a start, and the least change of gains that takes away what they leave of it.

    Parameters
    ----------
    H : (R, n) array
        The rows, run back to the start.
    below : (R,) bool array
        One-sided rows: their gains are not negative, and only where one is positive may it shrink.
    unit : (R,) array
        Sizes of the rows' noise: the least change counts in them.

    Notes
    -----
    *Claim.* Where `closes` is true, gains that leave nothing at all lie within `CHANGED` of those given, and cost no
    more than rounding does. That a rest is small in itself says nothing: a direction that decays fast has small terms,
    and a start may be as large in it as in any other.
    """

    def __init__(self, H: Array, below: Mask, unit: Array):
        self._H, self._below, self._unit = H, below, unit
        self._backs: dict[bytes, tuple[Array, Array]] = {}

    @cached_property
    def _sizes(self) -> Array:
        """(n,) what all rows show of each entry of the start."""
        with np.errstate(over="ignore", invalid="ignore"):
            sizes = np.linalg.norm(self._H / self._unit[:, None], axis=0)
        return np.asarray(np.where(sizes > 0, sizes, 1.0))

    def _change(self, gains: Array, rest: Array, play: float) -> Array:
        """Return the least change (R,) of gains after which nothing that some rows show is left of a rest (n,).

        These are the two-sided ones, and one-sided ones whose gains are above a share of the largest.
        """
        own = gains * self._unit
        usable = ~self._below | (own > play * np.abs(own).max(initial=0.0))
        key = usable.tobytes()
        if key not in self._backs:
            self._backs[key] = self._back(usable)
        back, sizes = self._backs[key]
        return np.asarray(back @ (rest / sizes) / self._unit)

    def _back(self, usable: Mask) -> tuple[Array, Array]:
        """What takes a rest away, and the sizes (n,) in which the start's entries count alike."""
        rows = np.where(usable[:, None], self._H, 0.0) / self._unit[:, None]
        with np.errstate(over="ignore", invalid="ignore"):
            sizes = np.linalg.norm(rows, axis=0)
        if not np.isfinite(sizes).all():
            return np.zeros_like(rows), np.ones(rows.shape[1])
        sizes = np.where(sizes > 0, sizes, 1.0)
        return np.asarray(np.linalg.pinv((rows / sizes).T, rcond=CUT)), sizes

    def _small(self, change: Array, gains: Array, share: float) -> bool:
        """Whether gains change by no more than a share."""
        return bool(np.abs(change) @ self._unit <= share * (np.abs(gains) @ self._unit))

    def without(self, gains: Array, begun: Array, rest: Callable[[Array], Array]) -> Array:
        """Return gains after the least change that leaves nothing; `rest` says what gains leave of a target `begun`."""
        own = gains
        for play in PLAYS:
            own = gains
            for _ in range(ROUNDS):
                change = self._change(own, rest(own), play)
                settled = self._small(change, own, SETTLED)
                own = own + change
                own = np.where(self._below, np.maximum(own, 0.0), own)
                if settled:
                    break
            if not self._below.any() or self.closes(own, begun, rest(own)):
                break
        return own

    def closes(self, gains: Array, begun: Array, rest: Array) -> bool:
        """Whether what gains leave is rounding: a change of them as small takes it away, and no one-sided row turns."""
        with np.errstate(over="ignore", invalid="ignore"):
            terms = (np.abs(begun) + np.abs(gains) @ np.abs(self._H)) / self._sizes
        most = LEFT * np.linalg.norm(terms)
        for play in PLAYS:
            change = self._change(gains, rest, play)
            if self._small(change, gains, CHANGED) and np.all((gains + change)[self._below] >= 0):
                with np.errstate(over="ignore", invalid="ignore"):
                    left = np.linalg.norm((rest - change @ self._H) / self._sizes)
                if not left > most:  # where rows have grown beyond all numbers, nobody can say
                    return True
        return False

    def start(self, residuals: Array) -> Array:
        """Return a start (n,) that shows about what two-sided rows showed.

        Only in the directions in which it must, to come within `NEAR` of them: where little is seen of one, noise alone
        would make it large.
        """
        rows = np.where(self._below[:, None], 0.0, self._H) / self._unit[:, None]
        size = np.linalg.norm(rows, axis=0)
        if not np.isfinite(size).all():
            return np.zeros(len(size))
        size = np.where(size > 0, size, 1.0)
        left, singular_values, right = np.linalg.svd(rows / size, full_matrices=False)
        part = left.T @ (residuals / self._unit)
        needed = (singular_values > CUT * singular_values.max(initial=0.0)) & (np.abs(part) > NEAR)
        return np.asarray(np.where(needed, part / np.where(needed, singular_values, 1.0), 0.0) @ right / size)

    @cached_property
    def _unobservable(self) -> Array:
        """(n, m) directions of the start that no row shows."""
        return unobservable_directions(self._H)

    def hides(self, begun: Array) -> bool:
        """Whether a target, run back to the start (n,), holds something that no gains can take away."""
        if not self._unobservable.size:
            return False
        return bool(np.linalg.norm(begun @ self._unobservable) > UNKNOWN * np.linalg.norm(begun))
