"""A start of which nothing is known: gains must leave nothing of it, or it makes every bound infinite.

Responses that are bounded for all times before: they may have gone on for ever, within the bounds on w and noise.

x(t - s) = Re sum_m X_m c_m e^{-mu_m s},  w = Re sum_m W_m c_m e^{-mu_m s},  (mu_m - A) X_m = G W_m,  Re mu_m >= 0;
responses at i omega h, h odd, of one mode turn together: for all s >= 0
|C_i x(t - s)| <= sum_omega max_a |Re sum_h C_i X_h c_h e^{i h a}|,  and |w_k(t - s)| likewise
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sampling_design.accuracy.bounds import SignalBounds
from sampling_design.accuracy.undetectable import output_scales, unobservable_directions
from sampling_design.numerics.cone_table import ConeTable
from sampling_design.plants.clusters import eigenvalue_clusters
from sampling_design.plants.grouping import balanced_schur
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Complex, Index, Mask

LASTS = 1e-12
"""Share of |A| below which a mode does not decay, and within which a direction is an eigenvector: rounding alone."""

AMONG = 1e-9
"""A state is that of a lasting response if what is left of it, balanced, is below this share of it: rounding alone."""

HARMONICS = (3, 5)
"""Odd multiples of an undamped mode's rate at which w may hide it, too; of what w(t) = sign sin hides they reach all
but percents, and each is a column more for each entry of w."""

ANGLES = 32  # of half a turn, at which a program bounds what harmonics of one mode show together
FINE_ANGLES = 4096  # the same where it is evaluated, with what may lie between two: a share of 2e-6


@dataclass(frozen=True, eq=False)
class LastingTrajectory:
    """One trajectory that has gone on for ever, as it stands at its end: X c and W c of each of its M responses."""

    rates: Complex  # (M,): mu of the mode
    multiples: Index  # (M,): h; the response has Re mu + i h Im mu
    x: Complex  # (n, M)
    w: Complex  # (q, M)

    @property
    def state(self) -> Array:
        """(n,) where it ends."""
        return np.asarray(self.x.sum(axis=1).real)

    def scaled(self, factor: float | Complex) -> LastingTrajectory:
        """The same, so many times as large, each response by its own factor if there are several."""
        return replace(self, x=self.x * factor, w=self.w * factor)

    def excess(self, plant: Plant, bounds: SignalBounds) -> float:
        """By which factor it may exceed the bounds at any time before; infinite if it is no trajectory of the plant."""
        scale, h, v = _scales(plant)[0][:, None], self.multiples, bounds.v.min(axis=0)
        turned = (self.rates.real + 1j * h * self.rates.imag) * self.x
        left = np.abs(turned - plant.A @ self.x - plant.G @ self.w)
        terms = np.abs(turned) + np.abs(plant.A) @ np.abs(self.x) + np.abs(plant.G) @ np.abs(self.w)
        solved = np.linalg.norm(left / scale, axis=0) <= AMONG * np.linalg.norm(terms / scale, axis=0)
        undamped = (self.rates.real == 0) & (h % 2 == 1) & (h <= HARMONICS[-1])
        if not np.all(solved & (self.rates.real >= 0) & ((h == 1) | undamped)):
            return np.inf
        y = plant.C @ self.x
        rounding = LASTS * plant.n_states * (np.abs(plant.C) @ np.abs(self.x))
        y[(v == 0)[:, None] & (np.abs(y) <= rounding)] = 0.0
        return max(
            beyond(self._most(y), v, ball=bounds.v_ball),
            beyond(self._most(self.w), bounds.w, ball=bounds.w_ball),
        )

    def _most(self, parts: Complex) -> Array:
        """(k,) what its parts (k, M) of an output or of w are at most, at any time before."""
        each = [_largest(self.multiples[own], parts[:, own]) for own in self._modes()]
        return np.asarray(sum(each, np.zeros(len(parts))))

    def _modes(self) -> list[Mask]:
        """Responses of one mode, whose phases turn together, mode by mode."""
        return [self.rates == rate for rate in np.unique(self.rates)]


def beyond(sizes: Array, most: Array, *, ball: bool = False) -> float:
    """By which factor sizes exceed what bounds them, each by itself or all together; 0 is within a bound of 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(sizes > 0, sizes / most, 0.0)
    return float(np.linalg.norm(ratio) if ball else np.max(ratio, initial=0.0))


