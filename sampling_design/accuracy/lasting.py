"""Responses that are bounded for all times before: they may have gone on for ever, within the bounds on w and noise.

x(t - s) = Re sum_m X_m(t - s) e^{-mu_m s},  w = Re sum_m W_m(t - s) e^{-mu_m s},  X_m' = (A - mu_m) X_m + G W_m,
mu_m = Re mu + i h Im mu,  Re mu >= 0,  h odd, X_m and W_m with the period of the schedule, or constant;
those of one mode turn together, from wherever: for all samples t_j and cells k of a period, whichever period it is,
|C_i x(t_j)| <= sum_mu max_a |Re sum_h C_i X_h(t_j) e^{i h a}|,  and |w_i| <= sum_mu max_a |Re sum_h W_hik e^{i h a}|
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sampling_design.accuracy.bounds import SignalBounds
from sampling_design.accuracy.undetectable import output_scales
from sampling_design.numerics.cone_table import ConeTable
from sampling_design.numerics.linalg import forced_flow
from sampling_design.plants.clusters import balanced_schur, eigenvalue_clusters
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Complex, Index, Mask

LASTS = 1e-12
"""Share of |A| below which a mode does not decay, and within which a direction is an eigenvector: rounding alone."""

AMONG = 1e-9
"""A state is that of a lasting response if what is left of it, balanced, is below this share of it: rounding alone."""

HARMONICS = (3, 5)
"""Odd multiples of an undamped mode's rate at which w may hide it, too; of what w(t) = sign sin hides they reach all
but percents, and each is a column more for each entry of w."""

NEAR = 1e-6
"""Share of a period's flow within which a response repeats itself without a disturbance: w must not drive it then."""

CELLS = 4  # of a gap, on which w may have amplitudes of its own

DIRECTIONS, FINE_DIRECTIONS = 8, 64  # of half a turn, along which two signals are bounded that a ball bounds

ANGLES = 32  # of half a turn, at which a program bounds what harmonics of one mode show together
FINE_ANGLES = 1024  # the same where it is evaluated, with what may lie between two: a share of 2e-6


