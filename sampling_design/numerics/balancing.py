"""Scales and an order of the states that suit a matrix whatever its units: what every decision is made in."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.kept import kept

ROUNDS = 40  # of reweighted least squares: enough for the median of what the couplings ask of the scales
LARGEST_LOGARITHM = 700.0  # of a double, with room
FARTHEST = 1000.0  # |log2| of a scale: beyond, numbers end


class Balance(NamedTuple):
    """Scales d, an order of the states, and the norm of diag(d)^-1 A diag(d) without what couples components."""

    d: Array
    order: Index
    speed: float


@kept
def balance(A: Array, C: Array | None = None) -> Balance:
    """Return scales d (powers of two) and an order of the states, with B = diag(d)^-1 A diag(d) of moderate entries.

    In that order B is block upper triangular, one block for each set of states that drive each other.

    Notes
    -----
    *Method.* States that drive each other (a strong component of the graph of A) are balanced by themselves: the
    scales of least norm are unique there. Between components a coupling can be scaled to any size, and plain
    balancing runs away with it; here the couplings are brought as near as they can be (their logarithms in the
    median) to the largest norm of a component, to 1 where all of these vanish. So d follows a change of units, up to
    the factor of two that powers of two leave. Sets of states that share no coupling at all are scaled against
    each other by what the rows of C show of them, where C is given.
    """
    from scipy.linalg.lapack import dgebal
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    n = A.shape[0]
    d = np.ones(n)
    if not A.any():
        return Balance(_scaled_by_outputs(A, C, d), np.arange(n), 0.0)
    top = int(np.floor(np.log2(np.max(np.abs(A)))))
    moderate = np.ldexp(A, -top)  # neither 1e200 nor 1e-200 squared is a number
    count, part = connected_components(csr_array(A != 0), directed=True, connection="strong")
    speed = np.zeros(count)
    for k in range(count):
        block = np.flatnonzero(part == k)
        inner = moderate[np.ix_(block, block)]
        if block.size > 1:
            inner, _, _, d[block], _ = dgebal(inner, scale=1, permute=0)
        speed[k] = np.linalg.norm(inner)
    fastest = float(np.ldexp(np.linalg.norm(speed), top)) if top < 1000 else np.inf
    if count == 1:
        return Balance(d, np.arange(n), fastest)
    with np.errstate(divide="ignore"):
        entries = np.log2(np.abs(A)) - np.log2(d)[:, None] + np.log2(d)
        goal = np.log2(speed.max()) + top if speed.max() > 0 else 0.0
    size = np.full((count, count), -np.inf)
    np.maximum.at(size, (part[:, None], part), entries)
    np.fill_diagonal(size, -np.inf)
    d *= np.exp2(np.rint(_between(size - goal))[part])
    return Balance(
        _scaled_by_outputs(A, C, d), np.argsort(_depth(np.isfinite(size))[part] * count + part, kind="stable"), fastest
    )


def balanced(A: Array, d: Array) -> Array:
    """Return diag(d)^-1 A diag(d) for powers of two d: without rounding, and 0 stays 0 however far d reaches."""
    power = np.log2(d).astype(int)
    return np.ldexp(A, np.where(A != 0, power - power[:, None], 0))


def balanced_rows(C: Array, d: Array) -> Array:
    """Return C diag(d), each row divided by a power of two that makes its largest entry about 1."""
    power = np.log2(d).astype(int)
    reach = np.where(C != 0, np.frexp(C)[1] + power, -(2**20))
    top = np.max(reach, axis=1, initial=-(2**20), keepdims=True)
    return np.ldexp(C, np.where(C != 0, np.clip(power - top, -4000, 4000), 0))


def _scaled_by_outputs(A: Array, C: Array | None, d: Array) -> Array:
    """Scales d times one factor for each set of states that no coupling leaves, by the size of C diag(d) there."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    count, part = connected_components(csr_array(A != 0), directed=False)
    if C is None or count < 2 or not C.any():
        return d
    size = np.full((len(C), count), -np.inf)
    with np.errstate(divide="ignore"):
        np.maximum.at(size, (np.arange(len(C))[:, None], part), np.log2(np.abs(C)) + np.log2(d))
    finite = np.isfinite(size)
    size = np.where(finite, size, 0.0)
    outputs, factors = np.zeros(len(C)), np.zeros(count)
    for _ in range(ROUNDS):  # alternating means: least squares of the logarithms, which no unit changes
        factors = -np.sum(np.where(finite, size + outputs[:, None], 0.0), axis=0) / np.maximum(finite.sum(axis=0), 1)
        outputs = -np.sum(np.where(finite, size + factors, 0.0), axis=1) / np.maximum(finite.sum(axis=1), 1)
    return np.asarray(d * np.exp2(np.rint(np.clip(factors, -FARTHEST, FARTHEST)))[part])


def _between(size: Array) -> Array:
    """Logarithms of the scales of components: sum of |size[i, j] + s[j] - s[i]| about least over the couplings."""
    to, by = np.nonzero(np.isfinite(size))
    demand = size[to, by]
    rows = np.zeros((to.size, len(size)))
    rows[np.arange(to.size), to] += 1.0
    rows[np.arange(to.size), by] -= 1.0
    weight: Array = np.ones(to.size)
    s: Array = np.zeros(len(size))
    for _ in range(ROUNDS if to.size else 0):
        s = np.asarray(np.linalg.lstsq(rows * weight[:, None], demand * weight, rcond=None)[0], dtype=np.float64)
        weight = 1 / np.sqrt(np.maximum(np.abs(rows @ s - demand), 1e-3))
    return np.clip(s, -FARTHEST, FARTHEST)


def _depth(driven: Mask) -> Index:
    """How many couplings lead from a component to the last one that it drives: drivers come after the driven."""
    depth = np.zeros(len(driven), dtype=np.intp)
    for _ in range(len(driven)):
        depth = np.max(np.where(driven, 1 + depth[:, None], depth[None, :]), axis=0, initial=0)
    return depth


def chain_speed(A: Array, G: Array, C: Array, w: Array, v: Array) -> float:
    """Return max_k (|C A^(k-1) G w| / (k! v))^(1/k) [1/time], k = 1, ..., n: how soon w moves an output by v > 0.

    Chains of integrators have no rate of their own: only what drives and what measures them says how fast they are.
    It is 0 if w moves no output. Sizes are summed as logarithms, since powers of A leave the doubles.
    """
    noise = np.broadcast_to(v, len(C))
    rows, noise = C[noise > 0], np.log(noise[noise > 0])
    power, total, fastest = G * w, 0.0, -np.inf
    for k in range(1, len(A) + 1):
        size = float(np.max(np.abs(power), initial=0.0))
        if size == 0:
            break
        power, total = power / size, total + math.log(size)
        with np.errstate(divide="ignore"):  # the logarithm of what is not moved
            reached = np.log(np.sum(np.abs(rows @ power), axis=1)) - noise
        fastest = max(fastest, (total + float(np.max(reached, initial=-np.inf)) - math.lgamma(k + 1)) / k)
        power = A @ power
    return math.exp(min(fastest, LARGEST_LOGARITHM))