def _largest(h: Index, parts: Complex) -> Array:
    """(k,) the largest |Re sum_m parts_m e^{i h_m a}| over all angles a, odd h; no less, and 2e-6 more at most."""
    if np.all(h == 1):
        return np.asarray(np.abs(parts.sum(axis=1)))
    turned = np.exp(1j * np.pi / FINE_ANGLES * np.arange(FINE_ANGLES)[:, None] * h)
    between = np.cos(np.pi * h.max() / (2 * FINE_ANGLES))  # of a trigonometric polynomial of degree h
    return np.asarray(np.abs((parts @ turned.T).real).max(axis=1, initial=0.0) / between)


@dataclass(frozen=True, eq=False)
class LastingResponses:
    """All that modes which do not decay span, each with the disturbances that may hide it.

    These are at its own rate, and at odd multiples of an undamped mode's. Where nothing drives a mode, the states that
    are driven may make up for what outputs show of it.
    """

    span: LastingTrajectory  # its responses, each as large as the bounds allow it to be alone
    ratios: Complex  # (p + q, M): C X and W, in units of the bounds
    v_ball: bool  # whether the noise of a sample is bounded in the Euclidean norm
    w_ball: bool  # whether w is
    undriven: bool  # whether a mode is beyond the reach of w

    @classmethod
    def of(cls, plant: Plant, bounds: SignalBounds) -> LastingResponses:
        """Return those of a plant."""
        scale, size = _scales(plant)
        A, n, q = plant.A * scale / scale[:, None], plant.n_states, plant.n_disturbances
        G, C = plant.G * bounds.w / scale[:, None], plant.C * scale
        v, undriven = bounds.v.min(axis=0), False
        rates, multiples, X, W = [], [], [np.zeros((n, 0), dtype=complex)], [np.zeros((q, 0), dtype=complex)]
        for cluster in eigenvalue_clusters(A):
            undamped = abs(cluster.value.real) <= LASTS * size
            rate = complex(0.0 if undamped else cluster.value.real, cluster.value.imag)
            if rate.real < 0 or rate.imag < 0:  # what decays, and conjugates
                continue
            left, sizes, right = np.linalg.svd(rate * np.eye(n) - A)
            none = sizes <= LASTS * n * size
            own = right[none].conj().T
            own[np.abs(own) < LASTS] = 0.0
            across = left[:, none].conj().T  # what is seen of the mode itself
            free = _null_space(across @ G, float(np.linalg.norm(G)))  # w that do not drive it
            undriven |= free.shape[1] > q - own.shape[1]
            moved = right[~none].conj().T @ (left[:, ~none].conj().T @ (G @ free) / sizes[~none, None])
            moved -= own @ np.linalg.lstsq(across @ own, across @ moved)[0]
            found = [(1, np.hstack([own, moved]), np.hstack([np.zeros((q, own.shape[1])), free]))]
            for h in HARMONICS if undamped and rate.imag > 0 and own.size else ():
                turning = h * rate * np.eye(n) - A
                if np.linalg.norm(turning, -2) > LASTS * n * size:  # else it is the rate of another mode
                    found.append((h, np.linalg.solve(turning, G.astype(complex)), np.eye(q, dtype=complex)))
            for h, x, w in found:
                unobserved = _unobserved_shares(x, C[v == 0])
                X.append(x @ unobserved)
                W.append(w @ unobserved)
                rates += [rate] * unobserved.shape[1]
                multiples += [h] * unobserved.shape[1]
        x, w = np.hstack(X), np.hstack(W)
        noisy = (v > 0)[:, None]
        ratios = np.vstack([np.divide(C @ x, v[:, None], out=np.zeros((len(C), x.shape[1]), complex), where=noisy), w])
        unit = np.abs(ratios).max(axis=0, initial=0.0)
        used = np.isfinite(unit) & (unit > 0)
        x, w, ratios = (each[:, used] / unit[used] for each in (x * scale[:, None], w * bounds.w[:, None], ratios))
        span = LastingTrajectory(np.array(rates, complex)[used], np.array(multiples, int)[used], x, w)
        return cls(span, ratios, bounds.v_ball, bounds.w_ball, undriven)

    def trajectory(self, shares: Array) -> LastingTrajectory:
        """That of the first variables of a program, in the order of `begin`."""
        real, imaginary = shares[: 2 * self.span.rates.size].reshape(2, -1)
        c = real + 1j * imaginary
        return self.span.scaled(c)

    @property
    def columns(self) -> int:
        """How many variables of a program stand for a response."""
        return int(2 * self.span.rates.size + len(self.span._modes()) * len(self.ratios))

    def begin(self, table: ConeTable, at: int, change: Array) -> None:
        """Let the first variables of a program, z = change x, be the state of a response whose variables begin at `at`.

        These are real and imaginary parts of the shares, then what each mode shows at most.
        """
        X = change @ self.span.x
        table.add(np.zeros(len(X)), (0, np.eye(len(X))), (at, np.hstack([-X.real, X.imag])))

    def pose(self, table: ConeTable, at: int, *, ball: bool) -> None:
        """Bound what each mode shows, at angles where harmonics turn with it, and their sums at all times before.

        The part of it that is of second-order cones (`ball`), or the other.
        """
        M, k, modes = self.span.rates.size, len(self.ratios), self.span._modes()
        p = k - len(self.span.w)
        for place, own in enumerate(modes):
            h, sizes = self.span.multiples[own], at + 2 * M + place * k + np.arange(k)
            columns = at + np.concatenate([np.flatnonzero(own), M + np.flatnonzero(own)])
            if bool(np.all(h == 1)) != ball:
                continue
            turns = np.ones((1, 1)) if ball else np.exp(1j * np.pi / ANGLES * np.arange(ANGLES)[:, None] * h)
            for size, part in zip(sizes, self.ratios[:, own], strict=True):
                real, turned = np.hstack([(turns * part).real, -(turns * part).imag]), turns * part
                if ball:  # |sum| <= size
                    rows = np.vstack([real, np.hstack([turned.imag, turned.real])])
                    table.put(np.array([0]), np.array([size]), -np.ones(1))
                    table.put(np.arange(1, 3)[:, None], columns, rows)
                    table.more(np.zeros(3))
                    table.end("second order")
                else:
                    both = np.vstack([real, -real])
                    table.put(np.arange(len(both))[:, None], columns, both)
                    table.put(np.arange(len(both)), np.full(len(both), size), -np.ones(len(both)))
                    table.more(np.zeros(len(both)))
        for first, last, round_ in ((0, p, self.v_ball), (p, k, self.w_ball)):
            sums = np.tile(np.eye(k)[first:last], len(modes))
            if round_ is ball and ball and last > first:
                table.ball(at + 2 * M, sums)
            elif round_ is ball and last > first:
                table.add(np.ones(last - first), (at + 2 * M, sums))


def _scales(plant: Plant) -> tuple[Array, float]:
    """(n,) sizes of the states that balance A, and the size of A in them."""
    balance = balanced_schur(plant.A).d
    rate = float(np.linalg.norm(plant.A * balance / balance[:, None], 2))
    scale = output_scales(plant, 1 / rate if rate > 0 else 1.0)
    return scale, float(np.linalg.norm(plant.A * scale / scale[:, None], 2))


def _unobserved_shares(X: Complex, C: Array) -> Complex:
    """Shares of responses X, by column, of which exact sensors C see nothing."""
    size = np.linalg.norm(X, axis=0)
    size = np.where(size > 0, size, 1.0)
    return np.asarray(_null_space(C @ (X / size), float(np.linalg.norm(C))) / size[:, None])


def _null_space(M: Array | Complex, size: float) -> Complex:
    """Orthonormal columns that M (k, q) makes nothing of, but for rounding of entries of a size."""
    _, sizes, right = np.linalg.svd(M, full_matrices=len(M) < M.shape[1])
    return np.asarray(right[np.count_nonzero(sizes > LASTS * max(M.shape) * size) :].conj().T, dtype=np.complex128)


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