@dataclass(frozen=True, eq=False)
class LastingTrajectory:
    """One trajectory that has gone on for ever: amplitudes X_m and W_m of each of its M responses.

    They are those at the samples of a period, the last of which is where it ends, and on equal cells of the gaps behind
    these; or one of each that is constant.
    """

    rates: Complex  # (M,): mu of the mode
    multiples: Index  # (M,): h; the response has Re mu + i h Im mu
    x: Complex  # (N, n, M)
    w: Complex  # (N, m, q, M)

    @property
    def exponents(self) -> Complex:
        """(M,) mu_m."""
        return np.asarray(self.rates.real + 1j * self.multiples * self.rates.imag)

    @property
    def state(self) -> Array:
        """(n,) where it ends."""
        return np.asarray(self.x[-1].sum(axis=1).real)

    def scaled(self, factor: float | Complex) -> LastingTrajectory:
        """The same, so many times as large, each response by its own factor if there are several."""
        return replace(self, x=self.x * factor, w=self.w * factor)

    def excess(self, plant: Plant, bounds: SignalBounds, gaps: Array | None = None, last: int = 0) -> float:
        """By which factor it may exceed the bounds at any time before; infinite if it is no trajectory of the plant.

        `gaps` (N,) lie behind the samples of a period, and it ends at sample `last`; without them it must be constant.
        """
        scale, size = _scales(plant)
        A, G = plant.A * scale / scale[:, None], plant.G / scale[:, None]
        constant = self.w.shape[:2] == (1, 1)
        if constant:  # an equation that holds over any step
            gaps, v = np.array([1 / size if size > 0 else 1.0]), bounds.v.min(axis=0, keepdims=True)
        elif gaps is None or not len(gaps) == len(self.x) == len(self.w):
            return np.inf
        else:
            gaps, v = (np.roll(each, -last - 1, axis=0) for each in (gaps, bounds.v))
        undamped = (self.rates.real == 0) & (self.multiples % 2 == 1) & (self.multiples <= HARMONICS[-1])
        if not np.all((self.rates.real >= 0) & ((self.multiples == 1) | undamped) & self._solved(A, G, scale, gaps)):
            return np.inf
        y, rounding = plant.C @ self.x, LASTS * plant.n_states * (np.abs(plant.C) @ np.abs(self.x))
        y[(v == 0)[:, :, None] & (np.abs(y) <= rounding)] = 0.0
        at_samples, on_cells = faded(self.rates, gaps, self.w.shape[1])
        return max(
            self._most(y * at_samples, v[:, :, None], bounds.v_ball),
            *(self._most(cells, bounds.w[:, None], bounds.w_ball) for cells in self.w * on_cells),
        )

    def _solved(self, A: Array, G: Array, scale: Array, gaps: Array) -> Mask:
        """(M,) whether amplitudes follow from each other, in balanced coordinates, but for rounding of their own."""
        x, found = self.x / scale[:, None], np.zeros(len(self.rates), dtype=bool)
        for k, rate in enumerate(self.exponents):
            F, B = _cell_steps(A, G, rate, gaps / self.w.shape[1])
            ahead, driven = x[:, :, k], np.abs(self.w[..., k]).sum(axis=1) @ np.abs(G).T
            for cell in range(self.w.shape[1]):
                ahead = np.einsum("kij,kj->ki", F, ahead) + np.einsum("kij,kj->ki", B, self.w[:, cell, :, k])
            terms = np.abs(x[:, :, k]) + np.abs(np.roll(x[:, :, k], -1, axis=0)) + driven * gaps[:, None]
            left = np.abs(ahead - np.roll(x[:, :, k], -1, axis=0)).max(axis=1)
            found[k] = np.all(left <= AMONG * terms.max(axis=1))
        return found

    def _most(self, parts: Complex, bound: Array, ball: bool) -> float:
        """By which factor its parts (N, k, M) of outputs or of w exceed a bound on each, or on all k, at most."""
        with np.errstate(divide="ignore", invalid="ignore"):
            parts = np.where(parts != 0, parts / bound, 0.0)
        if not np.isfinite(parts).all():
            return np.inf
        if ball and parts.shape[1] == 2:
            parts, ball = _directions(FINE_DIRECTIONS) @ parts, False
        sizes = np.zeros(parts.shape[:-1])
        for own in self.modes():
            sizes += _largest(self.multiples[own], parts[..., own])
        return float(np.max(np.linalg.norm(sizes, axis=-1) if ball else sizes, initial=0.0))

    def modes(self) -> list[Mask]:
        """Responses of one mode, whose phases turn together, mode by mode."""
        return [self.rates == rate for rate in np.unique(self.rates)]


def faded(rates: Complex, gaps: Array, cells: int) -> tuple[Array, Array]:
    """What is left of responses by age, (N, 1, M) at the samples of the last period and (N, m, 1, M) on their cells.

    The gap behind the last sample was passed one period before.
    """
    ages = np.append(0.0, np.cumsum(gaps[:-1][::-1]))[::-1]
    ends = np.append(ages[1:], ages[0])[:, None] + gaps[:, None] * (1 - (1 + np.arange(cells)) / cells)
    return np.exp(-ages[:, None, None] * rates.real), np.exp(-ends[:, :, None, None] * rates.real)


def _cell_steps(A: Array, G: Array, rate: complex, lengths: Array) -> tuple[Complex, Complex]:
    """e^{(A - rate) h} and int_0^h e^{(A - rate) s} G ds over each length h."""
    n = len(A)
    steps = np.asarray(forced_flow(A - rate * np.eye(n), G, lengths), dtype=np.complex128)
    return steps[:, :, :n], steps[:, :, n:]


