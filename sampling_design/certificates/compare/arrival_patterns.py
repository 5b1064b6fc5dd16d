"""Patterns of samples that arrive or do not: bounds of the contraction of a window, over all of them.

Time is cut into steps, in each of which samples arrive or do not, independently (`_RandomSample`, `_PoissonStep`);
patterns of steps are followed side by side as `_PatternClasses`, and those that differ least become one where they are
too many.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree
from scipy.special import gammaln

from sampling_design.certificates.exact.window_problem import WindowProblem
from sampling_design.errors import ArgumentError
from sampling_design.numerics.filtering import CovarianceMap, measurement_update, propagate
from sampling_design.numerics.linalg import discounted_flow, expm_batch, symmetrise
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.record import short

MOST_CLASSES = 256  # of patterns, side by side: eight samples and fewer are counted out exactly
STEPS = 64  # of a window with Poisson arrivals, or more: within one it is only known whether something arrived
MOST_STEPS = 1024  # of a window with Poisson arrivals; each takes some 10 ms
NODES = 8  # Gauss points over a step, in which no mode turns or grows by more than e: means are exact to rounding
OFTEN = 1e4  # arrivals in a step, expected, from which on the mean of 1/N is an asymptotic sum
FASTEST = 2.0**16  # a filter that reads without a break is followed up to so many of its time constants in a step
NEIGHBOURS = 3  # classes that each one is compared with before two become one
ROUNDING = 1e-12  # of the size of Y: less does not count where it is asked which classes are alike
LARGEST = 1e150  # of Y in units of P2's inverse: beyond, squares are no doubles, and nothing is said of a pattern
UNDECIDED = 1e-9  # a factor within this share of 1 is on neither side of it: rounding decides
TIED = 1e-9  # share by which probabilities may differ by rounding: of two such classes the first one stays


def _updated(Y: Array, rows: Array) -> Array:
    """Y after a sample, raised by its rounding: what was large and is seen leaves an error of either sign."""
    for row in _one_by_one(rows):
        Y = measurement_update(Y, row) + _rounding(Y, row)[:, None, None] * np.eye(Y.shape[1])
    return Y


def _updated_below(Y: Array, rows: Array) -> Array:
    """Y after a sample, its eigenvalues lowered by its rounding; what is less than that may be nothing."""
    for row in _one_by_one(rows):
        values, vectors = np.linalg.eigh(measurement_update(Y, row))
        values = np.maximum(values - _rounding(Y, row)[:, None], 0.0)
        Y = symmetrise((vectors * values[:, None, :]) @ vectors.swapaxes(1, 2))
    return Y


def _one_by_one(rows: Array) -> list[Array]:
    return [rows[..., k : k + 1, :] for k in range(rows.shape[-2])]


def _rounding(Y: Array, row: Array) -> Array:
    """A bound of the rounding of a reading that begins with Y: |I - K C| makes of it what a row at a slant sees."""
    cross = Y @ row.swapaxes(-1, -2)
    slant = np.linalg.norm(cross / (1 + row @ cross), axis=(1, 2)) * np.linalg.norm(row, axis=(-2, -1))
    return np.asarray(8 * np.finfo(float).eps * np.trace(Y, axis1=1, axis2=2) * (1 + slant) ** 2)


class _RandomSample(NamedTuple):
    """A gap F, W and a sample at its end, which arrives with some probability."""

    F: Array
    W: Array
    arrives: float
    rows: Array

    def upper(self, Y: Array) -> Array:
        """E[Y] where it arrives."""
        return _updated(propagate(Y, self.F, self.W), self.rows)

    def lower(self, Y: Array) -> Array:
        """The same but for rounding: what is known of it is known exactly."""
        return _updated_below(propagate(Y, self.F, self.W), self.rows)


class _PoissonStep(NamedTuple):
    """A step F, W of a Poisson process: at unknown times within it there arrive samples, with some probability."""

    F: Array
    W: Array
    arrives: float
    joint: tuple[Array, Array]
    """Flow and noise of x, beside the mean of C x over the step."""
    share: float
    """E[1/N] of the N arrivals, if there are any."""
    weights: Array
    nodes: Array
    """Rows (g, p, n) at Gauss points, and their weights."""
    noise: Array
    """What the disturbance of the step adds to the mean covariance of one reading."""
    continuous: CovarianceMap | None
    """The step of a filter that reads without a break: a sample, and a flow."""

    def upper(self, Y: Array) -> Array:
        """E[Y] after arrivals: of the best gain that does not know when in the step, and how many, they were.

        The mean z of N innovations has E zz' = V12 + E[1/N] (V1 - V12 + I), V1 the mean over one arrival, V12 that
        over two independent ones; V12 and E xz' stand in the joint flow.
        """
        n, p = len(self.F), len(self.noise)
        Z = propagate(Y, *self.joint)
        single = np.einsum("g,gij,kjl,gml->kim", self.weights, self.nodes, Y, self.nodes) + self.noise
        innovations = symmetrise(self.share * (single - Z[:, n:, n:] + np.eye(p)))
        whitener = np.linalg.solve(np.linalg.cholesky(innovations), np.broadcast_to(np.eye(p), innovations.shape))
        rows = np.concatenate([np.zeros((len(Y), p, n)), whitener], axis=2)
        return _updated(Z, rows)[:, :n, :n]

    def lower(self, Y: Array) -> Array:
        """1/E[1/Y] after arrivals: as if their information were spread evenly over the step."""
        if self.continuous is None:
            return np.zeros_like(Y)
        values, vectors = np.linalg.eigh(self.continuous.G)
        updated = _updated_below(Y, (vectors * np.sqrt(np.maximum(values, 0.0))).T)
        return propagate(updated, self.continuous.F, self.continuous.Q)


def planned_steps(problem: WindowProblem, last: int, periods: int, p: float) -> list[_RandomSample | _PoissonStep]:
    """The gaps of the window that ends with the sample `last` of a period."""
    order = (last + 1 + np.arange(periods * problem.count)) % problem.count
    F, W = problem.flow(problem.gaps[order])
    return [_RandomSample(F[k], W[k], 1 - p, problem.rows[i]) for k, i in enumerate(order)]


def poisson_steps(problem: WindowProblem, rows: Array, rate: float, M: float) -> list[_RandomSample | _PoissonStep]:
    """Equal steps, each of which sees one arrival or more with the probability 1 - e^{-x}, x = rate h."""
    n, p = problem.size, len(rows)
    A = problem.A + problem.eta / 2 * np.eye(n)
    turns = np.linalg.norm(A, 2) * M if n else 0.0
    if not turns <= MOST_STEPS:
        raise ArgumentError(
            f"`horizon` = {short(M)} spans {short(turns)} time constants of the plant in the weights of the "
            f"certificate: at most {MOST_STEPS} are followed."
        )
    count = max(STEPS, int(np.ceil(turns)))
    h = M / count
    (F,), (W,) = problem.flow(h)
    x = rate * h
    if not x:
        return [_RandomSample(F, W, 0.0, rows)] * count
    arrives = -float(np.expm1(-x))
    # the flow of (x, z), z the mean of C x over the step: their covariance is what an average reading knows
    big, noise = np.zeros((2, n + p, n + p))
    big[:n, :n], big[n:, :n], noise[:n, :n] = A, rows / h, problem.noise
    (joint,), (spread,) = discounted_flow(big, noise, h)
    at, weights = np.polynomial.legendre.leggauss(NODES)
    flows, gramians = discounted_flow(A, problem.noise, h * (at + 1) / 2)
    mean = np.einsum("g,gij->ij", weights / 2, rows @ gramians @ rows.T)
    step = _PoissonStep(
        F=F, W=W, arrives=arrives, joint=(joint[:, :n], spread), share=_mean_inverse(x), weights=weights / 2,
        nodes=rows @ flows, noise=mean, continuous=_filtered(A, problem.noise, rows * np.sqrt(rate / arrives), h),
    )  # fmt: skip
    return [step] * count


def _filtered(A: Array, noise: Array, rows: Array, h: float) -> CovarianceMap | None:
    """Y over h, where outputs are read without a break: Y' = AY + YA' + noise - Y rows' rows Y; None where lost.

    Y is counted in the unit in which noise and information are alike: halvings, each of which doubles the rounding,
    grow with the root of the information only.
    """
    n = len(A)
    gain = np.linalg.norm(rows)
    unit = max(np.sqrt(np.linalg.norm(noise)), 1 / (h * gain)) / gain if gain else 1.0
    scaled = rows * np.sqrt(unit)
    hamiltonian = np.block([[A, noise / unit], [scaled.T @ scaled, -A.T]]) * h
    if not (steps := float(np.linalg.norm(hamiltonian, 1))) <= FASTEST:
        return None
    halvings = max(0, int(np.ceil(np.log2(max(steps, 1.0)))))
    (E,) = expm_batch(np.ldexp(hamiltonian, -halvings), 1.0)
    F = np.linalg.solve(E[n:, n:].T, np.eye(n))
    flow = CovarianceMap(F, symmetrise(F.T @ E[n:, :n]), symmetrise(E[:n, n:] @ F.T))
    for _ in range(halvings):
        flow = flow.then(flow)
    return CovarianceMap(flow.F, flow.G / unit, flow.Q * unit)


def _mean_inverse(x: float) -> float:
    """E[1/N | N >= 1], N Poisson of mean x."""
    if x > OFTEN:  # the sum of k!/x^{k+1}, whose terms fall to rounding
        return float(np.sum(np.cumprod(np.arange(1, 7) / x) / np.arange(1, 7)))
    k = np.arange(1, int(x + 12 * np.sqrt(x) + 40))
    return float(np.sum(np.exp(k * np.log(x) - x - gammaln(k + 1)) / k) / -np.expm1(-x))


def contraction_bounds(
    problem: WindowProblem, steps: list[_RandomSample | _PoissonStep], M: float
) -> tuple[Array, Array]:
    """Bounds of P(rho < 1) and of E[rho] of a window."""
    n = problem.size
    if not n:
        return np.ones(2), np.zeros(2)
    classes = _PatternClasses(np.ones(1), np.ones(1, dtype=np.bool_), np.eye(n)[None], np.eye(n)[None])
    beyond = 0.0
    for step in steps:
        classes = classes.after(step)
        finite = np.trace(classes.upper, axis1=1, axis2=2) < LARGEST
        beyond += float(classes.mass[~finite].sum())
        classes = classes.only(finite)
        while len(classes.mass) > MOST_CLASSES:
            classes = classes.joined(len(classes.mass) - MOST_CLASSES)
    low, high = classes.factors(float(np.exp(-problem.eta * M / 2)))
    with np.errstate(divide="ignore"):  # E[(f - y)^2/f]/(1 - y)^2 of the best y: what may lie on the other side of 1
        wrong = np.nan_to_num((high - low) / (high * low + 1 - 2 * low), nan=1.0)
    wrong = np.where(classes.single, 0.0, wrong.clip(0.0, 1.0))
    least = np.where(high < 1 - UNDECIDED, 1 - wrong, 0.0)
    most = np.where(low > 1 + UNDECIDED, wrong, 1.0)
    upper = max(classes.mass @ most + beyond, 1 - classes.mass @ (1 - most))  # equal but for the rounding of a sum
    probability = np.array([classes.mass @ least, upper])
    factor = np.array([classes.mass @ low, classes.mass @ high + (np.inf if beyond else 0.0)])
    return probability.clip(0.0, 1.0), factor


class _PatternClasses(NamedTuple):
    """Classes of patterns: probability, whether it is one, an upper bound of E[Y], and that of E[1/Y], inverted.

    Of one pattern both bounds are the same, but for rounding.
    """

    mass: Array
    single: Mask
    upper: Array
    lower: Array

    def only(self, which: Mask | Index) -> _PatternClasses:
        """Return the classes of a mask or an index."""
        return _PatternClasses(self.mass[which], self.single[which], self.upper[which], self.lower[which])

    def after(self, step: _RandomSample | _PoissonStep) -> _PatternClasses:
        """Return twice as many: those to which nothing arrives, and those to which something does."""
        mass = np.concatenate([self.mass * (1 - step.arrives), self.mass * step.arrives])
        idle = [propagate(Y, step.F, step.W) for Y in (self.upper, self.lower)]
        if not step.arrives:
            return _PatternClasses(self.mass, self.single, *idle)
        upper = np.concatenate([idle[0], step.upper(self.upper)])
        lower = np.concatenate([idle[1], step.lower(self.lower)])
        single = np.append(self.single, self.single & isinstance(step, _RandomSample))
        return _PatternClasses(mass, single, upper, lower).only(mass > 0)

    def joined(self, count: int) -> _PatternClasses:
        """Return fewer classes, by at most `count`: of those near each other the pairs whose two means differ least.

        The arithmetic mean of Y for E[Y], the harmonic one for E[1/Y]; they differ by ab D (bY + aZ)^-1 D, D = Y - Z.
        """
        values, vectors = np.linalg.eigh(self.upper + self.lower)
        values = np.log(np.maximum(values, np.finfo(float).eps * values[:, -1:] + np.finfo(float).tiny))
        where = ((vectors * values[:, None, :]) @ vectors.swapaxes(1, 2)).reshape(len(values), -1)
        first = np.arange(len(where))
        near = KDTree(where).query(where, k=min(NEIGHBOURS + 1, len(where)))[1]
        i, j = np.append(np.repeat(first, near.shape[1]), first[:-1]), np.append(near, first[1:])
        i, j = i[i < j], j[i < j]
        heavy = self.mass[i] >= self.mass[j] * (1 - TIED)
        i, j = np.where(heavy, i, j), np.where(heavy, j, i)
        mass = self.mass[i] + self.mass[j]
        a, b = (self.mass[k][:, None, None] / mass[:, None, None] for k in (i, j))
        apart, both = self.lower[i] - self.lower[j], b * self.lower[i] + a * self.lower[j]
        size = np.trace(both, axis1=1, axis2=2)[:, None, None] + np.finfo(float).tiny
        apart_in_both = np.linalg.solve(both + ROUNDING * size * np.eye(both.shape[1]), apart)
        lost = mass * (a * b * apart @ apart_in_both).trace(axis1=1, axis2=2)
        pairs, free = [], np.ones(len(where), dtype=np.bool_)
        for k in np.argsort(lost, kind="stable").tolist():
            if free[i[k]] and free[j[k]]:
                pairs.append(k)
                free[i[k]] = free[j[k]] = False
        pairs = pairs[
            : min(count, max(count // 2, MOST_CLASSES // 8, 1))
        ]  # the rest may find better ones among those that are joined
        i, j, a, b = i[pairs], j[pairs], a[pairs], b[pairs]
        self.upper[i] = a * self.upper[i] + b * self.upper[j]
        self.lower[i] = _harmonic(self.lower[i], self.lower[j], a, b)
        self.mass[i], self.single[i] = mass[pairs], False
        return self.only(np.delete(first, j))

    def factors(self, half: float) -> tuple[Array, Array]:
        """Bounds of E[rho] of each class, with e^{-eta M/2} on either side.

        Low: lambda_max is convex. High: where all of a class is one Y that of its upper bound, else the largest r with
        X r^2 - (T X + 1 - (n - 1)^2) r + T <= 0, T = tr E[Y], X = tr E[1/Y].
        """
        values = np.linalg.eigvalsh(self.lower)
        n, low = values.shape[1], half * values[:, -1] * half
        T = half * np.trace(self.upper, axis1=1, axis2=2) * half
        values = values - 100 * n * np.finfo(float).eps * values[:, -1:]  # what is smaller is rounding
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            X = np.where(values > 0, 1 / values, np.inf).sum(axis=1) / half / half
            both = T * X
            root = np.sqrt(np.maximum(both - n**2, 0.0) * (both - (n - 2) ** 2))  # of the discriminant, by its factors
            high = (both + 1 - (n - 1) ** 2 + root) / (2 * X)
        high = np.where(np.isfinite(high), np.clip(high, low, np.maximum(T, low)), np.maximum(T, low))
        own = half * np.linalg.eigvalsh(self.upper)[:, -1] * half
        return np.asarray(low), np.where(self.single, np.maximum(own, low), high)


def _harmonic(Y: Array, Z: Array, a: Array, b: Array) -> Array:
    """(a/Y + b/Z)^-1 of stacks, a >= b: R U V (a^2 V + b^2 U)^-1 R', RR' = aY + bZ, RVR' = bZ, U = I - V.

    It is psd whatever the rounding, and what b Z says keeps its digits where b is small.
    """
    values, vectors = np.linalg.eigh(a * Y + b * Z)
    size = np.finfo(float).eps * values[:, -1:] + np.finfo(float).tiny
    root = np.sqrt(np.maximum(values, size))[:, None, :]
    back = vectors / root
    v, turned = np.linalg.eigh(back.swapaxes(1, 2) @ (b * Z) @ back)
    v, root = v.clip(np.finfo(float).tiny, 1.0)[:, None, :], (vectors * root) @ turned
    return symmetrise(root * ((1 - v) * v / (a**2 * v + b**2 * (1 - v))) @ root.swapaxes(1, 2))