def beyond(sizes: Array, most: Array, *, ball: bool = False) -> float:
    """By which factor sizes exceed what bounds them, each by itself or those of a row together; 0 is within 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(sizes > 0, sizes / most, 0.0)
    return float(np.max(np.linalg.norm(ratio, axis=-1) if ball else ratio, initial=0.0))


def _largest(h: Index, parts: Complex) -> Array:
    """The largest |Re sum_m parts_m e^{i h_m a}| over all angles a, odd h; no less, and little more at most."""
    if np.all(h == 1):
        return np.asarray(np.abs(parts.sum(axis=-1)))
    turned = np.exp(1j * np.pi / FINE_ANGLES * np.arange(FINE_ANGLES)[:, None] * h)
    between = np.cos(np.pi * h.max() / (2 * FINE_ANGLES))  # of a trigonometric polynomial of degree h
    return np.asarray(np.abs((parts @ turned.T).real).max(axis=-1, initial=0.0) / between)


def _directions(count: int) -> Array:
    """(count, 2) directions along which what a ball bounds is bounded, no less between two of them."""
    a = np.pi / count * np.arange(count)
    return np.asarray(np.stack([np.cos(a), np.sin(a)], axis=1) / np.cos(np.pi / (2 * count)))


@dataclass(frozen=True, eq=False)
class LastingResponses:
    """All that modes which do not decay span, each with the disturbances that may hide it.

    These are at its own rate, and at odd multiples of an undamped mode's. Where nothing drives a mode, the states that
    are driven may make up for what outputs show of it.
    """

    span: LastingTrajectory  # its responses, each as large as the bounds allow it to be alone
    ratios: Complex  # (k, M): C X at each sample, then W on each cell, faded, in units of the bounds
    bounded: tuple[tuple[Array, bool], ...]  # (N, l, k) what is bounded of these, and whether a ball bounds all l
    undriven: bool  # whether a mode is beyond the reach of w

    @classmethod
    def of(cls, plant: Plant, bounds: SignalBounds, gaps: Array | None = None, last: int = 0) -> LastingResponses:
        """Return those of a plant that are constant, or with the period of samples before `gaps` that end at one.

        What hides a mode that nothing drives is then free on each cell of a period.
        """
        scale, size = _scales(plant)
        A, n, q = plant.A * scale / scale[:, None], plant.n_states, plant.n_disturbances
        G, C = plant.G * bounds.w / scale[:, None], plant.C * scale
        count, cells = (1, 1) if gaps is None else (len(gaps), CELLS)
        v = bounds.v.min(axis=0, keepdims=True) if gaps is None else np.roll(bounds.v, -last - 1, axis=0)
        behind = np.zeros(1) if gaps is None else np.roll(gaps, -last - 1)
        exact = np.where((v == 0)[:, :, None], C, 0.0)
        rates, multiples, undriven = [], [], False
        X, W = [np.zeros((count, n, 0), dtype=complex)], [np.zeros((count, cells, q, 0), dtype=complex)]
        for mode in _lasting_modes(A, G, size):
            undriven |= mode.undriven
            for h in mode.multiples:
                moved = _repeating(mode, A, G, h, behind) if cells > 1 and mode.undriven else _constant(mode, A, G, h)
                x, w = np.broadcast_to(moved[0], (count, n, moved[0].shape[-1])), moved[1]
                w = np.broadcast_to(w, (count, cells, q, w.shape[-1]))
                if h == 1:
                    x = np.concatenate([np.broadcast_to(mode.own, (count, *mode.own.shape)), x], axis=-1)
                    w = np.concatenate([np.zeros((count, cells, q, mode.own.shape[1])), w], axis=-1)
                unobserved = _unobserved_shares(x, exact @ x, float(np.linalg.norm(exact)))
                X.append(x @ unobserved)
                W.append(w @ unobserved)
                rates += [mode.rate] * unobserved.shape[1]
                multiples += [h] * unobserved.shape[1]
        x, w = np.concatenate(X, axis=-1), np.concatenate(W, axis=-1)
        span = LastingTrajectory(np.array(rates, dtype=complex), np.array(multiples, dtype=int), x, w)
        at_samples, on_cells = faded(span.rates, behind, cells)
        y = np.divide(
            C @ x, v[:, :, None], out=np.zeros((count, len(C), len(rates)), complex), where=(v > 0)[:, :, None]
        )
        parts, sizes = (y * at_samples, w * on_cells), (count * len(C), count * cells * q)
        ratios = np.vstack([each.reshape(many, len(rates)) for each, many in zip(parts, sizes, strict=True)])
        bounded, each = list[tuple[Array, bool]](), np.split(np.eye(len(ratios)), [count * len(C)])
        for entries, many, ball in zip(each, (len(C), q), (bounds.v_ball, bounds.w_ball), strict=True):
            rows = entries.reshape(-1, many, len(ratios)) if many else np.zeros((0, 0, len(ratios)))
            turned = ball and many == 2
            bounded.append((_directions(DIRECTIONS) @ rows if turned else rows, ball and not turned))
        unit = np.abs(ratios).max(axis=0, initial=0.0)
        used = np.isfinite(unit) & (unit > 0)
        x, w = x[..., used] * scale[:, None] / unit[used], w[..., used] * bounds.w[:, None] / unit[used]
        span = LastingTrajectory(span.rates[used], span.multiples[used], x, w)
        return cls(span, ratios[:, used] / unit[used], tuple(bounded), undriven)

    @cached_property
    def _kinds(self) -> tuple[Index, Index]:
        """Of responses of one mode and multiple the first (R,), and which of these each one (M,) is of."""
        kinds = np.stack([self.span.rates, self.span.multiples])
        _, first, which = np.unique(kinds, axis=1, return_index=True, return_inverse=True)
        return first, which

    def trajectory(self, shares: Array) -> LastingTrajectory:
        """That of the first variables of a program, in the order of `begin`: one response for each rate."""
        real, imaginary = shares[: 2 * self.span.rates.size].reshape(2, -1)
        taken, (first, which) = self.span.scaled(real + 1j * imaginary), self._kinds
        sums = (which[:, None] == np.arange(first.size)).astype(float)
        return LastingTrajectory(taken.rates[first], taken.multiples[first], taken.x @ sums, taken.w @ sums)

    @cached_property
    def _places(self) -> tuple[int, int, int]:
        """Where amplitudes begin among the variables of a response, where what each mode shows does, and the end."""
        amplitudes = 2 * self.span.rates.size
        sizes = amplitudes + 2 * len(self._kinds[0]) * len(self.ratios)
        return amplitudes, sizes, sizes + len(self.span.modes()) * sum(X[..., 0].size for X, _ in self.bounded)

    @property
    def columns(self) -> int:
        """How many variables of a program stand for a response."""
        return self._places[-1]

    def begin(self, table: ConeTable, at: int, change: Array) -> None:
        """Let the first variables of a program, z = change x, be the state of a response whose variables begin at `at`.

        These are real and imaginary parts of the shares, of amplitudes for each mode and multiple, and what each mode
        shows at most.
        """
        X, (first, which), k = change @ self.span.x[-1], self._kinds, len(self.ratios)
        table.add(np.zeros(len(X)), (0, np.eye(len(X))), (at, np.hstack([-X.real, X.imag])))
        for kind in range(first.size):
            ratio = np.where(which == kind, self.ratios, 0.0)
            shares = np.block([[ratio.real, -ratio.imag], [ratio.imag, ratio.real]])
            table.add(np.zeros(2 * k), (at, -shares), (at + self._places[0] + 2 * k * kind, np.eye(2 * k)))

    def pose(self, table: ConeTable, at: int, *, ball: bool) -> None:
        """Bound what each mode shows, at angles where harmonics turn with it, and their sums at all times before.

        The part of it that is of second-order cones (`ball`), or the other.
        """
        (first, _), modes, k = self._kinds, self.span.modes(), len(self.ratios)
        rows = np.vstack([X.reshape(-1, k) for X, _ in self.bounded])
        for place, own in enumerate(modes):
            kinds = np.flatnonzero(own[first])
            h = self.span.multiples[first[kinds]]
            if bool(np.all(h == 1)) != ball:
                continue
            a = np.zeros(1) if ball else np.pi / ANGLES * np.arange(ANGLES)
            turn = np.exp(1j * a[:, None] * h)
            for size, row in enumerate(rows, at + self._places[1] + place * len(rows)):
                some = np.flatnonzero(row)
                columns = (at + self._places[0] + 2 * k * kinds[:, None] + np.concatenate([some, k + some])).ravel()
                part = np.einsum("ah,e->ahe", turn, row[some])
                real = np.concatenate([part.real, -part.imag], axis=2).reshape(len(a), -1)
                if ball:  # |sum| <= size
                    imaginary = np.concatenate([part.imag, part.real], axis=2).reshape(len(a), -1)
                    table.put(np.array([0]), np.array([size]), -np.ones(1))
                    table.put(np.arange(1, 3)[:, None], columns, np.vstack([real, imaginary]))
                    table.more(np.zeros(3))
                    table.end("second order")
                else:
                    both = np.vstack([real, -real])
                    table.put(np.arange(len(both))[:, None], columns, both)
                    table.put(np.arange(len(both)), np.full(len(both), size), -np.ones(len(both)))
                    table.more(np.zeros(len(both)))
        self._bound_sums(table, at + self._places[1], ball)

    def _bound_sums(self, table: ConeTable, at: int, ball: bool) -> None:
        """What all modes show together, each at most."""
        modes, total, begin = len(self.span.modes()), sum(X[..., 0].size for X, _ in self.bounded), 0
        for X, round_ in self.bounded:
            for _ in range(len(X)):
                sums = np.tile(np.eye(total)[begin : begin + X.shape[1]], modes)
                begin += X.shape[1]
                if round_ and ball:
                    table.ball(at, sums)
                elif not round_ and not ball:
                    table.add(np.ones(len(sums)), (at, sums))


@dataclass(frozen=True, eq=False)
class _LastingMode:
    """A mode that does not decay, in balanced coordinates; of a conjugate pair one."""

    rate: complex
    undamped: bool
    own: Complex  # (n, k) what stays in it by itself
    across: Complex  # (k, n) what is seen of it: across (A - rate) = 0
    free: Complex  # (q, c): constant w that do not drive it

    @property
    def multiples(self) -> tuple[int, ...]:
        """Multiples of its rate at which w may hide it."""
        return (1, *HARMONICS) if self.undamped and self.rate.imag > 0 and self.own.size else (1,)

    @property
    def undriven(self) -> bool:
        """Whether some of it is beyond the reach of w."""
        return bool(self.free.shape[1] > self.free.shape[0] - self.own.shape[1])

    def exponent(self, h: int) -> complex:
        """That of a response at a multiple."""
        return complex(self.rate.real, h * self.rate.imag)


def _lasting_modes(A: Array, G: Array, size: float) -> Iterator[_LastingMode]:
    """Modes of A, of that size, that do not decay."""
    for cluster in eigenvalue_clusters(A):
        undamped = abs(cluster.value.real) <= LASTS * size
        rate = complex(0.0 if undamped else cluster.value.real, cluster.value.imag)
        if rate.real < 0 or rate.imag < 0:  # what decays, and conjugates
            continue
        left, sizes, right = np.linalg.svd(rate * np.eye(len(A)) - A)
        none = sizes <= LASTS * len(A) * size
        own, across = right[none].conj().T, left[:, none].conj().T
        own[np.abs(own) < LASTS] = 0.0
        yield _LastingMode(rate, undamped, own, across, _null_space(across @ G, float(np.linalg.norm(G))))


def _constant(mode: _LastingMode, A: Array, G: Array, h: int) -> tuple[Complex, Complex]:
    """Responses (n, M) to constant w (q, M) at a multiple of a mode's rate: (mu - A) X = G W; none at another's."""
    left, sizes, right = np.linalg.svd(mode.exponent(h) * np.eye(len(A)) - A)
    regular = sizes > LASTS * len(A) * float(np.linalg.norm(A, 2))
    w = mode.free if h == 1 else np.eye(G.shape[1], dtype=complex)[:, : G.shape[1] * int(regular.all())]
    x = right[regular].conj().T @ (left[:, regular].conj().T @ (G @ w) / sizes[regular, None])
    if h == 1:
        x -= mode.own @ np.linalg.lstsq(mode.across @ mode.own, mode.across @ x)[0]
    return x, w


def _repeating(mode: _LastingMode, A: Array, G: Array, h: int, gaps: Array) -> tuple[Complex, Complex]:
    """Responses (N, n, M) to w (N, m, q, M) on equal cells of the gaps, with amplitudes that repeat themselves.

    X_{j+1} = F_j X_j + sum_i B_ji W_ji,   X_N = X_0
    """
    (n, q), count = G.shape, len(gaps)
    F, B = _cell_steps(A, G, mode.exponent(h), gaps / CELLS)
    ahead, flows = np.hstack([np.eye(n), np.zeros((n, count * CELLS * q))]).astype(complex), []
    for k in range(count):
        flows.append(ahead)
        for at in range(n + k * CELLS * q, n + (k + 1) * CELLS * q, q):
            ahead = F[k] @ ahead
            ahead[:, at : at + q] += B[k]
    left, sizes, right = np.linalg.svd(np.eye(n) - ahead[:, :n])
    regular = sizes > NEAR * max(1.0, sizes[0])
    free = _null_space(left[:, ~regular].conj().T @ ahead[:, n:], float(np.linalg.norm(ahead[:, n:])))
    start = right[regular].conj().T @ (left[:, regular].conj().T @ (ahead[:, n:] @ free) / sizes[regular, None])
    x = np.array([flow @ np.vstack([start, free]) for flow in flows])
    return x, free.reshape(count, CELLS, q, -1)


def _scales(plant: Plant) -> tuple[Array, float]:
    """(n,) sizes of the states that balance A, and the size of A in them."""
    balance = balanced_schur(plant.A).d
    rate = float(np.linalg.norm(plant.A * balance / balance[:, None], 2))
    scale = output_scales(plant, 1 / rate if rate > 0 else 1.0)
    return scale, float(np.linalg.norm(plant.A * scale / scale[:, None], 2))


def _unobserved_shares(X: Complex, shown: Complex, size: float) -> Complex:
    """Shares of responses X (N, n, M) of which exact sensors of that size, which are shown (N, p, M), see nothing."""
    sizes = np.linalg.norm(X, axis=(0, 1))
    sizes = np.where(sizes > 0, sizes, 1.0)
    return np.asarray(
        _null_space((shown / sizes).reshape(shown.shape[0] * shown.shape[1], sizes.size), size) / sizes[:, None]
    )


def _null_space(M: Array | Complex, size: float) -> Complex:
    """Columns, orthonormal, that M (k, q) makes nothing of, but for rounding of entries of a size; all as they are."""
    _, sizes, right = np.linalg.svd(M, full_matrices=len(M) < M.shape[1])
    rank = np.count_nonzero(sizes > LASTS * max(M.shape, default=0) * size)
    return np.asarray(right[rank:].conj().T if rank else np.eye(M.shape[1]), dtype=np.complex128)
